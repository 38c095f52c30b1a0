"""The structure language, compared with Python's `struct` and with a reference recognizer.

The last test sends every float32 through a socket; `test_matrices` sends arbitrary bytes.
"""

from __future__ import annotations

import math
import re
import socket
import struct

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import example, given, settings
from hypothesis import strategies as st
from polling import until

from sero_mj.base.errors import SeroError, StructureError, UnknownName
from sero_mj.data.receive.structure import Structure
from sero_mj.data.receive.udp import UdpReceiver

MAX_BYTES = 65_507  # of UDP over IPv4: 65,535 less 20 bytes of IP and 8 of UDP header
SPACES = "".join(c for c in map(chr, range(0x3001)) if c.isspace())

NUMBERS = {"F": 1, "V": 3, "M": 16, "T": 12}
SHAPES: dict[str, tuple[int, ...]] = {"F": (), "V": (3,), "M": (4, 4), "T": (4, 4)}
KINDS = {"F": "values", "V": "vectors", "M": "matrices"}

Items = list[tuple[int, str]]
items_lists = st.lists(st.tuples(st.integers(1, 6), st.sampled_from("FVM")), min_size=1, max_size=6)
# Every bit pattern: NaNs with payloads, infinities, denormals, negative zero.
bit_patterns = st.one_of(
    st.integers(0, 2**64 - 1),
    st.sampled_from([0x7FF0000000000001, 0x7FF8000000000000, 0xFFF0000000000000, 1, 1 << 63]),
)
# Strings with typing errors, and digits that are not ASCII.
almost_structures = st.text(alphabet="0123456789FFFVVMMTfdbBhHiIqQ?xvm ,\nX.-é٣²", max_size=12)


def text_of(items: Items) -> str:
    return "".join(f"{count}{letter}" for count, letter in items)


def length_of(items: Items) -> int:
    return sum(count * NUMBERS[letter] for count, letter in items)


def places_of(items: Items, *, column_major: bool) -> dict[str, np.ndarray]:
    """Returns the index in the packet of each number of each event."""
    places: dict[str, np.ndarray] = {}
    start = 0
    for k, (count, letter) in enumerate(items):
        before = [other for _, other in items[:k]].count(letter)
        array = np.empty((count, *SHAPES[letter]), int)
        for index in np.ndindex(array.shape):
            i, *inner = index
            if letter == "M" and column_major:
                inner.reverse()
            for base, digit in zip(SHAPES[letter], inner, strict=True):
                i = i * base + digit
            array[index] = start + i
        places[f"{KINDS[letter]}{before}"] = array
        start += count * NUMBERS[letter]
    return places


ITEM = re.compile(r"([0-9]+)(\s*)(?:([FVMT][fdbBhHiIqQ?]?)|([fdbBhHiIqQ?])|(x))")
TYPE_BYTES = dict(zip("fdbBhHiIqQ?", (4, 8, 1, 1, 2, 2, 4, 4, 8, 8, 1), strict=True))


def recognise(text: str, number_bytes: int = 8) -> Items | int:
    """Returns the items, or the index of the first invalid character, by a regular expression.

    Knows no names, byte orders and constants.
    """
    items: Items = []
    at, size = 0, 0
    while True:
        at += len(text[at:]) - len(text[at:].lstrip(SPACES + ","))
        if at == len(text):
            return items if any(kind != "x" for _, kind in items) else at
        digits = re.match("[0-9]*", text[at:]).group()
        if not digits:
            return at
        if not digits.strip("0"):
            return at
        found = ITEM.match(text, at)
        if found is None:
            at += len(digits)
            return at + len(text[at:]) - len(text[at:].lstrip(SPACES))
        kind = found[3] or found[4] or found[5]
        each = TYPE_BYTES.get(kind[-1], number_bytes)
        numbers = NUMBERS.get(kind[0], 1) * int(digits)
        size += numbers * (1 if kind == "x" else each)
        if size > MAX_BYTES:
            return at
        items.append((int(digits), kind))
        at = found.end()


