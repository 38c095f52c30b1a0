"""Keys and mouse gestures of windows and pages, and the text of the help."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ..image.clicks import CLICKS, KEYS, Gesture


class Key(NamedTuple):
    """The action of a key, and its description in the help.

    Attributes:
        action: name of the action.
        text: text in the help, or an empty string to omit the key.
        repeats: whether the action is repeated while the key is held.
    """

    action: str
    text: str = ""
    repeats: bool = False


# The help lists these keys for the camera, the clock and the window.
VIEWER_KEYS: dict[str, Key] = {
    " ": Key("pause", "pause or continue"),
    ".": Key("step", "single step forward", repeats=True),
    ",": Key("step_back", "single step back", repeats=True),
    "-": Key("slower", "slower", repeats=True),
    "+": Key("faster", "faster", repeats=True),
    "backspace": Key("reset", "go to the start"),
    "left": Key("back", "1 s back", repeats=True),
    "right": Key("on", "1 s forward", repeats=True),
    "end": Key("end", "go to the end, or to live data"),
    "0": Key("camera_0", "initial view (0) or a camera (1 to 9)"),
    "f": Key("follow", "follow the item under the pointer"),
    "]": Key("next_joint", "select the previous or next joint", repeats=True),
    "t": Key("status_line", "status line on or off"),
    "tab": Key("panel", "panel on or off"),
    "f11": Key("full_screen", "full screen"),
    "h": Key("help", "this help"),
}
# Pages leave these keys to the browser.
_OF_BROWSER = ("tab", "f11")
# The help does not list these alternative keys.
MORE_KEYS: dict[str, Key] = {
    "?": Key("help"),
    "f1": Key("help"),
    "=": Key("faster", repeats=True),
    "_": Key("slower", repeats=True),
    "[": Key("last_joint", repeats=True),
    "home": Key("reset"),
    **{str(number): Key(f"camera_{number}") for number in range(1, 10)},
}
# The help lists these effects of the mouse.
VIEWER_MOUSE: dict[str, str] = {
    "drag": "rotate the view",
    "drag a handle": "move or rotate the target of a robot",
    "right drag": "pan the view, also with Shift",
    "Ctrl+drag": "pull a simulated link, move another link or a target",
    "wheel": "zoom, or set the strength of a pull",
    "right double click": "center the view there",
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
_GESTURES: dict[Gesture, str] = {"click": "click", "double": "double click"}  # in the help
_KINDS = {
    "link": "link",
    "arrow": "round arrow",
    "billboard": "billboard",
    "axes": "axes",
    "name": "name",
    "vector": "smart arrow",
    "card": "values of a smart arrow",
    "limb": "billboard of a limb",
    "object": "object",
}


def help_columns(of_tools: Mapping[str, Key], *, on_page: bool = False) -> list[list[Row]]:
    """Returns the columns of the help. A row is a key or gesture with its effect, or a heading."""
    keys = {**VIEWER_KEYS, **{key: entry for key, entry in of_tools.items() if entry.text}}
    if on_page:
        keys = {key: entry for key, entry in keys.items() if key not in _OF_BROWSER}
        keys |= {"t": Key("panel", "panel on or off")}
    view: list[Row] = [("View", ""), *VIEWER_MOUSE.items()]
    view += [("", ""), ("Page and time" if on_page else "Window and time", "")]
    view += [(_KEY_NAMES.get(key, key), entry.text) for key, entry in keys.items()]
    view += [] if on_page else [("Ctrl+Q", "close")]
    shown: list[Row] = [("Displayed features", "")]
    shown += [(key, words) for key, (words, _) in KEYS.items()]
    shown += [("", ""), ("Clicks", "")]
    for kind, name in _KINDS.items():
        for gesture, how in _GESTURES.items():
            if (gesture, kind) in CLICKS:
                shown.append((f"{how} {name}", CLICKS[gesture, kind][0]))
    shown += [
        ("double click background", "reset to the declared values"),
        ("Shift+click", "same effect for the whole robot, or for all smart arrows"),
    ]
    return [view, shown]
