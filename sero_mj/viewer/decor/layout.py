"""Lays out panels in columns beside the robots, and the leaders (lines) from panels to joints.

All positions are in pixels. Heights of panels follow their anchors, the points at which leaders
end, continuously. Panels do not overlap if the image is large enough.
"""

from __future__ import annotations

import numpy as np

from ...base.frames import Array, Bools, Ints

LEFT, RIGHT = 0, 1
_RAMP = 6  # distance from a corner panel at which a column begins to avoid it, in gaps
# Minimum gap between panels, fraction of the desired gap. A second column is started, or robots are
# covered, only if panels do not fit with this gap.
_MIN_GAP = 0.2


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
    covered: Array | None = None,
) -> Array:
    """Arranges panels in columns and returns their centers, shape (k, 2), pixels.

    Args:
        anchors: points at which the leaders of the panels end, shape (k, 2), pixels. The vertical
            order of the panels is the order of this array, lowest first.
        sizes: widths and heights of the panels, shape (k, 2), pixels.
        side: side of each panel, `LEFT` or `RIGHT`, shape (k,).
        gap: desired space between panels, pixels.
        beside: space between the robots and the innermost columns, pixels.
        span: left and right limit of the robots, pixels (default: the limits of the anchors).
        kept_free: rectangles of the corner panels, which other panels must not cover, shape (c, 4),
            pixels. The columns are left, bottom, right and top.
        covered: rectangles that robots cover, which panels avoid if possible, shape (m, 4), pixels.
    """
    centres = np.empty((len(anchors), 2))
    if not len(anchors):
        return centres
    corners = np.zeros((0, 4)) if kept_free is None else kept_free
    on_left = (corners[:, 0] + corners[:, 2]) / 2 < width / 2
    sides = (corners[on_left], corners[~on_left])
    groups = []
    for which in (LEFT, RIGHT):
        low, high = side_limits(corners, which, width, height)
        groups.append(_chunks((side == which).nonzero()[0], sizes, gap, high - low))
    widths = [[float(sizes[column, 0].max()) + gap for column in group] for group in groups]
    left, right = (sum(group) for group in widths)
    # Both sides move inward, over the robot if necessary, so that panels stay in the image and do
    # not cover the other side.
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
            low, high = limits(np.concatenate([sides[which], near]), height)
            high = max(high, low + 2 * gap + float(sizes[column, 1].max()))
            blocked = np.zeros((0, 2))
            if covered is not None:
                right_edge = float((centres[column, 0] + half).max())
                left_edge = float((centres[column, 0] - half).min())
                is_behind = (covered[:, 2] > left_edge) & (covered[:, 0] < right_edge)
                blocked = covered[is_behind][:, [1, 3]]
            centres[column, 1] = spread_around(
                anchors[column, 1], sizes[column, 1], gap, low + gap, high - gap, blocked
            )
            edge += outward * column_width
    return centres


