"""Options of environments, and the scenario of a robot alone."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ..assemble.double import Double
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..declaration import Declaration
from ..errors import DeclarationError, Problem
from ..runs.run_log import event_of
from ..simulate.scenario import Scenario
from ..simulate.simulated_scene import SOURCE
from .actions import AnyAction, ImpedanceAction, Kind, TorqueAction
from .task import GOAL, Task

Array = NDArray[np.float64]


class Settings(Declaration):
    """Options of all environments.

    Attributes:
        action: what an agent commands: joint torques, or offsets of an impedance's target.
        control_timestep: s between two actions.
        seed: of everything that is random; the same seed gives the same episodes.
        stiffness: Nm/rad, one for all joints or one each; where actions are target offsets.
        damping: ratio, likewise.
    """

    action: Kind = "torque"
    control_timestep: float = Field(0.02, ge=1e-4, le=1.0)
    seed: int = Field(0, ge=0, lt=2**32)
    stiffness: Any = 500.0
    damping: Any = 0.7

    def substeps(self, timestep: float) -> int:
        """Steps of the simulation in a control step.

        Args:
            timestep: of the simulation, s.

        Raises:
            DeclarationError: a control step is no whole number of them.
        """
        ratio = self.control_timestep / timestep
        if abs(ratio - round(ratio)) > 1e-6 or round(ratio) < 1:
            found = f"found {self.control_timestep:g} s; expected a whole number of steps of"
            raise DeclarationError([Problem("control_timestep", f"{found} {timestep:g} s")])
        return round(ratio)

    def make_action(self, robot: SerialRobot, timestep: float) -> AnyAction:
        """What an agent commands a robot, at a timestep of the simulation in s."""
        if self.action == "torque":
            return TorqueAction(robot)
        return ImpedanceAction(robot, self.control_timestep, timestep, self.stiffness, self.damping)


class ScenarioSettings(Settings):
    """Options of the environment of a scenario.

    Attributes:
        robot: whose controller the agent takes the place of; the first one when None.
        overrides: dotted key to its value, over the scenario's file: `{"run.duration": 2.0}`.
    """

    robot: str | None = None
    overrides: Mapping[str, Any] = Field(default_factory=dict)


class RobotSettings(Settings):
    """Options of the environment of a robot with a task.

    Attributes:
        time_limit: s, of an episode.
        timestep: s between two steps of the simulation.
        sensors: what they add to the truth, as in a scenario's `[sensors.NAME]`.
        start: `random`, `home` (as the robot is declared), or joint angles, rad or m.
        robot: fields over those of the robot's file: `{"show_billboards": True}`.
    """

    time_limit: float = Field(5.0, gt=0, le=1e4)
    timestep: float = Field(0.001, ge=1e-5, le=0.02)
    sensors: Mapping[str, Any] = Field(default_factory=dict)
    start: Literal["random", "home"] | list[float] = "random"
    robot: Mapping[str, Any] = Field(default_factory=dict)

    def make_scenario(self, robot: SerialRobot, task: Task) -> Scenario:
        """A scenario of a robot alone; it stands at its start, or within its limits.

        Args:
            robot: its declaration: `show_arrows` and the like are what pictures show.
            task: whose goal and arrows are in the pictures as well.

        Raises:
            DeclarationError: the start, sensors or times do not fit.
        """
        steps = max(round(self.time_limit / self.control_timestep), 1)
        name = robot.name
        # Pictures show what is true, not what is measured.
        actual = {"joint_angles": "actual_angles", "torques": "actual_torques"}
        scene = Scene(
            robots=[robot.model_copy(update={"joint_angles": self._home(robot)})],
            doubles=[Double(name=f"{name}_{GOAL}", of=name)],
            arrows=task.arrows(name),
            routes={
                f"{name}.{key}": f"{SOURCE}.{event_of(name, signal)}"
                for key, signal in actual.items()
            },
            name=name,
        )
        return Scenario(
            scene,
            sensors={name: self.sensors},
            duration=steps * self.control_timestep,
            timestep=self.timestep,
            show_targets=False,
            name=name,
        )

    def _home(self, robot: SerialRobot) -> Array:
        """Where the robot stands before the first episode."""
        limits = robot.position_limits
        if isinstance(self.start, str):
            home = np.asarray(robot.home, np.float64)
            if limits is None or self.start == "home":
                return home
            return np.clip(home, limits[:, 0], limits[:, 1])
        angles = np.asarray(self.start, np.float64)
        if angles.shape != (robot.n,):
            message = f"found {angles.size} numbers; expected {robot.n}, one per joint"
            raise DeclarationError([Problem("start", message)])
        if limits is not None:
            bad = (angles < limits[:, 0]) | (angles > limits[:, 1])
            if bad.any():
                joint = int(np.argmax(bad))
                low, high = limits[joint]
                found = f"joint {robot.names[joint]} is to be at {angles[joint]:g}"
                raise DeclarationError(
                    [Problem("start", f"{found}; expected {low:.4g} to {high:.4g}")]
                )
        return angles