def test_events_are_numbered_by_kind_and_sizes_add_up() -> None:
    structure = Structure("7F2V7F1M3F1V")
    assert list(structure.events.items()) == [
        ("values0", (7,)),
        ("vectors0", (2, 3)),
        ("values1", (7,)),
        ("matrices0", (1, 4, 4)),
        ("values2", (3,)),
        ("vectors1", (1, 3)),
    ]
    assert structure.matrices == ("matrices0",)
    assert structure.size == (7 + 6 + 7 + 16 + 3 + 3) * 8
    assert structure.text == "7F2V7F1M3F1V"
    assert Structure("7F2V7F1M3F1V", is_double=False).size == 42 * 4


def test_documented_example_has_the_stated_events_and_size() -> None:
    structure = Structure("7F1V7F1M")
    assert structure.events == {
        "values0": (7,),
        "vectors0": (1, 3),
        "values1": (7,),
        "matrices0": (1, 4, 4),
    }
    assert structure.size == 264


def test_spaces_and_commas_are_allowed_between_items() -> None:
    assert Structure(" 7F, 6F\n").events == {"values0": (7,), "values1": (6,)}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "",
            "character 1: found the end, "
            "expected a count and F, V, M, T, x or a type, for example 7F1M",
        ),
        ("F", "character 1: found 'F', expected a count before 'F', as in 1F"),
        ("V", "character 1: found 'V', expected a count before 'V', as in 1V"),
        ("7FM", "character 3: found 'M', expected a count before 'M', as in 1M"),
        (
            "-7F",
            "character 1: found '-', "
            "expected a count and F, V, M, T, x or a type, for example 7F1M",
        ),
        (
            "7F;7F",
            "character 3: found ';', "
            "expected a count and F, V, M, T, x or a type, for example 7F1M",
        ),
        (
            "7",
            "character 2: found the end, "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
        ),
        (
            "7F7",
            "character 4: found the end, "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
        ),
        (
            "7X",
            "character 2: found 'X', "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
        ),
        (
            "1m",
            "character 2: found 'm', expected F, V, M, T, x or a type after a count, "
            "for example 7F1M; did you mean 'M'?",
        ),
        (
            "7F 3.5V",
            "character 5: found '.', "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
        ),
        (
            "7 7F",
            "character 3: found '7', "
            "expected F, V, M, T, x or a type after a count, for example 7F1M",
        ),
        ("7F0F", "character 3: found '0', expected a count of 1 or more"),
        ("7F00M", "character 3: found '0', expected a count of 1 or more"),
        (
            "8188F1F",
            "character 6: found '1', the packet would be too long; expected at most 65507 bytes",
        ),
        (
            "512M",
            "character 1: found '5', the packet would be too long; expected at most 65507 bytes",
        ),
    ],
)
def test_error_marks_the_first_invalid_character(text: str, message: str) -> None:
    with pytest.raises(StructureError) as caught:
        Structure(text)
    assert str(caught.value) == f"structure '{text}', {message}"
    assert caught.value.structure == text
    assert message.startswith(f"character {caught.value.position + 1}:")
    assert message.endswith(caught.value.reason)
    assert isinstance(caught.value, SeroError)
    assert isinstance(caught.value, ValueError)


TOO_LONG = "the packet would be too long; expected at most 65507 bytes"


def test_maximum_packet_size_is_that_of_udp() -> None:
    assert Structure("8188F").size == 65_504
    assert Structure("16376F", is_double=False).size == 65_504
    assert UdpReceiver(structure="16376F", is_double=False).layout.size == 65_504
    with raises_with(
        StructureError,
        position=0,
        reason=TOO_LONG,
    ):
        Structure("8189F")
    with raises_with(
        StructureError,
        position=0,
        reason=TOO_LONG,
    ):
        Structure("16377F", is_double=False)
    assert Structure("511M4V").size == 65_504
    with raises_with(
        StructureError,
        position=4,
        reason=TOO_LONG,
    ):
        Structure("511M5V")


