"""A third-party kind of source is found, mirrored, recorded and replayed like ours."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from plugin_tools import write_package
from polling import until
from pydantic import PrivateAttr

from sero_mj import Mirror, Recording, Replay, Scene, SerialRobot, load_scene, record_sources
from sero_mj.base.errors import DeclarationError
from sero_mj.base.plugins import SOURCES, forget_plugins, plugins
from sero_mj.cli import main
from sero_mj.data.receive.source import Source
from sero_mj.viewer.session.clock import Clock

EXAMPLE = Path(__file__).parent / "plugins" / "json_lines.py"
ENTRY_POINTS = """\
[sero_mj.sources]
json_lines = json_lines_example:JsonLines
broken = json_lines_example.missing:JsonLines
udp = json_lines_example:JsonLines
"""
# Forwards its standard input to the first client.
SERVER = """
import socket, sys
listening = socket.create_server(("127.0.0.1", 0))
print(listening.getsockname()[1], flush=True)
connection, _ = listening.accept()
for line in sys.stdin.buffer:
    connection.sendall(line)
"""
SCENE = """
[robots.lwr]
model = "lwr"
[sources.arm]
kind = "{kind}"
port = {port}
structure = "count:1I angles:7F"
sequence = "count"
{more}
[routes]
"lwr.joint_angles" = "arm.angles"
"""


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Installs the example as a package on `sys.path`, as pip does."""
    site = tmp_path / "site"
    (site / "json_lines_example").mkdir(parents=True)
    (site / "json_lines_example" / "__init__.py").write_text("from ._source import JsonLines\n")
    (site / "json_lines_example" / "_source.py").write_text(EXAMPLE.read_text())
    info = site / "json_lines_example-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: json-lines-example\nVersion: 1.2\n"
    )
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(site)
    forget_plugins()
    yield
    forget_plugins()
    for name in [name for name in sys.modules if name.startswith("json_lines_example")]:
        del sys.modules[name]


