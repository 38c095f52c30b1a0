"""The start page on the web: its server, and a walk in a real browser."""

from __future__ import annotations

import base64
import json
import os
import queue
import re
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import pytest
import trimesh
from conftest import ROOT
from page_client import read_sections
from polling import until
from test_web_guard import get
from web_tools import MISSING
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from sero_mj import Mirror, load_scene
from sero_mj.base import paths
from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.host.start_page import PortMonitor
from sero_mj.viewer.session.recent_views import RecentView
from sero_mj.viewer.web import start_host, uploads
from sero_mj.viewer.web.host import WebHost
from sero_mj.viewer.web.messages import Control, ForStartPage, Got, MessageReader
from sero_mj.viewer.web.server import socket_url
from sero_mj.viewer.web.start_host import StartHost

PATHS = ("/", "/sero-mj/tiles", "/sero-mj/pictures/0", "/sero-mj/start", "/sero-mj/files")


class Opened:
    """A start page that is served, and what its user opens."""

    def __init__(self, **options: Any) -> None:
        self.contents: dict[str, bytes] = {}  # of the folder of the last file
        self.asked: queue.SimpleQueue[RecentView | Path] = queue.SimpleQueue()
        self.page = StartHost(
            self._open, PortMonitor([]), options.pop("host", "127.0.0.1"), **options
        )
        self.found: list[Scene | None] = []
        self._thread = threading.Thread(target=lambda: self.found.append(self.page.run()))
        self._thread.start()

    def _open(self, what: RecentView | Path) -> Scene:
        if isinstance(what, Path):
            folder = what.parent
            self.contents = {
                file.relative_to(folder).as_posix(): file.read_bytes()
                for file in folder.rglob("*") if file.is_file()
            }  # fmt: skip
            self.asked.put(what)
            raise UsageError(f"{what.name}: found {len(what.read_bytes())} bytes; expected a robot")
        self.asked.put(what)
        return Scene(name=what.scene)

    def line(self, path: str, **options: Any) -> Any:
        return connect(socket_url(self.page.server.url, path), **options)

    def secret(self, path: str) -> str:
        """A path with the token of the page."""
        return f"{path}{'&' if '?' in path else '?'}token={self.page.server.token}"

    def get(self, path: str) -> tuple[int, str, dict[str, str]]:
        return get(self.page.server.port, self.secret(path))

    def upload(self, key: str, listed: Any, *parts: bytes) -> dict[str, str]:
        """The answer to files that are dropped."""
        with self.line("/sero-mj/files") as line:
            line.send(json.dumps({"key": key, "files": listed}).replace("Infinity", "1e999"))
            for part in parts:
                line.send(part)
            answer: dict[str, str] = json.loads(line.recv(timeout=10))
            return answer

    def close(self) -> None:
        self.page.close()
        self._thread.join()


@pytest.fixture
def opened() -> Iterator[Opened]:
    found = Opened()
    yield found
    found.close()


class Onlooker:
    """A browser at the start page, without a browser.

    Attributes:
        state: sections that came.
        notices: that came.
    """

    def __init__(self, opened: Opened) -> None:
        self._stack = ExitStack()
        self.line = self._stack.enter_context(opened.line("/sero-mj/start"))
        self.state: dict[str, Any] = {}
        self.notices: list[dict[str, Any]] = []
        self.until(lambda: {"you", "control"} <= self.state.keys())
        self.key: str = self.state["you"]["key"]
        self.id: int = self.state["you"]["id"]

    def say(self, what: str, **words: Any) -> None:
        self.line.send(json.dumps({"t": what, **words}))

    def until(self, found: Callable[[], Any]) -> None:
        while not found():
            sections = read_sections(self.line.recv(timeout=10))
            self.say("got")
            self.state.update(sections)
            self.notices += [sections["notice"]] if sections.get("notice") else []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._stack.close()


