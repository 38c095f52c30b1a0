"""Checks received packets, counts them, and selects the packets to apply."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Mapping, MutableMapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from ...base.frames import NOT_A_ROTATION, Array, Ints
from .structure import LAST_ROW, LAST_ROW_TOLERANCE, Rows, Structure, are_frames
from .tracking import (
    DUPLICATE,
    LATE,
    MAX_SENDERS,
    RESTARTED,
    Senders,
    SequenceTracker,
    StampTracker,
    Timing,
)

# Counters in the order of their updates. Malformed packets are last, because tests wait for them.
_COUNTED = ("duplicates", "late", "restarts", "blanked", "not_frames", "not_finite",
            "implausible", "wrong_constant", "wrong_checksum", "wrong_size",
            "received")  # fmt: skip
_MAX_WIDTH = 4096  # maximum bytes of a row if a packet is malformed or encoded


def pad_packets(packets: Sequence[bytes], size: int) -> tuple[Rows, Ints]:
    """Converts n >= 1 packets to rows for `Intake.take` and recorders.

    Args:
        size: size of a valid packet in bytes.

    Returns:
        rows, shape (n, `size` or more), and packet lengths, shape (n,). In rows, short packets are
        padded with zeros, and long packets are truncated to 4096 bytes or `size`.
    """
    lengths = np.array([len(packet) for packet in packets], np.intp)
    width = max(size, min(int(lengths.max()), _MAX_WIDTH))
    text = b"".join(packet[:width].ljust(width, b"\0") for packet in packets)
    return np.frombuffer(text, np.uint8).reshape(len(packets), width), lengths


@dataclass
class Counters:
    """Counts of packets since the source was opened.

    Attributes:
        wrong_constant: malformed packets with a number other than the constant in the structure.
        wrong_checksum: malformed packets with a wrong checksum.
        not_finite: malformed packets with NaN or infinity where these are not allowed.
        not_frames: malformed packets with a matrix that is not a rigid frame.
        implausible: malformed packets with a number beyond its limit; see `Source.limit`.
        foreign: packets of unexpected senders, not listed in `sender`. They are not checked.
        late: packets that arrived after a packet with a higher sequence number. They are applied
            only if `only_latest_packet` is false.
        duplicates: packets with a repeated sequence number, which are not applied.
        restarts: restarts of the sender, detected by its sequence numbers or its port.
        torn: reads of shared memory that failed because the writer was always writing.
        senders: number of concurrent senders within the last 2 s.
        blanked: applied packets with missing data; see `Source.allow_nan`.
        superseded: valid packets that a newer packet replaced before their use. This is normal if
            a robot sends faster than the frame rate.
        dropped: packets that the kernel has dropped.
        failures: failures of reception, which restarted after each failure.
        last_size: size in bytes of the last packet with a wrong size.
        last_fault_time: arrival time of the last malformed packet on the clock of `Source.now`.
    """

    received: int = 0
    wrong_size: int = 0
    wrong_constant: int = 0
    wrong_checksum: int = 0
    not_finite: int = 0
    not_frames: int = 0
    implausible: int = 0
    foreign: int = 0
    lost: int = 0
    late: int = 0
    duplicates: int = 0
    restarts: int = 0
    torn: int = 0
    senders: int = 0
    blanked: int = 0
    superseded: int = 0
    dropped: int = 0
    failures: int = 0
    last_fault: str = ""
    last_size: int = 0
    last_fault_time: float = 0.0

    @property
    def malformed(self) -> int:
        """Number of malformed packets. These are not applied."""
        return (
            self.wrong_size
            + self.wrong_constant
            + self.wrong_checksum
            + self.not_finite
            + self.not_frames
            + self.implausible
        )


class Intake:
    """Checks batches of packets from a socket, shared memory or a file.

    Args:
        sequence: name of the event with the sequence number; empty for none.
        time: name of the event with the send time; empty for none.
        time_scale: unit of the send time in seconds.
        lossless: whether late packets are applied.
        nan_allowed: names of the events in which NaN stands for missing data.
        limits: mapping from event names to the maximum magnitudes of their k numbers, shape (k,).
        on_fault: function called with the description of a malformed packet.
    """

    def __init__(
        self,
        layout: Structure,
        *,
        sequence: str = "",
        time: str = "",
        time_scale: float = 1.0,
        lossless: bool = False,
        nan_allowed: frozenset[str] = frozenset(),
        limits: Mapping[str, Array] = MappingProxyType({}),
        on_fault: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.layout = layout
        self.counters = Counters()
        self.timing = Timing()
        self.nan_allowed = nan_allowed
        self.limits = limits
        self._sequence, self._time = sequence, time
        self._time_scale = time_scale
        self._lossless = lossless
        self.on_fault = on_fault
        self._trackers: OrderedDict[bytes, SequenceTracker | StampTracker] = OrderedDict()
        self._lost_by_forgotten = 0
        self._senders = Senders()
        # Counts of the current batch, added only after its valid packets can be taken.
        self._tally = Counters()
        self._modulus = 0
        if sequence:
            dtype = layout.event_rows(np.zeros((1, layout.size), np.uint8), sequence).dtype
            self._modulus = 2 ** (8 * dtype.itemsize) if dtype.kind in "iu" else 0

    @property
    def limits(self) -> Mapping[str, Array]:
        return self._limits

    @limits.setter
    def limits(self, limits: Mapping[str, Array]) -> None:
        self._limits = limits
        self._bounds = self.layout.bounds(
            {event: float(each.min()) for event, each in limits.items()}
        )

    def take(
        self, rows: Rows, lengths: Ints, arrivals: Array, senders: Rows | None = None
    ) -> tuple[Rows, Array]:
        """Checks n >= 1 packets, and returns the packets to apply. Call `count` afterwards.

        Args:
            rows: one packet per row, shape (n, `size` or more), or (n, any) for encoded packets.
            lengths: packet lengths in bytes, shape (n,); greater than a row for truncated packets.
            arrivals: arrival times in seconds, shape (n,).
            senders: sender addresses, shape (n, any).

        Returns:
            rows, shape (m, `size`), and arrival times, shape (m,), of the packets to apply. These
            are views of the arguments if all packets are valid.
        """
        counters, layout = self._tally, self.layout
        counters.received += len(rows)
        received, sizes = rows, lengths
        if layout.message:
            rows, lengths = layout.unpack(rows, lengths)
        rows = rows[:, : layout.size]
        if (lengths != layout.size).any():
            bad = lengths != layout.size
            counters.wrong_size += int(bad.sum())
            counters.last_size = int(sizes[bad][-1])
            packet = received[bad][-1].tobytes()[: counters.last_size]
            found = layout.describe_wrong_size(packet, counters.last_size)
            self._fault(found, arrivals[bad][-1])
            rows, arrivals = rows[~bad], arrivals[~bad]
            senders = None if senders is None else senders[~bad]
        for cause, find, describe in (
            ("wrong_constant", layout.find_wrong_constants, layout.describe_wrong_constant),
            ("wrong_checksum", layout.find_wrong_checksums, layout.describe_wrong_checksum),
        ):
            if len(rows) and (bad := find(rows)).any():
                setattr(counters, cause, getattr(counters, cause) + int(bad.sum()))
                self._fault(describe(rows[bad][-1:]), arrivals[bad][-1])
                rows, arrivals = rows[~bad], arrivals[~bad]
                senders = None if senders is None else senders[~bad]
        if not len(rows):
            return rows, arrivals
        begins = None if senders is None else self._note_senders(senders, arrivals)
        stamps = self._stamps(rows) if self._time else None
        positions = self._classify(rows, arrivals, stamps, senders)
        suspect = layout.find_out_of_bounds(rows, self._bounds)
        is_finite, good = True, ~suspect
        if is_any_suspect := bool(suspect.any()):  # seldom
            blank = layout.find_not_finite(rows)
            is_finite, good = not blank.any(), ~blank
            if not is_finite:
                good = ~layout.find_not_finite(rows, self.nan_allowed)
                self._count_not_finite(rows, arrivals, good)
        if required := layout.required_frames:
            good &= self._are_frames(rows, arrivals, good, required)
        if is_any_suspect and self._limits:
            good &= self._are_plausible(rows, arrivals, good)
        self._time_good(good, arrivals, stamps, positions, begins)
        # Packets that were counted as malformed are not counted again, for example as late.
        if positions.any():
            duplicate = good & (positions == DUPLICATE)
            late = good & (positions == LATE)
            counters.duplicates += int(duplicate.sum())
            counters.late += int(late.sum())
            good &= ~duplicate if self._lossless else ~(duplicate | late)
        if not is_finite:
            counters.blanked += int((good & blank).sum())
        if not good.all():
            rows, arrivals = rows[good], arrivals[good]
        return rows, arrivals

    def _count_not_finite(self, rows: Rows, arrivals: Array, good: NDArray[np.bool_]) -> None:
        if good.all():
            return
        self._tally.not_finite += int((~good).sum())
        last = int(np.flatnonzero(~good)[-1])
        values = self.layout.decode_rows(rows[last : last + 1])
        single = {event: array[0] for event, array in values.items()}
        fault = _describe_not_finite(single, self.nan_allowed) or "a number is out of range"
        self._fault(fault, arrivals[last])

    def decode(self, rows: Rows) -> dict[str, Array]:
        """Decodes rows returned by `take`, and replaces infinity by NaN."""
        values = self.layout.decode_rows(rows)
        _blank_not_finite(values, self.nan_allowed, self.layout.matrices)
        return values

    def count(self) -> None:
        """Adds the counts of the last `take` to the counters."""
        tally, counters = self._tally, self.counters
        self._tally = Counters()
        for name in _COUNTED:
            if more := getattr(tally, name):
                setattr(counters, name, getattr(counters, name) + more)
        counters.lost = self._lost_by_forgotten + sum(
            tracker.lost for tracker in self._trackers.values()
        )
        counters.senders = self._senders.at_once
        if tally.malformed:
            counters.last_size = tally.last_size or counters.last_size
            counters.last_fault_time = tally.last_fault_time
            counters.last_fault = tally.last_fault
            self.on_fault(tally.last_fault)

    def reject(self, reason: str, length: int, arrival: float) -> None:
        """Counts a malformed message that cannot be converted to a packet."""
        self._tally.received += 1
        self._tally.wrong_size += 1
        self._tally.last_size = length
        self._fault(reason, arrival)
        self.count()

    def restart(self) -> None:
        """Counts a restart of the sender that sequence numbers did not reveal."""
        self._lost_by_forgotten += sum(tracker.lost for tracker in self._trackers.values())
        self._trackers.clear()
        self.counters.restarts += 1
        self.timing.restart()

    def _fault(self, text: str, when: float) -> None:
        tally = self._tally
        if when >= tally.last_fault_time:  # the last fault of the batch
            tally.last_fault, tally.last_fault_time = text, float(when)

    def _stamps(self, rows: Rows) -> Array:
        numbers = self.layout.event_rows(rows, self._time)[:, 0]
        with np.errstate(over="ignore", invalid="ignore"):
            return numbers.astype(np.float64) * self._time_scale

    def _time_good(
        self,
        good: NDArray[np.bool_],
        arrivals: Array,
        stamps: Array | None,
        positions: NDArray[np.int8],
        begins: int | None,
    ) -> None:
        timed = good.copy()
        restarts = np.flatnonzero(positions == RESTARTED)
        self._tally.restarts += len(restarts)
        if len(restarts) or begins is not None:
            self.timing.restart()
            timed[: max([begins or 0, *restarts[-1:]])] = False
        if stamps is not None:
            timed &= np.isfinite(stamps)
        if timed.any():
            self.timing.add(arrivals[timed], None if stamps is None else stamps[timed])

    def _are_frames(
        self, rows: Rows, arrivals: Array, finite: NDArray[np.bool_], events: Collection[str]
    ) -> NDArray[np.bool_]:
        layout = self.layout
        values = layout.decode_rows(rows, events)
        matrices = np.concatenate([values[event] for event in events], axis=1)
        frames = are_frames(matrices.reshape(-1, 4, 4)).reshape(len(rows), -1)
        if frames.all():
            return np.ones(len(rows), bool)
        frames |= ~np.isfinite(matrices).all(axis=(2, 3))
        good = np.asarray(frames.all(axis=1))
        bad = finite & ~good
        if bad.any():
            self._tally.not_frames += int(bad.sum())
            last = int(np.flatnonzero(bad)[-1])
            single = {event: values[event][last] for event in events}
            _blank_not_finite(single, events, events)
            column_major = layout.column_major
            fault = find_not_frame(single, events, column_major=column_major)
            self._fault(fault, arrivals[last])
        return good

    def _are_plausible(
        self, rows: Rows, arrivals: Array, before: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        good = np.ones(len(rows), bool)
        found = self.layout.decode_rows(rows, self.limits)
        for event, limit in self.limits.items():
            values = found[event].reshape(len(rows), -1)
            with np.errstate(invalid="ignore"):
                beyond = np.abs(values) > limit
            if beyond.any():
                good &= ~(beyond & np.isfinite(values)).any(axis=1)
        bad = before & ~good
        if bad.any():
            self._tally.implausible += int(bad.sum())
            last = int(np.flatnonzero(bad)[-1])
            single = {event: found[event][last] for event in self.limits}
            self._fault(_describe_implausible(single, self.limits), arrivals[last])
        return good

    def _classify(
        self, rows: Rows, arrivals: Array, stamps: Array | None, senders: Rows | None
    ) -> NDArray[np.int8]:
        positions = np.zeros(len(rows), np.int8)
        if not self._sequence and stamps is None:
            return positions
        if self._sequence:
            raw = self.layout.event_rows(rows, self._sequence)[:, 0]
            if raw.dtype.kind == "f":
                finite = np.isfinite(raw) & (np.abs(raw) < 2.0**62)
                numbers = np.where(finite, raw, 0.0).astype(np.int64).tolist()
            else:
                finite, numbers = np.ones(len(raw), bool), raw.tolist()
        else:
            assert stamps is not None
            finite, numbers = np.isfinite(stamps), stamps.tolist()
        one_sender = senders is None or (senders == senders[0]).all()
        if one_sender and finite.all():
            tracker = self._tracker(b"" if senders is None else senders[0].tobytes())
            if isinstance(tracker, SequenceTracker) and tracker.is_consecutive(numbers):
                tracker.skip_to(numbers[-1], float(arrivals[-1]))
                return positions
        for i, arrival in enumerate(arrivals.tolist()):
            if finite[i]:
                tracker = self._tracker(b"" if senders is None else senders[i].tobytes())
                positions[i] = tracker.classify(numbers[i], arrival)
        return positions

    def _tracker(self, sender: bytes) -> SequenceTracker | StampTracker:
        tracker = self._trackers.get(sender)
        if tracker is None:
            tracker = SequenceTracker(self._modulus) if self._sequence else StampTracker()
            self._trackers[sender] = tracker
            if len(self._trackers) > MAX_SENDERS:
                self._lost_by_forgotten += self._trackers.popitem(last=False)[1].lost
        else:  # the tracker of the least recent sender is removed first
            self._trackers.move_to_end(sender)
        return tracker

    def _note_senders(self, senders: Rows, arrivals: Array) -> int | None:
        """Registers senders, and returns the first row of a sender with another clock, or None."""
        self._senders.note(senders, arrivals)
        for gone in self._senders.gone:  # the same program has restarted on another port
            self._tally.restarts += 1
            if (tracker := self._trackers.pop(gone, None)) is not None:
                self._lost_by_forgotten += tracker.lost
        return self._senders.begins


def _describe_not_finite(values: Mapping[str, Array], but: Collection[str]) -> str:
    for event, array in values.items():
        if event in but:
            continue
        good = np.isfinite(array)
        if not good.all():
            index = tuple(np.argwhere(~good)[0].tolist())
            return f"{event}[{', '.join(map(str, index))}] is {array[index]}"
    return ""


def _describe_implausible(values: Mapping[str, Array], limits: Mapping[str, Array]) -> str:
    for event, array in values.items():
        limit = limits[event].reshape(array.shape)
        beyond = np.isfinite(array) & (np.abs(array) > limit)
        if beyond.any():
            index = tuple(np.argwhere(beyond)[0].tolist())
            place = f"{event}[{', '.join(map(str, index))}]"
            return f"{place} is {array[index]:g}; expected at most {limit[index]:g} in magnitude"
    return ""


def _blank_not_finite(
    values: MutableMapping[str, Array], events: Collection[str], matrices: Collection[str]
) -> None:
    """Replaces infinities, and whole matrices with NaN or infinity, by NaN in copied arrays."""
    for event in events:
        array = values.get(event)
        if array is None:
            continue
        good = np.isfinite(array)
        if good.all():
            continue
        if event in matrices:  # a partial frame is invalid
            good &= good.all(axis=(-2, -1), keepdims=True)
        values[event] = np.where(good, array, np.nan)


def find_not_frame(
    values: Mapping[str, Array], events: Collection[str], *, column_major: bool
) -> str:
    """Describes the first matrix that is not a rigid frame or NaN; returns "" if there is none.

    Args:
        column_major: whether the matrices were decoded in column-major order. If the other order
            results in a frame, the description suggests it.
    """
    matrices = np.concatenate([values[event] for event in events])
    wrong = ~(are_frames(matrices) | np.isnan(matrices[:, 3, 3]))
    if not wrong.any():
        return ""
    first = int(np.argmax(wrong))
    name = [f"{event}[{i}]" for event in events for i in range(len(values[event]))][first]
    matrix = matrices[first]
    if np.abs(matrix[3] - LAST_ROW).max() > LAST_ROW_TOLERANCE:
        why = f"the last row is [{', '.join(f'{number:.7g}' for number in matrix[3])}]"
    else:
        why = NOT_A_ROTATION
    if are_frames(matrix.T[None])[0]:
        other = "false" if column_major else "true"
        why += f"; its transpose is a frame. Set column_major = {other}"
    return f"{name} is not a frame: {why}"
