"""`kind = "udp"`: a program receives the robot's state by UDP, and answers with a command."""

from __future__ import annotations

import logging
import os
import select
import shlex
import socket
import struct
import time as clock
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Protocol, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from ...base.errors import Problem, SimulationError, mismatch
from ...base.frames import Array
from ...base.trust import RequestedAction
from ...robots.declared.robot import SerialRobot
from ..control.controller import Controller, ControllerDeclaration, MaybePerJoint, Sensed, Target
from ..control.robot_model import RobotModel
from .exchange import Answer, State
from .program import PORT, Program, find_program, held_port, is_file

log = logging.getLogger(__name__)

DONT_WAIT = getattr(socket, "MSG_DONTWAIT", 0)
_SLICE = 0.02  # time between checks for interrupts and for the end of the program, s
_BEHIND = 10  # maximum lag in steps of a program that counts as answering every step
_OLD = 0.02  # minimum age of a command that is reported, s
RECEIVE_BUFFER = 1 << 20  # size in bytes, so that unexpected packets do not displace the answer


def _as_word(value: Any) -> Any:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return repr(value) if is_number else value


Word = Annotated[str, BeforeValidator(_as_word)]


class Reachable(ControllerDeclaration):
    """Base class of controllers that are programs with a network address.

    Attributes:
        host: address of the program.
        port: port of the program; 0 selects a free port for `command`.
        command: command that starts the program for a run, for example ["./controller", "--port",
            "{port}"]; empty if the program is already running. Numbers are converted to text.
        folder: working directory of the program, relative to the scenario's folder (the default).
        clock: `lockstep` (the simulation waits for the answer to each state) or `real_time` (states
            are sent on time, and the latest answer is used until the next step, as on a robot).
        same_core: whether to move a started program to the CPU core of the simulation after its
            first answer. It only applies in lockstep, where waking another core takes time. Set it
            to false for programs that later start threads for parallel computations.
        patience: maximum time to wait for an answer in lockstep, and maximum age of a command in
            real time, s.
        first_patience: maximum time to wait for the first answer, s.
    """

    may_be_probed: ClassVar[bool] = False

    host: str = "127.0.0.1"
    port: int = Field(0, ge=0, le=65535)
    command: list[Word] = []
    folder: Path = Path()
    clock: Literal["lockstep", "real_time"] = "lockstep"
    same_core: bool = True
    patience: float = Field(1.0, gt=0, le=3600)
    first_patience: float = Field(10.0, gt=0, le=3600)

    @model_validator(mode="after")
    def _is_reachable(self) -> Self:
        names_port = any(PORT in part for part in self.command)
        if self.port == 0 and not names_port:
            expected = f"a port number, or a command with {PORT}"
            raise Problem("port", "is required", expected=expected).error()
        return self

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        return None

    @property
    def peer(self) -> str:
        """Name of the program that is shown when the user must allow the connection."""
        return f"{self.host}:{self.port}"

    def actions(self, key: str = "") -> list[RequestedAction]:
        if not self.command:
            return [RequestedAction(key, f"exchange packets with {self.peer}")]
        beside = [self.folder / word for word in self.command]
        files = tuple(path.absolute() for path in beside if is_file(path))
        name, *words = self.command
        if os.sep in name:  # show the absolute path, which may be outside of the scenario's folder
            name = str(beside[0].absolute())
        return [RequestedAction(key, f"run the program {shlex.join([name, *words])}", files)]

    @property
    def is_in_real_time(self) -> bool:
        return self.clock == "real_time"

    def check_files(self) -> None:
        if self.command:
            find_program(self.command, self.folder)

    @staticmethod
    def steps_per_cycle(cycle: float, timestep: float) -> int:
        """Returns the steps in a cycle (s). Raises DeclarationError if they are fractional."""
        steps = round(cycle / timestep)
        if steps < 1 or abs(steps * timestep - cycle) > 1e-9:
            raise mismatch(cycle, f"a multiple of the time step, {timestep:g} s", key="cycle")
        return steps


