"""Cards: panels beside the robots, with a leader line to the item they describe.

Each robot's cards stand on its own side of the picture; a single robot, or one in the middle, has
cards on both sides. Their heights follow the joints continuously; a card changes its place only
where leaders would cross, or where a robot gets behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import DoublePart
from ...robots.assemble.world_view import WorldView
from ...robots.declared.mounts import carrier
from .geom_buffer import GeomBuffer, Kind
from .layout import (
    LEFT,
    RIGHT,
    bends,
    columns,
    is_narrow,
    tangle,
    uncross,
    with_room,
)
from .panels import PANEL_RGBA, Panels, draw_leaders, panel_sizes
from .picture_view import PictureView

_Key = tuple[Kind, int]

_CLOSE = 0.03  # of the picture's width, by which a robot moves before it changes its place
_MIN_GAIN = 0.01  # of a line's height: less is noise, and no reason to change places
FEWEST = 8  # cards, also where they need several columns
# Of a robot with more joints only the most loaded have cards, unless they were clicked on.
_MANY, _MAX_LOADED = 24, 12
GAP = 0.3  # between cards, of a line's height
# A hand or finger is less than this of the arm that carries it: their cards stand together.
SMALL = 0.5
NO_SHARE = -1.0  # comes after any known share
# A card takes the room of another one only if its share is larger by this factor, and this much.
_MORE = (1.25, 0.02)
_NEW_ROOM = 0.5  # of a line's height, by which robots must be farther away from a new card
_MARGIN = 0.5  # of a line's height
_LANE = 0.2  # between leaders beside a column of cards, of a line's height
_OF_LIMB = 2  # how many cards of joints the card of a limb stands for where there is little room
_OF_LOADS = (Kind.BILLBOARD, Kind.LIMB)  # kinds of which the most loaded are shown
_PLACED_BY = ("anchors", "sizes", "owners", "side", "rank")  # of `Cards`
_ROUNDS = 8  # of placing and uncrossing; panels of several sizes can need more than one
# Dark on a light scene, light on a dark one.
LEADER_RGBA = {"light": (0.09, 0.11, 0.14, 0.9), "dark": (0.62, 0.67, 0.73, 0.9)}


@dataclass(frozen=True, eq=False)
class Cards:
    """Cards of one kind, before layout.

    Attributes:
        texts: the lines of every card, top first.
        owners: robot or double that they belong to, by their order in `WorldView.owners`, (k,); -1
            for none.
        side: `LEFT` or `RIGHT`, (k,), where there is one robot; else the robot's side is taken.
        rank: vertical order, lowest first, (k,).
        share: how much each carries of what it can, (k,), `NO_SHARE` where that is unknown: where
            there is no room for all, those with the largest are shown; inf for those that always
            are.
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
    share: Array
    clear: float
    rgba: tuple[float, float, float, float] | Array = PANEL_RGBA

    def only(self, kept: Bools) -> Cards:
        """Returns those of its cards that are kept, (k,)."""
        arrays = ("items", "anchors", "sizes", "owners", "side", "rank", "share")
        parts = {name: getattr(self, name)[kept] for name in arrays}
        texts = [text for text, is_kept in zip(self.texts, kept, strict=True) if is_kept]
        rgba = self.rgba[kept] if isinstance(self.rgba, np.ndarray) else self.rgba
        return replace(self, **parts, texts=texts, rgba=rgba)


@dataclass(frozen=True, eq=False)
class _Placed:
    """Where cards are.

    Attributes:
        kept: which are shown, (k,).
        note: how many are shown, in a list; empty if all are.
        centres: of those that are shown, (m, 2), pixels.
        starts: of their leaders, (m, 2), pixels.
        bends: of their leaders, (m, 2), pixels; as `starts` where they are straight.
    """

    kept: Bools
    note: list[Panels]
    centres: Array
    starts: Array
    bends: Array


