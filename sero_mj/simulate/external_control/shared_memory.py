"""`kind = "shm"`: a program reads the robot's state from shared memory, and writes its command.

Two named pipes synchronize the two sides with one byte per step, so neither has to poll the memory.
They also reveal when the program ends.
"""

from __future__ import annotations

import contextlib
import mmap
import os
import select
import shutil
import tempfile
import time as clock
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import model_validator

from ...base.errors import Problem
from ..control.robot_model import RobotModel
from .program import Program
from .program_controller import Answering, Link, PacketProgram, ProgramController

# Placeholders in a command: the memory file, the pipe to read from, and the pipe to write to.
MEMORY, TURN, DONE = "{memory}", "{turn}", "{done}"
ALIGNMENT = 64  # alignment of the answer, which follows the state, bytes
_SLICE = 20  # time between checks for interrupts and for the end of the program, ms


class SharedMemoryProgram(PacketProgram):
    """A user's program that exchanges data over shared memory.

    The state is at the beginning of the file `{memory}`, and the answer follows at the next
    multiple of 64 bytes. The program reads a byte from the pipe `{turn}`, reads the state, writes
    the answer, and writes a byte to the pipe `{done}`. If the answer is late, the state remains
    unchanged until it arrives. Afterwards the program receives the current state.

    Attributes:
        command: command that starts the program, with {memory}, {turn} and {done} as placeholders.
    """

    title: ClassVar[str] = "program over shared memory"
    order: ClassVar[int] = 72

    kind: Literal["shm"] = "shm"

    @model_validator(mode="after")
    def _is_reachable(self) -> Self:
        missing = [each for each in (MEMORY, TURN, DONE) if each not in " ".join(self.command)]
        if missing:
            expected = f"a program with {', '.join(missing)} among its arguments"
            raise Problem("command", found=self.command, expected=expected).error()
        for key, value in (("port", 0), ("clock", "lockstep"), ("host", "127.0.0.1")):
            if getattr(self, key) != value:
                raise Problem(key, "is only for programs over UDP; remove it").error()
        if not hasattr(os, "mkfifo"):
            raise Problem("kind", "requires named pipes, which this system does not have").error()
        return self

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        state, answer = self._packets(model)
        link = MemoryLink(self, model.name, state.structure.size, answer.structure.size)
        return ProgramController(self, state, answer, model, timestep, link)


class MemoryLink(Link):
    """A connection over shared memory to a program that the run starts."""

    def __init__(self, declared: Answering, robot: str, size: int, answer_size: int) -> None:
        super().__init__(declared, robot, answer_size)
        self._size, self._answer_size = size, answer_size
        self._at = -(-size // ALIGNMENT) * ALIGNMENT
        self._memory: mmap.mmap | None = None
        self._end: weakref.finalize[Any, Any] | None = None
        self._is_pending = False  # whether an answer of the program is pending

    @property
    def is_open(self) -> bool:
        return self._memory is not None

    def open(self, time: float) -> None:
        shared = Path("/dev/shm")
        parent = shared if shared.is_dir() else Path(tempfile.gettempdir())
        folder = Path(tempfile.mkdtemp(prefix="sero-mj-", dir=parent))
        names = {MEMORY: folder / "memory", TURN: folder / "turn", DONE: folder / "done"}
        with names[MEMORY].open("wb+") as file:
            file.truncate(self._at + self._answer_size)
            self._memory = mmap.mmap(file.fileno(), self._at + self._answer_size)
        pipes = []
        for name in (TURN, DONE):
            os.mkfifo(names[name], 0o600)
            # A pipe that is opened in both directions does not wait for the other side.
            pipes.append(os.open(names[name], os.O_RDWR | os.O_NONBLOCK))
        self._turn, self._done = pipes
        self._poll = select.poll()
        self._poll.register(self._done, select.POLLIN)
        self._end = weakref.finalize(self, _end, self._memory, pipes, folder)
        command = []
        for part in self._declared.command:
            text = part
            for key, path in names.items():
                text = text.replace(key, str(path))
            command.append(text)
        self._program = Program(command, self._declared.folder, leftovers=[folder])
        self._is_pending = False
        self._given_up = clock.monotonic() + self._declared.first_patience

    def close(self) -> None:
        super().close()
        self._memory = None
        if self._end is not None:
            self._end()

    def ask(
        self,
        packet: bytes | bytearray,
        step: int,
        time: float,
        take: Callable[[int], bool],
        patience: float | None = None,
    ) -> bool:
        assert self._memory is not None
        self._share_core()
        is_late = self._is_pending  # the program is still computing an earlier step
        if not is_late:
            self._give_turn(packet)
        deadline = clock.monotonic() + self._patience(patience)
        while True:
            if not self._poll.poll(_SLICE):
                self.check(time)
                if clock.monotonic() > deadline:
                    return False
                continue
            os.read(self._done, 1)
            self._is_pending = False
            if not is_late:
                break
            is_late = False  # this was the answer to the earlier step
            self._give_turn(packet)
        self.buffer[: self._answer_size] = self._memory[self._at :]
        if not take(self._answer_size):
            return False
        self.answered = step
        return True

    def _give_turn(self, packet: bytes | bytearray) -> None:
        assert self._memory is not None
        self._memory[: self._size] = packet
        os.write(self._turn, b"1")
        self._is_pending = True

    def drain(self) -> int:
        return 0  # answers only follow states


def _end(memory: mmap.mmap, pipes: list[int], folder: Path) -> None:
    for pipe in pipes:
        os.close(pipe)
    with contextlib.suppress(BufferError):
        memory.close()
    shutil.rmtree(folder, ignore_errors=True)
