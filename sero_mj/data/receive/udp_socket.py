"""Opens UDP sockets and reads packets in batches.

On Linux, one call of `recvmmsg` reads up to 256 packets with their arrival times. With waiting
packets of 112 bytes, it takes 15 us for one packet, 17 us for 8, and 114 us for 256. `recvmsg_into`
takes 3, 13 and 405 us, and also releases the interpreter lock for each packet. Beside a busy
thread, the 99th percentile for 64 packets is therefore 26 ms instead of 10 ms. Receiving 300,000
packets/s while rendering (docs/peers.md) leaves 3.3 us for each packet.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import ipaddress
import os
import socket
import struct
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.errors import SourceError
from ...base.frames import Array, Ints
from .structure import Rows

DEFAULT_BUFFER = 4 * 2**20  # bytes; the system may grant less
_SO_RCVBUFFORCE = 33  # with permission, may exceed net.core.rmem_max on Linux
_REASONS = {
    errno.EADDRINUSE: " is in use by another program. Close it, or choose another port",
    errno.EACCES: ": no permission. Choose a port above 1023",
    errno.ENODEV: ": no route for this group. Set interface = ... to choose the network",
}

BATCH = 256  # packets
_ADDRESS_BYTES, _V4_BYTES = 28, 16  # sizes of sockaddr_in6 and sockaddr_in
_CONTROL_BYTES = 64  # a time stamp (32) and a count of dropped packets (24)
_MAPPED = bytes(10) + b"\xff\xff"  # prefix of an IPv4 address in IPv6
# Constants of Linux that Python's socket module does not have.
_SO_TIMESTAMPNS = 35
_SO_RXQ_OVFL = 40
_WSAEMSGSIZE = 10040  # Windows error if a packet is longer than the buffer
_UNKNOWN = ("0.0.0.0", 0)


class _Iovec(ctypes.Structure):
    _fields_ = [("base", ctypes.c_void_p), ("length", ctypes.c_size_t)]


class _Msghdr(ctypes.Structure):
    _fields_ = [
        ("name", ctypes.c_void_p),
        ("namelen", ctypes.c_uint32),
        ("iov", ctypes.c_void_p),
        ("iovlen", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("controllen", ctypes.c_size_t),
        ("flags", ctypes.c_int),
    ]


class _Mmsghdr(ctypes.Structure):
    _fields_ = [("header", _Msghdr), ("length", ctypes.c_uint)]


# The first control message: header, then seconds and nanoseconds of a 64-bit system.
_STAMP = np.dtype(
    {
        "names": ["level", "kind", "seconds", "nanoseconds"],
        "formats": ["i4", "i4", "i8", "i8"],
        "offsets": [8, 12, 16, 24],
        "itemsize": _CONTROL_BYTES,
    }
)

OnArrival = Callable[[memoryview, int, bytes], None]


@dataclass(frozen=True, eq=False)
class Batch:
    """n consecutive packets of a socket, valid until the next call of `Datagrams.read`.

    Attributes:
        rows: packets, shape (n, `max_bytes`); longer packets are truncated.
        lengths: lengths of the packets before truncation, shape (n,). If the system does not report
            the length of a truncated packet, its length is a lower bound.
        arrivals: arrival times in seconds on the clock of `time.monotonic`, shape (n,).
        senders: socket addresses in the layout of Linux, shape (n, 28), see `pack_address`.
        dropped: total number of packets that the kernel has dropped; None if unknown.
    """

    rows: Rows
    lengths: Ints
    arrivals: Array
    senders: Rows
    dropped: int | None

    def __len__(self) -> int:
        return len(self.lengths)


class Datagrams:
    """Reads the packets of a UDP socket in batches, and sends answers.

    Args:
        sock: bound UDP socket, which becomes non-blocking.
        max_bytes: number of bytes after which packets are truncated.

    Attributes:
        on_arrival: function that is called as soon as a packet is read, with its bytes, its length,
            and its sender as in `Batch.senders`; or None.
    """

    def __init__(self, sock: socket.socket, max_bytes: int) -> None:
        sock.setblocking(False)
        self.on_arrival: OnArrival | None = None
        self._socket = sock
        self._rows = np.zeros((BATCH, max_bytes), np.uint8)
        self._senders = np.zeros((BATCH, _ADDRESS_BYTES), np.uint8)
        self._lengths, self._times = np.zeros(BATCH, np.intp), np.zeros(BATCH)
        self.waiting = 0
        self._recvmmsg: Any = None
        self._sendto: Any = None
        self._dropped: int | None = None
        self._last_arrival = -np.inf  # s
        if sys.platform == "linux":
            for option in (_SO_RXQ_OVFL, _SO_TIMESTAMPNS):
                sock.setsockopt(socket.SOL_SOCKET, option, 1)
            # PyDLL does not release the interpreter lock, because these calls do not block.
            # Regaining it from a thread that renders takes up to the switch interval.
            library = ctypes.PyDLL(None, use_errno=True)
            self._recvmmsg = getattr(library, "recvmmsg", None)
            self._sendto = getattr(library, "sendto", None)
            self._dropped = 0
        if self._recvmmsg is not None:
            self._prepare()

    def _prepare(self) -> None:
        self._controls = np.zeros((BATCH, _CONTROL_BYTES), np.uint8)
        self._vectors = np.zeros(BATCH, np.dtype(_Iovec))
        self._vectors["base"], self._vectors["length"] = _addresses(self._rows), self._rows.shape[1]
        self._headers = (_Mmsghdr * BATCH)()
        states = np.frombuffer(memoryview(self._headers), np.dtype(_Mmsghdr))
        header = states["header"]
        header["name"], header["namelen"] = _addresses(self._senders), _ADDRESS_BYTES
        header["iov"], header["iovlen"] = _addresses(self._vectors), 1
        header["control"], header["controllen"] = _addresses(self._controls), _CONTROL_BYTES
        # Fields changed by the kernel.
        self._got, self._namelen = states["length"], header["namelen"]
        self._controllen = header["controllen"]
        self._row_views = [memoryview(row) for row in self._rows]  # type: ignore[arg-type]
        self._sender_view = memoryview(self._senders.reshape(-1))  # type: ignore[arg-type]
        self._stamps = self._controls.view(_STAMP)[:, 0]
        size, flags = ctypes.sizeof(_Mmsghdr), socket.MSG_DONTWAIT | socket.MSG_TRUNC
        fileno = ctypes.c_int(self._socket.fileno())
        self._arguments = [
            (fileno, ctypes.byref(self._headers, first * size), BATCH - first, flags, None)
            for first in range(BATCH)
        ]

    def receive(self) -> Batch | None:
        """Returns up to 256 available packets, or None if there are none; raises OSError."""
        self.read()
        return self.take()

    def read(self) -> int:
        """Reads available packets for `take`, and returns their number; raises OSError."""
        if self.waiting == BATCH:
            return 0
        count = self._read_each() if self._recvmmsg is None else self._read_batch()
        self.waiting += count
        return count

    def take(self) -> Batch | None:
        """Returns the packets read since the last call, or None if there are none."""
        count, self.waiting = self.waiting, 0
        if not count:
            return None
        rows, senders = self._rows[:count], self._senders[:count].copy()
        if self._recvmmsg is None:
            lengths, arrivals = self._lengths[:count].copy(), self._times[:count].copy()
            return Batch(rows, lengths, arrivals, senders, self._dropped)
        lengths = self._got[:count].astype(np.intp)
        arrivals = self._arrivals(count)
        if (self._controllen[:count] > 32).any():
            self._dropped = self._read_dropped(count)
        self._namelen[:count], self._controllen[:count] = _ADDRESS_BYTES, _CONTROL_BYTES
        return Batch(rows, lengths, arrivals, senders, self._dropped)

    def send(self, data: bytes, to: bytes) -> None:
        """Sends a packet to an address as in `Batch.senders`; raises OSError."""
        if self._sendto is None:
            self._socket.sendto(data, _as_tuple(to))
            return
        length = _V4_BYTES if to[0] == socket.AF_INET else _ADDRESS_BYTES
        sent = self._sendto(
            ctypes.c_int(self._socket.fileno()),
            data,
            ctypes.c_size_t(len(data)),
            ctypes.c_int(socket.MSG_DONTWAIT),
            to,
            ctypes.c_uint(length),
        )
        if sent < 0:
            error = ctypes.get_errno()
            raise OSError(error, os.strerror(error))

    def _read_batch(self) -> int:
        first = self.waiting
        count = int(self._recvmmsg(*self._arguments[first]))
        if count <= 0:
            error = ctypes.get_errno()
            if count == 0 or error in (11, 4):  # EAGAIN, EINTR
                return 0
            raise OSError(error, os.strerror(error))
        if (on_arrival := self.on_arrival) is not None:
            # NumPy is slow here, because a renderer displaces its code from the processor cache.
            for i in range(first, first + count):
                sender = self._sender_view[i * _ADDRESS_BYTES : (i + 1) * _ADDRESS_BYTES]
                on_arrival(self._row_views[i], self._headers[i].length, bytes(sender))
        return count

    def _arrivals(self, count: int) -> Array:
        now, wall = _both_clocks()
        stamps = self._stamps[:count]
        if not (stamps["kind"] == _SO_TIMESTAMPNS).all():
            return np.full(count, now * 1e-9)
        stamped = stamps["seconds"] * 1_000_000_000 + stamps["nanoseconds"]
        # Times are wrong if the wall clock was set, or the thread was interrupted between reading
        # the clocks. Arrivals are ordered and not in the future.
        arrivals: Array = (now - np.maximum(wall - stamped, 0)) * 1e-9
        arrivals = np.maximum.accumulate(np.maximum(arrivals, self._last_arrival))
        self._last_arrival = float(arrivals[-1])
        return arrivals

    def _read_dropped(self, count: int) -> int | None:
        for control in self._controls[count - 1 :: -1]:
            level, kind = struct.unpack_from("=ii", control, 40)
            if level == socket.SOL_SOCKET and kind == _SO_RXQ_OVFL:
                return int(struct.unpack_from("=I", control, 48)[0])
        return self._dropped

    def _read_each(self) -> int:
        first = self.waiting
        for i in range(first, BATCH):
            try:
                length, sender = self._receive_into(self._rows[i].data)
            except BlockingIOError:
                return i - first
            self._times[i] = time.monotonic()
            self._lengths[i] = length
            packed = pack_address(*sender[:2])
            if self.on_arrival is not None:
                self.on_arrival(self._rows[i].data, int(self._lengths[i]), packed)
            self._senders[i] = np.frombuffer(packed, np.uint8)
        return BATCH - first

    def _receive_into(self, row: memoryview) -> tuple[int, Any]:
        if hasattr(self._socket, "recvmsg_into"):
            length, _, flags, sender = self._socket.recvmsg_into([row])
            return (len(row) + 1 if flags & socket.MSG_TRUNC else length), sender
        try:
            return self._socket.recvfrom_into(row)
        except OSError as error:  # for long packets, Windows does not report the sender
            if getattr(error, "winerror", None) != _WSAEMSGSIZE:
                raise
            return len(row) + 1, _UNKNOWN


def _addresses(rows: NDArray[Any]) -> Ints:
    return np.asarray(rows.ctypes.data + rows.strides[0] * np.arange(len(rows)))


def _both_clocks() -> tuple[int, int]:
    """Returns the monotonic and the wall clock in ns, if possible without an interruption."""
    for _ in range(4):
        before, wall, after = time.monotonic_ns(), time.time_ns(), time.monotonic_ns()
        if after - before < 20_000:
            break  # not interrupted by another thread
    return before, wall


def pack_address(host: str, port: int) -> bytes:
    """Packs an address into 28 bytes in the layout of Linux's `sockaddr_in` or `sockaddr_in6`."""
    if ":" in host:
        packed = socket.inet_pton(socket.AF_INET6, host.partition("%")[0])
        return struct.pack("=H2s4x16s4x", 10, port.to_bytes(2, "big"), packed)
    packed = socket.inet_pton(socket.AF_INET, host)
    return struct.pack("=H2s4s20x", 2, port.to_bytes(2, "big"), packed)


