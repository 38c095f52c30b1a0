"""`kind = "library"`: a function of a shared library, in C or whatever compiles to its calls."""

from __future__ import annotations

import ctypes
import faulthandler
import mmap
import os
import select
import signal
import subprocess
import sys
import tempfile
import weakref
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field

from ...base.errors import Problem, SimulationError
from ...base.frames import Array
from ...base.trust import Action
from ...robots.declared.robot import SerialRobot
from ..control.controller import ControllerDeclaration, Sensed, Target
from ..control.robot_model import RobotModel
from . import library_host
from .library_host import ARRAYS, RobotStruct
from .program import SharedCore

HEADER = Path(__file__).with_name("sero_mj_controller.h")
_GUARD = b"\xa5" * 64  # behind the torques, where a library for more joints writes
# Of ELF files.
_MACHINES = {3: "x86", 8: "mips", 40: "arm", 62: "x86-64", 183: "aarch64", 243: "riscv"}
_SLICE = 20  # ms, in which an interrupt and the end of the process are seen


class Library(ControllerDeclaration):
    """A function of a shared library, `void control(struct sero_mj_robot *robot)`.

    Attributes:
        file: the library, controller.so say; relative to the scenario's folder.
        function: its name.
        gravity: whether the torques that hold the robot are computed for it.
        isolated: whether the library has a process of its own, so that its crash is an error of
            the run; it takes a few microseconds a step more.
        patience: s that a call may take in a process of its own.
    """

    may_be_asked: ClassVar[bool] = False
    title: ClassVar[str] = "library"
    order: ClassVar[int] = 60

    kind: Literal["library"] = "library"
    file: Path
    function: str = "control"
    gravity: bool = True
    isolated: bool = False
    patience: float = Field(10.0, gt=0, le=3600)

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """None: there is no library."""
        return None

    def actions(self, key: str = "") -> list[Action]:
        """See `ControllerDeclaration`."""
        return [Action(key, f"load the library {self.file}", (self.file,))]

    def check_files(self) -> None:
        """See `ControllerDeclaration`."""
        if not self.file.is_file():
            raise Problem("file", f"no file {self.file}").error()

    def make(self, model: RobotModel, timestep: float) -> LibraryController | IsolatedLibrary:
        """The controller; raises DeclarationError where the library cannot be loaded."""
        self.check_files()
        if self.isolated:
            return IsolatedLibrary(self, model, timestep)
        return LibraryController(self, model, timestep)


def _function_of(file: Path, name: str) -> Any:
    """A function of a library; raises DeclarationError."""
    try:
        return library_host.load(str(file.absolute()), name)
    except OSError as error:
        found, own = _machine(file), _machine(Path(sys.executable))
        if found and own and found != own:  # of which the system says that there is no such file
            problem = Problem("file", f"{file} is a library for {found}", expected=f"one for {own}")
            raise problem.error() from None
        raise Problem("file", f"{file} cannot be loaded: {error}").error() from None
    except AttributeError:
        header = (
            f'void {name}(struct sero_mj_robot *), in C++ extern "C", in Rust #[no_mangle]; '
            "see sero-mj snippet controller-c"
        )
        problem = Problem("function", f"{file} has no function {name}", expected=header)
        raise problem.error() from None


def _writes_too_much(name: str, model: RobotModel, time: float) -> SimulationError:
    what = f"{name} writes torques of more joints than there are; expected {model.n}"
    return SimulationError(time, model.name, what)


def _machine(file: Path) -> str:
    """For which machine an ELF file is; empty where it is none."""
    with file.open("rb") as opened:
        head = opened.read(20)
    if len(head) < 20 or head[:4] != b"\x7fELF":
        return ""
    order: Literal["little", "big"] = "little" if head[5] == 1 else "big"
    number = int.from_bytes(head[18:20], order)
    return _MACHINES.get(number, f"machine {number}")


