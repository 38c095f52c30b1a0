"""`kind = "library"`: a function of a shared library in C, or with C calling conventions."""

from __future__ import annotations

import ctypes
import faulthandler
import mmap
import os
import select
import subprocess
import sys
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from ...base.child_process import ChildProcess
from ...base.errors import DeclarationError, Problem, SimulationError
from ...base.frames import Array
from ...base.trust import RequestedAction
from ...robots.declared.robot import SerialRobot
from ..control.controller import Controller, ControllerDeclaration, Sensed, Target
from ..control.robot_model import RobotModel
from . import library_host
from .library_host import ARRAYS, RobotStruct
from .program import SharedCore

HEADER = Path(__file__).with_name("sero_mj_controller.h")
_GUARD = b"\xa5" * 64  # bytes after the torques, which a library for more joints would overwrite
_MACHINES = {3: "x86", 8: "mips", 40: "arm", 62: "x86-64", 183: "aarch64", 243: "riscv"}
_SLICE = 20  # time between checks for interrupts and for the end of the process, ms
_CLOSED = 0.5  # maximum time in which the process ends after its pipe is closed, s


class Library(ControllerDeclaration):
    """A function `void control(struct sero_mj_robot *robot)` of a shared library.

    Attributes:
        file: library file, for example controller.so, relative to the scenario's folder.
        function: name of the function.
        gravity: whether to compute gravity torques for the function.
        isolated: whether to load and call the library in its own process, so that a crash, exit or
            hang becomes an error of the run. Each step then takes a few microseconds longer.
        patience: maximum time of a call in its own process, s.
        first_patience: maximum time to start the process and load the library, s.
    """

    may_be_probed: ClassVar[bool] = False
    title: ClassVar[str] = "library"
    order: ClassVar[int] = 60

    kind: Literal["library"] = "library"
    file: Path
    function: str = "control"
    gravity: bool = True
    isolated: bool = False
    patience: float = Field(10.0, gt=0, le=3600)
    first_patience: float = Field(10.0, gt=0, le=3600)

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        return None

    def actions(self, key: str = "") -> list[RequestedAction]:
        return [RequestedAction(key, f"load the library {self.file}", (self.file,))]

    def check_files(self) -> None:
        if not self.file.is_file():
            raise Problem("file", f"no file {self.file}").error()

    def make(self, model: RobotModel, timestep: float) -> LibraryController | IsolatedLibrary:
        self.check_files()
        if self.isolated:
            return IsolatedLibrary(self, model, timestep)
        return LibraryController(self, model, timestep)


def _function_of(file: Path, name: str) -> Any:
    try:
        return library_host.load(str(file.absolute()), name)
    except OSError as error:
        raise _not_loaded(file, str(error)) from None
    except AttributeError:
        raise _no_function(file, name) from None


def _not_loaded(file: Path, reason: str) -> DeclarationError:
    found, own = _machine(file), _machine(Path(sys.executable))
    if found and own and found != own:  # the system reports this as a missing file
        expected = f"a library for {own}"
        return Problem("file", f"{file} is a library for {found}", expected=expected).error()
    return Problem("file", f"{file} cannot be loaded: {reason}").error()


def _no_function(file: Path, name: str) -> DeclarationError:
    header = (
        f'void {name}(struct sero_mj_robot *), in C++ extern "C", in Rust #[no_mangle]; '
        "see sero-mj new --snippet controller-c"
    )
    return Problem("function", f"{file} has no function {name}", expected=header).error()


def _writes_too_much(name: str, model: RobotModel, time: float) -> SimulationError:
    what = f"{name} has written torques of more than {model.n} joints"
    return SimulationError(time, model.name, what)


def _machine(file: Path) -> str:
    """Returns the processor architecture of an ELF file, or an empty string for other files."""
    with file.open("rb") as opened:
        head = opened.read(20)
    if len(head) < 20 or head[:4] != b"\x7fELF":
        return ""
    order: Literal["little", "big"] = "little" if head[5] == 1 else "big"
    number = int.from_bytes(head[18:20], order)
    return _MACHINES.get(number, f"machine {number}")


