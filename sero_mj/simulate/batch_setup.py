"""`BatchSetup`: the plant, drives, models and targets that the runs of a batch share."""

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
    """Objects that the runs of a batch share.

    Attributes:
        robots: simulated robots by name, with elastic joints if the runs request them.
        plant: the simulated robots, one row per run.
        drives: drives between controllers and motors; None if commands act on the motors directly.
        whole_bodies: moving bases of mounted robots in each row; empty if no robot is mounted.
        start: initial joint angles, shape (n,), rad or m.
        drive: commanded torques after and before the limits, shape (m, 2, n), Nm or N.
        gains: factor of each commanded torque, shape (m, n); drive faults change it.
        plans: cache of computed targets.
        has_changed: whether a controller was replaced since the last step.
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
        self.plant.joints.forwards = False  # controllers have their own models
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
        """Returns a new model of a robot, with shaped motor inertias if there is a torque loop."""
        if self.drives is not None and robot.name in self.drives.gains:
            robot = self.drives.gains[robot.name].shaped(robot)
        return self.compiler.robot_model(robot, self._run.gravity)

    def models(self, robots: Sequence[SerialRobot], rows: Sequence[int]) -> RobotModels:
        """Returns models of robots in some rows. The bases of mounted robots move in the models."""
        mountings = [
            (self.whole_bodies[row].mounting(robot.name), robot.base_frame)
            for row in rows
            if self.whole_bodies
            for robot in robots
        ]
        return RobotModels([self.robot_model(robot) for robot in robots], len(rows), mountings)


@contextmanager
def located_in(scene: Scene) -> Iterator[None]:
    """Adds the scene's file and lines to a `DeclarationError` that the `with` block raises."""
    try:
        yield
    except DeclarationError as error:
        raise DeclarationError(scene.located(error.problems)) from None


def _stripped(scenario: Scenario, robots: dict[str, SerialRobot]) -> Scene:
    """Returns the scene without doubles, arrows and cameras, which would slow down every step.

    Objects that robots carry are removed, too. They only add mass to the flange.
    """
    scene = scenario.scene
    return Scene(
        robots=list(robots.values()),
        # Touching links of a group's robots do not collide.
        groups=[group.without_defaults() for group in scene.groups.values()],
        objects=scenario.obstacles,
        floor=scene.floor,
        name=scene.name,
        file=scene.file,
    )
