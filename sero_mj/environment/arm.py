"""One simulated robot that an agent drives, and what can be seen of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import mujoco
import numpy as np
from dm_env import specs
from numpy.typing import NDArray
from pydantic import Field

from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..assemble.world import World
from ..control.controllers import make_controller
from ..control.robot_model import RobotModel
from ..control.state import Sensed, Target
from ..declaration import Declaration
from ..errors import DeclarationError, Problem, SimulationError
from ..simulate.plant import Plant
from ..simulate.scenario import RobotSensors
from ..simulate.sensors import SIGNALS, Sensors
from .actions import AnyAction, ImpedanceAction, Kind, TorqueAction

Array = NDArray[np.float64]

BEYOND = {"revolute": 0.2, "prismatic": 0.05}  # rad, m: how far springs let joints into stops
_MOST_TRIES = 2000
_FROM_LIMITS = 0.05  # share of a joint's range that sampled poses keep from either end


class Settings(Declaration):
    """What all environments have.

    Attributes:
        action: what an agent commands: joint torques, or offsets of an impedance's target.
        time_limit: s, of an episode.
        control_timestep: s between two actions.
        timestep: s between two steps of the simulation.
        seed: of everything that is random; the same seed gives the same episodes.
        stiffness: Nm/rad, one for all joints or one each; where actions are target offsets.
        damping: ratio, likewise.
        sensors: what they add to the truth, as in a scenario's `[sensors.NAME]`.
        start: `random`, `home` (as the robot is declared), or joint angles, rad or m.
        robot: fields over those of the robot's file: `{"show_billboards": True}`.
    """

    action: Kind = "torque"
    time_limit: float = Field(5.0, gt=0, le=1e4)
    control_timestep: float = Field(0.02, ge=1e-4, le=1.0)
    timestep: float = Field(0.001, ge=1e-5, le=0.02)
    seed: int = Field(0, ge=0, lt=2**32)
    stiffness: Any = 500.0
    damping: Any = 0.7
    sensors: Mapping[str, Any] = Field(default_factory=dict)
    start: Literal["random", "home"] | list[float] = "random"
    robot: Mapping[str, Any] = Field(default_factory=dict)

    @property
    def substeps(self) -> int:
        """Steps of the simulation in a control step.

        Raises:
            DeclarationError: it is no whole number of them.
        """
        ratio = self.control_timestep / self.timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            message = (
                f"found {self.control_timestep:g} s; expected a whole number of steps of "
                f"{self.timestep:g} s"
            )
            raise DeclarationError([Problem("control_timestep", message)])
        return round(ratio)

    def make_action(self, robot: SerialRobot) -> AnyAction:
        """What an agent commands."""
        if self.action == "torque":
            return TorqueAction(robot)
        return ImpedanceAction(
            robot, self.control_timestep, self.timestep, self.stiffness, self.damping
        )


class Arm:
    """A simulated robot with its controller, from action to action.

    Args:
        robot: its declaration.
        settings: how it is driven.

    Attributes:
        robot: as given.
        plant: the simulation.
        action: what an agent commands.
        truth: (3, n), true angles, velocities and torques now: a view.

    Raises:
        DeclarationError: limits that are missing, gains that are unstable, sensors that do not fit.
    """

    def __init__(self, robot: SerialRobot, settings: Settings) -> None:
        n = robot.n
        self.robot, self.settings = robot, settings
        self.substeps = settings.substeps
        self.action = settings.make_action(robot)
        declared = RobotSensors(**settings.sensors)
        try:
            angles, velocities, torques = (declared.errors(signal) for signal in SIGNALS)
            sensors = Sensors(n, angles, velocities, torques)
        except ValueError as error:
            raise DeclarationError([Problem("sensors", str(error))]) from None
        world = World(Scene(robots=[robot]), dynamic=True)
        self._model = RobotModel.of(robot, world)  # before anything is changed about the world
        self.plant = Plant(world, sensors, settings.timestep)
        self._part = world.robots[robot.name]
        self._motors = np.zeros(2 * n) if robot.elastic_joints else None
        self._torques: Array = np.zeros(n)
        self._scratch = world.make_data()
        self._start = self._make_start()
        self._slack = np.array([BEYOND[kind] for kind in robot.types])
        self._make_controller().check(np.asarray(robot.home, np.float64))

    @property
    def truth(self) -> Array:
        """True angles, velocities and torques, (3, n); see `Plant.actual`."""
        return self.plant.actual

    def _make_controller(self) -> Any:
        """A new one for every episode: nothing that it remembers may get into the next."""
        self.sensed = Sensed(self.robot.n, self.plant.measured, self._motors)
        self.target = Target(self.robot.n)
        return make_controller(
            self.action.controller, self._model, self.settings.timestep, self.robot.torque_limits
        )

    def _make_start(self) -> Array | None:
        start = self.settings.start
        if start == "random":
            return None
        angles = np.asarray(self.robot.home if start == "home" else start, np.float64)
        if angles.shape != (self.robot.n,):
            message = f"found {angles.size} numbers; expected {self.robot.n}, one per joint"
            raise DeclarationError([Problem("start", message)])
        limits = self.robot.position_limits
        if limits is not None:
            bad = (angles < limits[:, 0]) | (angles > limits[:, 1])
            if bad.any():
                joint = int(np.argmax(bad))
                low, high = limits[joint]
                found = f"joint {self.robot.names[joint]} is to be at {angles[joint]:g}"
                raise DeclarationError(
                    [Problem("start", f"{found}; expected {low:.4g} to {high:.4g}")]
                )
        return angles

    @property
    def time(self) -> float:
        """Since the episode began, s."""
        return self.plant.time

    @property
    def commanded_torques(self) -> Array:
        """What the drives were asked for last, (n,), Nm."""
        return self._torques

    def begin(self, rng: np.random.Generator) -> None:
        """Begins an episode.

        Args:
            rng: what is random comes from it, the sensors' noise as well.
        """
        angles = self.free_pose(rng) if self._start is None else self._start
        self.plant.sensors.seed = int(rng.integers(2**32))
        self.plant.reset(angles)
        self._controller = self._make_controller()
        self._torques[:] = self.plant.actual[2]
        self.action.begin(self.target, angles)

    def step(self, action: Array) -> None:
        """Lets a control step pass.

        Raises:
            SimulationError: the motion has become unstable.
        """
        plant, sensed, torques = self.plant, self.sensed, self._torques
        self.action.take(action)
        for _ in range(self.substeps):
            self.action.advance()
            sensed.time = plant.data.time
            if self._motors is not None:
                n = len(torques)
                self._motors[:n], self._motors[n:] = plant.motor_angles, plant.motor_velocities
            self._controller.torques(sensed, self.target, torques)
            plant.step(torques)

    def flange(self) -> Array:
        """T_world_flange now, (4, 4), m; the true one."""
        T, body = np.eye(4), self._part.flange_body
        data = self.plant.data
        T[:3, :3], T[:3, 3] = data.xmat[body].reshape(3, 3), data.xpos[body]
        return T

    def free_pose(self, rng: np.random.Generator) -> Array:
        """Joint angles, (n,), within the limits, in which the robot touches nothing.

        Raises:
            SimulationError: none was found.
        """
        robot, model, data, part = self.robot, self.plant.model, self._scratch, self._part
        limits = robot.position_limits
        if limits is None:
            far = [np.pi if kind == "revolute" else 0.0 for kind in robot.types]
            limits = np.stack([-np.array(far), np.array(far)], axis=1)
        low, high = limits.T
        gap = _FROM_LIMITS * (high - low)
        torques = np.full(robot.n, np.inf) if robot.torque_limits is None else robot.torque_limits
        for _ in range(_MOST_TRIES):
            angles = rng.uniform(low + gap, high - gap)
            data.qpos[part.qpos] = angles
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            if data.ncon == 0 and (np.abs(data.qfrc_bias[part.dofs]) < torques).all():
                return np.asarray(angles)
        reason = f"found no pose in {_MOST_TRIES} that touches nothing and that its torques hold"
        raise SimulationError(0.0, robot.name, f"{reason}; expected other limits, or a start")

    def observation(self) -> dict[str, Array]:
        """What its sensors say, each (n,), in arrays of their own."""
        angles, velocities, torques = self.plant.measured
        limits = self.robot.position_limits
        if limits is not None:
            angles = np.clip(angles, limits[:, 0] - self._slack, limits[:, 1] + self._slack)
        return {
            "joint_angles": np.array(angles),
            "joint_velocities": velocities.copy(),
            "torques": torques.copy(),
            **self.action.observation(),
        }

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of `observation`."""
        shape, limits = (self.robot.n,), self.robot.position_limits
        found: dict[str, specs.Array] = {
            name: specs.Array(shape, np.float64, name=name)
            for name in ("joint_angles", "joint_velocities", "torques")
        }
        if limits is not None:
            low, high = limits[:, 0] - self._slack, limits[:, 1] + self._slack
            found["joint_angles"] = specs.BoundedArray(
                shape, np.float64, low, high, name="joint_angles"
            )
        return {**found, **self.action.observation_spec()}
