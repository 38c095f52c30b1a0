"""Pages that have a server of their own: several browsers, lost servers, sources, fingers."""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from polling import until
from web_tools import FEW, MISSING, POSE, TORQUES, Served, Visitor, blue

# Their own file, for a page that is still open elsewhere takes its share of the processor to draw.
pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]


@pytest.mark.thorough
def test_second_browser_watches_and_takes_control(browser: Any, tmp_path: Path) -> None:
    settings = (POSE, TORQUES, "lwr.show_arrows=true")
    with Served(tmp_path, "lwr", settings=settings) as served:
        first = Visitor(browser, served, (280, 240))
        first.until("player.isInControl")
        second = Visitor(browser, served, (400, 300))
        second.until("!player.isInControl")
        second.shows(lambda p: blue(p) > FEW)
        # It has the same cards, in a picture of its own size.
        served.ask("w.toggles.billboards.fill(True)")
        for visitor in (first, second):
            visitor.until("document.querySelectorAll('#cards button').length === 7")
            assert visitor.page.evaluate(
                """[...document.querySelectorAll("#cards button")].filter(card => card.offsetWidth)
                    .map(card => card.getBoundingClientRect())
                    .every(({ left, right, top, bottom }) => left >= 0 && right <= innerWidth
                        && top >= 0 && bottom <= innerHeight)"""
            )
        # It sees what the other one turns.
        first.page.mouse.move(60, 200)
        first.page.mouse.down()
        first.page.mouse.move(120, 200, steps=3)
        first.page.mouse.up()
        azimuth = "Math.round(player.stage.view.azimuth)"
        turned = first.page.evaluate(azimuth)
        second.until(f"Math.abs({azimuth} - {turned}) <= 1")
        # Its keys do nothing until it has asked for control.
        second.page.keyboard.press("a")
        second.page.get_by_role("button", name="take control").click()
        second.until("player.isInControl")
        first.until("!player.isInControl")
        assert served.ask("w.toggles.arrows.all()")
        second.page.keyboard.press("a")
        served.until("not w.toggles.arrows.any()")
        second.close()
        first.until("player.isInControl")
        first.close()


@pytest.mark.thorough
def test_restarted_server_is_found_by_its_link(browser: Any, tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    options: dict[str, Any] = {"settings": (POSE, TORQUES), "port": port}
    with Served(tmp_path, "lwr", **options) as first:
        visitor = Visitor(browser, first)
        without = visitor.picture()
        first.visitors.clear()  # the page stays
        first.process.kill()
        first.process.join()
        visitor.page.get_by_text("The viewer is not running").wait_for()
    with Served(tmp_path, "lwr", **options) as again:
        again.ask("w.toggles.arrows.fill(True)")
        # It has another token, which a second tab of the same browser brings.
        visitor.page.get_by_text("This page is locked").wait_for()
        assert not blue(visitor.picture()) > blue(without) + FEW
        with visitor.page.expect_popup() as popup:
            visitor.page.evaluate("url => void open(url)", again.url)
        visitor.shows(lambda p: blue(p) > blue(without) + FEW)
        visitor.page.get_by_text("This page is locked").wait_for(state="hidden")
        popup.value.close()
    # That nobody answered for a while, and then refused, is what its console has.
    expected = ("ERR_CONNECTION_REFUSED", "403 (Forbidden)")
    assert [fault for fault in visitor.faults if not any(e in fault for e in expected)] == []
    visitor.page.close()


def test_mirrored_robot_moves_and_is_gray_when_its_source_is_silent(
    browser: Any, tmp_path: Path
) -> None:
    port = free_port(socket.SOCK_DGRAM)
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[robots.lwr]\nmodel = "lwr"\nstale_after = 3.0\n'
        f'[sources.udp]\nkind = "udp"\nport = {port}\nstructure = "7F"\n'
        '[routes]\n"lwr.joint_angles" = "udp.values0"\n'
    )
    with Served(tmp_path, str(scene)) as served:
        visitor = Visitor(browser, served)
        served.until("not w.notice.is_shown")  # that nothing has come yet
        visitor.until("document.getElementById('message').hidden")
        visitor.until("player.state.greys.some((grey) => grey)")
        grey = visitor.picture()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:

            def is_light() -> bool:
                sender.sendto(struct.pack("<7d", 0, 0.5, 0, -1, 0, 0, 0), ("127.0.0.1", port))
                return bool(visitor.page.evaluate("!player.state.greys.some((grey) => grey)"))

            assert until(is_light, 30.0)
        assert served.ask("w.data.qpos[[1, 3]]") == [0.5, -1.0]
        visitor.shows(lambda pixels: (np.abs(pixels - grey) > 20).any(axis=2).sum() > 200)
        visitor.until("player.state.greys.some((grey) => grey)")
        visitor.close()


