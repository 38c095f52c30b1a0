"""`UndoTool`: undoes and redoes the user's changes to a window or page."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any, ClassVar, Generic, TypeVar

from ..session.tool import Action, Tool
from ..session.view_state import ViewSnapshot

State = TypeVar("State")

_PAUSE = 0.3  # minimum pause between the changes of two steps, s
_MAX_STEPS = 200


class Undo(Generic[State]):
    """Undo history of the state that `read` returns. Changes without a pause form one step."""

    def __init__(self, read: Callable[[], State], write: Callable[[State], None]) -> None:
        self._read, self._write = read, write
        self._past: list[State] = []
        self._future: list[State] = []
        self._base = self._last = read()  # state after the last step, and in the last frame
        self._changed = float("-inf")

    @property
    def count(self) -> int:
        return len(self._past)

    @property
    def is_settled(self) -> bool:
        return self._read() == self._base

    def watch(self, now: float | None = None) -> None:
        now = time.monotonic() if now is None else now
        state = self._read()
        if state != self._last:
            self._last, self._changed = state, now
        elif state != self._base and now - self._changed > _PAUSE:
            self._settle()

    def _settle(self) -> None:
        if self._last != self._base:
            self._past.append(self._base)
            del self._past[:-_MAX_STEPS]
            self._future.clear()
            self._base = self._last

    def undo(self) -> str:
        """Reverts the last step, and returns a message for the user."""
        self._last = self._read()
        self._settle()
        done = self._step(self._past, self._future)
        return "undone; Ctrl+Y redoes it" if done else "nothing to undo"

    def redo(self) -> str:
        """Repeats the last step that was undone, and returns a message for the user."""
        self._last = self._read()
        self._settle()
        return "redone" if self._step(self._future, self._past) else "nothing to redo"

    def _step(self, source: list[State], target: list[State]) -> bool:
        if not source:
            return False
        target.append(self._base)
        self._write(source.pop())
        self._base = self._last = self._read()
        return True


class UndoTool(Tool):
    """Tool that undoes and redoes changes of camera, switches, selection and other tools."""

    order: ClassVar[int] = 80
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "ctrl+z": ("undo", "undo switches, camera and selection (Ctrl+Y: redo)"),
        "ctrl+y": ("redo", ""),
    }

    def actions(self) -> Mapping[str, Action]:
        return {"undo": self._undo, "redo": self._redo}

    def _undo(self) -> str:
        return self.undo.undo()

    def _redo(self) -> str:
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

    def _write(self, states: tuple[ViewSnapshot, dict[str, Any]]) -> None:
        view, of_tools = states
        view.show(self.shown.view_camera, self.shown.toggles)
        tools = self.shown.tools
        for name, state in of_tools.items():
            tool = tools.get(name)
            if tool is not None and tools.call(tool, lambda tool: tool.state) != state:
                tools.call(tool, lambda tool, state=state: tool.restore(state))  # type: ignore[misc]
        if view.selected is not None:
            self.shown.select(view.selected)
