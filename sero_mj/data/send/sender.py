"""Sends packets at an exact rate by UDP or shared memory.

`PacketBuffer` computes packets early, so that they are sent on time.
"""

from __future__ import annotations

import gc
import itertools
import math
import socket
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from ...base.errors import (
    SourceError,
    mismatch,
    reason_of,
)
from ..receive.shm_block import Block, block_path
from ..receive.structure import Rows, Structure

_SPIN = 2e-4  # s; accuracy of sleep, after which the rest is a busy wait
_MAX_COMPUTED_RATE = 1000.0  # maximum rate of computed packets, 1/s; others are interpolated
_LEAD_TIME = 0.25  # maximum time by which packets are computed early, s


class Sink(Protocol):
    """A destination of packets, such as `UdpSink` and `ShmWriter`."""

    def put(self, packet: bytes) -> None:
        """Sends a packet; raises OSError."""


class UdpSink:
    """A sink that sends packets to a UDP port; raises SourceError if the address is invalid.

    Args:
        message_of: function from a packet to the message to send; None to send the packet.
    """

    def __init__(
        self, host: str, port: int, message_of: Callable[[bytes], bytes] | None = None
    ) -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except (OSError, UnicodeError) as error:
            reason = reason_of(error)
            raise SourceError(f"{host}:{port}", f"not an address: {reason}") from error
        family, kind, _, _, address = found
        self._address: tuple[Any, ...] = address
        self.place = f"UDP {host}:{port}"
        self.socket = socket.socket(family, kind)
        self._message_of = message_of

    def put(self, packet: bytes) -> None:
        message = packet if self._message_of is None else self._message_of(packet)
        self.socket.sendto(message, self._address)

    def close(self) -> None:
        self.socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class ShmWriter:
    """A sink that writes packets to a block of POSIX shared memory; raises SourceError.

    The block is created if it is missing, and enlarged if it is too small. `close` removes a block
    that the writer has created.

    Args:
        block: name of the shared memory, for example `robot` or `/robot`.
        lock: event whose value is odd while a packet is written, and even afterwards (a seqlock);
            empty for no lock. The value of this event in packets is not used.
        offset: position of the packet in the block, bytes.
    """

    def __init__(self, block: str, structure: Structure, lock: str = "", offset: int = 0) -> None:
        self.place = f"shared memory {block}"
        self._size, self._offset, self._structure = structure.size, offset, structure
        self._lock = structure.field(lock) if lock else None
        if self._lock is not None and self._lock.numbers != 1:
            raise ValueError(f"lock '{lock}' has {self._lock.numbers} numbers; expected one")
        try:
            self.place = f"shared memory {block_path(block)}"
            self._block, self._is_own = _open(block)
            if self._block.size < offset + self._size:
                self._block.resize(offset + self._size)
            self._number = self._found_lock()
        except (OSError, ValueError) as error:
            raise SourceError("writer", f"{self.place}: {reason_of(error)}") from error

    def _found_lock(self) -> int:
        if self._lock is None:
            return 0
        field = self._lock
        found = self._block.read(field.end - field.offset, self._offset + field.offset)
        number = np.frombuffer(found, field.dtype)[0]
        return int(number) if np.isfinite(number) and 0 <= number < _modulus(field.dtype) else 0

    def put(self, packet: bytes) -> None:
        """Overwrites the last packet; raises OSError or ValueError."""
        if len(packet) != self._size:
            raise mismatch(len(packet), self._size, of="bytes")
        block, offset, field = self._block, self._offset, self._lock
        if field is None:
            block.write(packet, offset)
            return
        modulus = _modulus(field.dtype)
        odd = self._number | 1
        self._number = (odd + 1) % modulus or 2  # 0 means that nothing has been written
        before, after = (np.array(n, field.dtype).tobytes() for n in (odd, self._number))
        if self._structure.checksums:  # they cover the final value of the lock
            whole = bytearray(packet[: field.offset] + after + packet[field.end :])
            self._structure.seal(np.frombuffer(whole, np.uint8)[None])
            packet = bytes(whole)
        # Three calls, because system calls are ordered on all processors.
        block.write(before, offset + field.offset)
        block.write(packet[: field.offset] + before + packet[field.end :], offset)
        block.write(after, offset + field.offset)

    def close(self) -> None:
        """Closes the block, and removes it if this writer has created it."""
        if self._is_own:
            self._block.unlink()
        self._block.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class PacketBuffer:
    """A buffer of packets that are computed in the idle time between packets.

    At rates above 1 kHz, packets are computed at up to 1 kHz, and the packets in between are
    interpolated linearly. The maximum error of the joint angles of an LWR is 1e-6 rad.

    Args:
        packet_at: function from a time (s) to the packet.
        rate: packets per second.
        sequence: event that contains the sequence number, which starts at 1; empty for none.
        time: event that contains the send time; empty for none.
        time_scale: duration of one unit of `time`, s.
    """

    def __init__(
        self,
        packet_at: Callable[[float], bytes],
        structure: Structure,
        *,
        rate: float,
        sequence: str = "",
        time: str = "",
        time_scale: float = 1.0,
    ) -> None:
        self._packet_at, self._rate = packet_at, rate
        self._sequence = structure.field(sequence) if sequence else None
        self._time = structure.field(time) if time else None
        self._time_scale = time_scale
        self._structure = structure
        self._floats = [field for field in structure.fields if field.is_float]
        self._step = max(math.ceil(rate / _MAX_COMPUTED_RATE), 1)
        self._packets: deque[bytes] = deque()
        self._first = 0  # number of the first packet in the buffer, starting at 0
        self._made = 0
        self._last: Rows | None = None
        self._takes = 0.0  # time to compute the next packets, s

    def at(self, t: float) -> bytes:
        """Returns the packet at time `t` (s). Times of successive calls must not decrease."""
        number = round(t * self._rate)
        while self._made <= number:
            self._make()
        while self._first < number:
            self._packets.popleft()
            self._first += 1
        return self._packets[0]

    def idle(self, left: float) -> bool:
        """Computes packets if the time `left` (s) is sufficient; returns whether it did."""
        if left < 1.5 * self._takes or len(self._packets) > _LEAD_TIME * self._rate:
            return False
        self._make()
        return True

    def _make(self) -> None:
        start = time.perf_counter()
        step, made = self._step, self._made
        here = self._compute(made) if self._last is None else self._last
        rows = np.repeat(here[None], step, axis=0)
        if step > 1:
            self._last = self._compute(made + step)
            share = np.arange(step)[:, None] / step
            for field in self._floats:
                part = slice(field.offset, field.end)
                low, high = here[part].view(field.dtype), self._last[part].view(field.dtype)
                with np.errstate(invalid="ignore", over="ignore"):
                    between = low + share * (high - low)
                rows[:, part].view(field.dtype)[:] = between
        numbers = np.arange(made, made + step)
        if self._sequence is not None:
            field = self._sequence
            # It wraps like a counter in C.
            counted = (numbers + 1).astype("<i8").astype(field.dtype)
            rows[:, field.offset : field.end].view(field.dtype)[:, 0] = counted
        if self._time is not None:
            field, stamps = self._time, numbers / self._rate / self._time_scale
            if not field.is_float:
                stamps = np.rint(stamps).astype("<i8")
            rows[:, field.offset : field.end].view(field.dtype)[:, 0] = stamps.astype(field.dtype)
        self._structure.seal(rows)
        self._packets.extend(row.tobytes() for row in rows)
        self._made += step
        took = time.perf_counter() - start
        self._takes = took if not self._takes else 0.9 * self._takes + 0.1 * took

    def _compute(self, number: int) -> Rows:
        return np.frombuffer(self._packet_at(number / self._rate), np.uint8)


