"""Blocks of POSIX shared memory, which are read and written without mapping on Linux."""

from __future__ import annotations

import ctypes
import mmap
import os
import stat
import sys
from collections.abc import Callable

try:
    # The module behind `multiprocessing.shared_memory`, on all POSIX systems in CPython and PyPy.
    # That class is unsuitable: before Python 3.13, its resource tracker unlinks the blocks of other
    # processes at exit (bpo-38119). The package posix_ipc needs a compiler if it has no wheel.
    import _posixshmem
except ImportError:  # Windows
    _posixshmem = None

MAX_NAME_BYTES = 30 if sys.platform == "darwin" else 254  # without the slash

_Call = Callable[[int, object, int, int], int]


def block_path(name: str) -> str:
    """Returns the name of a block for `shm_open`: `/robot` for `robot`; raises ValueError."""
    bare = name.removeprefix("/")
    expected = "expected a name such as robot or /robot"
    if bare in ("", ".", ".."):
        raise ValueError(f"found {name!r}; {expected}")
    if "/" in bare or not bare.isprintable():
        wrong = next(c for c in bare if c == "/" or not c.isprintable())
        raise ValueError(f"found {wrong!r} in {name!r}; {expected}")
    if (length := len(bare.encode())) > MAX_NAME_BYTES:
        raise ValueError(f"found {length} bytes; expected at most {MAX_NAME_BYTES}")
    return f"/{bare}"


def _system_call(name: str) -> _Call | None:
    """Returns a version of `pread` or `pwrite` that does not release the interpreter lock.

    `os.pread` lets other threads run between two reads that must follow each other, and a busy
    thread releases the interpreter lock only after 5 ms.
    """
    if sys.platform != "linux":
        return None  # elsewhere shared memory is not a file
    call = getattr(ctypes.PyDLL(None, use_errno=True), name)
    call.restype = ctypes.c_ssize_t
    call.argtypes = (ctypes.c_int, ctypes.c_char_p, ctypes.c_size_t, ctypes.c_long)
    return call  # type: ignore[no-any-return]


_PREAD, _PWRITE = _system_call("pread"), _system_call("pwrite")


class Block:
    """An open block of POSIX shared memory; raises OSError or ValueError.

    On Linux, it is read and written by system calls, because a process with a mapping receives
    SIGBUS if another process shrinks the block. System calls are also ordered on processors that
    reorder memory accesses. On other systems, the block is mapped, and its size is checked before
    each access.

    Args:
        create: whether to create the block, which must not exist.

    Attributes:
        identity: value that differs between blocks of the same name; zeros if unavailable.
    """

    def __init__(self, name: str, *, writable: bool = False, create: bool = False) -> None:
        self.path = block_path(name)
        if _posixshmem is None:
            raise OSError("this system has no POSIX shared memory")
        flags = os.O_RDWR if writable else os.O_RDONLY
        flags |= os.O_CREAT | os.O_EXCL if create else 0
        flags |= os.O_NONBLOCK  # does not wait if the name is that of a pipe
        self._fd = _posixshmem.shm_open(self.path, flags, mode=0o600)
        self._map: mmap.mmap | None = None
        self._writable = writable
        self._buffer = ctypes.create_string_buffer(0)
        status = os.fstat(self._fd)
        if sys.platform == "linux" and not stat.S_ISREG(status.st_mode):
            os.close(self._fd)
            raise OSError("it is a special file, not shared memory")
        self.identity = (status.st_dev, status.st_ino) if status.st_ino else (0, 0)

    @property
    def size(self) -> int:
        return os.fstat(self._fd).st_size

    def resize(self, size: int) -> None:
        os.ftruncate(self._fd, size)

    def read(self, count: int, start: int = 0) -> bytes:
        """Reads `count` bytes from offset `start`, or fewer if the block ends earlier."""
        if _PREAD is None:
            mapped = self._mapped()
            return b"" if mapped is None else mapped[start : start + count]
        if len(self._buffer) < count:
            self._buffer = ctypes.create_string_buffer(count)
        found = _PREAD(self._fd, self._buffer, count, start)
        if found < 0:
            raise _last_error()
        return ctypes.string_at(self._buffer, found)

    def write(self, data: bytes, start: int = 0) -> None:
        """Writes bytes at offset `start`. They must fit into the block."""
        if _PWRITE is None:
            mapped = self._mapped()
            if mapped is None or len(mapped) < start + len(data):
                raise OSError("the block has shrunk")
            mapped[start : start + len(data)] = data
        elif _PWRITE(self._fd, data, len(data), start) != len(data):
            raise _last_error()

    def _mapped(self) -> mmap.mmap | None:
        size = self.size
        if self._map is not None and len(self._map) != size:
            self._map.close()
            self._map = None
        if self._map is None and size:
            access = mmap.ACCESS_WRITE if self._writable else mmap.ACCESS_READ
            self._map = mmap.mmap(self._fd, size, access=access)
        return self._map

    def close(self) -> None:
        """Closes the block without removing it."""
        if self._map is not None:
            self._map.close()
            self._map = None
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def unlink(self) -> None:
        """Removes the name if it refers to this block. The last process frees the memory."""
        try:
            other = Block(self.path)
        except OSError:
            return
        other.close()
        if other.identity == self.identity:
            _posixshmem.shm_unlink(self.path)


def _last_error() -> OSError:
    number = ctypes.get_errno()
    return OSError(number, os.strerror(number))
