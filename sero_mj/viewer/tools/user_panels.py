"""`UserPanelsTool`: shows the widgets that the user's program adds with `program/panels.py`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from ...base.errors import UsageError
from ..panels.user_widgets import Place, WidgetState
from ..session.tool import Shown, Tool
from ..session.widgets import Widgets


class UserPanelsTool(Tool):
    """Tool that adds one section to the viewer's panel for each `UserPanel` of the program."""

    order: ClassVar[int] = 10

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self._placed: dict[Place, WidgetState] = {}
        self._changes: dict[Place, tuple[Any, int]] = {}

    def receive(self, message: Mapping[Place, WidgetState | None]) -> None:
        if not self._placed:
            self.shown.shows_panel = True
        now = {**self._placed, **message}
        there = [(place, placed) for place, placed in now.items() if placed is not None]
        self._placed = dict(sorted(there, key=lambda each: each[1].order))

    def reply(self) -> dict[Place, tuple[Any, int]] | None:
        changes, self._changes = self._changes, {}
        return changes or None

    def build(self, ui: Widgets) -> None:
        panels: dict[str, list[tuple[Place, WidgetState]]] = {}
        for place, placed in self._placed.items():
            panels.setdefault(place[0], []).append((place, placed))
        for title, widgets in panels.items():
            ui.scope(title)
            if ui.header(title, is_open=True):
                for place, placed in widgets:
                    self._build(ui, place, placed)
            ui.end_scope()

    def _build(self, ui: Widgets, place: Place, placed: WidgetState) -> None:
        found = placed.widget.build(ui, placed.value)
        if found is None:
            return
        try:
            value = placed.widget.checked(found)
        except UsageError as error:
            self.shown.say(str(error), is_bad=True)
            return
        self._placed[place] = placed._replace(value=value)
        self._changes[place] = value, placed.number