def unpack_address(packed: bytes) -> tuple[str, int]:
    """Returns the address and port in a row of `Batch.senders`."""
    port = int.from_bytes(packed[2:4], "big")
    if packed[0] == 2:
        return socket.inet_ntop(socket.AF_INET, packed[4:8]), port
    return socket.inet_ntop(socket.AF_INET6, packed[8:24]), port


def _as_tuple(packed: bytes) -> tuple[str, int] | tuple[str, int, int, int]:
    host, port = unpack_address(packed)
    if ":" not in host:
        return host, port
    (scope,) = struct.unpack_from("=I", packed, 24)  # link-local addresses need their interface
    return host, port, 0, scope


def canonical_address(packed: bytes) -> tuple[bytes, int]:
    """Returns the IPv6 address (16 bytes) and the port in a row of `Batch.senders`.

    IPv4 addresses are mapped to IPv6 (`::ffff:192.168.0.7`), as by a socket bound to `::`.
    """
    port = int.from_bytes(packed[2:4], "big")
    return (_MAPPED + packed[4:8] if packed[0] == 2 else packed[8:24]), port


def is_multicast(host: str) -> bool:
    """Returns whether an address is a multicast group."""
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_multicast
    except ValueError:
        return False


def _needs_interface(host: str) -> bool:
    try:
        address = ipaddress.IPv6Address(host)
    except ValueError:
        return False
    # The second byte of a group is its scope: 1 for the machine, 2 for the network.
    return address.is_link_local or (address.is_multicast and address.packed[1] & 15 in (1, 2))


