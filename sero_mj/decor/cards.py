"""Cards: panels beside the robots, with a leader line to the item they describe.

Each robot's cards stand on its own side of the picture; a single robot, or one in the middle, has
cards on both sides. Their heights follow the joints continuously; a card changes its place only
where leaders would cross, or where a robot gets behind it. Cards do not overlap as long as the
picture is large enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.double import OUT_OF_SIGHT
from ..assemble.world_view import WorldView
from .panels import PANEL_RGBA, Panels, draw_leaders
from .pen import Kind, Pen
from .picture_view import PictureView

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
_Key = tuple[Kind, int]

LEFT, RIGHT = 0, 1
_RAMP = 6  # distance, in gaps, over which a column that approaches a corner gradually avoids it
_CLOSE = 0.03  # of the picture's width: robots closer than that keep their order
_LEAST_GAP = 0.2  # of the usual gap, before a second column is begun or a robot is covered
_LEAST_GAIN = 0.05  # of a line's height: less is noise, and no reason to change places
_ROUNDS = 4  # of placing and uncrossing; panels of several sizes can need more than one
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
        owners: robot or double that they belong to, by their order in `WorldView.owners`, (k,); -1
            for none.
        side: `LEFT` or `RIGHT`, (k,), where there is one robot; else the robot's side is taken.
        rank: vertical order, lowest first, (k,).
        clear: minimum horizontal distance of their columns from the anchors, pixels.
        rgba: (k, 4), or one for all.
    """

    kind: Kind
    items: Ints
    anchors: Array
    sizes: Array
    texts: list[list[bytes]]
    owners: Ints
    side: Ints
    rank: Ints
    clear: float
    rgba: tuple[float, float, float, float] | Array = PANEL_RGBA


class CardLayout:
    """Places the cards of a world, and keeps their places from frame to frame.

    A card keeps its side and its place in the vertical order from frame to frame, until leaders
    cross: then two cards change places. So nothing moves to and fro at a limit.

    Args:
        owner_group: group of every robot and double, by their order in `WorldView.owners`; a double
            belongs to its robot's group.
    """

    def __init__(self, owner_group: Ints) -> None:
        self._owner_group = owner_group
        self._groups_in_order: list[int] = []  # from left to right
        self._wanted: dict[_Key, int] = {}  # side that the robots' positions give
        self._places: dict[_Key, tuple[int, float]] = {}  # side and rank

    def lay_out(
        self,
        pen: Pen,
        view: PictureView,
        groups: list[Cards],
        points: Array,
        radii: Array,
        owners: Ints,
        corners: list[Panels],
        leader_rgba: tuple[float, float, float, float] = LEADER_RGBA["light"],
    ) -> list[Panels]:
        """Places every card, draws the leaders and returns the panels for `draw_panels`.

        Args:
            pen: where to.
            view: of the picture.
            groups: cards of every kind.
            points: of the robots and doubles that are shown, (m, 3), m; cards are placed beside
                them.
            radii: of the robot around every point, (m,), m.
            owners: index of the robot or double of every point, (m,).
            corners: panels in the corners of the picture, which cards must not cover.
            leader_rgba: of the leaders.
        """
        groups = [group for group in groups if group.texts]
        if not groups:
            return []
        anchors = np.concatenate([group.anchors for group in groups])
        sizes = np.concatenate([group.sizes for group in groups])
        gap = view.font.height * 0.3
        low, high = view.free
        width, height = high - low
        pixels, depth = view.project(points)
        is_before = depth > view.near
        pixels, of_point = pixels[is_before], self._owner_group[owners[is_before]]
        radius = (radii[is_before] / view.pixel_size(depth[is_before]))[:, None]
        covered = np.concatenate([pixels - radius, pixels + radius], axis=1) - [*low, *low]
        across = np.concatenate([pixels[:, 0], anchors[:, 0]]) - low[0]
        kept_free = np.array(
            [np.concatenate([low, high]) for low, high in map(_bounds, corners)]
        ).reshape(-1, 4)

        def place(side: Ints, rank: Array) -> Array:
            order = np.argsort(rank, kind="stable")
            centres = np.empty((len(anchors), 2))
            centres[order] = columns(
                anchors[order] - low,
                sizes[order],
                side[order],
                gap,
                min(max(3 * gap, *(group.clear for group in groups)), width / 6),
                width,
                height,
                span=(max(float(across.min()), 0.0), min(float(across.max()), width)),
                kept_free=kept_free - [*low, *low],
                covered=covered,
            )
            return centres + low

        keys = [(group.kind, int(item)) for group in groups for item in group.items]
        owner = np.concatenate([group.owners for group in groups])
        side, rank = self._last_places(keys, groups, owner, pixels[:, 0], of_point, width)
        for _ in range(_ROUNDS):
            centres = place(side, rank)
            starts = _starts(centres, sizes, anchors)
            changed = uncross(starts, anchors, _LEAST_GAIN * view.font.height)
            if (changed == np.arange(len(keys))).all():
                break
            side, rank = side[changed], rank[changed]
        self._places.update(zip(keys, zip(side.tolist(), rank.tolist(), strict=True), strict=True))
        draw_leaders(pen, view, starts, anchors, leader_rgba)
        panels = []
        first = 0
        for group in groups:
            these = slice(first, first + len(group.texts))
            panels.append(
                Panels(
                    centres[these],
                    sizes[these],
                    group.texts,
                    group.rgba,
                    group.kind,
                    group.items,
                    has_values=True,
                )
            )
            first += len(group.texts)
        return panels

    def _last_places(
        self,
        keys: list[_Key],
        groups: list[Cards],
        owner: Ints,
        across: Array,
        of_point: Ints,
        width: float,
    ) -> tuple[Ints, Array]:
        """Returns side and rank of every card (k,): the last ones, or those of a new card."""
        side = np.concatenate([group.side for group in groups])
        rank = np.concatenate([group.rank for group in groups]).astype(float)
        group_of = np.where(owner >= 0, self._owner_group[owner], -1)
        self._sort_groups(across, of_point, width)
        if len(self._groups_in_order) > 1:
            counts = [int((group_of == group).sum()) for group in self._groups_in_order]
            ends = np.cumsum(counts)
            for group, count, end in zip(self._groups_in_order, counts, ends, strict=True):
                if 2 * end <= ends[-1]:
                    side[group_of == group] = LEFT
                elif 2 * (end - count) >= ends[-1]:
                    side[group_of == group] = RIGHT
        for k, key in enumerate(keys):
            if self._wanted.get(key) == side[k]:
                side[k], rank[k] = self._places[key]
            else:
                self._wanted[key] = int(side[k])
        return side, rank

    def _sort_groups(self, across: Array, of_point: Ints, width: float) -> None:
        """Sorts the robots in the picture from left to right; two that are close stay in order."""
        middles = {group: float(across[of_point == group].mean()) for group in set(of_point)}
        order = [group for group in self._groups_in_order if group in middles]
        order += sorted(middles.keys() - {*order}, key=lambda group: middles[group])
        for _ in order:
            for i in range(len(order) - 1):
                if middles[order[i]] > middles[order[i + 1]] + _CLOSE * width * (
                    {order[i], order[i + 1]} <= {*self._groups_in_order}
                ):
                    order[i], order[i + 1] = order[i + 1], order[i]
        self._groups_in_order = order


