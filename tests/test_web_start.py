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
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import trimesh
from conftest import ROOT
from test_web_guard import get
from web_tools import MISSING
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from sero_mj import Mirror, load_scene
from sero_mj.base import paths
from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.session.recent_views import RecentView
from sero_mj.viewer.session.start_page import PortMonitor
from sero_mj.viewer.web.host import WebHost
from sero_mj.viewer.web.start_host import StartHost

PATHS = ("/", "/sero-mj/tiles", "/sero-mj/pictures/0", "/sero-mj/start", "/sero-mj/files")


class Opened:
    """A start page that is served, and what its user opens."""

    def __init__(self, **options: Any) -> None:
        self.asked: queue.SimpleQueue[RecentView | Path] = queue.SimpleQueue()
        self.page = StartHost(
            self._open, PortMonitor([]), options.pop("host", "127.0.0.1"), **options
        )
        self.found: list[Scene | None] = []
        self._thread = threading.Thread(target=lambda: self.found.append(self.page.run()))
        self._thread.start()

    def _open(self, what: RecentView | Path) -> Scene:
        self.asked.put(what)
        if isinstance(what, Path):
            raise UsageError(f"{what.name}: found {len(what.read_bytes())} bytes; expected a robot")
        return Scene(name=what.scene)

    def line(self, path: str, **options: Any) -> Any:
        token = f"?token={self.page.server.token}" if self.page.server.token else ""
        return connect(f"ws://localhost:{self.page.server.port}{path}{token}", **options)

    def close(self) -> None:
        self.page.close()
        self._thread.join()


@pytest.fixture
def opened() -> Iterator[Opened]:
    found = Opened()
    yield found
    found.close()


def notice(line: Any) -> dict[str, Any]:
    """The next message that is no report of what is awaited."""
    while True:
        message: dict[str, Any] = json.loads(line.recv(timeout=10))
        if "awaited" not in message:
            return message


def test_tiles_are_listed_with_pictures_and_open_their_scenes(opened: Opened) -> None:
    port = opened.page.server.port
    assert get(port)[0] == 200
    status, text, headers = get(port, "/sero-mj/tiles")
    assert (status, headers["Content-Type"]) == (200, "application/json")
    tiles = {tile["title"]: tile for each in json.loads(text)["sections"] for tile in each["tiles"]}
    number = tiles["impedance_push"]["number"]
    (section,) = json.loads(get(port, "/sero-mj/tiles?search=IMPEDANCE%20push")[1])["sections"]
    assert {**tiles["impedance_push"]} in section["tiles"]
    assert json.loads(get(port, "/sero-mj/tiles?search=no%20such")[1])["sections"] == []
    status, _, headers = get(port, f"/sero-mj/pictures/{number}")
    assert (status, headers["Content-Type"]) == (200, "image/jpeg")
    for wrong in ("/sero-mj/pictures/9999", "/sero-mj/pictures/x", "/etc/passwd", "/sero-mj/"):
        assert get(port, wrong)[0] == 404
    with opened.line("/sero-mj/start") as line:
        for nonsense in ("{", "[]", '{"tile": -1}', '{"tile": "x"}', '{"shown": "/etc/passwd"}'):
            line.send(nonsense)
        line.send(json.dumps({"tile": number}))
        assert opened.asked.get(timeout=10) == RecentView("impedance_push")
        assert opened.asked.empty()
    opened._thread.join(10)
    assert [scene.name for scene in opened.found if scene] == ["impedance_push"]


def test_files_are_taken_whole_and_what_is_wrong_is_told(opened: Opened) -> None:
    contents = os.urandom(300_000)
    with opened.line("/sero-mj/start") as start:
        json.loads(start.recv(timeout=10))
        with opened.line("/sero-mj/files") as line:
            line.send(json.dumps([{"path": "r/r.urdf", "size": 300_000},
                                  {"path": "r/m/a.stl", "size": 3}]))  # fmt: skip
            for part in (contents[:200_000], contents[200_000:], b"abc"):
                line.send(part)
            assert json.loads(line.recv(timeout=10)) == {"opening": "r.urdf"}
        path = opened.asked.get(timeout=10)
        assert isinstance(path, Path)
        assert path.read_bytes() == contents
        assert (path.parent / "m" / "a.stl").read_bytes() == b"abc"
        told = notice(start)
        told = told if told["is_bad"] else notice(start)
        assert told["notice"] == "r.urdf: found 300000 bytes; expected a robot"
        assert 1 < told["seconds"] < 60
    with opened.line("/sero-mj/files") as line:
        line.send(json.dumps([{"path": "a.toml", "size": 2}]))
        line.send(b"abc")
        told = json.loads(line.recv(timeout=10))
        assert told == {"error": "a.toml: found other contents than its 2 bytes"}
    assert opened.asked.empty()


