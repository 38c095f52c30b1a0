"""`ShmReader`: packets from POSIX shared memory, whoever writes it."""

from __future__ import annotations

import threading
import time as clock

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from ..errors import SourceError
from .receiver import Receiver, log
from .shm_block import Block, block_path
from .source import Packet, Packets
from .structure import Field as PacketField

_LOOK_EVERY = 0.02  # s; how soon a block that is made, or made anew, is noticed
_TELL_EVERY = 1.0  # s; how often a block that stays too small is counted
_TRIES = 50  # to read a packet between two writes; some 200 us
_LONGEST_SPIN = 2e-4  # s; a packet that has to stand still for longer is looked at again later
_WRITING_FOR = 0.1  # s; a packet takes no longer to be written by a writer that lives


class ShmReader(Receiver):
    """Reads packets of one structure from a block of POSIX shared memory.

    The block need not exist: it is taken up when it appears, and again when it is made anew.
    A packet is new when its bytes are; a writer that may write the same twice needs a counter or a
    time in the structure, or it is taken for silent.

    A torn packet, of which the writer has written a part only, is not applied:

    - With `lock` never. The writer makes that number odd before it writes, and even, another one
      than before, when it is done (a seqlock).
    - Without, a packet is applied when it has stood unchanged for `settle`; a writer that is
      interrupted for longer in the middle of a packet is not noticed.
    - With `sequence` alone likewise, and nothing is applied before the counter has changed: when it
      is what the writer writes last, an interrupted one is noticed as well unless it has only
      just begun.

    Packets that the writer replaces before they are read are counted as `lost` where there is
    a `sequence`, for only their numbers tell of them.

    Attributes:
        block: name of the shared memory, `robot` or `/robot`.
        lock: event of the structure that is odd while the writer writes; empty for none. 0 means
            that nothing has been written yet.
        offset: where in the block the packet begins, bytes.
        poll_rate: how often the block is looked at, Hz; what is shown is read afresh for every
            picture besides.
        settle: without a lock, how long a packet has to stand unchanged, s.
    """

    name: str = "shm"
    block: str
    lock: str = ""
    offset: int = Field(0, ge=0, le=2**40)
    poll_rate: float = Field(2000.0, ge=1.0, le=1e5)
    settle: float = Field(2e-5, ge=0, le=10.0)

    _block: Block | None = PrivateAttr(None)
    _thread: threading.Thread | None = PrivateAttr(None)
    _reading: threading.Lock = PrivateAttr(default_factory=threading.Lock)
    _wake: threading.Lock = PrivateAttr(default_factory=threading.Lock)
    _owes_call_back: bool = PrivateAttr(False)
    _lock_field: PacketField | None = PrivateAttr(None)
    _sequence_field: PacketField | None = PrivateAttr(None)
    _look_next: float = PrivateAttr(0.0)
    _tell_next: float = PrivateAttr(0.0)
    _done: bytes = PrivateAttr(b"")  # the packet that was handed on last
    _standing: bytes = PrivateAttr(b"")  # a new one that may not be whole
    _unfinished: bytes = PrivateAttr(b"")  # one that is not, as its lock says
    _since: float = PrivateAttr(0.0)  # when either was first seen
    _trouble: str = PrivateAttr("")

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
        if at := (self.offset + field.offset) % field.item.item_bytes:
            expected = f"multiple of {field.item.item_bytes}"
            message = f"lock '{self.lock}' is {at} bytes behind a {expected}; expected it at one, "
            raise ValueError(message + "or it could be torn itself (alignment = 8 may help)")
        return self

    @property
    def about(self) -> str:
        """Kind and place in a few words, for people."""
        return f"shared memory {block_path(self.block)}"

    @property
    def trouble(self) -> str:
        """What keeps packets from coming, for people; empty when nothing is known to."""
        return self._trouble

    def open(self) -> None:
        """Starts the thread that reads; the block need not exist.

        Raises:
            SourceError: this system has no POSIX shared memory, or the block may not be read.
        """
        self.close()
        self._start_afresh()
        layout = self.layout
        self._lock_field = layout.field(self.lock) if self.lock else None
        self._sequence_field = layout.field(self.sequence) if self.sequence else None
        self._tell_next, self._look_next = 0.0, clock.monotonic() + _LOOK_EVERY
        self._trouble = ""
        try:
            self._take_up(Block(self.block))
        except FileNotFoundError:
            self._trouble = f"no {self.about} yet"
        except OSError as error:
            raise SourceError(self.name, f"{self.about}: {_why(error)}") from error
        if self.debug_level >= 2:
            log.info("source '%s': reading %s", self.name, self.about)
        self._wake = threading.Lock()
        self._wake.acquire()
        self._thread = threading.Thread(target=self._receive, name=f"shm {self.name}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stops the thread and lets go of the block; harmless when it is not open."""
        if self._thread is not None:
            self._closing.set()
            self._wake.release()
            self._thread.join()
        with self._reading:
            if self._block is not None:
                self._block.close()
            self._block = self._thread = None

    def latest(self) -> Packet | None:
        """Returns the newest good packet, or None when there was none yet.

        Looks into the block itself, so that a picture shows what is there now.
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
        # Where no packet may be lost, the caller must not wait for room that it has to make itself.
        if self._thread is None or not self.only_latest_packet:
            return
        if self._reading.acquire(blocking=False):  # else the thread is just reading
            try:
                if not self._closing.is_set():
                    self._poll()
            finally:
                self._reading.release()

    def wait(self, timeout: float) -> bool:
        """Waits up to `timeout` s until a good packet has come; returns whether one has.

        When none has, why is logged, where it is known.
        """
        has_come = super().wait(timeout)
        if not has_come and self._trouble and self.debug_level >= 1:
            log.warning("source '%s': %s", self.name, self._trouble)
        return has_come

    def _call_back(self) -> None:
        # Not on the thread of one that takes packets: it may hold what the callback waits for.
        self._owes_call_back = threading.current_thread() is not self._thread
        if not self._owes_call_back:
            super()._call_back()

    def _receive(self) -> None:
        period = 1.0 / self.poll_rate
        while not self._closing.is_set():
            with self._reading:
                self._poll()
                if self._owes_call_back:
                    self._call_back()
            # Cheaper than to wait for an Event, and no less immediate.
            self._wake.acquire(timeout=period)

    def _poll(self) -> None:
        """Looks into the block once, and takes in what is new."""
        now = clock.monotonic()
        try:
            if now >= self._look_next:
                self._look_next = now + _LOOK_EVERY
                self._look_for_another()
            if self._block is None:
                return
            seen = self._read()
            if seen == self._done:
                return
            if len(seen) < self.size:
                self._tell_too_small(seen, now)
                return
            packet = self._read_whole(seen, now)
        except OSError as error:
            self._trouble = f"{self.about}: {_why(error)}"
            return
        if packet is not None:
            self._done, self._unfinished, self._standing = packet, b"", b""
            self._trouble = ""
            self._take_in(packet, len(packet))

    def _read(self, field: PacketField | None = None) -> bytes:
        assert self._block is not None
        if field is None:
            return self._block.read(self.size, self.offset)
        return self._block.read(field.end - field.offset, self.offset + field.offset)

    def _take_in(self, packet: bytes, length: int) -> None:
        rows = np.frombuffer(packet.ljust(self.size, b"\0"), np.uint8)[None]
        self._accept(rows, np.array([length]), np.array([clock.monotonic()]))

    def _look_for_another(self) -> None:
        """Takes up the block that has the name now."""
        old = self._block
        try:
            found = Block(self.block)
        except FileNotFoundError:
            # The one without a name is kept: its writer may be alive, and a new one cannot
            # have the same identity meanwhile.
            is_gone = old is not None or self._number
            self._trouble = f"{self.about} is gone" if is_gone else f"no {self.about} yet"
            return
        if old is not None and found.identity == old.identity and any(found.identity):
            found.close()
            return
        if old is not None and not any(found.identity):  # it may be the old one
            old.close()
            self._block = found
            return
        if old is not None:
            self.intake.restart()
            if self.debug_level >= 2:
                log.info("source '%s': %s was made anew", self.name, self.about)
        self._take_up(found)

    def _take_up(self, block: Block) -> None:
        if self._block is not None:
            self._block.close()
        self._block, self._trouble = block, ""
        self._done = self._standing = self._unfinished = b""

    def _tell_too_small(self, seen: bytes, now: float) -> None:
        """Counts a block without room for a packet, again while it stays so."""
        assert self._block is not None
        size = self._block.size
        if size == 0:  # made a moment ago
            self._trouble = f"{self.about} is empty"
            return
        self._trouble = f"{self.about} has {size} bytes; expected {self.offset + self.size}"
        if now >= self._tell_next:
            self._tell_next = now + _TELL_EVERY
            self._take_in(seen, len(seen))

    def _read_whole(self, seen: bytes, now: float) -> bytes | None:
        """Returns the packet when the writer is not in the middle of it and it is a new one."""
        if not self._done and seen.count(0) == len(seen):
            self._trouble = f"nothing has been written to {self.about} yet"
            return None
        if self._lock_field is not None:
            return self._read_locked(seen, now)
        field = self._sequence_field
        if field is not None and self._done and _part(seen, field) == _part(self._done, field):
            return None  # in the middle of the next one
        return self._read_standing(seen, now)

    def _read_locked(self, seen: bytes, now: float) -> bytes | None:
        """Reads between two writes, by the writer's lock."""
        field = self._lock_field
        assert field is not None
        if seen == self._unfinished:  # the same write as before
            if now - self._since > _WRITING_FOR:
                self._trouble = (
                    f"the writer of {self.about} stopped in the middle of a packet: "
                    f"'{self.lock}' is odd"
                )
            return None
        for _ in range(_TRIES):
            before = self._read(field)
            packet = self._read()
            if len(packet) < self.size:
                return None
            if before == self._read(field) == _part(packet, field) and _is_even(before, field):
                return packet if self._is_counted(packet, before) else None
        self.counters.torn += 1
        if not _is_even(_part(packet, field), field):
            self._unfinished, self._since = packet, now
        return None

    def _is_counted(self, packet: bytes, lock: bytes) -> bool:
        """Whether the lock says that this whole packet is a new one."""
        if packet == self._done:
            return False
        if not any(lock):
            self._trouble = f"nothing has been written to {self.about}: '{self.lock}' is 0"
        elif self._done and lock == _part(self._done, self._lock_field):
            self._trouble = (
                f"the writer of {self.about} does not count '{self.lock}' up for a packet"
            )
        else:
            return True
        return False

    def _read_standing(self, seen: bytes, now: float) -> bytes | None:
        """Reads again until nothing has changed for a while."""
        stands = seen == self._standing
        if stands and now - self._since >= self.settle:
            return seen
        if self.settle > _LONGEST_SPIN:
            if not stands:
                self.counters.torn += bool(self._standing)
                self._standing, self._since = seen, clock.monotonic()
            return None
        changes, since = 0, clock.monotonic()
        while changes < _TRIES:
            started = clock.monotonic()
            again = self._read()
            if len(again) < self.size:
                return None
            if again != seen:
                seen, since, changes = again, clock.monotonic(), changes + 1
            elif started - since >= self.settle:
                return seen
        self.counters.torn += 1
        self._trouble = f"{self.about} changes all the time; its writer needs a lock"
        self._standing, self._since = seen, since
        return None


def _part(packet: bytes, field: PacketField | None) -> bytes:
    assert field is not None
    return packet[field.offset : field.end]


def _is_even(number: bytes, field: PacketField) -> bool:
    """Whether a lock says that the packet is whole; NaN does not."""
    found = np.frombuffer(number, field.dtype)
    return len(found) == 1 and bool(found[0] % 2 == 0)


def _why(error: OSError) -> str:
    if isinstance(error, PermissionError):
        return "no permission to read it; ask its writer for mode 0644"
    return error.strerror or str(error)
