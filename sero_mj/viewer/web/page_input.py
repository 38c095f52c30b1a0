"""`PageInput`: converts messages of the browser in control to clicks, drags and actions."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Any

from ...base.errors import UsageError
from ..decor.geom_buffer import Kind
from ..host.live import LiveHost
from ..host.restoring import show_state
from ..image.picking import Picked, Pixel, picked_of
from ..session.input import Clicked, Event, Mouse, Moved
from ..session.view_state import ViewState
from .messages import (
    CameraMessage,
    CloseArea,
    Fold,
    HoldMessage,
    KeyMessage,
    Left,
    MessageSender,
    PageMessage,
    PageSize,
    PointerMessage,
    Received,
    TextClick,
    ViewMessage,
    Wheel,
    Widget,
)
from .page_panels import REQUEST, PagePanels
from .page_view import PageView

log = logging.getLogger(__name__)


class PageInput:
    """Handles the messages of the browser in control.

    Attributes:
        wrong: number of messages about items that do not exist.
        sender: browser whose message is being handled.
        is_dragging: whether a tool handles the drag. If so, the camera does not move.
        is_on_handle: whether a drag handle is under the pointer.
    """

    def __init__(self, host: LiveHost, view: PageView, panels: PagePanels) -> None:
        self._host, self._page_view, self._panels = host, view, panels
        self._mouse = Mouse()
        self.wrong = 0
        self.sender = MessageSender(0, is_local=False)
        self.is_dragging = self.is_on_handle = False
        # `Browsers` handles all other kinds of `ForScene`.
        self._acts: dict[type[PageMessage | Left], Callable[[Any], None]] = {
            PageSize: self._size,
            CameraMessage: self._camera,
            PointerMessage: self._pointer,
            Wheel: self._wheel,
            HoldMessage: self._hold,
            KeyMessage: self._key,
            TextClick: self._text_click,
            Widget: self._widget,
            Fold: self._fold,
            CloseArea: self._close,
            ViewMessage: self._view,
            Left: self._leave,
        }

    def take(self, messages: Iterable[Received]) -> None:
        for message, sender in messages:
            self.sender = sender
            try:
                self._acts[type(message)](message)
            except (ArithmeticError, LookupError, TypeError, ValueError):
                self.wrong += 1
                log.debug("a message of a browser is ignored: %.200r", message, exc_info=True)

    def point(self) -> None:
        """Shows the name of the item under the pointer."""
        is_free = not (self._mouse.is_down or self._host.shows_help)
        self.is_on_handle = self._host.pointer.hover(is_free=is_free)

    # ---- messages

    def _size(self, message: PageSize) -> None:
        self._page_view.size = message.w, message.h
        self._panels.fit(message.page)
        self._update_view()

    def _camera(self, message: CameraMessage) -> None:
        numbers = (message.distance, message.azimuth, message.elevation)
        self._page_view.take(message.fixed, message.lookAt, numbers)
        self._update_view()

    def _update_view(self) -> None:
        # The next click must use the current camera.
        self._host.decor.view = self._page_view.of_data(self._host.data)

    def _pointer(self, message: PointerMessage) -> None:
        if message.kind == "leave":  # A finger has left the screen, but no button was released.
            self._leave()
            return
        at = self._pixel(message)
        pointer = self._host.pointer
        pointer.at = at if self._is_inside(at) else None
        shift = message.shift or message.ctrl
        event = Event(
            message.kind, *at, time.monotonic(), message.button, shift=shift, control=message.ctrl
        )
        found = self._mouse.take(event)
        if isinstance(found, Clicked):
            self._click(found)
        elif isinstance(found, Moved):
            places = (found.pulls_from, found.pressed)
            self.is_dragging |= pointer.dragging.take(found, at, *places)
        is_click = isinstance(found, Clicked) and not self.is_dragging
        if not (self._mouse.is_down or is_click):
            self.is_dragging = False
            pointer.dragging.release()

    def _pixel(self, message: PointerMessage | TextClick) -> Pixel:
        return message.x, self._page_view.size[1] - message.y

    def _is_inside(self, at: Pixel) -> bool:
        width, height = self._page_view.size
        return 0 <= at[0] < width and 0 <= at[1] < height

    def _click(self, clicked: Clicked, picked: Picked | None = None) -> None:
        if self._host.shows_help:
            self._host.toggle("shows_help")
        else:
            self._host.pointer.click(clicked, picked)

    def _wheel(self, message: Wheel) -> None:
        if self.is_dragging:
            pointer = self._host.pointer
            pointer.dragging.take(Moved("zoom", 0.0, message.n), pointer.at, None, None)

    def _hold(self, message: HoldMessage) -> None:
        del message
        if self._mouse.is_down and self._mouse.hold(self._host.pointer.dragging.announce):
            self.is_dragging = True

    def _key(self, message: KeyMessage) -> None:
        if message.key == "escape":
            if self._host.shows_help:
                self._host.toggle("shows_help")
            else:
                self._host.others.dismiss()
            return
        self._host.actions.press(message.key, is_repeat=message.repeat)

    def _text_click(self, message: TextClick) -> None:
        picked = picked_of(self._host.world, Kind(message.kind), message.item)
        self._click(Clicked(*self._pixel(message), time.monotonic(), message.shift), picked)

    def _widget(self, message: Widget) -> None:
        if message.tree == REQUEST and not self.sender.is_local:
            raise ValueError("only a browser on this machine can allow programs")
        self._panels.act(message.tree, message.id, message.value)

    def _fold(self, message: Fold) -> None:
        self._panels.fold(message.tree, message.id, is_open=message.open)

    def _close(self, message: CloseArea) -> None:
        for tool in self._host.tools.areas:
            if tool.area == message.area:
                tool.shows_area = False

    def _view(self, message: ViewMessage) -> None:
        try:
            show_state(self._host, ViewState.from_text(message.text))
        except UsageError as error:
            self._host.say(str(error), is_bad=True)

    def _leave(self, message: Left | None = None) -> None:
        del message
        self._mouse, self._host.pointer.at, self.is_dragging = Mouse(), None, False
        self._host.pointer.dragging.release()
