"""Tasks of environments: `Reach`, `Hold`, and `Expectations` of a scenario.

A task is declared by its options; for a robot it makes an `Episode`, with the reward, what is
observed, and what pictures show.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
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

GOAL = "goal"  # the double at a task's goal is called `ROBOT_goal`
_MAX_TRIES = 2000
_MOST_DEPTH = 0.005  # m, of what stands on the floor in it
_FROM_LIMITS = 0.05  # share of a joint's range that sampled poses keep from either end


class AgentRobot:
    """The simulated robot that an agent drives, as tasks see it.

    Attributes:
        simulation: of the current episode.
        name: as given.
    """

    def __init__(self, simulation: Simulation, name: str) -> None:
        self.simulation, self.name = simulation, name
        self._scratch = self.plant.world.make_data()

    @property
    def declared(self) -> SerialRobot:
        """Its declaration."""
        return self.simulation.robots[self.name]

    def base(self) -> Array:
        """T_world_base now, (4, 4), m; of a mounted robot it moves with what carries it."""
        self.plant.rows.physics.forward()
        data, body = self.plant.data, self.plant.world.robots[self.name].bodies[0]
        return frame(data.xmat[body].reshape(3, 3), data.xpos[body])

    @property
    def plant(self) -> Plant:
        """The simulated robots of the current episode."""
        plant = self.simulation.plant
        assert isinstance(plant, Plant)
        return plant

    @property
    def angles(self) -> Array:
        """True joint angles now, (n,), rad or m: a view."""
        return self.plant.actual[0, self.plant.world.robots[self.name].joints]

    @property
    def measured_angles(self) -> Array:
        """Measured joint angles now, (n,), rad or m: a view."""
        return self.plant.measured[0, self.plant.world.robots[self.name].joints]

    def flange(self) -> Array:
        """T_world_flange now, (4, 4), m; the true one."""
        return self.plant.flange(self.name)

    def free_pose(self, rng: np.random.Generator) -> Array:
        """Joint angles, (n,), within the limits, in which the robot touches nothing.

        A robot with a free base may touch what is fixed, as where it stands on the floor.

        Raises:
            SimulationError: none was found.
        """
        robot, model, data = self.declared, self.plant.model, self._scratch
        part = self.plant.world.robots[self.name]
        low, high = robot.display_ranges.T
        gap = _FROM_LIMITS * (high - low)
        torques = robot.torque_bounds
        for _ in range(_MAX_TRIES):
            angles = rng.uniform(low + gap, high - gap)
            angles = robot.coupled.positions(angles[robot.coupled.independent])
            data.qpos[part.qpos] = angles
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_fwdVelocity(model, data)
            if not self._touches(data) and (np.abs(data.qfrc_bias[part.dofs]) < torques).all():
                return np.asarray(angles)
        reason = f"found no pose in {_MAX_TRIES} that touches nothing and that its torques hold"
        raise SimulationError(0.0, robot.name, f"{reason}; expected other limits, or a start")

    def _touches(self, data: mujoco.MjData) -> bool:
        if not data.ncon or not self.declared.free_base:
            return bool(data.ncon)
        model = self.plant.model
        stands = (model.body_weldid[model.geom_bodyid[data.contact.geom]] == 0).any(axis=1)
        return not (stands & (data.contact.dist > -_MOST_DEPTH)).all()


class ManyStates:
    """Where m equal robots are, as tasks see it; `AgentRobot` for one.

    Args:
        angles: (m, n), true, rad or m.
        flanges_at: T_world_flange, (m, 4, 4), m, of joint angles.

    Attributes:
        angles: as given.
    """

    def __init__(
        self, angles: Array, measured_angles: Array, flanges_at: Callable[[Array], Array]
    ) -> None:
        self.angles, self._measured_angles = angles, measured_angles
        self._flanges_at = flanges_at

    @cached_property
    def flanges(self) -> Array:
        """T_world_flange, (m, 4, 4), m; true."""
        return self._flanges_at(self.angles)

    @cached_property
    def measured_flanges(self) -> Array:
        """Likewise by the measured angles."""
        if self._measured_angles is self.angles:
            return self.flanges
        return self._flanges_at(self._measured_angles)


class ManyEpisodes(ABC):
    """A task of m robots at once, from episode to episode; `Episode` for one."""

    pushes: ClassVar[bool] = False  # whether `forces` are ever anything

    @abstractmethod
    def begin(self, k: int) -> None:
        """Begins an episode of robot k: the one that the episode for one has just begun."""

    def forces(self, times: Array) -> Array:
        """What pushes the flanges in the next control step, (m, 3), N, in the world's axes."""
        return np.zeros((len(times), 3))

    @abstractmethod
    def rewards(self, now: ManyStates) -> Array:
        """0 to 1, (m,)."""

    @abstractmethod
    def observations(self, now: ManyStates) -> dict[str, Array]:
        """What agents have to know of the task, (m, ...)."""


