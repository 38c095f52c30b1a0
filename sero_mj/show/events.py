"""What a user does with mouse and keys, as plain values that every live host makes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

LEFT, RIGHT, MIDDLE = 0, 1, 2


@dataclass(frozen=True)
class Event:
    """Something that the user did.

    Attributes:
        kind: `press` and `release` of a button, `move`, `scroll`, `key`.
        x: pixels of the framebuffer from its left edge; notches to the right for `scroll`.
        y: pixels up from its lower edge; notches away from the user for `scroll`.
        time: on the clock of `time.monotonic`, s.
        button: `LEFT`, `RIGHT`, `MIDDLE`.
        key: a character in lower case, or a name: `f1`, `left`, `escape`.
        shift: whether Shift or Control was held.
        is_repeat: whether a key is just held down.
    """

    kind: Literal["press", "release", "move", "scroll", "key"]
    x: float = 0.0
    y: float = 0.0
    time: float = 0.0
    button: int = LEFT
    key: str = ""
    shift: bool = False
    is_repeat: bool = False
