"""Encoding and decoding: every type at its limits, many packets at once, scale, checks."""

from __future__ import annotations

import math
import struct
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import StructureError
from sero_mj.data.receive.structure import Structure

LIMITS = {letter: np.iinfo(letter) for letter in "bBhHiIqQ"}


def rows_of(*packets: bytes) -> np.ndarray:
    return np.array([np.frombuffer(packet, np.uint8) for packet in packets])


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("letter", LIMITS)
def test_integers_round_trip_at_their_limits(letter: str, order: str) -> None:
    low, high = int(LIMITS[letter].min), int(LIMITS[letter].max)
    structure = Structure(f"{order}n:4{letter}")
    numbers = [low, high, 1, high - 1]
    packet = struct.pack(f"{order}4{letter}", *numbers)
    assert structure.encode({"n": numbers}) == packet
    assert structure.encode({"n": np.array(numbers, letter)}) == packet
    assert structure.decode(packet)["n"].tolist() == [float(number) for number in numbers]
    raw = structure.event_rows(rows_of(packet), "n")
    assert raw.tolist() == [numbers]
    for wrong in (low - 1, high + 1, math.nan, math.inf, float(high) * 1.01 + 1):
        with raises_with(key="n", found=wrong, expected=f"whole numbers from {low} to {high}"):
            structure.encode({"n": [0, wrong, 0, 0]})


def test_values_are_rounded_for_integer_types() -> None:
    assert Structure("3h").encode({"values0": [1.4, -1.6, 2.5]}) == struct.pack("<3h", 1, -2, 2)


@pytest.mark.parametrize("letter", "fd")
@pytest.mark.parametrize("order", "<>")
def test_floats_round_trip_at_their_limits_and_larger_values_are_rejected(
    letter: str, order: str
) -> None:
    most = float(np.finfo(letter).max)
    structure = Structure(f"{order}6{letter}")
    numbers = [most, -most, float(np.finfo(letter).smallest_subnormal), -0.0, math.inf, math.nan]
    packet = struct.pack(f"{order}6{letter}", *numbers)
    assert structure.encode({"values0": numbers}) == packet
    decoded = structure.decode(packet)["values0"]
    np.testing.assert_array_equal(decoded, numbers)
    assert math.copysign(1, decoded[3]) == -1
    if letter == "f":
        expected = "numbers from -3.40282e+38 to 3.40282e+38"
        with raises_with(key="values0", found=3.5e38, expected=expected):
            structure.encode({"values0": [0, 3.5e38, 0, 0, 0, 0]})


@pytest.mark.parametrize("byte", [0, 1, 2, 128, 255])
def test_any_nonzero_byte_is_true(byte: int) -> None:
    structure = Structure("on:1? must:1?=1")
    packet = bytes([byte, byte])
    assert structure.decode(packet)["on"].tolist() == [float(byte != 0)]
    assert structure.decode_rows(rows_of(packet))["must"].tolist() == [[float(byte != 0)]]
    assert structure.find_wrong_constants(rows_of(packet)).tolist() == [byte == 0]
    assert structure.encode({"on": [byte]}) == bytes([byte != 0, 1])


NUMBERS = "numbers in rows of equal length"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        *(
            (wrong, {"found": wrong, "expected": NUMBERS})
            for wrong in (["a", "b"], [[1, 2], [3]], [1j, 2], [None, "x"])
        ),
        ([2**70, 0], {"found": 2**70, "expected": "whole numbers from 0 to 255"}),
        ([10**400, 0], {"found": 10**400, "expected": "whole numbers from 0 to 255"}),
    ],
)
def test_values_that_are_not_numbers_are_rejected_with_the_event_name(
    given: Any, expected: dict[str, Any]
) -> None:
    with raises_with(key="level", **expected):
        Structure("level:2B").encode({"level": given})


@pytest.mark.parametrize("column_major", [True, False])
@pytest.mark.parametrize("kind", ["M", "Mf", "T", "Tf", "Td"])
def test_matrices_round_trip_in_row_and_column_major_order(kind: str, column_major: bool) -> None:
    matrix = np.arange(16.0).reshape(4, 4)
    matrix[3] = 0, 0, 0, 1
    structure = Structure(f"2{kind}", column_major=column_major)
    sent = matrix if kind[0] == "M" else matrix[:3]
    numbers = (sent.T if column_major else sent).ravel().tolist()
    letter = "f" if "f" in kind else "d"
    packet = struct.pack(f"<{2 * len(numbers)}{letter}", *numbers, *numbers)
    assert structure.encode({"matrices0": [matrix, matrix]}) == packet
    assert structure.decode(packet)["matrices0"].tolist() == [matrix.tolist()] * 2


