"""Playing damaged recordings: missing data is reported, and no data at all is an error."""

from __future__ import annotations

import logging
import re
import socket
from collections.abc import Callable
from pathlib import Path

import pytest
from recordings import SCENE, moving, record

from sero_mj import Mirror
from sero_mj.base.errors import SourceError
from sero_mj.cli import main
from sero_mj.data.record.recording import Recording
from sero_mj.load import load_scene

PACKETS = moving(40)
DAMAGED = r"the chunk at byte \d+ is damaged \(.+\): packets from \S+ s to \S+ s are missing"
CUT = r"is truncated or damaged at byte \d+ \(.+\): \d+ bytes are ignored"


@pytest.fixture
def damaged(tmp_path: Path) -> Callable[[str], Path]:
    """Writes a recording of 4 s in chunks, with some or all damaged, or a truncated end."""

    def make(how: str) -> Path:
        path = tmp_path / f"{how}.mcap"
        record(path, PACKETS, chunk_bytes=1500)
        data = bytearray(path.read_bytes())
        with Recording(path) as recording:
            chunks = [chunk.offset for chunk in recording._chunks]
        assert len(chunks) >= 4
        if how == "cut":
            del data[chunks[-1] + 100 :]
        for chunk in {"some": chunks[1:3], "all": chunks}.get(how, []):
            for at in range(chunk + 70, chunk + 90):
                data[at] ^= 0x5A
        if how == "index":
            data[-40:-30] = bytes(10)
        path.write_bytes(data)
        return path

    return make


def run(*arguments: object) -> int | str | None:
    with pytest.raises(SystemExit) as caught:
        main([*map(str, arguments)])
    return caught.value.code


def scene_of(path: Path) -> Path:
    scene = path.with_suffix(".toml")
    scene.write_text(SCENE.format(file=path.name, more=""))
    return scene


@pytest.mark.parametrize(("how", "fault"), [("some", DAMAGED), ("cut", CUT)])
def test_replay_source_reports_damage_once(
    damaged: Callable[[str], Path], how: str, fault: str, caplog: pytest.LogCaptureFixture
) -> None:
    path = damaged(how)
    with (
        caplog.at_level(logging.WARNING),
        Mirror(load_scene(scene_of(path))) as mirror,
    ):
        for time in (0.0, 1.0, 2.0, 5.0, 0.5, 5.0):
            mirror.advance(time)
    lines = [record.getMessage() for record in caplog.records]
    assert len(lines) == (2 if how == "some" else 1)
    for line in lines:
        assert re.fullmatch(f"{re.escape(str(path))}: {fault}", line), line


@pytest.mark.parametrize(("how", "fault"), [("some", DAMAGED), ("cut", CUT)])
def test_send_reports_damage(
    damaged: Callable[[str], Path], how: str, fault: str, capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
) -> None:  # fmt: skip
    path = damaged(how)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        scene = tmp_path / "live.toml"
        scene.write_text(
            SCENE.format(file="", more="").replace(
                'kind = "replay"\nfile = ""',
                f'kind = "udp"\nport = {sock.getsockname()[1]}\nstructure = "2F1V1M"',
            )
        )
        assert run("send", scene, "--play", path, "--speed", 50) == 0
        notes = [line for line in capsys.readouterr().out.splitlines() if line.startswith("note:")]
        assert len(notes) == (2 if how == "some" else 1)
        for note in notes:
            assert re.fullmatch(f"note: {re.escape(str(path))}: {fault}", note), note
        path = damaged("all")
        assert run("send", scene, "--play", path) == 2
    output = capsys.readouterr().err
    assert f"sero-mj: {path}: none of the 40 packets of 'arm' can be read: the chunk at" in output


def test_replay_source_without_readable_packets_cannot_be_opened(
    damaged: Callable[[str], Path],
) -> None:
    path = damaged("all")
    mirror = Mirror(load_scene(scene_of(path)))
    message = f"source 'arm': {path}: none of the 40 packets of 'arm' can be read: the chunk at"
    with pytest.raises(SourceError, match=re.escape(message)):
        mirror.open()


def test_export_csv_names_a_damaged_file_and_fails_without_data(
    damaged: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = damaged("some")
    assert run("export", path, tmp_path / "some.csv") == 0
    assert capsys.readouterr().out.startswith(f"note: {path}: the chunk at byte")
    assert run("export", damaged("all"), tmp_path / "all.csv") == 1
    assert capsys.readouterr().out.endswith("all.csv: 0 rows\n")


def test_damage_report_has_a_reason(damaged: Callable[[str], Path]) -> None:
    with Recording(damaged("index")) as recording:
        (fault,) = recording.faults
    assert "()" not in fault and "index" in fault
