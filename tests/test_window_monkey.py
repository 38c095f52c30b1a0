"""A window that 2,000 random events do not end, of which some come from the screen."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest
from conftest import examples
from window_tools import MISSING, Driven, screen

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(200),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
_TESTS = str(Path(__file__).parent)
EVENTS, AT_ONCE = 2000 if examples(100) >= 100 else 200, 50


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    with screen((400, 300)) as name:  # all of it is drawn in full screen
        yield name


@pytest.mark.thorough
def test_random_events_do_not_end_a_window(display: str, tmp_path: Path) -> None:
    """One of a pixel with a plot died of a division by zero."""
    errors = tmp_path / "errors.txt"
    folder = tmp_path / "window"
    folder.mkdir()
    with errors.open("w") as stream, Driven(
        display, folder, "lwr_double", control="joint", errors=stream
    ) as window:  # fmt: skip
        window.ask(f"sys.path.append({_TESTS!r})")
        window.ask("globals().update(hand=__import__('monkeys').WindowHand(w, places, seed=1))")
        window.ask("setattr(w, '_draw', draw)")  # every frame
        window.ask("w.actions.perform('plot') or w.toggle('shows_panel')")
        places = random.Random(1)
        for _ in range(EVENTS // AT_ONCE):
            assert window.ask(f"hand.run({AT_ONCE})") > 0, window.ask("[*hand.monkey.last]")
            if places.random() < 0.5:
                from_screen(window, places)
        window.tool("search", "--name", "lwr", "windowsize", 320, 240)
        window.until("w.gl.size == (320, 240)")
        # Wherever the camera has gone, and whatever was switched off: as the scene declares it.
        window.ask("[w.actions.press(key) for key in ('escape', '0', 'r', 'backspace')] and None")
        window.until("(w.image().max(axis=(0, 1)) > 100).all()")
    assert window.process.exitcode == 0
    told = errors.read_text().splitlines()
    assert [line for line in told if " was not finished; this makes it: " not in line] == []


def from_screen(window: Driven, places: random.Random) -> None:
    """What the window manager and a mouse do, and in one go."""
    size = places.choice([(1, 1), (2, 2), (300, 200)])
    x, y = places.randrange(300), places.randrange(200)
    window.tool(
        "search", "--name", "lwr", "windowsize", *size,
        "mousemove", x, y, "click", 1, "key", places.choice(["p", "Tab", "h", "F2", "F3", "r"]),
    )  # fmt: skip
