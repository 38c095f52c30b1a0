"""The start page: its list, recent views, ports that receive data, and opened files."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path, PurePosixPath
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image
from recordings import DECLARED, EVENTS, moving
from websockets.exceptions import ConnectionClosed

from sero_mj.base import paths
from sero_mj.base.errors import SeroError, UsageError
from sero_mj.cli.opening import is_temporary, view_of_file
from sero_mj.data.record.recording_writer import RecordingWriter
from sero_mj.load import load_scene
from sero_mj.viewer.host.start_page import ExpectedPackets, PortMonitor, sections
from sero_mj.viewer.session import recent_views as recent
from sero_mj.viewer.session.recent_views import MAX_VIEWS, RecentView, recent_views, remember_view
from sero_mj.viewer.web import uploads

ARM = """
[robots.two]
dh_convention = "craig"
dh_params = [[0, 0.3, 0, 0], [0, 0.3, 0, 0]]

[sources.arm]
kind = "udp"
port = {port}
structure = "2F"

[routes]
"two.joint_angles" = "arm.values0"
"""


@pytest.fixture(autouse=True)
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state" / "sero-mj"


def titles(section: str) -> list[str]:
    return [tile.title for each in sections() if each.title == section for tile in each.tiles]


def test_every_shipped_item_is_listed_once_with_its_image() -> None:
    found = sections()
    assert [section.title for section in found] == [
        "Simulations", "Live robots", "Robots", "Parts of robots",
    ]  # fmt: skip
    names = [tile.title for section in found for tile in section.tiles]
    assert sorted(names) == sorted(paths.list_all())
    assert len({tile.view for section in found for tile in section.tiles}) == len(names)
    for section in found:
        for tile in section.tiles:
            assert tile.about, tile.title
            assert tile.image is not None, f"{tile.title}: run make gallery"
            with Image.open(tile.image) as image:
                assert image.size == recent.IMAGE_SIZE
                assert np.asarray(image.convert("L")).std() > 10, tile.title  # not blank
    shown = {f"{name}.jpg" for name in names}
    assert {file.name for file in (paths.scenes_dir() / "pictures").iterdir()} == shown


def test_tile_opens_the_item_it_names() -> None:
    (tile,) = [
        tile for each in sections() if each.title == "Robots" for tile in each.tiles
        if tile.title == "biped"
    ]  # fmt: skip
    assert not load_scene(tile.view.scene).sources
    assert load_scene("biped").sources  # the live one


def test_recent_views_come_first_with_their_last_state(tmp_path: Path, state: Path) -> None:
    scene = tmp_path / "mine.toml"
    scene.write_text(ARM.format(port=0))
    grey = np.full((800, 1280, 3), 77, np.uint8)
    remember_view(RecentView(str(scene)), grey)
    remember_view(RecentView("lwr_udp"), None)  # without its own image, it has the shipped one
    remember_view(RecentView(str(scene)), grey)
    first = sections()[0]
    assert first.title == "Recent views"
    assert [tile.title for tile in first.tiles] == ["mine.toml", "lwr_udp"]
    mine, lwr = first.tiles
    assert mine.image is not None
    assert lwr.image == paths.scenes_dir() / "pictures" / "lwr_udp.jpg"
    with Image.open(mine.image) as image:
        assert image.size == recent.IMAGE_SIZE
        assert abs(int(np.asarray(image).mean()) - 77) < 2
    scene.unlink()
    assert titles("Recent views") == ["lwr_udp"]


def test_only_the_latest_views_are_stored_and_damaged_ones_ignored(state: Path) -> None:
    names = paths.list_all()[: MAX_VIEWS + 3]
    for name in names:
        remember_view(RecentView(name), np.zeros((30, 40, 3), np.uint8))
    assert [view.scene for view in recent_views()] == names[:2:-1]
    assert len(list((state / "recent").glob("*.jpg"))) == MAX_VIEWS
    for text in ("", "{", "[1]", '[{"scene": 3}]', '[{"scene": "a\\u0000", "replay": ""}]'):
        (state / "recent.json").write_text(text)
        assert recent_views() == []
    remember_view(RecentView("lwr"), None)
    assert recent_views() == [RecentView("lwr")]


@contextmanager
def hearing(tmp_path: Path, *sizes: int) -> Iterator[tuple[PortMonitor, socket.socket, int]]:
    """Yields a monitor for scenes with packets of these sizes at one port, and its sender."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    views = []
    for size in sizes:
        file = tmp_path / f"cell{size}.toml"
        file.write_text(ARM.format(port=port).replace("2F", f"{size // 8}F"))
        views.append(RecentView(str(file)))
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.connect(("127.0.0.1", port))
        yield PortMonitor(views), sender, port


def until(listening: PortMonitor, text: str) -> ExpectedPackets:
    """Returns the expected item once its text contains `text`."""
    end = time.monotonic() + 10.0
    while time.monotonic() < end:
        (found,) = listening.expected()
        if text in found.text:
            return found
        threading.Event().wait(0.01)
    raise AssertionError(found.text)


