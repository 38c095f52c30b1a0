"""`kind = "udp"`: a program gets the robot's state in a datagram, and answers with what to do."""

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
_SLICE = 0.02  # s, in which an interrupt and the end of the program are seen
_BEHIND = 10  # steps, by which a program that keeps up may be
_OLD = 0.02  # s, age of a command that is told
RECEIVE_BUFFER = 1 << 20  # bytes, so that a flood of strays does not push the answer out


def _as_word(value: Any) -> Any:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return repr(value) if is_number else value


Word = Annotated[str, BeforeValidator(_as_word)]


class Reachable(ControllerDeclaration):
    """Base of controllers that are programs reached by UDP.

    Attributes:
        host: address of the program.
        port: its port; 0 with `command`: a free one.
        command: starts the program, ["./controller", "--port", "{port}"] say, and it ends with the
            run; none where it runs already. Numbers may be in it, as in a shell.
        folder: where it is started; relative to the scenario's folder, which is the default.
        clock: `lockstep`: the simulation waits for the answer to each state; `real_time`: a state
            is sent at its time, and the newest answer until the next one is due holds, as on a
            robot.
        same_core: in lockstep, whether the main thread of a program that was started runs on the
            core of the simulation once it has answered, which then need not wake another one;
            false for programs that start threads later to compute beside each other.
        patience: s to wait for an answer in lockstep; in real time, age at which a command is old.
        first_patience: s to wait for the first answer.
    """

    may_be_asked: ClassVar[bool] = False

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
            expected = f"its number, or a command with {PORT}"
            raise Problem("port", "is required", expected=expected).error()
        return self

    @classmethod
    def for_robot(cls, robot: SerialRobot, model: RobotModel) -> Self | None:
        """None: there is no program."""
        return None

    def actions(self, key: str = "") -> list[RequestedAction]:
        if not self.command:
            return [RequestedAction(key, f"exchange packets with {self._peer}")]
        beside = [self.folder / word for word in self.command]
        files = tuple(path.absolute() for path in beside if is_file(path))
        name, *words = self.command
        if os.sep in name:  # where it is, which may be far from the file that was opened
            name = str(beside[0].absolute())
        return [RequestedAction(key, f"run the program {shlex.join([name, *words])}", files)]

    @property
    def is_in_real_time(self) -> bool:
        return self.clock == "real_time"

    @property
    def _peer(self) -> str:
        return f"{self.host}:{self.port}"

    def check_files(self) -> None:
        if self.command:
            find_program(self.command, self.folder)

    @staticmethod
    def steps_per_cycle(cycle: float, timestep: float) -> int:
        """Returns the number of time steps in a cycle (s); raises DeclarationError."""
        steps = round(cycle / timestep)
        if steps < 1 or abs(steps * timestep - cycle) > 1e-9:
            raise mismatch(cycle, f"a multiple of the time step, {timestep:g} s", key="cycle")
        return steps


