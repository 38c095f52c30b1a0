"""Cards: panels beside the robots, with a leader line to the item they describe."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .layout import columns
from .panels import PANEL_RGBA, Panels, draw_leaders
from .pen import Kind, Pen
from .picture_view import PictureView

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

# Dark on a light scene, light on a dark one.
LEADER_RGBA = {"light": (0.09, 0.11, 0.14, 0.9), "dark": (0.62, 0.67, 0.73, 0.9)}


@dataclass(frozen=True, eq=False)
class Cards:
    """Cards of one kind, before layout.

    Attributes:
        kind: kind of the items they describe.
        items: indices of these items, (k,).
        anchors: pixels that their leaders point at, (k, 2).
        sizes: width and height, (k, 2), pixels.
        texts: the lines of every card, top first.
        side: `layout.LEFT` or `RIGHT`, (k,).
        rank: vertical order, lowest first, (k,).
        clear: minimum horizontal distance of their columns from the anchors, pixels.
        rgba: (k, 4), or one for all.
    """

    kind: Kind
    items: Ints
    anchors: Array
    sizes: Array
    texts: list[list[bytes]]
    side: Ints
    rank: Ints
    clear: float
    rgba: tuple[float, float, float, float] | Array = PANEL_RGBA


def lay_out(
    pen: Pen,
    view: PictureView,
    groups: list[Cards],
    points: Array,
    corners: list[Panels],
    leader_rgba: tuple[float, float, float, float] = LEADER_RGBA["light"],
) -> list[Panels]:
    """Places every card, draws the leaders and returns the panels for `draw_panels`.

    Args:
        pen: where to.
        view: of the picture.
        groups: cards of every kind.
        points: of the robots and doubles that are shown, (m, 3), m; cards are placed beside them.
        corners: panels in the corners of the picture, which cards must not cover.
        leader_rgba: of the leaders.
    """
    groups = [group for group in groups if group.texts]
    if not groups:
        return []
    anchors = np.concatenate([group.anchors for group in groups])
    sizes = np.concatenate([group.sizes for group in groups])
    side = np.concatenate([group.side for group in groups])
    order = np.argsort(np.concatenate([group.rank for group in groups]), kind="stable")
    gap = view.font.height * 0.3
    low, high = view.free
    width, height = high - low
    beside = min(max(3 * gap, *(group.clear for group in groups)), width / 6)
    centres = np.empty((len(anchors), 2))
    kept_free = np.array(
        [np.concatenate([low, high]) for low, high in map(_bounds, corners)]
    ).reshape(-1, 4)
    centres[order] = columns(
        anchors[order] - low, sizes[order], side[order], gap, beside, width, height,
        span=_span(view, points, anchors), kept_free=kept_free - [*low, *low],
    )  # fmt: skip
    centres += low
    edge = np.sign(anchors[:, 0] - centres[:, 0]) * sizes[:, 0] / 2
    starts = np.stack([centres[:, 0] + edge, centres[:, 1]], axis=1)
    draw_leaders(pen, view, starts, anchors, leader_rgba)
    panels = []
    first = 0
    for group in groups:
        these = slice(first, first + len(group.texts))
        panels.append(
            Panels(centres[these], sizes[these], group.texts, group.rgba, group.kind, group.items)
        )
        first += len(group.texts)
    return panels


def move_below(right: Panels, left: Panels) -> Panels:
    """Returns the upper left corner's panels, moved below the right one's if they overlap."""
    low, _ = _bounds(right)
    _, high = _bounds(left)
    down = high[1] - low[1]
    if high[0] < low[0] or down <= 0:
        return left
    return replace(left, centres=left.centres - [0.0, down])


def _bounds(panels: Panels) -> tuple[Array, Array]:
    """Returns the lower left and upper right pixel of all panels of a corner."""
    half = panels.sizes / 2
    return (panels.centres - half).min(axis=0), (panels.centres + half).max(axis=0)


def _span(view: PictureView, points: Array, anchors: Array) -> tuple[float, float]:
    """Returns the first and last pixel column of the robots, within the host's free area."""
    pixels, depth = view.project(points)
    across = np.concatenate([pixels[depth > view.near, 0], anchors[:, 0]])
    low, high = view.free[0][0], view.free[1][0]
    return max(float(across.min() - low), 0.0), float(min(across.max(), high) - low)


def heights_in_order(heights: Array) -> Ints:
    """Returns the rank of every height, the lowest first, (k,).

    The order is computed once, in the declared pose: sorting by the current heights would make
    panels swap places.
    """
    order = np.argsort(heights, kind="stable")
    rank = np.empty(len(order), np.intp)
    rank[order] = np.arange(len(order))
    return rank
