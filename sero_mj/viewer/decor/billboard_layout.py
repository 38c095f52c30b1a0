"""Billboards: panels beside the robots, with a leader line to the item they describe.

Each robot's cards stand on its own side of the picture; a single robot, or one in the middle, has
cards on both sides. Their heights follow the joints continuously; a card changes its place only
where leaders would cross, or where a robot gets behind it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import DoublePart
from ...robots.assemble.world_view import WorldView
from ...robots.declared.mounts import carrier
from .geom_buffer import GeomBuffer, Kind
from .image_view import ImageView
from .layout import LEFT, RIGHT, bends, columns, is_narrow, tangle, uncross, with_room
from .panels import PANEL_RGBA, Panels, draw_leaders, panel_sizes

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
_ROUNDS = 8  # of placing and uncrossing; panels of several sizes can need more than one
# Dark on a light scene, light on a dark one.
LEADER_RGBA = {"light": (0.09, 0.11, 0.14, 0.9), "dark": (0.62, 0.67, 0.73, 0.9)}


@dataclass(frozen=True, eq=False)
class BillboardGroup:
    """BillboardGroup of one kind, before layout.

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

    def only(self, kept: Bools) -> BillboardGroup:
        """Returns those of its cards that are kept, (k,)."""
        arrays = ("items", "anchors", "sizes", "owners", "side", "rank", "share")
        parts = {name: getattr(self, name)[kept] for name in arrays}
        texts = [text for text, is_kept in zip(self.texts, kept, strict=True) if is_kept]
        rgba = self.rgba[kept] if isinstance(self.rgba, np.ndarray) else self.rgba
        return replace(self, **parts, texts=texts, rgba=rgba)


@dataclass(frozen=True, eq=False)
class _AllCards:
    """BillboardGroup of all kinds as one, in the order of their groups."""

    groups: list[BillboardGroup]
    keys: list[_Key]
    anchors: Array
    sizes: Array
    owners: Ints
    side: Ints
    rank: Array
    share: Array

    @classmethod
    def of(cls, groups: list[BillboardGroup]) -> _AllCards:
        def joined(name: str) -> Any:
            return np.concatenate([getattr(group, name) for group in groups])

        keys = [(group.kind, int(item)) for group in groups for item in group.items]
        arrays = {name: joined(name) for name in ("anchors", "sizes", "owners", "side", "share")}
        return cls(groups, keys, **arrays, rank=joined("rank").astype(float))

    @property
    def is_asked(self) -> Bools:
        return np.isinf(self.share)

    def only(self, kept: Bools) -> _AllCards:
        """Returns the cards that are kept, (k,), with their current sides and ranks."""
        ends = np.cumsum([len(group.texts) for group in self.groups])
        parts = zip(self.groups, np.split(kept, ends[:-1]), strict=True)
        found = _AllCards.of([group.only(mine) for group, mine in parts if mine.any()])
        return replace(found, side=self.side[kept], rank=self.rank[kept])


@dataclass
class _Memory:
    """What is kept from frame to frame, so that no card moves to and fro at a limit.

    Attributes:
        order: robots from left to right.
        middles: by which they are sorted, pixels.
        wanted: side of a card that the robots' positions give.
        places: side and rank of a card.
        chosen: the cards that were shown where there was no room for all.
    """

    order: list[int] = field(default_factory=list)
    middles: dict[int, float] = field(default_factory=dict)
    wanted: dict[_Key, int] = field(default_factory=dict)
    places: dict[_Key, tuple[int, float]] = field(default_factory=dict)
    chosen: set[_Key] = field(default_factory=set)

    def copy(self) -> _Memory:
        return _Memory(
            self.order,
            self.middles.copy(),
            self.wanted.copy(),
            self.places.copy(),
            self.chosen.copy(),
        )

    def sort_robots(self, across: Array, of_point: Ints, width: float) -> None:
        """Sorts the robots from left to right; small moves change nothing."""
        robots = set(of_point.tolist())
        for robot in robots:
            middle = float(across[of_point == robot].mean())
            if abs(middle - self.middles.get(robot, np.inf)) > _CLOSE * width:
                self.middles[robot] = middle
        self.order = sorted(robots, key=self.middles.__getitem__)

    def recall(self, cards: _AllCards) -> None:
        """Gives cards their last sides and ranks, unless another side is wanted now."""
        for k, key in enumerate(cards.keys):
            if self.wanted.get(key) == cards.side[k] and key in self.places:
                cards.side[k], cards.rank[k] = self.places[key]
            else:
                self.wanted[key] = int(cards.side[k])


@dataclass(frozen=True, eq=False)
class _Placed:
    """Where the cards are that are shown, and their leaders, (m, 2) each, pixels.

    Attributes:
        note: how many are shown, in a list; empty if all are.
        bends: of the leaders; as `starts` where they are straight.
    """

    cards: _AllCards
    kept: Bools
    note: list[Panels]
    centres: Array
    starts: Array
    bends: Array

    def panels(self, groups: list[BillboardGroup]) -> list[Panels]:
        counts = [len(group.texts) for group in groups]
        centres = np.split(self.centres, np.cumsum(counts)[:-1])
        return [
            Panels(
                middle, each.sizes, each.texts, each.rgba, each.kind, each.items, has_values=True
            )
            for middle, each in zip(centres, groups, strict=True)
        ]


