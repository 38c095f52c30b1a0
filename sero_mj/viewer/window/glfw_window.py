"""`GlWindow`: a GLFW window, including input events and OpenGL contexts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import glfw
import mujoco
import numpy as np

from ...base.errors import RenderError, shown
from ...robots.assemble.world_view import WorldView
from ..decor.font import line_height
from ..image.image_files import Pixels
from ..image.render import check_size, offscreen_size
from ..image.typesetting import Typesetter
from ..session.input import LEFT, MIDDLE, RIGHT, Event
from .gl_blend import Blender

_SAMPLES = 4  # number of samples per pixel, for antialiasing
_TEXT_HEIGHT = 18.0  # text height of the window at content scale 1, pixels
_SMALLEST = (320, 240)
_NAMED_KEYS = {
    glfw.KEY_BACKSPACE: "backspace",
    glfw.KEY_LEFT: "left",
    glfw.KEY_RIGHT: "right",
    glfw.KEY_UP: "up",
    glfw.KEY_DOWN: "down",
    glfw.KEY_ENTER: "enter",
    glfw.KEY_KP_ENTER: "enter",
    glfw.KEY_DELETE: "delete",
    glfw.KEY_HOME: "home",
    glfw.KEY_END: "end",
    glfw.KEY_ESCAPE: "escape",
    glfw.KEY_TAB: "tab",
    glfw.KEY_F1: "f1",
    glfw.KEY_F2: "f2",
    glfw.KEY_F3: "f3",
    glfw.KEY_F11: "f11",
}


class GlWindow:
    """A window with an OpenGL context for a world.

    Args:
        size: size of the window in screen coordinates, limited to the size of the screen.

    Attributes:
        context: context that renders the scene.
        typesetter: typesetter of text in the window, whose text size depends on the screen.
        on_key: function called with the key, action and modifiers of GLFW, before other handlers.
        on_character: function called with the code of each typed character.

    Raises:
        RenderError: there is no display, or OpenGL is not available.
    """

    def __init__(
        self, world: WorldView, size: tuple[int, int], title: str, *, full_screen: bool = False
    ) -> None:
        _check(size)
        _start_glfw()
        self._world = world
        self._events: list[Event] = []
        self._polled = time.monotonic()
        self._is_repeat = False
        self.on_key: Callable[[int, int, int], None] | None = None
        self.on_character: Callable[[int], None] | None = None
        self._at: tuple[float, float] | None = None  # position of the pointer, screen coordinates
        self._windowed: tuple[int, int, int, int] | None = None
        mode = glfw.get_video_mode(glfw.get_primary_monitor())
        self.refresh_rate = float(mode.refresh_rate or 60)
        if not full_screen:
            size = min(size[0], mode.size.width), min(size[1], mode.size.height)
        self._window = _make_window(size, title)
        glfw.set_window_size_limits(self._window, *_SMALLEST, glfw.DONT_CARE, glfw.DONT_CARE)
        if full_screen:
            self.toggle_full_screen()
        glfw.make_context_current(self._window)
        glfw.swap_interval(1)
        self._make_contexts()
        self._listen()

    def _make_contexts(self) -> None:
        world = self._world
        height = _TEXT_HEIGHT * glfw.get_window_content_scale(self._window)[1]
        self.typesetter = self._of_image = Typesetter(round(height))
        self.blender = Blender()
        # The scene is rendered into the window's buffer. Only quick frames need the offscreen one.
        with offscreen_size(world.model, 16, 16, samples=0):
            self.context = mujoco.MjrContext(world.model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_WINDOW, self.context)

    def _listen(self) -> None:
        window = self._window
        glfw.set_mouse_button_callback(window, self._on_button)
        glfw.set_cursor_pos_callback(window, self._on_move)
        glfw.set_scroll_callback(window, self._on_scroll)
        glfw.set_key_callback(window, self._on_key)
        glfw.set_char_callback(window, self._on_char)
        on_drop: Any = self._on_drop  # The type annotation of GLFW is wrong.
        glfw.set_drop_callback(window, on_drop)

    @property
    def size(self) -> tuple[int, int]:
        width, height = glfw.get_framebuffer_size(self._window)
        return int(width), int(height)

    @property
    def is_closing(self) -> bool:
        return self._window is None or bool(glfw.window_should_close(self._window))

    @property
    def is_full_screen(self) -> bool:
        return self._windowed is not None

    def request_close(self) -> None:
        glfw.set_window_should_close(self._window, True)

    def events(self) -> list[Event]:
        """Returns the events since the last call.

        GLFW does not report the times of events. They are spread evenly over the time since the
        last call, so that two clicks during a slow frame are not mistaken for a double click.
        """
        last, self._polled = self._polled, time.monotonic()
        glfw.poll_events()
        events, self._events = self._events, []
        return spread_times(events, last, self._polled)

    def typesetter_of(self, width: int, height: int) -> Typesetter:
        """Returns the typesetter for panels in an image, whose size is given in pixels.

        The text is at least as large as other text in the window.
        """
        line = max(line_height(self._world, width, height), self.typesetter.font.height)
        if line != self._of_image.font.height:
            self._of_image = Typesetter(line)
        return self._of_image

    @property
    def clipboard(self) -> str:
        with _glfw_errors():  # The clipboard may contain an image, which causes an error.
            text: Any = glfw.get_clipboard_string(self._window)
        return str((text or b"").decode("utf-8", "replace"))

    def set_clipboard(self, text: str) -> None:
        glfw.set_clipboard_string(self._window, text)

    def render_quickly(self, rect: mujoco.MjrRect, scene: mujoco.MjvScene) -> None:
        """Renders a scene into a rectangle of the window without multisampling and shadows.

        On machines without a GPU, this saves most of the rendering time.
        """
        context, shadow = self.context, mujoco.mjtRndFlag.mjRND_SHADOW
        here = self._offscreen(rect)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, context)
        before = scene.flags[shadow]
        scene.flags[shadow] = 0
        mujoco.mjr_render(here, scene, context)
        scene.flags[shadow] = before
        mujoco.mjr_blitBuffer(here, rect, 1, 0, context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_WINDOW, context)

    def read(self, rect: mujoco.MjrRect) -> Pixels:
        """Returns the rendered pixels of a rectangle of the window, with the top row first.

        Returns:
            pixels, shape (height, width, 3), uint8.
        """
        # The window's buffer is multisampled. Blitting resolves the samples, but reading does not.
        here = self._offscreen(rect)
        mujoco.mjr_blitBuffer(rect, here, 1, 0, self.context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self.context)
        pixels = np.empty((rect.height, rect.width, 3), np.uint8)
        mujoco.mjr_readPixels(pixels, None, here, self.context)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_WINDOW, self.context)
        return np.ascontiguousarray(pixels[::-1])

    def _offscreen(self, rect: mujoco.MjrRect) -> mujoco.MjrRect:
        context = self.context
        if (context.offWidth, context.offHeight) != (rect.width, rect.height):
            mujoco.mjr_resizeOffscreen(rect.width, rect.height, context)
        return mujoco.MjrRect(0, 0, rect.width, rect.height)

    def swap(self) -> None:
        glfw.swap_buffers(self._window)

    def wait(self, seconds: float) -> None:
        if seconds > 0:
            glfw.wait_events_timeout(seconds)

    def toggle_full_screen(self) -> None:
        window = self._window
        if self._windowed is not None:
            no_monitor: Any = None
            glfw.set_window_monitor(window, no_monitor, *self._windowed, glfw.DONT_CARE)
            self._windowed = None
            return
        self._windowed = (*glfw.get_window_pos(window), *glfw.get_window_size(window))
        monitor = self._monitor()
        mode = glfw.get_video_mode(monitor)
        glfw.set_window_monitor(
            window, monitor, 0, 0, mode.size.width, mode.size.height, mode.refresh_rate
        )

    def _monitor(self) -> Any:
        x, y = glfw.get_window_pos(self._window)
        width, height = glfw.get_window_size(self._window)
        x, y = x + width // 2, y + height // 2
        for monitor in glfw.get_monitors():
            left, top = glfw.get_monitor_pos(monitor)
            size = glfw.get_video_mode(monitor).size
            if 0 <= x - left < size.width and 0 <= y - top < size.height:
                return monitor
        return glfw.get_primary_monitor()

    def close(self) -> None:
        if self._window is not None:
            self.context.free()
            glfw.destroy_window(self._window)
            self._window = None

    def _add(self, kind: Any, **values: Any) -> None:
        self._events.append(Event(kind, time=time.monotonic(), **values))

    def _pixel(self, x: float, y: float) -> dict[str, float]:
        width, height = glfw.get_window_size(self._window)
        pixels = self.size
        return {
            "x": x * pixels[0] / max(width, 1),
            "y": pixels[1] - y * pixels[1] / max(height, 1),
        }

    def _on_button(self, window: Any, button: int, action: int, mods: int) -> None:
        # `get_cursor_pos` may return a later position than that of the press.
        x, y = self._at or glfw.get_cursor_pos(window)
        kind = "press" if action == glfw.PRESS else "release"
        shift = bool(mods & (glfw.MOD_SHIFT | glfw.MOD_CONTROL))
        if button in (LEFT, RIGHT, MIDDLE):
            control = bool(mods & glfw.MOD_CONTROL)
            self._add(kind, button=button, shift=shift, control=control, **self._pixel(x, y))

    def _on_move(self, window: Any, x: float, y: float) -> None:
        self._at = (x, y)
        self._add("move", **self._pixel(x, y))

    def _on_scroll(self, window: Any, x: float, y: float) -> None:
        self._add("scroll", x=x, y=y)

    def _on_key(self, window: Any, key: int, code: int, action: int, mods: int) -> None:
        self._is_repeat = action == glfw.REPEAT
        if self.on_key is not None:
            self.on_key(key, action, mods)
        if action == glfw.RELEASE:
            return
        if key in (glfw.KEY_Q, glfw.KEY_W) and mods & (glfw.MOD_CONTROL | glfw.MOD_SUPER):
            self.request_close()
        elif mods & (glfw.MOD_CONTROL | glfw.MOD_SUPER):
            # The letter on a key depends on the keyboard layout.
            letter = (glfw.get_key_name(key, code) or "").lower()
            if letter == "z" and mods & glfw.MOD_SHIFT:
                letter = "y"
            self._add("key", key=f"ctrl+{letter}", is_repeat=self._is_repeat)
        elif key in _NAMED_KEYS:
            self._add("key", key=_NAMED_KEYS[key], is_repeat=self._is_repeat)

    def _on_drop(self, window: Any, paths: Sequence[str]) -> None:
        if paths:  # A window shows one scene, so only the first file is opened.
            self._add("drop", key=str(paths[0]))

    def _on_char(self, window: Any, code: int) -> None:
        if self.on_character is not None:
            self.on_character(code)
        # Characters work with all keyboard layouts, unlike keys.
        self._add("key", key=chr(code).lower(), is_repeat=self._is_repeat)


def spread_times(events: Sequence[Event], begin: float, end: float) -> list[Event]:
    """Sets equidistant times of events, after `begin` and up to `end`, both in seconds."""
    step = (end - begin) / max(len(events), 1)
    return [replace(each, time=begin + step * (i + 1)) for i, each in enumerate(events)]


@contextmanager
def _glfw_errors() -> Iterator[list[str]]:
    errors: list[str] = []

    def note(code: int, text: Any) -> None:
        errors.append(text.decode(errors="replace") if isinstance(text, bytes) else str(text))

    no_callback: Any = None
    listener: Callable[[int, str], None] = note
    glfw.set_error_callback(listener)
    try:
        yield errors
    finally:
        glfw.set_error_callback(no_callback)


def _start_glfw() -> None:
    with _glfw_errors() as errors:
        if glfw.init():
            return
    reason = errors[-1] if errors else "GLFW cannot be initialized"
    raise RenderError(f"cannot open a window: {reason}; check that there is a display")


def _check(size: Any) -> None:
    try:
        width, height = (int(side) for side in size)
    except (TypeError, ValueError):
        raise RenderError(
            f"window size {shown(size)}: expected width and height in pixels"
        ) from None
    check_size("window", width, height)


def _make_window(size: tuple[int, int], title: str) -> Any:
    with _glfw_errors() as errors:
        glfw.default_window_hints()
        glfw.window_hint(glfw.SCALE_TO_MONITOR, glfw.TRUE)
        for samples in (_SAMPLES, 0):
            glfw.window_hint(glfw.SAMPLES, samples)
            window = glfw.create_window(*size, title, None, None)
            if window:
                return window
    reason = errors[-1] if errors else "no OpenGL"
    raise RenderError(f"cannot open a window: {reason}; `sero-mj render` needs no window")
