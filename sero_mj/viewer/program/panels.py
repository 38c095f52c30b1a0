"""`UserPanel`: widgets that a program adds to its viewer, from the side of the program.

They are shown by the tool `user_panels` in the viewer's process. Both sides change values: every
change by the program has a number, and changes by the user come with the last number that the
viewer has received, so that those which the program has overridden meanwhile are ignored.
"""

from __future__ import annotations

import itertools
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Generic

from ...base.errors import RenderError, UsageError, shown
from ..panels.user_widgets import (
    TOOL,
    ButtonWidget,
    CheckWidget,
    ChoiceWidget,
    NumberWidget,
    Place,
    SliderWidget,
    TextWidget,
    UserWidget,
    Value,
    WidgetState,
    check_label,
    check_range,
    to_number,
)
from .outbox import Outbox


class WidgetHandle(Generic[Value]):
    """A widget of a panel; made by `UserPanel`."""

    def __init__(
        self,
        panels: UserPanels,
        place: Place,
        placed: WidgetState,
        callback: Callable[..., object] | None,
    ) -> None:
        self._panels, self._callback = panels, callback
        self.place, self.placed = place, placed

    @property
    def value(self) -> Value:
        """What it shows; set it to show something else, which calls no callback.

        Raises:
            UsageError: a value that the widget cannot have.
        """
        value: Value = self.placed.value
        return value

    @value.setter
    def value(self, value: Value) -> None:
        self._panels.change(self, self.placed.widget.checked(value))

    def call(self, before: Value) -> None:
        if self._callback is not None:
            for arguments in self.placed.widget.calls(before, self.value):
                self._callback(*arguments)


class UserPanel:
    """A section of the viewer's panel with widgets of the program; see `Viewer.panel`.

    Callbacks are called by `Viewer.sync`, once for all changes since the last call; those of
    buttons once for every press. Values change without `sync` as well.

    Every method raises UsageError if the panel has a widget of that label, or an argument is
    wrong, and RenderError if the viewer is closed.
    """

    def __init__(self, panels: UserPanels, title: str) -> None:
        self._panels, self._title = panels, title
        self._labels: list[str] = []

    def slider(
        self,
        label: str,
        low: float,
        high: float,
        *,
        value: float | None = None,
        unit: str = "",
        on_change: Callable[[float], object] | None = None,
    ) -> WidgetHandle[float]:
        """Adds a slider.

        Args:
            low: value at its left end.
            high: value at its right end.
            value: where it is at first; `low` when None.
        """
        low, high = to_number(label, low), to_number(label, high)
        check_range(label, low, high)
        widget = SliderWidget(label, low, high, unit)
        return self._add(widget, low if value is None else value, on_change, "on_change")

    def number(
        self,
        label: str,
        *,
        value: float = 0.0,
        low: float = -math.inf,
        high: float = math.inf,
        unit: str = "",
        on_change: Callable[[float], object] | None = None,
    ) -> WidgetHandle[float]:
        """Adds a field for a number.

        Args:
            low: least value.
            high: greatest value.
        """
        check_range(label, low, high)
        return self._add(NumberWidget(label, low, high, unit), value, on_change, "on_change")

    def check(
        self,
        label: str,
        *,
        value: bool = False,
        on_change: Callable[[bool], object] | None = None,
    ) -> WidgetHandle[bool]:
        """Adds a check box."""
        return self._add(CheckWidget(label), value, on_change, "on_change")

    def choice(
        self,
        label: str,
        names: Sequence[str],
        *,
        value: str | None = None,
        on_change: Callable[[str], object] | None = None,
    ) -> WidgetHandle[str]:
        """Adds a list to choose a name from.

        Args:
            names: to choose from, all different.
        """
        names = [names] if isinstance(names, str) else [*names]
        for name in names:
            check_label(f"{label}: names", name)
        if len({*names}) < max(len(names), 1):
            raise UsageError(f"{label}: found the names {shown(names)}; expected different ones")
        widget = ChoiceWidget(label, tuple(names))
        return self._add(widget, names[0] if value is None else value, on_change, "on_change")

    def button(
        self, label: str, *, on_click: Callable[[], object] | None = None
    ) -> WidgetHandle[int]:
        """Adds a button; its value is how often it was pressed."""
        return self._add(ButtonWidget(label), 0, on_click, "on_click")

    def text(self, text: str) -> WidgetHandle[str]:
        """Adds a text; its value is the text, which can be changed."""
        return self._add(TextWidget(f"text {len(self._labels)}"), text, None, "")

    def clear(self) -> None:
        for label in self._labels:
            self._panels.remove((self._title, label))
        self._labels.clear()

    def _add(
        self,
        widget: UserWidget[Value],
        value: object,
        callback: Callable[..., object] | None,
        name: str,
    ) -> WidgetHandle[Value]:
        label = widget.label
        check_label("label", label)
        if label in self._labels:
            raise UsageError(f"{label}: the panel '{self._title}' has a widget of that name")
        if callback is not None and not callable(callback):
            raise UsageError(f"{label}: {name}: found {shown(callback)}; expected a function")
        if not self._panels.is_open():
            raise RenderError(f"{label}: no widget: the viewer is closed")
        value = widget.checked(value)
        self._labels.append(label)
        return self._panels.add((self._title, label), widget, value, callback)


