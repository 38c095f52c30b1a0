"""Actions of clicks, double clicks, clicks with Shift, and keys: one table for all hosts.

A host finds the item at a pixel by `picking.pick` and passes on the user's input.
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

_DOUBLE_CLICK_PIXELS = 8.0  # maximum distance between the two presses


def _joints(world: WorldView, picked: Picked) -> slice:
    """Returns all joints of the robot or double of an item, (N,) bool."""
    return world.owners[picked.owner].joints


def _frames(world: WorldView, picked: Picked) -> Any:
    """Returns all frames of the owner of an item, or a frame without owner, (M,) bool."""
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


def _do_nothing(world: WorldView, toggles: Toggles, picked: Picked) -> None:
    """Changes no toggles."""


# Description and action by gesture and kind of item, for all hosts.
CLICKS: dict[tuple[Gesture, str], tuple[str, Action]] = {
    ("click", "link"): ("its joint's billboard on or off", _toggle_billboard),
    ("shift", "link"): ("all billboards of the robot on or off", _toggle_billboards),
    ("double", "link"): ("all axes of the robot on or off", _toggle_axes),
    ("click", "billboard"): ("hides it", _hide_billboard),
    ("shift", "billboard"): ("hides all of the robot", _hide_billboards),
    ("click", "arrow"): ("its precise values on or off", _toggle_details),
    ("shift", "arrow"): ("precise values of the whole robot on or off", _toggle_all_details),
    ("double", "arrow"): ("the robot's arrows show the next quantity", _next_quantity_here),
    ("click", "axes"): ("their name on or off", _toggle_name),
    ("shift", "axes"): ("names of all axes of the robot on or off", _toggle_names),
    ("double", "axes"): ("hides them", _hide_axes),
    ("click", "name"): ("hides it", _toggle_name),
    ("shift", "name"): ("hides all of the robot", _toggle_names),
    ("click", "vector"): ("its values on or off", _toggle_card),
    ("shift", "vector"): ("values of all smart arrows on or off", _toggle_cards),
    ("click", "card"): ("hides it", _toggle_card),
    ("shift", "card"): ("hides all of them", _toggle_cards),
    ("click", "check"): ("hides the comparison of flange frames", _hide_checks),
    ("double", "object"): ("centres the view on it", _do_nothing),  # the host moves its camera
}
# Clicks on transparent doubles act as on robots; doubles of a path have no features.
CLICKS |= {
    (gesture, "double"): entry for (gesture, kind), entry in CLICKS.items() if kind == "link"
}


def click(
    world: WorldView, toggles: Toggles, picked: Picked | None, gesture: Gesture = "click"
) -> bool:
    """Performs the action of a gesture on an item, see `CLICKS`.

    A double click on the background resets the toggles to those of the scene.

    Args:
        world: the compiled scene.
        toggles: changed in place.
        picked: the item; None for the background (sky and floor).
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
class ClickDetector:
    """Distinguishes double clicks from clicks, and reverts the first click of a double click.

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
        """Handles a press of the button and performs its action.

        Args:
            picked: the item at the pixel.
            pixel: of the press, x and y.
            time: of the press, s on any clock.
            shift: whether a modifier was held.

        Returns:
            the recognized gesture.
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
    """Shows the name of the item under the pointer beside it, from the next frame on.

    Args:
        toggles: changed in place.
        picked: the item; None for none.
        pixel: x to the right and y up from the lower left corner of the picture.
    """
    # A billboard shows its name already, and the label would hide its values.
    name = "" if picked is None or picked.kind == "billboard" else picked.name
    toggles.hover = (name, pixel) if name else None


def _next_quantity(toggles: Toggles) -> None:
    toggles.arrow_quantity[:] = (toggles.arrow_quantity + 1) % len(ARROW_QUANTITIES)


def _toggle(name: str) -> Callable[[Toggles], None]:
    def toggle(toggles: Toggles) -> None:
        shown = getattr(toggles, name)
        if isinstance(shown, bool):
            setattr(toggles, name, not shown)
        else:
            shown[:] = not shown.any()

    return toggle


# Field of `Toggles` and its description, by key.
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


def _toggle_keys(keys: str) -> dict[str, KeyAction]:
    return {key: (f"{SWITCHES[key][1]} on or off", _toggle(SWITCHES[key][0])) for key in keys}


# Description and action by key, for all hosts.
KEYS: dict[str, KeyAction] = {
    **_toggle_keys("abx"),
    "n": ("names of all axes on or off", _toggle("frame_names")),  # a click toggles a single one
    "q": ("arrows show the next quantity", _next_quantity),
    **_toggle_keys("dvcls"),
    "r": ("reset to what the scene declares", Toggles.reset),
}
# Keys for camera, clock and window of a live host: name and description of the action by key.
# A host has a function for each name, or other controls for it.
HOST_KEYS: dict[str, tuple[str, str]] = {
    " ": ("pause", "pause or continue"),
    ".": ("step", "single step"),
    ",": ("step_back", "single step back"),
    "-": ("slower", "slower"),
    "+": ("faster", "faster"),
    "backspace": ("reset", "back to the start"),
    "left": ("back", "1 s back"),
    "right": ("on", "1 s on"),
    "0": ("camera", "0 initial view, 1 to 9 cameras"),
    "f": ("follow", "follow the item under the pointer"),
    "p": ("plot", "torques of the selected joint"),
    "]": ("next_joint", "select the next joint, [ the previous"),
    "t": ("status_line", "status line on or off"),
    "f2": ("screenshot", "screenshot of the scene"),
    "f3": ("film", "film on or off"),
    "f11": ("full_screen", "full screen"),
    "h": ("help", "help, its next page"),
}
# Actions that a browser provides itself.
OF_BROWSER = ("f2", "f3", "f11")
# Alternative keys, which the help does not list.
MORE_KEYS: dict[str, str] = {
    "?": "help",
    "f1": "help",
    "=": "faster",
    "_": "slower",
    "[": "last_joint",
    "home": "reset",
    **{str(number): "camera" for number in range(1, 10)},
}
# Effect of the mouse on the camera of a live host.
HOST_MOUSE: dict[str, str] = {
    "drag": "rotates the view",
    "right drag": "pans, also with Shift",
    "wheel": "zooms",
    "right double click": "centres the view there",
}


OnClick = Callable[[Picked | None, str], None]
_OF_JOINTS = ("link", "double", "arrow", "billboard")


class ClickHost(Protocol):
    """A live host, as seen by `handle_click`.

    Attributes:
        joint: the joint of the world whose torques are plotted.
        on_click: called with the clicked item and the gesture.
    """

    joint: int
    on_click: OnClick | None


def handle_click(
    host: ClickHost,
    detector: ClickDetector,
    picked: Picked | None,
    clicked: Clicked,
    centre: Callable[[tuple[float, float]], None],
) -> None:
    """Performs the action of a click, see `CLICKS`.

    Args:
        host: its selected joint is set, and its callback called.
        detector: of the host.
        picked: the item at the pixel.
        clicked: the click.
        centre: centres the view on what is at a pixel.
    """
    at = (clicked.x, clicked.y)
    gesture = detector.press(picked, at, clicked.time, shift=clicked.shift)
    if picked is not None and picked.kind in _OF_JOINTS and picked.index >= 0:
        host.joint = picked.index
    if picked is not None and picked.kind == "object" and gesture == "double":
        centre(at)
    if host.on_click is not None:
        host.on_click(picked, gesture)
