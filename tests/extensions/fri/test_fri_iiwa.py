"""`FriReceiver` against messages of an iiwa that Google's Protocol Buffers have encoded."""

from __future__ import annotations

import math
import socket
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import examples, raises_with
from decor_tools import corner_lines, view_at
from fri_packets import give
from hypothesis import given, settings
from hypothesis import strategies as st
from iiwa_messages import framed, monitoring, read_command, values
from newton_euler import inverse_dynamics

from sero_mj.cli import main
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.receive.report import describe, report
from sero_mj.data.receive.source import make_source
from sero_mj.data.record.replay import Replay
from sero_mj.extensions.fri.iiwa import (
    COMMAND_ID,
    OPTIONAL,
    STATES,
    STRUCTURES,
    IiwaLayout,
    MonitoringClient,
    no_command,
    pack,
    read_fields,
)
from sero_mj.extensions.fri.receiver import FriReceiver
from sero_mj.load import load_robot, load_scene
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.robot_parts import ARROW_QUANTITIES
from sero_mj.viewer.decor.quantities import arrow_values, joint_values
from sero_mj.viewer.decor.status import Status
from sero_mj.viewer.decor.toggles import Toggles

VERSIONS = ("iiwa-1", "iiwa-2")
Q = np.array([0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7])
# Of KUKA's layout, byte by byte: header, joint 2 of the measured torques, the connection.
BY_HAND = bytes.fromhex(
    "0a0a08c2a291011005188001"  # 1: identifier 0x245142, counter 5, reflected 128
    "1a8401"  # 3: of 132 bytes
    "0a3f" + 7 * "090000000000000040"
    + "123f" + "090000000000000000" + "09000000000000f83f" + 5 * "090000000000000000"
    + "7a00"  # 15: a time of no fields
    + "22080801100218052001"  # 4: monitoring wait, good, 5 ms, every one
)  # fmt: skip


def iiwa(version: str, **fields: Any) -> FriReceiver:
    return FriReceiver(udpport=0, version=version, **fields)


def scene_of(folder: Path, version: str, more: str = "") -> Path:
    """An LWR, which has seven joints as well, moved by an iiwa."""
    file = folder / "iiwa.toml"
    file.write_text(
        '[robots.arm]\nmodel = "lwr"\nshow_arrows = true\ninputs = ["external_torques"]\n'
        f'[sources.fri]\nkind = "fri"\nversion = "{version}"\nport = 0\n{more}\n'
        '[routes]\n"arm.joint_angles" = "fri.joint_angles"\n"arm.torques" = "fri.torques"\n'
        '"arm.commanded_torques" = "fri.commanded_torques"\n'
        '"arm.external_torques" = "fri.external_torques"\n'
    )
    return file


# ---- messages


@pytest.mark.parametrize("version", VERSIONS)
def test_message_is_decoded(version: str) -> None:
    got = FriReceiver(version=version).decode(monitoring(7))
    assert got is not None
    np.testing.assert_array_equal(got["joint_angles"], Q)
    np.testing.assert_array_equal(got["torques"], -10 * Q)  # KUKA has the load's sign
    np.testing.assert_array_equal(got["commanded_torques"], -11 * Q)
    np.testing.assert_array_equal(got["external_torques"], 2 * Q)  # and here ours
    assert got["send_counter"] == 7
    assert got["timestamp"] == 1_700_000_000.25  # s
    assert got["measurement_cycle"] == 0.005  # s
    states = {"state": 2, "quality": 3, "control": 2, "safety": 0, "operation_mode": 2}
    assert {name: got[name][0] for name in states} == states
    assert got["drives"].tolist() == [2] * 7
    assert np.isnan(got["interpolated_angles"]).all()


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("sign", [1, -1])
def test_declared_torque_sign_replaces_that_of_kuka(version: str, sign: int) -> None:
    receiver = FriReceiver(version=version, torque_sign=sign)
    got = receiver.decode(monitoring())
    assert got is not None
    np.testing.assert_array_equal(got["torques"], sign * 10 * Q)
    np.testing.assert_array_equal(got["commanded_torques"], sign * 11 * Q)
    np.testing.assert_array_equal(got["external_torques"], 2 * Q)
    assert receiver.decoding_fields() == {"version": version, "torque_sign": sign}


