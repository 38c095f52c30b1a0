"""`Replay`: the same packets and decoder result in the same frames as in the live run."""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from polling import until

from sero_mj import HeadlessRenderer, Mirror, Scene, SerialRobot, UdpReceiver
from sero_mj.base.errors import DeclarationError, SourceError
from sero_mj.cli import main
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.replay import Replay
from sero_mj.load import load_scene
from sero_mj.robots.declared.inputs import SOURCE_FIELDS

STRUCTURE = "number:1H 7F1M 7f"
ROUTES = {
    "lwr.joint_angles": "udp.values0",
    "lwr.flange_check": "udp.matrices0",
    "lwr.torques": "udp.values1",
}


def packet(number: int, angle: float, torque: float = 1.0, corner: float = 1.0) -> bytes:
    matrix = np.diag([corner, 1.0, 1.0, 1.0]).ravel()
    return struct.pack("<H7d16d7f", number % 65536, *[angle] * 7, *matrix, *[torque] * 7)


def scene_of(lwr: SerialRobot, source: object) -> Scene:
    return Scene(robots=[lwr], sources={"udp": source}, routes=ROUTES)


@pytest.fixture(scope="module")
def recorded(
    tmp_path_factory: pytest.TempPathFactory,
) -> Iterator[tuple[Path, list[tuple[float, np.ndarray, np.ndarray]]]]:
    """A recording, and the time, state and image of each frame of the live run."""
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    robot = SerialRobot.from_model("lwr", show_arrows=True, show_billboards=True)
    source = UdpReceiver(structure=STRUCTURE, sequence="number", name="udp")
    shown = []
    # Valid packets, missing torques, wrong sizes, an invalid frame, a lost packet, an old packet,
    # and NaN in joint angles. The replay must have the same counts as the live run.
    bursts = [
        [packet(65_534, 0.1), packet(65_535, 0.2)],
        [packet(0, 0.3, torque=float("nan"))],
        [b"short", bytes(300), packet(1, 0.4), packet(2, 0.4, corner=1.5)],
        [packet(5, 0.5), packet(3, 0.9), packet(6, float("inf"))],
        [packet(7, 0.7, torque=-20.0)],
    ]
    with (
        Mirror(scene_of(robot, source)) as mirror,
        HeadlessRenderer(mirror.world, 320, 240) as renderer,
        socket.socket(type=socket.SOCK_DGRAM) as sock,
        record_sources(mirror.sources, path, scene=mirror.world.scene) as recorder,
    ):
        began = recorder.clock.monotonic_ns * 1e-9
        sent = 0
        for burst in bursts:
            for data in burst:
                sock.sendto(data, ("127.0.0.1", source.port))
            sent += len(burst)
            assert until(lambda sent=sent: source.counters.received == sent)
            at = time.monotonic() - began
            mirror.advance(at)
            shown.append((at, mirror.data.userdata.copy(), mirror.data.qpos.copy(),
                          renderer.render(mirror.data).copy()))  # fmt: skip
    yield path, shown


@pytest.mark.slow
def test_replay_shows_the_same_frames_as_the_live_run(recorded: tuple[Path, list[tuple]]) -> None:
    path, shown = recorded
    robot = SerialRobot.from_model("lwr", show_arrows=True, show_billboards=True)
    replay = Replay(file=path, source="udp", start=0.0)
    with (
        Mirror(scene_of(robot, replay)) as mirror,
        HeadlessRenderer(mirror.world, 320, 240) as renderer,
    ):
        assert not mirror.is_live
        slot = mirror.world.slots["sources.udp"]
        ages = ("age", "fault_age", "link_age")  # times that depend on the time of the call
        times = [slot.start + SOURCE_FIELDS.index(age) for age in ages]
        others = np.setdiff1d(np.arange(len(mirror.data.userdata)), times)
        for at, userdata, qpos, pixels in shown:
            mirror.advance(at)
            assert mirror.data.qpos.tolist() == qpos.tolist()
            np.testing.assert_array_equal(mirror.data.userdata[others], userdata[others])
            np.testing.assert_allclose(mirror.data.userdata[times], userdata[times], atol=0.05)
            assert np.array_equal(renderer.render(mirror.data), pixels)
        counters = replay.counters
        assert (counters.lost, counters.late, counters.blanked) == (1, 1, 1)
        assert (counters.wrong_size, counters.not_finite, counters.not_frames) == (2, 1, 1)