def test_incoming_data_is_shown(tmp_path: Path) -> None:
    with hearing(tmp_path, 16, 24) as (listening, sender, port), listening:
        (nothing,) = listening.expected()
        assert nothing.text == f"UDP 127.0.0.1:{port}: no packets yet"
        assert nothing.packets == "16 bytes (cell16.toml) or 24 (cell24.toml)"
        assert nothing.command == f"sero-mj send {tmp_path / 'cell16.toml'}"
        assert (nothing.mood, nothing.shown) == ("plain", [])
        for _ in range(5):
            sender.send(bytes(24))
        found = until(listening, "5/s of 24 bytes")
        assert (found.mood, found.command) == ("good", "")
        assert [Path(view.scene).name for view in found.shown] == ["cell24.toml"]
        sender.send(bytes(10))
        found = until(listening, "1/s of 10 bytes (unexpected size)")
        assert found.mood == "bad"


def test_port_in_use_is_reported(tmp_path: Path) -> None:
    with hearing(tmp_path, 16) as (listening, _, port):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            other.bind(("127.0.0.1", port))
            with listening:
                (found,) = listening.expected()
        assert found.text.startswith(f"UDP port {port} on 127.0.0.1 is in use by another program")
        assert (found.mood, found.command) == ("bad", "")


def test_invalid_scenes_are_not_monitored(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    for text in ("[", "sources = 3", "[sources]\na = 1", '[sources.a]\nkind = "udp"\nport = -1\n'):
        wrong.write_text(text)
        with PortMonitor([RecentView(str(wrong)), RecentView("none.toml")]) as listening:
            assert listening.expected() == []


def record(path: Path, scene: str, files: Mapping[str, bytes]) -> None:
    """Writes a recording of `moving` packets of a source `arm`."""
    with RecordingWriter(path, about={"scene": scene}) as writer:
        writer.add_source("arm", kind="udp", declared=DECLARED, events=EVENTS, size=168)
        for name, contents in files.items():
            writer.attach(name, "application/toml", contents)
        for k, packet in enumerate(moving(3)):
            writer.write_raw("arm", packet, writer.clock.monotonic_ns / 1e9 + k)


def test_recording_is_shown_by_the_scene_of_its_sources(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    record(recording, "mine", {})
    with pytest.raises(UsageError) as told:
        view_of_file(recording, None)
    assert str(told.value) == (
        "found no scene that has the sources of run.mcap. "
        "Choose one: sero-mj view SCENE --replay run.mcap"
    )
    scene = tmp_path / "mine.toml"
    scene.write_text(ARM.format(port=0))
    found = RecentView(str(scene), str(recording))
    assert view_of_file(recording, None) == found  # beside it
    assert view_of_file(recording, "lwr_udp") == found  # which has other sources
    assert view_of_file(recording, str(scene)) == found
    elsewhere = tmp_path / "cell" / "mine.toml"
    elsewhere.parent.mkdir()
    scene.rename(elsewhere)
    remember_view(RecentView(str(elsewhere)), None)
    assert view_of_file(recording, None).scene == str(elsewhere)
    with pytest.raises(SeroError, match=r"expects udp"):
        elsewhere.unlink()
        view_of_file(recording, "lwr_udp")


def test_recording_contains_its_own_scene(tmp_path: Path) -> None:
    recording = tmp_path / "run.mcap"
    files = {"cell/mine.toml": ARM.format(port=0).encode()}
    record(recording, "mine", files)
    view = view_of_file(recording, None)
    assert Path(view.scene).read_bytes() == files["cell/mine.toml"]
    assert is_temporary(view)


def test_files_are_opened_by_kind(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nothing\.mcap: no such file"):
        view_of_file(tmp_path / "nothing.mcap", None)
    view = view_of_file(Path("robot.urdf"), None)
    assert view == RecentView(str(Path.cwd() / "robot.urdf"))
    assert not is_temporary(view)


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        (["scene.toml"], "scene.toml"),
        (["r/robot.urdf", "r/meshes/a.stl", "r/config/x.toml"], "r/robot.urdf"),
        (["panda/panda.urdf", "panda/hand.urdf"], "panda/panda.urdf"),
        (["lwr/robot.toml", "lwr/other.toml"], "lwr/robot.toml"),
        (["RUN.MCAP", "notes.txt"], "RUN.MCAP"),
    ],
)
def test_main_file_of_several_files_is_opened(names: list[str], chosen: str) -> None:
    assert uploads.main_file([PurePosixPath(name) for name in names]) == PurePosixPath(chosen)


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (
            ["a.txt", "b", "c", "d"],
            "found a.txt, b, c, ...; expected a file with the extension .toml",
        ),
        (["a.urdf", "b.urdf"], "found a.urdf and b.urdf; drop only one of them, or its folder"),
    ],
)
def test_files_that_cannot_be_opened_are_reported(names: list[str], text: str) -> None:
    with pytest.raises(UsageError) as told:
        uploads.main_file([PurePosixPath(name) for name in names])
    assert str(told.value).startswith(text)