class Link:
    """A socket to a program. The program is started if a command is declared.

    Attributes:
        buffer: last received bytes.
        answered: number of the last answered step; 0 if there is none.
        is_silent: whether an answer is missing.
        why_silent: reason for a missing answer, to be appended to a message; empty if unknown.
        why_wrong: reason why an answer was ignored; empty if only its size is wrong.
    """

    def __init__(self, declared: Reachable, robot: str, max_size: int) -> None:
        self.buffer = bytearray(max_size + 1)
        self.answered, self.is_silent, self.why_silent, self.why_wrong = 0, False, "", ""
        self._declared, self._robot = declared, robot
        declared.check_files()
        self._program: Program | None = None
        self._socket: socket.socket | None = None
        self._held: socket.socket | None = None  # see `held_port`
        self._port = declared.port
        # Monotonic times of the start of the run, and of the end of waiting for the first answer.
        self._began = self._given_up = 0.0
        self._late = 0.0  # delay of this step, s

    @property
    def name(self) -> str:
        """Name of the program in messages."""
        declared = self._declared
        words = [Path(part).name for part in declared.command if "{" not in part]
        return " ".join(words[:2]) or f"{declared.host}:{declared.port}"

    @property
    def is_open(self) -> bool:
        return self._socket is not None

    def open(self, time: float) -> None:
        """Starts the program, if a command is declared, and opens the socket.

        Args:
            time: simulated time, s.

        Raises:
            DeclarationError: the program cannot be started.
            SimulationError: the address is invalid.
        """
        declared = self._declared
        self._port = declared.port
        if not self._port:
            self._held = held_port()
            weakref.finalize(self, self._held.close)
            self._port = self._held.getsockname()[1]
        if declared.command:
            command = [part.replace(PORT, str(self._port)) for part in declared.command]
            self._program = Program(command, declared.folder)
        self._socket = opened = socket.socket(type=socket.SOCK_DGRAM)
        weakref.finalize(self, opened.close)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            opened.connect((declared.host, self._port))
        except OSError as error:
            what = f"{declared.host}:{self._port}: {error.strerror or error}"
            raise self.error(time, what) from error
        if declared.clock == "real_time":
            opened.setblocking(False)
        elif os.name == "posix":  # `settimeout` would poll before each call
            wait = struct.pack("ll", 0, round(_SLICE * 1e6))
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, wait)
        else:
            opened.settimeout(_SLICE)
        self._given_up = clock.monotonic() + declared.first_patience
        self._began = clock.monotonic() - time

    @property
    def is_given_up(self) -> bool:
        """Whether there was no first answer within `first_patience`."""
        return not self.answered and clock.monotonic() > self._given_up

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        if self._program is not None:
            self._program.end()
        self._program = None
        if self._held is not None:
            self._held.close()
        self._held = None

    def ask(
        self,
        packet: bytes | bytearray,
        step: int,
        time: float,
        take: Callable[[int], bool],
        patience: float | None = None,
    ) -> bool:
        """Sends a state in lockstep, waits for the answer, and returns whether it was received.

        Args:
            time: simulated time, s.
            take: function that gets the size of an answer in `buffer`, and validates the answer.
            patience: maximum time to wait once the program listens, s (default: as declared).

        Raises:
            SimulationError: the program has ended.
        """
        assert self._socket is not None
        patience = self._patience(patience)
        deadline = clock.monotonic() + patience
        self._share_core()
        is_sent = self.send(packet)
        while True:
            try:
                if not is_sent:
                    clock.sleep(_SLICE)
                    is_sent = self.send(packet)
                size = self._socket.recv_into(self.buffer)
                self.why_silent = ""
                if take(size):
                    self.answered = step
                    return True
            except (BlockingIOError, TimeoutError):
                pass
            except ConnectionError:  # no program listens yet, so the packet was not delivered
                self._is_refused()
                is_sent = bool(self.answered)
                clock.sleep(_SLICE if is_sent else 0.0)
                if not self.answered:
                    deadline = min(clock.monotonic() + patience, self._given_up)
            self.check(time)
            if clock.monotonic() > deadline:
                return False

    def _patience(self, patience: float | None) -> float:
        if self.is_silent:
            return _SLICE  # do not wait in every step
        if patience is not None:
            return patience
        return self._declared.patience if self.answered else self._declared.first_patience

    def _share_core(self) -> None:
        if self._program is not None and self.answered and self._declared.same_core:
            self._program.come_beside()

    def send(self, packet: bytes | bytearray) -> bool:
        """Sends a packet, and returns whether it was delivered."""
        assert self._socket is not None
        try:
            self._socket.send(packet)
        except ConnectionError:
            self._is_refused()
            return False
        except BlockingIOError:
            return False
        return True

    def _is_refused(self) -> None:
        self.why_silent = f": no program listens at {self._declared.host}:{self._port}"

    def drain(self) -> int:
        """Discards all received packets, and returns their number."""
        assert self._socket is not None
        count = 0
        try:
            while True:
                self._socket.recv(1, DONT_WAIT)
                count += 1
        except OSError:
            return count

    # ---- real time

    def wait_until(self, time: float) -> float:
        """Waits until a simulated time is due, and returns the delay behind it in seconds."""
        due = self._began + time
        while (left := due - clock.monotonic()) > 0.0:
            clock.sleep(left)
        self._late = -left
        return -left

    def receive(self, take: Callable[[int], object]) -> None:
        """Calls `take` with the size of each received packet, which is in `buffer`."""
        assert self._socket is not None
        while True:
            try:
                size = self._socket.recv_into(self.buffer, 0, DONT_WAIT)
            except OSError:
                return
            self.why_silent = ""
            take(size)

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        """Receives packets until a simulated time, or until a step is answered."""
        assert self._socket is not None
        due = self._due(time, step)
        while self.answered != step and (left := due - clock.monotonic()) > 0.0:
            select.select([self._socket], [], [], left)
            self.receive(take)

    def _due(self, time: float, step: int) -> float:
        """Returns the deadline for the answer to a step, on the monotonic clock, s.

        If the step starts late, its deadline is extended, unless the program lags far behind.
        """
        keeps_up = step - self.answered <= _BEHIND
        return self._began + time + (self._late if keeps_up else 0.0)

    def wait_for_first(
        self, packet: bytes | bytearray, time: float, take: Callable[[int], object]
    ) -> None:
        """Sends a packet repeatedly until the program answers, and then starts the clock."""
        deadline = clock.monotonic() + self._declared.first_patience
        while not self.answered and clock.monotonic() < deadline:
            clock.sleep(_SLICE / 10)
            self.receive(take)
            self.check(time)
            if not self.answered:
                self.send(packet)
        self._began = clock.monotonic() - time

    # ---- errors

    def check(self, time: float) -> None:
        """Raises SimulationError if the program has ended."""
        if self._program is not None and self._program.has_ended:
            raise self.error(time, self._program.why())

    def error(self, time: float, what: str) -> SimulationError:
        """Closes the link, and returns the error that ends the run."""
        self.close()
        return SimulationError(time, self._robot, what)


