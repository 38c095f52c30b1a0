"""Arrays in packets, on real sockets: frames, NaN where it is allowed, any bytes."""

from __future__ import annotations

import math
import os
import socket
import struct
import sys
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import example, given, settings
from hypothesis import strategies as st
from polling import until

from sero_mj.base.errors import UnknownName
from sero_mj.base.frames import nearest_rotation, rotation_from_rpy
from sero_mj.data.receive.intake import Counters, find_not_frame
from sero_mj.data.receive.mailbox import Packet
from sero_mj.data.receive.source import make_source
from sero_mj.data.receive.structure import are_frames
from sero_mj.data.receive.udp import UdpReceiver

NAN, INF = math.nan, math.inf
# A quarter turn about z at 0.5, 0, 0.25, in row-major order.
QUARTER_TURN = [0, -1, 0, 0.5, 1, 0, 0, 0, 0, 0, 1, 0.25, 0, 0, 0, 1]
# The same in the order of a Simulink packet.
BY_COLUMNS = [0, 1, 0, 0, -1, 0, 0, 0, 0, 0, 1, 0, 0.5, 0, 0.25, 1]
IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]

# An address of this process, so that packets of other tests to 127.0.0.1 do not arrive here.
ADDRESS = "127.0.0.1"
if sys.platform == "linux":
    ADDRESS = f"127.{1 + os.getpid() // 250 % 250}.{os.getpid() % 250}.1"

Send = Callable[..., Packet | None]


def doubles(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}d", *values)


def changed(numbers: list[float], **entries: float) -> list[float]:
    """Returns the values with other entries: `m03=2` sets row 0, column 3 of a row-major matrix."""
    numbers = list(numbers)
    for entry, value in entries.items():
        numbers[4 * int(entry[1]) + int(entry[2])] = value
    return numbers


@pytest.fixture
def deliver() -> Iterator[Send]:
    """Sends packets and returns the latest once all valid packets have arrived."""
    with socket.socket(type=socket.SOCK_DGRAM) as sock:

        def send(receiver: UdpReceiver, *packets: bytes, good: int) -> Packet | None:
            for packet in packets:
                sock.sendto(packet, (ADDRESS, receiver.port))
            assert until(lambda: (latest := receiver.latest()) and latest.number >= good)
            return receiver.latest()

        yield send


@pytest.mark.parametrize("is_double", [True, False])
@pytest.mark.parametrize(
    ("column_major", "numbers"), [(True, BY_COLUMNS), (False, QUARTER_TURN)], ids=["by col", "row"]
)
def test_frames_and_vectors_arrive_as_sent(
    deliver: Send, is_double: bool, column_major: bool, numbers: list[float]
) -> None:
    packet = struct.pack(
        f"<{36}{'d' if is_double else 'f'}", 7, 1.5, -2.5, 3.5, *IDENTITY, *numbers
    )
    with UdpReceiver(
        host=ADDRESS, structure="1F1V2M", is_double=is_double, column_major=column_major
    ) as receiver:
        assert receiver.events == {"values0": (1,), "vectors0": (1, 3), "matrices0": (2, 4, 4)}
        values = deliver(receiver, packet, good=1).values
        assert values["values0"].tolist() == [7.0]
        assert values["vectors0"].tolist() == [[1.5, -2.5, 3.5]]
        assert values["matrices0"].reshape(2, 16).tolist() == [IDENTITY, QUARTER_TURN]
        assert values["matrices0"][..., :3, 3].tolist() == [[0, 0, 0], [0.5, 0, 0.25]]
        assert receiver.counters == Counters(received=1, senders=1)


def test_scene_declares_the_order_of_matrices() -> None:
    table = {"kind": "udp", "structure": "1M"}
    assert not make_source("tracker", {**table, "column_major": False}).layout.column_major
    receiver = make_source("tracker", table)
    assert receiver.layout.column_major
    receiver.column_major = False
    assert not receiver.layout.column_major
    with raises_with(key="column_major", found=0):
        make_source("tracker", {**table, "column_major": 0})


NOT_A_ROTATION = "the upper left 3 x 3 part is not a rotation (orthonormal, determinant +1)"
TRANSPOSED = "the last row is [0.4, 0, 0.3, 1]; its transpose is a frame. Set column_major = "


