"""Guesses of structures, for packets with a known structure."""

from __future__ import annotations

import math
import re
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.base.frames import rotation_from_rpy
from sero_mj.data.receive.structure import Structure
from sero_mj.extensions.sniff.guess import (
    describe_bytes,
    find_frames,
    guess_layouts,
    plausibility,
    recognize,
)

JOINTS = np.random.default_rng(7).normal(size=(6, 14))
FRAME = np.eye(4)
FRAME[:3, :3], FRAME[:3, 3] = rotation_from_rpy(np.array([0.1, 0.7, -2.0])), (0.5, 0.1, 0.4)
FRAMES = np.tile(FRAME, (6, 1, 1))


def as_rows(*parts: np.ndarray) -> np.ndarray:
    return np.hstack(
        [np.ascontiguousarray(part.reshape(len(part), -1)).view(np.uint8) for part in parts]
    )


def counted(letter: str, first: int = 250) -> np.ndarray:
    return np.arange(first, first + 6).astype(f"<{letter}")[:, None]


@pytest.mark.parametrize(
    ("rows", "structure", "is_double", "column_major"),
    [
        (as_rows(JOINTS), "7F7F", True, True),
        (as_rows(JOINTS.astype("<f4")), "7F7F", False, True),
        (as_rows(JOINTS.astype(">f8")), ">7F7F", True, True),
        (as_rows(JOINTS.astype(">f4")), ">7F7F", False, True),
        (as_rows(JOINTS[:, :7]), "7F", True, True),
        (as_rows(JOINTS, FRAMES.swapaxes(1, 2)), "7F7F1M", True, True),
        (as_rows(JOINTS[:, :7], FRAMES, JOINTS[:, :3]), "7F1M3F", True, False),
        (as_rows(FRAMES.astype("<f4"), FRAMES.astype("<f4")), "1M1M", False, False),
        (as_rows(counted("u4"), JOINTS), "number:1I 7F7F", True, True),
        (as_rows(counted("u8"), JOINTS), "number:1Q 7F7F", True, True),
        (as_rows(counted("u2"), np.full((6, 1), 60, "<u2"), JOINTS.astype("<f4")),
         "number:1H 1H=size 7F7F", False, True),
        (as_rows(counted("u2", 65_533), counted("u2"), JOINTS), "number:1H 1H 7F7F", True, True),
        (as_rows(JOINTS.astype("<f4"))[:1], "7F7F", False, True),
        # A single packet shows a header before the numbers, but not that it is a counter.
        (as_rows(counted("u4", 10**9), JOINTS)[:1], "1I 7F7F", True, True),
        (as_rows(counted("u4", 10**9), JOINTS.astype(">f8"))[:1], "1I >7F7F", True, True),
        (as_rows(counted("u2").astype(">u2"), JOINTS[:, :12].astype(">f8")),
         ">number:1H 6F6F", True, True),
        (as_rows(counted("u2", 65_533).astype(">u2"), np.full((6, 1), 60, ">u2"),
                 JOINTS.astype(">f4")), ">number:1H 1H=size 7F7F", False, True),
        (as_rows(counted("u4", 60_000).astype(">u4"), JOINTS), ">number:1I <7F7F", True, True),
        (as_rows(counted("u8").astype(">u8"), np.zeros((6, 14), ">f8")),
         ">number:1Q 7F7F", True, True),
        # Zeros are plausible, and few digits do not indicate float32.
        (np.zeros((3, 112), np.uint8), "7F7F", True, True),
        (as_rows(np.tile([0.5, 1.0, -2.0, 0.25], (4, 1))), "2F2F", True, True),
    ],
)  # fmt: skip
def test_first_guess_is_correct(
    rows: np.ndarray, structure: str, is_double: bool, column_major: bool
) -> None:
    first, *others = guess_layouts(rows)
    found = (first.structure, first.is_double, first.column_major)
    assert found == (structure, is_double, column_major)
    assert first.plausible > 0.99
    for guess in (first, *others):
        assert Structure(guess.structure, is_double=guess.is_double).size == rows.shape[1]


FLAG = np.array([[0], [1], [1], [0], [0], [1]], np.uint8)
MODE = np.full((6, 1), 0x0234, "<u2")
SMOOTH = np.sin(np.arange(6)[:, None] / 50.0 + np.arange(14))


