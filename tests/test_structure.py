"""The packet language, against Python's `struct` and against a recogniser of its own.

At the end whatever bytes there are go through a socket: they are applied whole or counted.
"""

from __future__ import annotations

import math
import socket
import struct
import threading

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from polling import until

from sero_mj.errors import SeroError, StructureError
from sero_mj.receive.structure import Structure
from sero_mj.receive.udp import UdpReceiver

MAX_BYTES = 65_507  # of UDP over IPv4: 65,535 less 20 bytes of IP and 8 of UDP header
DIGITS = "0123456789"

counts_lists = st.lists(st.integers(1, 12), min_size=1, max_size=6)
# Every bit pattern: NaNs with payloads, infinities, denormals, negative zero.
bit_patterns = st.one_of(
    st.integers(0, 2**64 - 1),
    st.sampled_from([0x7FF0000000000001, 0x7FF8000000000000, 0xFFF0000000000000, 1, 1 << 63]),
)
# What a tired typist writes, and digits that are none of ours.
almost_structures = st.text(alphabet="0123456789FFFFf ,\nX.-é٣²", max_size=12)


def text_of(counts: list[int]) -> str:
    return "".join(f"{count}F" for count in counts)


def slices_of(counts: list[int]) -> list[slice]:
    ends = np.cumsum(counts).tolist()
    return [slice(end - count, end) for count, end in zip(counts, ends, strict=True)]


def recognise(text: str, item_bytes: int = 8) -> list[int] | int:
    """The counts, or the index of the first wrong character, one character at a time."""
    counts: list[int] = []
    start, closed, size = None, False, 0
    for i, char in enumerate(text):
        if start is None:
            if char in DIGITS:
                start = i
            elif not (char.isspace() or char == ","):
                return i
        elif char == "F":
            count = int(text[start:i])
            size += count * item_bytes
            if count == 0 or size > MAX_BYTES:
                return start
            counts.append(count)
            start, closed = None, False
        elif char.isspace():
            closed = True
        elif char not in DIGITS or closed:
            return i
    return len(text) if start is not None or not counts else counts


def test_the_events_are_numbered_in_order_and_the_size_is_theirs_together() -> None:
    structure = Structure("7F7F3F")
    assert structure.events == {"values0": 7, "values1": 7, "values2": 3}
    assert list(structure.events) == ["values0", "values1", "values2"]
    assert structure.size == 17 * 8
    assert structure.text == "7F7F3F"
    assert Structure("7F7F3F", is_double=False).size == 17 * 4


def test_spaces_and_commas_may_stand_between_items() -> None:
    assert Structure(" 7F, 6F\n").events == {"values0": 7, "values1": 6}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "character 1: found the end, expected a count and F, for example 7F7F"),
        ("F", "character 1: found 'F', expected a count and F, for example 7F7F"),
        ("-7F", "character 1: found '-', expected a count and F, for example 7F7F"),
        ("7F;7F", "character 3: found ';', expected a count and F, for example 7F7F"),
        ("7", "character 2: found the end, expected F for float values after a count (7F)"),
        ("7F7", "character 4: found the end, expected F for float values after a count (7F)"),
        ("7X", "character 2: found 'X', expected F for float values after a count (7F)"),
        ("7f", "character 2: found 'f', expected F for float values after a count (7F)"),
        ("7F 3.5F", "character 5: found '.', expected F for float values after a count (7F)"),
        ("7 7F", "character 3: found '7', expected F for float values after a count (7F)"),
        ("7F0F", "character 3: found '0', expected a count of 1 or more"),
        (
            "8188F1F",
            "character 6: found '1', the packet would be too long; expected at most 65507 bytes",
        ),
    ],
)
def test_an_error_points_at_the_first_wrong_character(text: str, message: str) -> None:
    with pytest.raises(StructureError) as caught:
        Structure(text)
    assert str(caught.value) == f"structure '{text}', {message}"
    assert caught.value.structure == text
    assert message.startswith(f"character {caught.value.position + 1}:")
    assert message.endswith(caught.value.reason)
    assert isinstance(caught.value, SeroError)
    assert isinstance(caught.value, ValueError)