@pytest.mark.parametrize(
    ("column_major", "numbers", "why"),
    [
        (True, changed(IDENTITY, m03=0.4, m23=0.3), TRANSPOSED + "false"),
        (False, changed(IDENTITY, m30=0.4, m32=0.3), TRANSPOSED + "true"),
        # A position error of 1 mm suffices to detect it.
        (
            False,
            changed(IDENTITY, m30=0.001),
            "the last row is [0.001, 0, 0, 1]; its transpose is a frame. Set column_major = true",
        ),
        (False, [0] * 16, "the last row is [0, 0, 0, 0]"),
        (False, changed(IDENTITY, m33=1.00001), "the last row is [0, 0, 0, 1.00001]"),
        (False, changed(IDENTITY, m30=0.4, m00=3), "the last row is [0.4, 0, 0, 1]"),
        (False, changed(IDENTITY, m00=1.1), NOT_A_ROTATION),
        (False, changed(IDENTITY, m00=-1), NOT_A_ROTATION),
        (False, changed(IDENTITY, m01=1e300, m10=-1e300), NOT_A_ROTATION),
        (False, changed(IDENTITY, m22=0, m33=1), NOT_A_ROTATION),
        (True, changed(BY_COLUMNS, m33=-1.7e308), "the last row is [0, 0, 0, -1.7e+308]"),
    ],
)
def test_matrix_that_is_not_a_frame_is_counted_and_not_applied(
    deliver: Send, column_major: bool, numbers: list[float], why: str
) -> None:
    with UdpReceiver(host=ADDRESS, structure="1F1M", column_major=column_major) as receiver:
        counters = receiver.counters
        deliver(receiver, doubles(1, *IDENTITY), doubles(2, *numbers), b"", good=1)
        assert until(lambda: counters.wrong_size == 1)
        assert (counters.malformed, counters.not_frames, counters.not_finite) == (2, 1, 0)
        assert receiver.latest().values["values0"].tolist() == [1.0]
        deliver(receiver, doubles(2, *numbers), doubles(3, *IDENTITY), good=2)
        assert counters.last_fault == f"matrices0[0] is not a frame: {why}"
        assert counters.last_fault_time > 0
        assert (counters.malformed, counters.not_frames, counters.blanked) == (3, 2, 0)
        assert receiver.latest().values["values0"].tolist() == [3.0]


@pytest.mark.parametrize(
    ("wrong", "name"), [(0, "matrices0[0]"), (1, "matrices0[1]"), (2, "matrices1[0]")]
)
def test_first_matrix_that_is_not_a_frame_is_named(deliver: Send, wrong: int, name: str) -> None:
    frames = [[*QUARTER_TURN] for _ in range(3)]
    for bad in frames[wrong:]:
        bad[0] = 2
    first, second, third = frames
    with UdpReceiver(host=ADDRESS, structure="2M2F1M", column_major=False) as receiver:
        bad_packet = doubles(*first, *second, 0, 0, *third)
        good_packet = doubles(*QUARTER_TURN * 2, 0, 0, *QUARTER_TURN)
        deliver(receiver, bad_packet, good_packet, good=1)
        assert receiver.counters.last_fault == f"{name} is not a frame: {NOT_A_ROTATION}"


angles = st.floats(-7, 7)
amounts = st.sampled_from([0, 1e-9, 2e-4, 4e-4, 6e-4, 2e-3, 0.1, 3, 1e160])


@given(
    st.lists(angles, min_size=3, max_size=3),
    st.lists(st.floats(-1, 1), min_size=9, max_size=9),
    amounts,
    st.sampled_from([1, -1]),
)
def test_received_rotations_are_checked_like_those_in_files(
    rpy: list[float], noise: list[float], amount: float, handedness: int
) -> None:
    rotation = rotation_from_rpy(np.array(rpy)) * (1, 1, handedness)
    rotation = rotation + amount * np.reshape(noise, (3, 3))
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    try:
        nearest_rotation(rotation)
    except ValueError:
        expected = False
    else:
        expected = True
    assert are_frames(np.array([np.eye(4), matrix])).tolist() == [True, expected]


@given(
    st.lists(angles, min_size=3, max_size=3),
    st.lists(st.floats(-5, 5, width=32), min_size=3, max_size=3),
    st.booleans(),
)
def test_float32_frames_are_accepted_and_passed_on_unchanged(
    rpy: list[float], position: list[float], column_major: bool
) -> None:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation_from_rpy(np.array(rpy)), position
    numbers = (matrix.T if column_major else matrix).ravel().tolist()
    packet = struct.pack("<16f", *numbers)
    layout = UdpReceiver(structure="1M", double=False, column_major=column_major).layout
    values = layout.decode(packet)
    assert find_not_frame(values, ["matrices0"], column_major=column_major) == ""
    # Differs from a rotation by float32 rounding and is not corrected.
    np.testing.assert_array_equal(values["matrices0"][0], matrix.astype(np.float32))


