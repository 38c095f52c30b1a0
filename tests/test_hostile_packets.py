"""Malformed packets are counted by cause, never applied in part, and never crash.

`SERO_MJ_PACKETS=1000000 pytest tests/test_hostile_packets.py` tests with a million packets.
"""

from __future__ import annotations

import os
import socket
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from conftest import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from packet_oracle import FORMAT, LENGTHS, TEXT, bad_packet, cause, good_packet, values_of
from polling import until

from sero_mj.base.errors import StructureError
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.receive.intake import Intake
from sero_mj.data.receive.language import parse
from sero_mj.data.receive.structure import Structure
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene

COUNT = int(os.environ.get("SERO_MJ_PACKETS", examples(20_000)))
CAUSES = ("wrong_size", "wrong_constant", "not_finite", "not_frames")
KEPT = 400  # bytes of a packet in a row


def as_rows(packets: list[bytes]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    text = b"".join(packet[:KEPT].ljust(KEPT, b"\xff") for packet in packets)
    lengths = np.array([len(packet) for packet in packets])
    return np.frombuffer(text, np.uint8).reshape(-1, KEPT), lengths, np.arange(len(packets)) * 1e-3


def check(intake: Intake, packets: list[bytes], expected: Counter[str]) -> None:
    """Checks a batch against the slow reference for each packet."""
    reasons = [cause(packet) for packet in packets]
    good = [packet for packet, why in zip(packets, reasons, strict=True) if not why]
    expected.update(why for why in reasons if why)
    expected["received"] += len(packets)
    rows, _ = intake.take(*as_rows(packets))
    intake.count()
    assert [row.tobytes() for row in rows] == good
    if good:
        decoded = intake.decode(rows)
        last = {event: array[-1].ravel().tolist() for event, array in decoded.items()}
        assert last == values_of(good[-1])
    counters = intake.counters
    assert {name: getattr(counters, name) for name in CAUSES} == {
        name: expected[name] for name in CAUSES
    }
    assert (counters.received, counters.malformed) == (
        expected["received"],
        sum(expected[name] for name in CAUSES),
    )


def test_malformed_packets_are_counted_by_cause_and_valid_ones_applied_whole() -> None:
    random, expected = np.random.default_rng(5), Counter[str]()
    intake = Intake(Structure(TEXT))
    assert intake.layout.size == FORMAT.size
    done = 0
    while done < COUNT:
        batch = [
            bad_packet(random, done + k) if random.random() < 0.8 else good_packet(random, done + k)
            for k in range(int(random.integers(1, 256)))
        ]
        check(intake, batch, expected)
        done += len(batch)
    assert all(expected[name] > COUNT / 100 for name in CAUSES)
    assert expected["received"] - sum(expected[name] for name in CAUSES) > COUNT / 5


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(st.binary(max_size=KEPT) | st.binary(min_size=216, max_size=216), max_size=8))
def test_any_bytes_are_classified_like_the_slow_reference(packets: list[bytes]) -> None:
    if packets:
        check(Intake(Structure(TEXT)), packets, Counter())


@settings(max_examples=examples(500), deadline=None)
@given(st.text(alphabet="0123456789FVMTxfdhHiIqQ?<>!=:., sizeabc_-+e\n", max_size=40) | st.text())
def test_any_text_is_a_structure_or_an_error_with_a_position(text: str) -> None:
    try:
        items = parse(text)
    except StructureError as error:
        assert 0 <= error.position <= len(text)
        assert f"character {error.position + 1}" in str(error)
    else:
        assert 0 < items[-1].end <= 65_507
        size = Structure(text).size
        zeros = np.zeros((2, size), np.uint8)
        decoded = Structure(text).decode_rows(zeros)
        assert all(array.shape[0] == 2 for array in decoded.values())


def without_blanks(packet: bytes) -> bytes:
    """Returns the packet with finite values where NaN means "no data".

    These are the frame, which a flange check shows, and the vector, which is not routed.
    """
    if len(packet) != FORMAT.size:
        return packet
    if not np.isfinite(np.frombuffer(packet[64:76], np.float32)).all():
        packet = packet[:64] + bytes(12) + packet[76:]
    if np.isfinite(np.frombuffer(packet[76:204])).all():
        return packet
    return packet[:76] + np.eye(4).tobytes() + packet[204:]


def test_socket_handles_every_length_ten_senders_and_noise() -> None:
    random = np.random.default_rng(8)
    robot = SerialRobot(name="arm", dh_convention="craig", dh_params=[[0.0, 0.1, 0, 0.1]] * 7)
    source = UdpReceiver(name="udp", udpport=0, structure=TEXT)
    routes = {"arm.joint_angles": "udp.values0", "arm.flange_check": "udp.tool"}
    scene = Scene(robots=[robot], sources={"udp": source}, routes=routes)
    packets = [bytes(random.bytes(length)) for length in LENGTHS]
    packets += [bad_packet(random, k) for k in range(1500)]
    packets = [packet for packet in packets if len(packet) <= 65_507]
    expected = Counter(cause(without_blanks(packet)) for packet in packets)
    with Mirror(scene) as mirror:
        senders = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(10)]
        try:
            for k, packet in enumerate(packets):
                senders[k % 10].sendto(packet, ("127.0.0.1", source.port))
                if k % 100 == 99:  # not more than the kernel buffers
                    assert until(lambda k=k: source.counters.received == k + 1)
                    mirror.advance()
                    assert np.isfinite(mirror.data.qpos).all()
            last = good_packet(random, 7)
            senders[0].sendto(last, ("127.0.0.1", source.port))
            assert until(lambda: source.counters.received == len(packets) + 1)
        finally:
            for sender in senders:
                sender.close()
        mirror.advance()
        assert mirror.data.qpos.tolist() == values_of(last)["values0"]
        counters = source.counters
        assert {name: getattr(counters, name) for name in CAUSES} == {
            name: expected[name] for name in CAUSES
        }
        assert counters.senders == 10


@pytest.mark.skipif("SERO_MJ_ATHERIS" not in os.environ, reason="by hand, with atheris installed")
def test_atheris_finds_no_crash(tmp_path: Path) -> None:
    import subprocess
    import sys

    command = [sys.executable, str(Path(__file__).with_name("fuzz_packets.py"))]
    runs = os.environ["SERO_MJ_ATHERIS"]
    done = subprocess.run(
        [*command, f"-runs={runs}", "-max_len=700", str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-3000:]