def _interfaces() -> str:
    return ", ".join(name for _, name in socket.if_nameindex())


def open_socket(source: str, host: str, port: int, interface: str, buffer: int) -> socket.socket:
    """Returns a bound UDP socket; raises SourceError.

    Args:
        source: name of the source for error messages.
        interface: name or IPv4 address of the network interface of a multicast group; empty to let
            the system choose.
        buffer: size of the receive buffer in bytes; 0 for 4 MiB, or less if this is not allowed.
    """
    place = f"UDP port {port} on {host}"
    address, _, zone = host.partition("%")
    if _needs_interface(host) and not interface and not zone:
        why = "this address exists on every network. Set interface = ... to choose one"
        raise SourceError(source, f"{place}: {why}; available: {_interfaces()}")
    sock = None
    try:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_DGRAM)
        _set_buffer(sock, buffer)
        if is_multicast(host):
            _join(sock, host, port, interface)
        elif _needs_interface(host):
            sock.bind((address, port, 0, socket.if_nametoindex(interface or zone)))
        else:
            sock.bind((host, port))
    # Invalid names raise TypeError or UnicodeError, unknown names OSError.
    except (OSError, TypeError, UnicodeError) as error:
        if sock is not None:
            sock.close()
        raise SourceError(source, f"{place}{_why(error, interface or zone)}") from error
    return sock