class Link:
    """A socket to a program, which is started where that is declared.

    Attributes:
        buffer: what came last.
        answered: number of the step whose answer was applied last; 0 for none.
        is_silent: whether an answer is missing.
        why_silent: what is known of the cause, to be put behind a sentence; empty for nothing.
        why_wrong: likewise of an answer of a wrong size, where that is not how to say it.
    """

    def __init__(self, declared: Reachable, robot: str, most: int) -> None:
        self.buffer = bytearray(most + 1)
        self.answered, self.is_silent, self.why_silent, self.why_wrong = 0, False, "", ""
        self._declared, self._robot = declared, robot
        declared.check_files()
        self._program: Program | None = None
        self._socket: socket.socket | None = None
        self._held: socket.socket | None = None  # see `held_port`
        self._port = declared.port
        # On the clock's time: when a run in real time began, and until when to wait at first.
        self._began = self._given_up = 0.0
        self._late = 0.0  # s, how much this step is

    @property
    def name(self) -> str:
        """Of the program, for messages."""
        declared = self._declared
        words = [Path(part).name for part in declared.command if "{" not in part]
        return " ".join(words[:2]) or f"{declared.host}:{declared.port}"

    @property
    def is_open(self) -> bool:
        """Whether it is."""
        return self._socket is not None

    def open(self, time: float) -> None:
        """Starts the program, if it is to be, and opens the socket.

        Args:
            time: s since the start.

        Raises:
            DeclarationError: the program cannot be started.
            SimulationError: there is no such address.
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
        elif os.name == "posix":  # `settimeout` would poll before each of them
            wait = struct.pack("ll", 0, round(_SLICE * 1e6))
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, wait)
        else:
            opened.settimeout(_SLICE)
        self._given_up = clock.monotonic() + declared.first_patience
        self._began = clock.monotonic() - time

    @property
    def is_given_up(self) -> bool:
        """Whether there was no first answer for as long as is declared."""
        return not self.answered and clock.monotonic() > self._given_up

    def close(self) -> None:
        """Ends the program; harmless when it has ended."""
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
        """Sends a state in lockstep, and waits for its answer; whether it came.

        Args:
            time: s since the start.
            take: gets the bytes of an answer, which is in `buffer`; whether it was the one.
            patience: s to wait once somebody listens; as declared when None.

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
            except ConnectionError:  # nobody listens there yet, so that it has not arrived
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
            return _SLICE  # it is not waited for at every step again
        if patience is not None:
            return patience
        return self._declared.patience if self.answered else self._declared.first_patience

    def _share_core(self) -> None:
        if self._program is not None and self.answered and self._declared.same_core:
            self._program.come_beside()

    def send(self, packet: bytes | bytearray) -> bool:
        """Sends a packet; whether somebody may have got it."""
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
        self.why_silent = f": nobody listens at {self._declared.host}:{self._port}"

    def drain(self) -> int:
        """Discards what came before; returns how many packets."""
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
        """Waits until it is a time, s since the start; returns how late it is, s."""
        due = self._began + time
        while (left := due - clock.monotonic()) > 0.0:
            clock.sleep(left)
        self._late = -left
        return -left

    def receive(self, take: Callable[[int], object]) -> None:
        """Passes on the sizes of all packets that have come, which are in `buffer`."""
        assert self._socket is not None
        while True:
            try:
                size = self._socket.recv_into(self.buffer, 0, DONT_WAIT)
            except OSError:
                return
            self.why_silent = ""
            take(size)

    def receive_until(self, time: float, step: int, take: Callable[[int], object]) -> None:
        """Likewise until it is a time, s since the start, or a step has been answered."""
        assert self._socket is not None
        due = self._due(time, step)
        while self.answered != step and (left := due - clock.monotonic()) > 0.0:
            select.select([self._socket], [], [], left)
            self.receive(take)

    def _due(self, time: float, step: int) -> float:
        """Until when a step may be answered, on the clock's time.

        Where steps are late, all those of a picture of a viewer say, a program that keeps up has as
        long as for those in time.
        """
        keeps_up = step - self.answered <= _BEHIND
        return self._began + time + (self._late if keeps_up else 0.0)

    def wait_for_first(
        self, packet: bytes | bytearray, time: float, take: Callable[[int], object]
    ) -> None:
        """Sends a packet until the program answers, and lets time begin then."""
        deadline = clock.monotonic() + self._declared.first_patience
        while not self.answered and clock.monotonic() < deadline:
            clock.sleep(_SLICE / 10)
            self.receive(take)
            self.check(time)
            if not self.answered:
                self.send(packet)
        self._began = clock.monotonic() - time

    # ---- the program's end

    def check(self, time: float) -> None:
        """Raises SimulationError where the program has ended; `time` is s since the start."""
        if self._program is not None and self._program.has_ended:
            raise self.error(time, self._program.why())

    def error(self, time: float, what: str) -> SimulationError:
        """What ends the run at a time, s; the program is ended."""
        self.close()
        return SimulationError(time, self._robot, what)


class Answering(Reachable):
    """Base of those that answer each state with a command.

    Attributes:
        on_silence: `stop`: the run ends; `hold`: the last command goes on;
            `gravity_compensation`: gravity alone, until there are answers again.
    """

    logged: ClassVar[tuple[str, ...]] = ("command_age", "step_lateness")

    on_silence: Literal["stop", "hold", "gravity_compensation"] = "stop"


class Filled(Protocol):
    """What is sent, written anew for each step; see `State`."""

    modulus: int

    @property
    def packet(self) -> bytes | bytearray:
        """The bytes of it."""

    def fill(self, step: int, sensed: Sensed, target: Target) -> None:
        """Writes the state of a step."""


