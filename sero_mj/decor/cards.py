"""Cards: panels beside the robots, with a leader line to the item they describe.

Cards keep their side, column and order for all camera poses, and their heights follow the joints
continuously, so that nothing jumps while the camera or the robot moves. Cards do not overlap as
long as the picture is large enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .panels import PANEL_RGBA, Panels, draw_leaders
from .pen import Kind, Pen
from .picture_view import PictureView

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

LEFT, RIGHT = 0, 1
_RAMP = 6  # distance, in gaps, over which a column that approaches a corner gradually avoids it
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
        side: `LEFT` or `RIGHT`, (k,).
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


def spread(centres: Array, heights: Array, gap: float, low: float, high: float) -> Array:
    """Moves intervals apart, in their given order, as little as necessary.

    Args:
        centres: desired centres, (k,), pixels.
        heights: (k,), pixels.
        gap: minimum space between two intervals, pixels.
        low: lower bound of all intervals.
        high: upper bound of all intervals. If they do not fit, the gap is reduced, then they
            overlap evenly.

    Returns:
        centres (k,), the first lowest.
    """
    if not len(centres):
        return centres
    room = high - low
    needed = float(heights.sum()) + gap * (len(heights) - 1)
    if needed > room and len(heights) > 1:
        gap = (room - float(heights.sum())) / (len(heights) - 1)
        needed = room
    below = np.concatenate([[0.0], np.cumsum(heights[:-1] + gap)])
    start = centres - heights / 2 - below
    # The mean of the smallest non-decreasing upper bound and the largest non-decreasing lower
    # bound is itself non-decreasing, and continuous in the centres.
    rising = np.maximum.accumulate(start)
    falling = np.minimum.accumulate(start[::-1])[::-1]
    start = (rising + falling) / 2
    start = np.minimum(np.maximum(start, low), max(high - needed, low))
    return np.asarray(start + below + heights / 2)


def columns(
    anchors: Array,
    sizes: Array,
    side: Ints,
    gap: float,
    beside: float,
    width: float,
    height: float,
    *,
    span: tuple[float, float] | None = None,
    kept_free: Array | None = None,
) -> Array:
    """Lays out all panels of a picture.

    Args:
        anchors: pixel of every panel's joint, (k, 2), in vertical order of the panels, lowest
            first.
        sizes: width and height of every panel, (k, 2), pixels.
        side: `LEFT` or `RIGHT`, (k,).
        gap: minimum space between panels, pixels.
        beside: space between the innermost columns and the outermost joint, pixels.
        width: of the picture, pixels.
        height: of the picture, pixels.
        span: first and last pixel column of the robots, which panels do not cover; None for
            those of the anchors.
        kept_free: rectangles in the corners of the picture (legend, faults, flange check) that
            panels do not cover: left, bottom, right, top, (c, 4), pixels.

    Returns:
        centres of the panels, (k, 2), pixels from the lower left corner.
    """
    centres = np.empty((len(anchors), 2))
    if not len(anchors):
        return centres
    corners = np.zeros((0, 4)) if kept_free is None else kept_free
    on_left = (corners[:, 0] + corners[:, 2]) / 2 < width / 2
    sides = (corners[on_left], corners[~on_left])
    groups = []
    for which in (LEFT, RIGHT):
        # A corner panel that extends beyond the middle limits the other side too.
        wide = (corners[:, 2] > width / 2) & (corners[:, 0] < width / 2)
        low, high = _limits(corners[wide | (on_left == (which == LEFT))], height)
        groups.append(_chunks((side == which).nonzero()[0], sizes, gap, high - low))
    widths = [[float(sizes[column, 0].max()) + gap for column in group] for group in groups]
    left, right = (sum(group) for group in widths)
    # Both sides move inward, over the robot if necessary, so that panels neither leave the picture
    # nor cover the other side.
    first, last = span or (float(anchors[:, 0].min()), float(anchors[:, 0].max()))
    inner_left = max(first - beside, left)
    inner_right = min(last + beside, width - right)
    inner_left = min(inner_left, width - right - gap)
    inner_right = max(inner_right, inner_left + gap)
    for which, outward, start in ((LEFT, -1.0, inner_left), (RIGHT, 1.0, inner_right)):
        edge = start
        for column, column_width in zip(groups[which], widths[which], strict=True):
            # Panels of one column are aligned on the side of the robot.
            half = sizes[column, 0] / 2
            x = edge + outward * half
            centres[column, 0] = np.maximum(np.minimum(x, width - half), half)
            inner = outward * float((outward * centres[column, 0] - half).min())
            near = _as_near(sides[1 - which], inner, outward, _RAMP * gap, height)
            low, high = _limits(np.concatenate([sides[which], near]), height)
            high = max(high, low + 2 * gap + float(sizes[column, 1].max()))
            centres[column, 1] = spread(
                anchors[column, 1], sizes[column, 1], gap, low + gap, high - gap
            )
            edge += outward * column_width
    return centres


def _limits(corners: Array, height: float) -> tuple[float, float]:
    """Returns the vertical range that corners leave free, at least a third of the picture."""
    at_bottom = corners[:, 1] + corners[:, 3] < height
    below = float(corners[at_bottom, 3].max(initial=0.0))
    above = float(corners[~at_bottom, 1].min(initial=height))
    above = max(above, height / 3)
    return min(below, above - height / 3), above


def _as_near(corners: Array, inner: float, outward: float, ramp: float, height: float) -> Array:
    """Returns corners of the other side, with heights scaled for a column that begins at `inner`.

    The height is full for a corner that reaches the column, zero for one `ramp` pixels away, and
    interpolated in between, so that panels do not jump when the robot moves.
    """
    away = inner - corners[:, 2] if outward > 0 else corners[:, 0] - inner
    share = np.clip(1.0 - away / ramp, 0.0, 1.0)
    at_bottom = corners[:, 1] + corners[:, 3] < height
    near = corners.copy()
    near[:, 3] = np.where(at_bottom, share * corners[:, 3], height)
    near[:, 1] = np.where(at_bottom, 0.0, height - share * (height - corners[:, 1]))
    return near


def _chunks(index: Ints, sizes: Array, gap: float, height: float) -> list[Ints]:
    """Splits one side's panels into as few columns of similar length as the height allows."""
    if not len(index):
        return []
    needed = float(sizes[index, 1].sum()) + gap * len(index)
    if needed <= height - gap:
        return [index]
    count = min(int(np.ceil(needed / max(height - gap, 1.0))), len(index))
    return np.array_split(index, max(count, 1))