def test_value_that_is_not_finite_is_named_by_row_and_column(deliver: Send) -> None:
    vectors = [0, 0, 0, 0, NAN, 0]
    with UdpReceiver(host=ADDRESS, structure="2V1M") as receiver:
        good = doubles(*[0] * 6, *IDENTITY)
        deliver(receiver, doubles(*vectors, *IDENTITY), good, good=1)
        assert receiver.counters.last_fault == "vectors0[1, 1] is nan"
        by_columns = changed(IDENTITY, m32=-INF)
        deliver(receiver, doubles(*[0] * 6, *by_columns), good, good=2)
        assert receiver.counters.last_fault == "matrices0[0, 2, 3] is -inf"
        counters = receiver.counters
        assert (counters.not_finite, counters.not_frames, counters.malformed) == (2, 0, 2)


def test_allowed_nan_blanks_that_value_only(deliver: Send) -> None:
    with UdpReceiver(host=ADDRESS, structure="2F3F2V") as receiver:
        receiver.allow_nan(["values1", "vectors0"])
        packet = doubles(1, 2, 3, INF, 5, 6, 7, -INF, NAN, 10, 11)
        values = deliver(receiver, packet, good=1).values
        np.testing.assert_array_equal(values["values0"], [1, 2])
        np.testing.assert_array_equal(values["values1"], [3, NAN, 5])
        np.testing.assert_array_equal(values["vectors0"], [[6, 7, NAN], [NAN, 10, 11]])
        assert receiver.counters == Counters(received=1, blanked=1, senders=1)
        # A packet without NaN is not counted as blanked.
        deliver(receiver, doubles(*range(11)), good=2)
        assert (receiver.counters.received, receiver.counters.blanked) == (2, 1)


def test_other_nan_makes_a_packet_malformed(deliver: Send) -> None:
    with UdpReceiver(host=ADDRESS, structure="2F1F") as receiver:
        receiver.allow_nan({"values1"})
        deliver(receiver, doubles(0, NAN, NAN), doubles(4, 5, NAN), good=1)
        assert receiver.counters.last_fault == "values0[1] is nan"
        assert (receiver.counters.malformed, receiver.counters.not_finite) == (1, 1)
        assert receiver.counters.blanked == 1  # the second packet; the first was not applied
        assert receiver.latest().values["values0"].tolist() == [4.0, 5.0]


def test_nan_in_part_of_a_frame_blanks_the_frame(deliver: Send) -> None:
    with UdpReceiver(host=ADDRESS, structure="2M1M1F", column_major=False) as receiver:
        receiver.allow_nan(["matrices0"])
        holed = changed(QUARTER_TURN, m03=INF)
        packet = doubles(*QUARTER_TURN, *holed, *IDENTITY, 1)
        matrices = deliver(receiver, packet, good=1).values["matrices0"]
        np.testing.assert_array_equal(matrices[0].ravel(), QUARTER_TURN)
        assert np.isnan(matrices[1]).all()
        assert receiver.counters == Counters(received=1, blanked=1, senders=1)
        # The other matrices are checked as usual, in this event and in others.
        bad = changed(QUARTER_TURN, m00=2)
        deliver(receiver, doubles(*holed, *bad, *IDENTITY, 2), packet, good=2)
        assert receiver.counters.last_fault == f"matrices0[1] is not a frame: {NOT_A_ROTATION}"
        deliver(receiver, doubles(*holed, *holed, *bad, 2), packet, good=3)
        assert receiver.counters.last_fault == f"matrices1[0] is not a frame: {NOT_A_ROTATION}"
        deliver(receiver, doubles(*holed, *QUARTER_TURN, *holed, 2), packet, good=4)
        assert receiver.counters.last_fault == "matrices1[0, 0, 3] is inf"
        counters = receiver.counters
        assert (counters.not_frames, counters.not_finite, counters.blanked) == (2, 1, 4)


