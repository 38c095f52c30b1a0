"""`PageInput`: what the browser in control says, as clicks, drags and keys of the host."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from typing import Any

from ...base.errors import UsageError
from ..decor.geom_buffer import Kind
from ..session.input import LEFT, Clicked, Event, Mouse, Moved
from ..session.live import LiveHost
from ..session.picking import Pixel, picked_of
from ..session.restoring import show_state
from ..session.view_state import ViewState
from .page_panels import PagePanels
from .page_view import PageView

log = logging.getLogger(__name__)

_MOST_PIXELS = 20_000  # of a page, in either direction
_BUTTONS = (0, 1, 2)


class PageInput:
    """Takes messages of the browser in control; those that are wrong are counted and left.

    Args:
        host: of the page.
        view: of the page.
        panels: of the page.

    Attributes:
        wrong: number of messages with wrong contents.
        is_dragging: whether a tool has the drag, and the camera stays.
        is_on_handle: whether the pointer is over a handle.
    """

    def __init__(self, host: LiveHost, view: PageView, panels: PagePanels) -> None:
        self._host, self._page_view, self._panels = host, view, panels
        self._mouse = Mouse()
        self.wrong = 0
        self.is_dragging = self.is_on_handle = False
        self._takes: dict[str, Callable[[dict[str, Any]], None]] = {
            "size": self._size,
            "camera": self._camera,
            "pointer": self._pointer,
            "wheel": self._wheel,
            "hold": self._hold,
            "key": self._key,
            "card": self._card,
            "widget": self._widget,
            "fold": self._fold,
            "close": self._close,
            "view": self._view,
            "left": self._leave,
        }

    def take(self, said: Iterable[dict[str, Any]]) -> None:
        """Takes messages, the oldest first."""
        for each in said:
            try:
                self._takes[each["t"]](each)
            except (KeyError, TypeError, ValueError, OverflowError):
                self.wrong += 1
                log.debug("a page's message is wrong: %.200r", each)

    def point(self) -> None:
        """Names what is under the pointer, and lights the handle there."""
        is_free = not (self._mouse.is_down or self._host.shows_help)
        self.is_on_handle = self._host.pointer.hover(is_free=is_free)

    # ---- messages

    def _size(self, said: dict[str, Any]) -> None:
        sizes = [int(said[key]) for key in ("w", "h", "page")]
        if not all(0 < size < _MOST_PIXELS for size in sizes):
            raise ValueError
        self._page_view.size = sizes[0], sizes[1]
        self._panels.fit(sizes[2])
        self._look_again()

    def _camera(self, said: dict[str, Any]) -> None:
        numbers = [float(said[key]) for key in ("distance", "azimuth", "elevation")]
        self._page_view.take(int(said["fixed"]), [*map(float, said["lookAt"])], numbers)
        self._look_again()

    def _look_again(self) -> None:
        """Lets pixels be those of the camera as it is now, before one is pressed."""
        self._host.decor.view = self._page_view.picture(self._host.data)

    def _at(self, said: dict[str, Any]) -> Pixel:
        x, y = float(said["x"]), float(said["y"])
        if not (abs(x) < _MOST_PIXELS and abs(y) < _MOST_PIXELS):  # nor NaN
            raise ValueError
        return x, self._page_view.size[1] - y

    def _pointer(self, said: dict[str, Any]) -> None:
        kind = said["kind"]
        if kind == "leave":  # a finger was taken away, say: what was pressed is not released
            self._leave(said)
            return
        at = self._at(said)
        button = int(said.get("button", LEFT))
        if kind not in ("press", "release", "move") or button not in _BUTTONS:
            raise ValueError
        pointer = self._host.pointer
        pointer.at = at if self._is_inside(at) else None
        control = bool(said.get("ctrl"))
        shift = bool(said.get("shift")) or control
        event = Event(kind, *at, time.monotonic(), button, shift=shift, control=control)
        found = self._mouse.take(event)
        if isinstance(found, Clicked):
            self._click(found)
        elif isinstance(found, Moved):
            places = (found.pulls_from, found.pressed)
            self.is_dragging |= pointer.dragging.take(found, at, *places)
        if not self._mouse.is_down:
            self.is_dragging = False
            pointer.dragging.release()

    def _is_inside(self, at: Pixel) -> bool:
        width, height = self._page_view.size
        return 0 <= at[0] < width and 0 <= at[1] < height

    def _click(self, clicked: Clicked) -> None:
        if self._host.shows_help:
            self._host.toggle_help()
        else:
            self._host.pointer.click(clicked)

    def _wheel(self, said: dict[str, Any]) -> None:
        notches = float(said["n"])
        if abs(notches) < _MOST_PIXELS and self.is_dragging:
            pointer = self._host.pointer
            pointer.dragging.take(Moved("zoom", 0.0, notches), pointer.at, None, None)

    def _hold(self, said: dict[str, Any]) -> None:
        del said
        if self._mouse.is_down and self._mouse.hold(self._host.pointer.dragging.announce):
            self.is_dragging = True

    def _key(self, said: dict[str, Any]) -> None:
        key = str(said["key"])
        if key == "escape":
            if self._host.shows_help:
                self._host.toggle_help()
            return
        self._host.actions.press(key, is_repeat=bool(said.get("repeat")))

    def _card(self, said: dict[str, Any]) -> None:
        """A click on text of the page, which stands for what it belongs to."""
        picked = picked_of(self._host.world, Kind(int(said["kind"])), int(said["item"]))
        # Clicks in a row on one card are at one place, those on another one are elsewhere.
        at = (1e5 * (1 + picked.index), 1e5 * int(said["kind"]))
        shift = bool(said.get("shift"))
        self._host.pointer.click_item(picked, at, time.monotonic(), shift=shift)

    def _widget(self, said: dict[str, Any]) -> None:
        self._panels.act(str(said["tree"]), str(said["id"]), said["value"])

    def _fold(self, said: dict[str, Any]) -> None:
        self._panels.fold(str(said["tree"]), str(said["id"]), is_open=bool(said["open"]))

    def _close(self, said: dict[str, Any]) -> None:
        for tool in self._host.areas:
            if tool.area == said["area"]:
                tool.shows_area = False

    def _view(self, said: dict[str, Any]) -> None:
        try:
            show_state(self._host, ViewState.from_text(str(said["text"])))
        except UsageError as error:
            self._host.say(str(error), is_bad=True)

    def _leave(self, said: dict[str, Any]) -> None:
        """Whoever had control has gone, and a button is no longer down."""
        del said
        self._mouse, self._host.pointer.at, self.is_dragging = Mouse(), None, False
        self._host.pointer.dragging.release()
