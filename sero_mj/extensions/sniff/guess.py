"""Guesses the structure of packets from their size and bytes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ...base.plugins import KNOWN_PACKETS, load_all
from ...data.receive.checksum import CRCS, SUMS, compute, width_of
from ...data.receive.language import TYPES
from ...data.receive.structure import Rows, Structure, are_frames
from .mixed_layout import LARGEST, SMALLEST, mixed_layout

_MAX_JOINTS = 64
_MAX_GUESSES = 4
_MAX_NUMBERS = 512  # maximum count of numbers that are searched for frames
# Minimum number of different values that a checksum must have in the packets, by size in bytes.
# Fewer values may match one of the algorithms by chance.
_MIN_DIFFERENT = {4: 2, 2: 3, 1: 8}
_BEGINS = (0, 2, 4, 1, 3)  # candidates for the first byte that a checksum covers
_HEADERS = {0: "", 2: "1H", 4: "1I", 8: "1Q", 16: "2Q"}  # structures by size in bytes
_LETTERS = {1: "B", 2: "H", 4: "I"}  # types of unsigned integers by size in bytes
_TYPES = {
    "<f8": "float64",
    "<f4": "float32",
    ">f8": "big-endian float64",
    ">f4": "big-endian float32",
}
_IN_WORDS = {
    "d": "float64", "f": "float32", "Q": "uint64", "I": "uint32", "i": "int32", "H": "uint16",
    "h": "int16", "B": "byte", "x": "byte of padding",
}  # fmt: skip


@dataclass(frozen=True)
class Guess:
    """A possible packet layout: arguments of `Structure`, and a description.

    Attributes:
        about: description of the layout.
        plausible: share of the non-zero floating-point numbers that look like measurements, 0 to 1;
            1 if there are no such numbers.
    """

    structure: str
    is_double: bool
    column_major: bool
    about: str
    plausible: float


@dataclass(frozen=True)
class Recognized:
    """A checksum of `width` bytes at the end of packets, which covers the bytes from `begin`."""

    name: str
    width: int
    order: str
    begin: int


def recognize(rows: NDArray[np.uint8]) -> Recognized | None:
    """Returns the checksum at the end of packets from one sender, shape (n, size), or None."""
    for width, minimum in _MIN_DIFFERENT.items():
        end = rows.shape[1] - width
        for order in "<>"[: min(width, 2)]:
            if end <= max(_BEGINS):
                continue
            found = np.ascontiguousarray(rows[:, end:]).view(f"{order}u{width}")[:, 0]
            if len(np.unique(found)) < minimum:
                continue
            # If only a counter varies, any sum of the bytes would follow it.
            varying = np.flatnonzero((rows[:, :end] != rows[0, :end]).any(axis=0))
            for begin in _BEGINS:
                if (varying >= begin).sum() < 2:
                    continue
                for name in (*CRCS, *SUMS):
                    if (
                        width_of(name) in (None, 8 * width)
                        and (found == compute(name, rows[:, begin:end], 8 * width)).all()
                    ):
                        return Recognized(name, width, order, begin)
    return None


def guess_layouts(rows: Rows) -> list[Guess]:
    """Returns up to four possible layouts of packets, the most likely layout first.

    `rows` contains consecutive packets from one sender, shape (n, size).
    """
    size, found = rows.shape[1], recognize(rows)
    if found is not None:
        guesses = _guess_layouts(rows[:, : size - found.width], size)
        if guesses:
            return [_with_checksum(guess, found) for guess in guesses]
    return _guess_layouts(rows, size)


def _with_checksum(guess: Guess, found: Recognized) -> Guess:
    orders = [each for each in guess.structure if each in "<>"]
    mark = "" if found.width == 1 or found.order == (orders or ["<"])[-1] else found.order
    covers = f"[{found.begin}:]" if found.begin else ""
    letter = _LETTERS[found.width]
    text = f"{guess.structure} {mark}1{letter}={found.name}{covers}"
    return replace(guess, structure=text, about=f"{guess.about}, {found.name}")


def _guess_layouts(rows: Rows, size: int) -> list[Guess]:
    header, begin = find_header(rows, size)
    first = ">" if header.startswith(">") else "<"  # the default if both fit
    fits = {}
    for start, letters in {begin: header, **({} if header else _HEADERS)}.items():
        for type_, word in _TYPES.items():
            if start < rows.shape[1] and (rows.shape[1] - start) % int(type_[-1]) == 0:
                fits[start, type_] = _with_body(rows, letters, start, type_, word)
    best = max((guess.plausible for (at, _), (_, guess) in fits.items() if at == begin), default=-1)
    ranked = [
        ranked_guess
        for (start, type_), ranked_guess in fits.items()
        # An unexplained header or another byte order must explain more numbers.
        if (start == begin or ranked_guess[1].plausible > best + 0.2)
        and (
            type_[0] == first or ranked_guess[1].plausible > _of(fits[start, f"{first}{type_[1:]}"])
        )
    ]
    guesses = [guess for _, guess in sorted(ranked, key=lambda pair: pair[0], reverse=True)]
    if not guesses or guesses[0].plausible < 1.0:
        known_ones = {guess.structure for guess in guesses}
        guesses[:0] = [each for each in _mixed(rows) if each.structure not in known_ones]
    if rows.shape[1] == size and size in (all_known := known_packets()):
        text, about = all_known[size]
        known = Structure(text, column_major=False)
        is_it = not known.find_wrong_constants(rows).any()
        rank = 0 if is_it else _MAX_GUESSES - 1
        guesses.insert(rank, Guess(text, False, False, about, float(is_it)))
    return guesses[:_MAX_GUESSES]


def known_packets() -> dict[int, tuple[str, str]]:
    """Returns the structure (row-major) and description of known packets of robots, by size."""
    found = load_all(KNOWN_PACKETS).values()
    return {size: about for packets in found for size, about in packets.items()}


def _mixed(rows: Rows) -> list[Guess]:
    found = mixed_layout(rows)
    if found is None:
        return []
    order, runs, likely = found
    floats = {run.letter for run in runs} & {"d", "f"}
    only = f"{order}f{8 if 'd' in floats else 4}" if len(floats) == 1 else None
    parts: list[str] = []
    words: list[str] = []
    column_major, at = True, 0
    for run in runs:
        letter, width = run.letter, 1 if run.letter == "x" else np.dtype(TYPES[run.letter]).itemsize
        end = at + run.count * width
        name = "number:" if run.is_counter and not any("number" in part for part in parts) else ""
        part, word = f"{name}{run.count}{letter}", _plural(run.count, _IN_WORDS[letter])
        if run.is_counter:
            word = "a counter"
        if letter in floats and only is not None:
            numbers = np.ascontiguousarray(rows[:, at:end]).view(only)
            part, by_columns, word = _body(numbers)
            column_major &= by_columns
            word = f"{_TYPES[only].removeprefix('big-endian ')}: {word}"
        parts.append(part)
        words.append(word)
        at = end
    text = " ".join(parts)
    about = ", ".join(words)
    if order == ">":
        text, about = f">{text}", f"big-endian {about}"
    return [Guess(text, only is None or only[-1] == "8", column_major, about, likely)]


def _of(ranked: tuple[tuple[float, ...], Guess]) -> float:
    return ranked[1].plausible


def _with_body(
    rows: Rows, header: str, start: int, type_: str, word: str
) -> tuple[tuple[float, ...], Guess]:
    numbers = rows[:, start:].view(type_)
    plausible, seen = plausibility(numbers)
    body, column_major, words = _body(numbers)
    about = f"{word}: {words}{f', after a header of {start} bytes' if start else ''}"
    before = ">" if header.startswith(">") else "<"  # a byte order applies to all following items
    order = type_[0] if type_[0] != before else ""
    structure = f"{header} {order}{body}" if header else order + body
    guess = Guess(structure, type_[-1] == "8", column_major, about, plausible)
    # float64 numbers with few digits also look like float32, but then half of those are zero.
    return (round(plausible, 1), float("M" in body), -float(start), float(seen)), guess


def plausibility(numbers: NDArray[np.floating]) -> tuple[float, int]:
    """Returns the share and count of the non-zero numbers with magnitudes from 1e-6 to 1e6.

    The share is 1 if all numbers are zero.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        sizes = np.abs(numbers.astype(np.float64))
        good = (sizes >= SMALLEST) & (sizes <= LARGEST)
    others = int((sizes != 0).sum())  # includes NaN
    return (float(good.sum()) / others if others else 1.0), int(good.sum())


