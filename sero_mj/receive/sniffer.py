"""Listens to a port and sorts packets of any kind by sender and size."""

from __future__ import annotations

import errno
import select
from collections import deque
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from ..errors import SourceError
from ._datagrams import Batch, Datagrams, unpack_address
from ._sockets import open_socket
from ._timing import Timing
from .guess import Guess, describe_bytes, guess_layouts, is_text
from .language import MAX_PACKET_BYTES
from .structure import Rows

_KEPT = 16  # packets of a stream that guesses are made from
_MOST_STREAMS = 100  # more senders and sizes than anyone reads


@dataclass
class Stream:
    """Packets of one size from one sender.

    Attributes:
        sender: address and port.
        size: bytes of a packet.
        count: packets so far.
        timing: their rate and jitter.
        last: the newest ones, the last one last.
    """

    sender: tuple[str, int]
    size: int
    count: int = 0
    timing: Timing = field(default_factory=Timing)
    last: deque[bytes] = field(default_factory=lambda: deque(maxlen=_KEPT))

    @property
    def rows(self) -> Rows:
        """The newest packets, (n, size)."""
        rows = np.frombuffer(b"".join(self.last), np.uint8)
        return rows.reshape(len(self.last), self.size)

    def guesses(self) -> list[Guess]:
        """Layouts that would fit, the most likely first."""
        return guess_layouts(self.rows) if self.is_binary else []

    @property
    def is_binary(self) -> bool:
        """Whether a structure could describe it."""
        return self.size > 0 and not is_text(self.last[-1])

    @property
    def description(self) -> str:
        """The bytes in words, where they are text or zeros; else empty."""
        return describe_bytes(self.rows)


class Sniffer:
    """Receives packets of any size from any sender.

    Args:
        host: address to listen on; `0.0.0.0` for every interface, or a multicast group.
        port: to listen on; 0 lets the system choose.
        interface: name or address of the network interface on which a group is joined.

    Attributes:
        streams: by sender and size, in the order in which they were first seen.
        received: packets of all streams.
        untold: packets of streams beyond the first hundred.
        port: that it listens on.

    Raises:
        SourceError: the port is in use, or the address is not one of this machine.
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
        """Takes in what comes within `timeout` s, up to `most` packets; returns how many."""
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
                if len(self.streams) >= _MOST_STREAMS:
                    self.untold += len(places)
                    continue
                stream = self.streams[key] = Stream(unpack_address(key[0]), key[1])
            stream.count += len(places)
            stream.timing.add(batch.arrivals[places])
            stream.last.extend(batch.rows[i, : key[1]].tobytes() for i in places[-_KEPT:].tolist())
