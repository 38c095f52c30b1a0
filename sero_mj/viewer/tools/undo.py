"""`UndoTool`: takes back what a user has changed, and does it again."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

from ..session.tool import Action, Tool
from ..session.view_state import ViewSnapshot

State = TypeVar("State")

_RESTS = 0.3  # s without a change after which what was changed is one step
_MOST = 200


class Undo(Generic[State]):
    """Watches a state from frame to frame; what changes without a rest is one step."""

    def __init__(self, read: Callable[[], State], write: Callable[[State], None]) -> None:
        self._read, self._write = read, write
        self._past: list[State] = []
        self._future: list[State] = []
        self._kept = self._seen = read()  # that a step leads back to, and that of the last frame
        self._changed = float("-inf")

    @property
    def count(self) -> int:
        return len(self._past)

    @property
    def is_settled(self) -> bool:
        return self._read() == self._kept

    def watch(self, now: float | None = None) -> None:
        """Looks at the state; call it in every frame."""
        now = time.monotonic() if now is None else now
        state = self._read()
        if state != self._seen:
            self._seen, self._changed = state, now
        elif state != self._kept and now - self._changed > _RESTS:
            self._settle()

    def _settle(self) -> None:
        if self._seen != self._kept:
            self._past.append(self._kept)
            del self._past[:-_MOST]
            self._future.clear()
            self._kept = self._seen

    def undo(self) -> str:
        """Takes the last step back; returns what to tell the user."""
        self._seen = self._read()
        self._settle()
        done = self._step(self._past, self._future)
        return "undone; Ctrl+Y does it again" if done else "nothing to undo"

    def redo(self) -> str:
        """Does again what was undone; returns what to tell the user."""
        self._seen = self._read()
        self._settle()
        return "done again" if self._step(self._future, self._past) else "nothing to do again"

    def _step(self, source: list[State], target: list[State]) -> bool:
        if not source:
            return False
        target.append(self._kept)
        self._write(source.pop())
        self._kept = self._seen = self._read()
        return True


class UndoTool(Tool):
    """Ctrl+Z and Ctrl+Y: for camera, switches, selection, and the state of other tools."""

    order: ClassVar[int] = 80
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "ctrl+z": ("undo", "undo: switches, camera, selection; Ctrl+Y redo"),
        "ctrl+y": ("redo", ""),
    }

    def actions(self) -> Mapping[str, Action]:
        return {"undo": self._take_back, "redo": self._do_again}

    def _take_back(self) -> str:
        return self.undo.undo()

    def _do_again(self) -> str:
        return self.undo.redo()

    @cached_property
    def undo(self) -> Undo[tuple[ViewSnapshot, dict[str, Any]]]:
        return Undo(self._read, self._write)

    def advance(self, passed: float) -> None:
        self.undo.watch()

    def _read(self) -> tuple[ViewSnapshot, dict[str, Any]]:
        shown = self.shown
        view = ViewSnapshot.of(shown.view_camera, shown.toggles, follows=shown.is_following)
        others = [(name, tool) for name, tool in shown.tools.items() if tool is not self]
        return view, {
            name: shown.tools.call(tool, lambda tool: tool.state) for name, tool in others
        }

    def _write(self, kept: tuple[ViewSnapshot, dict[str, Any]]) -> None:
        view, of_tools = kept
        view.show(self.shown.view_camera, self.shown.toggles)
        tools = self.shown.tools
        for name, state in of_tools.items():
            tool = tools.get(name)
            if tool is not None and tools.call(tool, lambda tool: tool.state) != state:
                tools.call(tool, lambda tool, state=state: tool.restore(state))  # type: ignore[misc]
        if view.selected is not None:
            self.shown.select(view.selected)
