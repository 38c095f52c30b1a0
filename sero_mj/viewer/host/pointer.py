"""`Pointer`: clicks and drags in the image of a window or page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...robots.assemble.world_view import WorldView
from ..decor.toggles import Toggles
from ..image.clicks import CLICKS, Gesture, click
from ..image.picking import Picked, Pixel, pick
from ..session.input import DOUBLE_CLICK_DISTANCE, DOUBLE_CLICK_TIME, Clicked, Moved
from ..session.tool import Grab, Shown, Tool, Tools

OnClick = Callable[[Picked | None, str], None]

_OF_JOINTS = ("link", "double", "arrow", "billboard")  # kinds of items that belong to a joint


@dataclass
class ClickDetector:
    """Detects double clicks, and reverts the action of the first click of a double click."""

    world: WorldView
    toggles: Toggles
    _before: dict[str, Any] = field(default_factory=dict)
    _first: Picked | None = None
    _where: Pixel = (0.0, 0.0)
    _when: float = float("-inf")

    def press(
        self, picked: Picked | None, pixel: Pixel, time: float, *, shift: bool = False
    ) -> Gesture:
        """Performs the action of a mouse click, and returns the detected gesture."""
        apart = max(abs(a - b) for a, b in zip(pixel, self._where, strict=True))
        second = time - self._when <= DOUBLE_CLICK_TIME and apart <= DOUBLE_CLICK_DISTANCE
        if second and not shift:
            kind = "" if self._first is None else self._first.kind
            if not kind or ("double", kind) in CLICKS:
                self.toggles.restore(self._before)
                self._when = float("-inf")
                click(self.world, self.toggles, self._first, "double")
                return "double"
        self._before, self._first = self.toggles.snapshot(), picked
        self._where, self._when = pixel, float("-inf") if shift else time
        gesture: Gesture = "shift" if shift else "click"
        click(self.world, self.toggles, picked, gesture)
        return gesture


class Pointer:
    """Handles the mouse pointer in the image of a window or page.

    Attributes:
        at: position of the pointer in pixels; None outside the image.
        dragging: handler of drags and wheel events.
        on_click: function called with the clicked item and the gesture, or None.
    """

    def __init__(self, shown: Shown) -> None:
        self.at: Pixel | None = None
        self.dragging = Dragging(shown.tools, shown.say)
        self.on_click: OnClick | None = None
        self._shown = shown
        self._clicks = ClickDetector(shown.world, shown.toggles)

    def hover(self, *, is_free: bool) -> bool:
        """Shows the name of the item under the pointer, and returns whether it is a drag handle.

        Args:
            is_free: whether nothing is dragged and no panel is under the pointer.
        """
        shown, at = self._shown, self.at if is_free else None
        if at is None:
            shown.toggles.hover = None
        else:
            shown.decor.hover(shown.data, at)
        return any(shown.tools.call_all(lambda tool: tool.hover(at)))

    def follow(self) -> str:
        """Makes the camera follow the frame under the pointer, or stop if no frame is there."""
        shown = self._shown
        picked = None if self.at is None else shown.decor.pick(shown.data, self.at)
        is_frame = picked is not None and picked.name in shown.world.frames.names
        return shown.camera_control.follow(picked.name if picked and is_frame else None)

    def click(self, clicked: Clicked, picked: Picked | None = None) -> None:
        """Performs the action of a click.

        Args:
            picked: clicked item; None to search for an item at the clicked pixel.
        """
        shown, at = self._shown, (clicked.x, clicked.y)
        if clicked.center:
            self._center(at)
            return
        decor = shown.decor
        if picked is None and decor.view is not None:
            picked = pick(shown.world, shown.data, decor.buffer, decor.view, at)
        taken = shown.tools.first(lambda tool: tool.click(picked, at))
        if taken is not None:
            shown.say(taken[1])
            return
        gesture = self._clicks.press(picked, at, clicked.time, shift=clicked.shift)
        if picked is not None and picked.kind in _OF_JOINTS and picked.index >= 0:
            shown.select(picked.index)
        elif picked is None:
            shown.toggles.selected = None
        if picked is not None and picked.kind == "object" and gesture == "double":
            self._center(at)
        if self.on_click is not None:
            self.on_click(picked, gesture)

    def _center(self, at: Pixel) -> None:
        point = self._shown.decor.point_at(self._shown.data, at)
        if point is not None and np.isfinite(point).all():
            self._shown.camera_control.center(point)


class Dragging:
    """Passes mouse drags and wheel events to the tools of a window or page.

    Args:
        say: function that shows a message. Its second argument is whether the message is an error.
            An empty string removes the current message.
    """

    def __init__(self, tools: Tools, say: Callable[[str, bool], None]) -> None:
        self._tools, self._say = tools, say
        self._tool: Tool | None = None  # tool that handles the current drag
        self._trouble = ""
        self._tried: Pixel | None = None  # start of the last drag that was tested for a handle
        self._is_refused = False

    def take(
        self, moved: Moved, at: Pixel | None, begin: Pixel | None, pressed: Pixel | None
    ) -> bool:
        """Passes a drag or wheel event to a tool.

        Args:
            moved: drag or wheel event.
            at: position of the pointer in pixels; None outside the image.
            begin: pixel at which the button was pressed with Ctrl; None for other drags.
            pressed: pixel at which the left button was pressed, with or without Ctrl.

        Returns:
            whether a tool has handled the event. If so, the camera must not move.
        """
        if self._tool is not None and moved.how == "zoom":
            text = self._tools.call(self._tool, lambda tool: tool.wheel(moved.down))
            if text is not None:
                self._say(text, False)
                return True
        if self._tool is None and pressed is not None and self._tried != moved.pressed:
            self._tried = moved.pressed  # A handle can only be grabbed at the start of a drag.
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
        """Shows which item a long press at a pixel would drag, and returns whether there is one."""
        found = self._tools.first(lambda tool: tool.announce(at))
        if found is None:
            return False
        self._say(*found[1])
        return not found[1].is_refused

    def advance(self) -> None:
        if self._tool is None or self._tool not in self._tools.values():
            self._tool = None  # A tool that fails is removed.
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