def test_last_allowed_events_are_used_and_survive_reopening(deliver: Send) -> None:
    receiver = UdpReceiver(host=ADDRESS, structure="1F1F")
    receiver.allow_nan(["values0"])
    for _ in range(2):
        with receiver:
            deliver(receiver, doubles(NAN, 1), good=1)
            assert receiver.counters.blanked == 1
    with receiver:
        receiver.allow_nan([])
        deliver(receiver, doubles(NAN, 1), doubles(0, 1), good=1)
        assert (receiver.counters.not_finite, receiver.counters.blanked) == (1, 0)


def test_nan_in_an_unknown_event_is_rejected() -> None:
    receiver = UdpReceiver(structure="1F1V")
    receiver.allow_nan(["values0"])
    with raises_with(UnknownName, kind="event", name="values7", near="values0"):
        receiver.allow_nan(["vectors0", "values7"])


NAMES = ["values0", "vectors0", "matrices0"]
strange = st.sampled_from([math.nan, math.inf, -math.inf, 5e-324, -0.0, 1.7e308, -1.7e308])
any_double = st.one_of(st.floats(), strange)
two_doubles = st.lists(any_double, min_size=2, max_size=2)
packets = st.one_of(
    two_doubles.map(lambda values: struct.pack("<2d", *values)),
    st.binary(min_size=16, max_size=16),
    st.binary(max_size=64),
    # Up to the longest that UDP carries, from a pattern: hypothesis does not generate 64 KiB.
    st.builds(
        lambda length, pattern: (pattern * (length // len(pattern) + 1))[:length],
        st.integers(0, 65_507),
        st.binary(min_size=1, max_size=32),
    ),
)


def runs(name: str) -> bool:
    return any(thread.name == f"udp {name}" for thread in threading.enumerate())


@settings(max_examples=examples(150), deadline=None)
@given(packets)
@example(struct.pack("<2d", 1.7e308, 1.7e308))
@example(struct.pack("<2d", math.inf, -math.inf))
@example(bytes(65_507))
def test_any_bytes_are_applied_whole_or_counted(packet: bytes) -> None:
    numbers = struct.unpack("<2d", packet) if len(packet) == 16 else (math.nan,)
    good = all(map(math.isfinite, numbers))
    before = struct.pack("<2d", 0.25, 0.5)
    with (
        UdpReceiver(host=ADDRESS, structure="2F", name="fuzzed") as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        address = (ADDRESS, receiver.port)
        for each in (before, packet, b""):
            sock.sendto(each, address)
        # When the third packet is counted, the second has been processed.
        assert until(lambda: receiver.counters.received == 3 or not runs("fuzzed"))
        assert runs("fuzzed"), "the thread died"
        latest = receiver.latest()
        assert latest is not None
        assert latest.number == (2 if good else 1)
        assert latest.values["values0"].tobytes() == (packet if good else before)
        wrong_size = 1 if len(packet) == 16 else 2
        assert until(lambda: receiver.counters.wrong_size == wrong_size)
        assert receiver.counters.not_finite == (len(packet) == 16 and not good)


@settings(max_examples=examples(150), deadline=None)
@given(
    st.lists(any_double, min_size=4, max_size=4),
    st.sampled_from([IDENTITY, BY_COLUMNS, QUARTER_TURN, changed(IDENTITY, m01=NAN)])
    | st.lists(any_double, min_size=16, max_size=16),
    st.sets(st.sampled_from(NAMES)),
)
def test_any_numbers_are_applied_or_blanked_or_counted(
    numbers: list[float], matrix: list[float], allowed: set[str]
) -> None:
    parts = dict(zip(NAMES, (numbers[:1], numbers[1:], matrix), strict=True))
    holed = {name for name, part in parts.items() if not all(map(math.isfinite, part))}
    not_finite = bool(holed - allowed)
    frame = "matrices0" in holed or matrix in (IDENTITY, BY_COLUMNS)
    good = frame and not not_finite
    with (
        UdpReceiver(host=ADDRESS, structure="1F1V1M") as receiver,
        socket.socket(type=socket.SOCK_DGRAM) as sock,
    ):
        receiver.allow_nan(allowed)
        for packet in (doubles(*numbers, *matrix), b""):
            sock.sendto(packet, (ADDRESS, receiver.port))
        counters = receiver.counters
        assert until(lambda: counters.wrong_size == 1)
        assert (counters.not_finite, counters.not_frames) == (not_finite, not (good or not_finite))
        assert counters.blanked == (good and bool(holed))
        assert (receiver.latest() is not None) == good
