"""Places billboards beside the robots, with leaders (lines) to the items that they describe.

Robots on the left have billboards on the left side of the image, and robots on the right have them
on the right. A single robot, or the one in the middle, has billboards on both sides. The heights of
billboards follow the joints continuously. A billboard changes its place only if leaders would cross
or a robot moves behind it.
"""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import DoublePart
from ...robots.assemble.world_view import WorldView
from ...robots.declared.mounts import carrier
from .geom_buffer import GeomBuffer, Kind
from .image_view import ImageView
from .layout import LEFT, RIGHT, bends, columns, is_narrow, tangle, uncross, with_room
from .panels import PANEL_RGBA, Panels, draw_leaders, panel_sizes

_Key = tuple[Kind, int]

_CLOSE = 0.03  # distance that a robot moves before it is sorted again, fraction of the image width
_MIN_GAIN = 0.01  # minimum gain of a swap, fraction of the line height; smaller gains are noise
FEWEST = 8  # minimum number of billboards, even if they need several columns
# If a robot has more than 24 joints, only the 12 most loaded joints and clicked ones are shown.
_MANY, _MAX_LOADED = 24, 12
GAP = 0.3  # distance between billboards, fraction of the line height
# The billboards of a hand or finger are beside those of its arm if the hand or finger is smaller
# than this fraction of the arm.
SMALL = 0.5
NO_SHARE = -1.0  # value of unknown shares, which is smaller than any known share
# A billboard replaces a shown one only if its share is larger by this factor plus this amount.
_MORE = (1.25, 0.02)
_NEW_ROOM = 0.5  # additional distance between robots and new billboards, fraction of line height
_MARGIN = 0.5  # distance of the note from the image border, fraction of the line height
_LANE = 0.2  # distance between leaders beside a column, fraction of the line height
_OF_LIMB = 2  # number of joint billboards that a limb billboard counts as
_LOADS = (Kind.BILLBOARD, Kind.LIMB)  # kinds of billboards that have a share
_LOADED = ": highest loads"  # end of the note if the loads of all shown joints are known
_ROUNDS = 8  # maximum iterations of placing and uncrossing; panels of several sizes need several
# Leaders are dark in a light scene and light in a dark scene.
LEADER_RGBA = {"light": (0.09, 0.11, 0.14, 0.9), "dark": (0.62, 0.67, 0.73, 0.9)}


@dataclass(frozen=True, eq=False)
class BillboardGroup:
    """A set of k billboards of the same kind, to be placed by `BillboardLayout`.

    Attributes:
        items: indices of the joints, arrows or robots that the billboards describe, shape (k,).
        anchors: pixels at which the leaders of the billboards end, shape (k, 2).
        texts: lines of each billboard, top line first.
        owners: indices of the robots or doubles in `WorldView.owners`, shape (k,); -1 for none.
        side: side of each billboard, `LEFT` or `RIGHT`, shape (k,). If there are several robots,
            their positions determine the sides instead.
        rank: position of each billboard in the vertical order, lowest first, shape (k,).
        share: load of the described joint as a fraction of its limit, shape (k,); `NO_SHARE` if
            unknown. If there is no room for all billboards, those with the largest share are
            shown. Billboards with a share of inf are always shown.
        clear: minimum horizontal distance between the billboards and the anchors, pixels.
        rgba: one color for all billboards, or one color for each, shape (k, 4).
    """

    kind: Kind
    items: Ints
    anchors: Array
    sizes: Array
    texts: list[list[bytes]]
    owners: Ints
    side: Ints
    rank: Ints
    share: Array
    clear: float
    rgba: tuple[float, float, float, float] | Array = PANEL_RGBA

    def only(self, is_shown: Bools) -> BillboardGroup:
        arrays = ("items", "anchors", "sizes", "owners", "side", "rank", "share")
        parts = {name: getattr(self, name)[is_shown] for name in arrays}
        texts = [text for text, is_on in zip(self.texts, is_shown, strict=True) if is_on]
        rgba = self.rgba[is_shown] if isinstance(self.rgba, np.ndarray) else self.rgba
        return replace(self, **parts, texts=texts, rgba=rgba)