class Episode:
    """A task from episode to episode; by itself one in which nothing happens or is shown."""

    def make_many(self, m: int) -> ManyEpisodes | None:
        """The same of m robots at once; None where they can only be taken one by one."""
        return None

    def begin(self, rng: np.random.Generator) -> None:
        """Begins an episode; the robot stands where it starts."""

    def advance(self) -> None:
        """Begins a control step."""

    def reward(self) -> float:
        """0 to 1, for the state now."""
        return 0.0

    def observation(self) -> dict[str, Array]:
        """What an agent has to know of the task."""
        return {}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        return {}

    def inputs(self) -> dict[str, Array]:
        """Inputs of the scene to what pictures show there: `lwr_goal.joint_angles`, (n,)."""
        return {}


class Task(Declaration, ABC):
    """Base of the declarations of tasks.

    Attributes:
        observed: signals of every robot that an agent observes.
    """

    observed: ClassVar[tuple[str, ...]] = ("joint_angles", "joint_velocities", "torques")

    @abstractmethod
    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""

    def arrows(self, robot: str) -> list[SmartArrow]:
        """What pictures of it show beside the robot and a double at its goal."""
        return []


def closeness(distance: Any, within: float, margin: float) -> Any:
    """1 up to `within`, then 1 / (1 + 9 ((distance - within) / margin)^2): it never gets flat.

    Args:
        distance: from 0; a number or an array.
        margin: that far beyond the reward is 0.1.

    Source: Tunyasuvunakool et al. 2020, dm_control: Software and Tasks for Continuous Control,
    Software Impacts 6 (`tolerance` with a long tail).
    """
    beyond = np.maximum(distance - within, 0.0) / margin
    return 1.0 / (1.0 + 9.0 * beyond * beyond)


class Reach(Task):
    """Brings the flange to a random target that the robot can reach.

    The reward is c(d, 0.005 m, 0.3 m) with the distance d between flange and target, and for poses
    that times c(a, 2 deg, 90 deg) with the angle a between them; c is 1 within the first number
    and 0.1 the second beyond it: `closeness`.

    Attributes:
        target: `position`, or `pose`: with orientation.
        within: m, that is as good as there.
        margin: m beyond, at which the reward has fallen to 0.1.
        within_angle: likewise rad.
        margin_angle: likewise rad.
    """

    target: Literal["position", "pose"] = "position"
    within: float = Field(0.005, ge=0)
    margin: float = Field(0.3, gt=0)
    within_angle: float = Field(float(np.deg2rad(2.0)), ge=0)
    margin_angle: float = Field(float(np.deg2rad(90.0)), gt=0)

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        return ReachEpisode(self, robot)

    def rewards(self, flanges: Array, targets: Array) -> Array:
        """0 to 1, (...,), for poses in the world, (..., 4, 4), m."""
        away = flanges[..., :3, 3] - targets[..., :3, 3]
        found = closeness(np.linalg.norm(away, axis=-1), self.within, self.margin)
        if self.target == "pose":
            angles = rotation_angles(flanges[..., :3, :3].mT @ targets[..., :3, :3])
            found = found * closeness(angles, self.within_angle, self.margin_angle)
        return np.asarray(found)

    def observations(self, flanges: Array, targets: Array) -> dict[str, Array]:
        """Positions (..., 3), m; for poses also quaternions (..., 4), w first."""
        found = {
            "flange_position": flanges[..., :3, 3].copy(),
            "target_position": targets[..., :3, 3].copy(),
        }
        if self.target == "pose":
            found["flange_quaternion"] = _quaternions(flanges)
            found["target_quaternion"] = _quaternions(targets)
        return found


