"""Smart axes: x red, y green, z blue, at the base, every joint, the flange and named frames."""

from __future__ import annotations

import mujoco
import numpy as np

from ..assemble.world import World
from .pen import ARROW_SIZE_OF_LENGTH, Pen
from .toggles import Toggles

# Red, green, blue as is customary, in shades that differ in lightness as well.
AXIS_RGB = np.array([[0.84, 0.15, 0.16], [0.17, 0.63, 0.17], [0.12, 0.35, 0.85]], np.float32)
_RADIUS_OF_LENGTH = 0.025
# A rotation of the geom's z (along which an arrow points) onto x, y and z.
_ONTO_AXIS = np.array(
    [
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
    np.float64,
)


def draw_axes(pen: Pen, world: World, data: mujoco.MjData, toggles: Toggles) -> None:
    """Draws three arrows for every frame whose axes are shown."""
    shown = toggles.axes.nonzero()[0]
    table = world.frames
    shown = shown[table.alpha[shown] > 0]
    rows = pen.take(3 * len(shown), int(mujoco.mjtGeom.mjGEOM_ARROW))
    if not len(rows):
        return
    sites = table.site[shown]
    length = np.repeat(table.size[shown], 3)
    rotation = data.site_xmat[sites].reshape(-1, 1, 3, 3) @ _ONTO_AXIS
    rows["pos"] = np.repeat(data.site_xpos[sites], 3, axis=0)
    rows["mat"] = rotation.reshape(-1, 3, 3)
    rows["size"][:, :2] = (_RADIUS_OF_LENGTH * length)[:, None]
    rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length
    rows["rgba"][:, :3] = np.tile(AXIS_RGB, (len(shown), 1))
    rows["rgba"][:, 3] = np.repeat(table.alpha[shown], 3)