@pytest.mark.parametrize("version", VERSIONS)
def test_gravity_explains_the_torques_of_an_iiwa_at_rest(
    controller: socket.socket, tmp_path: Path, version: str
) -> None:
    angles = np.deg2rad([0.0, 50.0, 0.0, -40.0, 0.0, 30.0, 0.0])
    robot = load_robot("iiwa14")
    held = inverse_dynamics(robot, robot_dynamics(robot), angles)
    assert held[1] < -50.0  # A2 leans forward, so its drive pulls back, and KUKA sends +
    wire = {"measuredJointPosition": values(*angles), "measuredTorque": values(*-held)}
    file = scene_of(tmp_path, version)
    file.write_text(file.read_text().replace('"lwr"', '"iiwa14"'))
    with Mirror(load_scene(file)) as mirror:
        source = mirror.sources["fri"]
        assert isinstance(source, FriReceiver)
        give(source, controller, monitoring(monitorData=wire))
        mirror.advance()
        world, data = mirror.world, mirror.data
        np.testing.assert_allclose(data.userdata[world.slots["arm.torques"]], held, atol=1e-9)
        quantity = np.full(7, ARROW_QUANTITIES.index("torque_without_gravity"))
        shown, _ = arrow_values(world, data, joint_values(world, data), quantity)
        np.testing.assert_allclose(shown, 0.0, atol=1e-9)


def test_handwritten_messages_are_decoded_in_kuka_conventions() -> None:
    got = FriReceiver(version="iiwa-1").decode(BY_HAND)
    assert got is not None
    assert got["joint_angles"].tolist() == [2.0] * 7
    assert got["torques"].tolist() == [0, -1.5, 0, 0, 0, 0, 0]  # KUKA has the load's sign
    assert (got["send_counter"], got["reflected_counter"]) == (5, 128)
    assert (got["state"], got["quality"], got["receive_multiplier"]) == (1, 2, 1)
    assert math.isnan(got["timestamp"][0])
    assert got["control"] == -1


def test_each_version_decodes_the_fields_of_its_controllers() -> None:
    wrench = {"element": [1.0, 2.0, 3.0, 30.0, 20.0, 10.0]}  # A, B, C: about z, y, x
    message = monitoring(monitorData={"externalForce": wrench, "commandedJointPosition": None})
    one = FriReceiver(version="iiwa-1").decode(monitoring())
    two = FriReceiver(version="iiwa-2").decode(message)
    assert one is not None and two is not None
    np.testing.assert_array_equal(one["commanded_angles"], Q + 0.01)
    assert (two["tcp_force"].tolist(), two["tcp_moment"].tolist()) == ([[1, 2, 3]], [[10, 20, 30]])
    assert "commanded_angles" not in two and "tcp_force" not in one
    ipo = {"jointPosition": values(*Q), "clientCommandMode": 3, "overlayType": 1}
    commanding = monitoring(ipoData=ipo, connectionInfo={"sessionState": 4})
    got = FriReceiver(version="iiwa-2").decode(commanding)
    assert got is not None
    np.testing.assert_array_equal(got["interpolated_angles"], Q)


def test_framed_message_of_2_7_is_checked() -> None:
    packet = framed(monitoring(9))
    receiver = FriReceiver(version="iiwa-2")
    got = receiver.decode(packet)
    assert got is not None and got["send_counter"] == 9
    with pytest.raises(ValueError, match="the checksum is wrong"):
        pack(packet[:-1] + bytes([packet[-1] ^ 1]), "iiwa-2")
    with pytest.raises(ValueError, match="set version = 'iiwa-2'"):
        pack(packet, "iiwa-1")