class Outline:
    """Points along the links of all robots and doubles, with radii, as an outline of them.

    Every geom counts as a capsule along its longest side, with a point at each end and in the
    middle.

    Args:
        world: the compiled scene.
    """

    def __init__(self, world: WorldView) -> None:
        model = world.model
        owner = np.full(model.ngeom, -1)
        for i, part in enumerate(world.owners.values()):
            owner[np.isin(model.geom_bodyid, part.bodies)] = i
        owner[(model.geom_group > 2) | (model.geom_rgba[:, 3] <= 0)] = -1
        self._geoms = (owner >= 0).nonzero()[0]
        centre, half = np.hsplit(model.geom_aabb[self._geoms], 2)
        longest = half.argmax(axis=1)
        self._radii = np.sort(half, axis=1)[:, 1]
        along = np.eye(3)[longest] * (half.max(axis=1) - self._radii)[:, None]
        self._offsets = np.stack([centre - along, centre, centre + along], axis=1)
        self._owners = owner[self._geoms]
        self._joints = world.joints

    def points(
        self,
        data: mujoco.MjData,
        hidden: NDArray[np.bool_] | None,
        sites: Array,
        arrows: NDArray[np.bool_],
    ) -> tuple[Array, Array, Ints]:
        """Returns points (m, 3), m, radii (m,), m, and the index of their robot or double (m,).

        Args:
            data: the state of the model.
            hidden: geoms that are not shown, (ngeom,) bool; None for none.
            sites: positions of the world's sites, `site_xpos` of its state, m.
            arrows: which joints have an arrow, which belongs to the outline, (N,) bool.
        """
        rotation = data.geom_xmat[self._geoms].reshape(-1, 1, 3, 3)
        points = data.geom_xpos[self._geoms, None] + (rotation @ self._offsets[..., None])[..., 0]
        is_shown = points[:, 0, 2] > OUT_OF_SIGHT[2] / 2  # doubles without a pose are far away
        if hidden is not None:
            is_shown &= ~hidden[self._geoms]
        joints = self._joints
        of_links, of_arrows = points[is_shown].reshape(-1, 3), sites[joints.centre_site[arrows]]
        radii = np.repeat(self._radii[is_shown], 3), joints.arrow_radius[arrows]
        owners = np.repeat(self._owners[is_shown], 3), joints.owner[arrows]
        return np.concatenate([of_links, of_arrows]), np.concatenate(radii), np.concatenate(owners)


