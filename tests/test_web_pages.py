"""Pages that have a server of their own: several browsers, lost servers, sources, fingers."""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from web_tools import FEW, MISSING, POSE, TORQUES, Served, Visitor, blue, on_page

# Their own file, for a page that is still open elsewhere takes its share of the processor to draw.
pytestmark = [
    pytest.mark.gl,
    pytest.mark.timeout(300),
    pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}"),
]


@pytest.mark.thorough
def test_a_second_browser_watches_and_takes_over(browser: Any, tmp_path: Path) -> None:
    settings, small = (POSE, TORQUES, "lwr.show_arrows=true"), (280, 240)
    with Served(tmp_path, "lwr", settings=settings) as served:
        first = Visitor(browser, served, small)
        first.hears("role=controller")
        second = Visitor(browser, served, (400, 300))
        second.hears("role=spectator")
        second.shows(lambda p: blue(p) > FEW)
        # It has numbers of its own, in a page without Studio's bar.
        assert served.until("[*w.decor._others]") == [[400, 268]]
        served.ask("w.toggles.billboards.fill(True)")
        served.settle()
        own, other = "w.decor.panels", "w.decor._others[400, 268].panels"
        for panels, (width, height) in ((own, (280, 208)), (other, (400, 268))):
            high = f"max((p.centres + p.sizes / 2).max(axis=0)[{{}}] for p in {panels})"
            assert 0.8 * width < served.ask(high.format(0)) <= width
            assert served.ask(high.format(1)) <= height
        first.close()
        third = Visitor(browser, served, small)
        third.hears("role=controller")
        second.close()
        third.close()


@pytest.mark.thorough
def test_control_is_released_and_asked_back_with_a_button_that_was_let_go_of_elsewhere(
    browser: Any, tmp_path: Path
) -> None:
    """While a dialog was open, say: Studio held it for ever, and its bar could not be clicked."""
    with Served(tmp_path, "lwr") as served:
        visitor = Visitor(browser, served)
        visitor.hears("First remote draw frame applied")
        line = visitor.page.context.new_cdp_session(visitor.page)
        where = {"x": 450, "y": 200, "button": "right", "clickCount": 1}
        line.send("Input.dispatchMouseEvent", {"type": "mousePressed", **where})
        for wanted in (False, True):
            visitor.set_control(wanted)
        visitor.press("p")
        visitor.close()


@pytest.mark.thorough
def test_a_restarted_server_is_found_again(browser: Any, tmp_path: Path) -> None:
    port = free_port(socket.SOCK_STREAM)
    options: dict[str, Any] = {"settings": (POSE, TORQUES), "port": port}
    with Served(tmp_path, "lwr", **options) as first:
        visitor = Visitor(browser, first)
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
        '[robots.lwr]\nmodel = "lwr"\nstale_after = 3.0\n'
        f'[sources.udp]\nkind = "udp"\nport = {port}\nstructure = "7F"\n'
        '[routes]\n"lwr.joint_angles" = "udp.values0"\n'
    )
    with Served(tmp_path, str(scene)) as served:
        served.ask("setattr(w, 'shows_status', False)")
        visitor = Visitor(browser, served)
        visitor.hears("First remote draw frame applied")
        served.until("not w.notice.is_shown")  # that nothing has come yet
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
    return on_page((pixels[..., 0] > 150) & (warm > 8) & (warm < 60))


