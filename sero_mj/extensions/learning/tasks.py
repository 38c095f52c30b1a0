"""Tasks of environments: `Reach`, `Hold`, and `Expectations` of a scenario.

A `Task` declares the options of a task. It creates an `Episode` for a robot, which computes rewards
and observations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar, Literal

import mujoco
import numpy as np
from dm_env import specs
from pydantic import Field

from ...base.declaration import Declaration
from ...base.errors import SimulationError
from ...base.frames import Array, frame, rotation_angles
from ...robots.declared.cartesian import SmartArrow
from ...robots.declared.robot import SerialRobot
from ...simulate.plant import Plant
from ...simulate.runs.run_log import RunLog
from ...simulate.simulation import Simulation

GOAL = "goal"  # the double at the goal is called `ROBOT_goal`
_MAX_TRIES = 2000
_MAX_DEPTH = 0.005  # maximum penetration of a robot that stands on the floor, m
_LIMIT_DISTANCE = 0.05  # minimum distance of sampled poses to limits, share of the range


class AgentRobot:
    """The state of the simulated robot that an agent controls, for use by tasks."""

    def __init__(self, simulation: Simulation, name: str) -> None:
        self.simulation, self.name = simulation, name
        self._scratch = self.plant.world.make_data()

    @property
    def declared(self) -> SerialRobot:
        return self.simulation.robots[self.name]

    def base(self) -> Array:
        """Returns the current T_world_base, which varies for mounted and mobile robots."""
        self.plant.rows.physics.forward()
        data, body = self.plant.data, self.plant.world.robots[self.name].bodies[0]
        return frame(data.xmat[body].reshape(3, 3), data.xpos[body])

    @property
    def plant(self) -> Plant:
        plant = self.simulation.plant
        assert isinstance(plant, Plant)
        return plant

    @property
    def angles(self) -> Array:
        """True joint values, a view of shape (n,)."""
        return self.plant.actual[0, self.plant.world.robots[self.name].joints]

    @property
    def measured_angles(self) -> Array:
        """Measured joint values, a view of shape (n,)."""
        return self.plant.measured[0, self.plant.world.robots[self.name].joints]

    def flange(self) -> Array:
        """Returns the true T_world_flange."""
        return self.plant.flange(self.name)

    def free_pose(self, rng: np.random.Generator) -> Array:
        """Returns random joint values, shape (n,), within the limits and without contact.

        A robot with a free base may touch fixed bodies, for example the floor.

        Raises:
            SimulationError: no such pose was found.
        """
        robot, model, data = self.declared, self.plant.model, self._scratch
        part = self.plant.world.robots[self.name]
        low, high = robot.display_ranges.T
        gap = _LIMIT_DISTANCE * (high - low)
        torques = robot.torque_bounds
        for _ in range(_MAX_TRIES):
            angles = rng.uniform(low + gap, high - gap)
            angles = robot.coupled.positions(angles[robot.coupled.independent])
            data.qpos[part.qpos] = angles
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            if not self._touches(data) and (np.abs(data.qfrc_bias[part.dofs]) < torques).all():
                return np.asarray(angles)
        reason = f"none of {_MAX_TRIES} random poses is without contact and within torque limits"
        raise SimulationError(0.0, robot.name, f"{reason}; expected other limits or a fixed start")

    def _touches(self, data: mujoco.MjData) -> bool:
        if not data.ncon or not self.declared.free_base:
            return bool(data.ncon)
        model = self.plant.model
        is_fixed = (model.body_weldid[model.geom_bodyid[data.contact.geom]] == 0).any(axis=1)
        return not (is_fixed & (data.contact.dist > -_MAX_DEPTH)).all()


class ManyStates:
    """The states of m equal robots, for use by tasks.

    Args:
        angles: true joint values, shape (m, n).
        measured_angles: measured joint values, shape (m, n).
        flanges_at: function from joint values to T_world_flange, shape (m, 4, 4).
    """

    def __init__(
        self, angles: Array, measured_angles: Array, flanges_at: Callable[[Array], Array]
    ) -> None:
        self.angles, self._measured_angles = angles, measured_angles
        self._flanges_at = flanges_at

    @cached_property
    def flanges(self) -> Array:
        """True T_world_flange, shape (m, 4, 4)."""
        return self._flanges_at(self.angles)

    @cached_property
    def measured_flanges(self) -> Array:
        """T_world_flange from measured joint values, shape (m, 4, 4)."""
        if self._measured_angles is self.angles:
            return self.flanges
        return self._flanges_at(self._measured_angles)


class ManyEpisodes(ABC):
    """A task of m robots, in successive episodes."""

    pushes: ClassVar[bool] = False  # whether `forces` may return nonzero forces

    @abstractmethod
    def begin(self, k: int) -> None:
        """Begins an episode of robot k as a copy of the one that `Episode.begin` has begun."""

    def forces(self, times: Array) -> Array:
        """Returns forces at the flanges in the next control step, shape (m, 3), world axes, N."""
        return np.zeros((len(times), 3))

    @abstractmethod
    def rewards(self, now: ManyStates) -> Array:
        """Returns the rewards of the current states, from 0 to 1, shape (m,)."""

    @abstractmethod
    def observations(self, now: ManyStates) -> dict[str, Array]:
        """Returns the observations of the task by name, shape (m, ...)."""


class Episode:
    """A task of one robot, in successive episodes. The base class has no reward."""

    def make_many(self, m: int) -> ManyEpisodes | None:
        """Returns the task for m robots, or None if robots can only be simulated one by one."""
        return None

    def begin(self, rng: np.random.Generator) -> None:
        """Begins an episode. The robot is already in its start pose."""

    def advance(self) -> None:
        """Begins a control step."""

    def reward(self) -> float:
        """Returns the reward of the current state, 0 to 1."""
        return 0.0

    def observation(self) -> dict[str, Array]:
        """Returns the observations of the task by name."""
        return {}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Returns the shapes and bounds of `observation`."""
        return {}

    def inputs(self) -> dict[str, Array]:
        """Returns the values of inputs that display the goal, such as `lwr_goal.joint_angles`."""
        return {}


