"""Steps many environments of a robot with a task together.

Each thread simulates a lane of robots. MuJoCo steps all robots of a lane in one call, and their
controllers are computed together. Threads synchronize once per control step. Except for rounding,
observations and rewards are those of separate environments.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Any

import numpy as np

from ...base.errors import Problem
from ...base.frames import Array, Bools
from ...robots.declared.mounts import base_frames, unmounted
from ...simulate.control.make_controller import LimitedController, make_controller
from ...simulate.control.robot_models import RobotModels
from ...simulate.control.torque_loop import StaticDeflection
from ...simulate.drives import Drives
from ...simulate.event_schedule import FaultSchedule, TimedActions
from ...simulate.plant import PlantRows
from ...simulate.robot_control import RobotControl
from ...simulate.runs.run_log import MEASURED
from .actions import checked_action
from .environment import Environment
from .tasks import ManyEpisodes, ManyStates


class ManyEnvironments:
    """A set of m environments of a robot with a task, which are stepped together.

    Args:
        environment: environment that initializes all episodes; do not use it elsewhere.
        m: number of environments.
        threads: number of threads.

    Attributes:
        lanes: robots of each thread.
        seeds: random seeds, shape (m,); by default, the seed of `environment` and the seeds that
            follow.
        episodes: numbers of the current episodes, from 0, shape (m,); -1 before the first episode.
            Episode k of a seed is the same as in `Environment`.
        is_over: whether each episode has ended, so that the next step begins another, shape (m,).
        task: task of all environments.

    Raises:
        DeclarationError: these environments can only be stepped one by one.
    """

    def __init__(self, environment: Environment, m: int, threads: int = 1) -> None:
        self.task = _task_of_many(environment, m)
        self.environment, self.m = environment, m
        self.seeds = environment.seed + np.arange(m)
        self.episodes = np.full(m, -1)
        self.is_over: Bools = np.ones(m, bool)
        self._left = np.zeros(m, np.intp)  # control steps until the end of the episode
        self._length = -(-environment.simulation.steps // environment.substeps)
        robot = environment.robot
        self._base, self._robot = environment.base_frame, robot
        ends = np.linspace(0, m, min(threads, m) + 1).round().astype(int).tolist()
        self.lanes = [Lane(environment, slice(a, b), self.task) for a, b in pairwise(ends)]
        others = len(self.lanes) - 1
        self._pool = ThreadPoolExecutor(others) if others else None
        self._observed: dict[str, Array] = {}

    def close(self) -> None:
        """Ends the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def reset(self, seeds: Any | None = None) -> dict[str, Array]:
        """Begins the next episode of all environments, or the first episode of new seeds.

        `seeds` has the shape (m,). Returns copies of the observations by name, shape (m, ...).
        """
        if seeds is not None:
            self.seeds, self.episodes = np.array(seeds), np.full(self.m, -1)
        self.is_over[:] = True
        return self.begin_next()

    def begin_next(self) -> dict[str, Array]:
        """Begins the next episode of each environment whose episode has ended.

        Returns copies of the observations of all environments by name, shape (m, ...).
        """
        self._begin(self.is_over.copy())
        self._observed = self._observe(self._states())
        return {name: value.copy() for name, value in self._observed.items()}

    def _begin(self, which: Bools) -> None:
        self.episodes[which] += 1
        for lane in self.lanes:
            for k in np.flatnonzero(which[lane.rows]).tolist():
                j = lane.rows.start + k
                self.environment.place(int(self.seeds[j]), int(self.episodes[j]))
                lane.place(k)
                self.task.begin(j)
            lane.begin(which[lane.rows])
        self._left[which] = self._length
        self.is_over[which] = False

    def step(self, actions: Any) -> tuple[dict[str, Array], Array, Bools, Bools]:
        """Simulates a control step, or begins the next episode if an episode has ended.

        `actions` has the shape (m, n). Returns copies of the observations by name, shape (m, ...),
        and three arrays of shape (m,): rewards, whether the motion has become unstable, and whether
        the episode has reached its end.

        Raises:
            ValueError: the actions have a wrong shape.
            SimulationError: an action is NaN or infinite; nothing is simulated.
        """
        environment, running = self.environment, ~self.is_over
        spec, unit, time = environment.action_spec(), environment.action.unit, self._time
        checked = checked_action(actions, spec, environment.robot, unit, float(time[0]), self.m)
        rewards: Array = np.zeros(self.m)
        unstable: Bools = np.zeros(self.m, bool)
        if running.any():
            unstable = self._simulate(checked, running, self.task.forces(time))
            self._left -= running
        if not running.all():
            self._begin(~running)
        states = self._states()
        stable = running & ~unstable
        rewards[stable] = self.task.rewards(states)[stable]
        observed = self._observe(states)
        if unstable.any():
            for name, value in observed.items():
                value[unstable] = self._observed[name][unstable]
        at_end = stable & (self._left == 0)
        self.is_over = unstable | at_end
        self._observed = observed
        return {name: value.copy() for name, value in observed.items()}, rewards, unstable, at_end

    @property
    def _time(self) -> Array:
        return np.concatenate([lane.plant.physics.bind("time") for lane in self.lanes])

    def _simulate(self, actions: Array, which: Bools, forces: Array) -> Bools:
        first, *others = self.lanes

        def simulate(lane: Lane) -> Bools:
            return lane.simulate(actions[lane.rows], which[lane.rows], forces[lane.rows])

        if self._pool is None:
            return simulate(first)
        waited = [self._pool.submit(simulate, lane) for lane in others]
        return np.concatenate([simulate(first), *(each.result() for each in waited)])

    def _states(self) -> ManyStates:
        angles, measured = (
            np.concatenate([getattr(lane.plant, key)[:, 0] for lane in self.lanes])
            for key in ("actual", "measured")
        )
        if all(lane.plant.sensors.is_perfect for lane in self.lanes):
            measured = angles
        return ManyStates(angles, measured, self._flanges_at)

    def _flanges_at(self, angles: Array) -> Array:
        return np.asarray(self._base @ self._robot.fwd_kin_base_to_flange(angles))

    def _observe(self, states: ManyStates) -> dict[str, Array]:
        environment = self.environment
        measured = np.concatenate([lane.plant.measured for lane in self.lanes])
        found = {name: measured[:, MEASURED.index(name)] for name in environment.columns}
        for name, (low, high) in environment.bounds.items():
            np.clip(found[name], low, high, out=found[name])
        commanded = [lane.action.observation() for lane in self.lanes]
        for name in commanded[0]:
            found[name] = np.concatenate([each[name] for each in commanded])
        return {**found, **self.task.observations(states)}


