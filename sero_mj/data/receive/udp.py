"""Receives packets from a UDP socket in a thread (Fig. 5 of the paper)."""

from __future__ import annotations

import ipaddress
import selectors
import socket
import time
from collections.abc import Callable
from functools import lru_cache
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, PrivateAttr, field_validator

from ...base.errors import mismatch
from .connecting import is_address
from .reception import log
from .source import Source
from .udp_socket import (
    BATCH,
    Batch,
    Datagrams,
    OnArrival,
    canonical_address,
    open_socket,
    pack_address,
)

# At high rates, reading several packets at once leaves more time to the renderer, which shares the
# interpreter with this thread.
_BUSY_BATCH = 8  # packets in a batch
_GATHER_TIME = 5e-4  # s
_MAX_CHECK_DELAY = 4e-3  # s that answered packets may wait until they are checked


def _as_list(value: Any) -> Any:
    return [value] if isinstance(value, str) else value


class UdpReceiver(Source):
    """Receives UDP packets of one structure.

    Attributes:
        udpport: port to listen on (`port` in files); 0 lets the system choose.
        host: address to listen on: `0.0.0.0` for all IPv4 interfaces, `::` for all interfaces, or a
            multicast group to join (`239.0.0.1`, `ff02::1`).
        interface: name or address of the network interface of a multicast group; required for
            addresses that exist on every network (`ff02::1`, `fe80::1`).
        sender: addresses of accepted senders, with or without a port (`192.168.0.7:1234`,
            `[fe80::1]:1234`); empty for any sender. Other packets are counted as `foreign`.
        buffer_size: size of the kernel's receive buffer in bytes; 0 for 4 MiB, or less if the
            system does not allow it.
    """

    name: str = "udp"
    udpport: int = Field(0, alias="port", ge=0, le=65535)
    host: Annotated[str, AfterValidator(is_address("an address such as 127.0.0.1 or 0.0.0.0"))] = (
        "127.0.0.1"
    )
    interface: str = ""
    sender: Annotated[
        list[str], BeforeValidator(_as_list, json_schema_input_type=str | list[str])
    ] = []
    buffer_size: int = Field(0, ge=0, le=2**31 - 1)

    _min_row_bytes: ClassVar[int] = 2048  # malformed packets up to this size are recorded whole
    _socket: socket.socket | None = PrivateAttr(None)
    _allowed: frozenset[tuple[bytes, int]] = PrivateAttr(frozenset())

    @field_validator("sender")
    @classmethod
    def _check_senders(cls, senders: list[str]) -> list[str]:
        for sender in senders:
            split_sender(sender)
        return senders

    @property
    def place(self) -> tuple[str, int]:
        return self.host, self.udpport

    @property
    def port(self) -> int:
        """Port on which the source listens, even if the system has chosen it."""
        return int(self._socket.getsockname()[1]) if self._socket else self.udpport

    @property
    def about(self) -> str:
        return f"UDP {self.host}:{self.port}"

    def open(self) -> None:
        self.close()
        self._socket = open_socket(
            self.name, self.host, self.udpport, self.interface, self.buffer_size
        )
        self.reset()
        self._allowed = frozenset(
            canonical_address(pack_address(*split_sender(sender))) for sender in self.sender
        )
        if self.debug_level >= 2:
            log.info("source '%s': listening on %s", self.name, self.about)
        self.start_receiving(self._receive, name=f"udp {self.name}")

    def close(self) -> None:
        self.stop_receiving()
        if self._socket is not None:
            self._socket.close()
        self._socket = None

    def _receive(self, wake: socket.socket) -> None:
        sock = self._socket
        assert sock is not None
        # On systems that do not report packets that are too long, one more byte than a packet has
        # reveals them.
        datagrams = Datagrams(sock, max(self.layout.size + 1, self._min_row_bytes))
        datagrams.on_arrival = self._on_arrival(datagrams.send)
        answers, since = datagrams.on_arrival is not None, 0.0
        with selectors.DefaultSelector() as selector:
            selector.register(sock, selectors.EVENT_READ)
            selector.register(wake, selectors.EVENT_READ)
            while not self.closing.is_set():
                try:
                    count = datagrams.read()
                except ConnectionError:  # on Windows, if nobody listens for an answer
                    continue
                if answers and datagrams.waiting < BATCH:
                    # The next answer is more urgent than checking packets.
                    if count and datagrams.waiting == count:
                        since = time.monotonic()
                    left = (
                        _MAX_CHECK_DELAY - (time.monotonic() - since) if datagrams.waiting else None
                    )
                    if left is None or left > 0.0:
                        selector.select(left)
                        continue
                batch = datagrams.take()
                if batch is None:
                    selector.select()
                    continue
                if batch.dropped is not None:
                    self.counters.dropped = batch.dropped
                self._take_in(batch)
                if _BUSY_BATCH <= len(batch) < BATCH and not answers:
                    self.closing.wait(_GATHER_TIME)
        if (batch := datagrams.take()) is not None:
            self._take_in(batch)

    def _on_arrival(self, send: Callable[[bytes, bytes], None]) -> OnArrival | None:
        """Returns a function that is called for each packet before checking its sender, or None."""
        return None

    def _is_known(self, sender: bytes) -> bool:
        return not self._allowed or _is_among(sender, self._allowed)

    def _take_in(self, batch: Batch) -> None:
        rows, lengths, arrivals, senders = batch.rows, batch.lengths, batch.arrivals, batch.senders
        if self._allowed:
            if (senders == senders[0]).all():
                known = np.full(len(batch), self._is_known(senders[0].tobytes()))
            else:
                known = np.array([self._is_known(sender.tobytes()) for sender in senders])
            if not known.all():
                foreign = int((~known).sum())
                self.counters.foreign += foreign
                self.counters.received += foreign
                if not known.any():
                    return
                rows, lengths = rows[known], lengths[known]
                arrivals, senders = arrivals[known], senders[known]
        self._accept(rows, lengths, arrivals, senders)


def split_sender(text: str) -> tuple[str, int]:
    """Splits `192.168.0.7:1234` into address and port (0 if missing); raises ValueError."""
    host, port = text, ""
    if text.startswith("["):
        host, _, port = text[1:].partition("]")
        port = port.removeprefix(":")
    elif text.count(":") == 1:
        host, _, port = text.partition(":")
    try:
        address = ipaddress.ip_address(host)
        number = int(port or 0)
    except ValueError:
        number = -1
    else:
        if address.is_unspecified or address.is_multicast:
            raise ValueError(
                f"found {text!r}, which cannot be the address of a sender. Remove it to accept "
                "any sender"
            )
    if not 0 <= number <= 65535:
        raise mismatch(text, "an address such as 192.168.0.7, 192.168.0.7:1234 or [fe80::1]:1234")
    return host, number


@lru_cache(maxsize=1024)
def _is_among(sender: bytes, allowed: frozenset[tuple[bytes, int]]) -> bool:
    address, port = canonical_address(sender)
    return (address, port) in allowed or (address, 0) in allowed