@pytest.mark.thorough
def test_a_finger_taps_once_and_two_zoom(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr", settings=(POSE,)) as served:
        served.ask("setattr(w, 'shows_status', False)")
        hand = Visitor(browser, served, has_touch=True)
        hand.hears("First remote draw frame applied")
        served.until("w.decor.view is not None")
        served.settle()
        x, y = served.joint(1)
        send = hand.page.context.new_cdp_session(hand.page).send

        def touch(kind: str, *offsets: float) -> None:
            points = [{"x": x + by, "y": y, "id": i} for i, by in enumerate(offsets)]
            send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

        touch("touchStart", 0)
        served.until("w._app._mouse.is_down")
        touch("touchEnd")
        served.until("clicks")
        hand.page.wait_for_timeout(1500)  # in which mouse events would come
        assert served.ask("clicks") == [["click", "lwr/link2"]]
        far, azimuth = served.ask("[w.viewer.camera.distance, w.viewer.camera.azimuth]")
        touch("touchStart", -30)
        touch("touchStart", -30, 30)
        for half in (36, 42, 48, 54, 60):
            touch("touchMove", -half, half)
        touch("touchEnd")
        served.until(f"{0.4 * far} < w.viewer.camera.distance < {0.6 * far}")
        served.settle()
        assert served.ask("w.viewer.camera.azimuth") == azimuth
        assert served.ask("len(clicks)") == 1
        hand.close()


def test_a_simulation_is_pulled_paused_and_scrubbed(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "impedance_push", settings=("run.duration=100",)) as served:
        served.ask("setattr(w, 'shows_status', False)")
        # With fewer pixels Studio's page takes a turn of the wheel for more.
        visitor = Visitor(browser, served, has_touch=True, device_scale_factor=1)
        visitor.hears("First remote draw frame applied")
        served.until("w.decor.view is not None")
        served.settle()
        camera = "[w.viewer.camera.azimuth, w.viewer.camera.distance]"
        seen = served.ask(camera)
        x, y = served.joint(3)
        visitor.move(x, y)
        visitor.page.keyboard.down("Control")
        served.settle()
        visitor.hold()
        visitor.page.mouse.move(x - 48, y - 32, steps=3)
        served.until(
            "w.tools['pulling'].is_on and (w.tools['pulling']._force.force ** 2).sum() > 20 ** 2"
        )
        assert served.ask("w.notice.text").startswith("pulls lwr/link4 with 500 N/m")
        visitor.page.mouse.wheel(0, -100)
        served.until("600 < w.tools['pulling']._force.stiffness < 700")
        visitor.page.keyboard.up("Control")
        visitor.release()
        served.until("not w.tools['pulling'].is_on")
        assert served.ask(camera) == seen
        x, y = served.joint(3)
        send = visitor.page.context.new_cdp_session(visitor.page).send
        for kind, by in (("touchStart", 0), ("touchMove", 20), ("touchMove", 45), ("touchEnd", 0)):
            points = [{"x": x + by, "y": y, "id": 0}] * (kind != "touchEnd")
            send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
            if kind == "touchStart":
                served.until("w.notice.text == 'drag to pull lwr/link4'")
            elif kind == "touchMove":
                served.until("w.tools['pulling'].is_on")
        served.until("not w.tools['pulling'].is_on and len(w.tools['pulling']._force.pulls) == 2")
        assert served.ask(camera) == seen
        assert served.ask("clicks") == []
        now = served.until("w.clock.time > 4 and w.clock.time")
        left, top, right, bottom = served.until("places.get('##time')")
        visitor.click(left + 0.02 * (right - left), (top + bottom) / 2)
        served.until(f"w.clock.time < {now} - 0.05")
        visitor.press(" ")
        assert served.until("w.clock.is_paused")
        time = served.ask("w.clock.time")
        assert served.ask("w.data.time") == pytest.approx(time, abs=0.05)
        visitor.close()


@pytest.mark.thorough
def test_windows_of_the_page_stay_on_it_and_beside_studios(browser: Any, tmp_path: Path) -> None:
    with Served(tmp_path, "lwr") as served:
        visitor = Visitor(browser, served, (600, 380))
        visitor.hears("First remote draw frame applied")
        served.ask("setattr(w, 'shows_help', True)")
        served.until("'Mouse and keys' in windows")
        served.settle(30)
        left, top, right, bottom = served.ask("windows['Mouse and keys']")
        assert 0 <= left < right <= 600
        assert 0 <= top < bottom <= 380
        served.ask("setattr(w, 'shows_help', False)")
        served.ask("setattr(w._app.config, 'show_options', True)")
        served.until("w._app.docked[0] > 0")
        served.settle(30)
        of_studio, ours = served.ask("[windows['Options'], windows['lwr']]")
        assert ours[0] >= of_studio[2]
        visitor.click(62, 12)  # the menu Simulation
        visitor.click(*served.middle("Pause"))
        served.until("w.clock.is_paused")
        visitor.close()
