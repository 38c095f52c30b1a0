"""`PageInput`: what the browser in control says, as clicks, drags and keys of the host."""

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
    Card,
    CloseArea,
    Fold,
    HoldMessage,
    KeyMessage,
    Left,
    MessageSender,
    PageMessage,
    PageSize,
    PointerMessage,
    Said,
    ViewMessage,
    Wheel,
    Widget,
)
from .page_panels import REQUEST, PagePanels
from .page_view import PageView

log = logging.getLogger(__name__)


class PageInput:
    """Acts on messages of the browser in control, and counts those about what does not exist.

    Attributes:
        wrong: number of these.
        sender: browser whose message is handled.
        is_dragging: whether a tool has the drag, and the camera stays.
    """

    def __init__(self, host: LiveHost, view: PageView, panels: PagePanels) -> None:
        self._host, self._page_view, self._panels = host, view, panels
        self._mouse = Mouse()
        self.wrong = 0
        self.sender = MessageSender(0, is_local=False)
        self.is_dragging = self.is_on_handle = False
        # One for each kind of `ForScene`, except those that `Browsers` handles.
        self._acts: dict[type[PageMessage | Left], Callable[[Any], None]] = {
            PageSize: self._size,
            CameraMessage: self._camera,
            PointerMessage: self._pointer,
            Wheel: self._wheel,
            HoldMessage: self._hold,
            KeyMessage: self._key,
            Card: self._card,
            Widget: self._widget,
            Fold: self._fold,
            CloseArea: self._close,
            ViewMessage: self._view,
            Left: self._leave,
        }

    def take(self, said: Iterable[Said]) -> None:
        for message, sender in said:
            self.sender = sender
            try:
                self._acts[type(message)](message)
            except (ArithmeticError, LookupError, TypeError, ValueError):
                self.wrong += 1
                log.debug("a page's message is wrong: %.200r", message, exc_info=True)

    def point(self) -> None:
        """Names what is under the pointer, and lights the handle there."""
        is_free = not (self._mouse.is_down or self._host.shows_help)
        self.is_on_handle = self._host.pointer.hover(is_free=is_free)

    # ---- messages

    def _size(self, said: PageSize) -> None:
        self._page_view.size = said.w, said.h
        self._panels.fit(said.page)
        self._look_again()

    def _camera(self, said: CameraMessage) -> None:
        numbers = (said.distance, said.azimuth, said.elevation)
        self._page_view.take(said.fixed, said.lookAt, numbers)
        self._look_again()

    def _look_again(self) -> None:
        """Uses the current camera for the next click."""
        self._host.decor.view = self._page_view.picture(self._host.data)

    def _pointer(self, said: PointerMessage) -> None:
        if said.kind == "leave":  # a finger was taken away: what was pressed is not released
            self._leave()
            return
        at = self._pixel(said)
        pointer = self._host.pointer
        pointer.at = at if self._is_inside(at) else None
        shift = said.shift or said.ctrl
        event = Event(said.kind, *at, time.monotonic(), said.button, shift=shift, control=said.ctrl)
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

    def _pixel(self, said: PointerMessage | Card) -> Pixel:
        return said.x, self._page_view.size[1] - said.y

    def _is_inside(self, at: Pixel) -> bool:
        width, height = self._page_view.size
        return 0 <= at[0] < width and 0 <= at[1] < height

    def _click(self, clicked: Clicked, picked: Picked | None = None) -> None:
        if self._host.shows_help:
            self._host.toggle("shows_help")
        else:
            self._host.pointer.click(clicked, picked)

    def _wheel(self, said: Wheel) -> None:
        if self.is_dragging:
            pointer = self._host.pointer
            pointer.dragging.take(Moved("zoom", 0.0, said.n), pointer.at, None, None)

    def _hold(self, said: HoldMessage) -> None:
        del said
        if self._mouse.is_down and self._mouse.hold(self._host.pointer.dragging.announce):
            self.is_dragging = True

    def _key(self, said: KeyMessage) -> None:
        if said.key == "escape":
            if self._host.shows_help:
                self._host.toggle("shows_help")
            else:
                self._host.others.dismiss()
            return
        self._host.actions.press(said.key, is_repeat=said.repeat)

    def _card(self, said: Card) -> None:
        picked = picked_of(self._host.world, Kind(said.kind), said.item)
        self._click(Clicked(*self._pixel(said), time.monotonic(), said.shift), picked)

    def _widget(self, said: Widget) -> None:
        if said.tree == REQUEST and not self.sender.is_local:
            raise ValueError("only a browser on this machine may say what runs on it")
        self._panels.act(said.tree, said.id, said.value)

    def _fold(self, said: Fold) -> None:
        self._panels.fold(said.tree, said.id, is_open=said.open)

    def _close(self, said: CloseArea) -> None:
        for tool in self._host.tools.areas:
            if tool.area == said.area:
                tool.shows_area = False

    def _view(self, said: ViewMessage) -> None:
        try:
            show_state(self._host, ViewState.from_text(said.text))
        except UsageError as error:
            self._host.say(str(error), is_bad=True)

    def _leave(self, said: Left | None = None) -> None:
        """Releases a button that the browser in control can no longer release."""
        del said
        self._mouse, self._host.pointer.at, self.is_dragging = Mouse(), None, False
        self._host.pointer.dragging.release()