def test_seeking_and_looping_reproduce_recorded_poses(
    recorded: tuple[Path, list[tuple]], lwr: SerialRobot
) -> None:
    path, shown = recorded
    for order in ([4, 0, 2, 1, 3], [2, 2, 4, 1]):
        with Mirror(scene_of(lwr, Replay(file=path, start=0.0))) as mirror:
            for k in order:
                mirror.advance(shown[k][0])
                assert mirror.data.qpos.tolist() == shown[k][2].tolist(), k
    # In a loop, a time beyond the end is in the next repetition.
    replay = Replay(file=path, start=0.0, loop=True)
    with Mirror(scene_of(lwr, replay)) as mirror:
        for round_ in (0, 1, 7):
            for k in (0, 3):
                mirror.advance(shown[k][0] + round_ * replay.duration)
                assert mirror.data.qpos.tolist() == shown[k][2].tolist(), (round_, k)


def test_speed_seek_pause_and_resume(recorded: tuple[Path, list[tuple]], lwr: SerialRobot) -> None:
    path, shown = recorded
    replay = Replay(file=path, start=0.0, speed=4.0)
    with Mirror(scene_of(lwr, replay)) as mirror:
        mirror.advance(shown[2][0] / 4)
        assert mirror.data.qpos.tolist() == shown[2][2].tolist()
        assert replay.position == pytest.approx(shown[2][0])
        replay.pause(1.0)
        replay.seek(shown[1][0], 1.0)
        mirror.advance(50.0)
        assert mirror.data.qpos.tolist() == shown[1][2].tolist()
        replay.resume(50.0)
        mirror.advance(50.0 + (shown[3][0] - shown[1][0]) / 4)
        assert mirror.data.qpos.tolist() == shown[3][2].tolist()
        mirror.advance(50.0 + (replay.duration - shown[1][0]) / 4)  # it stops at the end
        assert replay.position == pytest.approx(replay.duration)
        assert replay.receiving


@pytest.mark.slow
def test_lossless_replay_returns_all_packets(
    recorded: tuple[Path, list[tuple]], lwr: SerialRobot
) -> None:
    path, _ = recorded
    heard: list[float] = []
    replay = Replay(file=path, start=0.0, only_latest_packet=False)
    with Mirror(scene_of(lwr, replay)) as mirror:
        mirror.listen(lambda _, packets: heard.extend(packets.values["values0"][:, 0]))
        mirror.advance(1000.0)
    assert heard == [0.1, 0.2, 0.3, 0.4, 0.5, 0.9, 0.7]


def test_replay_starts_with_the_first_packet_of_a_file_next_to_the_scene(
    recorded: tuple[Path, list[tuple]], tmp_path: Path
) -> None:
    (tmp_path / "run.mcap").write_bytes(recorded[0].read_bytes())
    (tmp_path / "scene.toml").write_text(
        '[robots.lwr]\nmodel = "lwr"\n\n[sources.again]\nkind = "replay"\nfile = "run.mcap"\n\n'
        '[routes]\n"lwr.joint_angles" = "again.values0"\n'
    )
    with Mirror(load_scene(tmp_path / "scene.toml")) as mirror:
        assert mirror.wait(0.0) == []
        mirror.advance(0.0)
        assert mirror.data.qpos[0] == 0.1