class CardLayout:
    """Places the cards of a world, and keeps their places from frame to frame.

    A card keeps its side and its place in the vertical order from frame to frame, until leaders
    cross: then two cards change places. So nothing moves to and fro at a limit. While nothing moves
    that cards depend on, they are not placed anew.

    Args:
        owner_group: as returned by `owner_groups`.
    """

    def __init__(self, owner_group: Ints) -> None:
        self._owner_group = owner_group
        self._groups_in_order: list[int] = []  # from left to right
        self._middles: dict[int, float] = {}  # by which they are sorted, pixels
        self._wanted: dict[_Key, int] = {}  # side that the robots' positions give
        self._places: dict[_Key, tuple[int, float]] = {}  # side and rank
        self._chosen: set[_Key] = set()  # where there is no room for all
        self._last: tuple[tuple[object, ...], _Placed] | None = None  # and what it followed from

    def lay_out(
        self,
        buffer: GeomBuffer,
        view: PictureView,
        groups: list[Cards],
        points: Array,
        radii: Array,
        owners: Ints,
        corners: list[Panels],
        leader_rgba: tuple[float, float, float, float] = LEADER_RGBA["light"],
    ) -> tuple[list[Cards], list[Panels], list[Panels]]:
        """Places the cards and draws their leaders.

        Where there is no room for all beside what the robots cover, or a robot has many, those
        with the largest shares are shown, but not less than a few; a note in the corner says how
        many.

        Args:
            radii: of the robot around every point, (m,), m.
            owners: index of the robot or double of every point, (m,).
            corners: panels in the corners of the picture, which cards must not cover.

        Returns:
            the cards that are shown, their panels, and the note for the corner if there is one.
        """
        groups = [group for group in groups if group.texts]
        if not groups:
            return [], [], []
        pixels, depth = view.project(points)
        is_before = depth > view.near
        pixels, of_point = pixels[is_before], self._owner_group[owners[is_before]]
        radius = (radii[is_before] / view.pixel_size(depth[is_before]))[:, None]
        keys = _keys(groups)
        share = _of_all(groups, "share")
        # Of shares only the order counts and what is known: most values change without it.
        order, is_known, is_asked = self._by_share(keys, share), share > NO_SHARE, np.isinf(share)
        arrays = [pixels, of_point, radius, order, is_known, is_asked, *view.free]
        arrays += [getattr(group, name) for group in groups for name in _PLACED_BY]
        arrays += [array for corner in corners for array in (corner.centres, corner.sizes)]
        inputs = (
            view.font,
            tuple(keys),
            tuple(float(group.clear) for group in groups),
            tuple(array.tobytes() for array in arrays),
        )
        if self._last is None or self._last[0] != inputs:
            before = self._state()
            covered = np.concatenate([pixels - radius, pixels + radius], axis=1)
            placed = self._place(view, groups, (pixels, of_point, covered), corners, order)
            is_settled = self._state() == before
            self._last = (inputs, placed) if is_settled else None
        else:
            placed = self._last[1]
        if placed.note:
            groups = _only(groups, placed.kept)
        sizes = _of_all(groups, "sizes")
        anchors = _of_all(groups, "anchors")
        draw_leaders(buffer, view, placed.starts, placed.bends, anchors, leader_rgba)
        panels = []
        first = 0
        for group in groups:
            these = slice(first, first + len(group.texts))
            panels.append(
                Panels(
                    placed.centres[these],
                    sizes[these],
                    group.texts,
                    group.rgba,
                    group.kind,
                    group.items,
                    has_values=True,
                )
            )
            first += len(group.texts)
        return groups, panels, placed.note

    def _state(self) -> tuple[object, ...]:
        kept = self._middles, self._wanted, self._places, self._chosen
        return (self._groups_in_order, *(each.copy() for each in kept))

    def _by_share(self, keys: list[_Key], share: Array) -> Ints:
        last = np.array([key in self._chosen for key in keys])
        factor, more = _MORE
        return np.argsort(
            -np.where(last, np.maximum(factor * share, share) + more, share), kind="stable"
        )

    def _place(
        self,
        view: PictureView,
        groups: list[Cards],
        body: tuple[Array, Ints, Array],
        corners: list[Panels],
        order: Ints,
    ) -> _Placed:
        """Places all cards."""
        pixels, of_point, covered = body
        gap = GAP * view.font.height
        low, high = view.free
        width, height = high - low
        covered = covered - [*low, *low]
        keys = _keys(groups)
        side, rank = self._last_places(keys, groups, pixels[:, 0], of_point, width)
        kept, note = self._choose(view, groups, side, covered, corners, order)
        corners = [*corners, *note]
        if note:
            groups = _only(groups, kept)
            keys, side, rank = _keys(groups), side[kept], rank[kept]
        kept_free = _rectangles(corners, low)
        anchors, sizes = _of_all(groups, "anchors"), _of_all(groups, "sizes")
        across = np.concatenate([pixels[:, 0], anchors[:, 0]]) - low[0]

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
                kept_free=kept_free,
                covered=covered,
            )
            return centres + low

        lane, least_gain = _LANE * view.font.height, _MIN_GAIN * view.font.height
        best: tuple[int, Ints, Array, _Placed] | None = None
        for _ in range(_ROUNDS):
            centres = place(side, rank)
            starts = _starts(centres, sizes, anchors, side)
            turns = bends(starts, anchors, centres, sizes, lane)
            tangled = tangle(starts, turns, anchors, centres - sizes / 2, centres + sizes / 2)
            if best is None or tangled < best[0]:
                best = tangled, side, rank, _Placed(kept, note, centres, starts, turns)
            changed = uncross(starts, anchors, least_gain)
            if (changed == np.arange(len(keys))).all():
                changed = uncross(turns, anchors, least_gain)
            if not tangled or (changed == np.arange(len(keys))).all():
                break
            side, rank = side[changed], rank[changed]
        assert best is not None
        _, side, rank, placed = best
        self._places.update(zip(keys, zip(side.tolist(), rank.tolist(), strict=True), strict=True))
        return placed

    def _choose(
        self,
        view: PictureView,
        groups: list[Cards],
        side: Ints,
        covered: Array,
        corners: list[Panels],
        order: Ints,
    ) -> tuple[Bools, list[Panels]]:
        low, high = view.free
        line, (width, height) = view.font.height, high - low
        sizes, share, keys = _of_all(groups, "sizes"), _of_all(groups, "share"), _keys(groups)
        asked = int(np.isinf(share).sum())
        limit = max(_most_cards(_of_all(groups, "owners")), asked)
        if is_narrow(sizes, GAP * line, width):  # leaders cross one column more than two
            limit = max(FEWEST, asked)
        first = order[:limit]

        def fitting(around: Array, corners: list[Panels], fewest: int = 0) -> tuple[int, Ints]:
            # Each of several robots has its cards on its own side, if these are not too few.
            for may_move in (False, True) if len(self._groups_in_order) > 1 else (True,):
                found = with_room(
                    sizes[first],
                    side[first],
                    GAP * line,
                    width,
                    height,
                    kept_free=_rectangles(corners, low),
                    covered=around,
                    may_move=may_move,
                )
                if found[0] >= fewest:
                    break
            return found

        def is_all(found: tuple[int, Ints]) -> bool:
            if found[0] < len(keys):
                return False
            side[order] = found[1]
            self._chosen.clear()
            return True

        everything, nothing = np.ones(len(keys), bool), np.zeros((0, 4))
        # The card of a limb has more lines than those of joints, and says as much as several.
        weights = np.where([kind == Kind.LIMB for kind, _ in keys], _OF_LIMB, 1)[order]
        few = max(int((weights.cumsum() <= FEWEST).sum()), 1)
        if len(keys) <= few and is_all(fitting(nothing, corners, len(keys))):
            return everything, []
        if not self._chosen and is_all(fitting(covered, corners)):
            return everything, []
        note = _note(view, len(keys), corners)
        corners = [*corners, note]
        # A few are shown even over robots, but never over each other.
        fewest = fitting(nothing, corners, min(few, limit))[0]
        least = max(min(fewest, max(few, asked), limit), 1)
        apart = _NEW_ROOM * line * np.array([-1, -1, 1, 1])
        count, sides = fitting(covered + apart, corners, least)
        if is_all((count, sides)):
            return everything, []
        if count < len(self._chosen):  # as many as in the last frame, if they still have room
            most, sides = fitting(covered, corners, least)
            count = min(most, len(self._chosen))
        if count < least:
            count, sides = least, fitting(nothing, corners, least)[1]
        side[first] = sides
        kept = np.zeros(len(keys), bool)
        kept[order[:count]] = True
        self._chosen = {key for key, is_kept in zip(keys, kept, strict=True) if is_kept}
        is_load = np.concatenate(
            [np.full(len(group.texts), group.kind in _OF_LOADS) for group in groups]
        )
        has_limbs = any(group.kind == Kind.LIMB for group in groups)
        text = _note_text(
            int((kept & is_load).sum()),
            int(is_load.sum()),
            is_loaded=bool((share[kept & is_load] > NO_SHARE).all()),
            what="" if has_limbs else " joints",
        )
        return kept, [replace(note, texts=[[text]])]

    def _last_places(
        self,
        keys: list[_Key],
        groups: list[Cards],
        across: Array,
        of_point: Ints,
        width: float,
    ) -> tuple[Ints, Array]:
        owner, side = _of_all(groups, "owners"), _of_all(groups, "side")
        rank = _of_all(groups, "rank").astype(float)
        group_of = np.append(self._owner_group, -1)[owner]  # -1 for no owner
        self._sort_groups(across, of_point, width)
        robots = self._groups_in_order
        if len(robots) > 1:
            counts = np.array([(group_of == group).sum() for group in robots])
            middles = np.cumsum(counts) - counts / 2
            for place, group in enumerate(robots):
                if 2 * place + 1 != len(robots):  # one in the middle has cards on both sides
                    of_left = middles[place] < counts.sum() / 2
                    side[group_of == group] = LEFT if of_left else RIGHT
        for k, key in enumerate(keys):
            if self._wanted.get(key) == side[k] and key in self._places:
                side[k], rank[k] = self._places[key]
            else:
                self._wanted[key] = int(side[k])
        return side, rank

    def _sort_groups(self, across: Array, of_point: Ints, width: float) -> None:
        for group in set(of_point.tolist()):
            middle = float(across[of_point == group].mean())
            if abs(middle - self._middles.get(group, np.inf)) > _CLOSE * width:
                self._middles[group] = middle
        self._groups_in_order = sorted(set(of_point.tolist()), key=self._middles.__getitem__)