class Answering(Reachable):
    """Base class of controllers that answer each state with a command.

    Attributes:
        on_silence: reaction to a missing answer: `stop` ends the run, `hold` repeats the last
            command, and `gravity_compensation` only compensates gravity until the next answer.
    """

    logged: ClassVar[tuple[str, ...]] = ("command_age", "step_lateness")

    on_silence: Literal["stop", "hold", "gravity_compensation"] = "stop"


class Filled(Protocol):
    """A packet that is updated in each step; see `State`."""

    modulus: int

    @property
    def packet(self) -> bytes | bytearray: ...

    def fill(self, step: int, sensed: Sensed, target: Target) -> None: ...


class PacketProgram(Answering):
    """Base class of programs that receive a packet for each state, and answer with a packet.

    Attributes:
        state: structure of the state with any of step, flags (1 in the first state), time, angles,
            velocities, torques, motor_angles, motor_velocities, gravity, coriolis, mass_matrix,
            target_angles, target_velocities, target_accelerations and target_pose. The default is
            step:1I flags:1I time:1d, followed by angles, velocities, torques, target_angles,
            target_velocities and gravity with n doubles each.
        answer: structure of the answer with the step of its state and either torques or
            joint_angles. It can also have feed_forward and, with joint_angles, stiffness and
            damping. The default is step:1I 4x torques:nd.
        stiffness: stiffness per joint for answers with joint_angles but without stiffness, Nm/rad.
        damping: damping per joint for answers with joint_angles but without damping, Nm s/rad.
    """

    state: str = ""
    answer: str = ""
    stiffness: MaybePerJoint = None
    damping: MaybePerJoint = None

    def _packets(self, model: RobotModel) -> tuple[State, Answer]:
        gains = [
            None if getattr(self, key) is None else self.per_joint(key, model.n)
            for key in ("stiffness", "damping")
        ]
        return State(self.state, model), Answer(self.answer, model, *gains)


class UdpProgram(PacketProgram):
    """A user's program that exchanges data by UDP."""

    title: ClassVar[str] = "program over UDP"
    order: ClassVar[int] = 70

    kind: Literal["udp"] = "udp"

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        return ProgramController(self, *self._packets(model), model, timestep)