@pytest.mark.parametrize(
    ("rows", "structure", "about"),
    [
        (as_rows(JOINTS, FLAG), "7F7F 1B", "float64: 7 joints twice, 1 byte"),
        (as_rows(JOINTS, FLAG, np.zeros((6, 7), np.uint8)), "7F7F 1B 7x",
         "float64: 7 joints twice, 1 byte, 7 bytes of padding"),
        (as_rows(SMOOTH, FLAG, np.zeros((6, 7), np.uint8)), "7F7F 1B 7x",
         "float64: 7 joints twice, 1 byte, 7 bytes of padding"),
        (as_rows(FLAG, JOINTS.astype("<f4")), "1B 7F7F", "1 byte, float32: 7 joints twice"),
        (as_rows(JOINTS.astype(">f8"), FLAG), ">7F7F 1B",
         "big-endian float64: 7 joints twice, 1 byte"),
        (as_rows(counted("u4"), JOINTS[:, :1], JOINTS[:, :7].astype("<f4"), FLAG),
         "number:1I 1d 7f 1B", "a counter, 1 float64, 7 float32, 1 byte"),
        (as_rows(MODE, JOINTS[:, :7], counted("u4")), "1H 7F number:1I",
         "1 uint16, float64: 7 numbers, a counter"),
        (as_rows(counted("u4"), (1000 * JOINTS[:, :7]).astype("<i4")), "number:1I 7i",
         "a counter, 7 int32"),
    ],
)  # fmt: skip
def test_numbers_of_several_types_are_distinguished(
    rows: np.ndarray, structure: str, about: str
) -> None:
    first, *_ = guess_layouts(rows)
    assert (first.structure, first.about) == (structure, about)
    layout = Structure(first.structure, is_double=first.is_double)
    assert layout.size == rows.shape[1]
    assert first.plausible > 0.9


@pytest.mark.parametrize(
    ("structure", "size", "reported"),
    [
        ("7F7F1B", 120, "with 7x at its end it has 120"),
        ("7F7F", 56, "with double = false it has 56"),
        ("1I 7F", 64, "with alignment = 8 it has 64"),
        ("1I 7F", 62, ""),
        ("1B 7F 1B", 72, "with alignment = 8 and 7x at its end it has 72"),
        ("7F", 57, ""),
        ("7F", 48, ""),
    ],
)
def test_different_size_is_explained_by_options(structure: str, size: int, reported: str) -> None:
    assert Structure(structure).explain_size(size) == reported


def test_112_bytes_are_14_doubles_or_28_floats() -> None:
    rows = as_rows(JOINTS)
    guesses = {guess.about: guess for guess in guess_layouts(rows)}
    assert list(guesses) == ["float64: 7 joints twice", "float32: 14 joints twice"]
    assert guesses["float64: 7 joints twice"].plausible == 1.0
    assert 0.4 < guesses["float32: 14 joints twice"].plausible < 0.8


def test_other_byte_order_is_proposed_only_if_more_plausible() -> None:
    assert not any(">" in guess.structure for guess in guess_layouts(as_rows(JOINTS)))
    swapped = guess_layouts(as_rows(JOINTS.astype(">f8")))
    assert swapped[0].about == "big-endian float64: 7 joints twice"
    assert swapped[-1].plausible < 0.2


@pytest.mark.parametrize(
    ("numbers", "structure", "about"),
    [
        (9, "3F3F3F", "float64: 3 joints three times"),
        (12, "6F6F", "float64: 6 joints twice (or 4 joints three times: 4F4F4F)"),
        (14, "7F7F", "float64: 7 joints twice"),
        (11, "11F", "float64: 11 numbers"),
    ],
)
def test_two_and_three_values_per_joint_are_both_proposed(
    numbers: int, structure: str, about: str
) -> None:
    guess = guess_layouts(as_rows(np.random.default_rng(1).normal(size=(8, numbers))))[0]
    assert (guess.structure, guess.about) == (structure, about)


@pytest.mark.extensions
def test_commercial_robots_are_recognized_by_size_and_header() -> None:
    packet = bytearray(np.full(229, 0.5, "<f4").tobytes())
    rows = np.frombuffer(packet, np.uint8)[None]
    assert [guess.about for guess in guess_layouts(rows)] == [
        "float32: 229 numbers", "KUKA FRI, measured data (LWR 4)",
    ]  # fmt: skip
    packet[4:8] = struct.pack("<2H", 916, 0x2006)
    first, *_ = guess_layouts(rows)
    assert first.about == "KUKA FRI, measured data (LWR 4)"
    assert (first.is_double, first.column_major, first.plausible) == (False, False, 1.0)


@pytest.mark.parametrize(("size", "most"), [(1, 0), (3, 0), (13, 0), (4, 2), (6, 1), (4_096, 4)])
def test_guesses_fit_packets_of_any_size(size: int, most: int) -> None:
    rows = np.random.default_rng(size).integers(0, 256, (5, size), np.uint8)
    guesses = guess_layouts(rows)
    assert bool(guesses) == bool(most)
    assert len(guesses) <= 4
    for guess in guesses:
        assert Structure(guess.structure, is_double=guess.is_double).size == size
        assert 0.0 <= guess.plausible <= 1.0