def test_tiles_are_listed_with_images_and_open_their_scenes(opened: Opened) -> None:
    status, text, headers = opened.get("/sero-mj/tiles")
    assert (status, headers["Content-Type"]) == (200, "application/json")
    tiles = {tile["title"]: tile for each in json.loads(text)["sections"] for tile in each["tiles"]}
    number = tiles["impedance_push"]["number"]
    (section,) = json.loads(opened.get("/sero-mj/tiles?search=IMPEDANCE%20push")[1])["sections"]
    assert {**tiles["impedance_push"]} in section["tiles"]
    assert json.loads(opened.get("/sero-mj/tiles?search=no%20such")[1])["sections"] == []
    status, _, headers = opened.get(f"/sero-mj/pictures/{number}")
    assert (status, headers["Content-Type"]) == (200, "image/jpeg")
    for wrong in ("/sero-mj/pictures/9999", "/sero-mj/pictures/x", "/etc/passwd", "/sero-mj/"):
        assert opened.get(wrong)[0] == 404
    with Onlooker(opened) as browser:
        for nonsense in ("{", "[]", '{"t": "tile", "number": -1}', '{"t": "tile", "number": "x"}',
                         '{"t": "tile"}', "[" * 5000, "x" * 30_000):  # fmt: skip
            browser.line.send(nonsense)
        browser.say("tile", number=10**6)  # none of the page's
        browser.say("shown", scene="/etc/passwd")
        browser.say("tile", number=number)
        assert opened.asked.get(timeout=10) == RecentView("impedance_push")
        assert opened.asked.empty()
    opened._thread.join(10)
    assert [scene.name for scene in opened.found if scene] == ["impedance_push"]


def test_only_the_browser_in_control_opens_anything(opened: Opened) -> None:
    """Every kind of message, and uploads, from another browser of the page."""
    files = [{"path": "a.toml", "size": 3}]
    with Onlooker(opened) as first, Onlooker(opened) as other:
        assert other.state["control"] == {"holder": first.id, "count": 2}
        for kind in MessageReader(ForStartPage).kinds:
            if kind not in (Got, Control):
                name = kind.model_fields["t"].annotation.__args__[0]  # type: ignore[union-attr]
                refused = opened.page.browsers.refused
                other.say(name, **{"tile": {"number": 0}, "shown": {"scene": "lwr_udp"}}[name])
                assert until(lambda refused=refused: opened.page.browsers.refused == refused + 1, 5)
        for key in (other.key, "", first.key[:-1], f"{first.key}x", "é"):
            answer = opened.upload(key, files)
            assert answer["error"].startswith("another browser has control of this page"), key
        assert opened.asked.empty()
        other.say("control")
        first.until(lambda: first.state["control"]["holder"] == other.id)
        assert "error" in opened.upload(first.key, files)
        assert opened.upload(other.key, files, b"abc") == {"opening": "a.toml"}
        assert isinstance(opened.asked.get(timeout=10), Path)
    # Nobody is in control when all have gone.
    assert until(lambda: opened.page.browsers.holder is None, 5)
    assert "error" in opened.upload(other.key, files)


def test_browser_that_loses_control_during_an_upload_uploads_nothing(opened: Opened) -> None:
    before = uploads.drops.size
    with Onlooker(opened) as first, Onlooker(opened) as other:
        with opened.line("/sero-mj/files") as line:
            listed = [{"path": "a.toml", "size": 6}]
            line.send(json.dumps({"key": first.key, "files": listed}))
            line.send(b"abc")
            assert until(lambda: uploads.drops.size == (before[0] + 1, before[1] + 6), 5)
            other.say("control")
            first.until(lambda: first.state["control"]["holder"] == other.id)
            line.send(b"abc")
            assert "another browser" in json.loads(line.recv(timeout=10))["error"]
        assert uploads.drops.size == before
    assert opened.asked.empty()


def test_complete_files_are_accepted_and_errors_reported(opened: Opened) -> None:
    contents = os.urandom(300_000)
    with Onlooker(opened) as browser:
        listed = [{"path": "r/r.urdf", "size": 300_000}, {"path": "r/m/a.stl", "size": 3}]
        answer = opened.upload(browser.key, listed, contents[:200_000], contents[200_000:], b"abc")
        assert answer == {"opening": "r.urdf"}
        assert opened.asked.get(timeout=10).name == "r.urdf"
        assert opened.contents == {"r.urdf": contents, "m/a.stl": b"abc"}
        browser.until(lambda: browser.notices and browser.notices[-1]["isBad"])
        told = browser.notices[-1]
        assert told["text"] == "r.urdf: found 300000 bytes; expected a robot"
        assert 1 < told["seconds"] < 60
        answer = opened.upload(browser.key, [{"path": "a.toml", "size": 2}], b"abc")
        assert answer == {"error": "a.toml: found contents of another size; expected 2 bytes"}
    assert opened.asked.empty()


