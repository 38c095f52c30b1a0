"""`kind = "rtde"`: a client of Universal Robots' RTDE controls a simulated robot with six joints.

With `interface = "ur_rtde"`, registers have the same meaning as for the script that the library
ur_rtde (SDU Robotics) uploads: input_int_register_0 is a command, input_double_register_0 and the
following ones are its arguments, and output_int_register_0 reports whether the robot is ready (1)
or done (2). If the client is configured for the upper range, registers from 24 on are used. The
script is never run.
"""

from __future__ import annotations

import logging
import re
import time as clock
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ...base.errors import Problem, SimulationError, mismatch
from ...base.frames import Array
from ...base.once import Once
from ...simulate.control.controller import (
    Controller,
    MaybePerJoint,
    PerJoint,
    Ratio,
    Sensed,
    Target,
    within,
)
from ...simulate.control.joint_control import JointPosition
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.commanded_motion import (
    HOLDS,
    SERVOS,
    SPEEDS,
    TORQUES,
    CommandedMotion,
)
from ...simulate.external_control.program import PORT, Program
from ...simulate.external_control.program_controller import Reachable
from .receiver import PORT as RTDE_PORT
from .server import RtdePeer, RtdeServer
from .state import JOINTS, RtdeState
from .variables import INPUT_DOUBLE, INPUT_INT, OUTPUT_INT, REGISTERS

log = logging.getLogger(__name__)

DASHBOARD, SCRIPT = 29999, 30003  # additional ports that ur_rtde connects to
# Logged states.
NOBODY, CONNECTED, STARTED, COMMANDED, SILENT = 0, 1, 2, 3, 4
READY, DONE = 1, 2  # values of ur_rtde's output register
_CLEAR, _STOP = 0, 255
_MOVE_J, _SPEED_J, _SERVO_J, _TORQUE = 1, 9, 11, 66
_ZERO_SENSOR, _TEACH, _END_TEACH = 8, 18, 19
_STOPS = 15, 16, 34  # speedStop, servoStop, stopJ
_OFFSETS = 0, 24  # first registers of the lower and the upper range
_SLICE = 0.02  # time between checks for interrupts and for the end of the program, s
_DECELERATION = 4.0  # deceleration after the client has become silent, rad/s^2
_NUMBER = re.compile(r"[-+]?\d[\d.e:+-]*")


class RtdeClient(Reachable):
    """An RTDE client, for which the simulated robot listens like a Universal Robots controller.

    Attributes:
        host: address that the robot listens on; 0.0.0.0 for all addresses of this machine.
        port: port of RTDE.
        interface: command interface: `ur_rtde` (the registers that the library ur_rtde and its
            script exchange), or `position` or `torque` (six input registers).
        first_register: first register k of `position` and `torque`. input_double_register_k to k+5
            contain joint angles in rad, or torques in addition to gravity compensation in Nm.
        dashboard_port: port of the dashboard server, which `ur_rtde` connects to; 0 for none.
        script_port: port of a server that accepts and discards URScript; 0 for none.
        cycle: minimum time between packages in s: 0.002 for an e-Series, 0.008 for a CB3.
        stiffness: stiffness of the robot's position control, Nm/rad per joint.
        damping: damping ratio of the robot's position control per joint.
        torque_constants: torque per ampere in Nm/A per joint, to convert torques to currents.
            Without these constants, currents are 0.
        patience: time in s without a command after which a client is considered silent and the
            robot holds its position.
    """

    logged: ClassVar[tuple[str, ...]] = ("rtde_state", "command_age", "step_lateness")
    title: ClassVar[str] = "RTDE client"
    order: ClassVar[int] = 77
    protocol_joints: ClassVar[int] = JOINTS

    kind: Literal["rtde"] = "rtde"
    port: int = Field(RTDE_PORT, ge=0, le=65535)
    clock: Literal["lockstep", "real_time"] = "real_time"
    interface: Literal["ur_rtde", "position", "torque"] = "ur_rtde"
    first_register: int = Field(0, ge=0, le=REGISTERS - JOINTS)
    dashboard_port: int = Field(DASHBOARD, ge=0, le=65535)
    script_port: int = Field(SCRIPT, ge=0, le=65535)
    cycle: float = Field(0.002, gt=0.0, le=0.1)
    stiffness: Annotated[PerJoint, within(1.0, 1e6, "Nm/rad")] = np.array([10000.0])
    damping: Ratio = np.ones(1)
    torque_constants: MaybePerJoint = None

    @model_validator(mode="after")
    def _fields_fit_each_other(self) -> Self:
        if self.interface == "ur_rtde" and "first_register" in self.model_fields_set:
            reason = "requires interface = 'position' or 'torque'. Otherwise, remove it"
            raise Problem("first_register", reason).error()
        constants = self.torque_constants
        if constants is not None and not (constants > 0.0).all():
            lowest = float(constants.min())
            raise mismatch(lowest, "positive numbers, Nm/A", key="torque_constants")
        return self

    def make(self, model: RobotModel, timestep: float) -> RtdeRobot:
        if model.n != JOINTS:
            reason = f"RTDE requires {JOINTS} joints, but {model.name} has {model.n}"
            raise Problem("kind", reason).error()
        return RtdeRobot(self, model, timestep, self.steps_per_cycle(self.cycle, timestep))