@pytest.mark.parametrize(
    ("message", "fault"),
    [
        (b"", "the header is missing"),
        (monitoring()[:-1], "field 5 has "),
        (monitoring()[:200], "field 3 has "),
        (b"\x0b", "byte 0 is not the start of a field"),
        (b"\x0a\xff\xff\xff\xff\x0f", "field 1 has 4294967295 bytes, but 0 are left"),
        (b"\x08" + b"\xff" * 11, "is truncated or too long"),
        (b"\x08\x01", "field 1 is an integer; expected a message"),
        (monitoring(robotInfo={"numberOfJoints": 6}), "found 6 joints; expected 7"),
        (monitoring(monitorData={"measuredTorque": values(1, 2)}), "found 2 numbers in field 2"),
        (monitoring(connectionInfo={"sessionState": 300}), "field 1 is 300; expected -1 to 127"),
    ],
)
def test_invalid_messages_are_explained(message: bytes, fault: str) -> None:
    with pytest.raises(ValueError) as caught:
        pack(message, "iiwa-1")
    assert fault in str(caught.value)
    told = IiwaLayout("iiwa-1").describe_wrong_size(message, len(message))
    assert told == f"{len(message)} bytes are not an FRI message: {caught.value}"


@settings(max_examples=examples(300))
@given(st.binary(max_size=700), st.sampled_from(VERSIONS))
def test_random_bytes_are_a_packet_or_an_error(data: bytes, version: str) -> None:
    for packet in (data, framed(data)):
        try:
            assert len(pack(packet, version)) == IiwaLayout(version).size
        except ValueError as error:
            assert str(error)
        MonitoringClient().answer(packet, 0)


@settings(max_examples=examples(200))
@given(st.data())
def test_damaged_message_is_a_packet_or_an_error(data: st.DataObject) -> None:
    message = bytearray(monitoring())
    for _ in range(data.draw(st.integers(1, 4))):
        message[data.draw(st.integers(0, len(message) - 1))] = data.draw(st.integers(0, 255))
    kept = bytes(message[: data.draw(st.integers(0, len(message)))])
    try:
        packet = pack(kept, "iiwa-1")
    except ValueError:
        return
    rows, lengths = np.frombuffer(packet, np.uint8)[None], np.array([len(packet)])
    assert len(rows[0]) == lengths[0] == IiwaLayout("iiwa-1").size


@given(st.integers(0, 2**32 - 1), st.integers(0, 2**32 - 1))
@settings(max_examples=examples(50))
def test_our_encoding_is_read_by_protocol_buffers(counter: int, reflected: int) -> None:
    command = read_command(no_command(counter, reflected))
    assert command.header.messageIdentifier == COMMAND_ID
    assert command.header.sequenceCounter == counter
    assert command.header.reflectedSequenceCounter == reflected
    assert not command.HasField("commandData")
    assert read_fields(no_command(counter, reflected)).keys() == {1}


# ---- the source


def test_omitted_fields_default_to_those_of_fri() -> None:
    source = make_source("arm", {"kind": "fri", "version": "iiwa-2"})
    assert isinstance(source, FriReceiver)
    assert source.place == ("127.0.0.1", 30200)
    assert source.about == "KUKA FRI 2.x of an iiwa on UDP 127.0.0.1:30200, listens only"
    assert source.decoding_fields() == {"version": "iiwa-2"}
    assert make_source("arm", {"kind": "fri", "version": "1"}).place == ("127.0.0.1", 49938)
    assert make_source("arm", {"kind": "fri", "version": "iiwa-1", "port": 5}).place[1] == 5
    with raises_with(key="version", found="3", expected="'1', 'iiwa-1' or 'iiwa-2'"):
        make_source("arm", {"kind": "fri", "version": "3"})
    with raises_with(key="structure", reason="found '7F'; FRI determines this field. Remove it"):
        make_source("arm", {"kind": "fri", "version": "iiwa-1", "structure": "7F"})
    source.version = "iiwa-1"
    assert source.structure == STRUCTURES["iiwa-1"]
    assert "commanded_angles" in source.events
    assert {name for text in VERSIONS for name in FriReceiver(version=text).events} >= OPTIONAL


