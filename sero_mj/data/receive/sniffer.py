"""Listens to a port, sorts packets of any kind by sender and size, and guesses their structures.

`Sniffer` receives the packets; `guess_layouts` guesses from their size and bytes.
"""

from __future__ import annotations

import errno
import select
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ...base.errors import SourceError
from ...base.plugins import KNOWN_PACKETS, load_all
from ._tracking import Timing
from .checksum import Recognized, recognize
from .language import MAX_PACKET_BYTES, TYPES
from .mixed_layout import LARGEST, SMALLEST, mixed_layout
from .structure import Rows, Structure, are_frames
from .udp_socket import Batch, Datagrams, open_socket, unpack_address

_KEPT_PACKETS = 16  # packets of a stream used for guesses
_MAX_STREAMS = 100  # senders and sizes

_MAX_JOINTS = 64
_MAX_GUESSES = 4
_MAX_NUMBERS = 512  # searched for frames
_HEADERS = {0: "", 2: "1H", 4: "1I", 8: "1Q", 16: "2Q"}  # size in bytes to structure
_LETTERS = {1: "B", 2: "H", 4: "I"}  # of unsigned integers, by bytes
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
    """A possible layout.

    Attributes:
        structure: for `Structure`.
        is_double: whether `F`, `V` and `M` are float64.
        plausible: share of its non-zero floating-point numbers that look like measurements, 0 to 1;
            1 without any.
    """

    structure: str
    is_double: bool
    column_major: bool
    about: str
    plausible: float


@dataclass
class Stream:
    """Packets of one size from one sender.

    Attributes:
        size: bytes of a packet.
        timing: their rate and jitter.
    """

    sender: tuple[str, int]
    size: int
    count: int = 0
    timing: Timing = field(default_factory=Timing)
    last: deque[bytes] = field(default_factory=lambda: deque(maxlen=_KEPT_PACKETS))

    @property
    def rows(self) -> Rows:
        rows = np.frombuffer(b"".join(self.last), np.uint8)
        return rows.reshape(len(self.last), self.size)

    def guesses(self) -> list[Guess]:
        return guess_layouts(self.rows) if self.is_binary else []

    @property
    def is_binary(self) -> bool:
        """Whether a structure could describe it."""
        return self.size > 0 and not is_text(self.last[-1])

    @property
    def description(self) -> str:
        """Description of text or zeros; else empty."""
        return describe_bytes(self.rows)


class Sniffer:
    """Receives packets of any size from any sender; raises SourceError.

    Args:
        host: address to listen on; `0.0.0.0` for every interface, or a multicast group.
        port: to listen on; 0 lets the system choose.
        interface: name or address of the network interface on which a group is joined.

    Attributes:
        streams: by sender and size, in the order in which they were first seen.
        untold: number of packets of streams beyond the first hundred.
    """

    def __init__(self, host: str, port: int, interface: str = "") -> None:
        try:
            self._socket = open_socket("sniff", host, port, interface, 0)
        except SourceError as error:
            if getattr(error.__cause__, "errno", None) != errno.EADDRINUSE:
                raise
            raise SourceError(
                "sniff",
                f"UDP port {port} on {host} is in use; two programs cannot listen to one port: "
                "close the other one, a viewer perhaps, for as long as you sniff",
            ) from error
        self._datagrams = Datagrams(self._socket, MAX_PACKET_BYTES)
        self.port = int(self._socket.getsockname()[1])
        self.streams: dict[tuple[bytes, int], Stream] = {}
        self.received = self.untold = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._socket.close()

    def receive(self, timeout: float, most: int) -> int:
        """Receives up to `most` packets within `timeout` s; returns their number."""
        before = self.received
        if select.select([self._socket], [], [], timeout)[0]:
            while self.received - before < most and (batch := self._datagrams.receive()):
                self._take_in(batch, most - (self.received - before))
                if len(batch) < 8:  # a slow sender; a fast one has filled the buffer meanwhile
                    break
        return self.received - before

    def _take_in(self, batch: Batch, most: int) -> None:
        count = min(len(batch), most)
        self.received += count
        lengths = np.minimum(batch.lengths[:count], MAX_PACKET_BYTES)
        keys = [
            (sender.tobytes(), size)
            for sender, size in zip(batch.senders[:count], lengths.tolist(), strict=True)
        ]
        for key in dict.fromkeys(keys):
            places = np.array([i for i, other in enumerate(keys) if other == key])
            stream = self.streams.get(key)
            if stream is None:
                if len(self.streams) >= _MAX_STREAMS:
                    self.untold += len(places)
                    continue
                stream = self.streams[key] = Stream(unpack_address(key[0]), key[1])
            stream.count += len(places)
            stream.timing.add(batch.arrivals[places])
            stream.last.extend(
                batch.rows[i, : key[1]].tobytes() for i in places[-_KEPT_PACKETS:].tolist()
            )


def guess_layouts(rows: Rows) -> list[Guess]:
    """Returns up to four possible layouts of packets of one size, most likely first.

    Args:
        rows: packets of one sender one after the other, (n, size), n >= 1.
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
        # An unexplained header, and the other byte order, only if they explain more.
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
    """Packets of commercial robots, by size: structure, row-major, and description."""
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
    about = f"{word}: {words}{f', behind a header of {start} bytes' if start else ''}"
    before = ">" if header.startswith(">") else "<"  # an order applies to all following items
    order = type_[0] if type_[0] != before else ""
    structure = f"{header} {order}{body}" if header else order + body
    guess = Guess(structure, type_[-1] == "8", column_major, about, plausible)
    # Doubles of few digits also look like float32, but then half of these are zero.
    return (round(plausible, 1), float("M" in body), -float(start), float(seen)), guess


def plausibility(numbers: NDArray[np.floating]) -> tuple[float, int]:
    """Share and count of non-zero numbers with magnitudes from 1e-6 to 1e6.

    The share is 1 if there are only zeros, which are plausible.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        sizes = np.abs(numbers.astype(np.float64))
        good = (sizes >= SMALLEST) & (sizes <= LARGEST)
    others = int((sizes != 0).sum())  # NaN is one of them
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
    """Structure of numbers that may be two or three values of every joint, and a description."""
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
    """Offsets of rigid frames common to all packets, and whether they are column-major.

    Args:
        numbers: (n, k).
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
    """Structure and bytes of a header with a packet counter or size; empty if none.

    Args:
        rows: consecutive packets, (n, k); at least four are needed to detect a counter.
        size: bytes of the packets, which may have a checksum behind these.
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
            # Eight bytes only if doubles after them stay aligned.
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
    """Whether it contains only printable ASCII characters and line ends."""
    return all(32 <= byte < 127 or byte in b"\t\r\n" for byte in packet)


def describe_bytes(rows: Rows) -> str:
    """Description of packets (n, size): text, or only zeros; else empty."""
    if not rows.size:
        return "empty"
    if not rows.any():
        return "only zeros"
    packet = bytes(rows[-1])
    if not is_text(packet):
        return ""
    words = packet.decode("ascii").split() or [" "]
    kind = {"<": "XML", "{": "JSON", "[": "JSON"}.get(words[0][0], "text")
    return f"{kind}, which no structure describes: {' '.join(words)[:40]}"
