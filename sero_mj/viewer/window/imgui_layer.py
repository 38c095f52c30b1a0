"""`ImguiLayer`: draws Dear ImGui in a window, and passes mouse and keyboard events to it."""

from __future__ import annotations

import time
from collections.abc import Callable

import glfw
from imgui_bundle import ImVec2, imgui, implot

from ..panels.imgui_widgets import ImguiWidgets
from ..session.input import Event
from ..session.widgets import Widgets
from .glfw_window import GlWindow
from .style import set_style

# This version works with OpenGL 2.1, which MuJoCo needs, and later versions.
_GLSL = "#version 120"
_TEXT = 0.84  # text height relative to other text in the window
_KEYS = {
    glfw.KEY_TAB: imgui.Key.tab,
    glfw.KEY_BACKSPACE: imgui.Key.backspace,
    glfw.KEY_DELETE: imgui.Key.delete,
    glfw.KEY_ENTER: imgui.Key.enter,
    glfw.KEY_KP_ENTER: imgui.Key.keypad_enter,
    glfw.KEY_ESCAPE: imgui.Key.escape,
    glfw.KEY_LEFT: imgui.Key.left_arrow,
    glfw.KEY_RIGHT: imgui.Key.right_arrow,
    glfw.KEY_HOME: imgui.Key.home,
    glfw.KEY_END: imgui.Key.end,
    glfw.KEY_A: imgui.Key.a,
    glfw.KEY_C: imgui.Key.c,
    glfw.KEY_V: imgui.Key.v,
    glfw.KEY_X: imgui.Key.x,
    glfw.KEY_Z: imgui.Key.z,
}
_MODIFIERS = {
    glfw.MOD_CONTROL: imgui.Key.mod_ctrl,
    glfw.MOD_SHIFT: imgui.Key.mod_shift,
    glfw.MOD_SUPER: imgui.Key.mod_super,
}


class ImguiLayer:
    """Draws Dear ImGui in the OpenGL context of a window, and restores the state of the context."""

    def __init__(self, gl: GlWindow) -> None:
        self._gl = gl
        self.size = gl.size  # Each query is a request to the display, so there is one per frame.
        self.text_height = round(_TEXT * gl.typesetter.font.height)
        self._context, self._plots = imgui.create_context(), implot.create_context()
        io = imgui.get_io()
        io.set_ini_filename("")
        io.config_flags |= imgui.ConfigFlags_.no_mouse_cursor_change
        set_style(self.text_height)
        imgui.backends.opengl3_init(_GLSL)
        platform = imgui.get_platform_io()
        platform.platform_get_clipboard_text_fn = lambda _: gl.clipboard
        platform.platform_set_clipboard_text_fn = lambda _, text: gl.set_clipboard(text)
        gl.on_key, gl.on_character = self._key, io.add_input_character
        self.widgets: Widgets = ImguiWidgets(imgui, implot)
        # ImGui windows that handle the mouse: left, top, width and height.
        self._rects: list[tuple[float, float, float, float]] = []
        self._at = (-1.0, -1.0)  # position of the pointer in pixels from the upper left corner
        self._is_held = False  # whether the mouse button was pressed over an ImGui window
        self._released: list[int] = []  # released buttons, passed to ImGui one frame later
        self._has_popup = False  # whether, for example, a drop-down list is open
        self._last = time.monotonic()

    @property
    def takes_keys(self) -> bool:
        return bool(imgui.get_io().want_text_input)

    def take(self, event: Event) -> bool:
        """Handles an event, and returns whether the rest of the window must ignore it."""
        if event.kind == "key":
            return self.takes_keys
        io = imgui.get_io()
        if event.kind == "scroll":
            is_over = self._is_over(*self._at)
            if is_over:
                io.add_mouse_wheel_event(event.x, event.y)
            return is_over
        self._at = x, y = event.x, self.size[1] - event.y
        io.add_mouse_pos_event(x, y)
        if event.kind == "move":
            return self._is_held
        is_press = event.kind == "press"
        if is_press and not self._is_over(x, y):
            imgui.set_window_focus(None)  # A text field loses the focus.
            return False
        was_held, self._is_held = self._is_held, is_press
        if is_press:
            io.add_mouse_button_event(event.button, True)
        elif was_held:
            # A dragged widget must first move to the position at which the button was released.
            self._released.append(event.button)
        return is_press or was_held

    def is_over(self, x: float, y: float) -> bool:
        return self._is_over(x, self.size[1] - y)

    def _is_over(self, x: float, y: float) -> bool:
        return self._has_popup or any(
            left <= x < left + width and top <= y < top + height
            for left, top, width, height in self._rects
        )

    def _key(self, key: int, action: int, mods: int) -> None:
        io = imgui.get_io()
        for modifier, name in _MODIFIERS.items():
            io.add_key_event(name, bool(mods & modifier))
        if key in _KEYS:
            io.add_key_event(_KEYS[key], action != glfw.RELEASE)

    def frame(self, size: tuple[int, int], build: Callable[[], None]) -> None:
        """Builds the widgets of a frame, which `draw` draws.

        Args:
            size: width and height of the window in pixels.
            build: function that builds ImGui windows, and calls `take_mouse` in each window that
                handles the mouse.
        """
        now = time.monotonic()
        io = imgui.get_io()
        self.size = size
        io.display_size = ImVec2(*size)
        io.delta_time, self._last = max(now - self._last, 1e-4), now
        imgui.backends.opengl3_new_frame()
        imgui.new_frame()
        for button in self._released:
            io.add_mouse_button_event(button, False)
        self._released.clear()
        self._rects.clear()
        build()
        self._has_popup = imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
        imgui.render()

    def take_mouse(self) -> None:
        place, size = imgui.get_window_pos(), imgui.get_window_size()
        self._rects.append((place.x, place.y, size.x, size.y))

    def draw(self) -> None:
        imgui.backends.opengl3_render_draw_data(imgui.get_draw_data())

    def close(self) -> None:
        self._gl.on_key = self._gl.on_character = None
        imgui.backends.opengl3_shutdown()
        implot.destroy_context(self._plots)
        imgui.destroy_context(self._context)
