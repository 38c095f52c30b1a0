"""`Toggles`: which features are shown, per robot and per joint."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..assemble.world import World

Bools = NDArray[np.bool_]


class Toggles:
    """Which features are shown; a scene declares them, a user changes them.

    Attributes:
        arrows: for every joint of the world, (N,).
        arrow_quantity: what its arrow shows, index in `ARROW_QUANTITIES`, (N,).
        billboards: for every joint, (N,).
        details: whether a joint's billboard has the precise numbers of its arrow, (N,).
        frame_names: whether a frame's name is shown, (M,).
        axes: for every frame of the world, (M,).
        legend: whether it is written what arrows show.
        status: whether faults of the sources are written into the picture.
    """

    def __init__(self, world: World) -> None:
        robots = [part.robot for part in world.robots.values()]

        def per_joint(field: str) -> Bools:
            shown = np.array([getattr(robot, field) for robot in robots], bool)
            return shown[world.joints.robot] if len(robots) else np.zeros(0, bool)

        self.arrows = per_joint("show_arrows")
        self.arrow_quantity = world.joints.arrow_quantity.copy()
        self.billboards = per_joint("show_billboards")
        self.details = np.zeros(len(self.arrows), bool)
        self.frame_names = np.zeros(len(world.frames.names), bool)
        shown = np.array([*(robot.show_axes for robot in robots), True])  # -1: always shown
        self.axes = shown[world.frames.robot]
        self.legend = True
        self.status = True
