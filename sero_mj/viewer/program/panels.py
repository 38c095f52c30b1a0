"""`UserPanel`: adds widgets to a viewer from the user's program.

The tool `user_panels` shows the widgets in the viewer's process. Both the program and the user
change values. Each change by the program has a number. Each change by the user contains the last
number that the viewer has received, so that the program ignores changes that it has overridden.
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
    to_number,
)
from .outbox import Outbox

Callback = Callable[..., object]


class WidgetHandle(Generic[Value]):
    """A widget in the viewer's panel, returned by the methods of `UserPanel`."""

    def __init__(
        self, panels: UserPanels, place: Place, state: WidgetState, callback: Callback | None
    ) -> None:
        self._panels, self._callback = panels, callback
        self.place, self.state = place, state

    @property
    def value(self) -> Value:
        """Value of the widget. Setting it does not call the widget's callback.

        Raises:
            UsageError: the new value is invalid for the widget.
        """
        value: Value = self.state.value
        return value

    @value.setter
    def value(self, value: Value) -> None:
        self._panels.change(self, self.state.widget.checked(value))

    def call(self, before: Value) -> None:
        if self._callback is not None:
            for arguments in self.state.widget.calls(before, self.value):
                self._callback(*arguments)


class UserPanel:
    """A section of the viewer's panel with widgets of the program, returned by `Viewer.panel`.

    `Viewer.sync` calls the callback of each widget that the user has changed since the last call.
    The callback of a button is called once for each press. Values also change without `sync`.

    Every method raises UsageError if an argument is invalid or the panel already has a widget with
    the same label. It raises RenderError if the viewer is closed.
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
        """Adds a slider for numbers from `low` to `high`. The initial value defaults to `low`."""
        low, high = to_number(label, low), to_number(label, high)
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
        """Adds a field in which the user enters a number from `low` to `high`."""
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
        """Adds a drop-down list of distinct names. The initial value defaults to the first one."""
        widget = ChoiceWidget(label, (names,) if isinstance(names, str) else (*names,))
        chosen = widget.names[0] if value is None else value
        return self._add(widget, chosen, on_change, "on_change")

    def button(
        self, label: str, *, on_click: Callable[[], object] | None = None
    ) -> WidgetHandle[int]:
        """Adds a button. The value of its handle is the number of presses."""
        return self._add(ButtonWidget(label), 0, on_click, "on_click")

    def text(self, text: str) -> WidgetHandle[str]:
        """Adds a line of text, which the program can change with the `value` of the handle."""
        return self._add(TextWidget(f"text {len(self._labels)}"), text, None, "")

    def clear(self) -> None:
        """Removes all widgets from the panel."""
        for label in self._labels:
            self._panels.remove((self._title, label))
        self._labels.clear()

    def _add(
        self, widget: UserWidget[Value], value: object, callback: Callback | None, name: str
    ) -> WidgetHandle[Value]:
        label = widget.label
        if label in self._labels:
            raise UsageError(f"{label}: the panel '{self._title}' already has a widget '{label}'")
        if callback is not None and not callable(callback):
            raise UsageError(f"{label}: {name}: found {shown(callback)}; expected a function")
        if not self._panels.is_open():
            raise RenderError(f"{label}: cannot add a widget: the viewer is closed")
        value = widget.checked(value)
        self._labels.append(label)
        return self._panels.add((self._title, label), widget, value, callback)


class UserPanels:
    """All panels that a program has added to its viewer.

    Args:
        outbox: outbox that sends changes by the program.
        is_open: function that returns whether the viewer is open.

    Attributes:
        has_changes: whether the user has made changes that `call` has not handled yet.
    """

    def __init__(self, outbox: Outbox, is_open: Callable[[], bool]) -> None:
        self._outbox, self.is_open = outbox, is_open
        self.has_changes = False
        self._panels: dict[str, UserPanel] = {}
        self._lock = threading.Lock()  # protects all fields below
        self._numbers = itertools.count(1)
        self._handles: dict[Place, WidgetHandle[Any]] = {}
        self._unsent: set[Place] = set()
        self._before: dict[WidgetHandle[Any], Any] = {}  # values at the last call of `call`

    def panel(self, title: str) -> UserPanel:
        check_label("panel", title)
        if not self.is_open():
            raise RenderError(f"panel '{title}': the viewer is closed")
        if not self._panels:
            self._outbox.add(TOOL, self._take_unsent)
        return self._panels.setdefault(title, UserPanel(self, title))

    def add(
        self, place: Place, widget: UserWidget[Value], value: Value, callback: Callback | None
    ) -> WidgetHandle[Value]:
        with self._lock:
            number = next(self._numbers)
            state = WidgetState(widget, value, number, number)
            handle = WidgetHandle[Value](self, place, state, callback)
            self._handles[place] = handle
            self._unsent.add(place)
        self._outbox.wake()
        return handle

    def change(self, handle: WidgetHandle[Value], value: Value) -> None:
        """Changes the value of a widget. This does not show a removed widget again."""
        with self._lock:
            handle.state = handle.state._replace(value=value, number=next(self._numbers))
            if self._handles.get(handle.place) is handle:
                self._unsent.add(handle.place)
        self._outbox.wake()

    def remove(self, place: Place) -> None:
        with self._lock:
            self._before.pop(self._handles.pop(place), None)
            self._unsent.add(place)
        self._outbox.wake()

    def _take_unsent(self) -> dict[Place, WidgetState | None] | None:
        with self._lock:
            unsent, self._unsent = self._unsent, set()
            handles = self._handles
            changes = {
                place: handles[place].state if place in handles else None for place in unsent
            }
        return changes or None

    def receive(self, changes: Mapping[Place, tuple[Any, int]]) -> None:
        """Applies the values that the user has set, unless the program has overridden them."""
        with self._lock:
            for place, (value, number) in changes.items():
                handle = self._handles.get(place)
                if handle is not None and handle.state.number == number:
                    self._before.setdefault(handle, handle.state.value)
                    handle.state = handle.state._replace(value=value)
                    self.has_changes = True

    def call(self) -> None:
        """Calls the callbacks of all widgets that the user has changed since the last call."""
        self.has_changes = False
        while self._before:
            with self._lock:
                handle = next(iter(self._before))
                before = self._before.pop(handle)
            handle.call(before)