class UserPanels:
    """All panels of a viewer, and what has changed of them.

    Args:
        outbox: sends changes by the program.
        is_open: returns whether the viewer is open.

    Attributes:
        has_changes: whether `call` has something to do.
    """

    def __init__(self, outbox: Outbox, is_open: Callable[[], bool]) -> None:
        self._outbox, self.is_open = outbox, is_open
        self.has_changes = False
        self._panels: dict[str, UserPanel] = {}
        self._lock = threading.Lock()  # of all below
        self._numbers = itertools.count(1)
        self._handles: dict[Place, WidgetHandle[Any]] = {}
        self._unsent: set[Place] = set()
        self._before: dict[WidgetHandle[Any], Any] = {}  # values at the last `call`

    def panel(self, title: str) -> UserPanel:
        check_label("panel", title)
        if not self.is_open():
            raise RenderError(f"panel '{title}': the viewer is closed")
        if not self._panels:
            self._outbox.add(TOOL, self._take_unsent)
        return self._panels.setdefault(title, UserPanel(self, title))

    def add(
        self,
        place: Place,
        widget: UserWidget[Value],
        value: Value,
        callback: Callable[..., object] | None,
    ) -> WidgetHandle[Value]:
        with self._lock:
            number = next(self._numbers)
            handle = WidgetHandle[Value](
                self, place, WidgetState(widget, value, number, number), callback
            )
            self._handles[place] = handle
            self._unsent.add(place)
        self._outbox.wake()
        return handle

    def change(self, handle: WidgetHandle[Value], value: Value) -> None:
        """Changes the value of a widget; one that was removed is not shown again."""
        with self._lock:
            handle.placed = handle.placed._replace(value=value, number=next(self._numbers))
            if self._handles.get(handle.place) is handle:
                self._unsent.add(handle.place)
        self._outbox.wake()

    def remove(self, place: Place) -> None:
        """Removes a widget."""
        with self._lock:
            self._before.pop(self._handles.pop(place), None)
            self._unsent.add(place)
        self._outbox.wake()

    def _take_unsent(self) -> dict[Place, WidgetState | None] | None:
        with self._lock:
            unsent, self._unsent = self._unsent, set()
            handles = self._handles
            changes = {
                place: handles[place].placed if place in handles else None for place in unsent
            }
        return changes or None

    def hear(self, changes: Mapping[Place, tuple[Any, int]]) -> None:
        """Takes over changes by the user: values, and the numbers of the last changes seen."""
        with self._lock:
            for place, (value, number) in changes.items():
                handle = self._handles.get(place)
                if handle is not None and handle.placed.number == number:
                    self._before.setdefault(handle, handle.placed.value)
                    handle.placed = handle.placed._replace(value=value)
                    self.has_changes = True

    def call(self) -> None:
        """Calls the callbacks of all that was changed by the user since the last call."""
        self.has_changes = False
        while self._before:
            with self._lock:
                handle = next(iter(self._before))
                before = self._before.pop(handle)
            handle.call(before)
