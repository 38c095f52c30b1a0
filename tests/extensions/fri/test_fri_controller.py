"""`FriController` as a client meets it: counters, statistics, faults, and a mirrored scene."""

from __future__ import annotations

import json
import re
import socket
import struct
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from fri_packets import measurement
from polling import until

from sero_mj.base.errors import SourceError, UsageError
from sero_mj.cli import main
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.send.sender import UdpSink
from sero_mj.extensions.fri.controller import (
    AnswerStatistics,
    FriController,
    FriSignals,
    NetworkFaults,
)
from sero_mj.extensions.fri.receiver import FriLayout, FriReceiver, no_command
from sero_mj.load import load_scene
from sero_mj.robots.declared.robot import SerialRobot

# A controller in a process of its own; it prints what it did when it has sent its packets.
ROBOT = """
import json, sys
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.extensions.fri.controller import NetworkFaults, FriController
from sero_mj.data.send.sender import UdpSink
options = json.loads(sys.argv[2])
faults = NetworkFaults(**options.pop("faults", {}))
controller = FriController(SerialRobot.from_model("lwr"), faults=faults, **options)
with UdpSink("127.0.0.1", int(sys.argv[1])) as sink:
    report = controller.run(sink, duration=float(sys.argv[3]))
last = controller._layout.decode(controller.measure(0.0))
print(json.dumps([report.packets, faults.lost, faults.duplicated, faults.swapped,
                  controller.answers, controller.command_flags,
                  last["answer_rate"][0], last["quality"][0], last["latency"][0]]))
"""