@pytest.mark.parametrize("version", VERSIONS)
def test_rejected_packets_are_counted_by_cause(controller: socket.socket, version: str) -> None:
    with iiwa(version, only_latest_packet=False) as receiver:
        wrong_id = {"messageIdentifier": 0x245143}
        give(
            receiver, controller, monitoring(1), monitoring(2), monitoring(5), monitoring(5),
            monitoring(6)[:-3], bytes(916), b"", monitoring(6, header=wrong_id), bytes(2100),
            monitoring(7, monitorData={"measuredJointPosition": values(*[math.nan] * 7)}),
        )  # fmt: skip
        counters = receiver.counters
        assert (counters.received, receiver.receive_trigger) == (10, 3)
        assert (counters.lost, counters.duplicates) == (2 + 1, 1)
        causes = (counters.wrong_size, counters.wrong_constant, counters.not_finite)
        assert causes == (4, 1, 1)
        give(receiver, controller, monitoring(8)[:30])
        assert counters.last_fault.startswith("30 bytes are not an FRI message: field ")


def test_controller_state_is_described_in_words(controller: socket.socket) -> None:
    with iiwa("iiwa-1") as receiver:
        give(receiver, controller, monitoring())
        (said,) = [why for what, _, why in describe(report(receiver)) if what == "controller"]
        assert said == (
            "monitoring ready, quality excellent, joint impedance control, drives active"
        )
        give(
            receiver, controller,
            monitoring(
                2, connectionInfo={"sessionState": 4, "quality": 9},
                robotInfo={"controlMode": None, "safetyState": 2, "driveState": [2, 0, 2]},
                ipoData={"clientCommandMode": 3},
            ),
        )  # fmt: skip
        assert report(receiver)["controller"] == (
            "commanding active, quality 9, drives changing, safety stop 1, commanded by torques"
        )


@pytest.mark.parametrize("version", VERSIONS)
def test_iiwa_is_mirrored_recorded_and_replayed(
    controller: socket.socket, tmp_path: Path, version: str
) -> None:
    scene, recording = load_scene(scene_of(tmp_path, version)), tmp_path / "run.mcap"
    with Mirror(scene) as mirror:
        source = mirror.sources["fri"]
        assert isinstance(source, FriReceiver)
        said = Status(mirror.world)._awaited(mirror.data, Toggles(mirror.world), view_at())
        assert said is not None
        lines = [text.decode() for text in said.texts[0]]
        assert lines[1:] == ["  expected: FRI messages"]  # and nothing that `send` could play
        with record_sources(mirror.sources, recording, scene=scene):
            give(source, controller, monitoring(1), monitoring(2)[:-9], framed(monitoring(3)))
        mirror.advance()
        slots, data = mirror.world.slots, mirror.data
        np.testing.assert_array_equal(data.qpos, Q)
        np.testing.assert_array_equal(data.userdata[slots["arm.torques"]], -10 * Q)
        np.testing.assert_array_equal(data.userdata[slots["arm.commanded_torques"]], -11 * Q)
        np.testing.assert_array_equal(data.userdata[slots["arm.external_torques"]], 2 * Q)
        good = source.receive_trigger
        assert good == (1 if version == "iiwa-1" else 2)
        assert source.counters.wrong_size == 3 - good
    scene.sources["fri"] = Replay(name="fri", file=recording)
    with Mirror(scene) as again:
        again.advance(1e3)
        np.testing.assert_array_equal(again.data.qpos, Q)
        # A recording has the packets as they came, so it is converted when it is played.
        torques = again.data.userdata[again.world.slots["arm.torques"]]
        np.testing.assert_array_equal(torques, -10 * Q)
        replayed = again.sources["fri"]
        assert (replayed.counters.wrong_size, replayed.receive_trigger) == (3 - good, good)
        assert replayed.original.kind == "fri"


