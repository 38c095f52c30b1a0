"""`Window`: shows a mirror in a window, and handles its mouse and key events."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from ...base.errors import RenderError
from ...data.drive.mirror import LiveWorld
from ...robots.assemble.world_view import WorldView
from ..decor.toggles import Toggles
from ..host.live import LiveHost
from ..image.image_files import Pixels
from ..image.image_options import DEFAULT_SIZE
from ..image.picking import Pixel
from ..session.input import Clicked, Event, Mouse, Moved
from ..session.keys import help_columns
from ..session.status_line import status_pieces
from ..session.tool import tool_keys
from .glfw_window import GlWindow
from .viewport import Pane, Viewport

_REST = 0.3  # time without motion or input after which frames have full quality, s
_SAME_VIEW = 1e-6  # tolerance of the camera's position in m, and of its direction


class Pace:
    """Reduces the quality of frames during motion and input if rendering is slow.

    Attributes:
        slow: rendering time in seconds above which a full-quality frame is slow.
    """

    def __init__(self) -> None:
        self.slow = 0.04
        self._time = 0.0  # mean rendering time of full-quality frames, s
        self._view: tuple[float, ...] = ()
        self._moved = float("-inf")  # time of the last motion or input

    def took(self, seconds: float) -> None:
        self._time += 0.15 * (seconds - self._time)

    def act(self, now: float) -> None:
        self._moved = now

    def is_quick(self, view: tuple[float, ...], now: float) -> bool:
        if self._view and not np.allclose(view, self._view, rtol=0.0, atol=_SAME_VIEW):
            self._moved = now
        self._view = view
        return self._time > self.slow and now - self._moved < _REST


class Window(LiveHost):
    """A window that shows a mirror. Frames show the latest packets and never wait for a packet.

    Attributes:
        is_quick: whether the last frame was rendered without multisampling and shadows.

    Raises:
        RenderError: there is no display, or OpenGL or Dear ImGui is not available.
        UnknownName: there is no camera with this name.
    """

    decor: Viewport
    is_window = True

    def __init__(
        self,
        mirror: LiveWorld,
        *,
        size: tuple[int, int] = DEFAULT_SIZE,
        camera: str | None = None,
        full_screen: bool = False,
        folder: Path | None = None,
        make_viewport: Callable[[WorldView, Toggles, mujoco.MjrContext], Viewport] = Viewport,
    ) -> None:
        try:  # This import is not at the top, because images can be rendered without Dear ImGui.
            from .chrome import Chrome
        except ImportError as error:  # A system library may be missing.
            raise RenderError(
                f"cannot open a window: {error}; `sero-mj view --web` serves a page instead"
            ) from error
        super().__init__(mirror, folder, camera)
        world = self.world
        title = f"{world.scene.name} - sero-mj"
        self.gl = GlWindow(world, size, title, full_screen=full_screen)
        self.decor = make_viewport(world, self.toggles, self.gl.context)
        self._use(self.decor)
        self.decor.needed = self.navigator.needed
        self._mouse = Mouse()
        self.actions.add({"full_screen": self.gl.toggle_full_screen})
        columns = help_columns(tool_keys())
        columns += [[*rows] for rows in self.tools.call_all(lambda tool: tool.help_rows()) if rows]
        self._chrome = Chrome(self.gl, self, columns)
        self._pace, self.is_quick = Pace(), False
        self._last = self._end = time.monotonic()  # start and end of the last frame
        self._interval = 1.0 / self.gl.refresh_rate  # mean time between the last frames, s

    @property
    def is_open(self) -> bool:
        return not self.gl.is_closing

    @property
    def is_due(self) -> bool:
        """Whether it is time for the next frame.

        The pause after a slow frame is as long as the frame took, to leave time for the caller.
        """
        took = self._end - self._last
        if not self.is_open:
            return False
        return time.monotonic() - self._end >= max(1.0 / self.gl.refresh_rate - 1e-3 - took, took)

    def frame(self, *, wait: bool = True) -> bool:
        begin = time.monotonic()
        passed, self._last = begin - self._last, begin
        self._interval += 0.1 * (passed - self._interval)
        if self.gl.is_closing:
            return False
        width, height = self.gl.size
        if not (width and height):  # The window is minimized.
            self.gl.wait(0.1)
            return True
        for event in self.gl.events():
            if event.kind != "move" or self._mouse.is_down:
                self._pace.act(begin)
            self._take(event, height)
        self._advance(passed)
        self.navigator.advance(self.data)
        chrome = self._chrome
        places = chrome.places((width, height))
        rect = mujoco.MjrRect(*places.image)
        typesetter = self.gl.typesetter_of(rect.width, rect.height)
        is_taken = self.tools.takes_images
        covered = 0.0 if is_taken else chrome.covered  # Saved images have no panel.
        self.decor.update(self.data, self.navigator.camera, Pane(rect, typesetter, covered))
        self._place_pointer()
        at = self._mouse.position
        is_over_chrome = at is not None and chrome.is_over(*at)
        self.pointer.hover(is_free=not (self._mouse.is_down or self.shows_help or is_over_chrome))
        frame_rate = 1.0 / max(self._interval, 1e-6)
        pieces = status_pieces(self.mirror.sources.values(), self.clock, frame_rate)
        pieces[1:1] = self.decor.pieces
        chrome.build((width, height), places, self.decor.rect, pieces)
        drawn = time.monotonic()
        self.work = drawn - begin
        view = self.decor.view
        assert view is not None  # `update` above has set the view.
        is_quick = self._pace.is_quick((*view.position, *view.forward), drawn)
        self.is_quick = is_quick and not is_taken
        self._draw()
        self.gl.swap()
        self._end = time.monotonic()
        if not self.is_quick:
            self._pace.took(self._end - drawn)
        # This limits the frame rate if swapping does not wait for the screen's refresh.
        if wait:
            self.gl.wait(1.0 / self.gl.refresh_rate - 1e-3 - (self._end - begin))
        return not self.gl.is_closing

    def _draw(self) -> None:
        self.decor.render(self.gl, quickly=self.is_quick)
        self.tools.distribute_image(lambda: self.gl.read(self.decor.rect))
        self._chrome.draw()

    @property
    def image_size(self) -> tuple[int, int]:
        return int(self.decor.rect.width), int(self.decor.rect.height)

    def image(self) -> Pixels:
        rect = self.decor.rect
        typesetter = self.gl.typesetter_of(rect.width, rect.height)
        self.decor.update(self.data, self.navigator.camera, Pane(rect, typesetter))
        self.decor.render(self.gl)
        return self.gl.read(rect)

    def _pixel(self, at: Pixel | None) -> Pixel | None:
        """Converts a pixel of the window to one of the image (of either eye), or None outside."""
        if at is None:
            return None
        rect = self.decor.rect
        x, y = at[0] - rect.left, at[1] - rect.bottom
        if not (0 <= x < rect.width and 0 <= y < rect.height):
            return None
        return x % self.decor.width, y

    def _place_pointer(self) -> None:
        self.pointer.at = self._pixel(self._mouse.position)

    def _take(self, event: Event, height: int) -> None:
        if event.kind == "drop":
            self.others.open_file(Path(event.key))
            return
        if self._chrome.take(event):
            if event.kind == "move":
                self._mouse.position = (event.x, event.y)
                self._place_pointer()
            return
        if event.kind == "key":
            self._press(event)
            return
        found = self._mouse.take(event)
        self._place_pointer()
        if not self._mouse.is_down:
            self.pointer.dragging.release()
        if isinstance(found, Moved):
            self._move(found, height)
        elif isinstance(found, Clicked):
            self._click(found)

    def _move(self, moved: Moved, height: int) -> None:
        view = self.decor.view
        begin, pressed = self._pixel(moved.pulls_from), self._pixel(moved.pressed)
        pointer = self.pointer
        if view is None or pointer.dragging.take(moved, pointer.at, begin, pressed):
            return
        if self.decor.fixed:
            self.say(self.decor.fixed)
            return
        is_zoom = moved.how == "zoom"
        down = moved.down if is_zoom else moved.down / height
        self.camera_control.move(moved.how, moved.right / height, down)

    def _click(self, clicked: Clicked) -> None:
        at = self._pixel((clicked.x, clicked.y))
        if self.shows_help:
            self.shows_help = False
        elif at is not None:
            self.pointer.click(replace(clicked, x=at[0], y=at[1]))

    def _press(self, event: Event) -> None:
        if event.key != "escape":
            self.actions.press(event.key, is_repeat=event.is_repeat)
        elif self.shows_help:
            self.shows_help = False
        elif self.others.asks:
            self.others.dismiss()
        elif self.gl.is_full_screen:
            self.gl.toggle_full_screen()

    def to_clipboard(self, text: str) -> None:
        self.gl.set_clipboard(text)

    def request_close(self) -> None:
        self.gl.request_close()

    def close(self) -> None:
        super().close()
        self._chrome.close()
        self.gl.close()