def owner_groups(world: WorldView) -> Ints:
    """Returns the index of the robot with which the cards of every owner of joints stand.

    A double's is that of its robot; a hand's that of the arm which carries it.
    """
    names, robots = list(world.owners), world.scene.robots

    def stands_with(name: str) -> str:
        below = carrier(robots[name]) if name in robots else None
        if below not in world.robots or robots[name].reach > SMALL * robots[below].reach:
            return name
        return stands_with(below)

    return np.array(
        [
            names.index(stands_with(part.double.of if isinstance(part, DoublePart) else name))
            for name, part in world.owners.items()
        ],
        np.intp,
    )


def _keys(groups: list[Cards]) -> list[_Key]:
    return [(group.kind, int(item)) for group in groups for item in group.items]


def _of_all(groups: list[Cards], name: str) -> Any:
    return np.concatenate([getattr(group, name) for group in groups])


def _most_cards(owners: Ints) -> int:
    """Returns how many cards a picture has at most: of each owner with many `_MAX_LOADED`."""
    counts = np.unique(owners[owners >= 0], return_counts=True)[1]
    return int(np.where(counts > _MANY, _MAX_LOADED, counts).sum() + (owners < 0).sum())


def _only(groups: list[Cards], kept: Bools) -> list[Cards]:
    ends = np.cumsum([len(group.texts) for group in groups])
    parts = zip(groups, np.split(kept, ends[:-1]), strict=True)
    return [group.only(mine) for group, mine in parts if mine.any()]