def test_a_packet_may_be_as_long_as_udp_carries_and_no_longer() -> None:
    assert Structure("8188F").size == 65_504
    assert Structure("16376F", is_double=False).size == 65_504
    assert UdpReceiver(structure="16376F", is_double=False).layout.size == 65_504
    with pytest.raises(StructureError, match="expected at most 65507 bytes"):
        Structure("8189F")
    with pytest.raises(StructureError, match="expected at most 65507 bytes"):
        Structure("16377F", is_double=False)


@pytest.mark.parametrize("digits", [20, 4300, 5000])
def test_a_count_of_thousands_of_digits_is_refused_like_any_other(digits: int) -> None:
    # Python itself refuses to turn more than 4300 digits into a number.
    with pytest.raises(StructureError, match="expected at most 65507 bytes") as caught:
        Structure("1F" + "9" * digits + "F")
    assert caught.value.position == 2


@given(almost_structures)
@example("٣F")
@example("7F0")
@example("0X")
def test_a_string_parses_or_the_error_points_at_the_first_wrong_character(text: str) -> None:
    expected = recognise(text)
    if isinstance(expected, int):
        with pytest.raises(StructureError) as caught:
            Structure(text)
        assert caught.value.position == expected
        found = f"found '{text[expected]}'" if expected < len(text) else "found the end"
        assert f"character {expected + 1}: {found}, " in str(caught.value)
    else:
        assert list(Structure(text).events.values()) == expected


@given(st.text())
def test_no_string_at_all_raises_anything_else(text: str) -> None:
    try:
        structure = Structure(text)
    except StructureError as error:
        assert 0 <= error.position <= len(text)
    else:
        assert 0 < structure.size <= MAX_BYTES


@given(counts_lists, st.data())
def test_doubles_are_decoded_bit_for_bit_as_struct_does(
    counts: list[int], data: st.DataObject
) -> None:
    n = sum(counts)
    bits = data.draw(st.lists(bit_patterns, min_size=n, max_size=n))
    packet = struct.pack(f"<{n}Q", *bits)
    structure = Structure(text_of(counts))
    decoded = structure.decode(packet)
    for k, part in enumerate(slices_of(counts)):
        array = decoded[f"values{k}"]
        assert array.shape == (counts[k],)
        assert array.dtype == np.float64
        assert array.tobytes() == struct.pack(f"<{counts[k]}Q", *bits[part])
    assert structure.encode(decoded) == packet


def test_a_signalling_nan_is_decoded_without_a_warning() -> None:
    packet = struct.pack("<I", 0x7F800001)  # numpy tells when it makes a quiet one of it
    assert np.isnan(Structure("1F", is_double=False).decode(packet)["values0"]).all()


@given(counts_lists, st.data())
def test_floats_are_decoded_as_struct_does(counts: list[int], data: st.DataObject) -> None:
    n = sum(counts)
    pattern = st.one_of(st.integers(0, 2**32 - 1), st.sampled_from([0x7F800001, 0x7F800000, 1]))
    bits = data.draw(st.lists(pattern, min_size=n, max_size=n))
    packet = struct.pack(f"<{n}I", *bits)
    expected = struct.unpack(f"<{n}f", packet)
    decoded = Structure(text_of(counts), is_double=False).decode(packet)
    for k, part in enumerate(slices_of(counts)):
        array = decoded[f"values{k}"]
        assert array.dtype == np.float64
        np.testing.assert_array_equal(array, expected[part])


@given(
    st.lists(st.floats(-1e38, 1e38), min_size=1, max_size=9),
    st.lists(st.floats(-1e38, 1e38), min_size=1, max_size=9),
    st.booleans(),
)
def test_packets_are_encoded_as_struct_does(
    first: list[float], second: list[float], is_double: bool
) -> None:
    structure = Structure(f"{len(first)}F{len(second)}F", is_double=is_double)
    n = len(first) + len(second)
    packed = struct.pack(f"<{n}{'d' if is_double else 'f'}", *first, *second)
    assert structure.encode({"values1": second, "values0": first}) == packed


def test_events_that_are_not_given_are_zero() -> None:
    assert Structure("2F1F").encode({"values1": [3.5]}) == struct.pack("<3d", 0.0, 0.0, 3.5)
    assert Structure("2F1F").encode({}) == bytes(24)