@dataclass(frozen=True, eq=False)
class _All:
    groups: list[BillboardGroup]
    keys: list[_Key]
    anchors: Array
    sizes: Array
    owners: Ints
    side: Ints
    rank: Array
    share: Array

    @classmethod
    def of(cls, groups: list[BillboardGroup]) -> _All:
        keys = [(group.kind, int(item)) for group in groups for item in group.items]
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(group, name) for group in groups])
            for name in ("anchors", "sizes", "owners", "side", "rank", "share")
        }
        return cls(groups, keys, **{**arrays, "rank": arrays["rank"].astype(float)})

    @property
    def is_clicked(self) -> Bools:
        return np.isinf(self.share)

    def only(self, is_shown: Bools) -> _All:
        ends = np.cumsum([len(group.texts) for group in self.groups])
        parts = zip(self.groups, np.split(is_shown, ends[:-1]), strict=True)
        found = _All.of([group.only(mine) for group, mine in parts if mine.any()])
        return replace(found, side=self.side[is_shown], rank=self.rank[is_shown])


@dataclass
class _Memory:
    """The layout of the last frame, which prevents billboards from alternating between two places.

    Attributes:
        order: indices of the robots from left to right.
        middles: horizontal positions by which the robots are sorted, pixels.
        preferred: side of each billboard according to the positions of the robots.
        places: side and rank of each billboard.
        chosen: billboards that were shown if there was no room for all; otherwise empty.
    """

    order: list[int] = field(default_factory=list)
    middles: dict[int, float] = field(default_factory=dict)
    preferred: dict[_Key, int] = field(default_factory=dict)
    places: dict[_Key, tuple[int, float]] = field(default_factory=dict)
    chosen: set[_Key] = field(default_factory=set)

    def sort_robots(self, x: Array, robot_of_point: Ints, width: float) -> None:
        robots = set(robot_of_point.tolist())
        for robot in robots:
            middle = float(x[robot_of_point == robot].mean())
            if abs(middle - self.middles.get(robot, np.inf)) > _CLOSE * width:
                self.middles[robot] = middle
        self.order = sorted(robots, key=self.middles.__getitem__)

    def restore_places(self, every: _All) -> None:
        for k, key in enumerate(every.keys):
            if self.preferred.get(key) == every.side[k] and key in self.places:
                every.side[k], every.rank[k] = self.places[key]
            else:
                self.preferred[key] = int(every.side[k])


@dataclass(frozen=True, eq=False)
class _Placed:
    """The shown billboards with the positions of billboards and leaders, shape (m, 2), pixels.

    Attributes:
        note: list with a panel that states the number of shown billboards; empty if all are shown.
        bends: points at which the leaders bend. Straight leaders bend at their start.
    """

    billboards: _All
    is_shown: Bools
    note: list[Panels]
    centres: Array
    starts: Array
    bends: Array


@dataclass(frozen=True, eq=False)
class _Covered:
    """The m points on robots that billboards avoid, each with the rectangle that it covers."""

    pixels: Array  # shape (m, 2)
    robots: Ints  # index of the robot at each point, shape (m,)
    rectangles: Array  # left, bottom, right and top of the area around each point, shape (m, 4)


