"""Memory that the user's program shares with the viewer's process.

The program sends inputs and the state of an overlay's model. The viewer sends the displayed state.
Neither process ever waits for the other.
"""

from __future__ import annotations

import mmap
import os
import struct
import tempfile
import threading
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

import mujoco
import numpy as np

from ...base.frames import Array
from ...data.drive.place import follow
from ...robots.assemble.world_view import WorldView
from ...robots.declared.inputs import to_array
from ...robots.external.model_world import ModelWorld

_STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)  # MuJoCo calls with an int are 10 times faster.
_MEMORY = Path("/dev/shm")  # file system in memory, on Linux only
_HEADER = 2  # number of entries before each array: the number of writes, and a checksum
_CHECKSUM_MODULUS = 2**32  # number of different checksums
_pack = struct.Struct("dd").pack


class SharedArrays:
    """Arrays of float64 in memory that two processes share. Only one process writes each array.

    Each array has a write count, and a checksum of the count and the values. While an array is
    being written, its checksum does not match, and the reader tries again at the next read. No
    lock is needed, so a process that ends cannot block the other one.

    Args:
        lengths: lengths of the K arrays.
        path: path of the memory that the other process has created; None to create the memory.
            The process that opens the memory removes the file.

    Attributes:
        written: write count of each array in this process, length K.
        numbers: write count of each array at the last read, shape (K,).
    """

    def __init__(self, lengths: Sequence[int], path: Path | None = None) -> None:
        stops = np.cumsum([_HEADER + length for length in lengths])
        self._stops: list[int] = stops.tolist()
        self._starts: list[int] = [0, *self._stops[:-1]]
        self._spans = [
            slice(8 * start, 8 * stop)
            for start, stop in zip(self._starts, self._stops, strict=True)
        ]
        self.written = [0] * len(lengths)
        self.numbers = np.zeros(len(lengths))
        self._lock = threading.Lock()  # Several threads of one process may write.
        if path is None:
            folder = _MEMORY if os.access(_MEMORY, os.W_OK) else None
            file, name = tempfile.mkstemp(prefix="sero-mj-", dir=folder)
            os.truncate(file, 8 * self._stops[-1])
            self.path = Path(name)
            memory = mmap.mmap(file, 0)
            os.close(file)
        else:
            self.path = path
            with path.open("r+b") as opened:
                memory = mmap.mmap(opened.fileno(), 0)
            self.remove_name()
        self._memory, self._cells = memory, np.frombuffer(memory)
        self._heads = np.array(self._starts)

    def remove_name(self) -> None:
        with suppress(OSError):  # Windows raises OSError while the file is in use.
            self.path.unlink()

    def write(self, index: int, values: Array) -> None:
        """Writes values to an array. They may have any shape with the right number of elements."""
        contents = values.tobytes()
        with self._lock:
            self.written[index] = number = self.written[index] + 1
            header = _pack(number, zlib.crc32(contents, number % _CHECKSUM_MODULUS))
            self._memory[self._spans[index]] = header + contents

    def number(self, index: int) -> int:
        """Returns the write count of an array."""
        return int(self._cells[self._starts[index]])

    def changed(self) -> list[int]:
        return np.flatnonzero(self._cells[self._heads] != self.numbers).tolist()

    def read(self, index: int) -> Array | None:
        """Returns a copy of an array, or None if it is unchanged or is being written."""
        start, stop = self._starts[index], self._stops[index]
        if self._cells[start] == self.numbers[index]:
            return None
        cells = self._cells[start:stop].copy()
        values = cells[_HEADER:]
        if zlib.crc32(values.data, int(cells[0]) % _CHECKSUM_MODULUS) != cells[1]:
            return None
        self.numbers[index] = cells[0]
        return values


class ViewerMemory(Protocol):
    """Shared memory for a scene or an overlay.

    The user's program calls `set` and `sync`. The viewer's process calls `apply` and `show`.

    Attributes:
        data: state of the scene or of the user's model.
        is_read: whether `sync` copies the displayed state to `data`.
    """

    data: mujoco.MjData
    is_read: bool
    arrays: SharedArrays

    @property
    def frame_count(self) -> int: ...

    def set(self, target: str, values: Any) -> None:
        """Sets an input of the world and sends its values. Raises the errors of `set_input`."""

    def sync(self) -> None:
        """Sends the state of an overlay's model, or receives the displayed state of a scene."""

    def apply(self) -> None:
        """Applies the values that the user's program has sent."""

    def show(self) -> None:
        """Sends the displayed state."""