def _rectangles(corners: list[Panels], origin: Array) -> Array:
    rows = np.array([np.concatenate(bounds(corner)) for corner in corners]).reshape(-1, 4)
    return rows - np.tile(origin, 2)


def _note(view: PictureView, count: int, corners: list[Panels]) -> Panels:
    margin = _MARGIN * view.font.height
    text = _note_text(count, count)  # the longest
    size = panel_sizes(np.array([view.font.width(text)]), 1, view)[0]
    right, bottom = view.free[1][0] - margin, view.free[0][1] + margin
    for corner in corners:  # above the legend, in a narrow picture
        low, high = bounds(corner)
        if high[0] > right - size[0] and low[1] < bottom + size[1]:
            bottom = high[1] + margin
    centre = np.array([right, bottom]) + size * (-0.5, 0.5)
    return Panels(centre[None], size[None], [[text]])


def _note_text(shown: int, count: int, *, is_loaded: bool = True, what: str = " joints") -> bytes:
    which = ", the most loaded" if is_loaded else ""  # of joints without data none is
    return f"cards: {shown} of {count}{what}{which}".encode()


def _starts(centres: Array, sizes: Array, anchors: Array, side: Ints) -> Array:
    half = sizes[:, 0] / 2
    beside = anchors[:, 0] - centres[:, 0]
    edge = np.where(np.abs(beside) > half, np.sign(beside), np.where(side == LEFT, 1.0, -1.0))
    return np.stack([centres[:, 0] + edge * half, centres[:, 1]], axis=1)


def move_below(right: Panels, left: Panels) -> Panels:
    """Returns the upper left corner's panels, moved below the right one's if they overlap."""
    low, _ = bounds(right)
    _, high = bounds(left)
    down = high[1] - low[1]
    if high[0] < low[0] or down <= 0:
        return left
    return replace(left, centres=left.centres - [0.0, down])


def bounds(panels: Panels) -> tuple[Array, Array]:
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
