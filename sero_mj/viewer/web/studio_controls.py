"""Plugins that connect Studio's mouse, keys and time controls to a host of this package."""

from __future__ import annotations

import string
import time
from collections.abc import Callable

from mujoco.studio import app as studio_app
from mujoco.studio import messages, plugin, sim, sim_history, ux
from mujoco.studio.dear_imgui import dear_imgui as imgui

from ..session.clock import Clock
from ..session.input import LEFT, RIGHT, Clicked, Event, Mouse, Moved
from ..session.live import LiveHost

_BUTTONS = ((LEFT, imgui.MouseButton.Left), (RIGHT, imgui.MouseButton.Right))
# Names of keys here and in Studio; those of `interaction.OF_BROWSER` are omitted, and Escape.
_NAMED = {
    " ": imgui.Key.Space,
    ".": imgui.Key.Period,
    ",": imgui.Key.Comma,
    "-": imgui.Key.Minus,
    "=": imgui.Key.Equal,
    "[": imgui.Key.LeftBracket,
    "]": imgui.Key.RightBracket,
    "?": imgui.Key.Slash,
    "backspace": imgui.Key.Backspace,
    "home": imgui.Key.Home,
    "end": imgui.Key.End,
    "left": imgui.Key.LeftArrow,
    "right": imgui.Key.RightArrow,
    "f1": imgui.Key.F1,
    "f2": imgui.Key.F2,
    "f3": imgui.Key.F3,
}
_LETTERS = {letter.lower(): getattr(imgui.Key, letter) for letter in string.ascii_uppercase}
_DIGITS = {digit: getattr(imgui.Key, f"N{digit}") for digit in string.digits}
_HELD = (".", ",", "-", "=", "left", "right", "[", "]")  # repeated while they are held down
IMGUI_KEYS = {**_NAMED, **_LETTERS, **_DIGITS}
_RUNS = sim.PauseState.UNPAUSED
_PAUSED = sim.PauseState.NORMAL_PAUSED


class StudioApp(studio_app.App):
    """Studio's menus, tool bar and panels.

    Studio's own keys and its perturbation of bodies are disabled, because the state is that of a
    mirrored robot. The browser moves the camera by itself.

    Args:
        host: handles clicks, keys and the pointer.

    Attributes:
        press_time: returns when a button was pressed that is seen to be pressed now, s.
        take_left: returns whether the browser that was pressing has gone, once.
        take_hold: returns whether a finger has been held still, once for every time.
        docked: width of what is docked to the left and the right edge of the page, pixels.
    """

    def __init__(self, host: LiveHost) -> None:
        super().__init__(
            studio_app.Config(
                show_options=False,
                show_inspector=False,
                show_status_bar=False,
                show_view_gizmo=True,
            )
        )
        self._host = host
        self._mouse = Mouse()
        self._is_on_handle = False  # whether the pointer is
        self._pulls = False  # whether the drag that goes on pulls, and the camera stays
        self.take_left: Callable[[], bool] = lambda: False
        self.take_hold: Callable[[], bool] = lambda: False
        self.press_time: Callable[[int], float] = lambda button: time.monotonic()
        self.docked = (0.0, 0.0)

    def build_gui(self) -> None:
        """Builds Studio's windows, and notes which edges of the page they are docked to."""
        super().build_gui()
        width = imgui.GetIO().DisplaySize.x
        left = right = 0.0
        for title, is_shown in (
            ("Options", self.config.show_options),
            ("Inspector", self.config.show_inspector),
        ):
            if not is_shown:
                continue
            imgui.Begin(title)  # once more, to ask where it is
            if imgui.IsWindowDocked():
                place, size = imgui.GetWindowPos(), imgui.GetWindowSize()
                if place.x + size.x / 2 < width / 2:
                    left = max(left, place.x + size.x)
                else:
                    right = max(right, width - place.x)
            imgui.End()
        self.docked = (left, right)

    def reset_camera_index(self, index: int) -> None:
        """Sets the index of the current camera in Studio."""
        self.ux_state.camera_index = index

    def align_camera(self) -> None:
        """Does nothing: the camera is that of the scene."""
        self.ux_state.camera_index = ux.TUMBLE_CAMERA_IDX

    def handle_mouse_events(self) -> None:
        """Distinguishes clicks from drags, with which the browser moves its camera."""
        io = imgui.GetIO()
        height = io.DisplaySize.y
        at = (io.MousePos.x, height - io.MousePos.y)
        # A handle holds the browser's camera, as a window does, before it is pressed.
        is_free = not imgui.IsWindowHovered(int(imgui.HoveredFlags.AnyWindow))
        is_own = self._pulls or (self._is_on_handle and is_free)
        over_scene = (is_own or not io.WantCaptureMouse) and imgui.IsMousePosValid()

        def event(kind: str, button: int = LEFT, when: float = 0.0) -> Event:
            shift, control = io.KeyShift or io.KeyCtrl, io.KeyCtrl
            return Event(kind, *at, when, button, shift=shift, control=control)  # type: ignore[arg-type]

        if self.take_left():  # and its button is no longer down
            self._mouse = Mouse()
        found = [self._mouse.take(event("move"))]
        for button, studio_button in _BUTTONS:
            if imgui.IsMouseClicked(int(studio_button)):
                when = self.press_time(button)
                if over_scene:
                    found.append(self._mouse.take(event("press", button, when)))
            if imgui.IsMouseReleased(int(studio_button)):
                found.append(self._mouse.take(event("release", button)))
        # A slow browser may tell of a hold before its press is seen here.
        if self._mouse.is_down and self.take_hold() and self._mouse.hold(self._host.hold):
            self._pulls = True
        for each in found:
            if isinstance(each, Clicked):
                self._host.click(each)
            elif isinstance(each, Moved):
                self._pulls |= self._host.drag(each, at, each.pulls_from, each.pressed)
        if self._pulls and io.MouseWheel:
            self._host.drag(Moved("zoom", 0.0, io.MouseWheel), at, None, None)
        if not self._mouse.is_down:
            self._pulls = False
            self._host.let_go()
        self._is_on_handle = over_scene and self._host.hover_handle(at)
        if (
            self._pulls or self._is_on_handle
        ):  # the browser leaves its camera alone, as over a window
            imgui.SetNextFrameWantCaptureMouse(True)
        self._host.point(at if over_scene and not self._mouse.is_down else None)

    def handle_keyboard_events(self) -> None:
        """Handles the keys of `interaction`."""
        io = imgui.GetIO()
        if io.WantCaptureKeyboard or io.KeyAlt:
            return
        if io.KeyCtrl or io.KeySuper:
            for letter in "zyc":
                if imgui.IsKeyPressed(_LETTERS[letter], False):
                    redo = letter == "z" and io.KeyShift
                    self._host.actions.press("ctrl+y" if redo else f"ctrl+{letter}")
            return
        for name, key in IMGUI_KEYS.items():
            if imgui.IsKeyPressed(key, name in _HELD):
                if name == "=" and io.KeyShift:
                    self._host.actions.press("+")
                elif name == "?" and not io.KeyShift:
                    continue
                else:
                    self._host.actions.press(name)

    def apply_perturb(self) -> None:
        """Does nothing: a mirrored robot is not simulated by this model."""


