"""`Simulation`: runs a scenario step by step, with a log of everything."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TypeVar

import numpy as np

from ..base.errors import DeclarationError, Problem, SimulationError, collect
from ..base.frames import Array, frame, rotation_from_quat
from ..data.receive.structure import Structure
from ..robots.assemble.joint_speeds import joint_speeds
from ..robots.assemble.mounts import base_frames, unmounted
from ..robots.assemble.robot import SerialRobot
from ..robots.assemble.scene import Scene
from .control.compiler import Compiler
from .control.controller import ControllerDeclaration
from .control.plan import Plan, make_plan
from .control.robot_model import RobotModel
from .control.whole_body import WholeBody
from .controlled_robot import ControlledRobot
from .drag_force import DragForce
from .drives import Drives
from .event_schedule import EventSchedule
from .expect import Outcome
from .external_loads import Contacts
from .live_control import LiveControl, LiveRobot
from .plant import Plant
from .runs.monitor import Finding
from .runs.run_log import ACTUAL, DRIVEN, ESTIMATED, MEASURED, TARGETS, RunLayout, RunLog, event_of
from .scenario import Scenario

T = TypeVar("T")

# s; half of the observer's time constant at its default gain, at a tenth of the cost of every step.
OBSERVED_EVERY = 0.01
MAX_BYTES = 2 * 2**30  # of a log; longer runs need a longer timestep


class Simulation:
    """Runs a scenario.

    Args:
        scenario: what to run.
        seed: of the noise; the scenario's when None.
        compiler: that remembers what it has compiled, for those who run many; a new one when None.
        by_hand: whether robots can be pulled by hand while it runs.
        is_live: whether targets and controllers are changed while it runs, see `LiveControl`.

    Attributes:
        scenario: as given.
        compiler: as given.
        robots: by name, as they are simulated: with elastic joints where the run asks for them.
        plant: the simulated robots.
        layout: of the log's rows.
        rows: (steps + 1, width), the log; rows behind `step` hold targets only.
        times: (steps + 1,), of the rows, s.
        step: how many steps have been made.
        whole_body: what the controllers of mounted robots know of each other; None where none is.
        hand: pulls them by hand; None without.
        live: changes targets and controllers; None without.

    Raises:
        DeclarationError: what only shows when robots are compiled and targets computed: unstable
            gains, unreachable targets, limits of zero.
    """

    def __init__(
        self,
        scenario: Scenario,
        seed: int | None = None,
        compiler: Compiler | None = None,
        *,
        by_hand: bool = False,
        is_live: bool = False,
    ) -> None:
        run, scene = scenario.run, scenario.scene
        self.compiler = compiler or Compiler()
        self.scenario = scenario
        _check_size(scenario)
        elastic = {} if run.elastic is None else {"elastic_joints": run.elastic}
        self.robots = {
            name: robot.model_copy(update=elastic) for name, robot in scene.robots.items()
        }
        sensors = scenario.make_sensors(run.seed if seed is None else seed)
        # Doubles, arrows and cameras take no part, and would cost time in every step. What is
        # carried is a mass of the flange, and nothing to run into.
        stripped = Scene(
            robots=list(self.robots.values()),
            # Links of a group's robots that stand together do not collide.
            groups=[group.without_defaults() for group in scene.groups.values()],
            objects=scenario.obstacles,
            floor=scene.floor,
            name=scene.name,
            file=scene.file,
        )
        timestep = run.timestep / run.substeps
        self.plant = Plant(self.compiler.world(stripped, run.gravity), sensors, timestep)
        self.plant.joints.looks_ahead = False  # controllers have models of their own
        self.whole_body = (
            WholeBody(self.plant.world) if WholeBody.is_needed(self.plant.world) else None
        )
        every = min(OBSERVED_EVERY, 0.5 / run.observer_gain)
        self._observed_every = max(round(every / run.timestep), 1)
        self.drives: Drives | None = None
        if run.torque_control or run.substeps > 1 or run.drive_delay or scenario.amplifies:
            with _located_in(scenario.scene):
                self.drives = Drives(self.plant, self.robots, run)
        self._limit_speeds()
        self.drag_force = DragForce(self.plant, scenario) if by_hand else None
        self.live = LiveControl() if is_live else None
        self._contacts = None
        if scenario.has_surroundings:
            self._contacts = Contacts(self.plant.world, self.plant.data)
        parts = self.plant.world.robots
        bases = {name: part.free for name, part in parts.items() if len(part.free)}
        self._free = {event_of(name, "base_frame"): free for name, free in bases.items()}
        objects = self.plant.world.free_objects
        self._free |= {event_of(name, "frame"): free for name, free in objects.items()}
        start = np.concatenate([robot.home for robot in self.robots.values()])
        self._begin(start)
        self._check_gains(start)

    def __reduce__(
        self,
    ) -> tuple[Callable[..., Simulation], tuple[Scenario, Array, int, bool, bool]]:
        """Pickles what is run, so that it runs anew, to the same log, where it is unpickled."""
        seed, by_hand = self.plant.sensors.seed, self.drag_force is not None
        return _begun_again, (self.scenario, self._start, seed, by_hand, self.live is not None)

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Begins anew with other joint angles and noise; what was changed about the plant stays.

        Args:
            joint_angles: (n,), of all robots together, rad or m.
            seed: of the noise.
        """
        self.plant.sensors.seed = seed
        self.plant.reset(joint_angles)
        if self.drives is not None:
            self.drives.reset()
        self._begin(joint_angles)

    def _limit_speeds(self) -> None:
        """Finds at which speeds a joint has run away."""
        limits = [joint_speeds(robot, "runaway") for robot in self.robots.values()]
        share = self.scenario.run.runaway_speed
        self._fastest: Array = np.concatenate(limits) * (share or np.inf)
        # While all speeds together, squared, are below this none can be above its own limit.
        self._surely_slow = float(self._fastest.min()) ** 2
        self._motor_speeds = self.plant.motor_velocities if self.plant.joints.elastic else None

    def _stop_runaway(self, k: int) -> None:
        """Ends the run if a joint, or the motor of an elastic one, has run away in row k."""
        speeds = np.abs(self._actual[k, 1])
        if self._motor_speeds is not None:
            speeds = np.maximum(speeds, np.abs(self._motor_speeds))
        if not (speeds > self._fastest).any():
            return
        joints = [(robot, j) for robot in self.robots.values() for j in range(robot.n)]
        row = int(np.argmax(speeds / self._fastest))
        robot, joint = joints[row]
        share, kind = self.scenario.run.runaway_speed, robot.types[joint]
        unit = "rad/s" if kind == "revolute" else "m/s"
        limit = f"{self._fastest[row] / share:.4g} {unit}"
        named = f"its velocity limit, {limit}"
        if robot.velocity_limits is None:
            named = f"{limit}, which stands for a velocity limit where none is declared"
        reason = (
            f"found {speeds[row]:.4g} {unit}, more than {share:g} times {named}: it runs away; "
            "expected other gains or torques, or another run.runaway_speed (0 for none)"
        )
        raise SimulationError(self.time, f"{robot.name}/{robot.names[joint]}", reason)

    def _check_gains(self, start: Array) -> None:
        """Refuses gains, of controllers and of the torque loop, that the time steps cannot hold."""
        robots = dict(zip(self.robots, self._robots, strict=True))
        self._of_robots(
            "controllers", lambda name: robots[name].controller.check(start[robots[name].joints])
        )
        if self.drives is not None and self.drives.loop is not None:
            with _located_in(self.scenario.scene):
                for name, robot in robots.items():
                    self.drives.check(
                        name,
                        *robot.linearised(self.robot_model, start[robot.joints]),
                        has_springs=robot.has_springs,
                    )

    def _begin(self, start: Array) -> None:
        """Makes a new log, and controllers that remember nothing, for a plant that is at rest."""
        self.step, self._start = 0, start
        run = self.scenario.run
        times = np.arange(run.steps + 1, dtype=np.float64) * run.timestep
        parts, targets = self.plant.world.robots, self.scenario.targets
        angles = {name: start[part.joints] for name, part in parts.items()}
        bases = base_frames(self.robots, angles)
        standing = {name: unmounted(robot, bases[name]) for name, robot in self.robots.items()}
        if self.whole_body is not None:
            self.whole_body.update(start, self.plant.data)

        def plan(name: str) -> Plan:
            controller = self.scenario.controller_of(name)
            robot, target = standing[name], targets.get(name)
            if self.live is not None:  # what is planned is replaced, but has its place in the log
                return make_plan(robot, None, times[:1], self.compiler, angles[name])
            return make_plan(
                robot,
                target,
                times,
                self.compiler,
                angles[name],
                needs_target=getattr(controller, "needs_target", True),
                needs_pose=getattr(controller, "needs_pose", False),
            )

        plans = self._of_robots("targets", plan)
        self._schedule = EventSchedule(self.scenario, self.plant, run.steps)
        self.layout = self._make_layout(plans)
        self.rows: Array = np.zeros((len(times), self.layout.width))
        self.times = self.rows[:, 0] = times
        self._fill_targets(plans)
        self._schedule.fill(self.layout.columns, self.rows)
        if self.drag_force is not None:
            self.drag_force.begin(self.layout.columns, self.rows)
        self._drive: Array = np.zeros((2, self.plant.n))  # torques: commanded, and asked for
        every = self._observed_every
        self._robots = list(
            self._of_robots(
                "controllers",
                lambda name: ControlledRobot(
                    standing[name],
                    self.scenario,
                    self.plant,
                    self.drives,
                    self.robot_model,
                    plans[name],
                    self._drive,
                    every,
                ),
            ).values()
        )
        # Views of the log, (T, signals, n): those of all robots lie in a row.
        self._measured, self._actual, self._driven = (
            self.rows[:, self.layout.block(signals)].reshape(len(times), len(signals), -1)
            for signals in (MEASURED, ACTUAL, DRIVEN)
        )
        self._estimated = self.rows[:, self.layout.block(ESTIMATED)]
        self._measured[0], self._actual[0] = self.plant.measured, self.plant.actual
        self._driven[0, 0] = self.plant.actual[2]  # what holds it at rest
        self._write_free(0)
        if self.live is not None:
            self.live.begin({robot.robot.name: self._live_robot(robot) for robot in self._robots})

    def _live_robot(self, controlled: ControlledRobot) -> LiveRobot:
        """What targets and controllers of a robot are changed by."""
        robot, columns = controlled.robot, self.layout.columns
        keys = (*TARGETS, "target_pose")
        return LiveRobot(
            robot=robot,
            model=self.robot_model(robot),
            timestep=self.scenario.run.timestep,
            target=controlled.target,
            measured=self.plant.measured[0, controlled.joints],
            speeds=self.plant.measured[1, controlled.joints],
            written=[self.rows[:, columns[event_of(robot.name, key)]] for key in keys],
            use=partial(self.use_controller, robot.name),
        )

    def _of_robots(self, section: str, make: Callable[[str], T]) -> dict[str, T]:
        """What is made for every robot, by name; tells all that is wrong in a section at once."""
        made: dict[str, T] = {}
        problems: list[Problem] = []
        for name in self.robots:
            with collect(problems, f"{section}.{name}"):
                made[name] = make(name)
        if problems:
            raise DeclarationError(self.scenario.scene.located(problems))
        return made

    def robot_model(self, robot: SerialRobot) -> RobotModel:
        """Returns a new model of a robot for its controller, which knows what the robot carries.

        Behind a torque loop the motors are what they feel like.

        Args:
            robot: as it stands in the world at first.
        """
        if self.drives is not None and robot.name in self.drives.gains:
            robot = self.drives.gains[robot.name].felt(robot)
        model = self.compiler.robot_model(robot, self.scenario.run.gravity)
        if self.whole_body is not None:
            model.follow(self.whole_body.mounting(robot.name), robot.base_frame)
        return model

    def _make_layout(self, plans: dict[str, Plan]) -> RunLayout:
        events = self._schedule.log_events()
        if self._contacts is not None:
            events |= {event_of(name, "contact_force"): "1V" for name in plans}
        events |= dict.fromkeys(self._free, "1M")
        if self.drag_force is not None:
            events |= self.drag_force.log_events()
        for name, plan in plans.items():
            if plan.flange is not None:
                events[event_of(name, "target_pose")] = "1M"
        targets = tuple(name for name, plan in plans.items() if plan.joints is not None)
        joints = {name: robot.n for name, robot in self.robots.items()}
        return RunLayout(joints, targets, events)

    def _fill_targets(self, plans: dict[str, Plan]) -> None:
        columns = self.layout.columns
        for name, plan in plans.items():
            if plan.joints is not None:
                self.rows[:, columns[event_of(name, "target_angles")]] = plan.joints.angles
                self.rows[:, columns[event_of(name, "target_velocities")]] = plan.joints.velocities
            if plan.flange is not None:
                poses = plan.flange.poses.reshape(-1, 16)
                self.rows[:, columns[event_of(name, "target_pose")]] = poses

    @property
    def about(self) -> str:
        """What it is, for people."""
        return f"simulation of {self.scenario.name}"

    @property
    def structure(self) -> Structure:
        """Of a row of the log as a packet."""
        return self.layout.structure

    @property
    def steps(self) -> int:
        """How many steps the run has."""
        return len(self.rows) - 1

    @property
    def time(self) -> float:
        """Until when it has been simulated, s."""
        return float(self.rows[self.step, 0])

    @property
    def is_done(self) -> bool:
        """Whether the run is over."""
        return self.step >= self.steps

    def run(self, chunk: int = 1000) -> Iterator[tuple[int, int]]:
        """Runs to the end, and tells after every so many steps which rows are new.

        Raises:
            SimulationError: it cannot go on; names the joint and the time. What came before is in
                the log.
        """
        first = 0 if self.step == 0 else self.step + 1
        while not self.is_done:
            try:
                self.advance(min(self.step + chunk, self.steps))
            finally:
                if self.step >= first:
                    yield first, self.step + 1
            first = self.step + 1

    def advance(self, to_step: int) -> None:
        """Simulates until a step.

        In every step, in this order: disturbances and faults that begin or end; each robot's
        controller, from what its sensors read, then its torque limits; the drives, with gains of
        faulty controllers, joint torque control and the motors' limits; the plant, once or several
        times, with pushes, physics and sensors; the log. The observer takes several steps at once.

        Raises:
            SimulationError: it cannot go on, and the log ends with the step before; or a joint has
                run away, and the log ends there.
        """
        first, stop = self.step + 1, min(to_step, self.steps) + 1
        try:
            self._make_steps(stop)
        finally:
            written = self._driven[first : self.step + 1]
            written[:, 1] = written[:, 0] != written[:, 1]  # saturated, or not

    def _make_steps(self, stop: int) -> None:
        """Makes the steps up to the row before `stop`."""
        schedule, plant, contacts = self._schedule, self.plant, self._contacts
        whole_body, free = self.whole_body, self._free
        acting = [each for each in (schedule, self.drag_force) if each is not None]
        before = [each.before for each in (*acting, self.live) if each is not None]
        after = [each.after for each in acting]
        measured, actual, driven = self._measured, self._actual, self._driven
        (commanded, _), every = self._drive, self._observed_every
        slow, motor_speeds = self._surely_slow, self._motor_speeds
        move = plant.step if self.drives is None else self.drives.step
        first = self.step + 1
        times = self.rows[first - 1 : stop - 1, 0].tolist()
        for k, time in zip(range(first, stop), times, strict=True):
            for act in before:
                act(k - 1)
            if whole_body is not None:
                whole_body.update(measured[k - 1, 0], plant.data)
            for robot in self._robots:
                robot.command(k - 1, time)
            move(commanded * schedule.gains)
            measured[k], actual[k], driven[k] = plant.measured, plant.actual, self._drive
            if free:
                self._write_free(k)
            if contacts is not None and plant.data.ncon:
                self._write_contacts(k, contacts.update())
            for act in after:
                act(k)
            if k % every == 0:
                self._observe(k)
            self.step = k
            speeds = actual[k, 1]
            if speeds.dot(speeds) > slow or (
                motor_speeds is not None and motor_speeds.dot(motor_speeds) > slow
            ):
                self._stop_runaway(k)

    def _observe(self, k: int) -> None:
        """Estimates the external torques of row k and those after it."""
        every, measured = self._observed_every, self._measured
        if self.whole_body is not None:
            self.whole_body.update(measured[k, 0], self.plant.data)
        for robot in self._robots:
            estimate = robot.observe(measured[k - every + 1 : k + 1])
            self._estimated[k : k + every, robot.joints] = estimate

    def drop_oldest(self, keep: int) -> int:
        """Forgets all rows of the log but the last ones, so that as many can be simulated anew.

        Args:
            keep: how many rows, at least; a few more are kept.

        Returns:
            how many were forgotten.
        """
        dropped = max(self.step + 1 - keep, 0) // self._observed_every * self._observed_every
        if not dropped:
            return 0
        kept, timestep = self.step + 1 - dropped, self.scenario.run.timestep
        self.rows[:kept] = self.rows[dropped : self.step + 1]
        self.rows[kept:] = self.rows[kept - 1]
        self.times = self.times + dropped * timestep
        self.rows[:, 0] = self.times
        self.step -= dropped
        if self.drag_force is not None:
            self.drag_force.drop_oldest(dropped, kept)
        return dropped

    def use_controller(self, robot: str, controller: ControllerDeclaration) -> None:
        """Changes the controller of a robot from the next step on.

        Args:
            robot: its name.
            controller: the new one.

        Raises:
            DeclarationError: gains that do not fit the robot, or that the step cannot hold where it
                is; the controller is what it was then.
        """
        controlled = self._robots[list(self.robots).index(robot)]
        angles = self._actual[self.step, 0, controlled.joints]
        before = controlled.in_use
        try:
            controlled.use(controller, self.robot_model)
            controlled.controller.check(angles)
            if self.drives is not None and self.drives.loop is not None:
                linearised = controlled.linearised(self.robot_model, angles)
                self.drives.check(robot, *linearised, has_springs=controlled.has_springs)
        except DeclarationError:
            controlled.in_use = before
            raise

    def _write_free(self, k: int) -> None:
        """Writes where free bases and objects are into row k."""
        for event, free in self._free.items():
            pose = self.plant.data.qpos[free]
            T = frame(rotation_from_quat(pose[3:]), pose[:3])
            self.rows[k, self.layout.columns[event]] = T.ravel()

    def _write_contacts(self, k: int, forces: Array) -> None:
        columns = self.layout.columns
        for name, force in zip(self.robots, forces, strict=True):
            self.rows[k, columns[event_of(name, "contact_force")]] = force

    @property
    def log(self) -> RunLog:
        """The log until now; its signals are views."""
        rows = self.rows[: self.step + 1]
        return RunLog.from_rows(self.layout, rows, self.robots, name=self.scenario.name)

    def findings(self) -> list[Finding]:
        """What the monitor finds in the log until now."""
        return self.scenario.monitor.find(self.log)

    def outcomes(self) -> list[Outcome]:
        """Whether what was expected held."""
        log, findings = self.log, self.findings()
        return [
            expect.judge(name, log, findings, self.scenario)
            for name, expect in self.scenario.expect.items()
        ]


def _begun_again(
    scenario: Scenario, start: Array, seed: int, by_hand: bool, is_live: bool
) -> Simulation:
    simulation = Simulation(scenario, seed, by_hand=by_hand, is_live=is_live)
    if not np.array_equal(start, simulation._start):
        simulation.restart(start, seed)
    return simulation


@contextmanager
def _located_in(scene: Scene) -> Iterator[None]:
    """Adds the scene's file and lines to the problems of a `DeclarationError` in its context."""
    try:
        yield
    except DeclarationError as error:
        raise DeclarationError(scene.located(error.problems)) from None


def _check_size(scenario: Scenario) -> None:
    """Refuses a run whose log would not fit into memory, before anything is computed for it."""
    joints = sum(robot.n for robot in scenario.scene.robots.values())
    signals = len((*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED))
    size = 8 * (scenario.run.steps + 1) * signals * joints
    if size > MAX_BYTES:
        found = f"found {scenario.run.steps} steps, a log of {size / 2**30:.1f} GiB"
        message = f"{found}; expected up to {MAX_BYTES / 2**30:.0f} GiB"
        raise DeclarationError(scenario.scene.located([Problem("run.duration", message)]))
