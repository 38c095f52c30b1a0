"""Widgets that a program adds to a viewer: slider, number, check box, choice, button and text.

The program creates and validates a widget, and the viewer builds the widget in another process. A
new kind of widget needs a class in this file and a method of `program.panels.UserPanel`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Generic, NamedTuple, TypeVar

from ...base.errors import UsageError, did_you_mean, shown
from ..session.widgets import Widgets

Value = TypeVar("Value")

TOOL = "user_panels"  # name of the tool that shows the widgets
_WIDTH = 9.0  # width of sliders and fields, in text heights
_DIGITS = 7  # significant digits of the values of sliders, which are float32 numbers


def check_label(what: str, label: object) -> None:
    """Raises a UsageError, which begins with the text `what`, if a label is invalid."""
    if not isinstance(label, str) or not label.strip() or "##" in label:
        raise UsageError(f"{what}: found {shown(label)}; expected a text without '##'")


def to_number(label: str, value: object) -> float:
    """Converts a value to a finite float, or raises a UsageError that names the label."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, str) or not math.isfinite(number):
        raise UsageError(f"{label}: found {shown(value)}; expected a finite number")
    return number


@dataclass(frozen=True)
class UserWidget(Generic[Value]):
    """Base class of the widgets that a program adds to a viewer. Widgets do not store their values.

    Attributes:
        label: displayed label, which must be unique in the panel.
    """

    label: str

    def __post_init__(self) -> None:
        check_label("label", self.label)

    def checked(self, value: object) -> Value:
        """Converts a value to the type of the widget, or raises UsageError if it is invalid."""
        raise NotImplementedError

    def build(self, ui: Widgets, value: Value) -> object:
        """Builds the widget, and returns the value that the user has set, or None."""
        raise NotImplementedError

    def calls(self, before: Value, now: Value) -> Sequence[tuple[Value, ...]]:
        """Returns the arguments of each callback call, such as one call per press of a button."""
        return [(now,)]


@dataclass(frozen=True)
class NumberWidget(UserWidget[float]):
    """A field for a number with a minimum, a maximum and a unit."""

    low: float = -math.inf
    high: float = math.inf
    unit: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.low < self.high:
            found = f"found the range {self.low:g} to {self.high:g}"
            raise UsageError(f"{self.label}: {found}; expected low < high")

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
    """A slider for a number."""

    def build(self, ui: Widgets, value: float) -> object:
        ui.width(_WIDTH)
        changed, now = ui.slide(self.label, value, self.low, self.high, self._format)
        # Ctrl+click on a slider lets users type numbers that are out of range.
        return min(max(float(f"{now:.{_DIGITS}g}"), self.low), self.high) if changed else None


@dataclass(frozen=True)
class CheckWidget(UserWidget[bool]):
    """A check box."""

    def checked(self, value: object) -> bool:
        if value not in (True, False):
            raise UsageError(f"{self.label}: found {shown(value)}; expected True or False")
        return bool(value)

    def build(self, ui: Widgets, value: bool) -> object:
        changed, now = ui.check(self.label, value)
        return now if changed else None


@dataclass(frozen=True)
class ChoiceWidget(UserWidget[str]):
    """A drop-down list of names."""

    names: tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.names:
            check_label(f"{self.label}: names", name)
        if len({*self.names}) < max(len(self.names), 1):
            found = shown([*self.names])
            raise UsageError(f"{self.label}: found the names {found}; expected different names")

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
class TextWidget(UserWidget[str]):
    """A line of text that only the program can change."""

    def checked(self, value: object) -> str:
        return str(value)

    def build(self, ui: Widgets, value: str) -> object:
        ui.text(value)
        return None


@dataclass(frozen=True)
class ButtonWidget(UserWidget[int]):
    """A button, whose value is the number of presses."""

    def checked(self, value: object) -> int:
        if not isinstance(value, int):
            raise UsageError(f"{self.label}: found {shown(value)}; expected a number of presses")
        return value

    def build(self, ui: Widgets, value: int) -> object:
        return value + 1 if ui.button(self.label) else None

    def calls(self, before: int, now: int) -> Sequence[tuple[int, ...]]:
        return [()] * (now - before)


Place = tuple[str, str]  # title of the panel and label of the widget


class WidgetState(NamedTuple):
    """The state of a widget, which the program sends to the viewer.

    Attributes:
        number: sequence number of the last change by the program.
        order: position of the widget in its panel.
    """

    widget: UserWidget[Any]
    value: Any
    number: int
    order: int