class BillboardLayout:
    """The algorithm that places the billboards of a world, with the layout of the last frame.

    The side of a billboard and its position in the vertical order do not change until leaders
    cross. Then two billboards swap positions. The layout is reused until one of its inputs changes.
    This saves 6 of 8 ms for a 1280x800 frame of an LWR, and 8 of 24 ms for Justin.

    Args:
        owner_group: for each robot and double, the index of the robot beside which its billboards
            are placed, see `owner_groups`.
    """

    def __init__(self, owner_group: Ints) -> None:
        self._owner_group = owner_group
        self._memory = _Memory()
        self._last: tuple[tuple[object, ...], _Placed] | None = None  # inputs and their result

    def lay_out(
        self,
        buffer: GeomBuffer,
        view: ImageView,
        groups: list[BillboardGroup],
        points: Array,
        radii: Array,
        owners: Ints,
        corners: list[Panels],
        leader_rgba: tuple[float, float, float, float] = LEADER_RGBA["light"],
    ) -> tuple[list[BillboardGroup], list[Panels], list[Panels]]:
        """Places the billboards and draws their leaders.

        If a robot has many billboards, or if there is no room for all of them beside the robots,
        those with the largest shares are shown. A minimum number is always shown. A note in the
        corner states the number of shown billboards.

        Args:
            points: points on robots and doubles, which billboards avoid, shape (m, 3), m.
            radii: radius of the robot around each point, shape (m,), m.
            owners: index of the robot or double that each point is on, shape (m,).
            corners: panels in the corners of the image, which billboards must not cover.

        Returns:
            the shown billboards, their panels, and a list with the note, which is empty if all
            billboards are shown.
        """
        groups = [group for group in groups if group.texts]
        if not groups:
            return [], [], []
        every = _All.of(groups)
        covered, radius = self._project(view, points, radii, owners)
        order = self._by_share(every)
        # The layout depends only on the order of the shares and on which of them are known. Both
        # rarely change.
        arrays: list[NDArray[Any]] = [covered.pixels, covered.robots, radius, order]
        arrays += [every.share > NO_SHARE, every.is_clicked, every.anchors, every.sizes]
        arrays += [every.owners, every.side, every.rank, *view.free]
        arrays += [array for corner in corners for array in (corner.centres, corner.sizes)]
        clear = tuple(float(group.clear) for group in groups)
        inputs = (view.font, tuple(every.keys), clear, tuple(array.tobytes() for array in arrays))
        if self._last is not None and self._last[0] == inputs:
            placed = self._last[1]
        else:
            before = deepcopy(self._memory)
            placed = self._place(view, every, covered, corners, order)
            self._last = (inputs, placed) if self._memory == before else None
        if placed.note:
            groups = every.only(placed.is_shown).groups
        anchors = placed.billboards.anchors
        draw_leaders(buffer, view, placed.starts, placed.bends, anchors, leader_rgba)
        centres = np.split(placed.centres, np.cumsum([len(group.texts) for group in groups])[:-1])
        panels = [
            Panels(
                middle, each.sizes, each.texts, each.rgba, each.kind, each.items, has_values=True
            )
            for middle, each in zip(centres, groups, strict=True)
        ]
        return groups, panels, placed.note

    def _project(
        self, view: ImageView, points: Array, radii: Array, owners: Ints
    ) -> tuple[_Covered, Array]:
        pixels, depth = view.project(points)
        is_before = depth > view.near
        pixels, robots = pixels[is_before], self._owner_group[owners[is_before]]
        radius = (radii[is_before] / view.pixel_size(depth[is_before]))[:, None]
        rectangles = np.concatenate([pixels - radius, pixels + radius], axis=1)
        return _Covered(pixels, robots, rectangles), radius

    def _by_share(self, every: _All) -> Ints:
        was_chosen = np.array([key in self._memory.chosen for key in every.keys])
        factor, more = _MORE
        share = every.share
        raised = np.where(was_chosen, np.maximum(factor * share, share) + more, share)
        return np.argsort(-raised, kind="stable")

    def _place(
        self, view: ImageView, every: _All, covered: _Covered, corners: list[Panels], order: Ints
    ) -> _Placed:
        low, high = view.free
        width, height = high - low
        rectangles = covered.rectangles - [*low, *low]
        self._memory.sort_robots(covered.pixels[:, 0], covered.robots, width)
        self._set_sides(every)
        self._memory.restore_places(every)
        is_shown, note = self._choose(view, every, rectangles, corners, order)
        if note:
            every = every.only(is_shown)
        anchors, sizes, line = every.anchors, every.sizes, view.font.height
        gap = GAP * line
        x = np.concatenate([covered.pixels[:, 0], anchors[:, 0]]) - low[0]
        span = max(float(x.min()), 0.0), min(float(x.max()), width)
        beside = min(max(3 * gap, *(group.clear for group in every.groups)), width / 6)
        kept_free = _rectangles([*corners, *note], low)
        side, rank, same = every.side, every.rank, np.arange(len(every.keys))
        best: tuple[int, Ints, Array, _Placed] | None = None
        for _ in range(_ROUNDS):
            by_rank = np.argsort(rank, kind="stable")
            centres = np.empty((len(anchors), 2))
            centres[by_rank] = low + columns(
                anchors[by_rank] - low,
                sizes[by_rank],
                side[by_rank],
                gap,
                beside,
                width,
                height,
                span=span,
                kept_free=kept_free,
                covered=rectangles,
            )
            starts = _starts(centres, sizes, anchors, side)
            turns = bends(starts, anchors, centres, sizes, _LANE * line)
            tangled = tangle(starts, turns, anchors, centres - sizes / 2, centres + sizes / 2)
            if best is None or tangled < best[0]:
                best = tangled, side, rank, _Placed(every, is_shown, note, centres, starts, turns)
            changed = uncross(starts, anchors, _MIN_GAIN * line)
            if (changed == same).all():
                changed = uncross(turns, anchors, _MIN_GAIN * line)
            if not tangled or (changed == same).all():
                break
            side, rank = side[changed], rank[changed]
        assert best is not None
        _, side, rank, placed = best
        places = zip(side.tolist(), rank.tolist(), strict=True)
        self._memory.places.update(zip(every.keys, places, strict=True))
        return placed

    def _set_sides(self, every: _All) -> None:
        robots = self._memory.order
        if len(robots) < 2:
            return
        robot_of = np.append(self._owner_group, -1)[every.owners]  # -1 for no owner
        counts = np.array([(robot_of == robot).sum() for robot in robots])
        middles = np.cumsum(counts) - counts / 2
        for place, robot in enumerate(robots):
            if 2 * place + 1 != len(robots):  # the middle robot has billboards on both sides
                is_left = middles[place] < counts.sum() / 2
                every.side[robot_of == robot] = LEFT if is_left else RIGHT

    def _choose(
        self, view: ImageView, every: _All, covered: Array, corners: list[Panels], order: Ints
    ) -> tuple[Bools, list[Panels]]:
        """Selects the billboards to show and moves billboards from a full side to the other side.

        Returns:
            mask (k,) of the shown billboards, and a list with the note if some are not shown.
        """
        memory, total = self._memory, len(every.keys)
        limit, nothing = _max_count(every, view), np.zeros((0, 4))
        first = order[:limit]
        fit = partial(self._fit, view, every, first)

        def show(count: int, sides: Ints) -> Bools:
            every.side[first] = sides
            is_shown = np.zeros(total, bool)
            is_shown[order[:count]] = True
            shown = {key for key, is_on in zip(every.keys, is_shown, strict=True) if is_on}
            memory.chosen = shown if count < total else set()
            return is_shown

        # The billboard of a limb has more lines and replaces several billboards of joints.
        weights = np.where([kind == Kind.LIMB for kind, _ in every.keys], _OF_LIMB, 1)[order]
        few = max(int((weights.cumsum() <= FEWEST).sum()), 1)
        attempts = [(nothing, total)] if total <= few else []
        attempts += [] if memory.chosen else [(covered, 0)]
        for around, required in attempts:
            count, sides = fit(around, corners, required)
            if count == total:
                return show(count, sides), []
        note = _note(view, total, corners)
        corners = [*corners, note]
        # A few billboards are shown even in front of robots, but never in front of each other.
        fewest = fit(nothing, corners, min(few, limit))[0]
        required = max(min(fewest, max(few, int(every.is_clicked.sum())), limit), 1)
        apart = _NEW_ROOM * view.font.height * np.array([-1, -1, 1, 1])
        count, sides = fit(covered + apart, corners, required)
        if count == total:
            return show(count, sides), []
        if count < len(memory.chosen):  # as many as in the last frame are shown if they still fit
            count, sides = fit(covered, corners, required)
            count = min(count, len(memory.chosen))
        if count < required:
            count, sides = required, fit(nothing, corners, required)[1]
        is_shown = show(count, sides)
        return is_shown, [replace(note, texts=[[_note_of(every, is_shown)]])]

    def _fit(
        self,
        view: ImageView,
        every: _All,
        first: Ints,
        covered: Array,
        corners: list[Panels],
        required: int = 0,
    ) -> tuple[int, Ints]:
        low, high = view.free
        gap, kept_free = GAP * view.font.height, _rectangles(corners, low)
        # With several robots, billboards change sides only if too few fit otherwise.
        for may_move in (False, True) if len(self._memory.order) > 1 else (True,):
            found = with_room(
                every.sizes[first],
                every.side[first],
                gap,
                *(high - low),
                kept_free=kept_free,
                covered=covered,
                may_move=may_move,
            )
            if found[0] >= required:
                break
        return found


