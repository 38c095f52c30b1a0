"""Joining ROS messages to packets; malformed messages are counted and reported."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from conftest import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from ros_tools import JOINT_STATE, STORE, encoded, joint_state

from sero_mj.data.receive.source import RoutedJoint
from sero_mj.extensions.ros.dds import Ros2
from sero_mj.extensions.ros.joined_packets import JOINT_STATES, JoinedPackets, prefix_before
from sero_mj.extensions.ros.messages import MAX_BYTES, MalformedMessage, decode
from sero_mj.extensions.ros.network import robots_with
from sero_mj.extensions.ros.ros_source import Listener

ARM = ("shoulder", "elbow")
JOINTS = [RoutedJoint("shoulder", 0.5, 50.0), RoutedJoint("elbow", -0.5, 20.0)]
GOOD = joint_state(ARM, (1, 2), (3, 4), (5, 6), stamp=10**9)


class Heard(Listener):
    """A source with a listener, and the warnings that it logs."""

    def __init__(self, **fields: Any) -> None:
        self.source = Ros2(**{"name": "ros", "domain": 1, **fields})
        self.source.set_joints(JOINTS)
        self.source.reset()
        super().__init__(self.source)
        self.said: list[str] = []
        self._joined._report = self.said.append

    def tell(self, *given: Any) -> None:
        self.take([(JOINT_STATES, each if isinstance(each, bytes) else encoded(each), b"")
                   for each in given])  # fmt: skip

    @property
    def values(self) -> dict[str, list[float]]:
        packet = self.source.latest()
        assert packet is not None
        return {key: value.tolist() for key, value in packet.values.items() if key != "stamp"}


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (joint_state(ARM, (1,)), "found 1 values of joint_angles"),
        (joint_state(ARM, (1, 2), (1, 2, 3)), "found 3 values of joint_velocities"),
        (joint_state(("elbow", "elbow"), (1, 2)), "joint elbow is named twice"),
        (joint_state(ARM, (np.nan, 2)), "joint_angles[0] is nan"),
        (joint_state(ARM, (1, np.inf)), "joint_angles[1] is inf"),
        (encoded(GOOD)[:-3], "smaller"),
        (encoded(GOOD)[:20], "the message is not a sensor_msgs/msg/JointState"),
        (b"", "the message is not a sensor_msgs/msg/JointState"),
        (b"\0\1\0\0" + b"\xff" * 100, "the message is not a sensor_msgs/msg/JointState"),
        (
            encoded(joint_state([f"j{i}" for i in range(60_000)], np.zeros(60_000))),
            "bytes; expected",
        ),
    ],
)
def test_malformed_messages_are_counted_and_reported(message: Any, said: str) -> None:
    heard = Heard()
    heard.tell(GOOD)
    heard.tell(message)
    assert heard.source.counters.malformed == 1
    assert said in heard.source.counters.last_fault
    assert heard.values["joint_angles"] == [1, 2]
    heard.tell(joint_state(ARM, (7, 8)))
    assert heard.values["joint_angles"] == [7, 8]


def test_values_missing_in_a_message_are_unknown() -> None:
    heard = Heard()
    heard.tell(joint_state(ARM, (), (), (5, 6)))  # some drivers have nothing else
    assert heard.values["joint_angles"] == [0.5, -0.5]
    assert heard.values["torques"] == [5, 6]
    assert np.isnan(heard.values["joint_velocities"]).all()
    heard.tell(joint_state(ARM, (1, 2)))
    assert np.isnan(heard.values["torques"]).all()
    heard.tell(joint_state(ARM, (1, 2), (), (np.nan, 3)))
    assert heard.values["torques"][1] == 3
    assert heard.source.counters.blanked == 3


def test_joints_without_names_are_read_in_order_if_the_count_matches() -> None:
    heard = Heard()
    heard.tell(joint_state((), (1, 2)))
    assert heard.values["joint_angles"] == [1, 2]
    heard.tell(joint_state((), (1, 2, 3)))
    assert heard.source.receive_trigger == 1
    assert [text for text in heard.said if "3 joints without names" in text]


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("left_shoulder", "left_elbow"), "'left_'"),
        (("elbow", "finger"), "finger"),
        (("a", "b"), "shoulder, elbow"),
    ],
)
def test_mismatching_names_are_reported(names: tuple[str, ...], said: str) -> None:
    heard = Heard()
    heard.tell(joint_state(names, (1, 2)))
    assert any(said in text for text in heard.said), heard.said


def test_missing_joints_are_reported_once_after_a_delay() -> None:
    def said_by(messages: list[tuple[float, tuple[str, ...]]]) -> list[str]:
        said: list[str] = []
        joined = JoinedPackets([RoutedJoint(name) for name in ARM], {}, report=said.append)
        for when, names in messages:
            joined.take(JOINT_STATES, joint_state(names, np.ones(len(names))), when)
        return said

    beginning = [(100.0, ("elbow",)), (101.9, ("elbow",))]
    missing = (
        "no message has contained shoulder within 2 s; these joints keep their declared angles"
    )
    assert said_by(beginning) == []
    assert said_by([*beginning, (102.1, ("elbow",)), (105.0, ("elbow",))]) == [missing]
    assert said_by([*beginning, (101.95, ("shoulder",)), (105.0, ("elbow",))]) == []


def test_names_may_change_and_their_order() -> None:
    heard = Heard()
    heard.tell(joint_state(ARM, (1, 2)))
    heard.tell(joint_state(ARM[::-1], (3, 4)))
    assert heard.values["joint_angles"] == [4, 3]
    heard.tell(joint_state(("x_elbow", "x_shoulder"), (5, 6)))
    assert heard.values["joint_angles"] == [6, 5]


@pytest.mark.parametrize("joints", [["s", "e"], {"shoulder": "s", "elbow": "e"}])
def test_list_or_table_maps_joint_names(joints: Any) -> None:
    heard = Heard(joints=joints)
    heard.tell(joint_state(("e", "s"), (1, 2)))
    assert heard.values["joint_angles"] == [2, 1]


def test_amperes_become_torques() -> None:
    heard = Heard(effort_unit="A", torque_constants=[10.0, 5.0])
    heard.tell(joint_state(ARM, (1, 2), (), (2, 3)))
    assert heard.values["torques"] == [20, 15]


@pytest.mark.parametrize(
    ("fields", "factors"),
    [({}, (-1, -1)), ({"effort_unit": "A", "torque_constants": [10.0, 5.0]}, (-10, -5))],
)
def test_efforts_of_the_load_on_the_drive_get_another_sign(
    fields: dict[str, Any], factors: tuple[int, int]
) -> None:
    heard = Heard(torque_sign=-1, **fields)
    heard.tell(joint_state(ARM, (1, 2), (), (2, 3)))
    assert heard.values["torques"] == [2 * factors[0], 3 * factors[1]]


def test_implausible_efforts_are_reported_once() -> None:
    heard = Heard()
    for k in range(3):
        heard.tell(joint_state(ARM, (1, 2), (), (0, 2000 + k)))
    (said,) = heard.said
    assert "the effort of elbow is 2000" in said and "limit is 20 Nm" in said


def test_decreasing_stamps_are_counted_as_late() -> None:
    heard = Heard()
    for stamp in (100, 200, 150, 300):
        heard.tell(joint_state(ARM, (1, 2), stamp=stamp * 10**6))
    assert heard.source.counters.late == 1
    heard.tell(joint_state(ARM, (1, 2), stamp=0))  # not set: when it came
    packet = heard.source.latest()
    assert packet is not None
    assert packet.values["stamp"][0] > 1.7e9


@settings(max_examples=examples(400))
@given(data=st.data())
def test_any_bytes_are_applied_or_counted(data: st.DataObject) -> None:
    raw = bytearray(encoded(GOOD))
    for _ in range(data.draw(st.integers(0, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(raw)))
    heard = Heard()
    heard.tell(bytes(raw[:cut]) if data.draw(st.booleans()) else bytes(raw))
    counters = heard.source.counters
    packet = heard.source.latest()
    assert packet is None or np.isfinite(packet.values["joint_angles"]).all()
    assert counters.received <= 1
    heard.tell(GOOD)
    assert heard.values["joint_angles"] == [1, 2] or counters.late == 1


def test_decoding_agrees_with_the_bytes_written_by_hand() -> None:
    """Little-endian CDR: strings have a length with their 0, and doubles are aligned to 8."""
    by_hand = b"\0\1\0\0" + bytes.fromhex(
        "0100000002000000"
        "02000000"
        "6200"
        "0000"
        "01000000"
        "02000000"
        "6100"
        "0000"
        "01000000"
        "000000000000f83f"
        "00000000"
        "00000000"
    )
    message = decode(by_hand, JOINT_STATE)
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (1, 2)
    assert (message.header.frame_id, message.name, message.position.tolist()) == ("b", ["a"], [1.5])
    assert by_hand == encoded(STORE.types[JOINT_STATE](message.header, ["a"], np.array([1.5]),
                                                       np.zeros(0), np.zeros(0)))  # fmt: skip


def test_message_above_the_size_limit_is_rejected() -> None:
    with pytest.raises(MalformedMessage, match=f"expected at most {MAX_BYTES}"):
        decode(bytes(MAX_BYTES + 1), JOINT_STATE)


@pytest.mark.parametrize(
    ("names", "prefix"),
    [
        (["fr3_joint1", "fr3_joint2", "fr3_finger_joint1"], "fr3_"),
        (["joint1", "joint2"], ""),
        (["a_joint1", "a_joint2", "b_joint1", "b_joint2"], ""),
        (["a_joint1", "b_joint2"], ""),
        ([], ""),
    ],
)
def test_common_prefix_of_joint_names_is_found(names: list[str], prefix: str) -> None:
    assert prefix_before(["joint1", "joint2"], names) == prefix


def test_shipped_robots_are_known_by_their_joints() -> None:
    assert robots_with([f"fr3_joint{i}" for i in range(7, 0, -1)]) == ["fr3"]
    assert set(robots_with([f"shoulder_{x}_joint" for x in ("pan", "lift")])) == set()
    assert "iiwa14" in robots_with([f"lbr_A{i}" for i in range(1, 8)])


def test_packets_hold_the_newest_of_all_topics() -> None:
    joined = JoinedPackets(JOINTS, {})
    first = joined.take(JOINT_STATES, GOOD, 0.0)
    assert first is not None
    assert len(first) == joined.layout.size == 8 * 7