class Server:
    """A robot in another process that sends lines of JSON."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        assert self._process.stdout is not None
        self.port = int(self._process.stdout.readline())

    def send(self, *lines: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write("".join(f"{line}\n" for line in lines).encode())
        self._process.stdin.flush()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.close()


def write_scene(folder: Path, port: int, kind: str = "json_lines", more: str = "") -> Path:
    path = folder / "arm.toml"
    path.write_text(SCENE.format(kind=kind, port=port, more=more))
    return path


def line(count: int, angle: float) -> str:
    return json.dumps({"count": [count], "angles": [angle] * 7})


@pytest.mark.usefixtures("installed")
def test_third_party_source_is_mirrored_recorded_and_replayed(
    tmp_path: Path, server: Server
) -> None:
    scene = load_scene(write_scene(tmp_path, server.port))
    recording = tmp_path / "arm.mcap"
    with Mirror(scene) as mirror:
        source = mirror.sources["arm"]
        assert isinstance(source, Source)
        assert source.about.startswith(f"JSON lines of 127.0.0.1:{server.port}")
        with record_sources(mirror.sources, recording, scene=scene):
            server.send(line(1, 0.25), line(2, 0.5))
            server.send("no JSON", '{"count": [3]}', '{"count": [3], "angles": [1, 2]}')
            server.send(line(4, float("nan")), line(5, 0.75))
            until(lambda: source.counters.received == 7)
        mirror.advance()
        np.testing.assert_array_equal(mirror.data.qpos, np.full(7, 0.75))
        counters = source.counters
        assert (counters.wrong_size, counters.not_finite, counters.lost) == (3, 1, 1)
    with Recording(recording) as kept:
        assert kept.sources["arm"].kind == "json_lines"
        assert [len(packet) for _, packet in kept.packets("arm")] == [60, 60, 7, 14, 32, 60, 60]
    server.close()
    scene.sources["arm"] = Replay(name="arm", file=recording)
    with Mirror(scene) as again:
        again.advance(1e3)
        np.testing.assert_array_equal(again.data.qpos, np.full(7, 0.75))
        assert again.sources["arm"].counters.malformed == 4


@pytest.mark.usefixtures("installed")
def test_every_packet_of_a_third_party_source_is_passed_on(tmp_path: Path, server: Server) -> None:
    scene = load_scene(write_scene(tmp_path, server.port, more="only_latest_packet = false"))
    with Mirror(scene) as mirror:
        source = mirror.sources["arm"]
        server.send(*(line(count, 0.01 * count) for count in range(1, 101)))
        until(lambda: source.receive_trigger == 100)
        packets = source.take()
        assert packets is not None
        np.testing.assert_array_equal(packets.values["count"].ravel(), np.arange(1, 101))
        assert (np.diff(packets.arrivals) >= 0.0).all()


@pytest.mark.usefixtures("installed")
def test_third_party_sources_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["list"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert "  json_lines         json_lines_example:JsonLines from json-lines-example\n" in out
    # Ours is listed, too.
    assert "  udp                sero_mj.data.receive.udp:UdpReceiver\n" in out


@pytest.mark.usefixtures("installed")
def test_source_that_cannot_be_loaded_names_its_package(tmp_path: Path) -> None:
    path = write_scene(tmp_path, 5, kind="broken")
    with pytest.raises(DeclarationError) as caught:
        load_scene(path)
    assert str(caught.value) == (
        f"{path}:5: sources.arm.kind: sero_mj.sources: 'broken' of json-lines-example 1.2 "
        "(json_lines_example.missing:JsonLines) cannot be loaded: ModuleNotFoundError: "
        "No module named 'json_lines_example.missing'"
    )


@pytest.mark.usefixtures("installed")
def test_fields_of_a_third_party_source_are_checked(tmp_path: Path, server: Server) -> None:
    with raises_with(key="sources.arm.prot", reason="unknown key", near="port"):
        load_scene(write_scene(tmp_path, server.port, more="prot = 3"))


@pytest.mark.usefixtures("installed")
def test_example_source_reconnects_and_shows_its_errors(tmp_path: Path) -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as listening,
        Mirror(load_scene(write_scene(tmp_path, listening.getsockname()[1]))) as mirror,
    ):
        source = mirror.sources["arm"]
        first, _ = listening.accept()
        with first:
            first.sendall(b'{"count": [1]}\n')
            assert until(lambda: source.counters.malformed == 1)
            assert source.counters.last_fault == "invalid line: KeyError('angles')"
        assert until(lambda: "closed the connection" in source.trouble)
        second, _ = listening.accept()
        with second:
            second.sendall(f"{line(2, 0.5)}\n".encode())
            assert until(lambda: source.receive_trigger == 1)
            assert source.trouble == ""


def test_numbers_of_arrivals_and_packets_must_match(installed: None, server: Server) -> None:
    source = plugins(SOURCES)["json_lines"].load()(port=server.port, structure="1F")
    source.open()
    source.accept([])
    with pytest.raises(ValueError, match="found 1 arrivals for 2 packets"):
        source.accept([bytes(8)] * 2, [0.0])
    source.accept([bytes(8), bytes(3), bytes(10**6)])
    assert (source.counters.received, source.counters.wrong_size) == (3, 2)
    source.close()


class Rows(Source):
    """Plays a row every 10 ms up to 2 s: a source without real time."""

    structure: str = "7F"
    _played: int = PrivateAttr(0)

    @property
    def is_live(self) -> bool:
        return False

    @property
    def end(self) -> float:
        return 2.0

    def now(self) -> float:
        return 0.01 * self._played

    def open(self) -> None:
        self.reset()
        self._played = 0

    def close(self) -> None:
        pass

    def advance_to(self, time: float) -> None:
        row = round(100 * min(time, 2.0))
        if row < self._played:
            self.open()
        rows = range(self._played + 1, row + 1)
        packets = [self.layout.encode({"values0": np.full(7, 0.01 * k)}) for k in rows]
        self.accept(packets, [0.01 * k for k in rows])
        self._played = row


def test_source_without_real_time_has_a_timeline() -> None:
    scene = Scene(
        robots=[SerialRobot.from_model("lwr")],
        sources={"table": Rows(name="table")},
        routes={"lwr.joint_angles": "table.values0"},
    )
    with Mirror(scene) as mirror:
        clock = Clock(mirror)
        assert (clock.is_live, clock.end) == (False, 2.0)
        for passed, angle in ((0.1, 0.1), (0.2, 0.3)):
            clock.advance(passed)
            np.testing.assert_allclose(mirror.data.qpos, angle)
        clock.seek(1.5)
        clock.advance(0.0)
        np.testing.assert_allclose(mirror.data.qpos, 1.5)
        clock.seek(0.5)  # back
        clock.advance(0.0)
        np.testing.assert_allclose(mirror.data.qpos, 0.5)
        clock.seek(9.0)
        assert clock.is_at_end


def write_source(folder: Path, monkeypatch: pytest.MonkeyPatch, methods: str) -> Path:
    """Writes a scene with a source from a package, whose class has these methods and a file."""
    code = (
        "from pathlib import Path\n"
        "from sero_mj.data.receive.source import Source\n"
        f"class Tail(Source):\n    path: Path\n{methods}"
    )
    write_package(folder, "tail_source", code, SOURCES, tail="Tail")
    monkeypatch.syspath_prepend(str(folder))
    forget_plugins()
    file = folder / "tail.toml"
    file.write_text(
        '[robots.lwr]\nmodel = "lwr"\n[sources.text]\nkind = "tail"\nstructure = "7F"\n'
        'path = "data/angles.txt"\n[routes]\n"lwr.joint_angles" = "text.values0"\n'
    )
    return file


@pytest.fixture
def forgotten() -> Iterator[None]:
    yield
    forget_plugins()
    sys.modules.pop("tail_source", None)


@pytest.mark.usefixtures("forgotten")
def test_files_of_a_source_are_relative_to_the_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = "    def open(self): ...\n    def close(self): ...\n"
    mirror = Mirror(load_scene(write_source(tmp_path, monkeypatch, methods)))
    assert mirror.sources["text"].path == tmp_path / "data/angles.txt"


@pytest.mark.usefixtures("forgotten")
def test_source_that_lacks_a_method_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = write_source(tmp_path, monkeypatch, "    def open(self): ...\n")
    with pytest.raises(DeclarationError) as error:
        load_scene(scene)
    (problem,) = error.value.problems
    assert problem.key == "sources.text.kind"
    assert "cannot be loaded: TypeError: Tail lacks close" in problem.message
