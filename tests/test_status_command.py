"""`sero-mj status`: packets received by sources, by cause, in a separate process."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import free_udp_port

from sero_mj.cli import main
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.udp import UdpReceiver

SCENE = """
[robots.arm]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.2], [0, 0.3, 0, 0]]

[sources.udp]
kind = "udp"
port = {port}
structure = "number:1I 1H=7 2F 1M"
sequence = "number"

[routes]
"arm.joint_angles" = "udp.values0"
"""


def packet(number: int, identity: int = 7, value: float = 0.0, corner: float = 1.0) -> bytes:
    matrix = np.diag([corner, 1, 1, 1]).ravel()
    return struct.pack("<IH18d", number, identity, value, 0.0, *matrix)


@pytest.fixture
def scene(tmp_path: Path) -> Callable[[], tuple[Path, int]]:
    def write() -> tuple[Path, int]:
        port = free_udp_port()
        file = tmp_path / "scene.toml"
        file.write_text(SCENE.format(port=port))
        return file, port

    return write


def watch(file: Path, *options: str) -> tuple[int, str]:
    command = [sys.executable, "-m", "sero_mj", "status", str(file), "--duration", "2", *options]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout


def while_sending(port: int, work: Callable[[], tuple[int, str]]) -> tuple[int, str]:
    """Sends valid and malformed packets repeatedly until the work is done."""
    stop = threading.Event()

    def send() -> None:
        number = 0
        with socket.socket(type=socket.SOCK_DGRAM) as sock:
            while not stop.wait(0.01):
                for data in (
                    packet(number), packet(number), packet(number + 1, identity=8), b"short",
                    packet(number + 2, value=float("nan")), packet(number + 3, corner=2.0),
                ):  # fmt: skip
                    sock.sendto(data, ("127.0.0.1", port))
                # One number is skipped, and the packet with the wrong identity is not counted.
                number += 6

    sender = threading.Thread(target=send)
    sender.start()
    try:
        return work()
    finally:
        stop.set()
        sender.join()


@pytest.mark.slow
def test_every_cause_is_reported_with_its_count(scene: Callable[[], tuple[Path, int]]) -> None:
    file, port = scene()
    status, text = while_sending(port, lambda: watch(file))
    assert status == 0
    lines = text.splitlines()
    assert lines[0] == f"udp: UDP 127.0.0.1:{port}"
    told = {line[2:17].strip(): line[17:].split() for line in lines[1:]}
    assert list(told) == [
        "state", "received", "lost", "duplicates", "wrong_size", "wrong_constant", "not_finite",
        "not_frames", "last fault",
    ]  # fmt: skip
    assert told["state"][0].endswith("/s")
    rounds = int(told["wrong_size"][0])
    assert rounds > 10
    for cause in ("duplicates", "wrong_constant", "not_finite", "not_frames"):
        assert abs(int(told[cause][0]) - rounds) <= 1, cause
    assert abs(int(told["lost"][0]) - 3 * rounds) <= 6


def test_ambiguous_losses_are_explained() -> None:
    found = report(UdpReceiver(structure="n:1I", sequence="n"))
    for more, why in (
        ({}, "missing sequence numbers"),
        ({"wrong_size": 2}, "missing sequence numbers, or numbers of malformed packets"),
    ):
        told = {row[0]: row[2] for row in describe({**found, "lost": 2, **more})}
        assert told["lost"] == why


@pytest.mark.slow
@pytest.mark.parametrize(("value", "joint"), [(60.0, "arm.J1"), (0.6, "")])
def test_angles_in_degrees_are_detected(
    scene: Callable[[], tuple[Path, int]], value: float, joint: str
) -> None:
    file, port = scene()
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        stop = threading.Event()

        def send() -> None:
            number = 0
            while not stop.wait(0.01):
                sock.sendto(packet(number := number + 1, value=value), ("127.0.0.1", port))

        sender = threading.Thread(target=send)
        sender.start()
        try:
            status, text = watch(file, "--json")
        finally:
            stop.set()
            sender.join()
    (found,) = json.loads(text)
    assert status == 0 and found["angles"].partition(":")[0] == joint


@pytest.mark.thorough
@pytest.mark.slow
def test_json_contains_the_same_report(scene: Callable[[], tuple[Path, int]]) -> None:
    file, port = scene()
    status, text = while_sending(port, lambda: watch(file, "--json"))
    (found,) = json.loads(text)
    assert status == 0
    assert found["receiving"] is True
    causes = ("wrong_size", "wrong_constant", "not_finite", "not_frames")
    assert found["malformed"] == sum(found[cause] for cause in causes)
    assert found["received"] == found["good"] + found["malformed"] + found["duplicates"]


def test_silent_source_makes_status_fail(
    scene: Callable[[], tuple[Path, int]], capsys: pytest.CaptureFixture[str]
) -> None:
    file, _ = scene()
    with pytest.raises(SystemExit) as caught:
        main(["status", str(file), "--duration", "0.05"])
    assert caught.value.code == 1
    text = " ".join(capsys.readouterr().out.split())
    assert "state silent no valid packet yet received 0 0 applied" in text


def test_scene_without_sources_is_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["status", "lwr"])
    assert caught.value.code == 2
    assert capsys.readouterr().err == "sero-mj: scene 'lwr' has no source to watch\n"


def test_source_that_went_silent_is_reported() -> None:
    with UdpReceiver(structure="t:1F", time="t") as receiver:
        with socket.socket(type=socket.SOCK_DGRAM) as sock:
            sock.sendto(struct.pack("<d", 1.0), ("127.0.0.1", receiver.port))
        assert receiver.wait(5.0)
        found = report(receiver)
        assert describe(found)[0][1].endswith("/s")
        assert "0.00 ms later than the fastest packet" in describe(found)[0][2]
        quiet = {**found, "receiving": False, "age": 3.21}
        assert describe(quiet)[0] == ("state", "quiet", "no valid packet for 3.2 s")
