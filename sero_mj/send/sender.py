"""Sends packets at an exact rate, by UDP or through shared memory."""

from __future__ import annotations

import gc
import itertools
import socket
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from ..errors import SourceError

_SPIN = 2e-4  # s; sleeping is not exact to less than this, so the rest is waited for actively


class Sink(Protocol):
    """Where packets go: `UdpSink`, `ShmWriter`."""

    def put(self, packet: bytes) -> None:
        """Takes a packet; raises OSError when the system refuses it."""


class UdpSink:
    """Sends packets to a UDP port.

    Args:
        host: where to.
        port: where to.

    Attributes:
        place: kind, host and port in a few words, for people.
        socket: that it sends through, and answers come to.

    Raises:
        SourceError: the address cannot be resolved.
    """

    def __init__(self, host: str, port: int) -> None:
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        except (OSError, UnicodeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise SourceError(f"{host}:{port}", f"not an address: {reason}") from error
        family, kind, _, _, address = found
        self._address: tuple[Any, ...] = address
        self.place = f"UDP {host}:{port}"
        self.socket = socket.socket(family, kind)

    def put(self, packet: bytes) -> None:
        """Sends a packet; raises OSError when the system refuses it."""
        self.socket.sendto(packet, self._address)

    def close(self) -> None:
        """Closes the socket."""
        self.socket.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


@dataclass
class SendReport:
    """What a sender achieved.

    Attributes:
        packets: how many were sent.
        seconds: how long it took.
        refused: how many the system refused to send; the others went on.
        jitter_p50: median of how late packets left, s.
        jitter_p99: 99th percentile of the same.
    """

    packets: int
    seconds: float
    refused: int
    jitter_p50: float
    jitter_p99: float

    @property
    def rate(self) -> float:
        """Packets per second."""
        return self.packets / self.seconds if self.seconds > 0 else 0.0

    def __str__(self) -> str:
        late = f"{self.jitter_p50 * 1e6:.0f} us (median), {self.jitter_p99 * 1e6:.0f} us (p99)"
        refused = f", {self.refused} refused by the system" if self.refused else ""
        sent = f"sent {self.packets} packets in {self.seconds:.2f} s ({self.rate:.1f} Hz)"
        return f"{sent}, late by {late}{refused}"


def paced(
    packet_at: Callable[[float], bytes], rate: float, duration: float | None = None
) -> Iterator[tuple[float, bytes]]:
    """Packets at equal intervals.

    Args:
        packet_at: makes the packet of a time (s).
        rate: packets per second.
        duration: s; None goes on for ever.

    Returns:
        When each packet is due, s, and the packet, made when it is asked for.
    """
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
    """Sends packets at exact times until there are no more or the user interrupts.

    Args:
        packets: when each one is due, s from now on, never decreasing, and its bytes.
        to: where to.
        idle: called with the time that is left (s) until a packet leaves, again and again while it
            returns that it has done something; for what can be done ahead.
    """
    late: list[float] = []
    refused = sent = 0
    gc.freeze()  # else all that was imported is looked through in between, for 50 ms at a time
    start = time.perf_counter()
    try:
        for due, packet in packets:
            late.append(wait_until(start + due, idle))
            try:
                to.put(packet)
            except OSError:  # nobody listens yet, or the network is away: a robot goes on
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
    """Waits, and returns by how much (s) it was late."""
    left = when - time.perf_counter()
    while idle is not None and left > 0 and idle(left):
        left = when - time.perf_counter()
    if left > _SPIN:
        time.sleep(left - _SPIN)
    while (late := time.perf_counter() - when) < 0:
        pass
    return late
