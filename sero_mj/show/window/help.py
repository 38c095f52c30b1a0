"""The help text of live hosts, generated from the tables of `interaction`."""

from __future__ import annotations

from ..interaction import CLICKS, HOST_KEYS, HOST_MOUSE, KEYS, OF_BROWSER, Gesture

Row = tuple[str, str]

_KEY_NAMES = {
    " ": "space",
    "0": "0 - 9",
    "]": "[ ]",
    "left": "left arrow",
    "right": "right arrow",
    **{f"f{number}": f"F{number}" for number in range(1, 13)},
}
_GESTURES: dict[Gesture, str] = {"click": "click", "double": "double"}
_KINDS = {
    "link": "link",
    "arrow": "round arrow",
    "billboard": "billboard",
    "axes": "axes",
    "name": "name",
    "vector": "smart arrow",
    "card": "card",
    "object": "object",
}


def help_columns(*, on_page: bool = False) -> list[list[Row]]:
    """Returns columns of rows of input and effect; headings have no effect.

    Args:
        on_page: whether to omit actions that a browser provides itself.
    """
    of_host = HOST_KEYS
    if on_page:
        of_host = {
            key: description for key, description in HOST_KEYS.items() if key not in OF_BROWSER
        }
        of_host |= {"t": ("panel", "panel on or off"), "h": ("help", "this help")}
    view: list[Row] = [("View", "")]
    view += [(how, words) for how, words in HOST_MOUSE.items()]
    view += [("", ""), ("Page and time" if on_page else "Window and time", "")]
    view += [(_KEY_NAMES.get(key, key), words) for key, (_, words) in of_host.items()]
    view += [] if on_page else [("Ctrl+Q", "close")]
    shown: list[Row] = [("What is shown", "")]
    shown += [(key, words) for key, (words, _) in KEYS.items()]
    shown += [("", ""), ("Clicks", "")]
    for kind, name in _KINDS.items():
        for gesture, word in _GESTURES.items():
            entry = CLICKS.get((gesture, kind))
            if entry is not None:
                shown.append((f"{word} {name}", entry[0]))
    shown += [
        ("double click background", "what the scene declares"),
        ("Shift+click", "the same for the whole robot"),
    ]
    return [view, shown]


def pages(columns: list[list[Row]], room: tuple[int, int]) -> list[list[list[Row]]]:
    """Divides the help into pages of columns.

    Args:
        columns: of rows.
        room: maximum number of rows of a column, and of columns of a page.
    """
    rows, beside = max(room[0], 4), max(room[1], 1)
    parts = [
        column[start : start + rows] for column in columns for start in range(0, len(column), rows)
    ]
    return [parts[start : start + beside] for start in range(0, len(parts), beside)]