@pytest.mark.parametrize(
    ("state", "quality", "answer", "lines"),
    [
        (2, 3, True, []),
        (4, 2, False, []),
        (0, 3, True, ["fri: quality excellent, state idle"]),
        (1, 1, True, ["fri: quality fair, state monitoring wait"]),
        (1, 0, False, ["fri: quality poor, state monitoring wait",
                       "  no answers are sent: answer = false"]),
    ],
)  # fmt: skip
def test_unhealthy_state_is_shown_in_the_corner(
    controller: socket.socket, tmp_path: Path, state: int, quality: int, answer: bool,
    lines: list[str],
) -> None:  # fmt: skip
    more = f"answer = {str(answer).lower()}"
    with Mirror(load_scene(scene_of(tmp_path, "iiwa-1", more))) as mirror:
        source = mirror.sources["fri"]
        assert isinstance(source, FriReceiver)
        link = {"sessionState": state, "quality": quality}
        give(source, controller, monitoring(connectionInfo=link))
        mirror.advance()
        assert corner_lines(mirror) == lines
        give(source, controller, b"short")
        mirror.advance()
        assert corner_lines(mirror)[:2] == [
            "fri: 1 of 2 packets not applied",
            "  invalid FRI message, 5 bytes",
        ]


# ---- answers


def test_receiver_without_answer_sends_nothing(controller: socket.socket) -> None:
    with iiwa("iiwa-1") as receiver:
        give(receiver, controller, *(monitoring(k) for k in range(20)))
        assert receiver.answers == 0
        controller.settimeout(0.1)
        with pytest.raises(TimeoutError):
            controller.recv(2000)


@pytest.mark.parametrize("is_framed", [False, True])
def test_answers_to_monitoring_are_headers(controller: socket.socket, is_framed: bool) -> None:
    with iiwa("iiwa-2", answer=True) as receiver:
        for k in range(1, 4):
            message = monitoring(300 + k)
            give(receiver, controller, framed(message) if is_framed else message)
            answer = controller.recv(2000)
            if is_framed:
                (size,), (crc,) = struct.unpack("<I", answer[:4]), struct.unpack("<I", answer[-4:])
                answer = answer[4:-4]
                assert (size, crc) == (len(answer), zlib.crc32(answer))
            command = read_command(answer)
            assert [field.name for field, _ in command.ListFields()] == ["header"]
            assert command.header.sequenceCounter == k - 1  # KUKA's client begins at 0
            assert command.header.reflectedSequenceCounter == 300 + k
        assert receiver.answers == 3


def test_receive_multiplier_is_respected_and_commanding_states_unanswered() -> None:
    monitor, link = MonitoringClient(), {"receiveMultiplier": 3}
    answers = [monitor.answer(monitoring(k, connectionInfo=link), 0) for k in range(7)]
    assert [k for k, answer in enumerate(answers) if answer] == [2, 5]
    for state in range(len(STATES)):
        asked = monitoring(connectionInfo={"sessionState": state})
        assert (MonitoringClient().answer(asked, 0) is not None) == (state in (1, 2)), STATES[state]
    other = monitoring(header={"messageIdentifier": 1})
    for packet in (b"", b"\xff" * 40, other, monitoring()[:50]):
        assert MonitoringClient().answer(packet, 0) is None


def test_send_rejects_arguments(tmp_path: Path, capsys: Any) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["send", str(scene_of(tmp_path, "iiwa-2")), "--duration", "0.1"])
    assert caught.value.code == 2
    assert "FRI 2.x of an iiwa on UDP 127.0.0.1:0, listens only; expected FRI 1.0 of an LWR" in (
        capsys.readouterr().err
    )