def owner_groups(world: WorldView) -> Ints:
    """Returns the index of the robot beside which each robot or double has its billboards.

    Billboards of a double are placed beside the robot that it duplicates, and those of a hand
    beside the arm that carries it. All other billboards are placed beside their own robot.
    """
    names, robots = list(world.owners), world.scene.robots

    def joined(name: str) -> str:
        below = carrier(robots[name]) if name in robots else None
        if below not in world.robots or robots[name].reach > SMALL * robots[below].reach:
            return name
        return joined(below)

    return np.array(
        [
            names.index(joined(part.double.of if isinstance(part, DoublePart) else name))
            for name, part in world.owners.items()
        ],
        np.intp,
    )


def _max_count(every: _All, view: ImageView) -> int:
    clicked, (low, high) = int(every.is_clicked.sum()), view.free
    if is_narrow(every.sizes, GAP * view.font.height, high[0] - low[0]):
        return max(FEWEST, clicked)  # leaders cross a single column more often than two
    owners = every.owners
    counts = np.unique(owners[owners >= 0], return_counts=True)[1]
    total = np.where(counts > _MANY, _MAX_LOADED, counts).sum() + (owners < 0).sum()
    return max(int(total), clicked)


def _rectangles(corners: list[Panels], origin: Array) -> Array:
    rows = np.array([np.concatenate(bounds(corner)) for corner in corners]).reshape(-1, 4)
    return rows - np.tile(origin, 2)


