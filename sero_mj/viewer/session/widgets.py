"""`Widgets`: the interface of the widgets of panels, which is the same for windows and pages.

Windows draw widgets with Dear ImGui, and pages show HTML elements. A panel builds all its widgets
in every frame, and the methods return the user's changes. A label may end in `##` and an
identifier, which is not displayed and distinguishes widgets with the same label.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

from ...base.frames import Array
from .status_line import Mood

Rgb = tuple[float, float, float]
# Marks of a slider: value, mood, and text that is shown while the slider is near this value.
Ticks = Sequence[tuple[float, Mood, str]]


class PlotLine(NamedTuple):
    """A line of a plot.

    Attributes:
        rgb: color components, 0 to 1.
        x: x coordinates, shape (k,), increasing.
        y: y coordinates, shape (k,), NaN for a gap.
    """

    name: str
    rgb: Rgb
    x: Array
    y: Array


class Plot(NamedTuple):
    """A plot, with lines and the ranges of the axes.

    `limits` are y values that are marked if they are within the range.
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
        points: approximate maximum number of points in a line of a plot.
        interval: time between two updates of a plot, s.
        folds: whether a section is open, for each section that the user has opened or closed, by
            scopes and label.
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
        """Begins a foldable section; returns whether the section is open.

        Args:
            is_open: initial state, until the user opens or closes the section, see `folds`.
        """

    def tree(self, label: str) -> bool:
        """Begins a node of a tree. Returns whether the node is open; then call `end_tree`."""

    def end_tree(self) -> None: ...

    def table(self, name: str, widths: Sequence[float]) -> bool:
        """Begins a table. Returns whether the table is visible; then call `end_table`.

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
            left: position of the left edge; 0 for directly beside the last widget.
            gap: distance from the last widget; -1 for the default.
        """

    def width(self, width: float) -> None:
        """Sets the width of the next widget; 0 for all remaining width."""

    def tip(self, words: str) -> None: ...

    def disable(self, *, is_off: bool) -> None:
        """Grays out the widgets up to the call of `enable` if `is_off`."""

    def enable(self) -> None: ...

    def button(self, label: str, width: float = 0.0) -> bool:
        """Returns whether the button was pressed."""

    def select(self, label: str, *, is_lit: bool) -> bool:
        """Builds a clickable text; returns whether the text was clicked."""

    def search(self, label: str, text: str, hint: str) -> str:
        """Builds a text field; returns the text in the field.

        Args:
            hint: text that is shown while the field is empty.
        """

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        """Builds a check box; returns whether the user has changed it, and whether it is on."""

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        """Builds a drop-down list; returns whether the user has chosen, and the chosen index."""

    def slide(
        self, label: str, value: float, low: float, high: float, text: str, ticks: Ticks = ()
    ) -> tuple[bool, float]:
        """Builds a slider; returns whether the user has moved it, and the value.

        Args:
            text: printf format of the value, such as `%.1f deg`; an empty string shows no value.
        """

    def plot(self, plot: Plot, height: float) -> None: ...

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        """Builds a number field; returns whether a number was entered, and the number."""

    def lines(self, label: str, text: str, count: int) -> None: ...

    def copy(self, text: str) -> None: ...
