"""`JsonUdp`: states of joints in JSON, by UDP."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from polling import until

from sero_mj.base.errors import SourceError
from sero_mj.cli.send import SinkOptions, make_sink
from sero_mj.data.receive.source import RoutedJoint
from sero_mj.extensions.ros.json_messages import joint_state_of
from sero_mj.extensions.ros.json_udp import JsonUdp
from sero_mj.extensions.ros.messages import MalformedMessage

NAMES = ["1", "left/j 2", "\N{CJK UNIFIED IDEOGRAPH-5173}"]


@pytest.fixture
def hand() -> Iterator[JsonUdp]:
    source = JsonUdp(port=0, debug_level=0)
    source.set_joints([RoutedJoint(name) for name in NAMES])
    with source:
        yield source


def give(source: JsonUdp, *messages: Any) -> None:
    """Sends messages, and waits until all of them are counted."""
    wanted = source.counters.received + len(messages)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for message in messages:
            raw = message if isinstance(message, bytes) else json.dumps(message).encode()
            sender.sendto(raw, ("127.0.0.1", source.port))
    assert until(lambda: source.counters.received == wanted)


def test_joints_are_matched_by_their_names(hand: JsonUdp) -> None:
    give(hand, {"name": NAMES[::-1], "position": [3, 2, 1], "effort": [30, None, 10]})
    values = hand.latest().values
    assert values["joint_angles"].tolist() == [1, 2, 3]
    np.testing.assert_equal(values["torques"], [10, np.nan, 30])
    # Another device, in Foxglove's form, and the envelope of rosbridge.
    joint = {"name": NAMES[0], "position": 5, "velocity": -1}
    give(hand, {"timestamp": {"sec": 7, "nsec": 500_000_000}, "joints": [joint]})
    values = hand.latest().values
    assert values["joint_angles"].tolist() == [5, 2, 3] and values["stamp"] == 7.5
    assert values["joint_velocities"][0] == -1
    give(hand, {"op": "publish", "msg": {"name": NAMES[:1], "position": [6]}})
    assert hand.latest().values["joint_angles"].tolist() == [6, 2, 3]


def test_message_of_many_joints_is_received_whole(hand: JsonUdp) -> None:
    others = [f"joint {k} of another device with a long name" for k in range(400)]
    give(hand, {"name": [*others, *NAMES], "position": [*[0.0] * 400, 1, 2, 3]})
    assert hand.latest().values["joint_angles"].tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (b"{", "the message is not JSON: "),
        (b"{\xff", "the message is not JSON: byte 1 is not UTF-8; it begins with the bytes 7b ff"),
        (b"{\x00", "the message is not JSON: Expecting property name enclosed in double quotes"),
        (b"[" * 50_000, "the message is not JSON: "),
        ([1], "found a list; expected a JSON object"),
        ({"q": [1]}, "found the keys q; expected name, position, velocity and effort, or joints"),
        ({"name": "1", "position": [1]}, "joint names are not a list of strings"),
        ({"joints": [{"position": 1}]}, "joint names are not a list of strings"),
        ({"name": ["1"], "position": ["x"]}, "position is not a list of numbers"),
        ({"name": ["1"], "position": 1}, "position is not a list of numbers"),
        ({"name": ["1"], "position": [10**400]}, "position is not a list of numbers"),
        ({"name": ["1"], "position": [1, 2]}, "found 2 values of joint_angles"),
        ({"name": ["1", "1"], "position": [1, 2]}, "joint 1 is named twice"),
        ({"position": [1], "header": {"stamp": {"sec": "now"}}}, "the time stamp is not in"),
    ],
    ids=lambda each: str(each)[:24],
)
def test_malformed_packets_are_counted_and_reported(hand: JsonUdp, message: Any, why: str) -> None:
    give(hand, message, {"name": NAMES[:1], "position": [1]})
    assert (hand.counters.received, hand.counters.wrong_size) == (2, 1)
    assert hand.counters.last_fault.startswith(why)
    assert hand.latest().values["joint_angles"][0] == 1


@pytest.mark.parametrize("velocity", [0.0, 2.5])
def test_packet_is_sent_as_its_original_message(velocity: float) -> None:
    constants = {"effort_unit": "A", "torque_constants": [2.0, 4.0, 5.0], "torque_sign": -1}
    with JsonUdp(port=0, debug_level=0, joints=NAMES, **constants) as source:
        packet = source.layout.encode({
            "stamp": [7.25], "joint_angles": [1, 2, 3], "joint_velocities": 3 * [velocity],
            "torques": [10, np.nan, 30],
        })  # fmt: skip
        assert json.loads(source.message_of(packet))["effort"] == [-5, None, -6]
        with make_sink(SinkOptions(port=source.port), source, source.layout) as sink:
            sink.put(packet)
        assert until(lambda: source.counters.received)
        values = source.latest().values
        assert values["stamp"] == 7.25 and values["joint_angles"].tolist() == [1, 2, 3]
        # Zeros where nothing leads to velocities are unknown.
        np.testing.assert_equal(values["joint_velocities"], 3 * [velocity or np.nan])
        np.testing.assert_equal(values["torques"], [10, np.nan, 30])


def test_json_udp_has_no_topics_and_requires_joints() -> None:
    with raises_with(key="commands", reason="unknown key"):
        JsonUdp(port=0, commands="/commands")
    with pytest.raises(SourceError, match="joints: no route"):
        JsonUdp(port=0).open()
    assert JsonUdp(port=0, joints=NAMES).of_messages.joint_names == NAMES


def test_long_messages_are_refused_before_they_are_parsed() -> None:
    with pytest.raises(MalformedMessage, match="expected at most 1048576"):
        joint_state_of(b" " * (1 << 21))
