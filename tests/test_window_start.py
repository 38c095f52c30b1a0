"""The start page in a real window, worked by mouse and keys."""

from __future__ import annotations

import os
import socket
import subprocess
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from driver import Driver
from window_tools import MISSING, screen

pytestmark = pytest.mark.skipif(bool(MISSING), reason=f"needs {' and '.join(MISSING)}")

SIZE = (900, 600)  # files and data are beside the tiles
_DRIVER = """
import os
os.environ["MUJOCO_GL"] = "glfw"
from pathlib import Path
from sero_mj.robots.declared.scene import Scene
from sero_mj.base.errors import UsageError
from sero_mj.viewer.session.recent_views import RecentView
from sero_mj.viewer.host.start_page import PortMonitor
from sero_mj.viewer.window.start_window import StartWindow
from imgui_bundle import imgui
size, heard = json.loads(sys.argv[1])
places = {}  # of what can be pressed, by its label: left, top, right, bottom
def noted(build):
    def built(label, *rest):
        found = build(label, *rest)
        low, high = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        places[label.partition("##")[0] or label] = [low.x, low.y, high.x, high.y]
        return found
    return built
for name in ("button", "image_button", "input_text_with_hint"):
    setattr(imgui, name, noted(getattr(imgui, name)))
opened = []
def open_it(what):
    opened.append(str(what) if isinstance(what, Path) else what.scene)
    if "wrong" in opened[-1]:
        raise UsageError(f"{opened[-1]}: found nothing; expected a robot")
    return Scene(name=opened[-1])
with PortMonitor([RecentView(each) for each in heard]) as listening:
    with StartWindow(open_it, listening, size) as w:
        w.frame()
        print("ready", flush=True)
        frames = 0
        while w.frame():
            frames += 1
            answer()
print("closed", flush=True)
while True:
    answer()
"""


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    with screen() as name:
        yield name


class Start(Driver):
    """A start page in a window of another process."""

    goodbye = "os._exit(0)"
    opens_windows = True

    def __init__(self, display: str, folder: Path, *heard: str) -> None:
        self._environment = {**os.environ, "DISPLAY": display, "XDG_STATE_HOME": str(folder)}
        self._environment.pop("WAYLAND_DISPLAY", None)
        super().__init__(_DRIVER, [SIZE, heard], folder, self._environment)

    def tool(self, *arguments: object) -> None:
        command = ["xdotool", *(str(argument) for argument in arguments)]
        subprocess.run(command, check=True, env=self._environment, timeout=20)

    def click(self, label: str) -> None:
        left, top, right, bottom = self.until(f"places.get({label!r})")
        self.tool("mousemove", round((left + right) / 2), round((top + bottom) / 2))
        frames = self.ask("frames")
        self.until(f"frames > {frames} + 2")  # the pointer is over it
        self.tool("click", 1)


def test_tile_opens_its_scene_and_errors_are_reported(display: str, tmp_path: Path) -> None:
    with Start(display, tmp_path) as start:
        start.click("##path")
        start.until("w._layer.takes_keys")
        start.tool("type", "/wrong.toml")
        start.tool("key", "Return")
        start.until("opened")
        notice = start.until("w.page.notice.is_bad and w.page.notice.text")
        assert notice == "/wrong.toml: found nothing; expected a robot"
        start.ask("w.gl._on_drop(None, ['/cell/wrong.urdf', 'b'])")
        start.until("opened[1:] == ['/cell/wrong.urdf']")
        start.click("##search")
        start.until("w._layer.takes_keys")
        start.tool("type", "stand biped")
        start.until("w._search == 'stand biped'")
        start.ask("places.clear()")
        start.click("biped_stand")
        start.until("w.page.chosen is not None")
        assert start.ask("[opened[-1], w.page.chosen.name]") == ["biped_stand", "biped_stand"]


@pytest.mark.thorough
def test_incoming_data_has_a_button(display: str, tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    cell = tmp_path / "cell.toml"
    cell.write_text(f'[sources.arm]\nkind = "udp"\nport = {port}\nstructure = "2F"\n')
    with (
        Start(display, tmp_path, str(cell)) as start,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        assert start.ask("'show cell.toml' in places") is False
        sender.connect(("127.0.0.1", port))
        done = threading.Event()

        def send() -> None:
            while not done.wait(0.02):
                with suppress(ConnectionRefusedError):  # once the start page has ended
                    sender.send(bytes(16))

        thread = threading.Thread(target=send)
        thread.start()
        try:
            start.click("show cell.toml")
            start.until("w.page.chosen is not None")
        finally:
            done.set()
            thread.join()
        assert start.ask("opened") == [str(cell)]
