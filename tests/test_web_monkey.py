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
    pytest.mark.timeout(600),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
# Else most of the time went to films, which software draws, and to pages of what was kept.
_BLACK_PICTURES = """[setattr(w.tools["pulling"]._exports, "add", lambda *_: 0),
    setattr(type(w), "image_size", (64, 48)),
    setattr(type(w), "image", lambda self: np.zeros((48, 64, 3), np.uint8))] and None""".replace(
    "\n", " "
)
EVENTS, AT_ONCE = 2000 if examples(100) >= 100 else 200, 40
# What can be clicked on in panels, by a name: left, top, right, bottom. Not what leads elsewhere.
_PLACES = """() => Object.fromEntries([...document.querySelectorAll(
    "#panel button, #panel input, #panel select, #panel summary, #timeline button, #timeline input,"
    + "#areas button, #areas select, .card, #open, #look, #help")]
    .filter((each) => each.checkVisibility()
        && !["start page", "end the simulation"].includes(each.textContent))
    .map((each, k) => { const { left, top, right, bottom } = each.getBoundingClientRect();
        return [`${k}`, [left, top, right, bottom]]; }))"""


@pytest.mark.thorough
def test_random_events_do_not_end_a_page(own_browser: Any, tmp_path: Path) -> None:
    errors = tmp_path / "errors.txt"
    folder = tmp_path / "page"
    folder.mkdir()
    with (
        errors.open("w") as stream,
        Served(folder, "lwr_double", control="joint", errors=stream) as served,
    ):
        served.ask(_BLACK_PICTURES)
        served.ask("w.actions.perform('plot')")
        visitor = Visitor(own_browser, served)
        page = visitor.page
        page.on("crash", lambda _: visitor.faults.append("the page has crashed"))
        page.on("dialog", lambda dialog: dialog.dismiss())
        hand, monkey, done = PageHand(page), Monkey(seed=1), 0
        events = monkey.events()
        while done < EVENTS:
            monkey.places = page.evaluate(_PLACES)
            size = page.viewport_size
            monkey.size = size["width"], size["height"]
            for event in itertools.islice(events, AT_ONCE):
                if event is not None:
                    hand.do(event)
                    done += 1
            hand.flush()
            assert visitor.faults == [], [*monkey.last]
        page.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
        served.ask("setattr(w, 'shows_help', False)")
        visitor.until("!document.querySelector('dialog[open]')")
        assert page.evaluate("player.isInControl")
        assert served.ask("w._input.wrong") == 0
        assert served.ask("w.browsers.refused") == 0
        # It still shows what the server has, and does what a key says.
        served.ask("w.toggles.reset() or w.camera_control.choose(0)[:0]")
        before = served.ask("bool(w.toggles.axes.any())")
        page.evaluate("document.activeElement.blur()")
        page.keyboard.press("x")
        served.until(f"bool(w.toggles.axes.any()) != {before}")
        visitor.close()
    assert served.process.exitcode == 0
    assert errors.read_text() == ""