class Lane:
    """The robots that one thread simulates; `rows` is the range of their environments."""

    def __init__(self, environment: Environment, rows: slice, task: ManyEpisodes) -> None:
        m, n = rows.stop - rows.start, environment.robot.n
        self.rows, self._environment, self._has_pushes = rows, environment, task.pushes
        world, scenario = environment.world, environment.scenario
        sensors = [scenario.make_sensors(0) for _ in range(m)]
        self.plant = plant = PlantRows(world, sensors, is_pushed=task.pushes)
        for row in range(m):
            plant.reset(row)
        self._drives = None
        if environment.simulation.drives is not None:
            self._drives = Drives(plant, environment.simulation.robots, scenario.run)
        self._gains: Array = np.ones((m, n))  # gains of the drives, which faults change
        self._drive: Array = np.zeros((m, 2, n))
        self._faults = [TimedActions(scenario.run.timestep) for _ in range(m)]
        self._k = np.zeros(m, np.intp)  # steps since the beginning of the episode
        self.action = environment.settings.make_action(environment.robot, scenario.run.timestep)
        robot, drives, simulation = environment.robot, self._drives, environment.simulation
        standing = unmounted(robot, base_frames(simulation.robots)[robot.name])
        models = RobotModels([simulation.robot_model(standing)], m)
        declared, timestep = self.action.controller, scenario.run.timestep
        one = make_controller(
            declared, simulation.robot_model(standing), timestep, robot.torque_limits
        )
        self._control = RobotControl([standing], plant, self._drive)
        self._control.use(LimitedController.joined([one] * m, 1, models))
        if plant.joints.elastic and drives is not None and drives.loop is not None:
            stiffness, home = drives.gains[robot.name].stiffness, np.tile(robot.home, (m, 1))
            self._control.deflection = StaticDeflection(stiffness, None, models, home)
        if self._has_pushes:
            self._find_flange()

    def _find_flange(self) -> None:
        world, physics = self._environment.world, self.plant.physics
        frame = world.frames.names.index(f"{self._environment.robot.name}/flange")
        self._site = int(world.frames.site[frame])
        self._body = int(world.model.site_bodyid[self._site])
        self._points: Array = physics.bind("site_xpos")
        self._centers: Array = physics.bind("xipos")
        self._pushes: Array = physics.bind("xfrc_applied")

    def place(self, k: int) -> None:
        """Moves robot k of the lane to the start at which `Environment.place` has put its robot."""
        seed, angles = self._environment.plant.sensors.seed, self._environment.plant.actual[0]
        plant = self.plant.row(k)
        plant.sensors.seed = seed
        self.plant.reset(k, angles)
        self._k[k], self._gains[k] = 0, 1.0
        self._faults[k] = due = TimedActions(self._environment.scenario.run.timestep)
        FaultSchedule(self._environment.scenario, plant, due, self._gains[k])

    def begin(self, which: Bools) -> None:
        """Begins an episode of the robots that `which` selects, shape (m,), after `place`."""
        if not which.any():
            return
        if self._drives is not None:
            self._drives.reset(which)
        self.action.begin(self._control.target, self.plant.actual[which, 0], which)
        self._control.controller.controller.begin(which)
        if self._control.deflection is not None:
            home = np.asarray(self._environment.robot.home)
            self._control.deflection.begin(which, home, self.plant.motor_angles)

    def simulate(self, actions: Array, which: Bools, forces: Array) -> Bools:
        """Simulates a control step of selected robots; returns which robots are unstable.

        The result has the shape (m,).

        Args:
            actions: actions within the bounds, shape (m, n).
            which: selected robots, shape (m,).
            forces: external forces at the flanges in world axes, shape (m, 3), N.
        """
        plant, control, action = self.plant, self._control, self.action
        move = plant.step if self._drives is None else self._drives.step
        if self._has_pushes:
            self._begin_pushes(forces)
        action.take(actions)
        plant.physics.begin(which)
        substeps = self._environment.substeps
        is_plain = self._drives is None and plant.sensors.is_perfect
        is_plain &= not self._environment.scenario.faults
        for k in range(substeps):
            self._begin_faults(which)
            # Drives, sensors with delay and faults need the torques of every step.
            plant.joints.reads_torques = k == substeps - 1 or not is_plain
            action.advance()
            control.command(k, k * plant.timestep)
            if self._has_pushes:
                self._push()
            move(control.commanded * self._gains)
        plant.failed.clear()
        return plant.physics.unstable.copy()

    def _begin_faults(self, which: Bools) -> None:
        if self._environment.scenario.faults:
            for row in np.flatnonzero(which).tolist():
                self._faults[row].act(int(self._k[row]))
        self._k += which

    def _begin_pushes(self, forces: Array) -> None:
        # Applies all forces in one operation, because `Plant.push` for single robots would take as
        # long as the rest of a step.
        self._pushes[:, self._body, :3] = forces
        x, y, z = forces.T
        zero = np.zeros(len(forces))
        # The torque arm x force is this matrix times the arm.
        rows = [[zero, z, -y], [-z, zero, x], [y, -x, zero]]
        self._turning = np.moveaxis(np.array(rows), 2, 0).copy()

    def _push(self) -> None:
        arms = self._points[:, self._site] - self._centers[:, self._body]
        self._pushes[:, self._body, 3:] = np.matmul(self._turning, arms[..., None])[..., 0]


def _task_of_many(environment: Environment, m: int) -> ManyEpisodes:
    simulation, scenario = environment.simulation, environment.scenario
    task = environment.task.make_many(m)
    found = expected = None
    if len(simulation.robots) > 1 or simulation.whole_body is not None:
        found, expected = "several robots or a moving base", "one robot with a fixed base"
    elif scenario.disturbances or task is None:
        found, expected = "a scenario", "a robot with a task"
    elif scenario.run.runaway_speed:
        found, expected = "run.runaway_speed", "0"
    if found is not None or task is None:
        advice = "Use vectorization_mode='sync' to step these environments one by one."
        raise Problem("num_envs", f"found {found}", expected=f"{expected}. {advice}").error()
    return task
