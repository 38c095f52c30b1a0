"""`BatchSetup`: what the runs of a batch share: plant, drives, whole bodies, models and targets."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from ..base.errors import DeclarationError
from ..base.frames import Array
from ..robots.declared.robot import SerialRobot
from ..robots.declared.scene import Scene
from .control.compiler import Compiler
from .control.plan import Plan
from .control.robot_model import RobotModel
from .control.robot_models import RobotModels
from .control.whole_body import WholeBody
from .drives import Drives
from .event_schedule import CarriedObjects
from .plant import PlantRows
from .scenario import Scenario


class BatchSetup:
    """What runs that are simulated together share.

    Args:
        scenarios: of the runs, with one `batch_key`.

    Attributes:
        robots: by name, as they are simulated: with elastic joints where the runs ask for them.
        plant: the simulated robots, a row for every run.
        drives: between controllers and motors; None where that is only a wire.
        whole_bodies: of every row, what the controllers of mounted robots know of each other; empty
            where none is mounted.
        start: (n,), joint angles at first, rad or m.
        drive: (m, 2, n), torques, Nm or N: commanded, and asked for before the limits.
        gains: (m, n), factors of the commanded torques, after the limits: those of faulty drives.
        carried: objects that robots of any run carry.
        plans: targets of its runs, by robot and all that they depend on.
        has_changed: whether a controller has been replaced since the last step.
    """

    def __init__(
        self,
        scenarios: Sequence[Scenario],
        seeds: Sequence[int],
        compiler: Compiler,
    ) -> None:
        self._scenarios, scenario = scenarios, scenarios[0]
        self.compiler = compiler
        run = self._run = scenario.run
        elastic = {} if run.elastic is None else {"elastic_joints": run.elastic}
        self.robots = {
            name: robot.model_copy(update=elastic) for name, robot in scenario.scene.robots.items()
        }
        sensors = [one.make_sensors(seed) for one, seed in zip(scenarios, seeds, strict=True)]
        world = compiler.world(_stripped(scenario, self.robots), run.gravity)
        self.start: Array = np.concatenate([robot.home for robot in self.robots.values()])
        world.model.opt.timestep = run.timestep / run.substeps
        self.plant = PlantRows(world, sensors)
        m = len(scenarios)
        for row in range(m):
            self.plant.reset(row)
        self.plant.joints.looks_ahead = False  # controllers have models of their own
        self.drives: Drives | None = None
        if run.torque_control or run.substeps > 1 or run.drive_delay or scenario.amplifies:
            with located_in(scenario.scene):
                self.drives = Drives(self.plant, self.robots, run)
        self.whole_bodies = [WholeBody(world) for _ in range(m) if WholeBody.is_needed(world)]
        self.drive: Array = np.zeros((m, 2, self.plant.n))
        self.gains: Array = np.ones((m, self.plant.n))
        self.carried = CarriedObjects(self.plant)
        self.plans: dict[object, Plan] = {}
        self.has_changed = False

    def robot_model(self, robot: SerialRobot) -> RobotModel:
        """Returns a new model of a robot alone; a torque loop changes what its motors feel like."""
        if self.drives is not None and robot.name in self.drives.gains:
            robot = self.drives.gains[robot.name].felt(robot)
        return self.compiler.robot_model(robot, self._run.gravity)

    def models(self, robots: Sequence[SerialRobot], rows: Sequence[int]) -> RobotModels:
        """The models of robots in some rows; they follow what carries them."""
        mountings = [
            (self.whole_bodies[row].mounting(robot.name), robot.base_frame)
            for row in rows
            if self.whole_bodies
            for robot in robots
        ]
        return RobotModels([self.robot_model(robot) for robot in robots], len(rows), mountings)


@contextmanager
def located_in(scene: Scene) -> Iterator[None]:
    """Adds the scene's file and lines to the problems of a `DeclarationError` in its context."""
    try:
        yield
    except DeclarationError as error:
        raise DeclarationError(scene.located(error.problems)) from None


def _stripped(scenario: Scenario, robots: dict[str, SerialRobot]) -> Scene:
    """The scene without doubles, arrows and cameras, which would cost time in every step.

    What is carried is a mass of the flange, and nothing to run into.
    """
    scene = scenario.scene
    return Scene(
        robots=list(robots.values()),
        # Links of a group's robots that stand together do not collide.
        groups=[group.without_defaults() for group in scene.groups.values()],
        objects=scenario.obstacles,
        floor=scene.floor,
        name=scene.name,
        file=scene.file,
    )