def play(receiver: FriReceiver, duration: float, **options: Any) -> list[float]:
    """Lets a controller in another process send to a receiver; returns what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", ROBOT, str(receiver.port), json.dumps(options), str(duration)],
        capture_output=True, text=True, check=True, timeout=60,
    )  # fmt: skip
    return list(json.loads(done.stdout))


def events(packet: bytes) -> dict[str, Any]:
    assert len(packet) == 916
    return FriLayout().decode(packet)


def answered(controller: FriController, count: int, every: Callable[[int], bool]) -> bytes:
    """The packet after `count` more, of which those that `every` picks are answered at once."""
    for k in range(count):
        packet = controller.measure(k * 0.01)
        if every(k):
            (counter,) = struct.unpack_from("<H", packet)
            assert controller.take_answer(no_command(k, counter), k * 0.01 + 0.002)
    return controller.measure(count * 0.01)


# ---- packets


def test_packet_contains_the_values_of_a_controller(lwr: SerialRobot) -> None:
    values = events(FriController(lwr, cycle=0.002, counter=65_535).measure(1.5))
    assert values["send_counter"] == 65_535
    assert (values["timestamp"], values["state"], values["quality"]) == (1.5, 1, 0)
    assert values["measurement_cycle"] == pytest.approx(0.002)
    assert (values["power"], values["control"]) == (0x7F, 3)
    assert ((values["temperatures"] > 20) & (values["temperatures"] < 60)).all()
    # The double is ahead of the robot, and each frame belongs to its angles.
    for angles, frame in (
        ("joint_angles", "flange_frame"),
        ("commanded_angles", "commanded_frame"),
    ):
        T = lwr.fwd_kin_base_to_flange(values[angles])
        assert np.abs(values[frame][0] - T).max() < 1e-6
    assert 0.01 < np.abs(values["commanded_angles"] - values["joint_angles"]).max() < 0.5
    low, high = lwr.position_limits.T
    assert ((low < values["joint_angles"]) & (values["joint_angles"] < high)).all()


def test_signals_are_consistent(lwr: SerialRobot) -> None:
    values = FriSignals(lwr).at(2.0)
    q, R = values["joint_angles"], values["flange_frame"][:3, :3]
    in_base = lwr.dh.jacobian(q, flange_frame=lwr.flange_frame)
    jacobian = np.concatenate([R.T @ in_base[:3], R.T @ in_base[3:]])
    np.testing.assert_allclose(values["jacobian"].reshape(6, 7), jacobian, atol=1e-12)
    wrench = np.concatenate([values["tcp_force"], values["tcp_moment"]])
    np.testing.assert_allclose(values["external_torques"], jacobian.T @ wrench, atol=1e-9)
    mass = values["mass_matrix"].reshape(7, 7)
    np.testing.assert_allclose(mass, mass.T, atol=1e-12)
    assert (np.linalg.eigvalsh(mass) > 0).all()
    still = FriSignals(lwr, amplitude=0.0).at(2.0)
    held = still["torques"] + still["external_torques"]
    np.testing.assert_allclose(held, still["gravity_torques"], atol=1e-9)


def test_counters_wrap_and_restart(lwr: SerialRobot) -> None:
    controller = FriController(lwr, counter=65_534)
    numbers = [events(controller.measure(0.0))["send_counter"][0] for _ in range(4)]
    assert numbers == [65_534, 65_535, 0, 1]
    controller.take_answer(no_command(9, 1), 0.001)
    assert events(controller.measure(0.0))["reflected_counter"] == 9
    controller.restart()
    values = events(controller.measure(0.0))
    assert (values["send_counter"], values["reflected_counter"]) == (65_534, 0)
    assert (values["miss_counter"], controller.sent) == (0, 6)


# ---- answers


@pytest.mark.parametrize(
    ("every", "rate", "quality"),
    [
        (lambda k: True, 1.0, 3),
        (lambda k: k % 10 > 0, 0.9, 2),
        (lambda k: k % 2 > 0, 0.5, 1),
        (lambda k: k % 4 > 2, 0.25, 0),
        (lambda k: False, 0.0, 0),
    ],
)
def test_quality_follows_the_answer_rate(
    lwr: SerialRobot, every: Callable[[int], bool], rate: float, quality: int
) -> None:
    controller = FriController(lwr, commands=True, counter=65_500)
    values = events(answered(controller, 120, every))
    assert values["answer_rate"] == pytest.approx(rate)
    assert values["miss_rate"] == pytest.approx(1 - rate)
    assert values["latency"] == pytest.approx(0.002 if rate else 0.0)
    assert values["jitter"] == pytest.approx(0.0, abs=1e-9)
    assert values["quality"] == quality
    assert values["state"] == (2 if quality else 1)  # it falls back to monitor
    assert values["miss_counter"] == sum(not every(k) for k in range(118))


def test_late_answer_counts_as_missed() -> None:
    statistics = AnswerStatistics()
    for k in range(4):
        statistics.send(k, 0.01 * k)
    statistics.answer(1, 0.05)  # two more have gone out
    statistics.answer(3, 0.05)
    statistics.answer(3, 0.09)  # twice
    for k in range(4, 7):
        statistics.send(k, 0.01 * k)
    values = statistics.values()
    assert (values["miss_counter"], values["answer_rate"]) == (4, 0.01)
    assert values["latency"] == pytest.approx(0.02)


def test_quality_starts_unacceptable_and_becomes_perfect(lwr: SerialRobot) -> None:
    controller = FriController(lwr)
    qualities = [events(answered(controller, 26, lambda k: True))["quality"][0] for _ in range(4)]
    assert qualities == [0, 1, 1, 3]


def test_invalid_command_is_not_counted_as_an_answer(lwr: SerialRobot) -> None:
    controller = FriController(lwr)
    for packet in (b"", bytes(376), no_command(1, 1)[:-1], measurement()):
        assert not controller.take_answer(packet, 0.0)
    assert (controller.answers, controller.wrong_answers) == (0, 4)
    moving = bytearray(no_command(1, 1))
    moving[140] = 0x11  # joint angles and stiffness
    assert controller.take_answer(bytes(moving), 0.0)
    assert controller.command_flags == 0x11


@pytest.mark.parametrize("name", ["unacceptable", "bad", "ok", "perfect", "invalid"])
def test_declared_quality_is_sent_regardless_of_answers(lwr: SerialRobot, name: str) -> None:
    values = events(FriController(lwr, quality=name, commands=True).measure(0.0))
    numbers = {"unacceptable": 0, "bad": 1, "ok": 2, "perfect": 3, "invalid": 65_535}
    assert values["quality"] == numbers[name]
    assert values["state"] == (2 if name in ("bad", "ok", "perfect") else 1)


# ---- faults, and another process


def test_network_faults_are_reproducible_by_seed() -> None:
    def outcome(**shares: Any) -> list[bytes]:
        faults = NetworkFaults(**shares)
        return [out for k in range(500) for out in faults.transmit(b"%d" % k)]

    assert outcome() == [b"%d" % k for k in range(500)]
    some = outcome(loss=0.1, duplicates=0.1, swaps=0.1, seed=3)
    assert some == outcome(loss=0.1, duplicates=0.1, swaps=0.1, seed=3)
    assert some != outcome(loss=0.1, duplicates=0.1, swaps=0.1, seed=4)
    assert outcome(loss=1.0) == []
    swapped = [int(text) for text in outcome(swaps=1.0)]
    assert swapped[:4] == [1, 0, 3, 2]


@pytest.mark.slow
@pytest.mark.thorough
def test_client_in_another_process_counts_withheld_packets() -> None:
    faults = {"loss": 0.1, "duplicates": 0.05, "swaps": 0.05, "seed": 5}
    with FriReceiver(udpport=0, only_latest_packet=False, buffer_size=4_000_000) as receiver:
        made, lost, doubled, swapped, answers, *_ = play(
            receiver, 1.5, cycle=0.001, counter=65_000, faults=faults
        )
        assert made == 1500
        assert 0.05 < lost / made < 0.15
        assert until(lambda: receiver.counters.received == made - lost + doubled)
        counters = receiver.counters
        packets = receiver.take()
        assert packets is not None
        # What was lost behind the last packet that came cannot be missed.
        newest = int(((packets.values["send_counter"] - 65_000) % 65_536).max())
        assert counters.lost == lost - (made - 1 - newest)
        assert (counters.duplicates, counters.late) == (doubled, swapped)
        assert (counters.malformed, counters.restarts, answers) == (0, 0, 0)


@pytest.mark.realtime
@pytest.mark.thorough
@pytest.mark.slow
def test_answering_client_has_a_perfect_link_and_commands_nothing() -> None:
    with FriReceiver(udpport=0, answer=True) as receiver:
        made, *_, answers, flags, rate, quality, latency = play(receiver, 1.5, cycle=0.01)
        assert (made, flags, receiver.counters.lost) == (150, 0, 0)
        assert receiver.answers == pytest.approx(made, abs=5)
        assert answers == pytest.approx(made, abs=5)
        assert rate > 0.9
        assert quality >= 2
        assert 0 < latency < 0.01


def test_scene_shows_the_values_of_the_controller(lwr: SerialRobot) -> None:
    scene = load_scene("lwr_fri")
    scene.sources["fri"] |= {"port": 0}
    controller = FriController(lwr, quality="bad")
    with Mirror(scene) as mirror, socket.socket(type=socket.SOCK_DGRAM) as sock:
        fri, world, data = mirror.sources["fri"], mirror.world, mirror.data
        assert isinstance(fri, FriReceiver)
        assert fri.host == "127.0.0.1" and not fri.answer
        for t in (0.0, 7.0):
            packet = controller.measure(t)
            number = fri.receive_trigger
            sock.sendto(packet, ("127.0.0.1", fri.port))
            assert until(lambda number=number: fri.receive_trigger == number + 1)
            mirror.advance()
            sent = events(packet)
            q = sent["joint_angles"]
            np.testing.assert_array_equal(data.qpos[world.robots["lwr"].qpos], q)
            shown = world.fwd_kin_base_to_flange(data, "lwr")
            received = data.userdata[world.slots["lwr.flange_check"]].reshape(4, 4)
            assert np.abs(shown - received)[:3, 3].max() < 1e-6  # m: a thousandth of a millimetre
            assert np.abs(shown - received)[:3, :3].max() < 1e-6
            for slot, event in {
                "commanded.joint_angles": "commanded_angles",
                "lwr.torques": "torques",
                "lwr.external_torques": "external_torques",
                "lwr.temperatures": "temperatures",
                "force.vector": "tcp_force",
                "moment.vector": "tcp_moment",
            }.items():
                np.testing.assert_array_equal(data.userdata[world.slots[slot]], sent[event].ravel())
            goal = world.frame(data, "commanded/flange")
            assert np.abs(goal - sent["commanded_frame"][0]).max() < 1e-6
        assert fri.counters.blanked == fri.counters.malformed == 0


# ---- the command


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["lwr_fri", "--cycle", "0.5"], "FRI cycle: found 0.5 ms; expected 1 to 100"),
        (["lwr_fri", "--cycle", "101"], "FRI cycle: found 101 ms"),
        (["lwr_fri", "--rate", "1001"], "FRI cycle: found 0.999001 ms"),
        (["lwr_fri", "--cycle", "2", "--rate", "9"], "--cycle and --rate both set the cycle"),
        (["lwr_fri", "--quality", "god"], "no quality 'god'; available: bad, invalid, ok, per"),
        (["lwr_fri", "--loss", "1.5"], "--loss: found '1.5'; expected a share from 0 to 1"),
        (["lwr_fri", "--seed", "-1"], "--seed: found '-1'; expected a whole number of 0"),
        (["lwr_fri", "--structure", "7F"], "--structure: FRI determines it; remove it"),
        (["lwr_udp", "--loss", "0.1"], '--loss needs a source of kind = "fri"'),
    ],
)
def test_send_rejects_arguments(capsys: Any, arguments: list[str], message: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["send", *arguments, "--duration", "0.1"])
    assert caught.value.code == 2
    assert message in capsys.readouterr().err


def test_fri_requires_seven_joints() -> None:
    two = SerialRobot(name="two", dh_convention="craig", dh_params=[[0.1, 0, 0, 0.2]] * 2)
    with raises_with(UsageError, reason="FRI requires 7 joints, but 'two' has 2"):
        FriController(two)
    with pytest.raises(SourceError, match=r"^source 'no\.such\.host\.invalid:1': not an address"):
        UdpSink("no.such.host.invalid", 1)


def test_send_plays_a_controller(capsys: Any) -> None:
    with FriReceiver(udpport=0) as receiver:
        port = str(receiver.port)
        arguments = ["--port", port, "--cycle", "4", "--duration", "0.4", "--loss", "0.2"]
        with pytest.raises(SystemExit) as caught:
            main(["send", "lwr_fri", *arguments, "--seed", "2"])
        assert caught.value.code == 0
        out = capsys.readouterr().out
        assert f"FRI 1.0 measurements (916 bytes) to UDP 127.0.0.1:{port} every 4 ms" in out
        made, lost = map(int, re.findall(r"sent (\d+) packets.* dropped (\d+) on purpose", out)[0])
        assert made == 100
        assert until(lambda: receiver.counters.received == made - lost)
        packet = receiver.latest()
        assert packet is not None and packet.values["quality"] == 2  # as if it were answered
