"""`kind = "udp"`: a program gets the robot's state in a datagram, and answers with what to do."""

from __future__ import annotations

import logging
import os
import select
import socket
import struct
import time as clock
import weakref
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ...base.errors import Problem, SimulationError
from ...base.frames import Array
from ...robots.declared.robot import SerialRobot
from ..control.controller import ControllerDeclaration, MaybePerJoint, Sensed, Target
from ..control.robot_model import RobotModel
from .exchange import Answer, State
from .program import PORT, Program, free_port

log = logging.getLogger(__name__)

_SLICE = 0.02  # s, in which an interrupt and the end of the program are seen
_RECEIVE_BUFFER = 1 << 20  # bytes, so that a flood of strays does not push the answer out


class UdpProgram(ControllerDeclaration):
    """A program of the user's, over UDP.

    Attributes:
        host: address of the program.
        port: its port; 0 with `command`: a free one.
        command: starts the program, ["./controller", "--port", "{port}"] say, and it ends with the
            run; none where it runs already.
        folder: where it is started; relative to the scenario's folder, which is the default.
        state: structure of the packet that it gets: any of step, flags (1 in the first), time,
            angles, velocities, torques, motor_angles, motor_velocities, gravity, target_angles,
            target_velocities, target_accelerations, target_pose. Default: step:1I flags:1I time:1d
            angles velocities torques target_angles target_velocities gravity, each of n:d.
        answer: structure of its answer: step (of the state that it answers) and either torques, or
            joint_angles with stiffness, damping; feed_forward. Default: step:1I 4x torques:nd.
        stiffness: Nm/rad per joint, where answers with joint_angles have none.
        damping: Nm s/rad per joint, likewise.
        clock: `lockstep`: the simulation waits for the answer to each state; `real_time`: a state
            is sent at its time, and the newest answer until the next one is due holds, as on a
            robot.
        patience: s to wait for an answer in lockstep; in real time, age at which a command is old.
        first_patience: s to wait for the first answer.
        on_silence: `stop`: the run ends; `hold`: the last command goes on;
            `gravity_compensation`: gravity alone, until there are answers again.
    """

    may_be_asked: ClassVar[bool] = False
    logged: ClassVar[tuple[str, ...]] = ("command_age", "step_lateness")
    title: ClassVar[str] = "program over UDP"
    order: ClassVar[int] = 70

    kind: Literal["udp"] = "udp"
    host: str = "127.0.0.1"
    port: int = Field(0, ge=0, le=65535)
    command: list[str] = []
    folder: Path = Path()
    state: str = ""
    answer: str = ""
    stiffness: MaybePerJoint = None
    damping: MaybePerJoint = None
    clock: Literal["lockstep", "real_time"] = "lockstep"
    patience: float = Field(1.0, gt=0, le=3600)
    first_patience: float = Field(10.0, gt=0, le=3600)
    on_silence: Literal["stop", "hold", "gravity_compensation"] = "stop"

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

    def make(self, model: RobotModel, timestep: float) -> ProgramController:
        """The controller; the program is started with its first step."""
        n = model.n
        gains = [None if getattr(self, key) is None else self.per_joint(key, n)
                 for key in ("stiffness", "damping")]  # fmt: skip
        return ProgramController(self, State(self.state, model), Answer(self.answer, model, *gains),
                                 model, timestep)  # fmt: skip