def packed(letters: str, order: str) -> np.ndarray:
    """Sixteen packets: `N` is a counter of eight bytes, `B` a bit, and other numbers are smooth."""
    packets = []
    for k in range(16):
        numbers: list[float] = []
        for i, letter in enumerate(letters.replace("x", "")):
            value = math.sin(k / 50.0 + i + 0.3)
            whole = int(1000.0 * value) if letter in "hiq" else (k + i) % 2
            numbers.append({"d": value, "f": value, "N": 1000 + k}.get(letter, whole))
        packets.append(struct.pack(order + letters.replace("N", "Q"), *numbers))
    return np.array([[*packet] for packet in packets], np.uint8)


@settings(max_examples=60, deadline=None)
@given(st.text("NdfqQiIhHB?x", min_size=1, max_size=30), st.sampled_from("<>"))
def test_guesses_fit_mixed_types(letters: str, order: str) -> None:
    rows = packed(letters, order)
    for guess in guess_layouts(rows):
        assert Structure(guess.structure, is_double=guess.is_double).size == rows.shape[1]
        assert guess.about


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.integers(5, 8), min_size=2, max_size=3),
    st.sampled_from(["df", "fd"]),
    st.sampled_from("<>"),
)
def test_counter_and_runs_of_two_types_are_recognized(
    counts: list[int], pair: str, order: str
) -> None:
    runs = [(count, pair[i % 2]) for i, count in enumerate(counts)]
    rows = packed("N" + "".join(count * letter for count, letter in runs), order)
    expected = "number:1Q " + " ".join(f"{count}{letter}" for count, letter in runs)
    assert expected in [re.sub("^>", "", guess.structure) for guess in guess_layouts(rows)]


def test_plausibility_counts_magnitudes_from_1e_minus_6_to_1e6() -> None:
    numbers = np.array([[1e-6, -1e6, 0.0, -0.0], [9e-7, 1.1e6, math.nan, -math.inf]])
    assert plausibility(numbers) == (2 / 6, 2)
    assert plausibility(np.zeros((2, 2))) == (1.0, 0)


def test_frames_are_found_if_all_packets_have_them() -> None:
    numbers = np.hstack([JOINTS[:, :2], FRAMES.reshape(6, 16), FRAMES.reshape(6, 16)])
    assert find_frames(numbers) == ([2, 18], False)
    numbers[3, 4] += 0.5  # the first frame is invalid in one packet
    assert find_frames(numbers) == ([18], False)
    assert find_frames(JOINTS) == ([], True)


@pytest.mark.parametrize(
    ("packet", "words"),
    [
        (b"", "empty"),
        (bytes(5), "only zeros"),
        (
            b'<Rob Type="KUKA">\r\n</Rob>',
            'XML, which a structure cannot describe: <Rob Type="KUKA"> </',
        ),
        (b'{"joint": 1}', 'JSON, which a structure cannot describe: {"joint": 1}'),
        (b"movej 1 2 3", "text, which a structure cannot describe: movej 1 2 3"),
        (b"   ", "text, which a structure cannot describe:  "),
        (struct.pack("<d", 0.1), ""),
    ],
)
def test_text_and_zeros_are_described(packet: bytes, words: str) -> None:
    described = describe_bytes(np.frombuffer(packet, np.uint8)[None])
    assert described.startswith(words) and bool(described) == bool(words)


@pytest.mark.parametrize(
    "text",
    [
        "number:1I 7F7F 1H=CRC-16/MODBUS",
        "number:1H 1H=size 7F7F >1H=CRC-16/IBM-3740[2:]",
        "7F7F 1B=sum",
        ">number:1H 7F7F 1I=CRC-32/ISO-HDLC",
    ],
)
def test_recognized_checksum_is_proposed(text: str) -> None:
    structure = Structure(text)
    packets = []
    for k in range(16):
        numbers = {event: np.sin(0.3 * k + np.arange(7)) for event in ("values0", "values1")}
        count = {"number": 1000 + k} if "number" in structure.events else {}
        packets.append(structure.encode({**numbers, **count}))
    first, *_ = guess_layouts(np.stack([np.frombuffer(packet, np.uint8) for packet in packets]))
    assert (first.structure, first.is_double) == (text, True)
    assert text.partition("=CRC")[2].partition("[")[0] in first.about


def test_no_checksum_is_recognized_in_packets_without_one() -> None:
    random = np.random.default_rng(3)
    rows = random.integers(0, 256, (16, 40), np.uint8)
    assert recognize(rows) is None
    assert recognize(np.zeros((16, 40), np.uint8)) is None
    rows[:] = 7
    rows[:, 0] = rows[:, -1] = np.arange(16)  # two counters; the second is a sum of the first
    rows[:, 1:-1] = 0
    assert recognize(rows) is None
    assert recognize(rows[:1]) is None
