"""What a click does in every live host, whatever it is made with."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from .interaction import Pointer
from .mouse import Clicked
from .picking import Picked

OnClick = Callable[[Picked | None, str], None]
_OF_JOINTS = ("link", "double", "arrow", "billboard")


class Clickable(Protocol):
    """What is clicked on.

    Attributes:
        joint: the joint of the world whose torques are plotted.
        on_click: called with what was clicked on and the gesture.
    """

    joint: int
    on_click: OnClick | None


def take_click(
    host: Clickable,
    pointer: Pointer,
    picked: Picked | None,
    clicked: Clicked,
    centre: Callable[[tuple[float, float]], None],
) -> None:
    """Does what a click means, by the table of `interaction`.

    Args:
        host: selects the joint of what was clicked on, and is told.
        pointer: of the host.
        picked: what is at the pixel.
        clicked: where and when it was.
        centre: lets the view turn about what is at a pixel.
    """
    at = (clicked.x, clicked.y)
    gesture = pointer.press(picked, at, clicked.time, shift=clicked.shift)
    if picked is not None and picked.kind in _OF_JOINTS and picked.index >= 0:
        host.joint = picked.index
    if picked is not None and picked.kind == "object" and gesture == "double":
        centre(at)
    if host.on_click is not None:
        host.on_click(picked, gesture)
