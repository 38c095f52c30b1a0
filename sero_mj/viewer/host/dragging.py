"""`Dragging`: assigns a drag to a tool, from press to release."""

from __future__ import annotations

from collections.abc import Callable

from ..image.picking import Pixel
from ..session.input import Moved
from ..session.tool import Grab, Tool, Tools


class Dragging:
    """Passes drags to the tools.

    Args:
        say: shows a message, and whether it is an error; an empty text removes the last one.
    """

    def __init__(self, tools: Tools, say: Callable[[str, bool], None]) -> None:
        self._tools, self._say = tools, say
        self._tool: Tool | None = None  # of the current drag
        self._trouble = ""  # its last message
        self._tried: Pixel | None = None  # where handles were searched
        self._is_refused = False

    def take(
        self, moved: Moved, at: Pixel | None, begin: Pixel | None, pressed: Pixel | None
    ) -> bool:
        """Takes a drag or a turn of the wheel, if a tool does.

        Args:
            at: the pointer's pixel in the picture; None outside of it.
            begin: that at which the button was pressed with Control; None for another drag.
            pressed: that at which the left button was pressed, with Control or without.

        Returns:
            whether it does not move the camera.
        """
        if self._tool is not None and moved.how == "zoom":
            said = self._tools.call(self._tool, lambda tool: tool.wheel(moved.down))
            if said is not None:
                self._say(said, False)
                return True
        if self._tool is None and pressed is not None and self._tried != moved.pressed:
            self._tried = moved.pressed  # the drag began there, and only there is a handle grabbed
            self._begin(self._tools.first(lambda tool: tool.grab_handle(pressed)))
        if moved.pulls_from is None and self._tool is None:
            return False
        if self._tool is None and not self._is_refused and begin is not None:
            self._begin(self._tools.first(lambda tool: tool.grab(begin)))
        if self._tool is not None and at is not None:
            self._tools.call(self._tool, lambda tool: tool.move(at))
        return self._tool is not None or self._is_refused

    def _begin(self, found: tuple[Tool, Grab] | None) -> None:
        if found is None:
            return
        tool, grab = found
        self._is_refused = grab.is_refused
        self._tool = None if grab.is_refused else tool
        if grab.text:
            self._say(grab.text, grab.is_refused)

    def announce(self, at: Pixel) -> bool:
        """Says what a long press at a pixel would drag; returns whether anything."""
        found = self._tools.first(lambda tool: tool.announce(at))
        if found is None:
            return False
        self._say(*found[1])
        return not found[1].is_refused

    def advance(self) -> None:
        if self._tool is None or self._tool not in self._tools.values():
            self._tool = None  # it has failed, and was taken out
            return
        trouble = self._tools.call(self._tool, lambda tool: tool.drag()) or ""
        if trouble or self._trouble:
            self._say(trouble, True)
        self._trouble = trouble

    def release(self) -> None:
        self.advance()
        if self._tool is not None:
            self._tools.call(self._tool, lambda tool: tool.release())
        self._tool, self._trouble, self._is_refused, self._tried = None, "", False, None
