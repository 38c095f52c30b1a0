"""A page and its browser, which 2,000 random events do not end."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import pytest
from monkeys import Monkey, PageHand
from web_tools import MISSING, SIZE, Served, Visitor

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
EVENTS, AT_ONCE = 2000, 40
_MENU = ("File", "Quit")  # which ends it, as it should


def test_random_events_do_not_end_a_page(browser: Any, tmp_path: Path) -> None:
    errors = tmp_path / "errors.txt"
    folder = tmp_path / "page"
    folder.mkdir()
    with (
        errors.open("w") as stream,
        Served(folder, "lwr_double", control="joint", errors=stream) as served,
    ):
        served.ask("w.toggle_plot()")
        visitor = Visitor(browser, served)
        page, faults = visitor.page, list[str]()
        page.on("pageerror", lambda error: faults.append(str(error)))
        page.on("crash", lambda _: faults.append("the page has crashed"))
        page.on("dialog", lambda dialog: dialog.dismiss())
        visitor.hears("First remote draw frame applied")
        hand, monkey, done = PageHand(page), Monkey(seed=1), 0
        events = monkey.events()
        while done < EVENTS:
            places = served.ask("places")
            monkey.places = {label: places[label] for label in places if label not in _MENU}
            size = page.viewport_size
            monkey.size = size["width"], size["height"]
            for event in itertools.islice(events, AT_ONCE):
                if event is not None:
                    hand.do(event)
                    done += 1
                elif done % 4 == 0:  # else what follows comes with the same frame
                    hand.flush()
                    served.settle(1)
            hand.flush()
            served.settle(1)
            assert faults == [], [*monkey.last]
        page.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
        assert served.ask("clicks")  # presses and keys were heard
        assert [*folder.glob("lwr_double*")]
        served.until(f"w.viewer.server.is_watched and w.decor.size == ({SIZE[0]}, {SIZE[1]} - 32)")
        page.evaluate("framesWanted = framesDrawn + 1")
        page.wait_for_function("framesDrawn >= framesWanted")
        visitor.close()
    assert served.process.returncode == 0
    assert errors.read_text() == ""