def test_omitted_last_row_must_be_0_0_0_1() -> None:
    structure = Structure("1T")
    with raises_with(
        key="matrices0", reason="found last row [0, 0.5, 0, 1]", expected="[0, 0, 0, 1]"
    ):
        structure.encode({"matrices0": np.eye(4) + np.outer([0, 0, 0, 1], [0, 0.5, 0, 0])})
    nothing = np.full((1, 4, 4), np.nan)
    frame = structure.decode(structure.encode({"matrices0": nothing}))["matrices0"][0]
    assert np.isnan(frame[:3]).all()
    assert frame[3].tolist() == [0, 0, 0, 1]


def test_scale_applies_to_floats_and_matrix_positions_only() -> None:
    structure = Structure("1d 1i 1V 1M 1T mode:1d=4", scale=0.5, column_major=False)
    matrix = np.arange(1.0, 17.0).reshape(4, 4)
    frame = matrix.copy()
    frame[3] = 0, 0, 0, 1
    packet = struct.pack("<di3d16d12dd", 3, 3, 1, 2, 3, *matrix.ravel(), *frame[:3].ravel(), 4)
    halved, halved_frame = matrix.copy(), frame.copy()
    halved[:3, 3] /= 2
    halved_frame[:3, 3] /= 2
    values = structure.decode(packet)
    assert values["values0"].tolist() == [1.5]
    assert values["values1"].tolist() == [3.0]
    assert values["vectors0"].tolist() == [[0.5, 1.0, 1.5]]
    assert values["matrices0"].tolist() == [halved.tolist()]
    assert values["matrices1"].tolist() == [halved_frame.tolist()]
    assert values["mode"].tolist() == [4.0]
    assert structure.encode(values) == packet
    assert not structure.find_wrong_constants(rows_of(packet)).any()


def test_value_that_scale_makes_infinite_is_detected() -> None:
    rows = rows_of(struct.pack("<d", 1e308), struct.pack("<d", 1.0), struct.pack("<d", math.nan))
    assert Structure("1F", scale=100.0).find_not_finite(rows).tolist() == [True, False, True]
    assert Structure("1F", scale=0.01).find_not_finite(rows).tolist() == [False, False, True]
    for text, event, array in (("1d", "values0", [1e308]), ("1M", "matrices0", np.eye(4) * 1e308)):
        with raises_with(
            key=event,
            found=1e308,
            expected="a smaller number, because it is divided by scale 1e-10",
        ):
            Structure(text, scale=1e-10).encode({event: np.array(array)[..., ::-1]})
    with raises_with(key="values0", found=[10**400], expected=NUMBERS):
        Structure("1d").encode({"values0": [10**400]})


@given(st.lists(st.binary(min_size=95, max_size=95), min_size=1, max_size=5), st.booleans(),
       st.sampled_from([1.0, 0.001]))  # fmt: skip
def test_decoding_rows_equals_decoding_single_packets(
    packets: list[bytes], column_major: bool, scale: float
) -> None:
    text = ">h:1H 1x 2f 1Vf on:3? <1Tf, 1q >1d"
    structure = Structure(text, column_major=column_major, scale=scale)
    assert structure.size == 2 + 1 + 8 + 12 + 3 + 48 + 8 + 8
    packets = [packet[: structure.size] for packet in packets]
    wider = np.zeros((len(packets), structure.size + 3), np.uint8)
    wider[:, : structure.size] = rows_of(*packets)
    for rows in (rows_of(*packets), wider):
        decoded = structure.decode_rows(rows)
        for i, packet in enumerate(packets):
            for event, array in structure.decode(packet).items():
                assert decoded[event].dtype == array.dtype == np.float64
                assert decoded[event].shape[1:] == array.shape == structure.events[event]
                np.testing.assert_array_equal(decoded[event][i], array)


@pytest.mark.parametrize("bits", [0x7FF0000000000001, 0xFFF7FFFFFFFFFFFF, 0x7FF8DEADBEEF0001])
@pytest.mark.parametrize("text", ["1F", "1V", "1M", ">1F", "1F1f"])
def test_nan_bits_are_preserved_in_float64(bits: int, text: str) -> None:
    structure = Structure(text)
    order = ">" if text[0] == ">" else "<"
    packet = struct.pack(f"{order}Q", bits).ljust(structure.size, b"\0")
    event = next(iter(structure.events))
    for array in (structure.decode(packet)[event], structure.decode_rows(rows_of(packet))[event]):
        assert struct.pack("<d", 0) != array.tobytes()[:8] == struct.pack("<Q", bits)