@dataclass(frozen=True, eq=False)
class _Body:
    """What the robots cover: pixels of points (m, 2), their robots, and rectangles (m, 4)."""

    pixels: Array
    robots: Ints
    covered: Array


class BillboardLayout:
    """Places the cards of a world, and keeps their places from frame to frame.

    A card keeps its side and its place in the vertical order from frame to frame, until leaders
    cross: then two cards change places. While nothing moves that cards depend on, they are not
    placed anew: of a frame that takes 8 ms of an LWR at 1280x800 (24 ms of Justin) that saves 6 ms
    (8 ms).

    Args:
        owner_group: as returned by `owner_groups`.
    """

    def __init__(self, owner_group: Ints) -> None:
        self._owner_group = owner_group
        self._memory = _Memory()
        self._last: tuple[tuple[object, ...], _Placed] | None = None  # and what it followed from

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
        cards = _AllCards.of(groups)
        pixels, depth = view.project(points)
        is_before = depth > view.near
        pixels, robots = pixels[is_before], self._owner_group[owners[is_before]]
        radius = (radii[is_before] / view.pixel_size(depth[is_before]))[:, None]
        body = _Body(pixels, robots, np.concatenate([pixels - radius, pixels + radius], axis=1))
        order = self._by_share(cards)
        # Of shares only the order counts and what is known: most values change without it.
        arrays = [body.pixels, body.robots, radius, order, cards.share > NO_SHARE, cards.is_asked]
        arrays += [cards.anchors, cards.sizes, cards.owners, cards.side, cards.rank, *view.free]
        arrays += [array for corner in corners for array in (corner.centres, corner.sizes)]
        clear = tuple(float(group.clear) for group in groups)
        contents = tuple(array.tobytes() for array in arrays)
        inputs = (view.font, tuple(cards.keys), clear, contents)
        if self._last is None or self._last[0] != inputs:
            before = self._memory.copy()
            placed = self._place(view, cards, body, corners, order)
            self._last = (inputs, placed) if self._memory == before else None
        else:
            placed = self._last[1]
        if placed.note:
            groups = cards.only(placed.kept).groups
        anchors = placed.cards.anchors
        draw_leaders(buffer, view, placed.starts, placed.bends, anchors, leader_rgba)
        return groups, placed.panels(groups), placed.note

    def _by_share(self, cards: _AllCards) -> Ints:
        """Returns the order in which cards get room, (k,); those shown last come a bit earlier."""
        last = np.array([key in self._memory.chosen for key in cards.keys])
        factor, more = _MORE
        share = cards.share
        wanted = np.where(last, np.maximum(factor * share, share) + more, share)
        return np.argsort(-wanted, kind="stable")

    def _place(
        self,
        view: ImageView,
        cards: _AllCards,
        body: _Body,
        corners: list[Panels],
        order: Ints,
    ) -> _Placed:
        low, high = view.free
        width, height = high - low
        covered = body.covered - [*low, *low]
        self._memory.sort_robots(body.pixels[:, 0], body.robots, width)
        self._set_sides(cards)
        self._memory.recall(cards)
        kept, note = self._choose(view, cards, covered, corners, order)
        if note:
            cards = cards.only(kept)
        anchors, sizes, gap = cards.anchors, cards.sizes, GAP * view.font.height
        across = np.concatenate([body.pixels[:, 0], anchors[:, 0]]) - low[0]
        span = max(float(across.min()), 0.0), min(float(across.max()), width)
        beside = min(max(3 * gap, *(group.clear for group in cards.groups)), width / 6)
        kept_free = _rectangles([*corners, *note], low)
        lane, least_gain = _LANE * view.font.height, _MIN_GAIN * view.font.height
        side, rank, same = cards.side, cards.rank, np.arange(len(cards.keys))
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
                covered=covered,
            )
            starts = _starts(centres, sizes, anchors, side)
            turns = bends(starts, anchors, centres, sizes, lane)
            tangled = tangle(starts, turns, anchors, centres - sizes / 2, centres + sizes / 2)
            if best is None or tangled < best[0]:
                best = tangled, side, rank, _Placed(cards, kept, note, centres, starts, turns)
            changed = uncross(starts, anchors, least_gain)
            if (changed == same).all():
                changed = uncross(turns, anchors, least_gain)
            if not tangled or (changed == same).all():
                break
            side, rank = side[changed], rank[changed]
        assert best is not None
        _, side, rank, placed = best
        places = zip(side.tolist(), rank.tolist(), strict=True)
        self._memory.places.update(zip(cards.keys, places, strict=True))
        return placed

    def _set_sides(self, cards: _AllCards) -> None:
        """Gives the cards of several robots the sides of these, about equally many on each."""
        robots = self._memory.order
        if len(robots) < 2:
            return
        of_card = np.append(self._owner_group, -1)[cards.owners]  # -1 for no owner
        counts = np.array([(of_card == robot).sum() for robot in robots])
        middles = np.cumsum(counts) - counts / 2
        for place, robot in enumerate(robots):
            if 2 * place + 1 != len(robots):  # one in the middle has cards on both sides
                is_left = middles[place] < counts.sum() / 2
                cards.side[of_card == robot] = LEFT if is_left else RIGHT

    def _choose(
        self,
        view: ImageView,
        cards: _AllCards,
        covered: Array,
        corners: list[Panels],
        order: Ints,
    ) -> tuple[Bools, list[Panels]]:
        """Returns which cards are shown, (k,), and a note of how many, in a list; none for all.

        They are those with the largest shares in the whole image. Billboards whose side has no room
        may change to the other one.
        """
        memory, count_all = self._memory, len(cards.keys)
        asked, limit = int(cards.is_asked.sum()), _most_cards(cards, view)
        first = order[:limit]
        fitting = partial(self._fitting, view, cards, first)
        everything, nothing = np.ones(count_all, bool), np.zeros((0, 4))

        def is_all(found: tuple[int, Ints]) -> bool:
            if found[0] < count_all:
                return False
            cards.side[order] = found[1]
            memory.chosen.clear()
            return True

        # The card of a limb has more lines than those of joints, and says as much as several.
        weights = np.where([kind == Kind.LIMB for kind, _ in cards.keys], _OF_LIMB, 1)[order]
        few = max(int((weights.cumsum() <= FEWEST).sum()), 1)
        if count_all <= few and is_all(fitting(nothing, corners, count_all)):
            return everything, []
        if not memory.chosen and is_all(fitting(covered, corners)):
            return everything, []
        note = _note(view, count_all, corners)
        corners = [*corners, note]
        # A few are shown even over robots, but never over each other.
        fewest = fitting(nothing, corners, min(few, limit))[0]
        least = max(min(fewest, max(few, asked), limit), 1)
        apart = _NEW_ROOM * view.font.height * np.array([-1, -1, 1, 1])
        count, sides = fitting(covered + apart, corners, least)
        if is_all((count, sides)):
            return everything, []
        if count < len(memory.chosen):  # as many as in the last frame, if they still have room
            most, sides = fitting(covered, corners, least)
            count = min(most, len(memory.chosen))
        if count < least:
            count, sides = least, fitting(nothing, corners, least)[1]
        cards.side[first] = sides
        kept = np.zeros(count_all, bool)
        kept[order[:count]] = True
        memory.chosen = {key for key, is_kept in zip(cards.keys, kept, strict=True) if is_kept}
        return kept, [replace(note, texts=[[_text_of(cards, kept)]])]

    def _fitting(
        self,
        view: ImageView,
        cards: _AllCards,
        first: Ints,
        covered: Array,
        corners: list[Panels],
        fewest: int = 0,
    ) -> tuple[int, Ints]:
        """Returns for how many of the first cards there is room, and their sides.

        Each of several robots has its cards on its own side, if these are not too few.
        """
        low, high = view.free
        width, height = high - low
        for may_move in (False, True) if len(self._memory.order) > 1 else (True,):
            found = with_room(
                cards.sizes[first],
                cards.side[first],
                GAP * view.font.height,
                width,
                height,
                kept_free=_rectangles(corners, low),
                covered=covered,
                may_move=may_move,
            )
            if found[0] >= fewest:
                break
        return found


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


