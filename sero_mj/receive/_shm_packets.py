"""`ShmPackets`: finds packets in a block of shared memory that are new and not torn."""

from __future__ import annotations

import time

import numpy as np

from .language import Item
from .shm_block import Block
from .structure import Structure

_TRIES = 50  # to read a packet between two writes; some 200 us
_LONGEST_SPIN = 2e-4  # s; a packet that has to stand still for longer is looked at again later
_WRITING_FOR = 0.1  # s; a packet takes no longer to be written by a writer that lives


class ShmPackets:
    """Reads the packets of one structure from a block that another process writes.

    A plain class: its attributes are looked up many times for a packet, thousands of times a
    second.

    Args:
        layout: of the packets.
        about: kind and name of the block, for people.
        lock: event that is odd while the writer writes; empty for none.
        sequence: event that numbers the packets; empty for none.
        offset: where in the block the packet begins, bytes.
        settle: without a lock, how long a packet has to stand unchanged, s.

    Attributes:
        torn: how many reads were given up because the writer was in between.
        trouble: what keeps packets from coming, for people; empty when nothing is known to.
    """

    def __init__(
        self,
        layout: Structure,
        about: str,
        *,
        lock: str = "",
        sequence: str = "",
        offset: int = 0,
        settle: float = 0.0,
    ) -> None:
        self.torn, self.trouble = 0, ""
        self._about, self._lock_name = about, lock
        self._size, self._offset, self._settle = layout.size, offset, settle
        self._lock = layout.field(lock) if lock else None
        self._sequence = layout.field(sequence) if sequence else None
        self._block: Block | None = None
        self.forget()

    def forget(self) -> None:
        """Treats the next packet that is read as new."""
        self._done = b""  # the packet that was returned last
        self._standing = b""  # a new one that may not be whole
        self._unfinished = b""  # one that is not, as its lock says
        self._since = 0.0  # when either was first seen

    def find(self, block: Block) -> bytes | None:
        """Returns the packet that is there, if it is new and whole.

        What is too short to be one is returned likewise, every time.

        Raises:
            OSError: the block cannot be read.
        """
        # Before it is read: whoever is held up in between must not count that as standing still.
        started = time.monotonic()
        seen = block.read(self._size, self._offset)
        if seen == self._done and seen:
            return None
        if len(seen) < self._size:
            self.trouble = f"{self._about} has {block.size} bytes; expected {self._expected}"
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

    @property
    def _expected(self) -> int:
        return self._offset + self._size

    def _find_locked(self, block: Block, field: Item, seen: bytes) -> bytes | None:
        """Reads between two writes, by the writer's lock."""
        if seen == self._unfinished:  # the same write as before
            if time.monotonic() - self._since > _WRITING_FOR:
                self.trouble = (
                    f"the writer of {self._about} stopped in the middle of a packet: "
                    f"'{self._lock_name}' is odd"
                )
            return None
        begin, count = field.offset, field.end - field.offset
        packet = seen
        for _ in range(_TRIES):
            before = block.read(count, self._offset + begin)
            packet = block.read(self._size, self._offset)
            after = block.read(count, self._offset + begin)
            if len(packet) < self._size:
                return None  # it has just become smaller
            if before == after == packet[begin : field.end] and is_even(before, field):
                return packet if self._is_counted(packet, before) else None
        self.torn += 1
        if not is_even(packet[begin : field.end], field):
            self._unfinished, self._since = packet, time.monotonic()
        return None

    def _is_counted(self, packet: bytes, lock: bytes) -> bool:
        """Whether the lock says that this whole packet is a new one."""
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
        """Reads again until nothing has changed for a while.

        Args:
            block: to be read again.
            seen: what stood there.
            started: when it was about to be read, s.
        """
        stands = seen == self._standing
        if stands and started - self._since >= self._settle:
            return seen
        if self._settle > _LONGEST_SPIN:
            if not stands:
                self.torn += bool(self._standing)
                self._standing, self._since = seen, time.monotonic()
            return None
        changes, since = 0, time.monotonic()
        while changes < _TRIES:
            started = time.monotonic()
            again = block.read(self._size, self._offset)
            if len(again) < self._size:
                return None
            if again != seen:
                seen, since, changes = again, time.monotonic(), changes + 1
            elif started - since >= self._settle:
                return seen
        self.torn += 1
        self.trouble = f"{self._about} changes all the time; its writer needs a lock"
        self._standing, self._since = seen, since
        return None


def is_even(number: bytes, field: Item) -> bool:
    """Whether a lock says that the packet is whole; NaN and fractions do not."""
    dtype = field.dtype
    if dtype.kind == "f":
        return bool(np.frombuffer(number, dtype)[0] % 2 == 0)
    return not number[-1 if dtype.byteorder == ">" else 0] & 1


def _differ(packet: bytes, other: bytes, field: Item | None) -> bool:
    return field is None or packet[field.offset : field.end] != other[field.offset : field.end]