class ReachEpisode(Episode):
    """`Reach` from episode to episode.

    Attributes:
        goal: (n,), joint angles at which the flange is there, rad or m.
        target: T_world_target, (4, 4), m.
    """

    def __init__(self, task: Reach, robot: AgentRobot) -> None:
        self._task, self._robot = task, robot
        self.goal: Array = np.zeros(robot.declared.n)
        self.target: Array = np.eye(4)

    def make_many(self, m: int) -> ManyEpisodes:
        """The same of m robots at once."""
        return ManyReaches(self._task, self, m)

    def begin(self, rng: np.random.Generator) -> None:
        """Chooses a target: where the flange is in a pose that touches nothing."""
        robot = self._robot.declared
        self.goal = self._robot.free_pose(rng)
        self.target = self._robot.base() @ robot.fwd_kin_base_to_flange(self.goal)

    def reward(self) -> float:
        """0 to 1, for the state now."""
        return float(self._task.rewards(self._robot.flange(), self.target))

    def observation(self) -> dict[str, Array]:
        """Where flange and target are, in the world, m; for poses also quaternions, w first."""
        robot = self._robot.declared
        flange = self._robot.base() @ robot.fwd_kin_base_to_flange(self._robot.measured_angles)
        return self._task.observations(flange, self.target)

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        found: dict[str, specs.Array] = {
            name: specs.Array((3,), np.float64, name=name)
            for name in ("flange_position", "target_position")
        }
        if self._task.target == "pose":
            for name in ("flange_quaternion", "target_quaternion"):
                found[name] = specs.BoundedArray((4,), np.float64, -1.0, 1.0, name=name)
        return found

    def inputs(self) -> dict[str, Array]:
        """A double at the goal."""
        return {f"{self._robot.name}_{GOAL}.joint_angles": self.goal}


class ManyReaches(ManyEpisodes):
    """`ReachEpisode` of m robots at once."""

    def __init__(self, task: Reach, one: ReachEpisode, m: int) -> None:
        self._task, self._one = task, one
        self.targets: Array = np.tile(np.eye(4), (m, 1, 1))

    def begin(self, k: int) -> None:
        """Begins an episode of robot k."""
        self.targets[k] = self._one.target

    def rewards(self, now: ManyStates) -> Array:
        """0 to 1, (m,)."""
        return self._task.rewards(now.flanges, self.targets)

    def observations(self, now: ManyStates) -> dict[str, Array]:
        """Where flanges and targets are."""
        return self._task.observations(now.measured_flanges, self.targets)


def _quaternions(T: Array) -> Array:
    """w, x, y, z of poses (..., 4, 4), with w from 0 on: one for every orientation, (..., 4)."""
    found = np.empty((*T.shape[:-2], 4))
    for quaternion, rotation in zip(
        found.reshape(-1, 4), T[..., :3, :3].reshape(-1, 9), strict=True
    ):
        mujoco.mju_mat2Quat(quaternion, rotation)
    return np.clip(np.where(found[..., :1] >= 0, found, -found), -1.0, 1.0)


class Hold(Task):
    """Holds the pose of the start under random pushes at the flange.

    Pushes come in all directions, begin at random times and may overlap. They cannot be seen, but
    the torque sensors feel them. The reward is c(e, 0.005, 0.3) with the largest error e of any
    joint, rad or m; c is 1 within the first number and 0.1 the second beyond it.

    Attributes:
        most_force: N, of a push; its size is anything from 0 up to it.
        every: s, mean time from one push to the next.
        shortest: s, that a push lasts at least.
        longest: s, at most.
        within: rad or m, error that is as good as none.
        margin: rad or m beyond, at which the reward has fallen to 0.1.
    """

    most_force: float = Field(40.0, ge=0, le=1e4)
    every: float = Field(1.0, ge=0.01)
    shortest: float = Field(0.1, gt=0)
    longest: float = Field(0.5, gt=0)
    within: float = Field(0.005, ge=0)
    margin: float = Field(0.3, gt=0)

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        return HoldEpisode(self, robot)

    def rewards(self, angles: Array, poses: Array) -> Array:
        """0 to 1, (...,), for joint angles (..., n), rad or m."""
        errors = np.abs(angles - poses).max(axis=-1)
        return np.asarray(closeness(errors, self.within, self.margin))

    def arrows(self, robot: str) -> list[SmartArrow]:
        """The push."""
        return [SmartArrow(name="push", kind="force", at=f"{robot}/flange", expressed_in="world")]


