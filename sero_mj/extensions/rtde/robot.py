"""`RtdeRobot`: a simulated robot's side of RTDE: its clients' commands, and the control below them.

With `interface = "ur_rtde"` the registers mean what they mean to the script that the library
ur_rtde (SDU Robotics) uploads: input_int_register_0 is a command, input_double_register_0 and the
following ones its numbers, and output_int_register_0 tells that the robot is ready (1) or done (2).
Registers from 24 on are used where the client is told to use the upper range. The script itself is
never run.
"""

from __future__ import annotations

import logging
import re
import time as clock
from collections.abc import Callable
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ...base.errors import SimulationError
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
from .server import RtdePeer, RtdeServer
from .state import JOINTS, RtdeState
from .variables import INPUT_DOUBLE, INPUT_INT, OUTPUT_INT, REGISTERS

log = logging.getLogger(__name__)

DASHBOARD, SCRIPT = 29999, 30003  # ports that ur_rtde connects to as well
# States, as they are logged.
NOBODY, CONNECTED, STARTED, COMMANDED, SILENT = 0, 1, 2, 3, 4
READY, DONE = 1, 2  # of ur_rtde's output register
_CLEAR, _STOP = 0, 255
_MOVE_J, _SPEED_J, _SERVO_J, _TORQUE = 1, 9, 11, 66
_ZERO_SENSOR, _TEACH, _END_TEACH = 8, 18, 19
_STOPS = 15, 16, 34  # speedStop, servoStop, stopJ
_OFFSETS = 0, 24  # of registers: the lower and the upper range
_SLICE = 0.02  # s, in which an interrupt and the end of the program are seen
_DECELERATION = 4.0  # rad/s^2, of a robot whose client is silent
_NUMBER = re.compile(r"[-+]?\d[\d.e:+-]*")


class RtdeSession(Reachable):
    """Base of the declaration of a client of RTDE: what its session is like.

    Attributes:
        host: address that the robot listens on; 0.0.0.0 for all of this machine.
        port: of RTDE.
        interface: how the client commands: `ur_rtde`, by the registers that this library and the
            script that it uploads exchange; `position` or `torque`, by six input registers.
        first_register: of `position` and `torque`, k: input_double_register_k to k + 5 are joint
            angles, rad, or torques on top of gravity's, Nm.
        dashboard_port: of a dashboard server, which `ur_rtde` connects to; 0 for none.
        script_port: that URScript is sent to, and which throws it away; 0 for none.
        cycle: s, shortest time between packages; 0.002 as an e-Series has it, or 0.008 of a CB3.
        stiffness: Nm/rad per joint, of the robot's position control.
        damping: ratio per joint, likewise.
        torque_constants: Nm/A per joint, by which torques are told as currents; without them
            currents are 0.
        patience: s; a client that has not commanded for longer is silent, and the robot holds.
    """

    clock: Literal["lockstep", "real_time"] = "real_time"
    interface: Literal["ur_rtde", "position", "torque"] = "ur_rtde"
    first_register: int = Field(0, ge=0, le=REGISTERS - JOINTS)
    dashboard_port: int = Field(DASHBOARD, ge=0, le=65535)
    script_port: int = Field(SCRIPT, ge=0, le=65535)
    cycle: float = Field(0.002, gt=0.0, le=0.1)
    stiffness: Annotated[PerJoint, within(1.0, 1e6, "Nm/rad")] = np.array([10000.0])
    damping: Ratio = np.ones(1)
    torque_constants: MaybePerJoint = None