class SceneMemory:
    """Shared memory for the inputs and the displayed state of a scene.

    Each input has its own array, because the program sends only the inputs that it sets. The
    scene's sources set all other inputs. `sync` does not overwrite inputs that the program has set
    after the displayed state was sent.

    Args:
        world: compiled scene, which must be equal in both processes.
    """

    def __init__(self, world: WorldView, data: mujoco.MjData, path: Path | None = None) -> None:
        self._world, self.data, self.is_read = world, data, False
        self._inputs = list(world.inputs.values())
        self._index = {item.target: index for index, item in enumerate(self._inputs)}
        self._fields = (data.qpos, data.mocap_pos, data.mocap_quat, data.userdata)
        # The displayed state has the time, these fields, and the write counts of applied inputs.
        ends = np.cumsum([1, *(field.size for field in self._fields)]).tolist()
        self._slices = list(map(slice, ends, ends[1:]))
        self._flat = [field.reshape(-1) for field in self._fields]  # views
        self._numbers = slice(ends[-1], ends[-1] + len(self._inputs))
        lengths = [*(item.count for item in self._inputs), self._numbers.stop]
        self.arrays = SharedArrays(lengths, path)
        self._setter = self._inputs_of_numbers()

    def _inputs_of_numbers(self) -> Any:
        world, setter = self._world, [np.full(field.shape, -1) for field in self._fields]
        qpos, mocap_pos, mocap_quat, userdata = setter
        for index, item in enumerate(self._inputs):
            if item.kind == "pose":
                row = world.placed.get(item.name, slice(0))
                mocap_pos[row] = mocap_quat[row] = index
            elif item.kind == "angles" and item.name in world.robots:
                qpos[world.robots[item.name].qpos] = index
            else:
                userdata[world.slots[item.target]] = index
            userdata[world.flags[item.target]] = index
        return np.concatenate([[-1], *(each.ravel() for each in setter)])

    @property
    def frame_count(self) -> int:
        return self.arrays.number(-1)

    def set(self, target: str, values: Any) -> None:
        shares = self._world.shares(target, values)
        for each, share in shares.items():
            self._world.set_input(self.data, each, share)
        for each, share in shares.items():
            self.arrays.write(self._index[each], to_array(self._world.inputs[each], share))

    def sync(self) -> None:
        shown = self.arrays.read(len(self._inputs)) if self.is_read else None
        if shown is None:
            return
        # The last entry is for values that no input sets.
        is_shown = np.append(shown[self._numbers] == self.arrays.written[:-1], True)
        where = is_shown[self._setter]
        self.data.time = shown[0]
        for flat, part in zip(self._flat, self._slices, strict=True):
            np.copyto(flat, shown[part], where=where[part])
        follow(self._world.model, self.data)

    def apply(self) -> None:
        for index in self.arrays.changed():
            if index < len(self._inputs) and (values := self.arrays.read(index)) is not None:
                item = self._inputs[index]
                self._world.set_input(self.data, item.target, values.reshape(item.shape))

    def show(self) -> None:
        numbers = self.arrays.numbers[: len(self._inputs)]
        shown = np.concatenate([[self.data.time], *self._flat, numbers])
        self.arrays.write(len(self._inputs), shown)


class OverlayMemory:
    """Shared memory for the state of a user's model and the inputs of its overlay."""

    def __init__(self, world: ModelWorld, path: Path | None = None) -> None:
        self._world, self.data, self.is_read = world, world.data, False
        size, nv = mujoco.mj_stateSize(world.model, _STATE), world.model.nv
        # MuJoCo cannot compute the last fields from the state.
        self._values = np.empty(size + 2 * nv)
        self._state, *self._slices = np.split(self._values, [size, size + nv])  # views
        self._fields = (self.data.qfrc_actuator, self.data.qacc)
        self._changes = -1  # `world.changes` when the inputs were last sent
        self.arrays = SharedArrays([size + 2 * nv, len(world.input_state()), 0], path)

    @property
    def frame_count(self) -> int:
        return self.arrays.number(-1)

    def set(self, target: str, values: Any) -> None:
        self._world.set_input(self.data, target, values)
        self.sync()

    def sync(self) -> None:
        world = self._world
        mujoco.mj_getState(world.model, self.data, self._state, _STATE)
        for part, field in zip(self._slices, self._fields, strict=True):
            part[:] = field
        self.arrays.write(0, self._values)
        if self._changes != world.changes:
            self._changes = world.changes
            self.arrays.write(1, world.input_state())

    def apply(self) -> None:
        world, data = self._world, self.data
        if (inputs := self.arrays.read(1)) is not None:
            world.set_input_state(inputs)
        if (values := self.arrays.read(0)) is not None:
            self._values[:] = values
            mujoco.mj_setState(world.model, data, self._state, _STATE)
            follow(world.model, data)
            mujoco.mj_flex(world.model, data)
            mujoco.mj_tendon(world.model, data)
            for part, field in zip(self._slices, self._fields, strict=True):
                field[:] = part

    def show(self) -> None:
        self.arrays.write(2, np.empty(0))
