"""Smart axes: x red, y green, z blue, at the base, every joint, the flange and named frames."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world import World
from .pen import Kind, Pen
from .toggles import Toggles

# Red, green, blue as is customary, in shades that differ in lightness as well.
AXIS_RGB = np.array([[0.84, 0.15, 0.16], [0.17, 0.63, 0.17], [0.12, 0.35, 0.85]], np.float32)
_HALF_WIDTH_OF_LENGTH = 0.022
# A rotation of the bar's z onto x, y and z.
_ONTO_AXIS = np.array(
    [
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
    np.float64,
)


def draw_axes(pen: Pen, world: World, data: mujoco.MjData, toggles: Toggles) -> None:
    """Draws three bars for every frame whose axes are shown.

    Bars, for a box has 12 triangles and an arrow a thousand: axes would cost more than the robot.
    """
    shown = toggles.axes.nonzero()[0]
    table = world.frames
    shown = shown[table.alpha[shown] > 0]
    rows = pen.take(3 * len(shown), int(mujoco.mjtGeom.mjGEOM_BOX), Kind.AXES, np.repeat(shown, 3))
    if not len(rows):
        return
    sites = table.site[shown]
    grid = rows.reshape(-1, 3)  # three bars a frame
    length = table.size[shown][:, None]
    rotation = data.site_xmat[sites].reshape(-1, 1, 3, 3) @ _ONTO_AXIS
    grid["pos"] = data.site_xpos[sites][:, None] + rotation[..., 2] * (length / 2)[..., None]
    grid["mat"] = rotation
    grid["size"][..., :2] = (_HALF_WIDTH_OF_LENGTH * length)[..., None]
    grid["size"][..., 2] = length / 2
    grid["rgba"][..., :3] = AXIS_RGB
    grid["rgba"][..., 3] = table.alpha[shown][:, None]
