"""Mouse and key events, and `Mouse`, which interprets them as drags and clicks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

LEFT, RIGHT, MIDDLE = 0, 1, 2
DOUBLE_CLICK_TIME = 0.35  # maximum time between the presses of a double click, s
DOUBLE_CLICK_DISTANCE = 8.0  # maximum distance between the presses of a double click, pixels
_MAX_CLICK_MOTION = 4.0  # maximum distance between press and release of a click, pixels


@dataclass(frozen=True)
class Event:
    """A mouse event, a key event or a dropped file.

    Attributes:
        kind: kind of the event; `drop` for a dropped file.
        x: distance from the left edge of the framebuffer in pixels. For `scroll`, the number of
            wheel steps to the right.
        y: distance from the lower edge of the framebuffer in pixels. For `scroll`, the number of
            wheel steps away from the user.
        time: time of the event on the clock of `time.monotonic` in seconds.
        button: mouse button: `LEFT`, `RIGHT` or `MIDDLE`.
        key: key as a lowercase character or a name such as `f1`, `left` or `escape`. For `drop`,
            the path of the file.
        shift: whether Shift or Control was held.
        control: whether Control was held.
        is_repeat: whether the key event repeats because the key is held.
    """

    kind: Literal["press", "release", "move", "scroll", "key", "drop"]
    x: float = 0.0
    y: float = 0.0
    time: float = 0.0
    button: int = LEFT
    key: str = ""
    shift: bool = False
    control: bool = False
    is_repeat: bool = False


@dataclass(frozen=True)
class Moved:
    """A drag of the pointer, or a rotation of the mouse wheel.

    Attributes:
        how: effect on the camera.
        right: motion to the right in pixels.
        down: downward motion in pixels, or the number of wheel steps for `zoom`.
        pulls_from: pixel at which the left button was pressed with Control to pull a link, or None.
        pressed: pixel at which the left button was pressed; None for other buttons.
    """

    how: Literal["orbit", "pan", "zoom"]
    right: float
    down: float
    pulls_from: tuple[float, float] | None = None
    pressed: tuple[float, float] | None = field(default=None, compare=False)


@dataclass(frozen=True)
class Clicked:
    """A mouse click. The time is that of the press on the clock of `time.monotonic` in seconds.

    Attributes:
        center: whether the click centers the view at the clicked point.
    """

    x: float
    y: float
    time: float
    shift: bool = False
    center: bool = False


class Mouse:
    """Interprets mouse events as drags and clicks.

    Attributes:
        position: position of the pointer in pixels; None before the first mouse event.
    """

    def __init__(self) -> None:
        self.position: tuple[float, float] | None = None
        self._pressed: Event | None = None
        self._is_drag = False
        self._right_click: Event | None = None

    @property
    def is_down(self) -> bool:
        return self._pressed is not None

    def hold(self, pulls: Callable[[tuple[float, float]], bool]) -> bool:
        """Treats a long press without motion as a press with Control, for touch screens.

        Args:
            pulls: function that returns whether an item can be pulled at a pixel.
        """
        press = self._pressed
        if press is None or self._is_drag or not pulls((press.x, press.y)):
            return False
        self._pressed = replace(press, control=True)
        return True

    def take(self, event: Event) -> Moved | Clicked | None:
        if event.kind == "scroll":
            return Moved("zoom", 0.0, event.y)
        if event.kind == "key":
            return None
        before = self.position or (event.x, event.y)
        self.position = (event.x, event.y)
        if event.kind == "press":
            if self._pressed is None:
                self._pressed, self._is_drag = event, False
            return None
        if event.kind == "release":
            return self._release(event)
        return self._move(event, before)

    def _move(self, event: Event, before: tuple[float, float]) -> Moved | None:
        press = self._pressed
        if press is None:
            return None
        if not self._is_drag:
            self._is_drag = _apart(press, event) > _MAX_CLICK_MOTION
            if not self._is_drag:
                return None
            before = (press.x, press.y)  # includes the motion before the drag was detected
        right, down = event.x - before[0], before[1] - event.y
        if press.button == MIDDLE:
            return Moved("pan", right, down)
        is_pan = press.button == RIGHT or press.shift
        pulls_from = (press.x, press.y) if press.control and press.button == LEFT else None
        pressed = (press.x, press.y) if press.button == LEFT else None
        return Moved("pan" if is_pan else "orbit", right, down, pulls_from, pressed)

    def _release(self, event: Event) -> Clicked | None:
        press = self._pressed
        if press is None or press.button != event.button:
            return None
        self._pressed = None
        if self._is_drag:
            return None
        if press.button == LEFT:
            return Clicked(press.x, press.y, press.time, press.shift)
        if press.button == RIGHT:
            first, self._right_click = self._right_click, press
            soon = first is not None and press.time - first.time <= DOUBLE_CLICK_TIME
            if soon and first is not None and _apart(first, press) <= DOUBLE_CLICK_DISTANCE:
                self._right_click = None
                return Clicked(press.x, press.y, press.time, center=True)
        return None


def _apart(one: Event, other: Event) -> float:
    return max(abs(one.x - other.x), abs(one.y - other.y))
