"""`Widgets`: what panels are made of, the same in windows and on pages.

A window draws them with Dear ImGui, a page with HTML elements. A panel builds all its widgets anew
in every frame; their methods return what the user changed. `##` and the rest of a label are not
displayed, and distinguish widgets with the same label.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from ...base.frames import Array
from .status_line import Mood

Rgb = tuple[float, float, float]
# Values that a slider marks, how, and what is shown while the value is near.
Ticks = Sequence[tuple[float, Mood, str]]


class PlotLine(NamedTuple):
    """A line of a plot.

    Attributes:
        rgb: its colour, red, green and blue from 0 to 1, where the host can set it.
        x: (k,), rising.
        y: (k,), NaN for a gap.
    """

    name: str
    rgb: Rgb
    x: Array
    y: Array


class Plot(NamedTuple):
    """A plot with its lines and the ranges of its axes.

    `limits`: values of y that are marked, in the range or not.
    """

    x_unit: str
    y_label: str
    lines: Sequence[PlotLine]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    limits: Sequence[float]


class Widgets(Protocol):
    """What panels are made of; lengths are in units of the text's height.

    Attributes:
        points: of a line of a plot, at most, about.
        interval: between two updates of a plot, s.
        folds: sections that the user has folded or unfolded, by their scopes and labels: whether
            each is unfolded.
    """

    points: int
    interval: float
    folds: dict[str, bool]

    def room(self) -> tuple[float, float]: ...

    def wide(self, words: str) -> float: ...

    def text(self, words: str, mood: Mood = "plain") -> None: ...

    def label(self, words: str) -> None: ...

    def title(self, words: str) -> None: ...

    def header(self, label: str, *, is_open: bool = False) -> bool:
        """Begins a section that can be folded; returns whether it is unfolded.

        Args:
            is_open: whether it is unfolded as long as the user has said nothing, see `folds`.
        """

    def tree(self, label: str) -> bool:
        """Begins a node of a tree; returns whether it is unfolded, which `end_tree` then ends."""

    def end_tree(self) -> None: ...

    def table(self, name: str, widths: Sequence[float]) -> bool:
        """Begins a table; returns whether it is seen, which `end_table` then ends.

        Args:
            widths: of the columns; 0 for one that takes what is left, or its share of it.
        """

    def row(self) -> None: ...

    def cell(self) -> None: ...

    def end_table(self) -> None: ...

    def scope(self, name: str) -> None: ...

    def end_scope(self) -> None: ...

    def same_line(self, left: float = 0.0, gap: float = -1.0) -> None:
        """Puts the next widget beside the last one.

        Args:
            gap: distance from the last one; -1 for the usual.
        """

    def width(self, width: float) -> None:
        """Sets the width of the next widget; 0 for all that is left."""

    def tip(self, words: str) -> None: ...

    def disable(self, *, is_off: bool) -> None:
        """Begins widgets that are greyed and take no input, if `is_off`; `enable` ends them."""

    def enable(self) -> None: ...

    def button(self, label: str, width: float = 0.0) -> bool:
        """Builds a button; returns whether it was pressed."""

    def select(self, label: str, *, is_lit: bool) -> bool:
        """Builds a text that can be clicked on; returns whether it was."""

    def search(self, label: str, text: str, hint: str) -> str:
        """Builds a field for a text; returns what is in it.

        Args:
            hint: what it shows while it is empty.
        """

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        """Builds a check box; returns whether it was changed, and whether it is on."""

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        """Builds a list to choose from; returns whether it was changed, and the chosen index."""

    def slide(
        self, label: str, value: float, low: float, high: float, text: str, ticks: Ticks = ()
    ) -> tuple[bool, float]:
        """Builds a slider; returns whether it was moved, and its value.

        Args:
            text: printf's format of the value, `%.1f deg`; empty to show none.
            ticks: values that are marked, how, and what is told while the value is near.
        """

    def plot(self, plot: Plot, height: float) -> None: ...

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        """Builds a field for a number; returns whether one was typed to the end, and it."""

    def lines(self, label: str, text: str, count: int) -> None: ...

    def copy(self, text: str) -> None: ...