class ProgramController(Controller):
    """Sends states to a program, and applies its commands.

    Args:
        link: connection to the program (default: a UDP socket).

    Attributes:
        logged: age of the current command and delay of the current step, shape (2,), s.
        wrong: number of ignored answers (wrong size, wrong step, or not finite).
        silent: number of steps without an answer.
    """

    def __init__(
        self,
        declared: Answering,
        state: Filled,
        answer: Answer,
        model: RobotModel,
        timestep: float,
        link: Link | None = None,
    ) -> None:
        self._declared, self._state, self._answer = declared, state, answer
        self._modulus = min(state.modulus, answer.modulus)
        self._model, self._timestep = model, timestep
        self._link = link or Link(declared, model.name, answer.structure.size)
        self._link.buffer = answer.incoming
        self.logged: Array = np.zeros(2)
        self.wrong = self.silent = self._step = 0
        self._why_wrong = ""  # of the last ignored answer

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, shape (n,).

        Raises:
            SimulationError: the answer is missing, and `on_silence` is `stop`.
        """
        link = self._link
        self._step += 1
        if not link.is_open:
            link.open(sensed.time)
        self._state.fill(self._step, sensed, target)
        if self._is_fresh(sensed.time):
            if link.is_silent:
                log.warning("%s answers again at %.3f s", link.name, sensed.time)
                link.is_silent = False
        else:
            self._handle_missing_answer(sensed.time)
        self.logged[0] = (self._step - link.answered) * self._timestep
        if link.is_silent and self._declared.on_silence == "gravity_compensation":
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            out[:] = self._model.gravity()
        else:
            self._answer.write(sensed, out)

    @property
    def commanded_angles(self) -> Array | None:
        """Commanded equilibrium angles of springs, (n,), rad or m; None for torque commands."""
        return self._answer.angles

    def close(self) -> None:
        """Ends the program, and reports ignored and missing answers."""
        self._link.close()
        if self.wrong or self.silent:
            log.warning(
                "%s: %d answers were ignored%s, %d steps had no answer",
                self._link.name, self.wrong, self._why_wrong, self.silent,
            )  # fmt: skip
        if self.logged[0] > _OLD:
            log.warning("%s: no command in the last %.3f s", self._link.name, self.logged[0])
        self.wrong = self.silent = 0
        self.logged[0] = 0.0

    def _is_fresh(self, time: float) -> bool:
        """Sends the state, receives answers, and returns whether the latest is recent enough."""
        link, packet = self._link, self._state.packet
        if self._declared.clock == "lockstep":
            if not self._answer.has_step:  # earlier packets could be mistaken for the answer
                self.wrong += link.drain()
            return link.ask(packet, self._step, time, self._take)
        self.logged[1] = link.wait_until(time)
        link.receive(self._follow)
        link.send(packet)
        if not link.answered:
            link.wait_for_first(packet, time, self._follow)
        link.receive_until(time + self._timestep, self._step, self._follow)
        if link.answered != self._step:
            link.check(time)
        age = (self._step - link.answered) * self._timestep
        return bool(link.answered) and age <= self._declared.patience

    def _take(self, size: int) -> bool:
        return self._take_answer(size, self._step)

    def _take_answer(self, size: int, step: int) -> bool:
        answer = self._answer
        if size != answer.structure.size:
            self.wrong += 1
            # The buffer is one byte larger than an answer.
            found = f"{size}" if size <= answer.structure.size else "more"
            why = self._link.why_wrong or f"found {found} bytes; expected {answer.structure.size}"
            self._why_wrong = f" ({why})"
            return False
        if wrong := answer.wrong_checksum:
            self._why_wrong = f" ({wrong})"
        elif answer.has_step and (step - answer.step) % self._modulus:
            self._why_wrong = f" (expected step {step})"
        elif not answer.is_finite:
            self._why_wrong = f" (step {step}: not finite)"
        else:
            answer.use()
            return True
        self.wrong += 1
        return False

    def _follow(self, size: int) -> None:
        step = self._step_in_buffer(size)
        if step <= self._link.answered:
            if step != 1:  # the first state is sent repeatedly
                self.wrong += 1
                self._why_wrong = self._why_wrong or " (not newer than the previous one)"
        elif self._take_answer(size, step):
            self._link.answered = step

    def _step_in_buffer(self, size: int) -> int:
        """Returns the step number of the received answer, or the latest step if it has none."""
        answer = self._answer
        if size != answer.structure.size or not answer.has_step:
            return self._step
        behind = (self._step - answer.step) % self._modulus
        return self._step - int(behind) if np.isfinite(behind) else 0

    def _handle_missing_answer(self, time: float) -> None:
        self.silent += 1
        declared, link = self._declared, self._link
        link.check(time)
        patience = declared.patience if link.answered else declared.first_patience
        what = f"no answer from {link.name} to step {self._step} within {patience:g} s"
        what += link.why_silent
        if declared.on_silence == "stop" or not (
            link.answered or declared.on_silence == "gravity_compensation"
        ):
            raise link.error(time, what)
        if not link.is_silent:
            log.warning("at %.3f s: %s; %s", time, what, declared.on_silence)
        link.is_silent = True

    def __getstate__(self) -> Any:
        raise TypeError("a controller that is connected to a program cannot be pickled")
