"""A real page in a real browser: what is seen on it, and what clicks and keys change."""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from web_tools import ARGUMENTS, CHROMIUM, MISSING, Served, Visitor, blue, orange

pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]

POSE = "lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0"
TORQUES = "lwr.torques=20,60,-30,40,-9,5,3"
FEW = 60  # pixels of an arrow, at least


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def served(tmp_path_factory: Any) -> Iterator[Served]:
    folder = tmp_path_factory.mktemp("page")
    with Served(folder, "lwr", settings=(POSE, TORQUES, "lwr.show_arrows=true")) as served:
        yield served


@pytest.fixture(scope="module")
def visitor(browser: Any, served: Served) -> Iterator[Visitor]:
    visitor = Visitor(browser, served.url)
    visitor.hears("First remote draw frame applied")
    served.until("w.decor.view is not None and w.decor.count > 0")
    yield visitor
    visitor.close()


@pytest.fixture
def page(served: Served, visitor: Visitor) -> Visitor:
    """The page as it was when it was opened."""
    visitor.page.mouse.move(500, 60)
    served.ask("w.toggles.reset()")
    served.ask("w.choose_camera(0)[:0]")
    served.ask("setattr(w._panels, 'shows_status', False)")  # it would cover the robot
    served.settle()
    return visitor


def test_arrows_are_seen_in_both_colours_and_go_with_their_key(
    served: Served, page: Visitor
) -> None:
    served.ask("w.toggles.arrows.fill(False)")
    without = page.still()
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
        "(lambda pen: (w.decor.view.project(pen.rows['pos'][:pen.count][(pen.kinds[:pen.count]"
        " == 1) & (pen.items[:pen.count] == 1)].astype(float))[0]))(w.decor._decor.pen).tolist()"
    )
    height = served.ask("w.decor.view.height")
    seen = [
        (x, height - y)
        for x, y in served.ask(place)
        if served.ask(f"getattr(w.decor.pick(w.data, {x}, {y}), 'kind', '')") == "arrow"
    ]
    served.ask("setattr(w.clock, 'is_paused', True)")  # an arrow that turns moves away
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
    page.page.mouse.move(*served.joint(3))
    assert served.until("w.toggles.hover and w.toggles.hover[0]") == "lwr/link4"


def test_a_drag_turns_the_view_and_clicks_on_nothing(served: Served, page: Visitor) -> None:
    before, clicks = served.ask("w.viewer.camera.azimuth"), served.ask("len(clicks)")
    mouse = page.page.mouse
    mouse.move(430, 260)
    page.page.wait_for_timeout(300)
    mouse.down()
    for x in (440, 455, 470, 490, 510, 530):
        mouse.move(x, 260)
        page.page.wait_for_timeout(200)
    mouse.up()
    served.until(f"abs(w.viewer.camera.azimuth - {before}) > 5")
    assert served.ask("len(clicks)") == clicks


def test_the_panel_switches_what_is_shown(served: Served, page: Visitor) -> None:
    page.press("t")
    page.click(*served.middle("axes"))
    served.until("w.toggles.axes.any()")
    page.click(*served.middle("axes"))
    served.until("not w.toggles.axes.any()")


def test_billboards_stay_clear_of_the_panel(served: Served, page: Visitor) -> None:
    served.ask("w.toggles.billboards.fill(True)")
    served.ask("setattr(w._panels, 'shows_status', True)")
    served.settle()
    left = served.ask("w._panels.inset[0]")
    assert left > 300
    edges = served.ask(
        "(lambda pen, rows: (w.decor.view.project((rows['pos'] - rows['size'][:, :1] *"
        " rows['mat'][:, :, 0]).astype(float))[0][:, 0]))(w.decor._decor.pen,"
        " w.decor._decor.pen.rows[:w.decor.count][w.decor._decor.pen.kinds[:w.decor.count] == 2])"
        ".tolist()"
    )
    assert len(edges) == 7
    assert min(edges) >= left - 1