class TimeControl(plugin.SimPlugin):
    """Replaces Studio's `StepControl`: time and state are those of the mirror.

    Args:
        clock: of the mirror.

    Attributes:
        is_held: whether time is stopped because no browser has connected yet.
    """

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._last = time.monotonic()
        self._is_scrubbed = False
        self.is_held = False

    def snapshot(self) -> messages.StepControlSnapshot:
        """Returns the state of Studio's controls."""
        control = sim.StepControl()
        control.set_pause_state(_PAUSED if self._clock.is_paused else _RUNS)
        control.set_speed(100.0 * self._clock.speed)
        return messages.StepControlSnapshot.from_step_control(control)

    @messages.handler
    def on_step_control(self, event: messages.StepControlSnapshot) -> bool:
        """Applies pause and speed that were set on the page."""
        wanted = event.pause_state != _RUNS
        if wanted != self._clock.is_paused:
            self._clock.pause()
        if not self._clock.is_live:
            self._clock.speed = self._clock.real_speed = max(event.speed / 100.0, 1e-3)
        return True

    @messages.handler
    def on_single_step(self, event: messages.SingleStepEvent) -> bool:
        """Advances by a single step."""
        self._clock.step()
        return True

    @messages.handler
    def on_pause(self, event: messages.RequestPauseEvent) -> bool:
        """Pauses when the user opens Studio's history."""
        self._clock.is_paused = event.pause_state != _RUNS
        return True

    @messages.handler
    def on_reset(self, event: messages.ResetEvent) -> bool:
        """Resets the mirror to the start, not the data to zero as Studio does."""
        self._clock.reset()
        return True

    @messages.handler
    def on_state(self, event: messages.StateEvent) -> bool:
        """Refuses a state that was edited in Studio's inspector: it never came from the robot."""
        return True

    @messages.handler
    def on_history(self, event: sim_history.SimHistorySnapshot) -> None:
        """Handles the selection of a past state, which `SimHistory` writes to the data."""
        self._is_scrubbed = True

    @messages.handler
    def on_step(self, event: messages.StepEvent) -> None:
        """Advances the mirror to the current time."""
        now = time.monotonic()
        passed, self._last = now - self._last, now
        clock = self._clock
        with self.handle.send_if_changes(self.snapshot):
            if self._is_scrubbed and clock.can_go_back:
                self._is_scrubbed = False
                clock.seek(event.data.time)
            elif self._is_scrubbed and not clock.is_paused:
                self._is_scrubbed = False
                clock.reset()  # the current state, not the one that the history has written
            clock.advance(0.0 if self.is_held else passed)
