"""Widgets that a program adds to a view: slider, number, check box, choice, button and text.

A widget is checked by the program and built by the view, in another process; it has no state.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, Protocol, TypeVar

from ...base.errors import UsageError, did_you_mean, shown
from ..session.widgets import Widgets

Value = TypeVar("Value")

_WIDTH = 9.0  # of sliders and fields, of the text's height; their labels are beside them
_DIGITS = 7  # significant ones of a slider's value, which is a float32


class UserWidget(Protocol[Value]):
    """A widget; equal ones look the same.

    Attributes:
        label: unique in its panel.
    """

    @property
    def label(self) -> str: ...

    def checked(self, value: object) -> Value:
        """Returns a value as it is shown; raises UsageError if it is none of this widget."""

    def build(self, ui: Widgets, value: Value) -> object:
        """Builds the widget; returns what its user has set, None for nothing."""

    def calls(self, before: Value, now: Value) -> Sequence[tuple[Value, ...]]:
        """Returns the arguments of every call of its callback after a change."""


@dataclass(frozen=True)
class _ValueWidget(Generic[Value]):
    label: str

    def calls(self, before: Value, now: Value) -> Sequence[tuple[Value, ...]]:
        return [(now,)]


def check_label(what: str, label: object) -> None:
    """Raises UsageError if a text is not the label of a widget or a panel, as `what` says."""
    if not isinstance(label, str) or not label.strip() or "##" in label:
        raise UsageError(f"{what}: found {shown(label)}; expected a text without '##'")


def check_range(label: str, low: float, high: float) -> None:
    """Raises UsageError if two numbers are not lower and upper end of a range."""
    if not low < high:
        raise UsageError(f"{label}: found the range {low:g} to {high:g}; expected low < high")


def to_number(label: str, value: object) -> float:
    """Returns a number as float; raises UsageError if it is none, or not finite."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, str) or not math.isfinite(number):
        raise UsageError(f"{label}: found {shown(value)}; expected a finite number")
    return number


@dataclass(frozen=True)
class NumberWidget(_ValueWidget[float]):
    """A field for a number.

    Attributes:
        low: least value, -inf for none.
        high: greatest value, inf for none.
    """

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def checked(self, value: object) -> float:
        number = to_number(self.label, value)
        if not self.low <= number <= self.high:
            raise UsageError(f"{self.label}: found {number:g}; expected {self._range}")
        return number

    @property
    def _range(self) -> str:
        if math.isinf(self.low):
            return f"at most {self.high:g}"
        return (
            f"at least {self.low:g}" if math.isinf(self.high) else f"{self.low:g} to {self.high:g}"
        )

    @property
    def _format(self) -> str:
        return f"%.5g {self.unit.replace('%', '%%')}".rstrip()

    def build(self, ui: Widgets, value: float) -> object:
        ui.width(_WIDTH)
        changed, now = ui.number(self.label, value, self._format)
        return now if changed else None


@dataclass(frozen=True)
class SliderWidget(NumberWidget):
    """A number that is set by a slider."""

    def build(self, ui: Widgets, value: float) -> object:
        ui.width(_WIDTH)
        changed, now = ui.slide(self.label, value, self.low, self.high, self._format)
        # A typed number may be out of range.
        return min(max(float(f"{now:.{_DIGITS}g}"), self.low), self.high) if changed else None


@dataclass(frozen=True)
class CheckWidget(_ValueWidget[bool]):
    """A check box."""

    def checked(self, value: object) -> bool:
        if value not in (True, False):
            raise UsageError(f"{self.label}: found {shown(value)}; expected True or False")
        return bool(value)

    def build(self, ui: Widgets, value: bool) -> object:
        changed, now = ui.check(self.label, value)
        return now if changed else None


@dataclass(frozen=True)
class ChoiceWidget(_ValueWidget[str]):
    """One of several names."""

    names: tuple[str, ...]

    def checked(self, value: object) -> str:
        if value not in self.names:
            near = did_you_mean(str(value), self.names)
            raise UsageError(f"{self.label}: found {shown(value)}{near}")
        return str(value)

    def build(self, ui: Widgets, value: str) -> object:
        ui.width(_WIDTH)
        changed, now = ui.choose(self.label, self.names.index(value), self.names)
        return self.names[now] if changed else None


@dataclass(frozen=True)
class TextWidget(_ValueWidget[str]):
    """A text, which only the program changes."""

    def checked(self, value: object) -> str:
        return str(value)

    def build(self, ui: Widgets, value: str) -> object:
        ui.text(value)
        return None


@dataclass(frozen=True)
class ButtonWidget:
    """A button; its value is how often it was pressed."""

    label: str

    def checked(self, value: object) -> int:
        if not isinstance(value, int):
            raise UsageError(f"{self.label}: found {shown(value)}; expected a number of presses")
        return value

    def build(self, ui: Widgets, value: int) -> object:
        return value + 1 if ui.button(self.label) else None

    def calls(self, before: int, now: int) -> Sequence[tuple[int, ...]]:
        """One call without argument for every press."""
        return [()] * (now - before)


TOOL = "user_panels"  # that shows them

Place = tuple[str, str]  # of a widget: the panel's title, and its label there


class WidgetState(NamedTuple):
    """A widget as the viewer is told of it.

    Attributes:
        number: of the last change by the program.
        order: of the widgets in their panel.
    """

    widget: UserWidget[Any]
    value: Any
    number: int
    order: int
