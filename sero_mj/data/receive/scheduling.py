"""Lets a thread answer within a millisecond beside compute-bound threads.

It must not wait for time slices of the system or the interpreter. No privilege is needed.

Linux shares a core among busy threads in slices of about 3 ms. A thread that requests shorter ones
(`sched_setattr(2)`, since Linux 6.12) is scheduled before those with longer ones, without a larger
share of the core. This is needed to answer within a millisecond beside threads that render.
"""

from __future__ import annotations

import ctypes
import os
import platform
import sys
import threading

_SWITCH_INTERVAL = 5e-4  # s
_SLICE = 100_000  # ns; the minimum
# Numbers of `sched_setattr` and `sched_getattr`, missing in Python and in older C libraries.
_CALLS = {"x86_64": (314, 315), "aarch64": (274, 275), "riscv64": (274, 275)}


class _Attributes(ctypes.Structure):
    _fields_ = [
        ("size", ctypes.c_uint32),
        ("policy", ctypes.c_uint32),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        ("runtime", ctypes.c_uint64),
        ("deadline", ctypes.c_uint64),
        ("period", ctypes.c_uint64),
    ]


def request_short_slices() -> bool:
    """Requests short slices for the calling thread; returns whether the system grants them.

    Older Linux and other systems do not support them; real-time threads are left unchanged.
    """
    attributes = _read()
    if attributes is None or attributes.policy != os.SCHED_OTHER:
        return False
    attributes.runtime = _SLICE  # all else unchanged
    set_call, _ = _CALLS[platform.machine()]
    if ctypes.CDLL(None).syscall(set_call, 0, ctypes.byref(attributes), 0) != 0:
        return False
    changed = _read()
    return changed is not None and changed.runtime == _SLICE


def _read() -> _Attributes | None:
    if sys.platform != "linux" or platform.machine() not in _CALLS:
        return None
    attributes = _Attributes()
    size = ctypes.sizeof(attributes)
    _, get_call = _CALLS[platform.machine()]
    failed = ctypes.CDLL(None).syscall(get_call, 0, ctypes.byref(attributes), size, 0)
    return None if failed else attributes


class _ShortTurns:
    """Shortens the interpreter's switch interval while a receiver answers.

    An answering thread waits until the interpreter switches to it: up to 5 ms by default, too long
    for a controller's cycle of 1 ms.
    """

    def __init__(self) -> None:
        self._answering: set[int] = set()
        self._usual = 0.0
        self._lock = threading.Lock()

    def begin(self, receiver: object) -> None:
        with self._lock:
            if not self._answering:
                self._usual = sys.getswitchinterval()
                sys.setswitchinterval(min(self._usual, _SWITCH_INTERVAL))
            self._answering.add(id(receiver))

    def end(self, receiver: object) -> None:
        with self._lock:
            was_answering = id(receiver) in self._answering
            self._answering.discard(id(receiver))
            if was_answering and not self._answering:
                sys.setswitchinterval(self._usual)


short_turns = _ShortTurns()