@dataclass
class SendReport:
    """Statistics of a sender.

    Attributes:
        refused: number of packets that the system did not send.
        jitter_p50: median delay of packets, s.
        jitter_p99: 99th percentile of the delay, s.
    """

    packets: int
    seconds: float
    refused: int
    jitter_p50: float
    jitter_p99: float

    @property
    def rate(self) -> float:
        return self.packets / self.seconds if self.seconds > 0 else 0.0

    def __str__(self) -> str:
        delay = f"{self.jitter_p50 * 1e6:.0f} us (median), {self.jitter_p99 * 1e6:.0f} us (p99)"
        refused = f", {self.refused} refused by the system" if self.refused else ""
        sent = f"sent {self.packets} packets in {self.seconds:.2f} s ({self.rate:.1f} Hz)"
        return f"{sent}, delay {delay}{refused}"


def paced(
    packet_at: Callable[[float], bytes], rate: float, duration: float | None = None
) -> Iterator[tuple[float, bytes]]:
    """Yields send times (s) at equal intervals, and packets. A `duration` of None has no end."""
    for number in itertools.count():
        if duration is not None and number >= max(round(duration * rate), 1):
            return
        yield number / rate, packet_at(number / rate)


def send(
    packets: Iterable[tuple[float, bytes]],
    to: Sink,
    *,
    idle: Callable[[float], bool] | None = None,
) -> SendReport:
    """Sends packets at exact times until the last packet or Ctrl+C.

    Args:
        packets: send time of each packet, relative to now (s), and its bytes.
        idle: function that is called while there is time before the next packet, until it returns
            false. Its argument is the remaining time, s.
    """
    late: list[float] = []
    refused = sent = 0
    gc.freeze()  # otherwise, garbage collection of all imported objects takes 50 ms
    start = time.perf_counter()
    try:
        for due, packet in packets:
            late.append(wait_until(start + due, idle))
            try:
                to.put(packet)
            except OSError:  # no receiver or no network; robots continue, too
                refused += 1
            sent += 1
            if len(late) > 100_000:
                del late[:50_000]
    except KeyboardInterrupt:
        pass
    finally:
        gc.unfreeze()
    seconds = time.perf_counter() - start
    p50, p99 = np.percentile(late, [50, 99]) if late else (0.0, 0.0)
    return SendReport(sent, seconds, refused, float(p50), float(p99))


def wait_until(when: float, idle: Callable[[float], bool] | None = None) -> float:
    """Waits until `time.perf_counter` reaches a time (s); returns the delay (s).

    `idle` is called while there is time left, as in `send`.
    """
    left = when - time.perf_counter()
    while idle is not None and left > 0 and idle(left):
        left = when - time.perf_counter()
    if left > _SPIN:
        time.sleep(left - _SPIN)
    while (late := time.perf_counter() - when) < 0:
        pass
    return late


def _open(name: str) -> tuple[Block, bool]:
    while True:  # another writer may create or remove it meanwhile
        try:
            return Block(name, writable=True), False
        except FileNotFoundError:
            try:
                return Block(name, writable=True, create=True), True
            except FileExistsError:
                continue


def _modulus(dtype: np.dtype[np.generic]) -> int:
    if dtype.kind == "f":
        return 2**53 if dtype.itemsize == 8 else 2**24
    return int(2 ** (8 * dtype.itemsize - (dtype.kind == "i")))
