"""Guesses a layout of doubles, floats, integers, padding and counters in one packet.

An item of any type may begin at every byte of a packet. Its cost is the number of bits that encode
its numbers if they have the usual values of the type. The guess is the layout with the lowest cost
(minimum description length; Rissanen 1978). Constant numbers and counters cost almost nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from ...data.receive.structure import Rows

SMALLEST, LARGEST = 1e-6, 1e6  # magnitudes of plausible measurements in SI units
_MAX_BYTES = 2048
_NEW_TYPE, _NEW_ITEM = 8.0, 1.0  # costs of a change of type and of an item, bits
_MAX_RAW = 0.25  # share of unexplained bytes above which no guess is made
# NumPy's type, and the bits of a number of usual magnitude (of the 2,048 exponents of a double, 40
# are from 1e-6 to 1e6) or the largest usual integer.
_FLOATS = {"d": ("f8", 58.0), "f": ("f4", 29.0)}
_INTEGERS = {"I": ("u4", 2**16), "i": ("i4", 2**16), "H": ("u2", 2**12), "h": ("i2", 2**12),
             "B": ("u1", 2**4)}  # fmt: skip
_WIDTHS = {"Q": 8, "I": 4, "H": 2, "B": 1}
# Bits of a zero, of the same number as in the previous packet, and of that number plus one.
# The last entry is the number of additional bits of an unusual number.
_ZERO, _SAME, _COUNTED, _UNUSUAL = 2.0, 1.0, 1.0, 4.0
_EXPONENT_BITS = 3.0  # bits of the exponent that stay the same in a smooth signal
_PADDING_BITS = 0.5  # bits of an always-zero byte


@dataclass(frozen=True)
class Run:
    """Adjacent items of one type; `letter` is its letter in structures, or `x` for padding."""

    letter: str
    count: int
    is_counter: bool = False


def mixed_layout(rows: Rows) -> tuple[str, list[Run], float] | None:
    """Guesses the layout of consecutive packets from one sender, shape (n, size).

    Returns:
        Byte order (`<` or `>`), layout, and share of the bytes with usual values; None if too many
        bytes are unusual, or the packets have neither floating-point numbers nor a counter.
    """
    if not 0 < rows.shape[1] <= _MAX_BYTES:
        return None
    found = [(*_cheapest(rows, order), order) for order in "<>"]
    _, runs, raw, order = min(found, key=lambda each: each[0])
    has_floats = any(run.letter in _FLOATS for run in runs)
    if raw > _MAX_RAW * rows.shape[1] or not (has_floats or any(run.is_counter for run in runs)):
        return None
    step = 1 if order == "<" else -1  # from the low bytes of a number to its high ones
    return order, _wide_counters(runs[::step])[::step], 1.0 - raw / rows.shape[1]


def _wide_counters(runs: list[Run]) -> list[Run]:
    result: list[Run] = []
    for run in runs:
        last, left = result[-1] if result else None, run.count
        if run.letter == "x" and last is not None and last.is_counter:
            left += _WIDTHS[last.letter]
            letter = next(each for each in _WIDTHS if _WIDTHS[each] <= left)
            result[-1] = Run(letter, 1, True)
            left -= _WIDTHS[letter]
        if left:
            result.append(Run(run.letter, left, run.is_counter))
    return result


@dataclass(frozen=True, eq=False)
class _Kind:
    """The cost of an item of one type at each of k bytes; arrays have the shape (k,)."""

    width: int
    bits: Array
    raw: Array
    counts: NDArray[np.bool_] | None = None


def _cheapest(rows: Rows, order: str) -> tuple[float, list[Run], float]:
    n, size = rows.shape
    padding = np.where(rows.any(axis=0), np.inf, _PADDING_BITS)
    kinds = {"x": _Kind(1, np.asarray(padding, np.float64), np.zeros(size))}
    for letter, (type_, usual) in _FLOATS.items():
        values = _at_every_byte(rows, order + type_)
        with np.errstate(invalid="ignore"):  # a signalling NaN would warn
            sizes = np.abs(values.astype(np.float64))
        good = (sizes >= SMALLEST) & (sizes <= LARGEST)
        width, is_unusual = int(type_[1]), ~good & (sizes != 0)
        each = np.where(good, usual, np.where(is_unusual, 8.0 * width + _UNUSUAL, _ZERO))
        # The leading digits of smooth signals are those of the previous packet.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            change = np.abs(np.diff(values, axis=0)) / np.maximum(sizes[1:], sizes[:-1])
            less = usual - _EXPONENT_BITS + np.log2(np.clip(change, 1e-15, 1.0))
        smooth = good[1:] & good[:-1]
        each[1:] = np.where(smooth, np.maximum(less, _SAME), each[1:])
        kinds[letter] = _Kind(width, _total_bits(values, each), width * is_unusual.mean(axis=0))
    for letter, (type_, small) in _INTEGERS.items():
        values = _at_every_byte(rows, order + type_)
        width = int(type_[1])
        sizes = np.abs(values.astype(np.float64))
        usual = np.log2(small) + 2.0
        each = np.where(sizes == 0, _ZERO, np.where(sizes <= small, usual, 8.0 * width + _UNUSUAL))
        total = _total_bits(values, each)
        steps = np.diff(values, axis=0)
        counts = np.zeros(values.shape[1], bool)
        if n >= 4 and type_[0] == "u":
            counts = (steps == 1).all(axis=0)
            total = np.where(counts, each[0] + _COUNTED * (n - 1), total)
        raw = np.where(counts, 0.0, width * (sizes > small).mean(axis=0))
        kinds[letter] = _Kind(width, np.asarray(total, np.float64), raw, counts)
    best: list[dict[str, tuple[float, str]]] = [{"": (0.0, "")}]
    for end in range(1, size + 1):  # the cheapest layout up to here, by the type that ends here
        here: dict[str, tuple[float, str]] = {}
        for letter, kind in kinds.items():
            at = end - kind.width
            if at < 0 or not np.isfinite(kind.bits[at]):
                continue
            before = [(cost + (0.0 if last == letter else _NEW_TYPE), last)
                      for last, (cost, _) in best[at].items()]  # fmt: skip
            item = _NEW_ITEM if letter != "x" else 0.0
            here[letter] = min(before)[0] + item + float(kind.bits[at]), min(before)[1]
        best.append(here)
    letter = min(best[size], key=lambda each: best[size][each][0])
    cheapest, end, items, unknown = best[size][letter][0], size, [], 0.0
    while end > 0:
        kind = kinds[letter]
        at = end - kind.width
        unknown += float(kind.raw[at])
        items.append(Run(letter, 1, kind.counts is not None and bool(kind.counts[at])))
        letter, end = best[end][letter][1], at
    return cheapest, _runs(items[::-1]), unknown


def _at_every_byte(rows: Rows, type_: str) -> NDArray[np.generic]:
    width = int(type_[-1])
    if rows.shape[1] < width:
        return np.zeros((len(rows), 0), type_)
    windows = np.lib.stride_tricks.sliding_window_view(rows, width, axis=1)
    values = np.ascontiguousarray(windows).view(type_)[..., 0]
    return values.astype(values.dtype.newbyteorder("="))


def _total_bits(values: NDArray[np.generic], bits: Array) -> Array:
    with np.errstate(invalid="ignore"):  # a signalling NaN would warn
        same = values[1:] == values[:-1]
    return np.asarray(bits[0] + np.where(same, _SAME, bits[1:]).sum(axis=0))


def _runs(items: list[Run]) -> list[Run]:
    runs: list[Run] = []
    for item in items:
        last = runs[-1] if runs else None
        are_alike = last is not None and last.letter == item.letter
        if last is not None and are_alike and not (last.is_counter or item.is_counter):
            runs[-1] = Run(item.letter, last.count + 1)
        else:
            runs.append(item)
    return runs
