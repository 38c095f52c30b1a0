"""`ShmWriter`: writes packets to POSIX shared memory as a robot's controller would."""

from __future__ import annotations

from typing import Self

import numpy as np

from ..errors import SourceError
from ..receive.shm_block import Block, block_path
from ..receive.structure import Structure


class ShmWriter:
    """Writes packets of one structure to a block of POSIX shared memory, each over the one before.

    The block is made where there is none, and made larger where it is too small; one that this
    writer has made goes with it.

    Args:
        block: name of the shared memory, `robot` or `/robot`.
        structure: of the packets.
        lock: event that is made odd before a packet is written and even when it is there (a
            seqlock); what the packets have there is not used. Empty for none: readers then have to
            guess whether a packet is whole.
        offset: where in the block the packet begins, bytes.

    Attributes:
        place: kind and name in a few words, for people.

    Raises:
        SourceError: no block can have this name, or it may not be made or written.
        UnknownName: the structure has no event `lock`.
        ValueError: `lock` is several numbers.
    """

    def __init__(self, block: str, structure: Structure, lock: str = "", offset: int = 0) -> None:
        self.place = f"shared memory {block}"
        self._size, self._offset = structure.size, offset
        self._lock = structure.field(lock) if lock else None
        if self._lock is not None and self._lock.numbers != 1:
            raise ValueError(f"lock '{lock}' has {self._lock.numbers} numbers; expected one")
        try:
            self.place = f"shared memory {block_path(block)}"
            self._block, self._is_own = _open(block)
            if self._block.size < offset + self._size:
                self._block.resize(offset + self._size)
            self._number = self._found_lock()
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise SourceError("writer", f"{self.place}: {reason}") from error

    def _found_lock(self) -> int:
        """The lock's number that another writer has left, maybe in the middle of a packet."""
        if self._lock is None:
            return 0
        field = self._lock
        found = self._block.read(field.end - field.offset, self._offset + field.offset)
        number = np.frombuffer(found, field.dtype)[0]
        return int(number) if np.isfinite(number) and 0 <= number < _modulus(field.dtype) else 0

    def put(self, packet: bytes) -> None:
        """Writes a packet over the one before.

        Raises:
            OSError: the system refuses, because there is no memory left, say.
            ValueError: the packet is not as long as the structure says.
        """
        if len(packet) != self._size:
            raise ValueError(f"found {len(packet)} bytes; expected {self._size}")
        block, offset, field = self._block, self._offset, self._lock
        if field is None:
            block.write(packet, offset)
            return
        modulus = _modulus(field.dtype)
        odd = self._number | 1
        self._number = (odd + 1) % modulus or 2  # 0 means that nothing has been written
        before, after = (np.array(n, field.dtype).tobytes() for n in (odd, self._number))
        # Three calls: each has had its effect when the next begins, for readers on every processor.
        block.write(before, offset + field.offset)
        block.write(packet[: field.offset] + before + packet[field.end :], offset)
        block.write(after, offset + field.offset)

    def close(self) -> None:
        """Closes the block, and removes it where this writer has made it."""
        if self._is_own:
            self._block.unlink()
        self._block.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def _open(name: str) -> tuple[Block, bool]:
    """The block, and whether it was made just now."""
    while True:  # another writer may make or remove it meanwhile
        try:
            return Block(name, writable=True), False
        except FileNotFoundError:
            try:
                return Block(name, writable=True, create=True), True
            except FileExistsError:
                continue


def _modulus(dtype: np.dtype[np.generic]) -> int:
    """Up to where a lock of this type can count exactly."""
    if dtype.kind == "f":
        return 2**53 if dtype.itemsize == 8 else 2**24
    return int(2 ** (8 * dtype.itemsize - (dtype.kind == "i")))
