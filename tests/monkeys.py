"""Random events for windows and pages, reproducible by a seed.

`Monkey` generates the events for both. `WindowHand` and `PageHand` perform them.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from sero_mj.viewer.image.clicks import KEYS
from sero_mj.viewer.session.keys import MORE_KEYS, VIEWER_KEYS
from sero_mj.viewer.session.tool import tool_keys

SHIFT, CONTROL = "shift", "control"
_EVERY = [*KEYS, *VIEWER_KEYS, *MORE_KEYS, *tool_keys()]
_CHARACTERS = [key for key in _EVERY if len(key) == 1]
_NAMED = [*(key for key in _EVERY if len(key) > 1 and "+" not in key), "up", "down", "enter",
          "delete", "escape"]  # fmt: skip
_LETTERS = "zyca"  # keys that are pressed together with Control
_MODS: Sequence[frozenset[str]] = [frozenset(), frozenset(), frozenset(), frozenset([SHIFT]),
                                   frozenset([CONTROL]), frozenset([SHIFT, CONTROL])]  # fmt: skip
_NONE = _MODS[0]
_SIZES = [(1, 1), (2, 1), (1, 2), (2, 2), (3, 300), (400, 2), (40, 30), (120, 90), (200, 300),
          (400, 200), (400, 300), (400, 300), (400, 300)]  # fmt: skip
_TEXTS = ["0", "-1.5", "1e9", "nan", "1e999", "-", "0,1,2", "x" * 30, "é😀", "9" * 20]

Event = tuple[Any, ...]  # the name of an event, and its arguments


class Monkey:
    """A generator of endless random events.

    Args:
        seed: seed of the events.

    Attributes:
        size: width and height of the window or page, pixels.
        places: rectangles of widgets by label: left, top, right, bottom, pixels.
        last: last events, for debugging.
    """

    def __init__(self, seed: int) -> None:
        self._random = random.Random(seed)
        self.size: tuple[int, int] = (1, 1)
        self.places: Mapping[str, Sequence[float]] = {}
        self.last: deque[Event] = deque(maxlen=40)
        self._acts = {
            self._character: 25, self._name: 12, self._shortcut: 6, self._move: 20,
            self._click: 16, self._double_click: 6, self._drag: 10, self._wheel: 8,
            self._widget: 16, self._field: 5, self._resize: 8,
        }  # fmt: skip

    def events(self) -> Iterator[Event | None]:
        """Yields events, and None before events that belong to the next frame."""
        acts, weights = list(self._acts), list(self._acts.values())
        while True:
            for event in self._random.choices(acts, weights)[0]():
                if event is not None:
                    self.last.append(event)
                yield event

    def _character(self) -> Iterator[Event | None]:
        yield "character", self._random.choice(_CHARACTERS)

    def _name(self) -> Iterator[Event | None]:
        yield "key", self._random.choice(_NAMED), _NONE

    def _shortcut(self) -> Iterator[Event | None]:
        mods = self._random.choice(([CONTROL], [SHIFT, CONTROL]))
        yield "key", self._random.choice(_LETTERS), frozenset(mods)

    def _place(self) -> tuple[float, float]:
        beyond = self._random.choice((1.0, 1.0, 1.0, 1.1))
        width, height = self.size
        return self._random.uniform(0, beyond * width), self._random.uniform(0, beyond * height)

    def _move(self) -> Iterator[Event | None]:
        yield "move", *self._place()

    def _click(self) -> Iterator[Event | None]:
        button, mods = self._random.randrange(3), self._random.choice(_MODS)
        yield from self._click_at(self._place(), button, mods)

    def _click_at(
        self, at: tuple[float, float], button: int = 0, mods: frozenset[str] = _NONE
    ) -> Iterator[Event | None]:
        yield "move", *at
        yield "button", *at, button, True, mods
        yield None
        yield "button", *at, button, False, mods

    def _double_click(self) -> Iterator[Event | None]:
        at, button = self._place(), self._random.randrange(3)
        yield "move", *at
        for is_down in (True, False, True, False):
            yield "button", *at, button, is_down, _NONE

    def _drag(self) -> Iterator[Event | None]:
        at, button, mods = self._place(), self._random.randrange(3), self._random.choice(_MODS)
        yield "move", *at
        yield "button", *at, button, True, mods
        for _ in range(self._random.randint(1, 4)):
            at = self._place()
            yield "move", *at
            yield None
        if self._random.random() < 0.9:  # otherwise, there is no release event
            yield "button", *at, button, False, mods

    def _wheel(self) -> Iterator[Event | None]:
        yield "wheel", self._random.choice((1, 1, -1, -1, 30, -30))

    def _widget(self) -> Iterator[Event | None]:
        if self.places:
            left, top, right, bottom = self.places[self._random.choice(sorted(self.places))]
            at = self._random.uniform(left, right), self._random.uniform(top, bottom)
            yield from self._click_at(at)

    def _field(self) -> Iterator[Event | None]:
        """Types into a field, or into a slider by Control and click."""
        if self.places:
            left, top, right, bottom = self.places[self._random.choice(sorted(self.places))]
            at = (left + right) / 2, (top + bottom) / 2
            yield from self._click_at(at, 0, self._random.choice((_NONE, frozenset([CONTROL]))))
            yield None
            yield "text", self._random.choice(_TEXTS)
            yield None
            yield "key", self._random.choice(("enter", "tab", "escape")), _NONE

    def _resize(self) -> Iterator[Event | None]:
        yield "resize", *self._random.choice(_SIZES)


class WindowHand:
    """A hand that controls a window of the same process through GLFW callbacks.

    Args:
        window: window to control.
        places: rectangles of the widgets of the panel, as in `Monkey`.
        seed: seed of the events.
    """

    def __init__(self, window: Any, places: Mapping[str, Sequence[float]], seed: int) -> None:
        import glfw

        from sero_mj.viewer.window.glfw_window import _NAMED_KEYS

        self._glfw, self._window, self._gl = glfw, window, window.gl
        self._codes = {name: code for code, name in _NAMED_KEYS.items()}
        self._mods = {SHIFT: glfw.MOD_SHIFT, CONTROL: glfw.MOD_CONTROL}
        self.monkey = Monkey(seed)
        self.monkey.places = places
        self._events = self.monkey.events()

    def run(self, count: int) -> int:
        """Runs this number of events, up to eight before each frame.

        Returns:
            The number of frames, or -1 if the window is closed.
        """
        frames = done = 0
        while done < count:
            for _ in range(8):
                self.monkey.size = self._gl.size
                event = next(self._events)
                if event is None:
                    break
                name, *how = event
                getattr(self, f"_{name}")(*how)
                done += 1
            if not self._window.frame(wait=False):
                return -1
            frames += 1
        return frames

    def _sum(self, mods: frozenset[str]) -> int:
        return sum(self._mods[each] for each in mods)

    def _character(self, character: str) -> None:
        self._gl._on_char(None, ord(character))

    def _text(self, text: str) -> None:
        for character in text:
            self._character(character)

    def _key(self, name: str, mods: frozenset[str]) -> None:
        code = self._codes.get(name) or ord(name.upper())
        for action in (self._glfw.PRESS, self._glfw.REPEAT, self._glfw.RELEASE):
            self._gl._on_key(None, code, 0, action, self._sum(mods))

    def _move(self, x: float, y: float) -> None:
        self._gl._on_move(None, x, y)

    def _button(self, x: float, y: float, button: int, is_down: bool, mods: frozenset[str]) -> None:
        self._gl._on_move(None, x, y)
        self._gl._on_button(None, button, int(is_down), self._sum(mods))

    def _wheel(self, turns: int) -> None:
        self._gl._on_scroll(None, 0, turns)

    def _resize(self, width: int, height: int) -> None:
        self._glfw.set_window_size(self._gl._window, width, height)


class PageHand:
    """A hand that controls a page in a browser.

    The browser performs clicks, changes of size, and text input. Other events are dispatched by
    JavaScript, several at once, because the browser would delay each of them to the next frame.

    Args:
        page: page of Playwright.
    """

    def __init__(self, page: Any) -> None:
        self._page = page
        self._line = page.context.new_cdp_session(page)
        # Events for each of the next frames: class, kind and details.
        self._waiting: list[list[tuple[str, str, dict[str, Any]]]] = [[]]

    def do(self, event: Event) -> None:
        """Performs an event, or stores it until the browser performs the next event."""
        name, *how = event
        if name in ("button", "resize", "text"):
            self.flush()
        getattr(self, f"_{name}")(*how)

    def flush(self) -> None:
        """Sends the stored events and returns when the page has received them."""
        waiting, self._waiting = self._waiting, [[]]
        self._page.evaluate(_DISPATCH, waiting)

    def _character(self, character: str) -> None:
        self._key(character, frozenset([SHIFT] if character in "+?_" else []))

    def _key(self, name: str, mods: frozenset[str]) -> None:
        code = _CODES.get(name) or (f"Key{name.upper()}" if name.isalpha() else f"Digit{name}")
        if len(name) > 1:
            code = f"Arrow{name.title()}" if name in _ARROWS else name.title()
        how = {"key": code if len(name) > 1 else name, "code": code, **_held(mods)}
        self._waiting[-1].append(("KeyboardEvent", "keydown", how))
        self._waiting.append([("KeyboardEvent", "keyup", how)])

    def _move(self, x: float, y: float) -> None:
        self._waiting[-1].append(("PointerEvent", "pointermove", {"clientX": x, "clientY": y}))

    def _wheel(self, turns: int) -> None:
        self._waiting[-1].append(("WheelEvent", "wheel", {"deltaY": -100 * turns}))
        self._waiting.append([])

    def _button(self, x: float, y: float, button: int, is_down: bool, mods: frozenset[str]) -> None:
        self._line.send(
            "Input.dispatchMouseEvent",
            {
                "type": "mousePressed" if is_down else "mouseReleased", "x": x, "y": y,
                "button": ("left", "right", "middle")[button], "clickCount": 1,
                "modifiers": 8 * (SHIFT in mods) + 2 * (CONTROL in mods),
            },
        )  # fmt: skip

    def _text(self, text: str) -> None:
        self._page.keyboard.type(text)

    def _resize(self, width: int, height: int) -> None:
        self._page.set_viewport_size({"width": width, "height": height})
        if min(width, height) < 100:  # Chromium draws such a page only once a second
            self._page.set_viewport_size({"width": 100 + width, "height": 100 + height})


def _held(mods: frozenset[str]) -> dict[str, bool]:
    return {"shiftKey": SHIFT in mods, "ctrlKey": CONTROL in mods}


_ARROWS = ("left", "right", "up", "down")
_CODES = {" ": "Space", ".": "Period", ",": "Comma", "-": "Minus", "_": "Minus", "=": "Equal",
          "+": "Equal", "[": "BracketLeft", "]": "BracketRight", "?": "Slash"}  # fmt: skip
_DISPATCH = """async (waiting) => {
    const canvas = document.querySelector("canvas");
    for (const events of waiting) {
        for (const [kind, name, how] of events) {
            const event = new window[kind](name, { ...how, bubbles: true, cancelable: true });
            canvas.dispatchEvent(event);
        }
        await new Promise(requestAnimationFrame);
    }
}"""
