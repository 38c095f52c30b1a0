"""A real page in a real browser: what is seen on it, and what clicks and keys change."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from web_tools import FEW, MISSING, POSE, TORQUES, Served, Visitor, blue, orange

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]


@pytest.fixture(scope="module")
def served(tmp_path_factory: Any) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("page")
    with Served(folder, "lwr", settings=(POSE, TORQUES, "lwr.show_arrows=true")) as served:
        yield served


@pytest.fixture(scope="module")
def visitor(browser: Any, served: Served) -> Iterator[Visitor]:
    served.ask("w.toggles.axes.fill(True) or w.select(3)")
    link = served.ask("w.link")
    served.ask("w.toggles.reset() or setattr(w.toggles, 'selected', None)")
    visitor = Visitor(browser, served, url=link)
    visitor.hears("First remote draw frame applied")
    served.until("w.decor.view is not None and w.decor.count > 0")
    served.until("w.toggles.axes.all() and w.toggles.selected == 3")  # by the link
    served.ask("setattr(w.toggles, 'selected', None)")
    yield visitor
    visitor.close()


@pytest.fixture
def page(served: Served, visitor: Visitor) -> Visitor:
    """The page as it was when it was opened."""
    visitor.move(500, 60)
    served.ask("w.toggles.reset()")
    served.ask("w.choose_camera(0)[:0]")
    served.ask("setattr(w, 'shows_status', False)")  # it would cover the robot
    served.settle()
    return visitor


def test_arrows_are_seen_in_both_colours_and_go_with_their_key(
    served: Served, page: Visitor
) -> None:
    served.ask("w.toggles.arrows.fill(False)")
    without = page.still()
    page.press("F2")
    served.until("w.notice.text.startswith('screenshot saved: ')")
    page.press("a")
    served.until("w.toggles.arrows.all()")
    for colour in (orange, blue):
        page.shows(lambda p, seen=colour: seen(p) > seen(without) + FEW)
    page.press("a")
    for colour in (orange, blue):
        page.shows(lambda p, seen=colour: abs(seen(p) - seen(without)) < FEW / 3)


def test_a_click_on_a_link_shows_its_billboard_and_selects_its_joint(
    served: Served, page: Visitor
) -> None:
    served.ask("w.toggles.arrows.fill(False)")
    page.click(*served.joint(1))
    assert served.until("w.toggles.billboards.nonzero()[0].tolist()") == [1]
    assert served.ask("w.joint") == 1
    assert served.ask("clicks[-1]") == ["click", "lwr/link2"]


def test_a_click_on_an_arrow_shows_its_precise_numbers(served: Served, page: Visitor) -> None:
    place = (
        "(lambda d, n: w.decor.view.project(d.rows['pos'][:n][(d.kinds[:n] == 1)"
        " & (d.items[:n] == 1)].astype(float))[0])(w.decor.buffer, w.decor.buffer.count).tolist()"
    )
    served.ask("setattr(w.clock, 'is_paused', True)")  # an arrow that turns moves away
    served.settle()
    seen = served.until(
        f"[(x, w.decor.view.height - y) for x, y in {place}"
        " if getattr(w.decor.pick(w.data, (x, y)), 'kind', '') == 'arrow']"
    )
    page.click(*seen[len(seen) // 2])
    assert served.until("w.toggles.details.nonzero()[0].tolist()") == [1]
    served.ask("setattr(w.clock, 'is_paused', False)")


def test_shift_acts_on_the_whole_robot(served: Served, page: Visitor) -> None:
    served.ask("w.toggles.arrows.fill(False)")
    page.page.keyboard.down("Shift")
    page.click(*served.joint(3))
    page.page.keyboard.up("Shift")
    served.until("w.toggles.billboards.all()")


def test_the_name_of_what_is_under_the_pointer_is_written(served: Served, page: Visitor) -> None:
    served.ask("w.toggles.arrows.fill(False)")
    page.move(*served.joint(3))
    assert served.until("w.toggles.hover and w.toggles.hover[0]") == "lwr/link4"


def test_a_drag_turns_the_view_and_clicks_on_nothing(served: Served, page: Visitor) -> None:
    before, clicks = served.ask("w.viewer.camera.azimuth"), served.ask("len(clicks)")
    page.move(430, 260)
    page.hold()
    for x in range(450, 540, 20):
        page.move(x, 260)
    served.until(f"abs(w.viewer.camera.azimuth - {before}) > 5")
    page.release()
    assert served.ask("len(clicks)") == clicks


def test_the_tab_names_the_scene_and_the_page_is_isolated(page: Visitor) -> None:
    assert page.page.title() == "lwr - sero-mj"
    assert page.page.evaluate("window.crossOriginIsolated")


def test_the_wheel_comes_nearer_when_it_is_turned_up(served: Served, page: Visitor) -> None:
    page.move(430, 260)
    page.settle()
    far = served.ask("w.viewer.camera.distance")
    page.page.mouse.wheel(0, -100)
    served.until(f"w.viewer.camera.distance < {0.97 * far}")
    page.page.mouse.wheel(0, 200)
    served.until(f"w.viewer.camera.distance > {1.03 * far}")


def test_the_panel_switches_what_is_shown(served: Served, page: Visitor) -> None:
    page.press("t")
    page.click(*served.middle("Move lwr"))  # folds what would push the others out of the page
    served.settle()
    page.click(*served.middle("axes"))
    served.until("w.toggles.axes.any()")
    page.click(*served.middle("axes"))
    served.until("not w.toggles.axes.any()")


def test_billboards_stay_clear_of_the_panel(served: Served, page: Visitor) -> None:
    served.ask("w.toggles.billboards.fill(True)")
    served.ask("setattr(w, 'shows_status', True)")
    served.settle()
    left = served.ask("w._panels.inset[0]")
    assert left > 300
    edges = served.ask(
        "(lambda buffer, rows: (w.decor.view.project((rows['pos'] - rows['size'][:, :1] *"
        " rows['mat'][:, :, 0]).astype(float))[0][:, 0]))(w.decor.buffer,"
        " w.decor.buffer.rows[:w.decor.count][w.decor.buffer.kinds[:w.decor.count] == 2])"
        ".tolist()"
    )
    assert len(edges) == 7
    assert min(edges) >= left - 1