def test_decoding_copies_nothing() -> None:
    packet = bytearray(struct.pack("<2d", 1.0, 2.0))
    values = Structure("1F1F").decode(packet)["values1"]
    packet[8:] = struct.pack("<d", math.pi)
    assert values[0] == math.pi


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_packets_come_in_any_bytes(kind: type) -> None:
    assert Structure("1F").decode(kind(struct.pack("<d", -0.5)))["values0"].tolist() == [-0.5]


@pytest.mark.parametrize("length", [0, 1, 111, 113, 224])
def test_a_packet_of_another_length_is_refused(length: int) -> None:
    with pytest.raises(ValueError, match=f"^found {length} bytes; expected 112 for '7F7F'$"):
        Structure("7F7F").decode(bytes(length))


def test_values_of_another_number_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^values1: found \(6,\); expected \(7,\)$"):
        Structure("7F7F").encode({"values1": np.zeros(6)})
    with pytest.raises(ValueError, match=r"^values0: found \(\); expected \(7,\)$"):
        Structure("7F7F").encode({"values0": 1.0})


def test_an_event_that_is_not_there_is_refused_by_name() -> None:
    with pytest.raises(KeyError, match="values2"):
        Structure("7F7F").encode({"values2": np.zeros(7)})


strange = st.sampled_from([math.nan, math.inf, -math.inf, 5e-324, -0.0, 1.7e308, -1.7e308])
two_doubles = st.lists(st.one_of(st.floats(), strange), min_size=2, max_size=2)
packets = st.one_of(
    two_doubles.map(lambda values: struct.pack("<2d", *values)),
    st.binary(min_size=16, max_size=16),
    st.binary(max_size=64),
    # To the longest that UDP carries, from a pattern: hypothesis itself makes no 64 KiB.
    st.builds(
        lambda length, pattern: (pattern * (length // len(pattern) + 1))[:length],
        st.integers(0, 65_507),
        st.binary(min_size=1, max_size=32),
    ),
)


def runs(name: str) -> bool:
    return any(thread.name == f"udp {name}" for thread in threading.enumerate())


@settings(max_examples=150, deadline=None)
@given(packets)
@example(struct.pack("<2d", 1.7e308, 1.7e308))
@example(struct.pack("<2d", math.inf, -math.inf))
@example(bytes(65_507))
def test_any_bytes_are_applied_whole_or_counted(packet: bytes) -> None:
    numbers = struct.unpack("<2d", packet) if len(packet) == 16 else (math.nan,)
    good = all(map(math.isfinite, numbers))
    before = struct.pack("<2d", 0.25, 0.5)
    with (
        UdpReceiver(structure="2F", name="fuzzed") as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        address = ("127.0.0.1", receiver.port)
        for each in (before, packet, b""):
            sock.sendto(each, address)
        # When the third is counted, the second has been dealt with.
        assert until(lambda: receiver.counters.received == 3 or not runs("fuzzed"))
        assert runs("fuzzed"), "the thread died"
        latest = receiver.latest()
        assert latest is not None
        assert latest.number == (2 if good else 1)
        assert latest.values["values0"].tobytes() == (packet if good else before)
        wrong_size = 1 if len(packet) == 16 else 2
        assert until(lambda: receiver.counters.wrong_size == wrong_size)
        assert receiver.counters.not_finite == (len(packet) == 16 and not good)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1) | st.sampled_from([0x7F800001, 0xFF800000, 1, 0x7F7FFFFF]))
def test_any_float32_is_applied_or_counted(bits: int) -> None:
    packet = struct.pack("<I", bits)
    (number,) = struct.unpack("<f", packet)
    with (
        UdpReceiver(structure="1F", is_double=False) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock,
    ):
        sock.sendto(packet, ("127.0.0.1", receiver.port))
        good = math.isfinite(number)
        assert until(
            lambda: receiver.wait(0) if good else receiver.counters.not_finite == 1, seconds=2
        )
        latest = receiver.latest()
        assert (latest is not None) == good
        assert latest is None or latest.values["values0"].tolist() == [number]
