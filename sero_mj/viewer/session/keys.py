"""Keys and mouse of a window or page, and the help that lists them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ..image.clicks import CLICKS, KEYS, Gesture


class Key(NamedTuple):
    """What a key does.

    Attributes:
        text: for the help; empty to omit it from the help.
    """

    action: str
    text: str = ""
    repeats: bool = False


# Keys for camera, clock and window of a live host.
# A host has a function for each action, or other controls for it.
HOST_KEYS: dict[str, Key] = {
    " ": Key("pause", "pause or continue"),
    ".": Key("step", "single step", repeats=True),
    ",": Key("step_back", "single step back", repeats=True),
    "-": Key("slower", "slower", repeats=True),
    "+": Key("faster", "faster", repeats=True),
    "backspace": Key("reset", "back to the start"),
    "left": Key("back", "1 s back", repeats=True),
    "right": Key("on", "1 s on", repeats=True),
    "end": Key("end", "to the end; what is live again"),
    "0": Key("camera_0", "0 initial view, 1 to 9 cameras"),
    "f": Key("follow", "follow the item under the pointer"),
    "]": Key("next_joint", "select the next joint, [ the previous", repeats=True),
    "t": Key("status_line", "status line on or off"),
    "tab": Key("panel", "panel with switches and sizes on or off"),
    "f11": Key("full_screen", "full screen"),
    "h": Key("help", "this help"),
}
# Actions that a browser provides itself.
OF_BROWSER = ("tab", "f11")
# Alternative keys, which the help does not list.
MORE_KEYS: dict[str, Key] = {
    "?": Key("help"),
    "f1": Key("help"),
    "=": Key("faster", repeats=True),
    "_": Key("slower", repeats=True),
    "[": Key("last_joint", repeats=True),
    "home": Key("reset"),
    **{str(number): Key(f"camera_{number}") for number in range(1, 10)},
}
# Effect of the mouse on the camera of a live host.
HOST_MOUSE: dict[str, str] = {
    "drag": "rotates the view",
    "drag of a handle": "moves or turns the target of a robot",
    "right drag": "pans, also with Shift",
    "Ctrl+drag": "pulls a simulated link, moves others and targets",
    "wheel": "zooms; how strongly it pulls",
    "right double click": "centres the view there",
}


Row = tuple[str, str]

_KEY_NAMES = {
    " ": "space",
    "0": "0 - 9",
    "]": "[ ]",
    "left": "left arrow",
    "ctrl+z": "Ctrl+Z",
    "ctrl+c": "Ctrl+C",
    "right": "right arrow",
    **{f"f{number}": f"F{number}" for number in range(1, 13)},
}
_IN_HELP: tuple[Gesture, ...] = ("click", "double")
_KINDS = {
    "link": "link",
    "arrow": "round arrow",
    "billboard": "billboard",
    "axes": "axes",
    "name": "name",
    "vector": "smart arrow",
    "card": "card",
    "limb": "card of a limb",
    "object": "object",
}


def help_columns(of_tools: Mapping[str, Key], *, on_page: bool = False) -> list[list[Row]]:
    """Returns columns of rows of input and effect; headings have no effect.

    Args:
        on_page: whether to omit actions that a browser provides itself.
    """
    of_host = {**HOST_KEYS, **{key: entry for key, entry in of_tools.items() if entry.text}}
    if on_page:
        of_host = {key: action for key, action in of_host.items() if key not in OF_BROWSER}
        of_host |= {"t": Key("panel", "panel on or off")}
    view: list[Row] = [("View", "")]
    view += [(how, words) for how, words in HOST_MOUSE.items()]
    view += [("", ""), ("Page and time" if on_page else "Window and time", "")]
    view += [(_KEY_NAMES.get(key, key), entry.text) for key, entry in of_host.items()]
    view += [] if on_page else [("Ctrl+Q", "close")]
    shown: list[Row] = [("What is shown", "")]
    shown += [(key, words) for key, (words, _) in KEYS.items()]
    shown += [("", ""), ("Clicks", "")]
    for kind, name in _KINDS.items():
        for gesture in _IN_HELP:
            if (gesture, kind) in CLICKS:
                shown.append((f"{gesture} {name}", CLICKS[gesture, kind][0]))
    shown += [
        ("double click background", "what the scene declares"),
        ("Shift+click", "the same for the whole robot, or all smart arrows"),
    ]
    return [view, shown]
