"""Begin and end of a replay: seeking, playing beyond the end, and error messages."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from recordings import SCENE, moving, record

from sero_mj import Mirror, Scene, SerialRobot
from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.data.record.replay import Replay
from sero_mj.load import load_scene
from sero_mj.robots.declared.inputs import SOURCE_FIELDS

PACKETS = moving(11)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """Eleven packets within one second."""
    path = tmp_path / "rec.mcap"
    record(path, PACKETS)
    return path


def scene_file(recording: Path, more: str = "") -> Path:
    path = recording.with_name("scene.toml")
    path.write_text(SCENE.format(file="rec.mcap", more=more))
    return path


def refused(*arguments: object) -> None:
    with pytest.raises(SystemExit) as caught:
        main([*map(str, arguments)])
    assert caught.value.code == 2


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("more", ["", "speed = 2\nloop = true"])
def test_status_plays_a_recording(
    recording: Path, more: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["status", str(scene_file(recording, more)), "--duration", "1.4", "--json"])
    (found,) = json.loads(capsys.readouterr().out)
    assert caught.value.code == 0
    assert found["good"] > 11 if more else found["good"] == 11
    assert found["rate"] == pytest.approx(10.0, rel=0.1)


@pytest.mark.parametrize(
    ("more", "reported"),
    [
        ("start = 50", "start: found 50; the recording ends at 1.00 s"),
        ("start = 0.5\nstop = 0.5", "stop: found 0.5; expected more than 0.5 s, start"),
        ("stop = -1", "stop: found -1; expected more than 0 s, the time of its first packet"),
    ],
)
def test_empty_time_ranges_are_reported(recording: Path, more: str, reported: str) -> None:
    file = scene_file(recording, more)
    with pytest.raises(DeclarationError) as caught:
        load_scene(file)
    (problem,) = caught.value.problems
    assert (
        re.sub(r"than \d\.?\d*e-\d+", "than 0", str(problem))
        == f"{file}:{problem.line}: sources.arm.{reported}"
    )
    assert problem.line == 8 + len(more.splitlines())


def test_empty_time_ranges_of_options_are_reported(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "live.toml"
    scene.write_text(
        SCENE.replace('"replay"\nfile = "{file}"', '"udp"\nstructure = "2F1V1M"').format(more="")
    )
    refused("render", scene, "-o", tmp_path / "x.png", "--replay", recording, "--start", 99)
    assert "sero-mj: --start: found 99; the recording ends at 1.00 s" in capsys.readouterr().err
    refused("export", recording, tmp_path / "x.csv", "--from", 0.5, "--to", 0.2)
    reported = "sero-mj: --to: found 0.2; expected more than --from"
    assert reported in capsys.readouterr().err
    refused("export", recording, tmp_path / "x.csv", "--from", 2)
    assert "--from: found 2; the recording ends" in capsys.readouterr().err
    assert not list(tmp_path.glob("x.*"))


def test_export_does_not_overwrite_an_existing_table(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "t.csv"
    table.write_text("mine")
    refused("export", recording, table)
    reported = f"sero-mj: {table} already exists; choose another name or add --overwrite\n"
    assert capsys.readouterr().err == reported
    assert table.read_text() == "mine"
    with pytest.raises(SystemExit) as caught:
        main(["export", str(recording), str(table), "--overwrite"])
    assert caught.value.code == 0
    assert len(table.read_text().splitlines()) == 12


def test_send_rejects_a_replay_source(recording: Path, capsys: pytest.CaptureFixture[str]) -> None:
    refused("send", scene_file(recording), "--duration", 0.1)
    reported = "source 'arm' of the scene is a recording, which cannot receive packets. Add --port"
    assert capsys.readouterr().err.startswith(f"sero-mj: {reported}")


def test_first_packet_is_received_once_for_any_start(recording: Path) -> None:
    whole = Replay(file=recording, start=0.0)
    for start in (0.0, 0.35, whole.recorded.last, whole.recorded.first):
        with Replay(file=recording, start=start) as replay:
            replay.advance_to(0.0)
            before = replay.counters.received
            replay.advance_to(5.0)
            assert before <= 1
            expected = 10 - int((start - whole.recorded.first + 1e-6) * 10) + 1
            assert replay.counters.received == expected, start


def test_replay_becomes_stale_after_its_end(recording: Path) -> None:
    arm = SerialRobot(name="two", dh_convention="craig", dh_params=[[0, 0.3, 0, 0]] * 2)
    replay = Replay(file=recording, name="udp")
    scene = Scene(robots=[arm], sources={"udp": replay}, routes={"two.joint_angles": "udp.values0"})
    with Mirror(scene) as mirror:
        age = mirror.world.slots["sources.udp"].start + SOURCE_FIELDS.index("age")
        for time, stale in ((0.5, 0.0), (1.0, 0.0), (1.3, 0.3), (4.0, 3.0), (0.2, 0.0)):
            mirror.advance(time)
            assert mirror.data.userdata[age] == pytest.approx(stale, abs=0.02)
            ended = "the recording has ended" if time > 1.1 else ""
            assert replay.trouble == ended or abs(time - 1.0) < 0.1
        assert mirror.data.qpos[0] == pytest.approx(0.2)
        mirror.advance(3.0)
        replay.seek(0.5, 3.0)
        mirror.advance(3.0)
        assert replay.receiving