def test_a_second_browser_watches_and_takes_over(
    browser: Any, served: Served, page: Visitor
) -> None:
    other = Visitor(browser, served.url)
    other.hears("role=spectator")
    other.shows(lambda p: blue(p) > blue(page.picture()) / 2 > FEW)
    page.page.reload()  # the one in control leaves; it may come back as either
    served.until("w.viewer.server._thread.is_alive()")
    other.close()
    page.hears("role=controller")


def test_a_restarted_server_is_found_again(browser: Any, tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    options: dict[str, Any] = {"settings": (POSE, TORQUES), "port": port}
    with Served(tmp_path, "lwr", **options) as first:
        visitor = Visitor(browser, first.url)
        visitor.hears("First remote draw frame applied")
        first.process.kill()
        first.process.wait()
    without = visitor.still()
    with Served(tmp_path, "lwr", **options) as again:
        again.ask("w.toggles.arrows.fill(True)")
        visitor.shows(lambda p: blue(p) > blue(without) + FEW)
    visitor.close()


def test_a_mirrored_robot_moves_and_is_grey_when_its_source_is_quiet(
    browser: Any, tmp_path: Path
) -> None:
    port = free_port(socket.SOCK_DGRAM)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[robots.lwr]\nmodel = "lwr"\nstale_after = 5.0\n'
        f'[sources.udp]\nkind = "udp"\nport = {port}\nstructure = "7F"\n'
        '[routes]\n"lwr.joint_angles" = "udp.values0"\n'
    )
    with Served(tmp_path, str(scene)) as served:
        served.ask("setattr(w._panels, 'shows_status', False)")
        visitor = Visitor(browser, served.url)
        visitor.hears("First remote draw frame applied")
        grey = _light_pixels(visitor.still())
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

            def is_light(pixels: np.ndarray) -> bool:
                sender.sendto(struct.pack("<7d", 0, 0.5, 0, -1, 0, 0, 0), ("127.0.0.1", port))
                return _light_pixels(pixels) > grey + 500

            visitor.shows(is_light)
        assert served.ask("w.data.qpos[[1, 3]]") == [0.5, -1.0]
        visitor.shows(lambda p: _light_pixels(p) < grey + 100)
        visitor.close()


def free_port(kind: socket.SocketKind) -> int:
    """A port that nobody has."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


def _light_pixels(pixels: np.ndarray) -> int:
    """Pixels of the LWR's shell: light, and warmer than the floor."""
    warm = pixels[..., 0] - pixels[..., 2]
    return int(((pixels[..., 0] > 150) & (warm > 8) & (warm < 60)).sum())


def test_a_finger_taps_once(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,)) as served:
        served.ask("setattr(w._panels, 'shows_status', False)")
        finger = Visitor(browser, served.url, has_touch=True)
        finger.hears("First remote draw frame applied")
        served.until("w.decor.view is not None")
        served.settle()
        x, y = served.joint(1)
        send = finger.page.context.new_cdp_session(finger.page).send
        at = [{"x": x, "y": y}]
        send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": at})
        served.until("w._app._mouse.is_down")
        send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
        served.until("clicks")
        finger.page.wait_for_timeout(1500)  # in which mouse events would come
        assert served.ask("clicks") == [["click", "lwr/link2"]]
        finger.close()


def test_a_simulation_is_paused_and_scrubbed(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "impedance_push") as served:
        visitor = Visitor(browser, served.url)
        visitor.hears("First remote draw frame applied")
        served.until("w.clock.time >= w.clock.end - 1e-6")
        left, top, right, bottom = served.until("places.get('##time')")
        visitor.click(left + 0.5 * (right - left), (top + bottom) / 2)
        served.until("abs(w.clock.time - w.clock.end / 2) < 0.6 or w.clock.time")
        visitor.press(" ")
        assert served.until("w.clock.is_paused")
        time = served.ask("w.clock.time")
        assert time < served.ask("w.clock.end") - 0.05
        assert served.ask("w.data.time") == pytest.approx(time, abs=0.05)
        visitor.close()
