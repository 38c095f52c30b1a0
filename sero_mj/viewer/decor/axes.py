"""Smart axes: coordinate axes of robot bases, joints, flanges and named frames.

The x axis is red, the y axis is green and the z axis is blue. If frames coincide, the bars of each
additional frame are shorter and thicker. All frames thus stay visible and clickable in any
orientation. A click on the axes of a frame shows its name. Source: section 2.5 of the paper.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Bools
from ...robots.assemble.world_view import WorldView
from .arrow_shapes import AXIS
from .feature import Feature, Frame
from .geom_buffer import FIRST_SHAPE, GREY, GeomBuffer, Kind
from .image_view import ImageView
from .joint_titles import frame_titles
from .panels import Panels, labels_below

# Red, green and blue in shades that also differ in lightness.
AXIS_RGB = np.array([[0.84, 0.15, 0.16], [0.17, 0.63, 0.17], [0.12, 0.35, 0.85]], np.float32)
_WIDTH_OF_LENGTH = 0.044
_STALE_SHARE = 0.75  # fraction of gray in the color of a stale frame
# Frames closer than the first distance coincide. Frames farther apart than the second distance do
# not. Between both distances, sizes change continuously, which avoids flicker when frames move
# apart.
_AT_ONE_PLACE = (0.004, 0.02)  # m
_SHORTER, _THICKER = 0.45, 0.35  # scale factors per coinciding frame
# Rotations that map the z axis of a bar to x, y and z.
ONTO_AXIS = np.array(
    [
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[1, 0, 0], [0, 0, 1], [0, -1, 0]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    ],
    np.float64,
)


class SmartAxes(Feature):
    """The visual feature that draws the coordinate axes of all frames of a world."""

    order = 80

    def draw(self, frame: Frame) -> None:
        stale = frame.is_stale(self.world.frames.names)
        draw_axes(frame.buffer, self.world, frame.data, frame.shown.axes, stale)


def ranks(positions: Array) -> Array:
    """Returns the number of earlier frames that coincide with each frame.

    Args:
        positions: origins of the frames, shape (m, 3), m.

    Returns:
        ranks, shape (m,), which vary continuously with the positions. The first of several
        coinciding frames has rank 0.
    """
    squares = np.einsum("ij,ij->i", positions, positions)
    apart = squares[:, None] + squares - 2.0 * positions @ positions.T
    distance = np.sqrt(np.maximum(apart, 0.0))
    near, far = _AT_ONE_PLACE
    shared = np.minimum(np.maximum((far - distance) / (far - near), 0.0), 1.0)
    return np.asarray(np.einsum("ij,ij->i", shared, _earlier(len(positions))))


@cache
def _earlier(m: int) -> Array:
    return np.tril(np.ones((m, m)), -1)


def draw_axes(
    buffer: GeomBuffer, world: WorldView, data: mujoco.MjData, shown: Bools, stale: Bools
) -> None:
    """Draws the coordinate axes of the selected frames of a world as three bars each.

    Both masks, `shown` and `stale`, have shape (M,). The axes of stale frames are gray.
    """
    table = world.frames
    index = (shown & (table.alpha > 0)).nonzero()[0]
    if not len(index):
        return
    sites = table.site[index]
    origins = data.site_xpos[sites]
    rank = ranks(origins)
    length = table.size[index] / (1.0 + _SHORTER * rank)
    width = _WIDTH_OF_LENGTH * table.size[index] * (1.0 + _THICKER * rank)
    rgb = AXIS_RGB
    if stale.any():
        rgb = np.repeat(AXIS_RGB[None], len(index), axis=0)
        rgb[stale[index]] += _STALE_SHARE * (np.array(GREY, np.float32) - AXIS_RGB)
    rotation = data.site_xmat[sites].reshape(-1, 3, 3)
    draw_bars(buffer, origins, rotation, (length, width), rgb, table.alpha[index], index)


def draw_bars(
    buffer: GeomBuffer,
    origins: Array,
    rotation: Array,
    size: tuple[Array, Array],
    rgb: NDArray[np.float32],
    alpha: Array,
    items: NDArray[np.intp] | None = None,
) -> None:
    """Draws the coordinate axes of k frames as three bars each.

    Args:
        origins: origins of the frames, shape (k, 3), m.
        rotation: orientations of the frames, shape (k, 3, 3).
        size: lengths and widths of the bars, shape (k,) each, m.
        rgb: colors of the three bars, shape (3, 3) or (k, 3, 3).
        alpha: opacities of the axes, shape (k,).
        items: indices of the frames in `FrameTable`, shape (k,). If None, users cannot click the
            axes.
    """
    kind = Kind.NONE if items is None else Kind.AXES
    owners = 0 if items is None else np.repeat(items, 3)
    rows = buffer.take(3 * len(origins), int(mujoco.mjtGeom.mjGEOM_MESH), kind, owners)
    if not len(rows):
        return
    grid = rows.reshape(-1, 3)  # three bars per frame
    length, width = size[0][:, None], size[1][:, None]
    grid["dataid"] = FIRST_SHAPE + AXIS
    grid["pos"] = origins[:, None]
    grid["mat"] = rotation[:, None] @ ONTO_AXIS
    grid["size"][..., :2] = width[..., None]
    grid["size"][..., 2] = length
    grid["rgba"][..., :3] = rgb
    grid["rgba"][..., 3] = alpha[:, None]


class FrameNames(Feature):
    """The visual feature that shows the names of selected frames."""

    order = 60

    def lay_out(self, frame: Frame) -> None:
        panels = name_panels(self.world, frame.data, frame.shown.frame_names, frame.view)
        if panels is not None:
            frame.panels.append(panels)


def name_panels(
    world: WorldView, data: mujoco.MjData, named: Bools, view: ImageView
) -> Panels | None:
    """Returns name labels of the frames in the mask `named`, or None if no label is visible."""
    shown = named.nonzero()[0]
    if not len(shown):
        return None
    titles = frame_titles(tuple(world.frames.names))
    found = labels_below(data.site_xpos[world.frames.site[shown]], [titles[i] for i in shown], view)
    if found is None:
        return None
    panels, visible = found
    return replace(panels, kind=Kind.NAME, items=shown[visible])
