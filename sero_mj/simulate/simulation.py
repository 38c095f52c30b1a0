"""`Simulation`: runs a scenario step by step, with a log of everything."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

import numpy as np

from ..base.errors import DeclarationError, Problem, SimulationError, UsageError, collect
from ..base.frames import Array, Ints, frame, rotation_from_quat
from ..data.receive.structure import Structure
from ..robots.declared.mounts import base_frames, unmounted
from ..robots.declared.robot import SerialRobot
from .control.compiler import Compiler, fingerprint
from .control.controller import ControllerDeclaration
from .control.plan import Plan, make_plan
from .control.robot_model import RobotModel
from .control.whole_body import WholeBody
from .controlled_robot import ControlledRobot
from .drag_force import DragForce
from .event_schedule import EventSchedule
from .expect import Outcome
from .external_loads import Contacts
from .live_control import LiveControl, LiveRobot
from .plant import Plant
from .real_time import RealTimeWatch
from .run_batch import RunBatch, located_in
from .runs.measures import STEP_LATENESS
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
        controlled: the robots with their controllers, in the order of `robots`.
        step: how many steps have been made.
        observed_every: steps between two estimates of the external torques.
        error: what has ended it, of one that is simulated `together` with others; else None.
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
        _check_size(scenario)
        self.compiler = compiler or Compiler()
        seed = scenario.run.seed if seed is None else seed
        batch = RunBatch([scenario], [seed], self.compiler, raises=True)
        self._join(scenario, batch, 0)
        if by_hand:
            self.drag_force = DragForce(self.plant, scenario)
        if is_live:
            self.live = LiveControl()
        self._plan(self._batch.start)
        self._batch.begin([self])
        self._check_gains(self._start)

    drag_force: DragForce | None
    live: LiveControl | None

    def _join(self, scenario: Scenario, batch: RunBatch, row: int) -> None:
        """Takes its place in a batch."""
        self.scenario, self._batch = scenario, batch
        self.robots, self.plant, self.drives = (
            batch.robots,
            batch.plant.row(batch.plant.rows.indices[row]),
            batch.drives,
        )
        self.error: SimulationError | None = None
        self.drag_force = self.live = None
        world, run = self.plant.world, scenario.run
        self.whole_body = WholeBody(world) if WholeBody.is_needed(world) else None
        every = min(OBSERVED_EVERY, 0.5 / run.observer_gain)
        self.observed_every = max(round(every / run.timestep), 1)
        self._contacts = None
        if scenario.has_surroundings:
            self._contacts = Contacts(world, self.plant.model)
        self._free: dict[str, Callable[[Array], Array]] = {
            event_of(name, "base_frame"): part.base_pose
            for name, part in world.robots.items()
            if len(part.free)
        }
        for name, free in world.free_objects.items():
            self._free[event_of(name, "frame")] = partial(_pose_of, free)

    @classmethod
    def together(
        cls, scenarios: Sequence[Scenario], compiler: Compiler | None = None
    ) -> list[Simulation | DeclarationError]:
        """Simulations that are advanced together: one's `advance` is that of all.

        Where one cannot go on it has its `error`, and the others go on.

        Args:
            scenarios: what to run, with one `batch_key`.
            compiler: as for one.

        Returns:
            in their order; where one cannot be run, why.
        """
        compiler = compiler or Compiler()
        seeds = [each.run.seed for each in scenarios]
        batch = RunBatch(scenarios, seeds, compiler, raises=False)
        made: list[Simulation | DeclarationError] = []
        for row, scenario in enumerate(scenarios):
            one = cls.__new__(cls)
            one.compiler = compiler
            try:
                one._join(scenario, batch, row)
                one._plan(batch.start)
                one._check_gains(batch.start)
            except DeclarationError as error:
                made.append(error)
            else:
                made.append(one)
        if runs := [each for each in made if isinstance(each, Simulation)]:
            batch.begin(runs)
        return made

    def __reduce__(
        self,
    ) -> tuple[Callable[..., Simulation], tuple[Scenario, Array, int, bool, bool]]:
        """Pickles what is run, so that it runs anew, to the same log, where it is unpickled."""
        seed, by_hand = self.plant.sensors.seed, self.drag_force is not None
        return _begun_again, (self.scenario, self._start, seed, by_hand, self.live is not None)

    def restart(self, joint_angles: Array, seed: int) -> None:
        """Restarts with other joint angles and noise; changes of the plant persist.

        Args:
            joint_angles: (n,), of all robots together, rad or m.
            seed: of the noise.
        """
        plant = self._batch.plant
        assert isinstance(plant, Plant)
        plant.sensors.seed = seed
        plant.reset(joint_angles)
        self._batch.plans.clear()
        if self.drives is not None:
            self.drives.reset()
        self._plan(joint_angles)
        self._batch.begin([self])

    def _check_gains(self, start: Array) -> None:
        """Refuses gains of controllers and torque loop that are unstable at the time step."""
        robots = dict(zip(self.robots, self.controlled, strict=True))
        self._of_robots(
            "controllers", lambda name: robots[name].controller.check(start[robots[name].joints])
        )
        if self.drives is not None and self.drives.loop is not None:
            with located_in(self.scenario.scene):
                for name, robot in robots.items():
                    self.drives.check(
                        name,
                        *robot.linearised(self.robot_model, start[robot.joints]),
                        has_springs=robot.has_springs,
                    )

    def _plan(self, start: Array) -> None:
        """Computes targets and makes new controllers for a plant at rest.

        Args:
            start: (n,), of all robots together, rad or m.
        """
        self.step, self._start = 0, start
        run, parts, row = self.scenario.run, self.plant.world.robots, self.plant.index
        self.times = np.arange(run.steps + 1, dtype=np.float64) * run.timestep
        angles = {name: start[part.joints] for name, part in parts.items()}
        bases = base_frames(self.robots, angles)
        standing = {name: unmounted(robot, bases[name]) for name, robot in self.robots.items()}
        if self.whole_body is not None:
            self.whole_body.update(start, self.plant.qpos)

        def plan(name: str) -> Plan:
            controller, times = self.scenario.controller_of(name), self.times
            robot, target = standing[name], self.scenario.targets.get(name)
            if self.live is not None:  # the plan is replaced, but keeps its columns in the log
                return make_plan(robot, None, times[:1], self.compiler, angles[name])
            needs_target = getattr(controller, "needs_target", True)
            needs_pose = getattr(controller, "needs_pose", False)
            known, key = self._batch.plans, fingerprint([name, target, needs_target, needs_pose])
            if key not in known:
                known[key] = make_plan(
                    robot,
                    target,
                    times,
                    self.compiler,
                    angles[name],
                    needs_target=needs_target,
                    needs_pose=needs_pose,
                )
            return known[key]

        self._plans = self._of_robots("targets", plan)
        self._schedule = EventSchedule(
            self.scenario, self.plant, run.steps, self._batch.gains[row], self._batch.carried
        )
        self.layout = self._make_layout(self._plans)
        self.controlled = list(
            self._of_robots(
                "controllers",
                lambda name: ControlledRobot(
                    standing[name],
                    self.scenario,
                    self.plant,
                    self.drives,
                    self.robot_model,
                    self._observer_model(standing[name]),
                    self._plans[name],
                    self._batch.drive[row],
                    self.observed_every,
                ),
            ).values()
        )

    def open_log(self, rows: Array) -> None:
        """Begins to write a log.

        Args:
            rows: (T, width), zeros but for what the plant measures at first.
        """
        self.rows, columns = rows, self.layout.columns
        rows[:, 0] = self.times
        self._fill_targets(self._plans)
        self._schedule.fill(columns, rows)
        blocks = self.layout.block(MEASURED), self.layout.block(ESTIMATED)
        self._measured = rows[:, blocks[0]].reshape(len(rows), len(MEASURED), -1)
        self._estimated = rows[:, blocks[1]]
        self._write_free(0)
        self._logged = {
            robot.robot.name: [columns[event_of(robot.robot.name, key)] for key in keys]
            for robot in self.controlled
            if (keys := getattr(robot.declared, "logged", ()))
        }
        acting = (self._schedule, self.drag_force, self.live)
        self._before = [each.before for each in acting if each is not None]
        self._after = []
        if self.drag_force is not None:
            self._after.append(self.drag_force.after)
            self.drag_force.begin(columns, rows)
        if self.live is not None:
            self.live.begin(
                {robot.robot.name: self._live_robot(robot) for robot in self.controlled}
            )

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
        """Makes one object per robot, by name; reports all problems of a section together."""
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

    def _observer_model(self, robot: SerialRobot) -> RobotModel:
        """What its observer knows of a robot; runs of a batch share it, as it takes long to make.

        What mounted robots know of each other is of one run.
        """
        if self.whole_body is not None:
            return self.robot_model(robot)
        shared = self._batch.observer_models
        if robot.name not in shared:
            shared[robot.name] = self.robot_model(robot)
        return shared[robot.name]

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
            logged = getattr(self.scenario.controller_of(name), "logged", ())
            events |= {event_of(name, key): "1F" for key in logged}
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
        watch = RealTimeWatch(self.scenario.name)
        while not self.is_done:
            try:
                self.advance(min(self.step + chunk, self.steps))
            finally:
                if self.step >= first:
                    yield first, self.step + 1
            first = self.step + 1
            watch.update(self.time, self._late)
        watch.finish(self.time, self._late)

    @property
    def _late(self) -> float:
        """How late the last step began, of the robots that are controlled in real time, s."""
        events = (event_of(name, STEP_LATENESS) for name in self._logged)
        late = [self.rows[self.step, self.layout.columns[event]] for event in events
                if event in self.layout.columns]  # fmt: skip
        return max((float(each[0]) for each in late), default=0.0)

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
        try:
            self._batch.advance(min(to_step, self.steps))
        except BaseException:
            self.close()
            raise
        if self.is_done:
            self.close()

    def close(self) -> None:
        """Ends what controllers have started, programs say; it cannot be advanced any more."""
        for robot in self.controlled:
            close = getattr(robot.controller.controller, "close", None)
            if close is not None:
                close()

    @property
    def prepares(self) -> bool:
        """Whether `prepare` has to be called for every row of the log."""
        acts = self.drag_force or self.live or self.whole_body
        return acts is not None or not all(robot.is_joined for robot in self.controlled)

    @property
    def wakes(self) -> float:
        """Else the next row for which it has to be; infinite for none."""
        return self._schedule.next

    @property
    def finishes(self) -> bool:
        """Whether `finish` has to be called for every row of the log."""
        return bool(self._free or self._after or self._logged)

    def prepare(self, k: int) -> None:
        """Applies controllers and events for the step after row k of the log."""
        for act in self._before:
            act(k)
        if self.whole_body is not None:
            self.whole_body.update(self._measured[k, 0], self.plant.qpos)
        for robot in self.controlled:
            if not robot.is_joined:
                robot.command(k, float(self.times[k]))

    def finish(self, k: int) -> None:
        """Writes row k of the log, except for the columns that have methods of their own.

        Args:
            k: the row, in which measured, actual and driven torques are.
        """
        if self._free:
            self._write_free(k)
        for act in self._after:
            act(k)
        if self._logged:
            self._write_logged(k)

    def observe(self, k: int) -> None:
        """Estimates the external torques of row k and those after it."""
        every, measured = self.observed_every, self._measured
        if self.whole_body is not None:
            self.whole_body.update(measured[k, 0], self.plant.qpos)
        for robot in self.controlled:
            estimate = robot.observe(measured[k - every + 1 : k + 1])
            self._estimated[k : k + every, robot.joints] = estimate

    def drop_oldest(self, keep: int) -> int:
        """Discards all but the last rows of the log, which makes room for new ones.

        Args:
            keep: how many rows, at least; a few more are kept.

        Returns:
            how many were forgotten.
        """
        dropped = max(self.step + 1 - keep, 0) // self.observed_every * self.observed_every
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
            UsageError: its torques are computed together with those of other runs, see `together`.
        """
        controlled = self.controlled[list(self.robots).index(robot)]
        if controlled.is_joined:
            raise UsageError(
                f"{robot} is controlled together with the same robot of other runs; expected a "
                "Simulation of its own to change its controller"
            )
        angles = self.plant.actual[0, controlled.joints]
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
        """Writes the poses of free bases and objects into row k."""
        for event, pose in self._free.items():
            self.rows[k, self.layout.columns[event]] = pose(self.plant.qpos).ravel()

    def _write_logged(self, k: int) -> None:
        """Writes what controllers have to log into row k, and targets that programs have set."""
        for robot in self.controlled:
            name, controller = robot.robot.name, robot.controller.controller
            places = self._logged.get(name, [])
            numbers = getattr(controller, "logged", ())  # of another one, live
            if len(places) == len(numbers):
                for columns, value in zip(places, numbers, strict=True):
                    self.rows[k, columns] = value
            wanted = getattr(controller, "commanded_angles", None)
            if wanted is not None and name in self.layout.targets:
                self.rows[k, self.layout.columns[event_of(name, "target_angles")]] = wanted

    def write_contacts(self, k: int) -> None:
        """Writes the forces of the contacts that there are into row k."""
        if self._contacts is None:
            return
        columns, forces = (
            self.layout.columns,
            self._contacts.update(self.plant.model, self.plant.data),
        )
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


def _pose_of(free: Ints, qpos: Array) -> Array:
    """The pose (4, 4) of a free joint with these indices in qpos."""
    at = qpos[free]
    return frame(rotation_from_quat(at[3:]), at[:3])


def _check_size(scenario: Scenario) -> None:
    """Refuses a run whose log would not fit into memory."""
    joints = sum(robot.n for robot in scenario.scene.robots.values())
    signals = len((*MEASURED, *ACTUAL, *DRIVEN, *TARGETS, *ESTIMATED))
    size = 8 * (scenario.run.steps + 1) * signals * joints
    if size > MAX_BYTES:
        found = f"found {scenario.run.steps} steps, a log of {size / 2**30:.1f} GiB"
        message = f"{found}; expected up to {MAX_BYTES / 2**30:.0f} GiB"
        raise DeclarationError(scenario.scene.located([Problem("run.duration", message)]))