class RtdeRobot(Controller):
    """Serves clients in each cycle of `steps` time steps and applies their commands.

    Attributes:
        logged: state (`NOBODY` to `SILENT`), age of the last command in s, and delay of this step
            in s.
    """

    def __init__(
        self, declared: RtdeClient, model: RobotModel, timestep: float, steps: int
    ) -> None:
        self._declared, self._model, self._timestep = declared, model, timestep
        self._steps, self._step, self._time = steps, 0, 0.0
        self._cycle = steps * timestep
        self._motion = CommandedMotion(
            model.joint_names, model.position_limits, model.velocity_limits
        )
        constants = declared.torque_constants
        self._state = RtdeState(
            model,
            self._motion,
            timestep,
            None if constants is None else declared.per_joint("torque_constants", JOINTS),
        )
        self._server = RtdeServer(self, self._cycle, model.name)
        self._program: Program | None = None
        gains = {key: declared.per_joint(key, JOINTS) for key in ("stiffness", "damping")}
        self._holder = JointPosition(**gains).make(model, timestep)
        self._target = Target(JOINTS)
        first = declared.first_register
        self._registers = [f"{INPUT_DOUBLE}{first + k}" for k in range(JOINTS)]
        self._received_inputs: set[str] = set()  # inputs received from the commanding client
        self.logged: Array = np.zeros(3)
        self.wrong = self.silent = 0
        self._is_new = Once()
        self._commander: RtdePeer | None = None  # client that sent the last accepted command
        self._commanded_at = 0.0
        self._is_silent = self._has_answered = False
        self._done_register = ""  # register that reports the end of a motion
        self._began = self._given_up = 0.0
        self._out: Array = np.zeros(JOINTS)
        has_script = declared.interface == "ur_rtde" and declared.script_port
        self._state.is_running = not has_script

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._step += 1
        self._time = sensed.time
        if self._step == 1:
            self._out[:] = out
            self._motion.hold(sensed.motor_angles)
            self._state.begin_cycle(self._cycle)
        self._state.observe(sensed, self._out)
        self._model.update(sensed.motor_angles, sensed.motor_velocities)
        if self._step == 1:
            self._open(sensed.time)
        if (self._step - 1) % self._steps == 0:
            self._exchange(sensed)
        self._motion.step(sensed.time, self._timestep)
        if self._done_register and self._motion.mode == HOLDS:
            self._state.registers[self._done_register] = DONE
            self._done_register = ""
        self.logged[1] = sensed.time - self._commanded_at
        self._control(sensed, out)
        self._out[:] = out

    def close(self) -> None:
        skipped = sum(peer.skipped for peer in self._server.peers)
        if self.wrong or self.silent or skipped:
            log.warning(
                "%s: %d messages or commands were rejected, %d cycles had no command, "
                "%d packages were not read",
                self._model.name, self.wrong, self.silent, skipped,
            )  # fmt: skip
        self.wrong = self.silent = 0
        self._server.close()
        if self._program is not None:
            self._program.end()
        self._program = None

    @property
    def commanded_angles(self) -> Array:
        return self._motion.angles

    # ---- interface for the server

    @property
    def is_running(self) -> bool:
        return self._state.is_running

    def value(self, name: str) -> Any:
        return self._state.value(name)

    def reject(self, reason: str) -> None:
        self.wrong += 1
        if self._is_new(_NUMBER.sub("#", reason)):
            log.warning(
                "%s: a message or command was rejected at %.3f s: %s",
                self._model.name,
                self._time,
                reason,
            )

    def take_script(self, text: bytes) -> None:
        if b"rtde_control" in text:
            self._state.is_running = True
            for offset in _OFFSETS:
                self._state.registers[f"{OUTPUT_INT}{offset}"] = READY
        else:
            self._server.warn_once(f"a script of {len(text)} bytes is not run (no URScript)")

    def stop_program(self) -> None:
        if self._declared.script_port:
            self._state.is_running = False
        self._commander = None
        self._come_to_rest()

    def take(self, peer: RtdePeer, values: dict[str, Any]) -> bool:
        self._state.take(values)
        if values.get("speed_slider_mask"):
            self._server.warn_once("the speed slider has no effect")
        if self._declared.interface == "ur_rtde":
            return self._take_command(peer, values)
        if not self._commands(peer):
            return False
        self._received_inputs |= values.keys()
        is_complete = self._received_inputs.issuperset(self._registers)
        if is_complete and not values.keys().isdisjoint(self._registers):
            numbers = np.array([self._state.registers[name] for name in self._registers])
            if self._declared.interface == "torque":
                self._motion.act(numbers)
                self._note_command(peer)
            else:
                self._servo(peer, numbers)
        return True

    def _commands(self, peer: RtdePeer) -> bool:
        if self._declared.interface == "ur_rtde":
            return any(f"{INPUT_INT}{offset}" in peer.claimed for offset in _OFFSETS)
        return not peer.claimed.isdisjoint(self._registers)

    def _take_command(self, peer: RtdePeer, values: dict[str, Any]) -> bool:
        offset = next((k for k in _OFFSETS if f"{INPUT_INT}{k}" in values), None)
        if offset is None:
            return False
        command = values[f"{INPUT_INT}{offset}"]
        state = f"{OUTPUT_INT}{offset}"
        if command == _CLEAR:
            self._state.registers[state] = READY
            return False  # ur_rtde clears the register after each command
        if command == _STOP:
            self.stop_program()
            return True
        if not self._state.is_running:
            self.reject(f"command {command} while no program is running")
            return True
        registers = self._state.registers

        def numbers(first: int, count: int) -> Array:
            keys = (f"{INPUT_DOUBLE}{offset + first + k}" for k in range(count))
            return np.array([registers.get(key, 0.0) for key in keys])

        if command == _SERVO_J:
            self._servo(peer, numbers(0, JOINTS))
        elif command == _SPEED_J:
            problem = self._motion.speed(numbers(0, JOINTS), float(numbers(JOINTS, 1)[0]))
            self._apply(peer, problem)
        elif command == _TORQUE:
            self._motion.act(numbers(0, JOINTS))
            self._note_command(peer)
        else:
            flag = values.get(f"{INPUT_INT}{offset + 1}")
            self._do_blocking_command(peer, command, state, numbers, flag)
        return True

    def _do_blocking_command(
        self,
        peer: RtdePeer,
        command: int,
        state: str,
        numbers: Callable[[int, int], Array],
        flag: int | None,
    ) -> None:
        motion = self._motion
        self._state.registers[state] = DONE
        if command == _MOVE_J:
            speed, acceleration = numbers(JOINTS, 2).tolist()
            problem = motion.move(numbers(0, JOINTS), speed, acceleration, self._time)
            self._apply(peer, problem)
            if not problem and not flag:  # otherwise it is asynchronous
                self._state.registers[state] = 0
                self._done_register = state
        elif command in _STOPS:
            motion.stop(float(numbers(0, 1)[0]))
            self._commander = None
            self._state.registers[state] = 0
            self._done_register = state
        elif command == _TEACH:
            motion.act(np.zeros(JOINTS))
        elif command == _END_TEACH:
            self._come_to_rest()
        elif command != _ZERO_SENSOR:
            # ur_rtde notices that no program is running and returns false.
            what = f"command {command} of ur_rtde is not supported; its program ends"
            self._state.registers[state] = 0
            self.reject(what)
            peer.send_text(what)
            self.stop_program()

    def _servo(self, peer: RtdePeer, angles: Array) -> None:
        self._apply(peer, self._motion.servo(angles, self._time, self._cycle))

    def _apply(self, peer: RtdePeer, problem: str) -> None:
        if problem:
            self.reject(problem)
        else:
            self._note_command(peer)

    def _note_command(self, peer: RtdePeer) -> None:
        self._commander, self._commanded_at = peer, self._time

    # ---- cycles

    def _open(self, time: float) -> None:
        declared = self._declared
        ports = (
            (declared.dashboard_port, declared.script_port)
            if declared.interface == "ur_rtde"
            else (0, 0)
        )
        try:
            self._server.open(declared.host, declared.port, *ports)
        except OSError as error:
            raise self._error(time, error.strerror or str(error)) from error
        log.info("%s: RTDE at %s:%d", self._model.name, declared.host, self._server.port)
        if declared.command:
            port = str(self._server.port)
            command = [part.replace(PORT, port) for part in declared.command]
            self._program = Program(command, declared.folder)
        self._given_up = clock.monotonic() + declared.first_patience
        if declared.clock == "real_time" and declared.command:
            while not any(peer.is_started for peer in self._server.peers):
                self._server.serve(_SLICE)
                self._check(time)
                if self._program is None or clock.monotonic() > self._given_up:
                    break
        self._began = clock.monotonic() - time

    def _exchange(self, sensed: Sensed) -> None:
        time, server = sensed.time, self._server
        if self._declared.clock == "real_time":
            due = self._began + time
            server.wait_until(due)
            self.logged[2] = max(clock.monotonic() - due, 0.0)
        else:
            server.serve()
        self._state.begin_cycle(self._cycle)
        cycle = (self._step - 1) // self._steps
        server.send(cycle)
        if self._declared.clock == "lockstep":
            self._wait_for_answers(cycle, time)
        self._check(time)
        self._check_silence(sensed)
        self.logged[0] = self._state_number()

    def _wait_for_answers(self, cycle: int, time: float) -> None:
        server, declared = self._server, self._declared
        if self._program is not None and self._has_answered and declared.same_core:
            self._program.come_beside()
        sent_to = {peer for peer in server.peers if peer.is_ready}
        patience = _SLICE if self._is_silent else declared.patience
        deadline = clock.monotonic() + patience
        while True:
            commanding = [peer for peer in server.peers if peer.is_started and self._commands(peer)]
            for peer in commanding:
                if peer not in sent_to and peer.is_ready:  # connected while waiting
                    sent_to.add(peer)
                    if peer.is_due(cycle):
                        server.send_to(peer)
            if commanding and all(peer in sent_to and not peer.is_awaited for peer in commanding):
                self._has_answered = True
                if self._is_silent:
                    log.warning("%s: a client answers again at %.3f s", self._model.name, time)
                self._is_silent = False
                return
            has_ended = self._program is None and bool(declared.command)
            until = deadline if self._has_answered else self._given_up
            if self._has_answered and has_ended and not server.peers:
                return
            if clock.monotonic() > until:
                break
            server.serve(min(_SLICE, max(until - clock.monotonic(), 0.0)))
            self._check(time)
        if not self._has_answered:
            name = f"{declared.host}:{server.port}"
            what = f"no client answers at {name} within {declared.first_patience:g} s"
            if any(map(self._commands, server.peers)):
                what += "; a client that does not answer each package needs clock = 'real_time'"
            raise self._error(time, what)
        self.silent += 1
        if not self._is_silent:
            log.warning("%s: no client answers the package at %.3f s", self._model.name, time)
        self._is_silent = True

    def _check_silence(self, sensed: Sensed) -> None:
        commander, time = self._commander, sensed.time
        if commander is None:
            return
        name = self._model.name
        if commander not in self._server.peers:
            log.warning(
                "%s: the commanding client left at %.3f s; the robot holds its position", name, time
            )
            self._commander = None
            self._is_silent = False
            self._received_inputs.clear()
            self._come_to_rest()
            return
        motion = self._motion
        if self._declared.clock == "lockstep":
            is_silent = self._is_silent
        else:
            age = time - self._commanded_at
            is_silent = age > self._declared.patience and motion.mode in (SERVOS, SPEEDS, TORQUES)
            self.silent += is_silent
            if is_silent and not self._is_silent:
                log.warning(
                    "%s: no command for %.3f s at %.3f s; the robot holds its position",
                    name,
                    age,
                    time,
                )
            elif self._is_silent and not is_silent:
                log.warning("%s: commands resume at %.3f s", name, time)
            self._is_silent = is_silent
        if is_silent and motion.mode in (SPEEDS, TORQUES):
            self._come_to_rest()

    def _come_to_rest(self) -> None:
        if self._motion.mode == TORQUES:
            self._motion.hold()
        elif self._motion.mode != HOLDS:
            self._motion.stop(_DECELERATION)

    def _state_number(self) -> int:
        peers = self._server.peers
        if self._is_silent and peers:
            return SILENT
        if self._commander is not None and self._motion.mode != HOLDS:
            return COMMANDED
        if any(peer.is_started for peer in peers):
            return STARTED
        return CONNECTED if peers else NOBODY

    def _check(self, time: float) -> None:
        program = self._program
        if program is None or not program.has_ended:
            return
        if program.has_failed:
            raise self._error(time, program.why())
        log.info("%s: %s at %.3f s", self._model.name, program.why(), time)
        program.end()
        self._program = None

    def _error(self, time: float, what: str) -> SimulationError:
        self.close()
        return SimulationError(time, self._model.name, what)

    # ---- control

    def _control(self, sensed: Sensed, out: Array) -> None:
        motion = self._motion
        if motion.mode == TORQUES:
            motion.angles[:] = sensed.motor_angles
            self._model.gravity(out)
            out += motion.torques
            return
        own = self._target
        own.angles[:], own.velocities[:] = motion.angles, motion.velocities
        own.accelerations[:] = motion.accelerations
        self._holder.torques(sensed, own, out)

    def __getstate__(self) -> Any:
        raise TypeError("a controller that communicates with a program cannot be pickled")