class PacketProgram(Answering):
    """Base of programs that get a packet for each state, and answer with one.

    Attributes:
        state: structure of the packet that it gets: any of step, flags (1 in the first), time,
            angles, velocities, torques, motor_angles, motor_velocities, gravity, coriolis,
            mass_matrix, target_angles, target_velocities, target_accelerations, target_pose.
            Default: step:1I flags:1I time:1d
            angles velocities torques target_angles target_velocities gravity, each of n:d.
        answer: structure of its answer: step (of the state that it answers) and either torques, or
            joint_angles with stiffness, damping; feed_forward. Default: step:1I 4x torques:nd.
        stiffness: Nm/rad per joint, where answers with joint_angles have none.
        damping: Nm s/rad per joint, likewise.
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
    """A program of the user's, over UDP."""

    title: ClassVar[str] = "program over UDP"
    order: ClassVar[int] = 70

    kind: Literal["udp"] = "udp"

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        """The controller; the program is started with its first step."""
        return ProgramController(self, *self._packets(model), model, timestep)


class ProgramController(Controller):
    """Sends states to a program, and commands what it answers.

    Args:
        timestep: s between two steps.
        link: by which they go; a socket when None.

    Attributes:
        logged: (2,), s: the age of the command in use, and how late this step began.
        wrong: answers that were not applied, of a wrong size, to another step, or not finite.
        silent: steps without an answer.
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
        self._modulus = min(state.modulus, answer.modulus)  # small counters begin at 0 again
        self._model, self._timestep = model, timestep
        self._link = link or Link(declared, model.name, answer.structure.size)
        self._link.buffer = answer.incoming
        self.logged: Array = np.zeros(2)
        self.wrong = self.silent = self._step = 0
        self._why_wrong = ""  # the last answer that was not applied

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,).

        Raises:
            SimulationError: there is no answer, and that ends the run.
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
            self._bear_silence(sensed.time)
        self.logged[0] = (self._step - link.answered) * self._timestep
        if link.is_silent and self._declared.on_silence == "gravity_compensation":
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            out[:] = self._model.gravity()
        else:
            self._answer.write(sensed, out)

    @property
    def commanded_angles(self) -> Array | None:
        """What the program's springs draw to, (n,), rad or m; None where it commands torques."""
        return self._answer.angles

    def close(self) -> None:
        """Ends the program, and tells what was wrong; harmless when it has ended."""
        self._link.close()
        if self.wrong or self.silent:
            log.warning(
                "%s: %d answers were not applied%s, %d steps had none",
                self._link.name, self.wrong, self._why_wrong, self.silent,
            )  # fmt: skip
        if self.logged[0] > _OLD:
            log.warning("%s: no command for %.3f s at the end", self._link.name, self.logged[0])
        self.wrong = self.silent = 0
        self.logged[0] = 0.0

    def _is_fresh(self, time: float) -> bool:
        """Sends the state, and takes its answer; whether there is one that is not too old."""
        link, packet = self._link, self._state.packet
        if self._declared.clock == "lockstep":
            if not self._answer.has_step:  # what came before could be taken for the answer
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
            # The buffer holds one byte more than an answer has.
            found = f"{size}" if size <= answer.structure.size else "more"
            why = self._link.why_wrong or f"found {found} bytes; expected {answer.structure.size}"
            self._why_wrong = f" ({why})"
            return False
        if wrong := answer.wrong_checksum:
            self._why_wrong = f" ({wrong})"
        elif answer.has_step and (step - answer.step) % self._modulus:
            self._why_wrong = f" (to another step than {step})"
        elif not answer.is_finite:
            self._why_wrong = f" (to step {step}: not finite)"
        else:
            answer.use()
            return True
        self.wrong += 1
        return False

    def _follow(self, size: int) -> None:
        step = self._step_in_buffer(size)
        if step <= self._link.answered:
            if step != 1:  # the first state is sent until it is answered
                self.wrong += 1
                self._why_wrong = self._why_wrong or " (none newer than the last)"
        elif self._take_answer(size, step):
            self._link.answered = step

    def _step_in_buffer(self, size: int) -> int:
        """Which step an answer is to; without a number that of the newest state."""
        answer = self._answer
        if size != answer.structure.size or not answer.has_step:
            return self._step
        behind = (self._step - answer.step) % self._modulus
        return self._step - int(behind) if np.isfinite(behind) else 0

    def _bear_silence(self, time: float) -> None:
        self.silent += 1
        declared, link = self._declared, self._link
        link.check(time)
        patience = declared.patience if link.answered else declared.first_patience
        what = f"no answer of {link.name} to step {self._step} within {patience:g} s"
        what += link.why_silent
        if declared.on_silence == "stop" or not (
            link.answered or declared.on_silence == "gravity_compensation"
        ):
            raise link.error(time, what)
        if not link.is_silent:
            log.warning("at %.3f s: %s; %s", time, what, declared.on_silence)
        link.is_silent = True

    def __getstate__(self) -> Any:
        raise TypeError("a controller that talks to a program is of this process")
