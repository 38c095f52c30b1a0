"""Receives packets from POSIX shared memory."""

from __future__ import annotations

import socket
import threading
import time as clock

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from ...base.errors import SourceError
from .language import Item
from .mailbox import Packet, Packets
from .reception import log
from .shm_block import Block, block_path
from .source import Source

_BLOCK_POLL_INTERVAL = 0.02  # s between checks whether the block was created or recreated
_LOCK_TIMEOUT = 2e-3  # s that a frame waits while another thread reads the block
_COUNT_INTERVAL = 1.0  # s between counts of a block that is too small
_GATHER_TIME = 8e-4  # s; faster packets are checked together, because ten take as long as one
_MAX_ATTEMPTS = 50  # attempts to read a packet between two writes, within about 200 us
_MAX_SPIN = 2e-4  # s; longer values of `settle` are checked at the next poll
_MAX_WRITE_TIME = 0.1  # s; a writer that needs longer has stopped


class ShmReader(Source):
    """Reads packets of one structure from a block of POSIX shared memory.

    The block need not exist: it is opened when it is created, and reopened when it is recreated. A
    packet is new if its bytes differ from those of the last packet. If packets can repeat, add a
    counter or a time to the structure. Otherwise, a writer of equal packets is reported as silent.

    Torn packets, which are only partly written, are detected in different ways:

    - With `lock`, torn packets are never applied. The writer sets this number to an odd value
      before it writes, and to another even value afterwards (a seqlock).
    - Without a lock, a packet is applied if it has not changed for `settle` seconds. If the writer
      is interrupted for longer, a torn packet is applied.
    - With `sequence` and without a lock, the sequence number must have changed as well. If the
      writer writes this number last, most interruptions are detected.

    Packets that are replaced before they are read are counted as `lost` only with a `sequence`.

    Attributes:
        block: name of the shared memory, such as `robot` or `/robot`.
        lock: event that is odd while the writer writes, and 0 before the first packet; empty for
            none.
        offset: position of the packet in the block in bytes.
        poll_rate: rate in Hz at which the block is read. It is also read for each frame.
        settle: time in seconds for which a packet must not change if there is no lock.
    """

    name: str = "shm"
    block: str
    lock: str = ""
    offset: int = Field(0, ge=0, le=2**40)
    poll_rate: float = Field(2000.0, ge=1.0, le=1e5)
    settle: float = Field(2e-5, ge=0, le=10.0)

    _block: Block | None = PrivateAttr(None)
    _reading: threading.Lock = PrivateAttr(default_factory=threading.Lock)
    _wake: threading.Lock = PrivateAttr(default_factory=threading.Lock)
    _is_callback_due: bool = PrivateAttr(False)
    _packets: _PacketFinder | None = PrivateAttr(None)
    _next_reopen: float = PrivateAttr(0.0)
    _next_count: float = PrivateAttr(0.0)
    # Packets to be checked, with the times at which they were read.
    _gathered: list[tuple[bytes, float]] = PrivateAttr(default_factory=list)
    _checked: float = PrivateAttr(-np.inf)  # time of the last check, s

    @field_validator("block")
    @classmethod
    def _check_block(cls, block: str) -> str:
        block_path(block)
        return block

    @field_validator("lock")
    @classmethod
    def _check_lock_event(cls, event: str, info: ValidationInfo) -> str:
        return cls._check_number_event(event, info)

    @model_validator(mode="after")
    def _check_lock(self) -> ShmReader:
        if not self.lock:
            return self
        if self.lock == self.sequence:
            reason = "but a lock increases by two. Remove `sequence`"
            raise ValueError(f"'{self.lock}' is both lock and sequence, {reason}")
        field = self.layout.field(self.lock)
        if (self.offset + field.offset) % field.item_bytes:
            expected = f"expected a multiple of {field.item_bytes}, so that it cannot be torn"
            found = f"lock '{self.lock}' is at byte {self.offset + field.offset}"
            raise ValueError(f"{found}; {expected}. For example, set alignment = 8")
        return self

    @property
    def about(self) -> str:
        return f"shared memory {block_path(self.block)}"

    @property
    def memory(self) -> tuple[str, str, int]:
        return self.block, self.lock, self.offset

    @property
    def trouble(self) -> str:
        return self._trouble or (self._packets.trouble if self._packets is not None else "")

    def open(self) -> None:
        self.close()
        self.reset()
        self._packets = _PacketFinder(self)
        self._gathered, self._checked = [], -np.inf
        self._next_count, self._next_reopen = 0.0, clock.monotonic() + _BLOCK_POLL_INTERVAL
        try:
            self._block = Block(self.block)
        except FileNotFoundError:
            self._trouble = f"no {self.about} yet"
        except OSError as error:
            raise SourceError(self.name, f"{self.about}: {_why(error)}") from error
        if self.debug_level >= 2:
            log.info("source '%s': reading %s", self.name, self.about)
        self._wake = threading.Lock()
        self._wake.acquire()
        self.start_receiving(self._receive, self._wake.release, name=f"shm {self.name}")

    def close(self) -> None:
        self.stop_receiving()
        with self._reading:
            if self._block is not None:
                self._block.close()
            self._block = None

    def latest(self) -> Packet | None:
        self._read_now()
        return super().latest()

    def take(self) -> Packets | None:
        self._read_now()
        return super().take()

    def _read_now(self) -> None:
        # Reads the block before the latest packet is returned.
        # If no packet may be lost, `accept` may wait until the caller of this method takes packets.
        if self._thread is None or self._thread.is_current or not self.only_latest_packet:
            return
        # The lock is held while the thread reads, or during a callback that waits for this thread.
        if self._reading.acquire(timeout=_LOCK_TIMEOUT):
            try:
                if not self.closing.is_set():
                    self._poll()
                    self._check()
            except Exception as error:  # must not end the loop of the consumer
                self.note_failure(error)
            finally:
                self._reading.release()

    def wait(self, timeout: float) -> bool:
        has_come = super().wait(timeout)
        if not has_come and self.trouble and self.debug_level >= 1:
            log.warning("source '%s': %s", self.name, self.trouble)
        return has_come

    def _call_back(self) -> None:
        # A consumer's thread must not run callbacks, which may wait for a lock that it holds.
        self._is_callback_due = self._thread is None or not self._thread.is_current
        if not self._is_callback_due:
            super()._call_back()

    def _receive(self, _: socket.socket) -> None:
        period, reading, wake = 1.0 / self.poll_rate, self._reading, self._wake
        while not self.closing.is_set():
            with reading:
                self._poll()
                if self._gathered and clock.monotonic() - self._checked >= _GATHER_TIME:
                    self._check()
                if self._is_callback_due:
                    self._call_back()
            # A lock is faster than an Event, and has the same latency.
            wake.acquire(timeout=period)
        self._check()

    def _poll(self) -> None:
        now = clock.monotonic()
        try:
            if now >= self._next_reopen:
                self._next_reopen = now + _BLOCK_POLL_INTERVAL
                self._reopen()
            block, packets = self._block, self._packets
            if block is None or packets is None:
                return
            found = packets.find(block)
        except OSError as error:
            self._trouble = f"{self.about}: {_why(error)}"
            return
        if found is None:
            if packets.torn:
                self.counters.torn += packets.torn
                packets.torn = 0
        elif len(found) == self.size:
            self._gathered.append((found, now))
        elif now >= self._next_count and block.size:  # a block is created with the size 0
            self._next_count = now + _COUNT_INTERVAL
            self._gathered.append((found, now))

    def _check(self) -> None:
        if not self._gathered:
            return
        gathered, self._gathered = self._gathered, []
        packets, arrivals = zip(*gathered, strict=True)
        self.accept(packets, arrivals)
        self._checked = clock.monotonic()

    def _reopen(self) -> None:
        old = self._block
        assert self._packets is not None
        try:
            found = Block(self.block)
        except FileNotFoundError:
            # The unlinked block stays open because its writer may still run, and so that a new
            # block cannot have the same identity.
            is_gone = old is not None or self.receive_trigger
            self._trouble = f"{self.about} is gone" if is_gone else f"no {self.about} yet"
            return
        if old is not None and found.identity == old.identity and any(found.identity):
            found.close()
            self._trouble = ""
            return
        self._trouble = ""
        if old is not None:
            old.close()
            if any(found.identity):
                self._check()
                self.intake.restart()
                self._packets.forget()
                if self.debug_level >= 2:
                    log.info("source '%s': %s was recreated", self.name, self.about)
        self._block = found


