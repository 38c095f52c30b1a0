"""Recordings and tables that are sent to real sockets and shared memory."""

from __future__ import annotations

import itertools
import re
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from polling import until
from recordings import begin, record

from sero_mj.base.errors import RecordingError, UsageError
from sero_mj.cli import main
from sero_mj.data.receive.shm import ShmReader
from sero_mj.data.receive.structure import Structure
from sero_mj.data.send.playback import RecordedPackets, timed

LAYOUT = Structure("2F1V1M")  # as declared in `recordings`
PACKETS = [
    LAYOUT.encode({"values0": [k, -k], "vectors0": [[k, 0, 1]], "matrices0": np.eye(4)})
    for k in range(5)
]
SCENE = """
[robots.two]
dh_convention = "craig"
dh_params = [[0, 0.3, 0, 0], [0, 0.3, 0, 0]]

[sources.arm]
kind = "udp"
port = {port}
structure = "{structure}"

[routes]
"two.joint_angles" = "arm.values0"
"""


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "rec.mcap"
    record(path, PACKETS)
    return path


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


def send(*arguments: object) -> int | str | None:
    with pytest.raises(SystemExit) as caught:
        main(["send", *map(str, arguments)])
    return caught.value.code


def scene_file(tmp_path: Path, sock: socket.socket, structure: str = "2F1V1M") -> Path:
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.format(port=sock.getsockname()[1], structure=structure))
    return path


# ---- recordings


def test_recording_is_sent_bit_for_bit_with_its_timing(recording: Path) -> None:
    found = RecordedPackets(recording, structure=LAYOUT)
    assert found.is_raw and (found.count, found.skipped) == (5, 0)
    times, packets = zip(*found.packets(), strict=True)
    assert list(packets) == PACKETS
    assert times == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4], abs=1e-6)
    assert found.duration == pytest.approx(0.4, abs=1e-6)


def test_events_keep_their_names_in_another_structure(recording: Path) -> None:
    other = Structure(">1H=7 values0:2f extra:1d".replace("values0:", ""))
    found = RecordedPackets(recording, structure=other)
    assert not found.is_raw
    assert found.about == f"{recording}, source arm, events values0"
    assert [packet for _, packet in found.packets()] == [
        struct.pack(">H2fd", 7, k, -k, 0.0) for k in range(5)
    ]


def test_recording_with_another_matrix_order_is_repacked(recording: Path) -> None:
    by_rows = Structure(LAYOUT.text, column_major=False)
    found = RecordedPackets(recording, structure=by_rows)
    assert not found.is_raw
    for (_, sent), packet in zip(found.packets(), PACKETS, strict=True):
        decoded, before = by_rows.decode(sent), LAYOUT.decode(packet)
        for event, values in before.items():
            assert decoded[event].tolist() == values.tolist()


def test_packets_that_cannot_be_decoded_or_packed_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "rec.mcap"
    huge = LAYOUT.encode({"values0": [1e300, 0], "matrices0": np.eye(4)})
    record(path, [PACKETS[1], b"short", PACKETS[2], huge])
    again = RecordedPackets(path, structure=Structure("2f"))
    assert len(list(again.packets())) == 2  # 1e300 is out of the range of float32
    raw = RecordedPackets(path, structure=LAYOUT)
    assert [len(packet) for _, packet in raw.packets()] == [168, 5, 168, 168]
    whole = RecordedPackets(path, structure=LAYOUT, only_whole=True)
    assert [len(packet) for _, packet in whole.packets()] == [168, 168, 168]
    assert (again.skipped, raw.skipped, whole.skipped) == (2, 0, 1)


