"""Draws round and straight arrows as mesh geoms.

In a `GeomBuffer`, such a geom has type `mjGEOM_MESH`, a rotation `mat`, and a `size` with the
factors that scale the mesh along its axes. `dataid` is `FIRST_SHAPE` plus the index in `shapes`.
"""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints
from .arrow_shapes import (
    BANDS,
    HEAD,
    HEAD_BARBS,
    RATIOS,
    SHAFT,
    STRAIGHT_HEAD_LENGTH,
    STRAIGHT_HEAD_WIDTH,
    nearest_ratio,
)
from .geom_buffer import FIRST_SHAPE, GeomBuffer, Kind

_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
STRIPE_RGB = (0.08, 0.08, 0.09)
DARKER = 0.4  # brightness factor of a straight arrow beyond its limit
LONGEST_HEAD = 0.5  # maximum length of a straight head, fraction of the arrow length


def draw_round(
    buffer: GeomBuffer,
    kind: Kind,
    items: Ints,
    *,
    centre: Array,
    axes: Array,
    phase: Array,
    sign: Array,
    radius: Array,
    width: Array,
    rgba: Array,
    striped: Bools,
) -> None:
    """Draws k round arrows, with one geom each and another one for stripes.

    Args:
        items: index of the item that each arrow shows, shape (k,).
        centre: centers of the arrows, shape (k, 3), m.
        axes: orientations of the arrows, which run around the z axes, shape (k, 3, 3).
        phase: angle from x to the tail of the arrow in its direction, shape (k,), rad.
        sign: direction, 1 for the right-hand rule or -1 for the opposite direction, shape (k,).
        radius: radii of the arrows, shape (k,), m.
        width: maximum widths of the tubes, shape (k,), m.
        rgba: colors, shape (k, 4).
        striped: mask of arrows that are striped because their values exceed the limit, shape (k,).
    """
    count, over = len(items), striped.nonzero()[0]
    index = np.concatenate([np.arange(count), over])
    rows = buffer.take(len(index), _MESH, kind, items[index])
    if not len(rows):
        return
    ratio = nearest_ratio(width / radius)
    turned = np.zeros((count, 3, 3))
    turned[:, 0, 0], turned[:, 0, 1] = np.cos(phase), -np.sin(phase)
    # For the negative direction, the arrow is rotated by 180 deg about x.
    turned[:, 1, 0], turned[:, 1, 1] = sign * np.sin(phase), sign * np.cos(phase)
    turned[:, 2, 2] = sign
    size = np.stack([radius, radius, width / RATIOS[ratio]], axis=1)
    rows["dataid"] = FIRST_SHAPE + np.concatenate([ratio, BANDS + ratio[over]])
    rows["pos"], rows["mat"], rows["size"] = centre[index], (axes @ turned)[index], size[index]
    rows["rgba"] = rgba[index]
    rows["rgba"][count:, :3] = STRIPE_RGB


def draw_straight(
    buffer: GeomBuffer,
    kind: Kind,
    items: Ints,
    *,
    start: Array,
    axes: Array,
    length: Array,
    width: Array,
    rgba: Array,
    over: Bools | None = None,
    emission: float | None = None,
) -> None:
    """Draws k straight arrows with two geoms each.

    Args:
        items: index of the item that each arrow shows, shape (k,).
        start: tails of the arrows, shape (k, 3), m.
        axes: orientations of the arrows, which point along the z axes, shape (k, 3, 3).
        length: lengths of the arrows, shape (k,), m.
        width: widths of the shafts at the head, shape (k,), m.
        rgba: colors, shape (k, 4).
        over: mask of the arrows that are dark because their values exceed the limit, shape (k,).
        emission: emission of the geoms (default: that of the buffer).
    """
    rows = buffer.take(2 * len(items), _MESH, kind, np.repeat(items, 2))
    if not len(rows):
        return
    head = np.minimum(STRAIGHT_HEAD_LENGTH * width, LONGEST_HEAD * length)
    grid = rows.reshape(-1, 2)
    grid["dataid"] = FIRST_SHAPE + SHAFT, FIRST_SHAPE + HEAD
    grid["mat"] = axes[:, None]
    grid["pos"] = start[:, None]
    grid["pos"][:, 1] += axes[:, :, 2] * (length - head)[:, None]
    grid["size"][:, 0] = np.stack([width, width, length - (1.0 - HEAD_BARBS) * head], axis=1)
    barbs = STRAIGHT_HEAD_WIDTH * width
    grid["size"][:, 1] = np.stack([barbs, barbs, head], axis=1)
    grid["rgba"] = rgba[:, None]
    if over is not None:
        grid["rgba"][over, :, :3] *= DARKER
    if emission is not None:
        rows["emission"] = emission
