"""`kind = "shm"`: a program gets the robot's state in shared memory, and writes what to do there.

Two named pipes carry whose turn it is, a byte for each step. They also tell that the program has
ended, and neither side has to look again and again.
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

# In a command: the file in memory, the pipe to be read from, and the one to be written to.
MEMORY, TURN, DONE = "{memory}", "{turn}", "{done}"
ALIGNMENT = 64  # bytes: the answer begins at the next multiple behind the state
_SLICE = 20  # ms, in which an interrupt and the end of the program are seen


class SharedMemoryProgram(PacketProgram):
    """A program of the user's, over shared memory.

    The state is at the beginning of the file `{memory}`, the answer behind it, at the next multiple
    of 64 bytes. The program reads a byte from the pipe `{turn}`, reads the state, writes the
    answer, and writes a byte to the pipe `{done}`. If its answer is late, the state stays as it is
    until then, and the program gets the current one afterwards.

    Attributes:
        command: starts the program, with {memory}, {turn} and {done} in it.
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
                raise Problem(key, "is for programs over UDP; leave it out").error()
        if not hasattr(os, "mkfifo"):
            raise Problem("kind", "needs named pipes, which this system lacks").error()
        return self

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        """The controller; the program is started with its first step."""
        state, answer = self._packets(model)
        link = MemoryLink(self, model.name, state.structure.size, answer.structure.size)
        return ProgramController(self, state, answer, model, timestep, link)


class MemoryLink(Link):
    """Shared memory with a program, which is started."""

    def __init__(self, declared: Answering, robot: str, size: int, most: int) -> None:
        super().__init__(declared, robot, most)
        self._size, self._most = size, most
        self._at = -(-size // ALIGNMENT) * ALIGNMENT
        self._memory: mmap.mmap | None = None
        self._end: weakref.finalize[Any, Any] | None = None
        self._is_owed = False  # whether the program has its turn, and has not answered

    @property
    def is_open(self) -> bool:
        """Whether it is."""
        return self._memory is not None

    def open(self, time: float) -> None:
        """Makes memory and pipes, and starts the program; raises DeclarationError."""
        shared = Path("/dev/shm")
        parent = shared if shared.is_dir() else Path(tempfile.gettempdir())
        folder = Path(tempfile.mkdtemp(prefix="sero-mj-", dir=parent))
        names = {MEMORY: folder / "memory", TURN: folder / "turn", DONE: folder / "done"}
        with names[MEMORY].open("wb+") as file:
            file.truncate(self._at + self._most)
            self._memory = mmap.mmap(file.fileno(), self._at + self._most)
        pipes = []
        for name in (TURN, DONE):
            os.mkfifo(names[name], 0o600)
            # Opened for both directions, a pipe waits for nobody.
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
        self._is_owed = False
        self._given_up = clock.monotonic() + self._declared.first_patience

    def close(self) -> None:
        """Ends the program, and removes memory and pipes; harmless when that is done."""
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
        """Writes a state, and waits for the answer; see `Link.ask`."""
        assert self._memory is not None
        self._share_core()
        is_late = self._is_owed  # the program still has the turn of an earlier step
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
            self._is_owed = False
            if not is_late:
                break
            is_late = False  # that was the answer to the earlier step: now it gets this one
            self._give_turn(packet)
        self.buffer[: self._most] = self._memory[self._at :]
        if not take(self._most):
            return False
        self.answered = step
        return True

    def _give_turn(self, packet: bytes | bytearray) -> None:
        assert self._memory is not None
        self._memory[: self._size] = packet
        os.write(self._turn, b"1")
        self._is_owed = True

    def drain(self) -> int:
        """Nothing can come before its turn."""
        return 0


def _end(memory: mmap.mmap, pipes: list[int], folder: Path) -> None:
    for pipe in pipes:
        os.close(pipe)
    with contextlib.suppress(BufferError):
        memory.close()
    shutil.rmtree(folder, ignore_errors=True)