def free_port(kind: socket.SocketKind) -> int:
    """A port that nobody has."""
    with socket.socket(socket.AF_INET, kind) as free:
        free.bind(("127.0.0.1", 0))
        return int(free.getsockname()[1])


@pytest.mark.thorough
def test_one_finger_taps_and_two_zoom(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,)) as served:
        hand = Visitor(browser, served, has_touch=True)
        served.until("w.view.size == (560, 400)")
        x, y = hand.joint(1)
        touch = hand.finger(x, y)
        touch("touchStart", 0)
        served.until("w._input._mouse.is_down")
        touch("touchEnd")
        served.until("clicks")
        far, azimuth = served.ask("[w.navigator.camera.distance, w.navigator.camera.azimuth]")
        touch("touchStart", -30)
        touch("touchStart", -30, 30)
        for half in (36, 42, 48, 54, 60):
            touch("touchMove", -half, half)
        touch("touchEnd")
        served.until(f"{0.4 * far} < w.navigator.camera.distance < {0.6 * far}")
        assert served.ask("w.navigator.camera.azimuth") == pytest.approx(azimuth, abs=1e-3)
        # Mouse events of fingers would have clicked again by now.
        assert served.ask("clicks") == [["click", "lwr/link2"]]
        hand.close()


@pytest.mark.thorough
def test_simulation_is_pulled_paused_and_scrubbed(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "impedance_push", settings=("run.duration=100",)) as served:
        visitor = Visitor(browser, served, has_touch=True)
        mouse = visitor.page.mouse
        camera = "[w.navigator.camera.azimuth, w.navigator.camera.distance]"
        seen = served.ask(camera)
        x, y = visitor.joint(3)
        mouse.move(x, y)
        visitor.page.keyboard.down("Control")
        mouse.down()
        mouse.move(x - 48, y - 32, steps=3)
        served.until(
            "w.tools['pulling'].is_on and (w.tools['pulling']._force.force ** 2).sum() > 20 ** 2"
        )
        assert served.ask("w.notice.text").startswith("pulls lwr/link4 with 500 N/m")
        visitor.until("player.now.dragging")
        mouse.wheel(0, -100)
        served.until("w.tools['pulling']._force.stiffness == 625")
        visitor.page.keyboard.up("Control")
        mouse.up()
        served.until("not w.tools['pulling'].is_on")
        assert served.ask(camera) == seen
        touch = visitor.finger(*visitor.joint(3))
        touch("touchStart", 0)
        visitor.page.get_by_text("drag to pull lwr/link4").wait_for()
        for by in (20, 45):
            touch("touchMove", by)
            served.until("w.tools['pulling'].is_on")
        touch("touchEnd")
        served.until("not w.tools['pulling'].is_on and len(w.tools['pulling']._force.pulls) == 2")
        assert served.ask(camera) == seen
        assert served.ask("clicks") == []
        now = served.until("w.clock.time > 4 and w.clock.time")
        box = visitor.page.locator("#timeline input[type=range]").bounding_box()
        mouse.click(box["x"] + 0.02 * box["width"], box["y"] + box["height"] / 2)
        served.until(f"w.clock.time < {now} - 0.05")
        visitor.page.locator("#picture").focus()
        visitor.page.keyboard.press(" ")
        assert served.until("w.clock.is_paused")
        time = served.ask("w.clock.time")
        assert served.ask("w.data.time") == pytest.approx(time, abs=0.05)
        visitor.close()


@pytest.mark.thorough
def test_help_opens_over_a_small_page_and_closes(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr") as served:
        visitor = Visitor(browser, served, (600, 380))
        dialog = visitor.page.get_by_role("dialog", name="Mouse and keys")
        for opens, closes in (("h", "Escape"), ("?", "h")):
            visitor.page.keyboard.press(opens)
            dialog.wait_for()
            assert served.ask("w.shows_help")
            box = dialog.bounding_box()
            assert box["x"] >= 0 and box["x"] + box["width"] <= 600
            assert box["y"] >= 0 and box["y"] + box["height"] <= 380
            visitor.page.keyboard.press(closes)
            dialog.wait_for(state="hidden")
            assert not served.ask("w.shows_help")
        visitor.close()