def with_room(
    sizes: Array,
    side: Ints,
    gap: float,
    width: float,
    height: float,
    *,
    kept_free: Array,
    covered: Array,
    may_move: bool,
) -> tuple[int, Ints]:
    """Determines how many panels, from the first on, fit into one column on each side of the image.

    A narrow image has only one column, on the right.

    Args:
        side: desired side of each panel, `LEFT` or `RIGHT`, shape (k,).
        gap: desired space between panels, pixels.
        may_move: whether a panel may move to the other side if its own side has no room.

    Returns:
        number of panels that fit, and the side of each panel, shape (k,).
    """
    column = float(sizes[:, 0].max(initial=0.0)) + gap
    least = float(sizes[:, 1].min(initial=height)) + _MIN_GAP * gap
    left_over = []
    for which in (LEFT, RIGHT):
        low, high = side_limits(kept_free, which, width, height)
        is_behind = covered[:, 0] < column if which == LEFT else covered[:, 2] > width - column
        rooms = _rooms_between(covered[is_behind][:, [1, 3]], low + gap, high - gap, least)
        left_over.append(
            sum((top - bottom + _MIN_GAP * gap) // least * least for bottom, top in rooms)
        )
    side = side.copy()
    if is_narrow(sizes, gap, width):
        side[:], may_move = RIGHT, False
    for k, needed in enumerate(sizes[:, 1] + _MIN_GAP * gap - 1e-9):
        if may_move and left_over[side[k]] < needed:
            side[k] = LEFT + RIGHT - side[k]
        if left_over[side[k]] < needed:
            return k, side
        left_over[side[k]] -= needed
    return len(sizes), side


def is_narrow(sizes: Array, gap: float, width: float) -> bool:
    """Returns whether an image is too narrow for two columns of panels of the given sizes."""
    return bool(2 * (float(sizes[:, 0].max(initial=0.0)) + gap) > width)


def side_limits(corners: Array, side: int, width: float, height: float) -> tuple[float, float]:
    """Returns the vertical range in pixels between the corner panels on one side of the image."""
    on_left = (corners[:, 0] + corners[:, 2]) / 2 < width / 2
    # A corner panel that extends beyond the middle also limits the other side.
    wide = (corners[:, 2] > width / 2) & (corners[:, 0] < width / 2)
    return limits(corners[wide | (on_left == (side == LEFT))], height)


def limits(corners: Array, height: float) -> tuple[float, float]:
    """Returns the vertical range between corner panels, at least a third of the image height."""
    at_bottom = corners[:, 1] + corners[:, 3] < height
    below = float(corners[at_bottom, 3].max(initial=0.0))
    above = float(corners[~at_bottom, 1].min(initial=height))
    above = max(above, height / 3)
    return min(below, above - height / 3), above


def _as_near(corners: Array, inner: float, outward: float, ramp: float, height: float) -> Array:
    """Returns the corner panels of the other side of the image, as obstacles for a column.

    `inner` is the edge of the column that faces them. A corner panel that reaches this edge has its
    full height. The height decreases with the distance and is zero at `ramp` pixels, so that the
    panels of the column do not jump when the robot moves.
    """
    away = inner - corners[:, 2] if outward > 0 else corners[:, 0] - inner
    share = np.clip(1.0 - away / ramp, 0.0, 1.0)
    at_bottom = corners[:, 1] + corners[:, 3] < height
    near = corners.copy()
    near[:, 3] = np.where(at_bottom, share * corners[:, 3], height)
    near[:, 1] = np.where(at_bottom, 0.0, height - share * (height - corners[:, 1]))
    return near


def _chunks(index: Ints, sizes: Array, gap: float, height: float) -> list[Ints]:
    if not len(index):
        return []
    needed = float(sizes[index, 1].sum()) + _MIN_GAP * gap * len(index)
    if needed <= height - gap:
        return [index]
    count = min(int(np.ceil(needed / max(height - gap, 1.0))), len(index))
    return np.array_split(index, max(count, 1))


def spread(centres: Array, heights: Array, gap: float, low: float, high: float) -> Array:
    """Moves intervals apart without changing their order.

    If the intervals do not fit between `low` and `high`, the gap is reduced. If they still do not
    fit, they overlap evenly.

    Args:
        centres: desired centers of the intervals, shape (k,), pixels.
        heights: lengths of the intervals, shape (k,), pixels.
        gap: desired space between two intervals, pixels.
        low: lower bound of all intervals, pixels.
        high: upper bound of all intervals, pixels.

    Returns:
        new centers of the intervals, shape (k,), lowest first, pixels.
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


def spread_around(
    centres: Array, heights: Array, gap: float, low: float, high: float, blocked: Array
) -> Array:
    """Moves intervals apart as `spread` does, and out of blocked ranges if there is room.

    Args:
        blocked: lower and upper ends of the blocked ranges, shape (b, 2), pixels. If the intervals
            do not fit between blocked ranges, these are ignored.
    """
    rooms = _rooms_between(blocked, low, high, float(heights.min())) if len(blocked) else []
    for between in (gap, _MIN_GAP * gap) if rooms else ():
        firsts = _assign_rooms(centres, heights, between, rooms)
        if firsts is None:
            continue
        placed = np.empty(len(centres))
        for (bottom, top), first, stop in zip(rooms, firsts, firsts[1:], strict=False):
            these = slice(first, stop)
            placed[these] = spread(centres[these], heights[these], between, bottom, top)
        return placed
    return spread(centres, heights, gap, low, high)


def _assign_rooms(
    centres: Array, heights: Array, gap: float, rooms: list[tuple[float, float]]
) -> list[int] | None:
    # Dynamic programming over the free ranges (rooms) minimizes the sum of all distances.
    k = len(centres)
    until = np.concatenate([[0.0], np.cumsum(heights + gap)])
    least = np.where(np.arange(k + 1) == 0, 0.0, np.inf)  # cost of the first i intervals so far
    firsts = []
    for bottom, top in rooms:
        away = np.maximum(
            np.maximum(bottom + heights / 2 - centres, centres - top + heights / 2), 0
        )
        distance = np.concatenate([[0.0], np.cumsum(away)])
        # [i, j]: intervals j to i - 1 are in this room.
        cost = least + distance[:, None] - distance
        cost[until[:, None] - until - gap > top - bottom] = np.inf
        cost[np.triu_indices(k + 1, 1)] = np.inf
        firsts.append(cost.argmin(axis=1))
        least = cost.min(axis=1)
    if not np.isfinite(least[-1]):
        return None
    found = [k]
    for first in reversed(firsts):
        found.append(int(first[found[-1]]))
    return found[::-1]


def _rooms_between(
    blocked: Array, low: float, high: float, least: float
) -> list[tuple[float, float]]:
    bottoms, tops = blocked[np.argsort(blocked[:, 0])].T
    starts = np.maximum.accumulate(np.append(low, tops))
    ends = np.append(np.minimum(bottoms, high), high)
    is_room = ends >= starts + least
    return list(zip(starts[is_room].tolist(), ends[is_room].tolist(), strict=True))


def place_clear(
    centres: Array, sizes: Array, taken: Array, low: Array, high: Array, is_needed: Bools
) -> tuple[Array, Bools]:
    """Moves rectangles, one after the other, to the closest positions without overlap.

    Args:
        taken: fixed rectangles, shape (m, 4), pixels. The columns are left, bottom, right and top.
        low: lower left pixel of the available area, shape (2,).
        high: upper right pixel of the available area, shape (2,).
        is_needed: mask of rectangles that are shown even if there is no room, shape (k,).

    Returns:
        new centers of the rectangles, shape (k, 2), and a mask of the rectangles with room, shape
        (k,). Rectangles without room are not moved.
    """
    placed, has_room = centres.copy(), np.ones(len(centres), bool)
    for k, (centre, half) in enumerate(zip(centres, sizes / 2, strict=True)):
        # A rectangle with its center inside these bounds overlaps an occupied one.
        below, above = taken[:, :2] - half, taken[:, 2:] + half

        def is_clear(at: Array, below: Array = below, above: Array = above) -> Bools:
            over = (at[:, None] > below + 1e-6) & (at[:, None] < above - 1e-6)
            return np.asarray(~(over[..., 0] & over[..., 1]).any(axis=1))

        if not is_clear(centre[None])[0]:
            x, y = (np.concatenate([[centre[i]], below[:, i], above[:, i]]) for i in (0, 1))
            grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
            grid = grid[((grid >= low + half) & (grid <= high - half)).all(axis=1)]
            grid = grid[np.argsort(np.linalg.norm(grid - centre, axis=1), kind="stable")]
            clear = is_clear(grid).nonzero()[0]
            has_room[k] = len(clear) > 0
            if has_room[k]:
                placed[k] = grid[clear[0]]
            elif not is_needed[k]:
                continue
        taken = np.concatenate([taken, np.concatenate([placed[k] - half, placed[k] + half])[None]])
    return placed, has_room


def uncross(starts: Array, ends: Array, least_gain: float = 0.0) -> Ints:
    """Returns the index of the start for each end, so that straight leaders do not cross.

    Two crossing leaders swap their starts. This reduces their total length, so the loop terminates.
    Leaders do not swap if the reduction is smaller than `least_gain` in pixels.
    """
    index = np.arange(len(starts))
    for _ in range(len(index) ** 2):
        crossing = crossings(starts[index], ends)
        if not crossing.any():
            break
        length = np.linalg.norm(starts[index][:, None] - ends, axis=2)  # from start i to end j
        own = length.diagonal()
        gain = np.where(crossing, own[:, None] + own - length - length.T, 0.0)
        i, j = np.unravel_index(gain.argmax(), gain.shape)
        if gain[i, j] <= least_gain:
            break
        index[[i, j]] = index[[j, i]]
    return index


def bends(starts: Array, ends: Array, centres: Array, sizes: Array, lane: float) -> Array:
    """Bends the leaders that would otherwise run behind other panels of their column.

    A bent leader first runs along the edge of its column. Past the last panel in its way, it turns
    to its joint. Leaders of farther panels are farther from the edge, so that leaders do not cross.

    Args:
        lane: distance between leaders beside a column, pixels.

    Returns:
        points at which the leaders bend, shape (k, 2), pixels. Straight leaders bend at their
        start.
    """
    low, high = centres - sizes / 2, centres + sizes / 2
    is_behind = behind(starts, ends, low, high)
    if not is_behind.any():
        return starts
    turns, outward = starts.copy(), np.sign(starts[:, 0] - centres[:, 0])
    up = np.sign(ends[:, 1] - starts[:, 1])
    in_column = (np.abs(starts[:, None, 0] - starts[:, 0]) < 1.0) & (outward[:, None] == outward)
    for k in np.nonzero(is_behind.any(axis=1))[0]:
        between = in_column[k] & (up[k] * (centres[:, 1] - centres[k, 1]) > 0)
        between &= up[k] * (ends[k, 1] - centres[:, 1]) > 0
        if between.any():
            past = high[between, 1].max() if up[k] > 0 else low[between, 1].min()
            turns[k] = starts[k, 0], past
    # The nearest panel of a column has the innermost lane, upward and downward.
    is_bent = np.any(turns != starts, axis=1)
    same = in_column & (up[:, None] == up) & is_bent[:, None] & is_bent
    nearer = same & (up[:, None] * (centres[None, :, 1] - centres[:, None, 1]) >= 0)
    turns[:, 0] += outward * lane * nearer.sum(axis=1)
    tangled = tangle(starts, turns, ends, low, high)
    for k in np.nonzero(is_bent)[0] if tangled > 1 else ():
        straight = turns.copy()
        straight[k] = starts[k]
        fewer = tangle(starts, straight, ends, low, high)
        if fewer + 1 < tangled:  # a leader that would cross several others stays straight
            turns, tangled = straight, fewer
    return turns


def tangle(starts: Array, bends: Array, ends: Array, low: Array, high: Array) -> int:
    """Returns how often leaders cross each other or run behind the panels of other leaders.

    Args:
        low: lower left pixels of the panels, shape (k, 2).
        high: upper right pixels of the panels, shape (k, 2).
    """
    k = len(starts)
    crossing = crossings(np.concatenate([starts, bends]), np.concatenate([bends, ends]))
    of_leaders = np.asarray(crossing.reshape(2, k, 2, k).any(axis=(0, 2)))
    np.fill_diagonal(of_leaders, False)
    is_behind = behind(starts, bends, low, high) | behind(bends, ends, low, high)
    return int(of_leaders.sum()) // 2 + int(is_behind.sum())


def behind(starts: Array, ends: Array, low: Array, high: Array) -> Bools:
    """Returns a mask (k, k) that states which leaders (rows) run behind other panels (columns)."""
    along = ends - starts
    along = np.where(np.abs(along) < 1e-9, 1e-9, along)[:, None]
    first, second = (
        (edge + margin - starts[:, None]) / along for edge, margin in ((low, 1.0), (high, -1.0))
    )
    enters = np.minimum(first, second).max(axis=2)
    leaves = np.maximum(first, second).min(axis=2)
    is_behind = (enters < leaves) & (leaves > 0) & (enters < 1)
    np.fill_diagonal(is_behind, False)
    return np.asarray(is_behind)


def crossings(starts: Array, ends: Array) -> Bools:
    """Returns a symmetric mask (k, k) that states which straight leaders cross each other."""
    along = ends - starts

    def side_of(points: Array) -> Array:
        away = points - starts[:, None]
        return along[:, None, 0] * away[..., 1] - along[:, None, 1] * away[..., 0]

    between = side_of(starts) * side_of(ends) < 0
    return between & between.T
