"""What a click, a double click, a click with Shift or a key does: one table for every host.

A host finds what is at a pixel with `picking.pick` and passes on what its user did.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

from ..assemble.robot_parts import ARROW_QUANTITIES
from ..assemble.world_view import WorldView
from ..decor.toggles import Toggles
from .input import DOUBLE_CLICK_TIME, Clicked
from .picking import Picked

Gesture = Literal["click", "shift", "double"]
GESTURES: tuple[Gesture, ...] = ("click", "shift", "double")
Action = Callable[[WorldView, Toggles, Picked], None]

_DOUBLE_CLICK_PIXELS = 8.0  # between the two presses


def _joints(world: WorldView, picked: Picked) -> slice:
    """All joints of what was clicked on."""
    return world.owners[picked.owner].joints


def _frames(world: WorldView, picked: Picked) -> Any:
    """All frames of what was clicked on, or the one that belongs to nothing."""
    if picked.owner not in world.owners:
        return [picked.index]
    return world.frames.owner == list(world.owners).index(picked.owner)


def _all_flipped(shown: Any, where: Any) -> None:
    shown[where] = not shown[where].any()


def _toggle_billboard(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.billboards[picked.index] ^= True


def _toggle_billboards(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    _all_flipped(toggles.billboards, _joints(world, picked))


def _toggle_axes(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    _all_flipped(toggles.axes, _frames(world, picked))


def _hide_billboard(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.billboards[picked.index] = toggles.details[picked.index] = False


def _hide_billboards(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    joints = _joints(world, picked)
    toggles.billboards[joints] = toggles.details[joints] = False


def _toggle_details(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.details[picked.index] ^= True


def _toggle_all_details(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    _all_flipped(toggles.details, _joints(world, picked))


def _next_quantity_here(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    joints = _joints(world, picked)
    following = toggles.arrow_quantity[picked.index] + 1
    toggles.arrow_quantity[joints] = following % len(ARROW_QUANTITIES)


def _toggle_name(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.frame_names[picked.index] ^= True


def _toggle_names(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    _all_flipped(toggles.frame_names, _frames(world, picked))


def _hide_axes(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.axes[picked.index] = toggles.frame_names[picked.index] = False


def _toggle_card(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.cards[picked.index] ^= True


def _toggle_cards(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.cards[:] = not toggles.cards.any()


def _hide_checks(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    toggles.flange_checks = False


def _leave(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    """Nothing that is shown changes."""


# Gesture and what it is made on: what it does, in words, and how. Every host reads this table.
CLICKS: dict[tuple[Gesture, str], tuple[str, Action]] = {
    ("click", "link"): ("its joint's billboard on or off", _toggle_billboard),
    ("shift", "link"): ("all billboards of the robot on or off", _toggle_billboards),
    ("double", "link"): ("all axes of the robot on or off", _toggle_axes),
    ("click", "billboard"): ("hides it", _hide_billboard),
    ("shift", "billboard"): ("hides all of the robot", _hide_billboards),
    ("click", "arrow"): ("its precise numbers on or off", _toggle_details),
    ("shift", "arrow"): ("precise numbers of the whole robot on or off", _toggle_all_details),
    ("double", "arrow"): ("the robot's arrows show the next quantity", _next_quantity_here),
    ("click", "axes"): ("their name on or off", _toggle_name),
    ("shift", "axes"): ("names of all axes of the robot on or off", _toggle_names),
    ("double", "axes"): ("hides them", _hide_axes),
    ("click", "name"): ("hides it", _toggle_name),
    ("shift", "name"): ("hides all of the robot", _toggle_names),
    ("click", "vector"): ("its numbers on or off", _toggle_card),
    ("shift", "vector"): ("numbers of all smart arrows on or off", _toggle_cards),
    ("click", "card"): ("hides it", _toggle_card),
    ("shift", "card"): ("hides all of them", _toggle_cards),
    ("click", "check"): ("hides the comparison of flange frames", _hide_checks),
    ("double", "object"): ("the view turns about it", _leave),  # the host moves its camera
}
# A transparent double is clicked on like a robot; one of a path has nothing to show.
CLICKS |= {
    (gesture, "double"): entry for (gesture, kind), entry in CLICKS.items() if kind == "link"
}


def click(
    world: WorldView, toggles: Toggles, picked: Picked | None, gesture: Gesture = "click"
) -> bool:
    """Does what a gesture on something does, see `CLICKS`.

    A double click on nothing shows again what the scene declares.

    Args:
        world: the compiled scene.
        toggles: changed in place.
        picked: what it was made on; None for the sky and the floor.
        gesture: a click, one with Shift held, or a double click.

    Returns:
        whether the table has an entry for it.
    """
    if picked is None:
        if gesture == "double":
            toggles.reset()
        return gesture == "double"
    if (gesture, picked.kind) not in CLICKS:
        return False
    if picked.kind in ("link", "double"):
        owner = world.owners.get(picked.owner)
        if owner is None or not owner.robot.enable_touch_sensor:
            return False
    CLICKS[gesture, picked.kind][1](world, toggles, picked)
    return True


@dataclass
class Pointer:
    """Tells clicks from double clicks, and undoes the click that a double click begins with.

    Attributes:
        world: the compiled scene.
        toggles: changed in place.
    """

    world: WorldView
    toggles: Toggles
    _before: dict[str, Any] = field(default_factory=dict)
    _first: Picked | None = None
    _where: tuple[float, float] = (0.0, 0.0)
    _when: float = float("-inf")

    def press(
        self, picked: Picked | None, pixel: tuple[float, float], time: float, *, shift: bool = False
    ) -> Gesture:
        """Takes one press of the button and does what it means.

        Args:
            picked: what is at the pixel.
            pixel: where it was.
            time: when, s on any clock.
            shift: whether a modifier was held.

        Returns:
            the gesture it was taken for.
        """
        apart = max(abs(a - b) for a, b in zip(pixel, self._where, strict=True))
        second = time - self._when <= DOUBLE_CLICK_TIME and apart <= _DOUBLE_CLICK_PIXELS
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


def hover(toggles: Toggles, picked: Picked | None, pixel: tuple[float, float]) -> None:
    """Writes the name of what is under the pointer beside it, from the next frame on.

    Args:
        toggles: changed in place.
        picked: what is there.
        pixel: x to the right and y up from the lower left corner of the picture.
    """
    # A billboard has its name on it, and one in front would hide its numbers.
    name = "" if picked is None or picked.kind == "billboard" else picked.name
    toggles.hover = (name, pixel) if name else None


def _next_quantity(toggles: Toggles) -> None:
    toggles.arrow_quantity[:] = (toggles.arrow_quantity + 1) % len(ARROW_QUANTITIES)


def _flip(name: str) -> Callable[[Toggles], None]:
    def flip(toggles: Toggles) -> None:
        shown = getattr(toggles, name)
        if isinstance(shown, bool):
            setattr(toggles, name, not shown)
        else:
            shown[:] = not shown.any()

    return flip


# Key, the field of `Toggles` that it flips, and what that is called.
SWITCHES: dict[str, tuple[str, str]] = {
    "a": ("arrows", "arrows"),
    "b": ("billboards", "billboards"),
    "x": ("axes", "axes"),
    "n": ("frame_names", "names of axes"),
    "d": ("doubles", "transparent doubles"),
    "v": ("vectors", "smart arrows"),
    "c": ("flange_checks", "comparison of flange frames"),
    "l": ("legend", "legend"),
    "s": ("status", "faults of the sources"),
}
KeyAction = tuple[str, Callable[[Toggles], None]]


def _flips(keys: str) -> dict[str, KeyAction]:
    return {key: (f"{SWITCHES[key][1]} on or off", _flip(SWITCHES[key][0])) for key in keys}


# Key, what it does, and how: every host reads this one table.
KEYS: dict[str, KeyAction] = {
    **_flips("abx"),
    "n": ("names of all axes on or off", _flip("frame_names")),  # a click is for one
    "q": ("arrows show the next quantity", _next_quantity),
    **_flips("dvcls"),
    "r": ("what the scene declares", Toggles.reset),
}
# What keys do to the camera, the clock and the window of a live host: the name of what it does, and
# what that is in words. A host has a function for each, or leaves it to its own controls.
HOST_KEYS: dict[str, tuple[str, str]] = {
    " ": ("pause", "pause, go on"),
    ".": ("step", "single step"),
    ",": ("step_back", "single step back"),
    "-": ("slower", "slower"),
    "+": ("faster", "faster"),
    "backspace": ("reset", "back to the start"),
    "left": ("back", "1 s back"),
    "right": ("on", "1 s on"),
    "0": ("camera", "0 the first view, 1 to 9 cameras"),
    "f": ("follow", "follow what is under the pointer"),
    "p": ("plot", "torques of the selected joint"),
    "]": ("next_joint", "select the next joint, [ the last"),
    "t": ("status_line", "status line on or off"),
    "f2": ("screenshot", "screenshot of the scene"),
    "f3": ("film", "film on or off"),
    "f11": ("full_screen", "full screen"),
    "h": ("help", "help, its next page"),
}
# What a browser does itself.
OF_BROWSER = ("f2", "f3", "f11")
# Other keys for the same, that a help need not list.
MORE_KEYS: dict[str, str] = {
    "?": "help",
    "f1": "help",
    "=": "faster",
    "_": "slower",
    "[": "last_joint",
    "home": "reset",
    **{str(number): "camera" for number in range(1, 10)},
}
# What the mouse does to the camera of a live host.
HOST_MOUSE: dict[str, str] = {
    "drag": "turns the view",
    "right drag": "moves it, also with Shift",
    "wheel": "nearer, farther",
    "right double click": "turns about that point",
}


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
