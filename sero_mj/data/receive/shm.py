"""`ShmReader`: receives packets from POSIX shared memory."""

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

_BLOCK_POLL_INTERVAL = 0.02  # s; delay until a created or recreated block is detected
_LOCK_TIMEOUT = 2e-3  # s; how long a frame waits while another thread reads the block
_COUNT_INTERVAL = 1.0  # s; between counts of a block that remains too small
_GATHER_TIME = 8e-4  # s; faster packets are checked together, since one costs as much as ten
_MAX_ATTEMPTS = 50  # at reading a packet between two writes; some 200 us
_MAX_SPIN = 2e-4  # s; a packet that has to be unchanged for longer is checked again later
_MAX_WRITE_TIME = 0.1  # s; upper bound for a live writer


class ShmReader(Source):
    """Reads packets of one structure from a block of POSIX shared memory.

    The block need not exist: it is opened when it appears, and again when it is recreated. A packet
    is new when its bytes differ; a writer that may repeat packets needs a counter or a time in the
    structure, or it is considered silent.

    A torn packet, written only in part, is not applied:

    - With `lock` never. The writer makes that number odd before it writes, and a different even
      number when it is done (a seqlock).
    - Without, a packet is applied when it has been unchanged for `settle`; a writer that is
      interrupted within a packet for longer is not detected.
    - With `sequence` alone likewise, and nothing is applied before the counter has changed: if the
      writer writes it last, an interruption is detected as well unless it has only just begun.

    Packets that the writer replaces before they are read are counted as `lost` if there is a
    `sequence`, since only their numbers show it.

    Attributes:
        block: name of the shared memory, `robot` or `/robot`.
        lock: event of the structure that is odd while the writer writes; empty for none. 0 means
            that nothing has been written yet.
        offset: of the packet in the block, bytes.
        poll_rate: at which the block is polled, Hz; in addition it is read for every frame.
        settle: without a lock, how long a packet has to be unchanged, s.
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
    _owes_call_back: bool = PrivateAttr(False)
    _packets: _PacketFinder | None = PrivateAttr(None)
    _look_next: float = PrivateAttr(0.0)
    _count_next: float = PrivateAttr(0.0)
    # Packets of any length to be checked, and when they were read.
    _gathered: list[tuple[bytes, float]] = PrivateAttr(default_factory=list)
    _checked: float = PrivateAttr(-np.inf)  # when others were

    @field_validator("block")
    @classmethod
    def _block_can_have_this_name(cls, block: str) -> str:
        block_path(block)
        return block

    @field_validator("lock")
    @classmethod
    def _lock_is_one_number(cls, event: str, info: ValidationInfo) -> str:
        return cls._is_one_number(event, info)

    @model_validator(mode="after")
    def _lock_can_be_one(self) -> ShmReader:
        if not self.lock:
            return self
        if self.lock == self.sequence:
            raise ValueError(
                f"'{self.lock}' is lock and sequence; a lock goes up by two: leave sequence out"
            )
        field = self.layout.field(self.lock)
        if at := (self.offset + field.offset) % field.item_bytes:
            expected = f"multiple of {field.item_bytes}"
            message = f"lock '{self.lock}' is {at} bytes behind a {expected}; expected it at one, "
            raise ValueError(message + "or it could be torn itself (alignment = 8 may help)")
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
        """Starts the thread that reads; the block need not exist; raises SourceError."""
        self.close()
        self.reset()
        self._packets = _PacketFinder(self)
        self._gathered, self._checked = [], -np.inf
        self._count_next, self._look_next = 0.0, clock.monotonic() + _BLOCK_POLL_INTERVAL
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
        """Returns the newest good packet, or None when there was none yet.

        Reads the block itself, so that a frame shows its current contents.
        """
        self._look_now()
        return super().latest()

    def take(self) -> Packets | None:
        """Returns the good packets since the last call, or None when there is none.

        Only the newest one, read from the block now, unless `only_latest_packet` is false.
        """
        self._look_now()
        return super().take()

    def _look_now(self) -> None:
        # If no packet may be lost, the caller must not wait for room that only it can make.
        if self._thread is None or self._thread.is_current or not self.only_latest_packet:
            return
        # The thread may be reading, which takes less, or in a callback that waits for us.
        if self._reading.acquire(timeout=_LOCK_TIMEOUT):
            try:
                if not self.closing.is_set():
                    self._poll()
                    self._check()
            except Exception as error:  # which must not end the consumer's loop
                self.note_failure(error)
            finally:
                self._reading.release()

    def wait(self, timeout: float) -> bool:
        """Waits up to `timeout` s for a good packet; returns whether one has arrived.

        Otherwise the reason is logged, if known.
        """
        has_come = super().wait(timeout)
        if not has_come and self.trouble and self.debug_level >= 1:
            log.warning("source '%s': %s", self.name, self.trouble)
        return has_come

    def _call_back(self) -> None:
        # Not on a consumer's thread, which may hold a lock that the callback waits for.
        self._owes_call_back = self._thread is None or not self._thread.is_current
        if not self._owes_call_back:
            super()._call_back()

    def _receive(self, _: socket.socket) -> None:
        period, reading, wake = 1.0 / self.poll_rate, self._reading, self._wake
        while not self.closing.is_set():
            with reading:
                self._poll()
                if self._gathered and clock.monotonic() - self._checked >= _GATHER_TIME:
                    self._check()
                if self._owes_call_back:
                    self._call_back()
            # Cheaper than waiting for an Event, with the same latency.
            wake.acquire(timeout=period)
        self._check()

    def _poll(self) -> None:
        now = clock.monotonic()
        try:
            if now >= self._look_next:
                self._look_next = now + _BLOCK_POLL_INTERVAL
                self._look_for_another()
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
        elif now >= self._count_next and block.size:  # else it has just been created
            self._count_next = now + _COUNT_INTERVAL
            self._gathered.append((found, now))

    def _check(self) -> None:
        if not self._gathered:
            return
        gathered, self._gathered = self._gathered, []
        packets, arrivals = zip(*gathered, strict=True)
        self.accept(packets, arrivals)
        self._checked = clock.monotonic()

    def _look_for_another(self) -> None:
        old = self._block
        assert self._packets is not None
        try:
            found = Block(self.block)
        except FileNotFoundError:
            # The unlinked block is kept open: its writer may be alive, and a new block cannot get
            # the same identity meanwhile.
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
            if any(found.identity):  # else it may be the old one
                self._check()
                self.intake.restart()
                self._packets.forget()
                if self.debug_level >= 2:
                    log.info("source '%s': %s was made again", self.name, self.about)
        self._block = found


def _why(error: OSError) -> str:
    if isinstance(error, PermissionError):
        return "no permission to read it; ask its writer for mode 0644"
    return error.strerror or str(error)


class _PacketFinder:
    """Finds new, untorn packets in a block; a plain class because attribute access counts here."""

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
        self._standing = b""  # a new one that may be incomplete
        self._unfinished = b""  # an incomplete one, according to its lock
        self._since = 0.0  # when either was first seen

    def find(self, block: Block) -> bytes | None:
        """Returns the current packet if it is new and complete, or contents that are too short."""
        # Before reading: a delay in between must not count as time without changes.
        started = clock.monotonic()
        seen = block.read(self._size, self._offset)
        if seen == self._done and seen:
            return None
        if len(seen) < self._size:
            expected = self._offset + self._size
            self.trouble = f"{self._about} has {block.size} bytes; expected {expected}"
            return seen
        if not self._done and seen.count(0) == len(seen):
            self.trouble = f"{self._about} is there ({block.size} bytes), nothing is written yet"
            return None
        if self._lock is not None:
            packet = self._find_locked(block, self._lock, seen)
        elif self._sequence is None or not self._done or _differ(seen, self._done, self._sequence):
            packet = self._find_standing(block, seen, started)
        else:
            packet = None  # the writer is in the middle of the next one
        if packet is not None:
            self._done, self._unfinished, self._standing = packet, b"", b""
            self.trouble = ""
        return packet

    def _find_locked(self, block: Block, field: Item, seen: bytes) -> bytes | None:
        if seen == self._unfinished:  # the same write as before
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
                return None  # it has just shrunk
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
            self.trouble = f"the writer of {about} does not count '{name}' up for a packet"
        else:
            return True
        return False

    def _find_standing(self, block: Block, seen: bytes, started: float) -> bytes | None:
        """Reads until nothing has changed for `settle`; `seen` was read at `started`."""
        stands = seen == self._standing
        if stands and started - self._since >= self._settle:
            return seen
        if self._settle > _MAX_SPIN:
            if not stands:
                self.torn += bool(self._standing)
                self._standing, self._since = seen, clock.monotonic()
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
        self.trouble = f"{self._about} changes all the time; its writer needs a lock"
        self._standing, self._since = seen, since
        return None


def is_even(number: bytes, field: Item) -> bool:
    """Whether a lock's value means a complete packet; NaN and fractions do not."""
    dtype = field.dtype
    if dtype.kind == "f":
        return bool(np.frombuffer(number, dtype)[0] % 2 == 0)
    return not number[-1 if dtype.byteorder == ">" else 0] & 1


def _differ(packet: bytes, other: bytes, field: Item | None) -> bool:
    return field is None or packet[field.offset : field.end] != other[field.offset : field.end]
