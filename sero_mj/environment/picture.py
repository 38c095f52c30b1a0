"""Pictures of an environment, with arrows, billboards and a double at the goal."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..assemble.cartesian import SmartArrow
from ..assemble.double import Double
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..assemble.world import World
from ..drive.place import Placer
from ..show.headless.renderer import HeadlessRenderer

Array = NDArray[np.float64]
GOAL = "goal"


class Picture:
    """Shows what an environment's robot does. Nothing of it takes part in the simulation.

    Args:
        robot: its declaration: `show_arrows` and the like are what is shown.
        arrows: what else there is.

    Raises:
        DeclarationError: the robot cannot be shown.
    """

    def __init__(self, robot: SerialRobot, arrows: list[SmartArrow]) -> None:
        self._name = robot.name
        goal = f"{robot.name}_{GOAL}"
        self._goal = goal
        doubles = [Double(name=goal, of=robot.name)]
        self._world = World(Scene(robots=[robot], doubles=doubles, arrows=arrows))
        self._data = self._world.make_data()
        self._placer = Placer(self._world)
        self._renderer: HeadlessRenderer | None = None
        self._shape: tuple[int, int, str | None] = (0, 0, None)

    def render(
        self,
        height: int,
        width: int,
        camera: str | None,
        values: Mapping[str, Array],
        goal: Array,
        arrows: Mapping[str, Array],
    ) -> NDArray[np.uint8]:
        """Renders (height, width, 3).

        Args:
            height: pixels.
            width: pixels.
            camera: see `HeadlessRenderer`.
            values: of the robot's inputs: `joint_angles`, `torques`, `commanded_torques`.
            goal: (n,), where the double stands.
            arrows: (3,) each, by name.

        Raises:
            RenderError: no OpenGL, or the size is out of range.
            UnknownName: no such camera.
        """
        if self._renderer is None or self._shape != (height, width, camera):
            self.close()
            self._renderer = HeadlessRenderer(self._world, width, height, camera)
            self._shape = (height, width, camera)
        world, data = self._world, self._data
        for key, value in values.items():
            world.set_input(data, f"{self._name}.{key}", value)
        world.set_input(data, f"{self._goal}.joint_angles", goal)
        for name, vector in arrows.items():
            world.set_input(data, f"{name}.vector", vector)
        self._placer.place(data)
        return self._renderer.render(data)

    def close(self) -> None:
        """Frees what OpenGL has."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