def _most_cards(cards: _AllCards, view: ImageView) -> int:
    """Returns how many cards a picture has at most: of each owner with many `_MAX_LOADED`."""
    asked, (low, high) = int(cards.is_asked.sum()), view.free
    if is_narrow(cards.sizes, GAP * view.font.height, high[0] - low[0]):
        return max(FEWEST, asked)  # leaders cross one column more than two
    owners = cards.owners
    counts = np.unique(owners[owners >= 0], return_counts=True)[1]
    most = np.where(counts > _MANY, _MAX_LOADED, counts).sum() + (owners < 0).sum()
    return max(int(most), asked)


def _rectangles(corners: list[Panels], origin: Array) -> Array:
    rows = np.array([np.concatenate(bounds(corner)) for corner in corners]).reshape(-1, 4)
    return rows - np.tile(origin, 2)


def _note(view: ImageView, count: int, corners: list[Panels]) -> Panels:
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
    return f"billboards: {shown} of {count}{what}{which}".encode()


def _text_of(cards: _AllCards, kept: Bools) -> bytes:
    is_load = np.array([kind in _OF_LOADS for kind, _ in cards.keys])
    has_limbs = any(kind == Kind.LIMB for kind, _ in cards.keys)
    return _note_text(
        int((kept & is_load).sum()),
        int(is_load.sum()),
        is_loaded=bool((cards.share[kept & is_load] > NO_SHARE).all()),
        what="" if has_limbs else " joints",
    )


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
