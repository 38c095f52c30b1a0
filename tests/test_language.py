"""The structure language with names, byte orders, checks and alignment, compared with `struct`."""

from __future__ import annotations

import math
import random
import struct
from dataclasses import dataclass

import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import StructureError
from sero_mj.data.receive.language import parse
from sero_mj.data.receive.structure import Structure
from sero_mj.data.receive.udp import UdpReceiver

CHECK = "expected a number, the word size or a checksum, for example 1H=0x2006 or 1H=CRC-16/MODBUS"
LETTERS = "fdbBhHiIqQ?"
PER_KIND = {"F": 1, "V": 3, "M": 16, "T": 12}
SHAPES: dict[str, tuple[int, ...]] = {"F": (), "V": (3,), "M": (4, 4), "T": (4, 4)}
EVENTS = {"F": "values", "V": "vectors", "M": "matrices", "T": "matrices"}


@dataclass
class Wanted:
    """An item of a generated structure."""

    count: int
    kind: str  # F, V, M, T, or x
    type: str  # a letter; empty for the default
    order: str  # < or >; empty for no change
    name: str
    check: str  # text after =, or empty
    gap: str

    def text(self) -> str:
        kind = self.kind if self.kind != "F" or not self.type else ""
        name = f"{self.name} : " if self.name else ""
        check = f" = {self.check}" if self.check else ""
        return f"{self.order}{self.gap} {name}{self.count}{kind}{self.type}{check}"


@st.composite
def wanted_items(draw: st.DrawFn) -> list[Wanted]:
    items = [Wanted(1, "F", "", "", "", "", "")]  # at least one item creates an event
    for i in range(draw(st.integers(0, 6))):
        kind = draw(st.sampled_from("FFFVMTx"))
        type_ = "" if kind == "x" else draw(st.sampled_from(["", *LETTERS]))
        check = ""
        if kind in "FV" and draw(st.booleans()):
            check = draw(st.sampled_from(["0", "1", "0x1", "+1", "1.0", "1e0"]))
            if type_ not in ("", *"bB?") and draw(st.booleans()):
                check = "size"
        name = f"field_{i}" if kind != "x" and draw(st.booleans()) else ""
        order = draw(st.sampled_from(["", "", "<", ">", "!"]))
        gap = draw(st.sampled_from(["", " ", ",", "\n", " , "]))
        items.append(Wanted(draw(st.integers(1, 4)), kind, type_, order, name, check, gap))
    return items


@given(wanted_items(), st.booleans(), st.sampled_from([1, 2, 4, 8]))
def test_offsets_equal_those_of_struct(
    wanted: list[Wanted], is_double: bool, alignment: int
) -> None:
    text = "".join(item.text() for item in wanted)
    structure = Structure(text, is_double=is_double, alignment=alignment)
    at, order, numbered = 0, "<", dict.fromkeys(EVENTS.values(), 0)
    events: dict[str, tuple[int, ...]] = {}
    for item, field in zip(wanted, structure.fields, strict=True):
        while at % alignment:  # a simple reference implementation
            at += 1
        order = {"": order, "!": ">"}.get(item.order, item.order)
        letter = "s" if item.kind == "x" else item.type or ("d" if is_double else "f")
        numbers = item.count * PER_KIND.get(item.kind, 1)
        assert field.offset == at
        at += struct.calcsize(f"{order}{numbers}{letter}")
        assert field.end == at
        assert np.dtype(field.type).newbyteorder("<") == np.dtype(
            {"s": "u1", "?": "u1"}.get(letter, letter)
        )
        if field.item_bytes > 1:
            assert field.type[0] == order
        if item.kind == "x":
            continue
        name = item.name
        if not name and not item.check:
            kind = EVENTS[item.kind]
            name = f"{kind}{numbered[kind]}"
            numbered[kind] += 1
        assert field.name == name
        assert field.is_bool == (letter == "?")
        assert (field.constant is not None) == bool(item.check)
        if name:
            events[name] = (item.count, *SHAPES[item.kind])
    assert structure.size == at
    assert structure.events == events
    assert list(structure.events) == list(events)
    for item, field in zip(wanted, structure.fields, strict=True):
        if item.check:
            assert field.constant == (at if item.check == "size" else 1 if "1" in item.check else 0)
    packet = structure.encode({})
    assert not structure.find_wrong_constants(np.frombuffer(packet, np.uint8)[None]).any()
    for item, field in zip(wanted, structure.fields, strict=True):
        if item.check:
            letter = item.type or ("d" if is_double else "f")
            byte_order = ">" if field.type[0] == ">" else "<"
            found = struct.unpack_from(f"{byte_order}{field.numbers}{letter}", packet, field.offset)
            assert found == (field.constant,) * field.numbers


EXPECTED = "expected a count and F, V, M, T, x or a type, for example 7F1M"