def _body(numbers: NDArray[np.floating]) -> tuple[str, bool, str]:
    places, column_major = find_frames(numbers)
    ends = [*places, numbers.shape[1]]
    parts, words, at = [], [], 0
    for end in ends:
        if count := end - at:
            part, word = _of_joints(count)
            parts.append(part)
            words.append(word)
        if end < numbers.shape[1]:
            parts.append("1M")
            words.append(f"a frame {'column by column' if column_major else 'row by row'}")
        at = end + 16
    return "".join(parts), column_major, ", ".join(words)


def _of_joints(count: int) -> tuple[str, str]:
    fits = [
        (f"{count // times}F" * times, f"{count // times} joints {often}")
        for times, often in ((2, "twice"), (3, "three times"))
        if count % times == 0 and 1 < count // times <= _MAX_JOINTS
    ]
    if not fits:
        return f"{count}F", _plural(count, "number")
    (part, word), *others = fits
    return part, "".join([word, *(f" (or {also}: {other})" for other, also in others)])


def _plural(count: int, word: str) -> str:
    first, of, rest = word.partition(" of ")
    return f"{count} {first}{'s' if count > 1 and not first[-1].isdigit() else ''}{of}{rest}"


def find_frames(numbers: NDArray[np.floating]) -> tuple[list[int], bool]:
    """Returns the offsets of rigid frames that all rows have, and whether they are column-major.

    `numbers` has the shape (n, k).
    """
    if not 16 <= numbers.shape[1] <= _MAX_NUMBERS:
        return [], True
    with np.errstate(invalid="ignore", over="ignore"):
        windows = sliding_window_view(np.nan_to_num(numbers.astype(np.float64)), 16, axis=1)
    matrices = np.clip(windows, -1e9, 1e9).reshape(-1, 4, 4)
    by_rows, by_columns = (
        are_frames(each).reshape(windows.shape[:2]).all(axis=0)
        for each in (matrices, matrices.swapaxes(1, 2))
    )
    column_major = int(by_columns.sum()) >= int(by_rows.sum())
    places: list[int] = []
    for place in np.flatnonzero(by_columns if column_major else by_rows).tolist():
        if not places or place >= places[-1] + 16:
            places.append(place)
    return places, column_major