def _starts(centres: Array, sizes: Array, anchors: Array) -> Array:
    """Returns where leaders begin, (k, 2): the middle of a card's edge towards its anchor."""
    edge = np.sign(anchors[:, 0] - centres[:, 0]) * sizes[:, 0] / 2
    return np.stack([centres[:, 0] + edge, centres[:, 1]], axis=1)


def uncross(starts: Array, ends: Array, least_gain: float = 0.0) -> Ints:
    """Returns which start belongs to every end, so that straight leaders do not cross.

    Two that cross change their starts, which makes their total length smaller: so it ends.

    Args:
        starts: (k, 2), pixels.
        ends: (k, 2), pixels.
        least_gain: two stay as they are if their total length would become smaller by less than
            this, pixels: those that barely cross, next to one of their ends.

    Returns:
        index of the start for every end, (k,).
    """
    index = np.arange(len(starts))
    for _ in range(len(index) ** 2):
        crossing = crossings(starts[index], ends)
        if not crossing.any():
            break
        length = np.linalg.norm(starts[index][:, None] - ends, axis=2)  # of start i to end j
        own = length.diagonal()
        gain = np.where(crossing, own[:, None] + own - length - length.T, 0.0)
        i, j = np.unravel_index(gain.argmax(), gain.shape)
        if gain[i, j] <= least_gain:
            break
        index[[i, j]] = index[[j, i]]
    return index


def crossings(starts: Array, ends: Array) -> NDArray[np.bool_]:
    """Returns which straight leaders cross, (k, k) bool.

    Args:
        starts: (k, 2), pixels.
        ends: (k, 2), pixels.
    """
    along = ends - starts

    def side_of(points: Array) -> Array:
        """Returns on which side of every leader (rows) points (columns) are."""
        away = points - starts[:, None]
        return along[:, None, 0] * away[..., 1] - along[:, None, 1] * away[..., 0]

    between = side_of(starts) * side_of(ends) < 0
    return between & between.T


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


def spread_around(
    centres: Array, heights: Array, gap: float, low: float, high: float, blocked: Array
) -> Array:
    """Moves intervals apart, as `spread` does, and out of blocked ranges where there is room.

    Args:
        centres: desired centres, (k,), pixels.
        heights: (k,), pixels.
        gap: minimum space between two intervals, pixels.
        low: lower bound of all intervals.
        high: upper bound of all intervals.
        blocked: lower and upper end of every blocked range, (b, 2), pixels; without effect if the
            intervals do not fit between them.

    Returns:
        centres (k,), the first lowest.
    """
    rooms = _rooms_between(blocked, low, high, float(heights.min())) if len(blocked) else []
    for between in (gap, _LEAST_GAP * gap) if rooms else ():
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
    """Returns the index of the first interval of every room, and k; None if they do not fit.

    The intervals are moved least in total, by dynamic programming over the rooms.
    """
    k = len(centres)
    until = np.concatenate([[0.0], np.cumsum(heights + gap)])
    least = np.where(np.arange(k + 1) == 0, 0.0, np.inf)  # of the first i intervals so far
    firsts = []
    for bottom, top in rooms:
        away = np.maximum(
            np.maximum(bottom + heights / 2 - centres, centres - top + heights / 2), 0
        )
        distance = np.concatenate([[0.0], np.cumsum(away)])
        cost = least + distance[:, None] - distance  # [i, j]: intervals j to i - 1 are in this room
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
    """Returns ranges from low to high, of a least size, that no blocked range covers, in order."""
    rooms = []
    for bottom, top in blocked[np.argsort(blocked[:, 0])].tolist():
        if bottom > low:
            rooms.append((low, min(bottom, high)))
        low = max(low, top)
    return [(bottom, top) for bottom, top in [*rooms, (low, high)] if top >= bottom + least]


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
        covered: rectangles around parts of the robots (r, 4), pixels; a column that has to stand
            in front of some leaves them free where it has the room.

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
    needed = float(sizes[index, 1].sum()) + _LEAST_GAP * gap * len(index)
    if needed <= height - gap:
        return [index]
    count = min(int(np.ceil(needed / max(height - gap, 1.0))), len(index))
    return np.array_split(index, max(count, 1))