@pytest.mark.parametrize(
    ("listed", "told"),
    [
        ([{"path": "a.toml", "size": float("inf")}], "found no list of files; expected paths"),
        ([{"path": f"{'x' * 300}/a.toml", "size": 1}], f"{'x' * 300}/a.toml: cannot be kept: "),
        ([{"path": "m", "size": 0}, {"path": "m/a.toml", "size": 1}], "m/a.toml: cannot be kept: "),
    ],
)
def test_files_that_cannot_be_kept_are_told_by_their_own_names(
    opened: Opened, listed: list[dict[str, Any]], told: str
) -> None:
    kept = paths.make_temporary_folder().parent
    before = set(kept.iterdir())
    with opened.line("/sero-mj/files") as line:
        line.send(json.dumps(listed).replace("Infinity", "1e999"))
        error = json.loads(line.recv(timeout=10))["error"]
    assert error.startswith(told)
    assert str(kept) not in error
    assert set(kept.iterdir()) == before
    assert opened.asked.empty()


def test_faults_in_files_that_were_dropped_have_their_names_there(home: None) -> None:
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


def test_other_sites_and_who_has_no_token_are_refused(opened: Opened) -> None:
    for path in PATHS:
        for headers in ({"Origin": "http://evil.example"}, {"Sec_Fetch_Site": "cross-site"},
                        {"Host": "evil.example"}):  # fmt: skip
            if (path, *headers) != ("/", "Sec_Fetch_Site"):
                assert get(opened.page.server.port, path, **headers)[0] == 403, (path, headers)
    for path in PATHS[3:]:
        with pytest.raises(InvalidStatus), opened.line(path, origin="http://evil.example"):
            pass
    guarded = Opened(token=True)
    try:
        for path in PATHS:
            assert get(guarded.page.server.port, path)[0] == 403
            assert get(guarded.page.server.port, f"{path}?token=wrong")[0] == 403
        assert (
            get(guarded.page.server.port, f"/sero-mj/tiles?token={guarded.page.server.token}")[0]
            == 200
        )
        with guarded.line("/sero-mj/start") as line:
            assert json.loads(line.recv(timeout=10)) == {"awaited": []}
    finally:
        guarded.close()


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


@pytest.mark.thorough
@pytest.mark.skipif(bool(MISSING), reason=f"needs {' and '.join(MISSING)}")
def test_a_tile_is_opened_and_a_folder_dropped_in_a_browser(
    browser: Any, tmp_path: Path, home: None
) -> None:
    program = (
        "from sero_mj.viewer.session import start_page\n"  # without the ports of shipped scenes
    )
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
            page.wait_for_function("() => drops.told.startsWith('found notes.txt; expected a')")
            mesh = trimesh.creation.box((0.1, 0.1, 0.3)).export(file_type="stl")
            files = {"r/pair.urdf": URDF.encode(), "r/meshes/arm.stl": mesh}
            encoded = {path: base64.b64encode(data).decode() for path, data in files.items()}
            page.evaluate(_DROP, encoded)
            page.wait_for_function("() => document.title === 'pair - sero-mj'", timeout=60_000)
            assert page.evaluate("player.state.run.joints.map((joint) => joint.name)") == [
                "pair/turn"
            ]
            page.get_by_role("button", name="start page").click()
            page.wait_for_selector(".tiles", timeout=60_000)
            page.close()
        finally:
            command.send_signal(2)
            assert command.wait(30) == 0
    recent = json.loads((tmp_path / "sero-mj" / "recent.json").read_text())
    assert recent == [{"scene": "scara", "replay": ""}]  # not what was dropped, which is gone