def find_header(rows: Rows, size: int) -> tuple[str, int]:
    """Returns structure and length of a header with a packet counter or size; "" and 0 for none.

    Args:
        rows: consecutive packets without a checksum at the end, shape (n, k). A counter is detected
            in four packets or more.
        size: size of the whole packets in bytes.
    """
    little, big = (_header_in(rows, size, order) for order in "<>")
    return (f">{big[0]}", big[1]) if big[1] > little[1] else little


def _header_in(rows: Rows, size: int, order: str) -> tuple[str, int]:
    count, at, parts, is_counted = rows.shape[1], 0, [], False
    while at < 16:
        for letter, each in (("Q", 8), ("I", 4), ("H", 2)):
            if at + each >= count:
                continue
            numbers = rows[:, at : at + each].view(f"{order}u{each}")[:, 0]
            numbers = numbers.astype(f"u{each}")  # so that differences wrap in either byte order
            # A counter of eight bytes must keep the doubles after it aligned.
            if letter == "Q" and ((count - at) % 8 or (numbers >= 2**32).any()):
                continue
            if letter == "I" and (_second(numbers, order) == size).all():
                continue  # a counter of two bytes, then the size
            steps = np.diff(numbers)  # they wrap like the counter
            if len(rows) >= 4 and (steps == 1).all():
                parts.append(f"1{letter}" if is_counted else f"number:1{letter}")
                is_counted = True
                break
            if letter != "Q" and (numbers == size).all():
                parts.append(f"1{letter}=size")
                break
        else:
            break
        at += each
    return " ".join(parts), at


def _second(numbers: NDArray[np.integer], order: str) -> NDArray[np.integer]:
    return numbers >> 16 if order == "<" else numbers & 0xFFFF


def is_text(packet: bytes) -> bool:
    """Whether a packet has only printable ASCII characters, tabs and line ends."""
    return all(32 <= byte < 127 or byte in b"\t\r\n" for byte in packet)


def describe_bytes(rows: Rows) -> str:
    """Returns a description of packets, shape (n, size), that are text or only zeros, or ""."""
    if not rows.size:
        return "empty"
    if not rows.any():
        return "only zeros"
    packet = bytes(rows[-1])
    if not is_text(packet):
        return ""
    words = packet.decode("ascii").split() or [" "]
    kind = {"<": "XML", "{": "JSON", "[": "JSON"}.get(words[0][0], "text")
    return f"{kind}, which a structure cannot describe: {' '.join(words)[:40]}"
