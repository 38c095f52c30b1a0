"""`UdpReceiver`: packets from a UDP socket, read on a thread of its own (the paper's Fig. 5)."""

from __future__ import annotations

import errno
import select
import socket
import struct
import sys
import threading
import time
from collections.abc import Collection, Mapping
from functools import cached_property

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator

from ..assemble.declaration import Declaration
from ..errors import SourceError, StructureError, UnknownName
from .checks import blank_not_finite, find_not_finite, find_not_frame
from .source import Counters, Packet
from .structure import Structure

_SO_RXQ_OVFL = 40  # Linux: the kernel tells how many packets it dropped; not in Python's socket
_ANCILLARY_BYTES = socket.CMSG_SPACE(4) if hasattr(socket, "CMSG_SPACE") else 0


class UdpReceiver(Declaration):
    """Receives UDP packets of one structure.

    Attributes:
        name: the source's name in routes.
        structure: what the packets look like, e.g. `7F1M`; see `structure`.
        udpport: port to listen on (`port` in files); 0 lets the system choose.
        host: address to listen on. Loopback by default; `0.0.0.0` for every interface.
        is_double: numbers are float64, else float32 (`double` in files).
        column_major: matrices come column by column, else row by row.
        buffer_size: bytes of the kernel's receive buffer; 0 leaves the system's default.
        counters: what came in since it was opened.
    """

    name: str = "udp"
    is_double: bool = Field(True, alias="double")  # before structure, whose size it decides
    column_major: bool = True
    structure: str
    udpport: int = Field(0, alias="port", ge=0, le=65535)
    host: str = "127.0.0.1"
    buffer_size: int = Field(0, ge=0, le=2**31 - 1)

    _counters: Counters = PrivateAttr(default_factory=Counters)
    _nan_allowed: frozenset[str] = PrivateAttr(frozenset())
    _latest: Packet | None = PrivateAttr(None)
    _taken: int = PrivateAttr(0)
    _first: threading.Event = PrivateAttr(default_factory=threading.Event)
    _closing: threading.Event = PrivateAttr(default_factory=threading.Event)
    _socket: socket.socket | None = PrivateAttr(None)
    _wake: tuple[socket.socket, socket.socket] | None = PrivateAttr(None)
    _thread: threading.Thread | None = PrivateAttr(None)

    @field_validator("structure")
    @classmethod
    def _structure_parses(cls, text: str, info: ValidationInfo) -> str:
        try:
            Structure(text, is_double=info.data.get("is_double", True))
        except StructureError as error:
            raise ValueError(str(error)) from None
        return text

    @field_validator("host")
    @classmethod
    def _host_is_an_address(cls, host: str) -> str:
        if not host or any(character.isspace() for character in host):
            raise ValueError(f"found {host!r}; expected an address such as 127.0.0.1 or 0.0.0.0")
        return host

    @property
    def place(self) -> tuple[str, int]:
        """Address and port it listens on; no two sources can share one."""
        return self.host, self.udpport

    @cached_property
    def layout(self) -> Structure:
        """The decoder."""
        return Structure(self.structure, is_double=self.is_double, column_major=self.column_major)

    @property
    def counters(self) -> Counters:
        """What came in since it was opened."""
        return self._counters

    @property
    def events(self) -> Mapping[str, tuple[int, ...]]:
        """Event name to its shape: (n,) values, (n, 3) vectors, (n, 4, 4) matrices."""
        return self.layout.events

    @property
    def size(self) -> int:
        """Bytes of a packet."""
        return self.layout.size

    @property
    def port(self) -> int:
        """The port it listens on; the one the system chose when `udpport` is 0."""
        return int(self._socket.getsockname()[1]) if self._socket else self.udpport

    def allow_nan(self, events: Collection[str]) -> None:
        """Lets NaN and infinity mean `no data` in these events, and in no others.

        There they are handed on as NaN, a matrix as a whole, and the rest of the packet is applied
        (counted as `blanked`); anywhere else they make it malformed. From the next packet on.

        Raises:
            UnknownName: an event that the structure does not have.
        """
        for event in events:
            if event not in self.events:
                raise UnknownName("event", event, self.events)
        self._nan_allowed = frozenset(events)

    def open(self) -> None:
        """Binds the socket and starts the thread.

        Raises:
            SourceError: the port is in use, or the address is not one of this machine.
        """
        self.close()
        self._socket = self._bound_socket()
        self._counters, self._latest, self._taken = Counters(), None, 0
        self._first.clear()
        self._closing.clear()
        self._wake = socket.socketpair()
        self._thread = threading.Thread(target=self._receive, name=f"udp {self.name}", daemon=True)
        self._thread.start()

    def _bound_socket(self) -> socket.socket:
        sock = None
        try:
            family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
            sock = socket.socket(family, socket.SOCK_DGRAM)
            sock.setblocking(False)
            if self.buffer_size:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self.buffer_size)
            if sys.platform == "linux":
                sock.setsockopt(socket.SOL_SOCKET, _SO_RXQ_OVFL, 1)
            sock.bind((self.host, self.udpport))
        # A name that cannot be one makes other errors than a name that is not known.
        except (OSError, TypeError, UnicodeError) as error:
            if sock is not None:
                sock.close()
            raise SourceError(self.name, self._why(error)) from error
        return sock

    def _why(self, error: Exception) -> str:
        place = f"UDP port {self.udpport} on {self.host}"
        if not isinstance(error, OSError):
            return f"{place}: not an address: {error}"
        if error.errno == errno.EADDRINUSE:
            return f"{place} is in use by another program; close that, or choose another port"
        if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
            return f"{place}: not an address of this machine; expected 127.0.0.1 or 0.0.0.0, say"
        if error.errno == errno.EACCES:
            return f"{place}: no permission; choose a port above 1023"
        return f"{place}: {error.strerror}"

    def close(self) -> None:
        """Stops the thread and closes the socket; harmless when it is not open."""
        if self._thread is not None and self._wake is not None:
            self._closing.set()
            self._wake[1].send(b"x")
            self._thread.join()
            for end in self._wake:
                end.close()
        if self._socket is not None:
            self._socket.close()
        self._socket = self._wake = self._thread = None

    def __enter__(self) -> UdpReceiver:
        self.open()
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def latest(self) -> Packet | None:
        """Returns the newest good packet, or None when there was none yet."""
        packet = self._latest
        if packet is not None and packet.number > self._taken:
            self._counters.superseded += packet.number - self._taken - 1
            self._taken = packet.number
        return packet

    def wait(self, timeout: float) -> bool:
        """Waits up to `timeout` s until a good packet has come; returns whether one has."""
        return self._first.wait(timeout)

    def _receive(self) -> None:
        sock, wake = self._socket, self._wake
        assert sock is not None and wake is not None
        size = self.layout.size
        scratch = bytearray(size + 1)  # one more byte than is right shows that it was too long
        number = 0
        while not self._closing.is_set():
            try:
                length, ancillary, flags, _ = sock.recvmsg_into([scratch], _ANCILLARY_BYTES)
            except BlockingIOError:
                select.select([sock, wake[0]], [], [])
                continue
            except OSError as error:
                # An ICMP answer to somebody else's packet may surface here; go on receiving.
                self._counters.last_fault = f"socket: {error.strerror}"
                self._closing.wait(0.01)  # an error that stays must not take a whole core
                continue
            arrival = time.monotonic()
            counters = self._counters
            counters.received += 1
            if ancillary:
                counters.dropped = _dropped_by_kernel(ancillary, counters.dropped)
            if length != size or flags & socket.MSG_TRUNC:
                counters.wrong_size += 1
                counters.last_size, counters.last_fault_time = length, arrival
                more = " or more" if flags & socket.MSG_TRUNC else ""
                counters.last_fault = f"{length} bytes{more}; expected {size}"
                continue
            layout, nan_allowed = self.layout, self._nan_allowed
            values = layout.decode(bytes(memoryview(scratch)[:size]))
            blanked = blank_not_finite(values, nan_allowed)
            if fault := find_not_finite(values, but=nan_allowed):
                counters.not_finite += 1
            elif layout.matrices:
                fault = find_not_frame(values, layout.matrices, column_major=layout.column_major)
                counters.not_frames += bool(fault)
            if fault:
                counters.last_fault_time = arrival
                counters.last_fault = fault
                continue
            counters.blanked += blanked
            number += 1
            self._latest = Packet(values, arrival, number)
            self._first.set()


def _dropped_by_kernel(ancillary: list[tuple[int, int, bytes]], before: int) -> int:
    for level, kind, data in ancillary:
        if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL:
            return int(struct.unpack("=I", data[:4])[0])
    return before