def _note(view: ImageView, total: int, corners: list[Panels]) -> Panels:
    margin = _MARGIN * view.font.height
    text = _note_text(total, total)  # the longest possible note
    size = panel_sizes(np.array([view.font.width(text)]), 1, view)[0]
    right, bottom = view.free[1][0] - margin, view.free[0][1] + margin
    for corner in corners:  # above the legend if the image is narrow
        low, high = bounds(corner)
        if high[0] > right - size[0] and low[1] < bottom + size[1]:
            bottom = high[1] + margin
    centre = np.array([right, bottom]) + size * (-0.5, 0.5)
    return Panels(centre[None], size[None], [[text]])


def _note_text(shown: int, total: int, what: str = "joints", which: str = _LOADED) -> bytes:
    return f"{shown} of {total} {what} shown{which}".encode()


def _note_of(every: _All, is_shown: Bools) -> bytes:
    kinds = [kind for kind, _ in every.keys]
    is_load = np.isin(kinds, _LOADS)
    is_known = (every.share[is_shown & is_load] > NO_SHARE).all()
    return _note_text(
        int((is_shown & is_load).sum()),
        int(is_load.sum()),
        "billboards" if Kind.LIMB in kinds else "joints",
        _LOADED if is_known else "",
    )


def _starts(centres: Array, sizes: Array, anchors: Array, side: Ints) -> Array:
    half = sizes[:, 0] / 2
    beside = anchors[:, 0] - centres[:, 0]
    edge = np.where(np.abs(beside) > half, np.sign(beside), np.where(side == LEFT, 1.0, -1.0))
    return np.stack([centres[:, 0] + edge * half, centres[:, 1]], axis=1)


def move_below(right: Panels, left: Panels) -> Panels:
    """Returns the upper left panels, moved below the upper right panels if they overlap."""
    low, _ = bounds(right)
    _, high = bounds(left)
    down = high[1] - low[1]
    if high[0] < low[0] or down <= 0:
        return left
    return replace(left, centres=left.centres - [0.0, down])


def bounds(panels: Panels) -> tuple[Array, Array]:
    """Returns the lower left and the upper right pixel of the bounding box of panels."""
    half = panels.sizes / 2
    return (panels.centres - half).min(axis=0), (panels.centres + half).max(axis=0)


def heights_in_order(heights: Array) -> Ints:
    """Returns the ranks of the heights, shape (k,), with 0 for the lowest.

    Call this once with the heights in the declared pose. If the ranks followed the current heights,
    billboards would swap places during motion.
    """
    order = np.argsort(heights, kind="stable")
    rank = np.empty(len(order), np.intp)
    rank[order] = np.arange(len(order))
    return rank
