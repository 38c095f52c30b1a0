"""A real page in a real browser: what is seen on it, and what clicks and keys change."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from web_tools import FEW, MISSING, POSE, SIZE, TORQUES, Served, Visitor, blue, orange

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]
NO_ARROWS = "player.state.arrowOn.every(isOn => !isOn)"
NO_CARDS = "document.getElementById('cards').childElementCount === 0"


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
    visitor = Visitor(browser, served, view=link.partition("#view=")[2])
    served.until("w.toggles.axes.all() and w.toggles.selected == 3")  # by the link
    served.ask("setattr(w.toggles, 'selected', None)")
    yield visitor
    visitor.close()


@pytest.fixture
def page(served: Served, visitor: Visitor) -> Visitor:
    """The page as it was when it was opened, without its panel and arrows."""
    visitor.page.mouse.move(500, 380)
    served.ask("w.toggles.reset() or w.toggles.arrows.fill(False)")
    served.ask("w.camera_control.choose(0)[:0]")
    served.ask("w.show_layout({'panel': False})")
    visitor.sees_camera()
    visitor.until(f"{NO_ARROWS} && {NO_CARDS} && document.getElementById('panel').hidden")
    visitor.has_told_its_size()
    return visitor


@pytest.mark.thorough
def test_arrows_are_seen_in_both_colours_and_go_with_their_key(
    served: Served, page: Visitor
) -> None:
    without = page.picture()
    page.page.keyboard.press("F2")
    served.until("w.notice.text.startswith('screenshot saved: ')")
    page.page.get_by_text("screenshot saved: ").wait_for()
    page.page.keyboard.press("a")
    served.until("w.toggles.arrows.all()")
    for colour in (orange, blue):
        page.shows(lambda p, seen=colour: seen(p) > seen(without) + FEW)
    page.page.keyboard.press("a")
    for colour in (orange, blue):
        page.shows(lambda p, seen=colour: abs(seen(p) - seen(without)) < FEW / 3)


def test_click_on_a_link_shows_its_billboard_and_selects_its_joint(
    served: Served, page: Visitor
) -> None:
    page.page.mouse.click(*page.joint(1))
    page.page.locator("#cards button", has_text="A2").wait_for()
    assert served.ask("w.toggles.billboards.nonzero()[0].tolist()") == [1]
    assert served.ask("w.joint") == 1
    assert served.ask("clicks[-1]") == ["click", "lwr/link2"]


def test_click_on_an_arrow_shows_its_precise_values(served: Served, page: Visitor) -> None:
    # An arrow that turns moves away; whatever is seen with arrows is of after the pause.
    served.ask("setattr(w.clock, 'is_paused', True)")
    served.ask("w.toggles.arrows.fill(True)")
    page.until("player.state.arrowOn.every(isOn => isOn)")
    served.ask("setattr(w, 'shapes', __import__('sero_mj').viewer.decor.arrow_shapes.shapes())")
    place = (
        "(lambda r: w.decor.view.project(r['pos'] + (w.shapes[r['dataid'] - (1 << 20)]"
        ".vertices[::29] * r['size']) @ r['mat'].T)[0])"
        "((lambda d, n: d.rows[:n][(d.kinds[:n] == 1) & (d.items[:n] == 1)][0])"
        "(w.decor.buffer, w.decor.buffer.count)).tolist()"  # of vertices
    )
    seen = served.until(
        f"[(x, w.decor.view.height - y) for x, y in {place}"
        " if getattr(w.decor.pick(w.data, (x, y)), 'kind', '') == 'arrow']"
    )
    free = page.page.evaluate(  # of what is written over the picture
        "places => places.filter(at => document.elementFromPoint(...at)?.id === 'picture')", seen
    )
    page.page.mouse.click(*free[len(free) // 2])
    assert served.until("w.toggles.details.nonzero()[0].tolist()") == [1]
    served.ask("setattr(w.clock, 'is_paused', False)")


def test_shift_acts_on_the_whole_robot(served: Served, page: Visitor) -> None:
    page.page.keyboard.down("Shift")
    page.page.mouse.click(*page.joint(3))
    page.page.keyboard.up("Shift")
    served.until("w.toggles.billboards.all()")
    page.until("document.querySelectorAll('#cards button').length === 7")


def test_name_under_the_pointer_is_shown(served: Served, page: Visitor) -> None:
    page.page.mouse.move(*page.joint(3))
    page.page.locator("#hover", has_text="lwr/link4").wait_for()
    assert served.ask("w.toggles.hover[0]") == "lwr/link4"


def test_drag_rotates_the_view_and_is_not_a_click(served: Served, page: Visitor) -> None:
    before, clicks = served.ask("w.navigator.camera.azimuth"), served.ask("len(clicks)")
    mouse = page.page.mouse
    mouse.move(430, 260)
    mouse.down()
    mouse.move(530, 260, steps=5)
    served.until(f"abs(w.navigator.camera.azimuth - {before}) > 5")
    mouse.up()
    mouse.move(430, 300)
    served.until("w.pointer.at == (430, w.view.size[1] - 300)")  # all that came before was taken
    assert served.ask("len(clicks)") == clicks


def test_tab_title_names_the_scene(page: Visitor) -> None:
    assert page.page.title() == "lwr - sero-mj"


def test_wheel_zooms_in_when_scrolled_up(served: Served, page: Visitor) -> None:
    page.page.mouse.move(430, 260)
    far = served.ask("w.navigator.camera.distance")
    page.page.mouse.wheel(0, -100)
    served.until(f"w.navigator.camera.distance < {0.97 * far}")
    page.page.mouse.wheel(0, 200)
    served.until(f"w.navigator.camera.distance > {1.03 * far}")


def test_panel_switches_features(served: Served, page: Visitor) -> None:
    page.page.keyboard.press("t")
    axes = page.page.locator("#panel").get_by_label("axes", exact=True)
    axes.check()
    served.until("w.toggles.axes.any()")
    axes.uncheck()
    served.until("not w.toggles.axes.any()")
    page.page.get_by_role("button", name="panel").click()
    page.until("document.getElementById('panel').hidden")


def test_billboards_stay_clear_of_the_panel(served: Served, page: Visitor) -> None:
    page.page.set_viewport_size({"width": 1000, "height": 600})  # else it is below
    served.ask("w.toggles.billboards.fill(True) or w.show_layout({'panel': True})")
    page.until("document.getElementById('panel').getBoundingClientRect().right > 300")
    served.until("550 < w.view.size[0] < 700 and w._panels._width == 1000")
    page.until("document.querySelectorAll('#cards button').length === 7")
    edge, cards = page.page.evaluate(
        """() => [document.getElementById("panel").getBoundingClientRect().right,
            [...document.querySelectorAll("#cards button")].filter(card => card.offsetWidth)
                .map(card => card.getBoundingClientRect().left)]"""
    )
    assert edge > 300
    assert cards and min(cards) >= edge
    page.page.set_viewport_size({"width": SIZE[0], "height": SIZE[1]})
    served.until(f"w.view.size[0] == {SIZE[0]}")


def test_page_follows_the_color_scheme_of_the_browser(page: Visitor) -> None:
    def background() -> float:
        pixels = page.picture()
        return float(pixels[60:100, 5:15].mean())

    page.page.emulate_media(color_scheme="dark")
    page.until("document.documentElement.dataset.look === 'dark'")
    assert background() < 100
    page.page.locator("#look").click()
    page.until("document.documentElement.dataset.look === 'light'")
    assert background() > 150


def test_phone_shows_everything_within_its_width(served: Served, page: Visitor) -> None:
    before = page.page.viewport_size
    page.page.set_viewport_size({"width": 390, "height": 844})
    served.until("w.view.size[0] == 390")
    page.page.keyboard.press("t")
    page.until("!document.getElementById('panel').hidden")
    low, high, wide = page.page.evaluate(
        """() => {
            const boxes = [...document.querySelectorAll("#panel, #tools, #tools button")]
                .filter(each => each.offsetWidth).map(each => each.getBoundingClientRect());
            return [Math.min(...boxes.map(box => box.left)),
                Math.max(...boxes.map(box => box.right)),
                document.documentElement.scrollWidth];
        }"""
    )
    assert low >= 0 and high <= 390 and wide <= 390
    page.page.keyboard.press("t")
    page.until("document.getElementById('panel').hidden")
    page.page.set_viewport_size(before)
    served.until(f"w.view.size[0] == {before['width']}")
