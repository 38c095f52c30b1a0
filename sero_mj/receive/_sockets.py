"""Opens the UDP sockets that packets come in by, and says clearly why one cannot be opened."""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import socket
import struct
import sys

from ..errors import SourceError

DEFAULT_BUFFER = 4 * 2**20  # bytes; the system may grant less
_SO_RCVBUFFORCE = 33  # Linux: beyond net.core.rmem_max, where the user may
_REASONS = {
    errno.EADDRINUSE: " is in use by another program; close that, or choose another port",
    errno.EACCES: ": no permission; choose a port above 1023",
    errno.ENODEV: ": no route for this group; name the network with interface = ...",
}


def is_multicast(host: str) -> bool:
    """Whether an address is a group that senders reach with one packet."""
    try:
        return ipaddress.ip_address(host.partition("%")[0]).is_multicast
    except ValueError:
        return False


def _needs_interface(host: str) -> bool:
    """Whether an address means something only together with a network: `ff02::1`, `fe80::1`."""
    try:
        address = ipaddress.IPv6Address(host)
    except ValueError:
        return False
    # Of a group the scope is in its second byte: 1 is this machine, 2 this network.
    return address.is_link_local or (address.is_multicast and address.packed[1] & 15 in (1, 2))


def _interfaces() -> str:
    return ", ".join(name for _, name in socket.if_nameindex())


def open_socket(source: str, host: str, port: int, interface: str, buffer: int) -> socket.socket:
    """Returns a bound UDP socket.

    Args:
        source: name of the source, for messages.
        host: address to listen on, or a multicast group to join.
        port: to listen on; 0 lets the system choose.
        interface: name or IPv4 address of the network interface on which a group is joined;
            empty for the system's choice.
        buffer: bytes of the receive buffer; 0 for 4 MiB, or what the system grants.

    Raises:
        SourceError: the port is in use, or the address is not one of this machine.
    """
    place = f"UDP port {port} on {host}"
    address, _, zone = host.partition("%")
    if _needs_interface(host) and not interface and not zone:
        why = "such an address is one on every network; name yours with interface = ..."
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
    # A name that cannot be one makes other errors than a name that is not known.
    except (OSError, TypeError, UnicodeError) as error:
        if sock is not None:
            sock.close()
        raise SourceError(source, f"{place}{_why(error, interface or zone)}") from error
    return sock


def _set_buffer(sock: socket.socket, size: int) -> None:
    wanted = size or DEFAULT_BUFFER
    try:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, wanted)
    except OSError:  # some systems refuse what they cannot grant
        if size:
            raise
    if not size and sys.platform == "linux":
        with contextlib.suppress(OSError):  # for the administrator only
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, wanted)


def _join(sock: socket.socket, group: str, port: int, interface: str) -> None:
    """Joins a multicast group; several programs of one machine may listen to it."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    if sock.family == socket.AF_INET6:
        address, _, zone = group.partition("%")
        index = socket.if_nametoindex(interface or zone) if interface or zone else 0
        sock.bind((address, port, 0, index))
        packed = socket.inet_pton(socket.AF_INET6, address)
        joined = struct.pack("=16sI", packed, index)
        sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, joined)
        return
    # On Linux a socket bound to the group gets nothing else; Windows cannot bind to one.
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
    # Python's own error for an interface that is not there has no number.
    unknown = (None, errno.ENODEV, errno.EADDRNOTAVAIL, errno.ENXIO)
    names = [name for _, name in socket.if_nameindex()]
    if interface and interface not in names and error.errno in unknown:
        return f": no network interface '{interface}'; available: {_interfaces()}"
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, socket.gaierror):
        return ": not an address of this machine; expected 127.0.0.1 or 0.0.0.0, say"
    return _REASONS.get(error.errno or 0, f": {error.strerror or error}")