def _why(error: OSError) -> str:
    if isinstance(error, PermissionError):
        return "no permission to read it; its writer must set mode 0644"
    return error.strerror or str(error)


class _PacketFinder:
    def __init__(self, reader: ShmReader) -> None:
        self.torn, self.trouble = 0, ""
        layout = reader.layout
        self._about, self._lock_name = reader.about, reader.lock
        self._size, self._offset, self._settle = layout.size, reader.offset, reader.settle
        self._lock = layout.field(reader.lock) if reader.lock else None
        self._sequence = layout.field(reader.sequence) if reader.sequence else None
        self.forget()

    def forget(self) -> None:
        self._done = b""  # the last packet returned
        self._candidate = b""  # a new packet that may be incomplete
        self._unfinished = b""  # a packet that is incomplete according to its lock
        self._since = 0.0  # time at which either was read first

    def find(self, block: Block) -> bytes | None:
        """Returns a new and complete packet, or contents that are too short, or None."""
        # Taken before reading, so that an interruption does not count as time without changes.
        started = clock.monotonic()
        seen = block.read(self._size, self._offset)
        if seen == self._done and seen:
            return None
        if len(seen) < self._size:
            expected = self._offset + self._size
            self.trouble = f"{self._about} has {block.size} bytes; expected {expected}"
            return seen
        if not self._done and seen.count(0) == len(seen):
            size = f"{block.size} bytes"
            self.trouble = f"{self._about} exists ({size}), but nothing has been written yet"
            return None
        if self._lock is not None:
            packet = self._find_locked(block, self._lock, seen)
        elif self._sequence is None or not self._done or _differ(seen, self._done, self._sequence):
            packet = self._find_candidate(block, seen, started)
        else:
            packet = None  # the writer has begun the next packet
        if packet is not None:
            self._done, self._unfinished, self._candidate = packet, b"", b""
            self.trouble = ""
        return packet

    def _find_locked(self, block: Block, field: Item, seen: bytes) -> bytes | None:
        if seen == self._unfinished:  # still the same write
            if clock.monotonic() - self._since > _MAX_WRITE_TIME:
                self.trouble = (
                    f"the writer of {self._about} stopped in the middle of a packet: "
                    f"'{self._lock_name}' is odd"
                )
            return None
        begin, count = field.offset, field.end - field.offset
        packet = seen
        for _ in range(_MAX_ATTEMPTS):
            before = block.read(count, self._offset + begin)
            packet = block.read(self._size, self._offset)
            after = block.read(count, self._offset + begin)
            if len(packet) < self._size:
                return None  # the block has shrunk
            if before == after == packet[begin : field.end] and is_even(before, field):
                return packet if self._is_counted(packet, before) else None
        self.torn += 1
        if not is_even(packet[begin : field.end], field):
            self._unfinished, self._since = packet, clock.monotonic()
        return None

    def _is_counted(self, packet: bytes, lock: bytes) -> bool:
        if packet == self._done:
            return False
        name, about = self._lock_name, self._about
        if not any(lock):
            self.trouble = f"nothing has been written to {about}: '{name}' is 0"
        elif self._done and not _differ(packet, self._done, self._lock):
            self.trouble = f"the writer of {about} does not increase '{name}' for each packet"
        else:
            return True
        return False

    def _find_candidate(self, block: Block, seen: bytes, started: float) -> bytes | None:
        is_same = seen == self._candidate
        if is_same and started - self._since >= self._settle:
            return seen
        if self._settle > _MAX_SPIN:
            if not is_same:
                self.torn += bool(self._candidate)
                self._candidate, self._since = seen, clock.monotonic()
            return None
        changes, since = 0, clock.monotonic()
        while changes < _MAX_ATTEMPTS:
            started = clock.monotonic()
            again = block.read(self._size, self._offset)
            if len(again) < self._size:
                return None
            if again != seen:
                seen, since, changes = again, clock.monotonic(), changes + 1
            elif started - since >= self._settle:
                return seen
        self.torn += 1
        self.trouble = f"{self._about} changes continuously; its writer needs a lock"
        self._candidate, self._since = seen, since
        return None


def is_even(number: bytes, field: Item) -> bool:
    """Returns whether the bytes of a lock are an even number; false for NaN and fractions."""
    dtype = field.dtype
    if dtype.kind == "f":
        return bool(np.frombuffer(number, dtype)[0] % 2 == 0)
    return not number[-1 if dtype.byteorder == ">" else 0] & 1


def _differ(packet: bytes, other: bytes, field: Item | None) -> bool:
    return field is None or packet[field.offset : field.end] != other[field.offset : field.end]
