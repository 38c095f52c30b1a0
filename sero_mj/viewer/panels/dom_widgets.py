"""`DomWidgets`: the widgets of pages, as a tree of nodes that the browser shows as HTML elements.

A panel is rebuilt for each update, as in windows. A user action is stored until its widget is built
again. The call that builds the widget returns the action.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...base.frames import Array
from ..session.status_line import Mood
from ..session.widgets import Plot, Ticks

Node = dict[str, Any]

_CHARACTER = 0.52  # mean width of a character, in text heights
_DIGITS = 5  # significant digits of numbers in plots
# Heights of `panels.css` in text heights: a line of widgets, a line of text, the gap below a plot.
_LINE, _TEXT_LINE, _GAP = 2.3, 1.45, 0.3


class _Tree:
    def __init__(self) -> None:
        self.folds: dict[str, bool] = {}
        self._is_open: dict[str, bool] = {}  # state of nodes that the user has opened or closed
        self._sections: set[str] = set()  # ids of foldable sections
        self._branches: set[str] = set()  # ids of foldable nodes
        self._widgets: set[str] = set()  # ids of the widgets of the last built panel
        self._done: dict[str, Any] = {}  # maps ids of widgets to values that the user has set
        self._begin((0.0, 0.0))

    def _begin(self, size: tuple[float, float]) -> None:
        self._size = size
        self._nodes: list[Node] = []
        self._into = [self._nodes]  # open lists of nodes, the innermost last
        self._tables: list[Node] = []
        self._scopes: list[str] = []
        self._ids: dict[str, int] = {}
        self._off: list[bool] = []
        self._next: Node = {}  # placement and width of the next node

    def act(self, id_: str, value: Any) -> None:
        """Stores the action of a user on a widget, and ignores unknown ids."""
        if id_ in self._widgets:
            self._done[id_] = value

    def fold(self, id_: str, *, is_open: bool) -> None:
        """Opens or closes a section or node, and ignores unknown ids."""
        if id_ in self._sections:
            self.folds[id_] = is_open
        elif id_ in self._branches:
            self._is_open[id_] = is_open

    def tree_of(self, build: Callable[[], object], size: tuple[float, float]) -> list[Node]:
        """Returns the nodes of a panel.

        Args:
            build: function that builds the panel.
            size: width and height of the panel, in text heights.
        """
        self._begin(size)
        self._widgets = set()
        build()
        self._done.clear()  # this also removes actions on widgets that are no longer shown
        return self._nodes

    def _id(self, label: str) -> str:
        name = label.partition("###")[2] or label
        id_ = "/".join([*self._scopes, name])
        count = self._ids[id_] = self._ids.get(id_, 0) + 1
        return id_ if count == 1 else f"{id_}#{count}"

    def _put(self, kind: str, **keys: Any) -> Node:
        node = {"k": kind, **keys, **self._next}
        if any(self._off):
            node["off"] = True
        self._next = {}
        self._into[-1].append(node)
        return node

    def _widget(self, kind: str, label: str, **keys: Any) -> tuple[bool, Any]:
        id_, shown = self._id(label), label.partition("##")[0]
        words = {"s": shown} if shown else {"s": "", "aria": label.strip("#")}
        self._put(kind, id=id_, **words, **keys)
        self._widgets.add(id_)
        is_done = id_ in self._done and not any(self._off)
        return is_done, self._done.pop(id_, None)


class DomWidgets(_Tree):
    """An implementation of `Widgets` for pages. Its nodes are read by `js/src/panels.js`.

    Args:
        to_clipboard: function that copies a text to the clipboard of the browser in control.
    """

    points, interval = 320, 1.0 / 15.0

    def __init__(self, to_clipboard: Callable[[str], None]) -> None:
        super().__init__()
        self.copy = to_clipboard

    def room(self) -> tuple[float, float]:
        width, height = self._size
        return width, max(height - _height_of(self._nodes, width), 0.0)

    def wide(self, words: str) -> float:
        return _CHARACTER * len(words)

    def text(self, words: str, mood: Mood = "plain") -> None:
        self._put("text", s=words, mood=mood)

    def label(self, words: str) -> None:
        self._put("label", s=words)

    def title(self, words: str) -> None:
        self._put("title", s=words)

    def header(self, label: str, *, is_open: bool = False) -> bool:
        self._into = [self._nodes]
        id_ = self._id(label)
        self._sections.add(id_)
        return self._foldable("header", label, id_, is_open=self.folds.get(id_, is_open))

    def tree(self, label: str) -> bool:
        id_ = self._id(label)
        self._branches.add(id_)
        is_open = self._foldable("tree", label, id_, is_open=self._is_open.get(id_, False))
        if is_open:
            self._scopes.append(label)
        return is_open

    def _foldable(self, kind: str, label: str, id_: str, *, is_open: bool) -> bool:
        nodes, shown = list[Node](), label.partition("##")[0]
        self._put(kind, id=id_, s=shown, open=is_open, nodes=nodes)
        if is_open:
            self._into.append(nodes)
        return is_open

    def end_tree(self) -> None:
        self._into.pop()
        self._scopes.pop()

    def table(self, name: str, widths: Sequence[float]) -> bool:
        node = self._put("table", id=self._id(name), widths=list(widths), rows=[])
        self._tables.append(node)
        self._scopes.append(name)
        self._into.append([])
        return True

    def row(self) -> None:
        self._tables[-1]["rows"].append([])

    def cell(self) -> None:
        nodes: list[Node] = []
        self._tables[-1]["rows"][-1].append(nodes)
        self._into[-1] = nodes

    def end_table(self) -> None:
        self._tables.pop()
        self._scopes.pop()
        self._into.pop()

    def scope(self, name: str) -> None:
        self._scopes.append(name)

    def end_scope(self) -> None:
        self._scopes.pop()

    def same_line(self, left: float = 0.0, gap: float = -1.0) -> None:
        self._next["same"] = gap
        if left:
            self._next["left"] = left

    def width(self, width: float) -> None:
        self._next["width"] = width

    def tip(self, words: str) -> None:
        self._into[-1][-1]["tip"] = words

    def disable(self, *, is_off: bool) -> None:
        self._off.append(is_off)

    def enable(self) -> None:
        self._off.pop()

    def button(self, label: str, width: float = 0.0) -> bool:
        if width:
            self._next["width"] = width
        return self._widget("button", label)[0]

    def select(self, label: str, *, is_lit: bool) -> bool:
        return self._widget("select", label, lit=is_lit)[0]

    def search(self, label: str, text: str, hint: str) -> str:
        is_done, typed = self._widget("search", label, text=text, hint=hint)
        return typed if is_done and isinstance(typed, str) else text

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        is_done, now = self._widget("check", label, on=bool(is_on))
        return (True, bool(now)) if is_done else (False, is_on)

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        is_done, now = self._widget("choose", label, index=int(index), names=list(names))
        if is_done and isinstance(now, int) and 0 <= now < len(names):
            return True, now
        return False, index

    def slide(
        self, label: str, value: float, low: float, high: float, text: str, ticks: Ticks = ()
    ) -> tuple[bool, float]:
        shown = (text % value if "%" in text else text) if text else ""
        ends = {"low": float(low), "high": float(high)}
        marks = {"ticks": [[float(at), mood, words] for at, mood, words in ticks]} if ticks else {}
        is_done, now = self._widget(
            "slide", label, value=_number(value, low), **ends, text=shown, **marks
        )
        if is_done and _is_number(now):
            return True, min(max(float(now), low), high)
        return False, value

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        is_done, now = self._widget("number", label, value=_number(value, 0.0), text=text % value)
        return (True, float(now)) if is_done and _is_number(now) else (False, value)

    def lines(self, label: str, text: str, count: int) -> None:
        self._put("lines", id=self._id(label), text=text, count=count)

    def plot(self, plot: Plot, height: float) -> None:
        self._put(
            "plot",
            id=self._id(plot.y_label),
            y=plot.y_label,
            x=plot.x_unit,
            xRange=list(plot.x_range),
            yRange=list(plot.y_range),
            limits=[float(each) for each in plot.limits if np.isfinite(each)],
            height=height,
            lines=[
                {"name": line.name, "rgb": line.rgb, "x": _short(line.x), "y": _short(line.y)}
                for line in plot.lines
            ],
        )


def _height_of(nodes: Sequence[Node], width: float) -> float:
    """Returns the approximate height of nodes in a panel, in text heights."""
    height = last = 0.0
    for node in nodes:
        own = _LINE
        if node["k"] == "plot":
            own = node["height"] + _GAP
        elif node["k"] == "text":
            lines = sum(len(part) * _CHARACTER // width + 1 for part in node["s"].split("\n"))
            own = lines * _TEXT_LINE + _GAP
        elif node["k"] == "table":
            own = sum(max((_height_of(cell, width) for cell in row), default=0.0)
                      for row in node["rows"])  # fmt: skip
        elif node["k"] == "lines":
            own = node["count"] * _TEXT_LINE + _GAP
        own += _height_of(node.get("nodes", ()), width)
        if "same" in node:  # beside the previous node
            height += max(own - last, 0.0)
            last = max(own, last)
        else:
            height, last = height + own, own
    return height


def _is_number(value: Any) -> bool:
    try:
        return isinstance(value, int | float) and math.isfinite(value)
    except OverflowError:  # an integer that exceeds float
        return False


def _number(value: float, otherwise: float) -> float:
    return float(value) if np.isfinite(value) else float(otherwise)


def _short(values: Array) -> list[float | None]:
    return [float(f"{v:.{_DIGITS}g}") if np.isfinite(v) else None for v in values.tolist()]
