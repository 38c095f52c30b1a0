"""`without_timers`: disables MuJoCo's timers, which take a seventh of the time of every step."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from itertools import chain
from pathlib import Path
from threading import Lock

import mujoco

_lock, _depth = Lock(), 0
_clock: int | None = None  # address of the clock function when the timers are enabled


@contextmanager
def without_timers() -> Iterator[None]:
    """Disables MuJoCo's timers (`MjData.timer`) in this process while the context is active.

    Each timer reads the clock twice for every part of a step. MuJoCo does not use a clock by
    default, but its Python package installs one, and `mujoco.set_mjcb_time(None)` installs it
    again. If MuJoCo's library is not found, the timers stay enabled.
    """
    global _clock, _depth  # noqa: PLW0603
    installed = _installed_clock()
    if installed is None:
        yield
        return
    with _lock:
        if not _depth:
            _clock, installed.value = installed.value, None
        _depth += 1
    try:
        yield
    finally:
        with _lock:
            _depth -= 1
            if not _depth:
                installed.value = _clock


@cache
def _installed_clock() -> ctypes.c_void_p | None:
    names = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")
    folders = [Path(folder) for folder in mujoco.__path__]
    for file in chain.from_iterable(each.glob(name) for each in folders for name in names):
        try:
            return ctypes.c_void_p.in_dll(ctypes.CDLL(str(file)), "mjcb_time")
        except (OSError, ValueError):
            continue
    return None
