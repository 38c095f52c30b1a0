"""A page and its browser, which 2,000 random events do not end."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from conftest import examples
from monkeys import Monkey, PageHand
from web_tools import MISSING, SIZE, Served, Visitor

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
# Else most of the time went to films, which software draws.
_BLACK_PICTURES = """[setattr(type(w), "picture_size", (64, 48)),
    setattr(type(w), "picture", lambda self: np.zeros((48, 64, 3), np.uint8))] and None""".replace(
    "\n", " "
)
EVENTS, AT_ONCE = examples(2000), 40
# The menu of a page without what ends it, as it should.
_WITHOUT_QUIT = """setattr(imgui, "MenuItem", lambda label, *rest, build=imgui.MenuItem:
    label != "Quit" and build(label, *rest))""".replace("\n", " ")


def test_random_events_do_not_end_a_page(own_browser: Any, tmp_path: Path) -> None:
    """Sooner or later they press "Release control" in Studio's bar, which is then asked back."""
    errors = tmp_path / "errors.txt"
    folder = tmp_path / "page"
    folder.mkdir()
    with (
        errors.open("w") as stream,
        Served(folder, "lwr_double", control="joint", errors=stream) as served,
    ):
        served.ask(_BLACK_PICTURES)
        served.ask(_WITHOUT_QUIT)
        served.ask("w.actions.perform('plot')")
        visitor = Visitor(own_browser, served)
        page, faults = visitor.page, list[str]()
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("crash", lambda _: faults.append("the page has crashed"))
        page.on("dialog", lambda dialog: dialog.dismiss())
        visitor.hears("First remote draw frame applied")
        page.evaluate("frameWait = 10")  # every event has a frame of its own
        hand, monkey, done = PageHand(page), Monkey(seed=1), 0
        events = monkey.events()
        while done < EVENTS:
            monkey.places = served.ask("places")
            size = page.viewport_size
            monkey.size = size["width"], size["height"]
            for event in itertools.islice(events, AT_ONCE):
                if event is not None:
                    hand.do(event)
                    done += 1
            hand.flush()
            served.settle(1)
            assert faults == [], [*monkey.last]
            visitor.set_control(True)
        for wanted in (False, True):
            visitor.set_control(wanted)
        served.until(f"w.decor.size == ({SIZE[0]}, {SIZE[1]} - 32)")
        visitor.press("p")
        visitor.picture()
        visitor.close()
    assert served.process.returncode == 0
    assert errors.read_text() == ""