@pytest.mark.parametrize("digits", [20, 4300, 5000])
def test_count_with_thousands_of_digits_is_rejected(digits: int) -> None:
    # Python does not convert more than 4300 digits to a number.
    with raises_with(StructureError, position=2, reason=TOO_LONG):
        Structure("1F" + "9" * digits + "F")


@given(almost_structures)
@example("٣F")
@example("7F0")
@example("0X")
@example("0M")
def test_parser_agrees_with_the_reference_recognizer(text: str) -> None:
    expected = recognise(text)
    if isinstance(expected, int):
        with pytest.raises(StructureError) as caught:
            Structure(text)
        assert caught.value.position == expected
        found = f"found '{text[expected]}'" if expected < len(text) else "found the end"
        assert f"character {expected + 1}: {found}, " in str(caught.value)
    else:
        shapes = [(n, *SHAPES.get(kind[0], ())) for n, kind in expected if kind != "x"]
        assert list(Structure(text).events.values()) == shapes


@given(st.text())
def test_arbitrary_text_raises_only_structure_errors(text: str) -> None:
    try:
        structure = Structure(text)
    except StructureError as error:
        assert 0 <= error.position <= len(text)
    else:
        assert 0 < structure.size <= MAX_BYTES


@given(items_lists, st.booleans(), st.data())
def test_doubles_are_decoded_bit_for_bit(
    items: Items, column_major: bool, data: st.DataObject
) -> None:
    n = length_of(items)
    bits = np.array(data.draw(st.lists(bit_patterns, min_size=n, max_size=n)), np.uint64)
    packet = struct.pack(f"<{n}Q", *bits.tolist())
    structure = Structure(text_of(items), column_major=column_major)
    decoded = structure.decode(packet)
    places = places_of(items, column_major=column_major)
    assert list(decoded) == list(places)
    for event, place in places.items():
        assert decoded[event].shape == structure.events[event]
        assert decoded[event].dtype == np.float64
        assert decoded[event].tobytes() == bits[place].tobytes()
    assert structure.encode(decoded) == packet


def test_signaling_nan_is_decoded_without_a_warning() -> None:
    packet = struct.pack("<I", 0x7F800001)  # NumPy would warn when it converts a signaling NaN
    assert np.isnan(Structure("1F", is_double=False).decode(packet)["values0"]).all()


@pytest.mark.slow
@given(items_lists, st.booleans(), st.data())
def test_floats_are_decoded_as_by_struct(
    items: Items, column_major: bool, data: st.DataObject
) -> None:
    n = length_of(items)
    pattern = st.one_of(st.integers(0, 2**32 - 1), st.sampled_from([0x7F800001, 0x7F800000, 1]))
    bits = data.draw(st.lists(pattern, min_size=n, max_size=n))
    packet = struct.pack(f"<{n}I", *bits)
    expected = np.array(struct.unpack(f"<{n}f", packet))
    structure = Structure(text_of(items), is_double=False, column_major=column_major)
    decoded = structure.decode(packet)
    for event, place in places_of(items, column_major=column_major).items():
        assert decoded[event].dtype == np.float64
        np.testing.assert_array_equal(decoded[event], expected[place])


@given(items_lists, st.booleans(), st.booleans(), st.data())
def test_packets_are_encoded_as_by_struct(
    items: Items, is_double: bool, column_major: bool, data: st.DataObject
) -> None:
    n = length_of(items)
    numbers = data.draw(st.lists(st.floats(-1e38, 1e38), min_size=n, max_size=n))
    structure = Structure(text_of(items), is_double=is_double, column_major=column_major)
    places = places_of(items, column_major=column_major)
    values = {event: np.array(numbers)[places[event]] for event in reversed(places)}
    packed = struct.pack(f"<{n}{'d' if is_double else 'f'}", *numbers)
    assert structure.encode(values) == packed
    assert structure.encode({event: array.tolist() for event, array in values.items()}) == packed
    again = structure.decode(packed)
    for event, array in values.items():
        rounded = array if is_double else array.astype(np.float32)
        np.testing.assert_array_equal(again[event], rounded)