class Task(Declaration, ABC):
    """Base class of the declarations of tasks.

    Attributes:
        observed: names of the observed signals of every robot.
    """

    observed: ClassVar[tuple[str, ...]] = ("joint_angles", "joint_velocities", "torques")

    @abstractmethod
    def make(self, robot: AgentRobot) -> Episode:
        """Returns the task for a robot."""

    def arrows(self, robot: str) -> list[SmartArrow]:
        """Returns the arrows that display the task."""
        return []


def closeness(distance: Any, within: float, margin: float) -> Any:
    """Returns a reward that is 1 up to the distance `within`, and decreases beyond it.

    The reward is 1 / (1 + 9 ((distance - within) / margin)^2), so it is 0.1 at `within + margin`.

    Source: Tunyasuvunakool et al. 2020, dm_control: Software and Tasks for Continuous Control,
    Software Impacts 6 (`tolerance` with a long tail).
    """
    beyond = np.maximum(distance - within, 0.0) / margin
    return 1.0 / (1.0 + 9.0 * beyond * beyond)


class Reach(Task):
    """Move the flange to a random reachable target.

    The reward is c(d, 0.005 m, 0.3 m) with the distance d between flange and target. For poses, it
    is multiplied by c(a, 2 deg, 90 deg) with the angle a. For c, see `closeness`.

    Attributes:
        target: kind of target: `position`, or `pose` (position and orientation).
        within: distance up to which the reward is 1, m.
        margin: additional distance at which the reward is 0.1, m.
        within_angle: angle up to which the reward is 1, rad.
        margin_angle: additional angle at which the reward is 0.1, rad.
    """

    target: Literal["position", "pose"] = "position"
    within: float = Field(0.005, ge=0)
    margin: float = Field(0.3, gt=0)
    within_angle: float = Field(float(np.deg2rad(2.0)), ge=0)
    margin_angle: float = Field(float(np.deg2rad(90.0)), gt=0)

    def make(self, robot: AgentRobot) -> Episode:
        return ReachEpisode(self, robot)

    def rewards(self, flanges: Array, targets: Array) -> Array:
        """Returns rewards, shape (...,), for poses in the world, shape (..., 4, 4)."""
        away = flanges[..., :3, 3] - targets[..., :3, 3]
        found = closeness(np.linalg.norm(away, axis=-1), self.within, self.margin)
        if self.target == "pose":
            angles = rotation_angles(flanges[..., :3, :3].mT @ targets[..., :3, :3])
            found = found * closeness(angles, self.within_angle, self.margin_angle)
        return np.asarray(found)

    def observations(self, flanges: Array, targets: Array) -> dict[str, Array]:
        """Returns positions, shape (..., 3), and for poses also quaternions, (..., 4), w first."""
        found = {
            "flange_position": flanges[..., :3, 3].copy(),
            "target_position": targets[..., :3, 3].copy(),
        }
        if self.target == "pose":
            found["flange_quaternion"] = _quaternions(flanges)
            found["target_quaternion"] = _quaternions(targets)
        return found


