"""`Widgets`: the widgets of panels, the same in windows and on pages.

Windows draw them with Dear ImGui, and pages with HTML elements. A panel builds all its widgets in
every frame; the methods return what the user has changed. `##` and the rest of a label are not
displayed and distinguish widgets with the same label.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from ...base.frames import Array
from .status_line import Mood

Rgb = tuple[float, float, float]
# Marks of a slider: value, mood, and the text that is shown while the value is near.
Ticks = Sequence[tuple[float, Mood, str]]


class PlotLine(NamedTuple):
    """A line of a plot.

    Attributes:
        rgb: color, 0 to 1.
        x: (k,), increasing.
        y: (k,), NaN for a gap.
    """

    name: str
    rgb: Rgb
    x: Array
    y: Array


class Plot(NamedTuple):
    """A plot with its lines and the ranges of its axes.

    `limits` are values of y that are marked if they are in the range.
    """

    x_unit: str
    y_label: str
    lines: Sequence[PlotLine]
    x_range: tuple[float, float]
    y_range: tuple[float, float]
    limits: Sequence[float]


class Widgets(Protocol):
    """Builds the widgets of a panel; lengths are in units of the text height.

    Attributes:
        points: approximate maximum number of points of a plotted line.
        interval: time between two updates of a plot, s.
        folds: whether each section that the user has opened or closed is open, by scopes and label.
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
        """Begins a foldable section; returns whether it is open.

        Args:
            is_open: whether it is open until the user opens or closes it, see `folds`.
        """

    def tree(self, label: str) -> bool:
        """Begins a node of a tree; returns whether it is open and must be ended by `end_tree`."""

    def end_tree(self) -> None: ...

    def table(self, name: str, widths: Sequence[float]) -> bool:
        """Begins a table; returns whether it is visible and must be ended by `end_table`.

        Args:
            widths: widths of the columns; 0 for a share of the remaining width.
        """

    def row(self) -> None: ...

    def cell(self) -> None: ...

    def end_table(self) -> None: ...

    def scope(self, name: str) -> None: ...

    def end_scope(self) -> None: ...

    def same_line(self, left: float = 0.0, gap: float = -1.0) -> None:
        """Puts the next widget beside the last one.

        Args:
            left: left edge; 0 for beside the last widget.
            gap: distance from the last widget; -1 for the default.
        """

    def width(self, width: float) -> None:
        """Sets the width of the next widget; 0 for all remaining width."""

    def tip(self, words: str) -> None: ...

    def disable(self, *, is_off: bool) -> None:
        """Begins widgets that are grayed out if `is_off`, until `enable`."""

    def enable(self) -> None: ...

    def button(self, label: str, width: float = 0.0) -> bool:
        """Returns whether the button was pressed."""

    def select(self, label: str, *, is_lit: bool) -> bool:
        """Builds a text that can be clicked; returns whether it was clicked."""

    def search(self, label: str, text: str, hint: str) -> str:
        """Builds a text field; returns its text.

        Args:
            hint: text that is shown while the field is empty.
        """

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        """Builds a check box; returns whether it was changed, and whether it is on."""

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        """Builds a drop-down list; returns whether the choice was changed, and its index."""

    def slide(
        self, label: str, value: float, low: float, high: float, text: str, ticks: Ticks = ()
    ) -> tuple[bool, float]:
        """Builds a slider; returns whether it was moved, and its value.

        Args:
            text: printf format of the value, such as `%.1f deg`; empty for none.
        """

    def plot(self, plot: Plot, height: float) -> None: ...

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        """Builds a number field; returns whether a number was entered, and the number."""

    def lines(self, label: str, text: str, count: int) -> None: ...

    def copy(self, text: str) -> None: ...
