"""`FriReceiver` against packets that `struct` alone has made, on real sockets."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from fri_packets import FORMAT, TABLE, UPRIGHT, give, measurement

from sero_mj.base.errors import DeclarationError, UnknownName, shown
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.receive.source import make_source
from sero_mj.data.receive.tracking import SequenceTracker
from sero_mj.extensions.fri.receiver import FriLayout, FriReceiver
from sero_mj.load import load_scene

# ---- the layout


def test_every_field_has_the_offset_of_the_interface() -> None:
    assert struct.calcsize(FORMAT) == FriLayout().size == 916
    fields = {field.name: field for field in FriLayout().fields if field.name}
    assert list(fields) == [name for *_, name in TABLE]
    for offset, count, kind, name in TABLE:
        assert (fields[name].offset, fields[name].numbers) == (offset, count), name
        assert np.dtype(fields[name].type) == np.dtype(f"<{kind}"), name


def test_all_fields_of_a_packet_are_decoded_in_our_conventions() -> None:
    numbers = [float(k) for k in range(300)]
    numbers = [int(k) if code in "HIi" else k for k, code in zip(numbers, codes(), strict=False)]
    packet = struct.pack(FORMAT, *numbers)
    values = FriLayout(optional_frames=()).decode(packet)
    at = 0
    for _, count, _, name in TABLE:
        at += name == "timestamp"  # two bytes of filling come before it
        wire = np.array(numbers[at : at + count], float)
        at += count
        if name == "tcp_moment":
            wire = wire[::-1]
        if name == "jacobian":
            wire = wire.reshape(6, 7)[[0, 1, 2, 5, 4, 3]].ravel()
        if values[name].shape == (1, 4, 4):
            assert (values[name][0, 3] == [0, 0, 0, 1]).all()
            np.testing.assert_array_equal(values[name][0, :3].ravel(), wire)
        else:
            np.testing.assert_array_equal(values[name].ravel(), wire, err_msg=name)
    total = values["commanded_before_fri"] + values["commanded_offset"]
    np.testing.assert_array_equal(values["commanded_angles"], total)


def codes() -> Iterator[str]:
    """The type of every number of the format."""
    for part in FORMAT[1:].replace("H", "H ").replace("f", "f ").replace("i", "i ").split():
        for single in part.replace("I", "I ").split():
            yield from single[-1] * int(single[:-1] or 1)


def test_moment_is_received_as_z_y_x() -> None:
    values = FriLayout().decode(measurement(tcp_force=[1, 2, 3], tcp_moment=[30, 20, 10]))
    assert values["tcp_force"].tolist() == [[1, 2, 3]]
    assert values["tcp_moment"].tolist() == [[10, 20, 30]]


def test_encoding_is_the_inverse_of_decoding() -> None:
    layout = FriLayout()
    packet = measurement(
        7, tcp_moment=[3, 2, 1], jacobian=list(range(42)), commanded_offset=0.25, krl_int=-5,
        commanded_before_fri=[0.5] * 7, commanded_frame=UPRIGHT,
    )  # fmt: skip
    values = layout.decode(packet)
    assert layout.encode(values) == packet
    del values["commanded_before_fri"]
    assert layout.encode(values) == packet
    single = layout.encode({"commanded_angles": np.arange(7.0), "tcp_moment": [1, 2, 3]})
    assert layout.decode(single)["commanded_before_fri"].tolist() == [0, 1, 2, 3, 4, 5, 6]
    assert struct.unpack_from("<3f", single, 512) == (3, 2, 1)


# ---- what can be declared


@pytest.mark.parametrize(
    ("field", "value"),
    [("structure", "7F"), ("double", True), ("column_major", True), ("sequence", ""),
     ("time", "latency"), ("scale", 0.001), ("time_scale", 1e-3), ("alignment", 4)],
)  # fmt: skip
def test_fields_determined_by_fri_cannot_be_set(field: str, value: object) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_source("fri", {"kind": "fri", field: value})
    assert str(caught.value).startswith(f"{field}: found {shown(value)}; FRI determines")


def test_omitted_fields_default_to_those_of_fri() -> None:
    source = make_source("arm", {"kind": "fri"})
    assert isinstance(source, FriReceiver)
    assert (source.name, source.place, source.size) == ("arm", ("127.0.0.1", 49938), 916)
    assert source.about == "KUKA FRI 1.0 on UDP 127.0.0.1:49938, listens only"
    source.answer = True
    assert source.about.endswith("49938, answers without commands")
    with raises_with(key="kind", reason="no kind", found="fir", near="fri"):
        make_source("arm", {"kind": "fir"})
    with raises_with(UnknownName, kind="event", name="tpc_force", near="tcp_force"):
        source.allow_nan(["tpc_force"])


# ---- on the wire


@pytest.mark.parametrize("start", [0, 65_500])
def test_counter_wraps_without_a_loss(controller: socket.socket, start: int) -> None:
    with FriReceiver(udpport=0) as receiver:
        give(receiver, controller, *(measurement((start + k) % 65_536) for k in range(200)))
        counters = receiver.counters
        assert (counters.lost, counters.restarts, counters.malformed) == (0, 0, 0)
        packet = receiver.latest()
        assert packet is not None
        assert (packet.number, *packet.values["send_counter"]) == (200, (start + 199) % 65_536)


def test_withheld_packets_are_lost_and_duplicates_applied_once(
    controller: socket.socket,
) -> None:
    numbers = [(65_530 + k) % 65_536 for k in range(20) if k not in (3, 6, 7)]
    with FriReceiver(udpport=0, only_latest_packet=False) as receiver:
        give(receiver, controller, *(measurement(k) for k in (*numbers, numbers[-1])))
        packets = receiver.take()
        assert packets is not None
        assert packets.values["send_counter"].ravel().tolist() == numbers
        assert (receiver.counters.lost, receiver.counters.duplicates) == (3, 1)


@pytest.mark.parametrize("batch", [[5, 5, 7], [5, 7, 6, 8], [5, 7, 7, 8]])
def test_incomplete_batch_with_the_expected_end_is_detected(batch: list[int]) -> None:
    tracker = SequenceTracker(65_536)
    tracker.classify(4, 0.0)
    assert tracker.is_consecutive(list(range(5, batch[-1] + 1)))
    assert not tracker.is_consecutive(batch)


@pytest.mark.parametrize(
    ("packet", "kind", "fault"),
    [
        (bytes(915), "wrong_size", "915 bytes; expected 916"),
        (bytes(376), "wrong_size", "376 bytes; expected 916"),
        (
            measurement(datagram_id=0x2005),
            "wrong_constant",
            "datagram_id at byte 6 is 8197 (0x2005); expected 8198 (0x2006)",
        ),
        (
            measurement(packet_size=912),
            "wrong_constant",
            "packet_size at byte 4 is 912 (0x390); expected 916 (0x394)",
        ),
        (measurement(torques=math.nan), "not_finite", "torques[0] is nan"),
        (measurement(commanded_offset=math.inf), "not_finite", "commanded_offset[0] is inf"),
    ],
    ids=["short", "command", "id", "size", "nan", "inf"],
)
def test_wrong_packet_is_counted_by_its_cause(
    controller: socket.socket, packet: bytes, kind: str, fault: str
) -> None:
    with FriReceiver(udpport=0) as receiver:
        give(receiver, controller, measurement(1, joint_angles=0.5), packet)
        counters = receiver.counters
        assert (counters.malformed, getattr(counters, kind)) == (1, 1)
        assert counters.last_fault == fault
        latest = receiver.latest()
        assert latest is not None and latest.values["joint_angles"].tolist() == [0.5] * 7


MIRRORED = [2, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]


@pytest.mark.parametrize("commanded", [[0.0] * 12, [math.nan] * 12, MIRRORED])
def test_invalid_frame_counts_as_no_data(controller: socket.socket, commanded: list[float]) -> None:
    with FriReceiver(udpport=0) as receiver:
        give(receiver, controller, measurement(commanded_frame=commanded))
        assert receiver.counters.malformed == 0
        packet = receiver.latest()
        assert packet is not None
        assert np.isnan(packet.values["commanded_frame"]).all()
        assert packet.values["flange_frame"][0, :3, 3] == pytest.approx([0.1, 0.2, 0.3])


def test_only_routed_values_must_be_valid(controller: socket.socket, tmp_path: Path) -> None:
    scene = tmp_path / "s.toml"
    scene.write_text(
        '[robots.lwr]\nmodel = "lwr"\n[objects.box]\nshape = "box"\nsize = [1, 1, 1]\n'
        '[sources.fri]\nkind = "fri"\nport = 0\n[doubles.goal]\nof = "lwr"\n'
        '[routes]\n"lwr.flange_check" = "fri.flange_frame"\n'
        '"box.frame" = "fri.commanded_frame"\n"goal.joint_angles" = "fri.commanded_angles"\n'
    )
    with Mirror(load_scene(scene)) as mirror:
        fri = mirror.sources["fri"]
        assert isinstance(fri, FriReceiver)
        good = {"commanded_frame": UPRIGHT, "mass_matrix": math.nan}
        give(fri, controller, measurement(0, **good, flange_frame=[0.0] * 12))
        assert fri.counters.malformed == 0
        give(fri, controller, measurement(1, commanded_frame=[0.0] * 12))  # it would move the box
        assert fri.counters.not_frames == 1
        give(fri, controller, measurement(2, **good, commanded_before_fri=math.nan))
        give(fri, controller, measurement(3, **good, commanded_offset=math.inf))
        assert (fri.counters.not_finite, fri.counters.malformed) == (2, 3)
        assert fri.counters.last_fault.startswith("commanded_")
        mirror.advance()
        assert np.isnan(mirror.data.userdata[mirror.world.slots["lwr.flange_check"]]).all()