class ReachEpisode(Episode):
    """Episodes of the task `Reach`.

    Attributes:
        goal: joint values that reach the target, shape (n,).
        target: T_world_target.
    """

    def __init__(self, task: Reach, robot: AgentRobot) -> None:
        self._task, self._robot = task, robot
        self.goal: Array = np.zeros(robot.declared.n)
        self.target: Array = np.eye(4)

    def make_many(self, m: int) -> ManyEpisodes:
        return ManyReaches(self._task, self, m)

    def begin(self, rng: np.random.Generator) -> None:
        robot = self._robot.declared
        self.goal = self._robot.free_pose(rng)
        self.target = self._robot.base() @ robot.fwd_kin_base_to_flange(self.goal)

    def reward(self) -> float:
        return float(self._task.rewards(self._robot.flange(), self.target))

    def observation(self) -> dict[str, Array]:
        robot = self._robot.declared
        flange = self._robot.base() @ robot.fwd_kin_base_to_flange(self._robot.measured_angles)
        return self._task.observations(flange, self.target)

    def observation_spec(self) -> dict[str, specs.Array]:
        found: dict[str, specs.Array] = {
            name: specs.Array((3,), np.float64, name=name)
            for name in ("flange_position", "target_position")
        }
        if self._task.target == "pose":
            for name in ("flange_quaternion", "target_quaternion"):
                found[name] = specs.BoundedArray((4,), np.float64, -1.0, 1.0, name=name)
        return found

    def inputs(self) -> dict[str, Array]:
        return {f"{self._robot.name}_{GOAL}.joint_angles": self.goal}


class ManyReaches(ManyEpisodes):
    """Episodes of the task `Reach` for m robots."""

    def __init__(self, task: Reach, one: ReachEpisode, m: int) -> None:
        self._task, self._one = task, one
        self.targets: Array = np.tile(np.eye(4), (m, 1, 1))

    def begin(self, k: int) -> None:
        self.targets[k] = self._one.target

    def rewards(self, now: ManyStates) -> Array:
        return self._task.rewards(now.flanges, self.targets)

    def observations(self, now: ManyStates) -> dict[str, Array]:
        return self._task.observations(now.measured_flanges, self.targets)


def _quaternions(T: Array) -> Array:
    # Returns unique quaternions with w >= 0, shape (..., 4).
    found = np.empty((*T.shape[:-2], 4))
    for quaternion, rotation in zip(
        found.reshape(-1, 4), T[..., :3, :3].reshape(-1, 9), strict=True
    ):
        mujoco.mju_mat2Quat(quaternion, rotation)
    return np.clip(np.where(found[..., :1] >= 0, found, -found), -1.0, 1.0)


class Hold(Task):
    """Hold the start pose under random pushes at the flange.

    Pushes have random directions and times, and may overlap. They are not observed, but the torque
    sensors measure their effect. The reward is c(e, 0.005, 0.3) with the largest error e of all
    joints (rad or m). For c, see `closeness`.

    Attributes:
        max_force: maximum force of a push, N.
        every: mean time between pushes, s.
        shortest: minimum duration of a push, s.
        longest: maximum duration of a push, s.
        within: error up to which the reward is 1, rad or m.
        margin: additional error at which the reward is 0.1, rad or m.
    """

    renamed: ClassVar[Mapping[str, str]] = {"most_force": "max_force"}
    max_force: float = Field(40.0, ge=0, le=1e4)
    every: float = Field(1.0, ge=0.01)
    shortest: float = Field(0.1, gt=0)
    longest: float = Field(0.5, gt=0)
    within: float = Field(0.005, ge=0)
    margin: float = Field(0.3, gt=0)

    def make(self, robot: AgentRobot) -> Episode:
        return HoldEpisode(self, robot)

    def rewards(self, angles: Array, poses: Array) -> Array:
        """Returns rewards, shape (...,), for joint values, shape (..., n)."""
        errors = np.abs(angles - poses).max(axis=-1)
        return np.asarray(closeness(errors, self.within, self.margin))

    def arrows(self, robot: str) -> list[SmartArrow]:
        return [SmartArrow(name="push", kind="force", at=f"{robot}/flange", expressed_in="world")]