@given(st.text(max_size=30), st.integers(-3, 10**12))
def test_no_path_leads_out_of_the_folder(name: str, size: int) -> None:
    message = json.dumps({"key": "k", "files": [{"path": name, "size": size}]})
    try:
        (found,) = uploads.read_list(message).sizes
    except UsageError:
        return
    assert Path("/folder", found).resolve().is_relative_to("/folder")
    assert 0 <= size <= uploads.MAX_BYTES


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ("nonsense", "the list of dropped files is invalid; expected their paths and sizes"),
        (b"\xff", "the list of dropped files is invalid"),
        ('[{"path": "a.toml", "size": 1e999}]', "the list of dropped files is invalid"),
        ('[{"path": "a.toml", "size": 1.5}]', "the list of dropped files is invalid"),
        ("[" * 100_000, "the list of dropped files is invalid"),
        ('{"files": []}', "the list of dropped files is invalid"),  # without a key
        ('[{"path": "a.toml", "size": 1, "more": 1}]', "the list of dropped files is invalid"),
        ('[{"path": "' + "a/" * 30 + 'a.toml", "size": 1}]', "found the path 'a/a/"),
        ("[]", "the drop contains no file; drop a robot"),
        (
            '[{"path": "../a", "size": 1}]',
            "found the path '../a'; expected a relative path without",
        ),
        ('[{"path": "/etc/a", "size": 1}]', "found the path '/etc/a'"),
        (r'[{"path": "C:\\a", "size": 1}]', "found the path 'C:"),
        ('[{"path": "a.toml", "size": 900000000}]', "found 900 MB; expected at most 500"),
        (
            json.dumps([{"path": f"{k}", "size": 0} for k in range(2001)]),
            "found 2001 files; expected at",
        ),
    ],
)
def test_lists_of_files_are_checked(message: str | bytes, text: str) -> None:
    if isinstance(message, str) and message.endswith("]"):
        message = f'{{"key": "k", "files": {message}}}'
    with pytest.raises(UsageError) as told:
        uploads.read_list(message)
    assert str(told.value).startswith(text)


class Uploading:
    """A connection over which a browser sends some messages and then leaves."""

    def __init__(self, said: list[str | bytes]) -> None:
        self.left, self.answers = said, list[dict[str, str]]()

    async def recv(self) -> str | bytes:
        if not self.left:
            raise ConnectionClosed(None, None)
        return self.left.pop(0)

    async def send(self, text: str) -> None:
        self.answers.append(json.loads(text))


# Few names, so that some are both files and folders.
PATHS = st.sampled_from(["a.toml", "a.toml/b", "b", "b/c.urdf", "b/../c", "/c", "", "d.mcap"])
PARTS = st.lists(st.one_of(st.binary(max_size=5), st.text(max_size=3)), max_size=4)


@given(
    st.lists(st.tuples(PATHS, st.binary(max_size=9)), max_size=4, unique_by=lambda each: each[0]),
    st.integers(-1, 1),
    PARTS,
    st.booleans(),
)
def test_uploads_are_stored_completely_or_not_at_all(
    tmp_path_factory: pytest.TempPathFactory,
    files: list[tuple[str, bytes]],
    longer: int,
    said: list[bytes | str],
    honest: bool,
) -> None:
    """An honest browser sends what it has listed; another one sends something else."""
    folder = tmp_path_factory.mktemp("uploaded")
    listed = [
        {"path": path, "size": len(content) + (0 if honest else longer)} for path, content in files
    ]
    if honest:  # empty files have no message
        said = [content for _, content in files if content]
    first = json.dumps({"key": "k", "files": listed})
    line, opened = Uploading([first, *said]), list[Path]()
    # On its own thread: Playwright keeps an event loop running on the test thread.
    with (
        patch.object(uploads, "make_temporary_folder", lambda: folder),
        patch.object(uploads, "drops", uploads.Drops()),
        ThreadPoolExecutor(1) as thread,
    ):
        taken = uploads.take_files(line, lambda key: None, opened.append)
        thread.submit(asyncio.run, taken).result()
    is_refused = any("error" in answer for answer in line.answers)
    assert len(opened) + is_refused <= 1
    if not opened:
        assert not any(folder.rglob("*")) or not folder.exists()
        return
    assert opened[0].is_file()
    assert opened[0].is_relative_to(folder)
    kept = {
        path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()
    }
    assert {name: path.stat().st_size for name, path in kept.items()} == {
        each["path"]: each["size"] for each in listed
    }
    if honest:
        assert all(kept[path].read_bytes() == content for path, content in files)
