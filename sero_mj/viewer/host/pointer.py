"""`Pointer`: clicks and drags in the picture of a window or page."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from ...robots.assemble.world_view import WorldView
from ..decor.toggles import Toggles
from ..image.clicks import CLICKS, Gesture, click
from ..image.picking import Picked, Pixel
from ..session.input import DOUBLE_CLICK_DISTANCE, DOUBLE_CLICK_TIME, Clicked, Moved
from ..session.tool import Grab, Shown, Tool, Tools
from .camera_control import CameraControl

OnClick = Callable[[Picked | None, str], None]

_OF_JOINTS = ("link", "double", "arrow", "billboard")  # kinds of items


class Pointed(Shown, Protocol):
    """A window or page whose camera can follow or center on what is under the pointer."""

    camera_control: CameraControl


@dataclass
class ClickDetector:
    """Distinguishes double clicks from clicks, and reverts the first click of a double click."""

    world: WorldView
    toggles: Toggles
    _before: dict[str, Any] = field(default_factory=dict)
    _first: Picked | None = None
    _where: Pixel = (0.0, 0.0)
    _when: float = float("-inf")

    def press(
        self, picked: Picked | None, pixel: Pixel, time: float, *, shift: bool = False
    ) -> Gesture:
        """Handles a press of the button and performs its action."""
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
    """Names, clicks and drags what is in the picture of a host.

    Attributes:
        dragging: takes drags and turns of the wheel.
        on_click: called with the clicked item and the gesture.
    """

    def __init__(self, host: Pointed) -> None:
        self.at: Pixel | None = None
        self.dragging = Dragging(host.tools, host.say)
        self.on_click: OnClick | None = None
        self._host = host
        self._clicks = ClickDetector(host.world, host.toggles)

    def hover(self, *, is_free: bool) -> bool:
        """Names the item under the pointer, and lights the handle there.

        Returns:
            whether there is a handle.
        """
        host, at = self._host, self.at if is_free else None
        if at is None:
            host.toggles.hover = None
        else:
            host.decor.hover(host.data, at)
        return any(host.tools.ask(lambda tool: tool.hover(at)))

    def follow(self) -> str:
        """Lets the camera follow the frame under the pointer; stops where there is none."""
        host = self._host
        picked = None if self.at is None else host.decor.pick(host.data, self.at)
        is_frame = picked is not None and picked.name in host.world.frames.names
        return host.camera_control.follow(picked.name if picked and is_frame else None)

    def click(self, clicked: Clicked, picked: Picked | None = None) -> None:
        """Performs the action of a click.

        Args:
            clicked: pixel, time and modifiers of the click.
            picked: the item there, if the caller knows it; found in the picture if None.
        """
        at = (clicked.x, clicked.y)
        if clicked.centre:
            self._centre(at)
            return
        if picked is None:
            picked = self._host.decor.pick(self._host.data, at)
        host = self._host
        taken = host.tools.first(lambda tool: tool.click(picked, at))
        if taken is not None:
            host.say(taken[1])
            return
        gesture = self._clicks.press(picked, at, clicked.time, shift=clicked.shift)
        if picked is not None and picked.kind in _OF_JOINTS and picked.index >= 0:
            host.select(picked.index)
        elif picked is None:
            host.toggles.selected = None
        if picked is not None and picked.kind == "object" and gesture == "double":
            self._centre(at)
        if self.on_click is not None:
            self.on_click(picked, gesture)

    def _centre(self, at: Pixel) -> None:
        point = self._host.decor.point_at(self._host.data, at)
        if point is not None and np.isfinite(point).all():
            self._host.camera_control.centre(point)


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