class HoldEpisode(Episode):
    """`Hold` from episode to episode."""

    def __init__(self, task: Hold, robot: AgentRobot) -> None:
        self._task, self._robot = task, robot
        self._pose: Array = np.zeros(robot.declared.n)
        self._times: Array = np.zeros((0, 2))
        self._forces: Array = np.zeros((0, 3))
        self._force: Array = np.zeros(3)

    def make_many(self, m: int) -> ManyEpisodes:
        """The same of m robots at once."""
        return ManyHolds(self._task, self, m)

    @property
    def pose(self) -> Array:
        """What is to be held, (n,), rad or m."""
        return self._pose

    @property
    def pushes(self) -> tuple[Array, Array]:
        """When they begin and end, (k, 2), s, and their forces, (k, 3), N."""
        return self._times, self._forces

    def begin(self, rng: np.random.Generator) -> None:
        """Draws all pushes of the episode."""
        task, robot = self._task, self._robot
        self._pose = robot.angles.copy()
        duration = robot.simulation.scenario.run.duration
        many = rng.poisson(duration / task.every)
        begins = rng.uniform(0.0, duration, many)
        lasting = rng.uniform(task.shortest, max(task.longest, task.shortest), many)
        self._times = np.stack([begins, begins + lasting], axis=1)
        directions = rng.standard_normal((many, 3))
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        self._forces = directions * rng.uniform(0.0, task.most_force, (many, 1))
        self._force = np.zeros(3)
        self._push = robot.plant.push(f"{robot.name}/flange")

    def advance(self) -> None:
        """Pushes as hard as it is time for."""
        now = self._robot.plant.time
        acting = (self._times[:, 0] <= now) & (now < self._times[:, 1])
        self._force = self._forces[acting].sum(axis=0)
        self._push.force[:] = self._force

    def reward(self) -> float:
        """0 to 1, for the state now."""
        return float(self._task.rewards(self._robot.angles, self._pose))

    def observation(self) -> dict[str, Array]:
        """The pose to be held, (n,)."""
        return {"hold_angles": self._pose.copy()}

    def observation_spec(self) -> dict[str, specs.Array]:
        """Shapes and bounds of that."""
        return {"hold_angles": specs.Array(self._pose.shape, np.float64, name="hold_angles")}

    def inputs(self) -> dict[str, Array]:
        """A double in the pose, and the push, (3,), N."""
        return {f"{self._robot.name}_{GOAL}.joint_angles": self._pose, "push.vector": self._force}


class ManyHolds(ManyEpisodes):
    """`HoldEpisode` of m robots at once."""

    pushes = True

    def __init__(self, task: Hold, one: HoldEpisode, m: int) -> None:
        self._task, self._one = task, one
        self._poses: Array = np.tile(one.pose, (m, 1))
        # Robots have as many pushes as the one that has most; those of others last no time.
        self._times: Array = np.zeros((m, 0, 2))
        self._forces: Array = np.zeros((m, 0, 3))

    def begin(self, k: int) -> None:
        """Begins an episode of robot k."""
        times, forces = self._one.pushes
        more = len(times) - self._times.shape[1]
        if more > 0:
            self._times = np.pad(self._times, ((0, 0), (0, more), (0, 0)))
            self._forces = np.pad(self._forces, ((0, 0), (0, more), (0, 0)))
        self._poses[k], self._times[k] = self._one.pose, 0.0
        self._times[k, : len(times)], self._forces[k, : len(times)] = times, forces

    def forces(self, times: Array) -> Array:
        """What pushes the flanges in the next control step, (m, 3), N."""
        now = times[:, None]
        acting = (self._times[..., 0] <= now) & (now < self._times[..., 1])
        return np.asarray((self._forces * acting[..., None]).sum(axis=1))

    def rewards(self, now: ManyStates) -> Array:
        """0 to 1, (m,)."""
        return self._task.rewards(now.angles, self._poses)

    def observations(self, now: ManyStates) -> dict[str, Array]:
        """The poses to be held, (m, n)."""
        return {"hold_angles": self._poses.copy()}


class Expectations(Task):
    """Keeps the measures of a scenario within the bounds that it expects.

    The reward is the mean over what is expected of a measure at this time: 1 while it is within
    its bounds, `below / value` or `value / above` beyond them, and 1 where nothing is expected.
    Expectations of findings, of `rms` and of `mean`, and a `max` that is to be above or a `min`
    that is to be below once, are judged at the end alone, by the simulation's `outcomes`.
    """

    observed: ClassVar[tuple[str, ...]] = (
        "joint_angles", "joint_velocities", "torques", "external_torques", "target_angles",
        "target_velocities",
    )  # fmt: skip

    def make(self, robot: AgentRobot) -> Episode:
        """The task for a robot, to be begun."""
        return ExpectationsEpisode(robot)


class ExpectationsEpisode(Episode):
    """`Expectations` from episode to episode."""

    def __init__(self, robot: AgentRobot) -> None:
        self._robot = robot
        self._expected = [
            each
            for each in robot.simulation.scenario.expect.values()
            if each.measure is not None and each.of in ("max", "min", "final")
        ]

    def reward(self) -> float:
        """0 to 1, for the state now."""
        simulation = self._robot.simulation
        now = simulation.time
        active = [
            each
            for each in self._expected
            if each.after - 1e-9 <= now <= (np.inf if each.before is None else each.before) + 1e-9
        ]
        if not active:
            return 1.0
        log = RunLog.from_rows(  # the first row is what drift counts from
            simulation.layout, simulation.rows[[0, simulation.step]], simulation.robots
        )
        return float(np.mean([each.share(log) for each in active]))