class LibraryController:
    """Calls a function of a library in every step.

    Args:
        declared: the library.
        model: of the robot, for itself.
        timestep: s between two steps.
    """

    def __init__(self, declared: Library, model: RobotModel, timestep: float) -> None:
        function = _function_of(declared.file, declared.function)
        self._model, self._has_gravity = model, declared.gravity
        self._struct = RobotStruct(n=model.n, is_first=1, timestep=timestep)
        self._bound: tuple[Any, ...] = ()
        self._gravity: Array = np.zeros(model.n)
        self._memory = bytearray(8 * model.n) + bytearray(_GUARD)
        self._written: Array = np.frombuffer(self._memory, np.float64, model.n)
        self._name = f"{declared.file}: {declared.function}"
        address = ctypes.c_void_p(ctypes.addressof(self._struct))
        # A crash ends this process. The interpreter then prints the file and line of each call that
        # is under way, so that this one bears the name of the library.
        if not faulthandler.is_enabled() and sys.__stderr__ is not None:
            with suppress(OSError, ValueError):  # it is closed, or no file
                faulthandler.enable(sys.__stderr__)
        scope: dict[str, Any] = {"call": function, "robot": address}
        file = f"library {declared.file.absolute()}"
        code = compile("def control(): call(robot)", file, "exec")
        exec(code, scope)
        self._call = scope["control"]

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,).

        Raises:
            SimulationError: the library has written those of more joints.
        """
        struct = self._struct
        bound = (sensed, target)
        if len(self._bound) != 2 or any(
            a is not b for a, b in zip(bound, self._bound, strict=True)
        ):
            self._bind(sensed, target)
            self._bound = bound
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
        """Points at what is measured, asked for and to be written."""
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
        raise TypeError("a loaded library is of this process")


class IsolatedLibrary:
    """Calls a function of a library in a process of its own.

    State and torques are in memory that both have; pipes carry whose turn it is, and tell of the
    end.

    Args:
        declared: the library.
        model: of the robot, for itself.
        timestep: s between two steps.
    """

    def __init__(self, declared: Library, model: RobotModel, timestep: float) -> None:
        _function_of(declared.file, declared.function)  # so that errors of it are told at once
        self._declared, self._model, self._timestep = declared, model, timestep
        self._end: weakref.finalize[Any, Any] | None = None
        self._process: subprocess.Popen[bytes] | None = None

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,).

        Raises:
            SimulationError: the library has crashed, does not come back, or has written torques of
                more joints.
        """
        if self._process is None:
            self._begin()
        values = self._values
        values[0], values[1], values[2] = sensed.angles, sensed.velocities, sensed.torques
        values[3], values[4], values[5] = target.angles, target.velocities, target.accelerations
        if self._declared.gravity:
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            values[6] = self._model.gravity()
        values[7] = out
        self._time[0] = sensed.time
        try:
            os.write(self._to, b"1")
        except BrokenPipeError:
            raise self._ended(sensed) from None
        waited = 0.0
        while not self._poll.poll(_SLICE):
            waited += _SLICE / 1e3
            if waited > self._declared.patience:
                what = (
                    f"{self._declared.file}: {self._declared.function} does not come back "
                    f"within {self._declared.patience:g} s"
                )
                self.close()
                raise SimulationError(sensed.time, self._model.name, what)
        if os.read(self._from, 1) != b"1":
            raise self._ended(sensed)
        if self._memory[-len(_GUARD) :] != _GUARD:
            self.close()
            name = f"{self._declared.file}: {self._declared.function}"
            raise _writes_too_much(name, self._model, sensed.time)
        out[:] = values[7]
        self._core.come()  # not before it has begun threads, if it does

    def close(self) -> None:
        """Ends the process; harmless when it has ended."""
        if self._end is not None:
            self._end()

    def _begin(self) -> None:
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
        errors = tempfile.TemporaryFile()  # noqa: SIM115  # open as long as the process
        arguments = [
            *(declared.file.absolute(), declared.function, path, theirs_in, theirs_out, n),
            *(repr(self._timestep), int(declared.gravity)),
        ]
        command = [sys.executable, "-S", "-E", library_host.__file__, *map(str, arguments)]
        self._process = process = subprocess.Popen(
            command, pass_fds=(theirs_in, theirs_out), stderr=errors, stdin=subprocess.DEVNULL
        )
        os.close(theirs_in)
        os.close(theirs_out)  # else its end would not be seen
        self._errors = errors
        self._core = SharedCore(process.pid)
        self._poll = select.poll()
        self._poll.register(self._from, select.POLLIN)
        self._end = weakref.finalize(self, _end, process, (self._to, self._from), errors, path)

    def _ended(self, sensed: Sensed) -> SimulationError:
        """What has become of the library."""
        assert self._process is not None
        code = self._process.wait()
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").strip().splitlines()
        how = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        said = f"; {lines[0]}" if lines else ""
        what = (
            f"{self._declared.file}: {self._declared.function} has ended its process: {how}{said}"
        )
        self.close()
        return SimulationError(sensed.time, self._model.name, what)

    def __getstate__(self) -> Any:
        raise TypeError("a library in a process of its own is of this process")


def _end(
    process: subprocess.Popen[bytes], pipes: tuple[int, int], errors: IO[bytes], path: str
) -> None:
    for pipe in pipes:
        os.close(pipe)
    errors.close()
    try:
        process.wait(0.5)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    Path(path).unlink(missing_ok=True)