def test_decoding_fields_reproduce_the_layout() -> None:
    source = UdpReceiver(
        structure="1F x:1Tf", is_double=False, column_major=False, scale=0.5, alignment=8,
        udpport=7, host="0.0.0.0",
    )  # fmt: skip
    assert source.decoding_fields() == {
        "is_double": False, "column_major": False, "alignment": 8, "scale": 0.5,
        "structure": "1F x:1Tf",
    }  # fmt: skip
    again = UdpReceiver(**source.decoding_fields())
    assert again.layout.dtype == source.layout.dtype


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"file": "none.mcap"}, "file: none.mcap cannot be read: No such file or directory"),
        ({"file": 7}, "file: found 7; expected the name of a recording, such as REC.mcap"),
        ({"source": "upd"}, "source: no source 'upd' in {file}; did you mean 'udp'?"),
        ({"structure": "7F"}, "structure is declared in the recording. Remove it"),
        ({"speed": 0.0}, "speed: found 0;"),
    ],
)
def test_invalid_declarations_are_reported(
    recorded: tuple[Path, list[tuple]], fields: dict[str, object], message: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        Replay(**{"file": recorded[0], **fields})
    assert str(caught.value).startswith(message.format(file=recorded[0]))


def test_missing_file_is_reported_by_open(
    recorded: tuple[Path, list[tuple]], tmp_path: Path
) -> None:
    copy = tmp_path / "run.mcap"
    copy.write_bytes(recorded[0].read_bytes())
    replay = Replay(file=copy)
    copy.unlink()
    with raises_with(
        SourceError,
        source="replay",
        reason=f"{tmp_path}/run.mcap cannot be read: No such file or directory",
    ):
        replay.open()


@pytest.mark.slow
def test_commands_record_render_and_export(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        port = sock.getsockname()[1]
    scene = tmp_path / "scene.toml"
    scene.write_text(
        f'[robots.lwr]\nmodel = "lwr"\n\n[sources.udp]\nkind = "udp"\nport = {port}\n'
        'structure = "7F7F"\n\n[routes]\n"lwr.joint_angles" = "udp.values0"\n'
        '"lwr.torques" = "udp.values1"\n'
    )
    run, table = tmp_path / "run.mcap", tmp_path / "run.csv"
    command = [sys.executable, "-m", "sero_mj", "send", str(scene), "--rate", "500"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as robot:
        try:
            count = 0
            while count < 50:  # until the sender has started
                with pytest.raises(SystemExit) as caught:
                    main(["record", str(scene), str(run), "--duration", "0.5", "--overwrite"])
                with Recording(run) as recording:
                    count = recording.sources["udp"].count
        finally:
            robot.terminate()
    with Recording(run) as recording:
        assert any(name.endswith("scene.toml") for name in recording.attachments)
        assert any(name.endswith("lwr/robot.toml") for name in recording.attachments)
        assert recording.about["scene"] == "scene"
    capsys.readouterr()
    with pytest.raises(SystemExit) as caught:
        main(["export", str(run), str(table)])
    assert caught.value.code == 0
    assert f"run.csv: {count} rows" in capsys.readouterr().out
    assert len(table.read_text().splitlines()) == count + 1
    film = tmp_path / "run.mp4"
    with pytest.raises(SystemExit) as caught:
        main(["render", str(scene), "--replay", str(run), "-o", str(film), "--duration", "0.3",
              "--size", "160x120", "--quiet"])  # fmt: skip
    assert caught.value.code == 0
    assert film.stat().st_size > 1000
    with pytest.raises(SystemExit) as caught:
        main(["record", str(scene), str(run), "--duration", "1"])
    assert caught.value.code == 2
    assert "run.mcap already exists. Choose another name, or remove it" in capsys.readouterr().err
    with pytest.raises(SystemExit) as caught:
        main(["render", "lwr", "--replay", str(run), "-o", str(film)])
    assert caught.value.code == 2
    assert "has udp; scene 'lwr' expects no source" in capsys.readouterr().err