def test_rejected_uploads_leave_nothing_and_full_storage_is_reported(
    opened: Opened, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(uploads, "drops", uploads.Drops())
    monkeypatch.setattr(start_host, "drops", uploads.drops)
    monkeypatch.setattr(uploads, "MAX_BYTES", 1000)
    folders = paths.make_temporary_folder().parent
    with Onlooker(opened) as browser:
        before = set(folders.iterdir())
        for _ in range(4):
            listed = [{"path": "a.toml", "size": 900}]
            assert opened.upload(browser.key, listed, b"x" * 900) == {"opening": "a.toml"}
            opened.asked.get(timeout=10)
            # It cannot be opened, see `Opened`, so it is refused.
            assert until(lambda: uploads.drops.size == (0, 0), 10)
            assert set(folders.iterdir()) == before
        shown = uploads.drops.reserve(1, 900)
        uploads.drops.show(shown / "a.toml")
        error = opened.upload(browser.key, [{"path": "b.toml", "size": 101}])["error"]
        assert error.startswith("no space for 1 files of 0 MB: this viewer already stores 1 drops")
        assert set(folders.iterdir()) == {*before, shown}
        uploads.drops.show()  # another scene is shown: its space is given to others
        with opened.line("/sero-mj/files") as line:
            listed = [{"path": "b.toml", "size": 101}]
            line.send(json.dumps({"key": browser.key, "files": listed}))
            assert until(lambda: uploads.drops.size == (1, 101), 10)
            assert not shown.exists()
        assert until(lambda: uploads.drops.size == (0, 0), 10)  # the browser has gone
        assert set(folders.iterdir()) == before


@pytest.mark.parametrize(
    ("listed", "told"),
    [
        (
            [{"path": "a.toml", "size": float("inf")}],
            "the list of dropped files is invalid; expected their paths",
        ),
        ([{"path": f"{'x' * 300}/a.toml", "size": 1}], f"{'x' * 300}/a.toml cannot be stored: "),
        (
            [{"path": "m", "size": 0}, {"path": "m/a.toml", "size": 1}],
            "m/a.toml cannot be stored: ",
        ),
    ],
)
def test_files_that_cannot_be_stored_are_reported_by_their_names(
    opened: Opened, listed: list[dict[str, Any]], told: str
) -> None:
    kept = paths.make_temporary_folder().parent
    before = set(kept.iterdir())
    with Onlooker(opened) as browser:
        error = opened.upload(browser.key, listed)["error"]
    assert error.startswith(told)
    assert str(kept) not in error
    assert set(kept.iterdir()) == before
    assert opened.asked.empty()


def test_errors_in_uploaded_files_use_their_original_names(home: None) -> None:
    path = paths.make_temporary_folder() / "cell" / "scene.toml"
    path.parent.mkdir()
    path.write_text("nonsense = 1\n")
    with pytest.raises(DeclarationError) as found:
        load_scene(path)
    said = paths.without_temporary(f"{found.value} and {paths.models_dir()}")
    assert said.startswith("cell/scene.toml:1: nonsense: unknown section")
    assert said.endswith(f" and {paths.models_dir()}")
    with Mirror(load_scene("lwr")) as mirror, WebHost(mirror) as page:
        page.say(str(found.value), is_bad=True)
        assert page.notice is not None
        assert page.notice.text.startswith("cell/scene.toml:1: nonsense")


def test_other_sites_and_requests_without_a_token_are_rejected(opened: Opened) -> None:
    port = opened.page.server.port
    for path in PATHS:
        for headers in ({"Origin": "http://evil.example"}, {"Sec_Fetch_Site": "cross-site"},
                        {"Host": "evil.example"}):  # fmt: skip
            if (path, *headers) != ("/", "Sec_Fetch_Site"):
                assert get(port, opened.secret(path), **headers)[0] == 403, (path, headers)
        assert get(port, path)[0] == (200 if path == "/" else 403)
        assert get(port, f"{path}?token=wrong")[0] == 403
    for path in PATHS[3:]:
        with pytest.raises(InvalidStatus), opened.line(path, origin="http://evil.example"):
            pass
        with pytest.raises(InvalidStatus), connect(f"ws://localhost:{port}{path}"):
            pass
    with Onlooker(opened) as browser:
        browser.until(lambda: browser.state.get("awaited") == [])


URDF = """
<robot name="pair">
  <link name="base"/>
  <link name="arm"><visual><geometry><mesh filename="meshes/arm.stl"/></geometry></visual></link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="5" velocity="1"/>
  </joint>
</robot>
"""
# Drops files, of a folder where their paths have one, as a browser's user does.
_DROP = """(files) => {
  const entry = (path, inside) => inside === null
    ? { isFile: true, fullPath: "/" + path, file: (done) => done(made[path]) }
    : { isFile: false, createReader: () => {
          let left = [inside.map((each) => entry(each, null)), []];
          return { readEntries: (done) => done(left.shift()) };
        } };
  const made = {};
  for (const [path, data] of Object.entries(files)) {
    const bytes = Uint8Array.from(atob(data), (c) => c.charCodeAt(0));
    made[path] = new File([bytes], path.split("/").pop());
  }
  const names = Object.keys(files);
  const event = new Event("drop", { bubbles: true, cancelable: true });
  const item = { kind: "file", getAsFile: () => made[names[0]],
    webkitGetAsEntry: () => entry("r", names) };
  event.dataTransfer = { types: ["Files"], items: [item] };
  document.body.dispatchEvent(event);
}"""


def evil(ran: Path) -> bytes:
    """A scenario that makes a file if it is simulated."""
    command = json.dumps(["touch", str(ran), "{port}"])
    return f"""[robots.lwr]
model = "lwr"
[controllers.lwr]
kind = "udp"
command = {command}
""".encode()


@pytest.mark.thorough
@pytest.mark.skipif(bool(MISSING), reason=f"needs {' and '.join(MISSING)}")
def test_tile_and_dropped_folder_are_opened_in_a_browser(
    browser: Any, tmp_path: Path, home: None
) -> None:
    program = "from sero_mj.viewer.host import start_page\n"  # without the ports of included scenes
    program += "start_page.listening = lambda: start_page.PortMonitor([])\n"
    program += "from sero_mj.cli import main\nmain(['view', '--web', '--fresh'])"
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_STATE_HOME": str(tmp_path)}
    with subprocess.Popen(
        [sys.executable, "-c", program], env=environment, stdout=subprocess.PIPE, text=True
    ) as command:
        try:
            assert command.stdout is not None
            found = re.search(r"start page is at (http://\S+)", command.stdout.readline())
            assert found is not None
            page = browser.new_page(viewport={"width": 900, "height": 600})
            page.goto(found[1])
            tile = page.locator(".tiles button", has=page.locator("strong", has_text="scara"))
            tile.scroll_into_view_if_needed()
            loaded = "element => element.complete && element.naturalWidth"
            assert page.wait_for_function(
                "() => document.querySelector('.tiles img').naturalWidth === 480"
            )
            assert tile.locator("img").evaluate(loaded) in (480, False)
            tile.click()
            page.wait_for_selector("canvas", timeout=60_000)  # the live page, at the same address
            page.wait_for_function("() => globalThis.player?.state && drops.may()", timeout=60_000)
            assert page.title() == "scara - sero-mj"
            page.evaluate(_DROP, {"r/notes.txt": ""})
            page.wait_for_function("() => drops.text.startsWith('found notes.txt; expected a')")
            mesh = trimesh.creation.box((0.1, 0.1, 0.3)).export(file_type="stl")
            files = {"r/pair.urdf": URDF.encode(), "r/meshes/arm.stl": mesh}
            encoded = {path: base64.b64encode(data).decode() for path, data in files.items()}
            page.evaluate(_DROP, encoded)
            page.wait_for_function("() => document.title === 'pair - sero-mj'", timeout=60_000)
            assert page.evaluate("player.state.run.joints.map((joint) => joint.name)") == [
                "pair/turn"
            ]
            ran = tmp_path / "ran"
            page.evaluate(_DROP, {"r/evil.toml": base64.b64encode(evil(ran)).decode()})
            page.wait_for_function("() => document.title === 'evil - sero-mj'", timeout=60_000)
            dialog = page.get_by_role("dialog", name="This file requests to run programs")
            dialog.get_by_text(f"run the program touch {ran} '{{port}}'").wait_for()
            dialog.get_by_role("button", name="display only").click()
            dialog.wait_for(state="hidden")
            page.get_by_role("button", name="programs of this file").click()
            assert not ran.exists()
            dialog.get_by_role("button", name="run and simulate").click()
            page.locator("#about", has_text="touch has ended").wait_for(timeout=60_000)
            assert ran.exists()
            page.get_by_role("button", name="start page").click()
            page.wait_for_selector(".tiles", timeout=60_000)
            page.close()
        finally:
            command.send_signal(2)
            assert command.wait(30) == 0
    recent = json.loads((tmp_path / "sero-mj" / "recent.json").read_text())
    assert recent == [{"scene": "scara", "replay": ""}]  # not what was dropped, which is gone