@pytest.mark.parametrize(
    ("structure", "message"),
    [
        (
            "joints:2F",
            "'arm' in {file} has the events values0, vectors0, matrices0, but 'joints:2F' has "
            "joints",
        ),
        ("3F", "values0 of 'arm' in {file} is 2; '3F' expects 3"),
    ],
)
def test_incompatible_structure_is_rejected(recording: Path, structure: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        RecordedPackets(recording, structure=Structure(structure))
    assert str(caught.value) == message.format(file=recording)


def test_recorded_source_must_be_unambiguous(tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    begin(path, "arm", "hand").close()
    with raises_with(
        UsageError,
        reason=f"{tmp_path}/two.mcap has several sources: arm, hand; "
        "choose one with --recorded arm",
    ):
        RecordedPackets(path)
    with raises_with(
        UsageError, reason="no source", found="amr", of=f"in {tmp_path}/two.mcap", near="arm"
    ):
        RecordedPackets(path, "amr")
    with raises_with(RecordingError, path=f"{tmp_path}/two.mcap", reason="has no packets of 'arm'"):
        RecordedPackets(path, "arm")


def test_missing_events_are_reported(recording: Path) -> None:
    again = RecordedPackets(recording, structure=Structure("2F1M1F"))
    assert again.notes == ["missing events: values1 (sent as zeros)"]


# ---- times


def test_speed_loop_and_duration_are_applied(recording: Path) -> None:
    found = RecordedPackets(recording, structure=LAYOUT)
    twice = [due for due, _ in timed(found, speed=2.0)]
    assert twice == pytest.approx([0.0, 0.05, 0.1, 0.15, 0.2], abs=1e-6)
    assert len(list(timed(found, duration=0.15))) == 2
    looped = list(itertools.islice(timed(found, loop=True), 12))
    assert [due for due, _ in looped] == pytest.approx(np.arange(12) * 0.1, abs=1e-6)
    assert [packet for _, packet in looped] == [PACKETS[k % 5] for k in range(12)]
    assert len(list(timed(found, loop=True, duration=1.05))) == 11


# ---- the command


def test_send_sends_a_recording(
    recording: Path, tmp_path: Path, listener: socket.socket, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = scene_file(tmp_path, listener)
    assert send(scene, "--play", recording, "--speed", 20, "--loop", "--duration", 0.03) == 0
    assert [listener.recv(1000) for _ in range(6)] == [*PACKETS, PACKETS[0]]
    out = capsys.readouterr().out
    assert f"sending {recording}, source arm, bit for bit: 5 packets, 0.40 s, to UDP" in out
    assert re.search(r"^sent 6 packets in 0\.\d+ s .* delay \d+ us \(median\)", out, re.MULTILINE)


@pytest.mark.extensions
def test_send_sends_an_exported_table(
    recording: Path, tmp_path: Path, listener: socket.socket
) -> None:
    table = tmp_path / "rec.csv"
    with pytest.raises(SystemExit):
        main(["export", str(recording), str(table)])
    scene = scene_file(tmp_path, listener)
    assert send(scene, "--play", table, "--speed", 20) == 0
    assert [listener.recv(1000) for _ in range(5)] == PACKETS


def test_send_writes_a_recording_to_shared_memory(tmp_path: Path, listener) -> None:
    recording = tmp_path / "rec.mcap"
    record(recording, [PACKETS[1], b"short", PACKETS[3]])
    got: list[list[float]] = []
    with ShmReader(
        block="sero_test_play", structure=LAYOUT.text, only_latest_packet=False
    ) as reader:
        scene = scene_file(tmp_path, listener)
        assert send(scene, "--play", recording, "--shm", "sero_test_play") == 0

        def came() -> bool:
            packets = reader.take()
            got.extend([] if packets is None else packets.values["values0"].tolist())
            return len(got) == 2

        assert until(came)
        assert reader.counters.malformed == 0
    assert got == [[1, -1], [3, -3]]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--speed", "2"], "--speed needs --play FILE"),
        (["--loop"], "--loop needs --play FILE"),
        (["--play", "REC", "--rate", "5"], "--rate cannot be combined with a recording"),
        (["--play", "REC", "--amplitude", "0"], "--amplitude cannot be combined with --play"),
        (["--play", "none.csv"], "none.csv"),
        (["--play", "none.mcap"], "none.mcap"),
        (["--play", "REC", "--recorded", "amr"], "no source 'amr' in"),
        (["--play", "REC", "--source", "amr"], "the scene has no source 'amr'; did you mean 'arm'"),
        (["--play", "t.csv", "--recorded", "arm"], "--recorded needs a recording; t.csv is a"),
    ],
)
def test_incompatible_options_are_rejected(
    recording: Path,
    tmp_path: Path,
    listener: socket.socket,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    message: str,
) -> None:
    scene = scene_file(tmp_path, listener)
    arguments = [str(recording) if option == "REC" else option for option in options]
    assert send(scene, *arguments) == 2
    assert message in capsys.readouterr().err


def test_send_sends_a_scenario_as_simulated(
    tmp_path: Path, listener: socket.socket, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "lwr.toml"
    scene.write_text(
        '[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\nstructure = "7F7F"\n'
        f'port = {listener.getsockname()[1]}\n[routes]\n"lwr.joint_angles" = "udp.values0"\n'
        '"lwr.torques" = "udp.values1"\n'
    )
    assert send(scene, "--play", "impedance_push", "--duration", 0.05) == 2
    refused = capsys.readouterr().err
    assert (
        "disturbances.push.begin: found 1 s; expected a time before the end of the run at 0.05 s"
        in refused
    )
    mine = tmp_path / "mine.toml"
    mine.write_text('[robots.lwr]\nmodel = "lwr"\n[run]\nduration = 0.05\n')
    assert send(scene, "--play", mine) == 0
    packets = [struct.unpack("<14d", listener.recv(1000)) for _ in range(51)]
    assert np.abs(packets).max() < 1e-6  # upright, where gravity torques are zero
    assert "sent 51 packets in 0.0" in capsys.readouterr().out
    assert send(scene, "--play", mine, "--rate", 5) == 2
    assert "--rate cannot be combined with a scenario" in capsys.readouterr().err