class HoldEpisode(Episode):
    """Episodes of the task `Hold`."""

    def __init__(self, task: Hold, robot: AgentRobot) -> None:
        self._task, self._robot = task, robot
        self._pose: Array = np.zeros(robot.declared.n)
        self._times: Array = np.zeros((0, 2))
        self._forces: Array = np.zeros((0, 3))
        self._force: Array = np.zeros(3)

    def make_many(self, m: int) -> ManyEpisodes:
        return ManyHolds(self._task, self, m)

    @property
    def pose(self) -> Array:
        """The joint values to hold, shape (n,)."""
        return self._pose

    @property
    def pushes(self) -> tuple[Array, Array]:
        """Start and end times of k pushes, shape (k, 2), s, and forces, shape (k, 3), N."""
        return self._times, self._forces

    def begin(self, rng: np.random.Generator) -> None:
        task, robot = self._task, self._robot
        self._pose = robot.angles.copy()
        duration = robot.simulation.scenario.run.duration
        many = rng.poisson(duration / task.every)
        begins = rng.uniform(0.0, duration, many)
        lasting = rng.uniform(task.shortest, max(task.longest, task.shortest), many)
        self._times = np.stack([begins, begins + lasting], axis=1)
        directions = rng.standard_normal((many, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._forces = directions * rng.uniform(0.0, task.max_force, (many, 1))
        self._force = np.zeros(3)
        self._push = robot.plant.push(f"{robot.name}/flange")

    def advance(self) -> None:
        now = self._robot.plant.time
        acting = (self._times[:, 0] <= now) & (now < self._times[:, 1])
        self._force = self._forces[acting].sum(axis=0)
        self._push.force[:] = self._force

    def reward(self) -> float:
        return float(self._task.rewards(self._robot.angles, self._pose))

    def observation(self) -> dict[str, Array]:
        return {"hold_angles": self._pose.copy()}

    def observation_spec(self) -> dict[str, specs.Array]:
        return {"hold_angles": specs.Array(self._pose.shape, np.float64, name="hold_angles")}

    def inputs(self) -> dict[str, Array]:
        return {f"{self._robot.name}_{GOAL}.joint_angles": self._pose, "push.vector": self._force}


class ManyHolds(ManyEpisodes):
    """Episodes of the task `Hold` for m robots."""

    pushes = True

    def __init__(self, task: Hold, one: HoldEpisode, m: int) -> None:
        self._task, self._one = task, one
        self._poses: Array = np.tile(one.pose, (m, 1))
        # All robots have the same number of pushes. Additional pushes have the duration 0.
        self._times: Array = np.zeros((m, 0, 2))
        self._forces: Array = np.zeros((m, 0, 3))

    def begin(self, k: int) -> None:
        times, forces = self._one.pushes
        more = len(times) - self._times.shape[1]
        if more > 0:
            self._times = np.pad(self._times, ((0, 0), (0, more), (0, 0)))
            self._forces = np.pad(self._forces, ((0, 0), (0, more), (0, 0)))
        self._poses[k], self._times[k] = self._one.pose, 0.0
        self._times[k, : len(times)], self._forces[k, : len(times)] = times, forces

    def forces(self, times: Array) -> Array:
        now = times[:, None]
        acting = (self._times[..., 0] <= now) & (now < self._times[..., 1])
        return np.asarray((self._forces * acting[..., None]).sum(axis=1))

    def rewards(self, now: ManyStates) -> Array:
        return self._task.rewards(now.angles, self._poses)

    def observations(self, now: ManyStates) -> dict[str, Array]:
        return {"hold_angles": self._poses.copy()}


class Expectations(Task):
    """Keep the measures of a scenario within the expected bounds.

    The reward is the mean over all expectations that are active at this time: 1 if the measure is
    within its bounds, otherwise `below / value` or `value / above`. Without active expectations, it
    is 1. Expectations of findings, of `rms` or `mean`, of a `max` above a bound, and of a `min`
    below a bound have no reward. `Simulation.outcomes` evaluates them at the end.
    """

    observed: ClassVar[tuple[str, ...]] = (
        "joint_angles", "joint_velocities", "torques", "external_torques", "target_angles",
        "target_velocities",
    )  # fmt: skip

    def make(self, robot: AgentRobot) -> Episode:
        return ExpectationsEpisode(robot)


class ExpectationsEpisode(Episode):
    """Episodes of the task `Expectations`."""

    def __init__(self, robot: AgentRobot) -> None:
        self._robot = robot
        self._expected = [
            each
            for each in robot.simulation.scenario.expect.values()
            if each.measure is not None and each.of in ("max", "min", "final")
        ]

    def reward(self) -> float:
        simulation = self._robot.simulation
        now = simulation.time
        active = [
            each
            for each in self._expected
            if each.after - 1e-9 <= now <= (np.inf if each.before is None else each.before) + 1e-9
        ]
        if not active:
            return 1.0
        log = RunLog.from_rows(  # drift needs the first row
            simulation.layout, simulation.rows[[0, simulation.step]], simulation.robots
        )
        return float(np.mean([each.share(log) for each in active]))
