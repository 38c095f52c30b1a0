"""Semitransparent panels with text, in pixels, in front of everything."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from .pen import ARROW_SIZE_OF_LENGTH, Pen
from .view import View

Array = NDArray[np.float64]

PANEL_RGBA = (0.09, 0.11, 0.14, 0.78)
# Depths in units of the near plane: text over panels over leaders over the scene.
_TEXT_DEPTH, _PANEL_DEPTH, _LEADER_DEPTH = 1.4, 1.5, 1.6
PADDING = 0.35  # of a line's height, on every side


def panel_sizes(text_widths: Array, lines: NDArray[np.intp] | int, view: View) -> Array:
    """Width and height (k, 2) of panels for so many lines of that width (k,), pixels."""
    line = view.font.height
    sizes = np.empty((len(text_widths), 2))
    sizes[:, 0] = text_widths + 2 * PADDING * line
    sizes[:, 1] = np.asarray(lines) * line + PADDING * line
    return sizes


def draw_panels(
    pen: Pen,
    view: View,
    centres: Array,
    sizes: Array,
    texts: list[list[bytes]],
    rgba: Array | tuple[float, ...] = PANEL_RGBA,
) -> None:
    """Draws panels with their text.

    Args:
        pen: where to.
        view: of the picture.
        centres: of the panels, (k, 2), pixels.
        sizes: of the panels, (k, 2), pixels.
        texts: the lines of every panel, top first.
        rgba: colour of the panels, (4,) or (k, 4).
    """
    if not texts:
        return
    depth = _PANEL_DEPTH * view.near
    pixel = view.pixel_size(depth)
    rows = pen.take(len(texts), int(mujoco.mjtGeom.mjGEOM_BOX))
    if not len(rows):
        return
    rows["pos"] = view.at(centres, depth)
    rows["mat"] = view.facing
    rows["size"][:, :2] = sizes * (pixel / 2)
    rows["size"][:, 2] = pixel / 10
    rows["rgba"] = rgba
    rows["emission"] = 1.0

    line = view.font.height
    counts = [len(lines) for lines in texts]
    panel = np.repeat(np.arange(len(texts)), counts)
    row = np.concatenate([np.arange(count) for count in counts])
    starts = centres[panel] + sizes[panel] * (-0.5, 0.5)
    starts[:, 0] += PADDING * line
    starts[:, 1] -= (PADDING / 2 + 1 + row) * line
    labels = pen.take(len(starts), int(mujoco.mjtGeom.mjGEOM_LABEL))
    if not len(labels):
        return
    labels["pos"] = view.at(starts, _TEXT_DEPTH * view.near)
    labels["mat"] = view.facing
    labels["size"] = pixel
    labels["rgba"] = 1.0
    labels["label"] = [text for lines in texts for text in lines]


def draw_leaders(
    pen: Pen, view: View, starts: Array, ends: Array, rgba: Array | tuple[float, ...]
) -> None:
    """Draws thin arrows in the picture plane.

    Args:
        pen: where to.
        view: of the picture.
        starts: (k, 2), pixels.
        ends: (k, 2), pixels, where the tips are.
        rgba: colour, (4,) or (k, 4).
    """
    rows = pen.take(len(starts), int(mujoco.mjtGeom.mjGEOM_ARROW))
    if not len(rows):
        return
    depth = _LEADER_DEPTH * view.near
    pixel = view.pixel_size(depth)
    along = ends - starts
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-3)
    direction = along / length[:, None]
    # z along the leader in the picture plane, y towards the eye, x = y cross z.
    z = direction[:, :1] * view.right + direction[:, 1:] * view.up
    y = np.broadcast_to(-view.forward, z.shape)
    rows["pos"] = view.at(starts, depth)
    rows["mat"][..., 0] = np.cross(y, z)
    rows["mat"][..., 1] = y
    rows["mat"][..., 2] = z
    thickness = max(view.height / 700, 1.0) * pixel
    rows["size"][:, :2] = thickness
    rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length * pixel
    rows["rgba"] = rgba
    rows["emission"] = 0.8