class ProgramController:
    """Sends states to a program, and commands what it answers.

    Args:
        declared: how.
        state: what is sent.
        answer: what comes back.
        model: of the robot, for itself.
        timestep: s between two steps.

    Attributes:
        logged: (2,), s: the age of the command in use, and how late this step began.
        wrong: answers that were not applied, of a wrong size, to another step, or not finite.
        silent: steps without an answer.
    """

    def __init__(
        self,
        declared: UdpProgram,
        state: State,
        answer: Answer,
        model: RobotModel,
        timestep: float,
    ) -> None:
        self._declared, self._state, self._answer = declared, state, answer
        self._model, self._timestep = model, timestep
        self.logged: Array = np.zeros(2)
        self.wrong = self.silent = 0
        self._step = self._answered = 0  # of the last answer that was applied
        self._is_silent = False
        self._program: Program | None = None
        self._socket: socket.socket | None = None
        self._buffer = bytearray(answer.structure.size + 1)
        self._began = 0.0  # of a run in real time, on the clock's time

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,).

        Raises:
            SimulationError: there is no answer, and that ends the run.
        """
        self._step += 1
        if self._socket is None:
            self._begin(sensed)
        self._state.fill(self._step, sensed, target)
        exchange = self._ask if self._declared.clock == "lockstep" else self._follow
        if exchange(sensed):
            if self._is_silent:
                log.warning("%s answers again at %.3f s", self._name, sensed.time)
                self._is_silent = False
        else:
            self._bear_silence(sensed)
        self.logged[0] = (self._step - self._answered) * self._timestep
        if self._is_silent and self._declared.on_silence == "gravity_compensation":
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            out[:] = self._model.gravity()
        else:
            self._answer.write(sensed, out)

    def close(self) -> None:
        """Ends the program, and tells what was wrong; harmless when it has ended."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        if self._program is not None:
            self._program.end()
        self._program = None
        if self.wrong or self.silent:
            log.warning(
                "%s: %d answers were not applied, %d steps had none",
                self._name, self.wrong, self.silent,
            )  # fmt: skip
        self.wrong = self.silent = 0

    @property
    def _name(self) -> str:
        declared = self._declared
        return declared.command[0] if declared.command else f"{declared.host}:{declared.port}"

    def _begin(self, sensed: Sensed) -> None:
        """Starts the program, if it is to be, and opens the socket."""
        declared = self._declared
        port = declared.port or free_port()
        if declared.command:
            command = [part.replace(PORT, str(port)) for part in declared.command]
            self._program = Program(command, declared.folder)
        self._socket = opened = socket.socket(type=socket.SOCK_DGRAM)
        weakref.finalize(self, opened.close)
        try:
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
            opened.connect((declared.host, port))
        except OSError as error:
            raise self._error(sensed, f"{declared.host}:{port}: {error.strerror}") from error
        if declared.clock == "real_time":
            opened.setblocking(False)
        elif os.name == "posix":  # `settimeout` would poll before each of them
            wait = struct.pack("ll", 0, round(_SLICE * 1e6))
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, wait)
        else:
            opened.settimeout(_SLICE)
        self._began = clock.monotonic() - sensed.time

    # ---- lockstep

    def _ask(self, sensed: Sensed) -> bool:
        """Sends the state, and waits for its answer; whether it came."""
        assert self._socket is not None
        self._drain()
        patience = self._declared.patience if self._answered else self._declared.first_patience
        if self._is_silent:
            patience = _SLICE  # it is not waited for at every step again
        deadline = clock.monotonic() + patience
        is_sent = self._send()
        while True:
            try:
                if not is_sent:
                    clock.sleep(_SLICE)
                    is_sent = self._send()
                if self._is_answer(self._socket.recv_into(self._buffer), self._step):
                    self._answered = self._step
                    return True
            except (BlockingIOError, TimeoutError):
                pass
            except ConnectionError:  # nobody listens there yet, so that it has not arrived
                is_sent = bool(self._answered)
                clock.sleep(_SLICE if is_sent else 0.0)
            self._check_program(sensed)
            if clock.monotonic() > deadline:
                return False

    def _send(self) -> bool:
        assert self._socket is not None
        try:
            self._socket.send(self._state.packet)
        except (ConnectionError, BlockingIOError):
            return False
        return True

    def _drain(self) -> None:
        """Discards answers to earlier states."""
        assert self._socket is not None
        try:
            while True:
                self._socket.recv(1, socket.MSG_DONTWAIT)
                self.wrong += 1
        except OSError:
            return

    def _is_answer(self, size: int, step: int) -> bool:
        """Takes what is in the buffer if it is the answer to a step."""
        answer = self._answer
        if size != answer.structure.size:
            self.wrong += 1
            return False
        before = bytes(answer.packet)
        answer.packet[:] = self._buffer[:size]
        is_good = (not answer.has_step or answer.step == step) and answer.is_finite
        if not is_good:
            answer.packet[:] = before
            self.wrong += 1
        return is_good

    # ---- real time

    def _follow(self, sensed: Sensed) -> bool:
        """Sends the state at its time, and takes the newest answer; whether it is not too old."""
        assert self._socket is not None
        due = self._began + sensed.time
        while (left := due - clock.monotonic()) > 0.0:
            clock.sleep(left)
        self.logged[1] = -left
        self._receive_all()
        self._send()
        if not self._answered:
            self._wait_for_first(sensed)
        while (left := due + self._timestep - clock.monotonic()) > 0.0:
            if self._answered == self._step:
                break
            select.select([self._socket], [], [], left)
            self._receive_all()
        age = (self._step - self._answered) * self._timestep
        return bool(self._answered) and age <= self._declared.patience

    def _receive_all(self) -> None:
        assert self._socket is not None
        while True:
            try:
                size = self._socket.recv_into(self._buffer)
            except OSError:
                return
            step = self._step_in_buffer(size)
            if step > self._answered and self._is_answer(size, step):
                self._answered = step
            elif step <= self._answered:
                self.wrong += 1

    def _step_in_buffer(self, size: int) -> int:
        """Which step an answer is to; without a number that of the newest state."""
        answer = self._answer
        if size != answer.structure.size or not answer.has_step:
            return max(self._step - 1, 1)
        item = answer.structure.field("step")
        step = int(np.frombuffer(self._buffer, item.dtype, 1, item.offset)[0])
        return step if step <= self._step else 0

    def _wait_for_first(self, sensed: Sensed) -> None:
        """Waits until the program answers, and lets time begin then."""
        deadline = clock.monotonic() + self._declared.first_patience
        while not self._answered and clock.monotonic() < deadline:
            clock.sleep(_SLICE / 10)
            self._receive_all()
            self._check_program(sensed)
            if not self._answered:
                self._send()
        self._began = clock.monotonic() - sensed.time

    # ---- silence

    def _check_program(self, sensed: Sensed) -> None:
        if self._program is not None and self._program.has_ended:
            raise self._error(sensed, self._program.why())

    def _bear_silence(self, sensed: Sensed) -> None:
        """Does what is declared for when there is no answer."""
        self.silent += 1
        declared = self._declared
        if self._program is not None and self._program.has_ended:
            raise self._error(sensed, self._program.why())
        patience = declared.patience if self._answered else declared.first_patience
        what = f"no answer of {self._name} to step {self._step} within {patience:g} s"
        if declared.on_silence == "stop" or not (
            self._answered or declared.on_silence == "gravity_compensation"
        ):
            raise self._error(sensed, what)
        if not self._is_silent:
            log.warning("at %.3f s: %s; %s", sensed.time, what, declared.on_silence)
        self._is_silent = True

    def _error(self, sensed: Sensed, what: str) -> SimulationError:
        self.close()
        return SimulationError(sensed.time, self._model.name, what)

    def __getstate__(self) -> Any:
        raise TypeError("a controller that talks to a program is of this process")