def _set_buffer(sock: socket.socket, size: int) -> None:
    wanted = size or DEFAULT_BUFFER
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted)
    except OSError:  # some systems refuse excessive sizes
        if size:
            raise
    if not size and sys.platform == "linux":
        with contextlib.suppress(OSError):  # requires the permission CAP_NET_ADMIN
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted)


def _join(sock: socket.socket, group: str, port: int, interface: str) -> None:
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if sock.family == socket.AF_INET6:
        address, _, zone = group.partition("%")
        index = socket.if_nametoindex(interface or zone) if interface or zone else 0
        sock.bind((address, port, 0, index))
        packed = socket.inet_pton(socket.AF_INET6, address)
        joined = struct.pack("=16sI", packed, index)
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, joined)
        return
    # On Linux, a socket bound to the group receives only its packets. Windows cannot bind to it.
    sock.bind((group if sys.platform == "linux" else "", port))
    here = "0.0.0.0"
    index = 0
    if interface:
        try:
            here = str(ipaddress.IPv4Address(interface))
        except ValueError:
            index = socket.if_nametoindex(interface)
    joined = socket.inet_aton(group) + socket.inet_aton(here)
    if index:
        joined += struct.pack("=i", index)
    sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)


def _why(error: Exception, interface: str) -> str:
    if not isinstance(error, OSError):
        return f": not an address: {error}"
    # Python's error for a missing interface has no errno.
    unknown = (None, errno.ENODEV, errno.EADDRNOTAVAIL, errno.ENXIO)
    names = [name for _, name in socket.if_nameindex()]
    if interface and interface not in names and error.errno in unknown:
        return f": no network interface '{interface}'; available: {_interfaces()}"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return ": not an address of this machine; expected 127.0.0.1 or 0.0.0.0, for example"
    return _REASONS.get(error.errno or 0, f": {error.strerror or error}")
