"""Scripted widgets of a panel, which log their calls and return the values of a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sero_mj.viewer.session.widgets import Ticks


class ScriptedWidgets:
    """An implementation of `Widgets` in which all sections and nodes are open.

    Args:
        does: input of the user: values by label of the widget, or by path (the labels of sections,
            nodes and the widget, separated by slashes); `True` for a button.
        size: width and height of the panel in units of the text height.

    Attributes:
        built: kind and label of all widgets, in order.
        ways: paths of sections and nodes.
        disabled: labels of disabled widgets.
        lit: labels of selected widgets.
        copied: text that was last copied to the clipboard.
        ticks: ticks of the last slider.
        plots: all plots.
    """

    points, interval = 980, 0.0

    def __init__(
        self, does: Mapping[str, Any] | None = None, size: tuple[float, float] = (40.0, 40.0)
    ) -> None:
        self.size = size
        self.ticks: list[tuple[float, str, str]] = []
        self.plots: list[Any] = []
        self._does = dict(does or {})
        self.built: list[tuple[str, str]] = []
        self.ways: list[str] = []
        self.disabled: list[str] = []
        self.lit: list[str] = []
        self.copied = ""
        self._way: list[str] = []
        self._is_off: list[bool] = []

    def _done(self, kind: str, label: str, now: Any) -> tuple[bool, Any]:
        self.built.append((kind, label))
        if any(self._is_off):
            self.disabled.append(label)
            return False, now
        for key in ("/".join([*self._way, label]), label):
            if key in self._does:
                return True, self._does[key]
        return False, now

    def texts(self) -> list[str]:
        """Returns all texts in order."""
        return [label for kind, label in self.built if kind == "text"]

    def text(self, words: str, mood: str = "plain") -> None:
        self.built.append(("text", words))

    def label(self, words: str) -> None:
        self.built.append(("text", words))

    def title(self, words: str) -> None:
        self.built.append(("title", words))

    def header(self, label: str, *, is_open: bool = False) -> bool:
        self._way = [label]
        self.built.append(("header", label))
        self.ways.append(label)
        return True

    def tree(self, label: str) -> bool:
        self._way.append(label)
        self.built.append(("tree", label))
        self.ways.append("/".join(self._way))
        return True

    def end_tree(self) -> None:
        self._way.pop()

    def table(self, name: str, widths: Sequence[float]) -> bool:
        return True

    def room(self) -> tuple[float, float]:
        return self.size

    def wide(self, words: str) -> float:
        return 0.5 * len(words)

    def button(self, label: str, width: float = 0.0) -> bool:
        return self._done("button", label, False)[0]

    def select(self, label: str, *, is_lit: bool) -> bool:
        self.lit += [label] * is_lit
        return self._done("select", label, False)[0]

    def search(self, label: str, text: str, hint: str) -> str:
        return str(self._done("search", label, text)[1])

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        return self._done("check", label, is_on)

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        changed, chosen = self._done("choose", label, index)
        return changed, names.index(chosen) if isinstance(chosen, str) else chosen

    def slide(
        self, label: str, value: float, low: float, high: float, text: str, ticks: Ticks = ()
    ) -> tuple[bool, float]:
        self.ticks = list(ticks)
        return self._done("slide", label, value)

    def plot(self, plot: Any, height: float) -> None:
        self.plots.append(plot)
        self.built.append(("plot", plot.y_label))

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        return self._done("number", label, value)

    def lines(self, label: str, text: str, count: int) -> None:
        self.built.append(("lines", text))

    def copy(self, text: str) -> None:
        self.copied = text

    def disable(self, *, is_off: bool) -> None:
        self._is_off.append(is_off)

    def enable(self) -> None:
        self._is_off.pop()

    def row(self) -> None: ...

    def cell(self) -> None: ...

    def end_table(self) -> None: ...

    def scope(self, name: str) -> None: ...

    def end_scope(self) -> None: ...

    def same_line(self, left: float = 0.0, gap: float = -1.0) -> None: ...

    def width(self, width: float) -> None: ...

    def tip(self, words: str) -> None: ...