@pytest.mark.parametrize(
    ("text", "character", "reason"),
    [
        ("joints:7", 9, "expected F, V, M, T, x or a type after a count, for example 7F1M"),
        ("joints:F", 8, "expected a count before 'F', as in 1F"),
        ("joints 7F", 1, EXPECTED),
        ("7Fjoints:7F", 3, "expected a space or a comma before a name"),
        ("1H=5joints:7F", 5, "expected a space or a comma before a name"),
        ("a:1F a:1F", 6, "two items have the name 'a'"),
        ("a:1F a:1F=1", 6, "two items have the name 'a'"),
        ("values0:7F", 1, "the name 'values0' is reserved; expected another name"),
        ("7F receiving:1F", 4, "the name 'receiving' is reserved; expected another name"),
        ("1F pad:4x", 4, "skipped bytes cannot have a name"),
        ("1F 4x=0", 6, "skipped bytes cannot be checked; expected a type, for example 1B=0"),
        ("4x", 3, "expected an item that creates an event"),
        ("1H=0x2006", 10, "expected an item that creates an event"),
        ("=7F", 1, "expected < (little-endian) or > (big-endian)"),
        ("7F @7F", 4, "expected < (little-endian) or > (big-endian)"),
        ("1M = 1", 4, "a matrix cannot be checked against one number"),
        ("1T=size", 3, "a matrix cannot be checked against one number"),
        ("1H= ", 5, CHECK),
        ("1H=sizes 1F", 4, f"{CHECK}; did you mean 'size'?"),
        ("1H=abcdefgh 1F", 4, CHECK),
        ("1H=7x", 5, "expected a count before 'x', as in 1x"),
        ("1H=1.5", 4, "expected a whole number for this type"),
        ("1H=65536", 4, "expected a number from 0 to 65535"),
        ("1H=-1", 4, "expected a number from 0 to 65535"),
        ("1b=-129", 4, "expected a number from -128 to 127"),
        ("1?=2", 4, "expected a number from 0 to 1"),
        ("1Q=18446744073709551616", 4, "expected a number from 0 to 18446744073709551615"),
        ("1q=9223372036854775808", 4,
         "expected a number from -9223372036854775808 to 9223372036854775807"),
        ("1H=1e999", 4, "expected a number from 0 to 65535"),
        ("1d=1e999", 4, "expected a number from -1.79769e+308 to 1.79769e+308"),
        ("1f=-4e38", 4, "expected a number from -3.40282e+38 to 3.40282e+38"),
        ("1H=" + "9" * 5000, 4, "expected a number of at most 40 characters"),
        ("1B=size 70F", 4,
         "the packet has 561 bytes; expected a type with this range, for example 1H=size"),
        ("1F arm:9000F", 8, "the packet would be too long; expected at most 65507 bytes"),
    ],
)  # fmt: skip
def test_error_has_position_and_expected_text(text: str, character: int, reason: str) -> None:
    with pytest.raises(StructureError) as caught:
        Structure(text)
    assert (caught.value.position + 1, caught.value.reason) == (character, reason)


def test_alignment_padding_counts_toward_the_size_limit() -> None:
    text = " ".join(["1B"] * 8190)
    assert Structure(text, alignment=4).size == 8189 * 4 + 1
    reason = "the packet would be too long; expected at most 65507 bytes"
    with raises_with(
        StructureError, position=3 * 8189, reason=reason
    ):  # the item would begin at 65512
        Structure(text, alignment=8)


@pytest.mark.parametrize(
    ("key", "found", "expected"),
    [
        ("alignment", 3, "1, 2, 4 or 8"),
        ("alignment", 0, "1, 2, 4 or 8"),
        ("scale", 0.0, "a finite number above 0"),
        ("scale", -1.0, "a finite number above 0"),
        ("scale", math.nan, "a finite number above 0"),
        ("scale", math.inf, "a finite number above 0"),
    ],
)
def test_invalid_options_are_rejected(key: str, found: float, expected: str) -> None:
    with raises_with(key=key, found=found, expected=expected):
        Structure("1F", **{key: found})  # type: ignore[arg-type]


def test_byte_pack_example_has_documented_offsets() -> None:
    text = "1B 1I 1f 1h 1d"
    packed, aligned = Structure(text), Structure(text, alignment=4)
    assert [field.offset for field in aligned.fields] == [0, 4, 8, 12, 16]
    assert [field.offset for field in packed.fields] == [0, 1, 5, 9, 11]
    assert (aligned.size, packed.size) == (24, 19)
    values = {f"values{i}": [i + 1] for i in range(5)}
    assert aligned.encode(values) == struct.pack("<B3xIfh2xd", 1, 2, 3, 4, 5)
    assert packed.encode(values) == struct.pack("<BIfhd", 1, 2, 3, 4, 5)


def test_size_limit_uses_the_declared_float_type() -> None:
    receiver = UdpReceiver(structure="n:1I 16000F", double=False, sequence="n")
    assert receiver.size == 64_004


def test_random_strings_raise_only_structure_errors() -> None:
    randomly = random.Random(2006)
    alphabet = "0123456789" * 2 + "FVMTxfdbBhHiIqQ?<>!=:, _ae.+-" * 2 + "size0x²٣é\n\0"
    parsed = 0
    for _ in range(30_000):
        text = "".join(randomly.choices(alphabet, k=randomly.randint(0, 14)))
        try:
            items = parse(text, alignment=randomly.choice((1, 8)))
        except StructureError as error:
            assert 0 <= error.position <= len(text)
        else:
            parsed += 1
            assert 0 < items[-1].end <= 65_507
    assert parsed > 100