def test_missing_events_are_encoded_as_zeros() -> None:
    assert Structure("2F1F").encode({"values1": [3.5]}) == struct.pack("<3d", 0.0, 0.0, 3.5)
    assert Structure("2F1F").encode({}) == bytes(24)


@pytest.mark.parametrize("column_major", [True, False])
def test_decoded_arrays_are_views_of_the_packet(column_major: bool) -> None:
    packet = bytearray(20 * 8)
    decoded = Structure("1F1V1M", column_major=column_major).decode(packet)
    packet[:] = struct.pack("<20d", *range(20))
    assert decoded["values0"].tolist() == [0.0]
    assert decoded["vectors0"].tolist() == [[1.0, 2.0, 3.0]]
    first = decoded["matrices0"][0, :, 0] if column_major else decoded["matrices0"][0, 0]
    assert first.tolist() == [4.0, 5.0, 6.0, 7.0]


def test_leading_axis_of_length_one_can_be_omitted() -> None:
    structure = Structure("1F1V1M")
    matrix = np.arange(16.0).reshape(4, 4)
    packet = structure.encode({"values0": 0.5, "vectors0": [1, 2, 3], "matrices0": matrix})
    assert packet == struct.pack("<20d", 0.5, 1, 2, 3, *matrix.T.flat)
    nested = {"values0": [0.5], "vectors0": [[1, 2, 3]], "matrices0": [matrix]}
    assert structure.encode(nested) == packet


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_packets_can_be_any_bytes_like_object(kind: type) -> None:
    assert Structure("1F").decode(kind(struct.pack("<d", -0.5)))["values0"].tolist() == [-0.5]


@pytest.mark.parametrize("length", [0, 1, 111, 113, 224])
def test_packet_of_wrong_length_is_rejected(length: int) -> None:
    with raises_with(found=length, of="bytes", expected="112 for '7F7F'"):
        Structure("7F7F").decode(bytes(length))


@pytest.mark.parametrize(
    ("text", "event", "shape", "expected"),
    [
        ("7F7F", "values1", (6,), "(7,)"),
        ("7F7F", "values0", (), "(7,)"),
        ("7F", "values0", (1, 7), "(7,)"),
        ("2V", "vectors0", (6,), "(2, 3)"),
        ("2V", "vectors0", (3,), "(2, 3)"),
        ("1V", "vectors0", (3, 1), "(1, 3) or (3,)"),
        ("2M", "matrices0", (4, 4), "(2, 4, 4)"),
        ("1M", "matrices0", (3, 3), "(1, 4, 4) or (4, 4)"),
        ("1M", "matrices0", (16,), "(1, 4, 4) or (4, 4)"),
    ],
)
def test_arrays_of_wrong_shape_are_rejected(
    text: str, event: str, shape: tuple[int, ...], expected: str
) -> None:
    with raises_with(key=event, found=shape, expected=expected):
        Structure(text).encode({event: np.zeros(shape)})


def test_unknown_event_is_rejected_by_name() -> None:
    with raises_with(UnknownName, kind="event", name="values2", near="values1"):
        Structure("7F7F").encode({"values2": np.zeros(7)})


@settings(max_examples=examples(60), deadline=None)
@given(st.integers(0, 2**32 - 1) | st.sampled_from([0x7F800001, 0xFF800000, 1, 0x7F7FFFFF]))
def test_any_float32_is_applied_or_counted_as_not_finite(bits: int) -> None:
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