def test_only_little_endian_float64_is_decoded_without_a_copy() -> None:
    structure = Structure("2F 1V 1M 1f >1d", column_major=True)
    packet = bytearray(structure.size)
    whole = np.frombuffer(packet, np.uint8)
    values = structure.decode(packet)
    shared = {event for event, array in values.items() if np.shares_memory(array, whole)}
    assert shared == {"values0", "vectors0", "matrices0"}
    rows = np.zeros((3, structure.size + 1), np.uint8)
    decoded = structure.decode_rows(rows)
    assert {e for e, array in decoded.items() if np.shares_memory(array, rows)} == shared
    with pytest.raises(ValueError, match="read-only"):
        structure.decode(bytes(packet))["values0"][0] = 1.0


@pytest.mark.parametrize(
    ("text", "sent", "order"),
    [("1H=0x2006 1F", ">H", ">"), (">1I=0xCAFE0006 1F", "<I", "<"), ("1q=-2 1F", ">q", ">")],
)
def test_constant_in_the_other_byte_order_is_recognized(text: str, sent: str, order: str) -> None:
    structure = Structure(text)
    constant = {"H": 0x2006, "I": 0xCAFE0006, "q": -2}[sent[1]]
    packet = struct.pack(sent, constant).ljust(structure.size, b"\0")
    told = structure.describe_wrong_constant(rows_of(packet))
    assert told.endswith(f"is '{order}' missing in the structure?")
    assert "missing" not in structure.describe_wrong_constant(rows_of(bytes(structure.size)))


def test_constants_and_size_are_encoded_checked_and_described() -> None:
    structure = Structure("1H=0x2006 size:1H=size 2b=-3 1F mode:1f=0.1 1Q=0xffffffffffffffff")
    packet = structure.encode({"values0": [1.5]})
    assert packet == struct.pack("<HH2bdfQ", 0x2006, 26, -3, -3, 1.5, 0.1, 2**64 - 1)
    assert structure.describe_wrong_constant(rows_of(packet)) == ""
    assert structure.decode(packet)["size"].tolist() == [26.0]
    assert list(structure.events) == ["size", "values0", "mode"]
    for place, byte, told in (
        (0, 5, "at byte 0 is 8197 (0x2005); expected 8198 (0x2006)"),
        (2, 27, "size at byte 2 is 27 (0x1b); expected 26 (0x1a)"),
        (5, 4, "at byte 5 is 4"),
        (17, 0x42, "mode at byte 14 is 102.4"),
        (25, 0xFE, "at byte 18 is 18374686479671623679 (0xfeffffffffffffff)"),
    ):
        wrong = bytearray(packet)
        wrong[place] = byte
        rows = rows_of(packet, bytes(wrong))
        assert structure.find_wrong_constants(rows).tolist() == [False, True]
        assert structure.describe_wrong_constant(rows[1:]).startswith(told)
    assert (
        structure.encode({"size": [26], "mode": np.float32(0.1)})
        == packet[:6] + bytes(8) + (packet[14:])
    )
    expected = f"26 (0x1a), as declared in '{structure.text}'"
    with raises_with(key="size", reason="found 27 (0x1b)", expected=expected):
        structure.encode({"size": [27]})


def test_numpy_reads_packets_with_the_dtype() -> None:
    structure = Structure("1H=7 2f >n:1I 1T 1x")
    values = {"values0": [1, 2], "n": [3], "matrices0": np.eye(4)}
    (record,) = np.frombuffer(structure.encode(values), structure.dtype)
    assert record["values0"].tolist() == [1, 2]
    assert record["n"].tolist() == [3]
    assert record["matrices0"].shape == (1, 3, 4)


def test_size_fields_hold_the_size_of_the_whole_packet() -> None:
    assert Structure("1B=size 1x 253B").fields[0].constant == 255
    holds = "expected a type with this range, for example 1H=size"
    told = f"the packet has 256 bytes; {holds}"
    with raises_with(StructureError, position=3, reason=told):
        Structure("1B=size 1x 254B")
    assert Structure("1b=size 126B").size == 127
    with raises_with(StructureError, position=3, reason=told.replace("256", "128")):
        Structure("1b=size 127B")