class RtdeRobot(Controller):
    """Serves clients in each cycle, takes their commands, and acts on them.

    Args:
        timestep: s between two steps.

    Attributes:
        logged: (3,), the state (`NOBODY` to `SILENT`), the age of the last command, s, and how late
            this step began, s.
    """

    def __init__(
        self, declared: RtdeSession, model: RobotModel, timestep: float, steps: int
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
        self._own = Target(JOINTS)
        first = declared.first_register
        self._plain = [f"{INPUT_DOUBLE}{first + k}" for k in range(JOINTS)]
        self._given: set[str] = set()  # of these, by the client that commands
        self.logged: Array = np.zeros(3)
        self.wrong = self.silent = 0
        self._is_new = Once()
        self._commander: RtdePeer | None = None  # whose command was taken last
        self._commanded_at = 0.0
        self._is_silent = self._has_answered = False
        self._told_when_still = ""  # register that tells that a motion is done
        self._began = self._given_up = 0.0
        self._out: Array = np.zeros(JOINTS)
        has_script = declared.interface == "ur_rtde" and declared.script_port
        self._state.is_running = not has_script

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,); raises SimulationError."""
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
        if self._told_when_still and self._motion.mode == HOLDS:
            self._state.registers[self._told_when_still] = DONE
            self._told_when_still = ""
        self.logged[1] = sensed.time - self._commanded_at
        self._act(sensed, out)
        self._out[:] = out

    def close(self) -> None:
        """Ends connections and the program; harmless when that is done."""
        skipped = sum(peer.skipped for peer in self._server.peers)
        if self.wrong or self.silent or skipped:
            log.warning(
                "%s: %d messages or commands were not taken, %d cycles had no command, "
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
        """Where the robot is commanded to, (n,), rad."""
        return self._motion.angles

    # ---- the desk of the server

    @property
    def is_running(self) -> bool:
        return self._state.is_running

    def value(self, name: str) -> Any:
        """The value of an output now: a number, or those of a vector."""
        return self._state.value(name)

    def count_wrong(self, why: str) -> None:
        """Counts what was not taken, and tells it, but for its numbers once."""
        self.wrong += 1
        kind = _NUMBER.sub("#", why)
        if self._is_new(kind):
            log.warning("%s: not taken at %.3f s: %s", self._model.name, self._time, why)

    def take_script(self, text: bytes) -> None:
        """Gets a script, which is not run; that of ur_rtde is what this robot does anyway."""
        if b"rtde_control" in text:
            self._state.is_running = True
            for offset in _OFFSETS:
                self._state.registers[f"{OUTPUT_INT}{offset}"] = READY
        else:
            self._server.tell(f"a script of {len(text)} bytes is not run: there is no URScript")

    def stop_program(self) -> None:
        """Ends what stands for the robot's program; the robot comes to rest."""
        if self._declared.script_port:
            self._state.is_running = False
        self._commander = None
        self._come_to_rest()

    def take(self, peer: RtdePeer, values: dict[str, Any]) -> bool:
        """Takes inputs; whether they answer the last package."""
        self._state.take(values)
        if values.get("speed_slider_mask"):
            self._server.tell("the speed slider has no effect")
        if self._declared.interface == "ur_rtde":
            return self._take_command(peer, values)
        if not self._commands(peer):
            return False
        self._given |= values.keys()
        if not values.keys().isdisjoint(self._plain) and self._given.issuperset(self._plain):
            numbers = np.array([self._state.registers[name] for name in self._plain])
            if self._declared.interface == "torque":
                self._motion.act(numbers)
                self._note(peer)
            else:
                self._servo(peer, numbers)
        return True

    def _commands(self, peer: RtdePeer) -> bool:
        if self._declared.interface == "ur_rtde":
            return any(f"{INPUT_INT}{offset}" in peer.claimed for offset in _OFFSETS)
        return not peer.claimed.isdisjoint(self._plain)

    def _take_command(self, peer: RtdePeer, values: dict[str, Any]) -> bool:
        offset = next((k for k in _OFFSETS if f"{INPUT_INT}{k}" in values), None)
        if offset is None:
            return False
        command = values[f"{INPUT_INT}{offset}"]
        state = f"{OUTPUT_INT}{offset}"
        if command == _CLEAR:
            self._state.registers[state] = READY
            return False  # it follows each command
        if command == _STOP:
            self.stop_program()
            return True
        if not self._state.is_running:
            self.count_wrong(f"command {command} while no program runs")
            return True
        registers = self._state.registers

        def numbers(first: int, count: int) -> Array:
            keys = (f"{INPUT_DOUBLE}{offset + first + k}" for k in range(count))
            return np.array([registers.get(key, 0.0) for key in keys])

        if command == _SERVO_J:
            self._servo(peer, numbers(0, JOINTS))
        elif command == _SPEED_J:
            speed = self._motion.speed(numbers(0, JOINTS), float(numbers(JOINTS, 1)[0]))
            self._obey(peer, speed)
        elif command == _TORQUE:
            self._motion.act(numbers(0, JOINTS))
            self._note(peer)
        else:
            self._do_and_tell(peer, command, state, numbers, values.get(f"{INPUT_INT}{offset + 1}"))
        return True

    def _do_and_tell(
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
            why = motion.move(numbers(0, JOINTS), speed, acceleration, self._time)
            self._obey(peer, why)
            if not why and not flag:  # else it is asynchronous
                self._state.registers[state] = 0
                self._told_when_still = state
        elif command in _STOPS:
            motion.stop(float(numbers(0, 1)[0]))
            self._commander = None
            self._state.registers[state] = 0
            self._told_when_still = state
        elif command == _TEACH:
            motion.act(np.zeros(JOINTS))
        elif command == _END_TEACH:
            self._come_to_rest()
        elif command != _ZERO_SENSOR:
            # ur_rtde sees that no program runs, and returns false.
            what = f"command {command} of ur_rtde is not there; its program ends"
            self._state.registers[state] = 0
            self.count_wrong(what)
            peer.say(what)
            self.stop_program()

    def _servo(self, peer: RtdePeer, angles: Array) -> None:
        self._obey(peer, self._motion.servo(angles, self._time, self._cycle))

    def _obey(self, peer: RtdePeer, why_not: str) -> None:
        if why_not:
            self.count_wrong(why_not)
        else:
            self._note(peer)

    def _note(self, peer: RtdePeer) -> None:
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
        self._mind_silence(sensed)
        self.logged[0] = self._state_number()

    def _wait_for_answers(self, cycle: int, time: float) -> None:
        server, declared = self._server, self._declared
        if self._program is not None and self._has_answered and declared.same_core:
            self._program.come_beside()
        asked = {peer for peer in server.peers if peer.is_ready}
        patience = _SLICE if self._is_silent else declared.patience
        deadline = clock.monotonic() + patience
        while True:
            commanding = [peer for peer in server.peers if peer.is_started and self._commands(peer)]
            for peer in commanding:
                if peer not in asked and peer.is_ready:  # it has come while this was waiting
                    asked.add(peer)
                    if peer.is_due(cycle):
                        server.send_to(peer)
            if commanding and all(peer in asked and not peer.is_awaited for peer in commanding):
                self._has_answered = True
                if self._is_silent:
                    log.warning("%s: a client answers again at %.3f s", self._model.name, time)
                self._is_silent = False
                return
            is_alone = self._program is None and bool(declared.command)
            until = deadline if self._has_answered else self._given_up
            if self._has_answered and is_alone and not server.peers:  # nobody will come
                return
            if clock.monotonic() > until:
                break
            server.serve(min(_SLICE, max(until - clock.monotonic(), 0.0)))
            self._check(time)
        if not self._has_answered:
            name = f"{declared.host}:{server.port}"
            what = f"no client answers at {name} within {declared.first_patience:g} s"
            if any(map(self._commands, server.peers)):
                what += "; one that does not answer each package needs clock = 'real_time'"
            raise self._error(time, what)
        self.silent += 1
        if not self._is_silent:
            log.warning("%s: no answer to the package of %.3f s", self._model.name, time)
        self._is_silent = True

    def _mind_silence(self, sensed: Sensed) -> None:
        commander, time = self._commander, sensed.time
        if commander is None:
            return
        name = self._model.name
        if commander not in self._server.peers:
            log.warning("%s: nobody commands at %.3f s; it holds", name, time)
            self._commander = None
            self._is_silent = False
            self._given.clear()
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
                log.warning("%s: no command for %.3f s at %.3f s; it holds", name, age, time)
            elif self._is_silent and not is_silent:
                log.warning("%s: commands come again at %.3f s", name, time)
            self._is_silent = is_silent
        if is_silent and motion.mode in (SPEEDS, TORQUES):
            self._come_to_rest()

    def _come_to_rest(self) -> None:
        if self._motion.mode == TORQUES:
            self._motion.hold()  # they are carried along
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

    def _act(self, sensed: Sensed, out: Array) -> None:
        motion = self._motion
        if motion.mode == TORQUES:
            motion.angles[:] = sensed.motor_angles
            self._model.gravity(out)
            out += motion.torques
            return
        own = self._own
        own.angles[:], own.velocities[:] = motion.angles, motion.velocities
        own.accelerations[:] = motion.accelerations
        self._holder.torques(sensed, own, out)

    def __getstate__(self) -> Any:
        raise TypeError("a controller that talks to a program is of this process")