class LibraryController(Controller):
    """Calls a function of a library in every step."""

    def __init__(self, declared: Library, model: RobotModel, timestep: float) -> None:
        function = _function_of(declared.file, declared.function)
        self._model, self._has_gravity = model, declared.gravity
        self._struct = RobotStruct(n=model.n, is_first=1, timestep=timestep)
        self._bound: tuple[Any, Any] = (None, None)
        self._gravity: Array = np.zeros(model.n)
        self._memory = bytearray(8 * model.n) + bytearray(_GUARD)
        self._written: Array = np.frombuffer(self._memory, np.float64, model.n)
        self._name = f"{declared.file}: {declared.function}"
        address = ctypes.c_void_p(ctypes.addressof(self._struct))
        # If the library crashes, the interpreter prints the file names of active calls. The
        # compiled function therefore has the name of the library as its file name.
        if not faulthandler.is_enabled() and sys.__stderr__ is not None:
            with suppress(OSError, ValueError):  # stderr is closed, or not a file
                faulthandler.enable(sys.__stderr__)
        scope: dict[str, Any] = {"call": function, "robot": address}
        file = f"library {declared.file.absolute()}"
        code = compile("def control(): call(robot)", file, "exec")
        exec(code, scope)
        self._call = scope["control"]

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, shape (n,).

        Raises:
            SimulationError: the library has written torques of too many joints.
        """
        struct = self._struct
        if self._bound[0] is not sensed or self._bound[1] is not target:
            self._bind(sensed, target)
            self._bound = sensed, target
        if self._has_gravity:
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            self._gravity[:] = self._model.gravity()
        struct.time = sensed.time
        self._written[:] = out
        self._call()
        struct.is_first = 0
        if not self._memory.endswith(_GUARD):
            raise _writes_too_much(self._name, self._model, sensed.time)
        out[:] = self._written

    def _bind(self, sensed: Sensed, target: Target) -> None:
        arrays = {
            "angles": sensed.angles,
            "velocities": sensed.velocities,
            "torques": sensed.torques,
            "target_angles": target.angles,
            "target_velocities": target.velocities,
            "target_accelerations": target.accelerations,
            "gravity": self._gravity if self._has_gravity else None,
            "torques_out": self._written,
        }
        for name, array in arrays.items():
            setattr(self._struct, name, None if array is None else array.ctypes.data)

    def __getstate__(self) -> Any:
        raise TypeError("a loaded library cannot be pickled")


class IsolatedLibrary(Controller):
    """Calls a function of a library in its own process.

    State and torques are in shared memory. Pipes synchronize the processes. This process never
    loads the library.

    Raises:
        DeclarationError: the library cannot be loaded, has no such function, or ends or blocks the
            process that loads it.
    """

    def __init__(self, declared: Library, model: RobotModel, timestep: float) -> None:
        self._declared, self._model = declared, model
        self._name = f"{declared.file}: {declared.function}"
        self._start(timestep)
        answer = self._answer(declared.first_patience)
        if answer == library_host.READY:
            return
        reason = self._child.lines()[-1:] or [""]
        if answer == library_host.NOT_LOADED:
            error = _not_loaded(declared.file, reason[0])
        elif answer == library_host.NO_FUNCTION:
            error = _no_function(declared.file, declared.function)
        elif answer is None:
            what = f"{declared.file} was not loaded within {declared.first_patience:g} s"
            error = Problem("file", what).error()
        else:
            what = f"{declared.file} has ended the process that loads it: {self._how_it_ended()}"
            error = Problem("file", what).error()
        self.close()
        raise error

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, shape (n,).

        Raises:
            SimulationError: the library has crashed, does not return, or has written torques of
                too many joints.
        """
        values = self._values
        values[0], values[1], values[2] = sensed.angles, sensed.velocities, sensed.torques
        values[3], values[4], values[5] = target.angles, target.velocities, target.accelerations
        if self._declared.gravity:
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            values[6] = self._model.gravity()
        values[7] = out
        self._time[0] = sensed.time
        answer: bytes | None = b""
        with suppress(BrokenPipeError):
            os.write(self._to, b"1")
            answer = self._answer(self._declared.patience)
        if answer is None:
            patience = self._declared.patience
            raise self._error(sensed, f"{self._name} did not return within {patience:g} s")
        if answer != library_host.DONE:
            raise self._error(sensed, f"{self._name} ended its process: {self._how_it_ended()}")
        if self._memory[-len(_GUARD) :] != _GUARD:
            self.close()
            raise _writes_too_much(self._name, self._model, sensed.time)
        out[:] = values[7]
        self._core.come()  # after the first call, which may have started threads

    def close(self) -> None:
        self._end()

    def _start(self, timestep: float) -> None:
        declared, n = self._declared, self._model.n
        shared = Path("/dev/shm")
        folder = shared if shared.is_dir() else Path(tempfile.gettempdir())
        handle, path = tempfile.mkstemp(prefix="sero-mj-library-", dir=folder)
        size = library_host.HEAD + 8 * len(ARRAYS) * n
        os.ftruncate(handle, size + len(_GUARD))
        self._memory = memory = mmap.mmap(handle, size + len(_GUARD))
        memory[size:] = _GUARD
        os.close(handle)
        self._time = np.frombuffer(memory, np.float64, 1)
        self._values = np.frombuffer(
            memory, np.float64, len(ARRAYS) * n, library_host.HEAD
        ).reshape(-1, n)
        theirs_in, self._to = os.pipe()
        self._from, theirs_out = os.pipe()
        arguments = [
            *(declared.file.absolute(), declared.function, path, theirs_in, theirs_out, n),
            *(repr(timestep), int(declared.gravity)),
        ]
        command = [sys.executable, "-S", "-E", library_host.__file__, *map(str, arguments)]
        try:
            self._child = child = ChildProcess(
                command,
                pass_fds=(theirs_in, theirs_out),
                stdin=subprocess.DEVNULL,
                leftovers=[Path(path)],
            )
        finally:
            os.close(theirs_in)
            os.close(theirs_out)  # otherwise the end of the process would not be detected
        self._core = SharedCore(child.process.pid)
        self._poll = select.poll()
        self._poll.register(self._from, select.POLLIN)
        self._end = weakref.finalize(self, _end, child, (self._to, self._from))

    def _answer(self, patience: float) -> bytes | None:
        """Returns a received byte, None after a timeout, or b"" if the process has ended."""
        waited = 0.0
        while not self._poll.poll(_SLICE):
            waited += _SLICE / 1e3
            # Child processes of the process may hold the pipe open.
            if self._child.status and not self._poll.poll(0):
                return b""
            if waited > patience:
                return None
        return os.read(self._from, 1)

    def _how_it_ended(self) -> str:
        with suppress(subprocess.TimeoutExpired):
            self._child.process.wait(_CLOSED)
        how = self._child.status or "it has closed its pipes"
        lines = self._child.lines()
        shown = [line for line in lines if line.startswith("Fatal Python error")] or lines
        return how + (f"; {shown[-1]}" if shown else "")

    def _error(self, sensed: Sensed, what: str) -> SimulationError:
        self.close()
        return SimulationError(sensed.time, self._model.name, what)

    def __getstate__(self) -> Any:
        raise TypeError("an isolated library cannot be pickled")


def _end(child: ChildProcess, pipes: tuple[int, int]) -> None:
    for pipe in pipes:
        os.close(pipe)
    with suppress(subprocess.TimeoutExpired):
        child.process.wait(_CLOSED)  # so that the library's own exit handlers run
    child.end()
