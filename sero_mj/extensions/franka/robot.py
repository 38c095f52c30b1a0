"""`FrankaRobot`: a simulated robot that an FCI client commands."""

from __future__ import annotations

import logging
import time as clock
from typing import Any

import numpy as np

from ...base.frames import Array
from ...simulate.control.controller import Controller, Sensed, Target
from ...simulate.control.joint_control import JointImpedance
from ...simulate.control.observer import MomentumObserver
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.program_controller import Reachable
from .link import FciLink
from .messages import (
    CARTESIAN_IMPEDANCE,
    EXTERNAL,
    IDLE,
    INVALID,
    JOINT_POSITION,
    JOINT_VELOCITY,
    MOVE,
    NO_GENERATOR,
    NOT_POSSIBLE,
    OTHER_CONTROLLER,
    REFLEX,
    SUCCESS,
    Messages,
)
from .model import urdf_of
from .motion import CYCLE, JOINTS, MAX_LOST, MAX_NUMBER, Desired, Motion, Violation
from .receiver import ERRORS
from .state import FrankaState

log = logging.getLogger(__name__)

_BANDWIDTH = 25.0  # bandwidth of the observer of external torques, 1/s (our choice)
_LOST = "communication_constraints_violation"
# Time in s after which a state is sent again in lockstep. libfranka does not answer the first state
# of a motion, and may skip other states. A client that takes longer receives a state twice.
_FIRST_REPEAT, _REPEAT = 0.02, 0.1
_MAX_STIFFNESS = 5000.0  # maximum stiffness of the internal joint impedance control, Nm/rad
_NO_LIMITS = bytes(24 + 128 + 1)  # payload of the answer that rejects GetCartesianLimit


class FrankaRobot(Controller):
    """The controller of a simulated robot that an FCI client commands.

    In each cycle of `steps` time steps, it sends a state and applies the command that answers it.
    Between motions, and during position and velocity motions, joint impedance control holds the
    robot at the desired angles. Commanded torques are added to gravity compensation.

    Attributes:
        logged: number of the robot mode in FCI, success rate of commands, age of the current
            command in s, and delay of this step in s.
        wrong: number of datagrams that are not commands or that answer a state not sent yet.
    """

    def __init__(
        self,
        declared: Reachable,
        model: RobotModel,
        timestep: float,
        steps: int,
        version: int,
        stiffness: Array,
        damping: Array,
    ) -> None:
        self._declared, self._model, self._timestep = declared, model, timestep
        self._steps, self._step, self._time = steps, 0, 0.0
        self._messages = Messages(version)
        self._link = FciLink(declared, model.name, self._messages, self)
        self._state = FrankaState(version, model, CYCLE)
        self._desired = Desired(model)
        self._observer = MomentumObserver(model, _BANDWIDTH, timestep)
        self._target = Target(JOINTS)
        self._target.has_torques = False
        self._stiffness, self._damping = stiffness, damping
        self._make_springs()
        self.logged: Array = np.zeros(4)
        self.mode = IDLE
        self.wrong = self.late = self.missed = 0
        self._motion: Motion | None = None
        self._number = self._first = 0  # ids of the newest state, and of the first in this cycle
        self._repeat_interval = _REPEAT
        self._idle_until, self._is_free = 0.0, False  # used by `_run_in_lockstep`
        self._motor_state: Array = np.zeros((2, JOINTS))
        self._torques: Array = np.zeros(JOINTS)  # torques of the last step without gravity

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._step += 1
        self._observer.update(sensed)
        if self._step == 1:
            self._begin(sensed)
        if (self._step - 1) % self._steps == 0:
            self._cycle(sensed)
        motion, desired = self._motion, self._desired
        if motion is not None and motion.is_external:
            self._model.update(sensed.motor_angles, sensed.motor_velocities)
            np.add(desired.torques, self._model.gravity(), out)
            self._torques[:] = desired.torques
        else:
            self._target.angles[:], self._target.velocities[:] = desired.angles, desired.velocities
            self._springs.torques(sensed, self._target, out)
            np.subtract(out, self._model.gravity(), self._torques)

    def close(self) -> None:
        link, name = self._link, self._model.name
        link.close()
        counts = {
            "datagrams are not commands": self.wrong,
            "commands arrived too late": self.late,
            "cycles had no command": self.missed,
            "datagrams came from other senders": link.unexpected,
        }
        for what, count in counts.items():
            if count:
                log.warning("%s: %d %s", name, count, what)
        self.wrong = self.late = self.missed = link.unexpected = 0

    @property
    def commanded_angles(self) -> Array:
        """Desired joint angles, shape (7,), rad. They are measured angles in torque control."""
        return self._desired.angles

    # ---- cycles

    def _begin(self, sensed: Sensed) -> None:
        self._time = sensed.time
        self._desired.rest_at(sensed.motor_angles, sensed.motor_velocities)
        self._desired.velocities[:] = 0.0
        self._link.open(sensed.time)
        if not self._link.wait_for_client(sensed.time):
            patience = f"within {self._declared.first_patience:g} s"
            if self._declared.clock == "lockstep":
                what = f"no client connects to {self._link.name} {patience}"
                raise self._link.error(sensed.time, what)
            log.warning("%s: no client connects %s; the robot waits", self._model.name, patience)

    def _cycle(self, sensed: Sensed) -> None:
        link, time, desired = self._link, sensed.time, self._desired
        self._time = time
        self._motor_state[0], self._motor_state[1] = sensed.motor_angles, sensed.motor_velocities
        is_paced = self._declared.clock == "real_time"
        if is_paced:
            self.logged[3] = link.wait_until(time)
        link.serve(0.0)
        if self._motion is not None and self._motion.generator == NO_GENERATOR:
            desired.angles[:], desired.velocities[:] = sensed.angles, sensed.velocities
        if link.is_connected:
            self._state.measure(sensed, self._observer.external)
            (self._run_in_real_time if is_paced else self._run_in_lockstep)(time)
        link.check(time)
        motion = self._motion
        if motion is None or not (motion.is_commanded or motion.generator == NO_GENERATOR):
            desired.brake()
        self.logged[0] = self.mode
        self.logged[1] = motion.success if motion is not None else 0.0
        self.logged[2] = time - motion.at if motion is not None and motion.is_commanded else 0.0

    def _run_in_real_time(self, time: float) -> None:
        link = self._link
        self._send()
        self._first = self._number
        if (motion := self._motion) is None:
            return
        link.receive_until(time + CYCLE, self._number, self._take)
        if self._motion is motion and link.answered != self._number:
            self._miss(motion)

    # During a motion, time stops until the next command. Between motions, it stops for `patience`,
    # so that the start of the next motion does not depend on the speed of the machine.
    def _run_in_lockstep(self, time: float) -> None:
        link = self._link
        while link.is_connected:
            self._first = self._number + 1
            motion = self._motion
            if motion is not None:
                if self._is_answered(motion, time):
                    return
            elif self._is_free:
                self._send()
                return
            else:
                self._send()
                link.serve(CYCLE)
                link.receive(self._take)
                if clock.monotonic() > self._idle_until:
                    self._is_free = True
                    log.info("%s: no motion at %.3f s; time continues", self._model.name, time)
            link.check(time)

    def _is_answered(self, motion: Motion, time: float) -> bool:
        link, declared = self._link, self._declared
        patience = declared.patience if motion.is_commanded else declared.first_patience
        now = clock.monotonic()
        deadline, next_send = now + patience, now
        interval = self._repeat_interval if motion.is_commanded else _FIRST_REPEAT
        if motion.is_commanded:
            link.share_core()
        while self._motion is motion and link.is_connected:
            if now >= next_send:
                self._send()
                next_send, interval = now + interval, self._repeat_interval
            if now > deadline:
                self._reflex(_LOST, f"no command within {patience:g} s")
                return False
            link.serve(min(next_send, deadline) - now)
            link.receive(self._take)
            if link.answered >= self._first:
                if link.answered < self._number:  # the client answers slowly
                    self._repeat_interval = min(2.0 * self._repeat_interval, declared.patience)
                return True
            link.check(time)
            now = clock.monotonic()
        return False

    def _take(self, size: int) -> None:
        command = self._messages.read_command(memoryview(self._link.buffer)[:size])
        if command is None or command.message_id > self._number:
            self.wrong += 1
            return
        motion = self._motion
        if motion is None:
            return  # the command was sent before the motion ended
        if command.message_id < self._first:
            self.late += motion.is_commanded
            return
        if self._link.answered >= self._first:
            return  # this is a second answer in the same cycle
        self._link.answered = command.message_id
        motion.at, motion.lost = self._time, 0
        motion.came.append(True)
        try:
            self._model.update(*self._motor_state)
            self._desired.command(motion, command, self._model.gravity())
        except Violation as violation:
            status = "input_error" if violation.is_input else "reflex"
            self._reflex(violation.error, violation.why, status)
            return
        motion.is_commanded = True
        if command.is_last:
            self._end("success", IDLE)

    def _miss(self, motion: Motion) -> None:
        if not motion.is_commanded:  # libfranka receives states before it commands
            if clock.monotonic() > motion.since + self._declared.first_patience:
                self._reflex(_LOST, f"no command within {self._declared.first_patience:g} s")
            return
        self.missed += 1
        motion.lost += 1
        motion.came.append(False)
        if motion.lost >= MAX_LOST:
            self._reflex(_LOST, f"{MAX_LOST} consecutive commands are missing")
        elif motion.generator in (JOINT_POSITION, JOINT_VELOCITY):
            self._desired.extrapolate()

    # ---- motions

    def _end(self, status: str, mode: int) -> None:
        motion = self._motion
        assert motion is not None
        if motion.is_external:
            self._desired.rest_at(*self._motor_state)
        self._motion, self.mode = None, mode
        self._start_idle()
        self._link.answer("Move", motion.number, self._messages.move_status(status))

    def _reflex(self, error: str, why: str, status: str = "reflex") -> None:
        name = self._model.name
        log.warning("%s: motion ends at %.3f s, %s: %s", name, self._time, error, why)
        number = ERRORS.index(error)
        for field in ("errors", "reflex_reason"):
            if number < len(self._state[field]):
                self._state[field][number] = True
        self._end(status, REFLEX)

    def _start_idle(self, patience: float | None = None) -> None:
        patience = self._declared.patience if patience is None else patience
        self._idle_until, self._is_free = clock.monotonic() + patience, False

    def _make_springs(self) -> None:
        declared = JointImpedance(stiffness=self._stiffness, damping=self._damping)
        self._springs = declared.make(self._model, self._timestep)

    # ---- the client

    def connected(self) -> None:
        log.info("%s: a client has connected at %.3f s", self._model.name, self._time)
        self._start_idle(self._declared.first_patience)

    def lost(self, why: str) -> None:
        """Called when the client has disconnected, which is an error during a motion."""
        if self._motion is not None:
            self._reflex(_LOST, f"the client {why}")
        else:
            log.info("%s: the client %s at %.3f s", self._model.name, why, self._time)

    def request(self, name: str, number: int, values: tuple[Any, ...]) -> None:
        self._idle_until = max(self._idle_until, clock.monotonic() + self._declared.patience)
        if name == "Move":
            self._start_motion(number, values)
            return
        status, more = SUCCESS, b""
        if name == "StopMove":
            self._link.answer(name, number, SUCCESS)
            if self._motion is not None:
                self._end("preempted", IDLE)
            return
        if name == "AutomaticErrorRecovery":
            if self._motion is None:
                self._state["errors"] = 0.0
                self.mode = IDLE
            else:
                status = NOT_POSSIBLE
        elif name == "GetCartesianLimit":
            status, more = NOT_POSSIBLE, _NO_LIMITS
        elif name == "LoadModelLibrary":
            status = NOT_POSSIBLE
            self._link.warn_once("there is no model library; libfranka needs server version 10")
        elif name == "GetRobotModel":
            more = urdf_of(self._model).encode()
        elif _is_wrong(name, np.array(values, float)):
            status = INVALID
        else:
            self._set(name, np.array(values, float))
        self._link.answer(name, number, status, more)

    def _set(self, name: str, values: Array) -> None:
        state = self._state
        if name == "SetJointImpedance":
            self._stiffness = np.clip(values, 0.0, _MAX_STIFFNESS)
            self._make_springs()
        elif name in ("SetEEToK", "SetNEToEE"):
            frames = ("EE_T_K",) if name == "SetEEToK" else ("NE_T_EE", "F_T_EE")  # F_T_NE = I
            for frame in frames:
                state.set_frame(frame, values.reshape(4, 4).T)
            state.place(self._observer.external)
        elif name == "SetLoad":
            state["m_load"], state["F_x_Cload"], state["I_load"] = np.split(values, [1, 4])
            if values[0]:
                self._link.warn_once("a load is reported to clients, but not compensated")
        else:  # SetCollisionBehavior, SetCartesianImpedance, SetGuidingMode, SetFilters
            self._link.warn_once(f"{name} has no effect")

    def _start_motion(self, number: int, values: tuple[Any, ...]) -> None:
        controller, generator = values[:2]
        messages, why = self._messages, ""
        has_torques = controller == EXTERNAL
        if controller > EXTERNAL or generator > NO_GENERATOR - (not messages.has_no_generator):
            status = "invalid"
        else:
            status = "not_possible"
            if self.mode == REFLEX:
                why = "the robot is in an error state; call automaticErrorRecovery first"
            elif self._motion is not None:
                why = "another motion is running"
            elif generator == NO_GENERATOR and not has_torques:
                why = "nothing is commanded"
            elif generator not in (JOINT_POSITION, JOINT_VELOCITY, NO_GENERATOR):
                why = "Cartesian motions are not supported"
            elif any(values[8:9]):
                why = "asynchronous motions are not supported"
            else:
                status = "started"
        if status != "started":
            log.warning("%s: a motion is rejected: %s", self._model.name, why or "unknown modes")
            self._link.answer("Move", number, messages.move_status(status))
            return
        if controller == CARTESIAN_IMPEDANCE:
            self._link.warn_once(
                "Cartesian impedance is not supported; joint impedance holds the robot"
            )
        self._motion = Motion(number, controller, generator, clock.monotonic())
        self.mode = MOVE
        self._state["reflex_reason"] = 0.0
        self._desired.torques[:] = self._desired.accelerations[:] = 0.0
        self._link.answer("Move", number, messages.move_status(status))

    # ---- states

    def _send(self) -> None:
        state, motion, desired = self._state, self._motion, self._desired
        self._number += 1
        state["message_id"] = self._number
        state["robot_mode"] = self.mode
        if motion is None:
            modes = 0, OTHER_CONTROLLER
            state["control_command_success_rate"], torques = 0.0, self._torques
        else:
            modes = motion.generator + 1, motion.controller
            state["control_command_success_rate"] = motion.success
            torques = desired.torques if motion.is_external else self._torques
        state["motion_generator_mode"], state["controller_mode"] = modes
        state["tau_J_d"] = torques
        state["q_d"], state["dq_d"] = desired.angles, desired.velocities
        state["ddq_d"] = desired.accelerations
        self._link.send(state.packet)

    def __getstate__(self) -> Any:
        raise TypeError("a controller that communicates with a program cannot be pickled")


def _is_wrong(name: str, values: Array) -> bool:
    if not (np.abs(values) < MAX_NUMBER).all():  # also NaN
        return True
    if name in ("SetEEToK", "SetNEToEE"):
        pose = values.reshape(4, 4).T
        rotation = pose[:3, :3]
        is_rotation = (
            np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
            and np.linalg.det(rotation) > 0.0
        )
        return not (is_rotation and np.allclose(pose[3], [0.0, 0.0, 0.0, 1.0]))
    first = {"SetJointImpedance": 7, "SetCartesianImpedance": 6, "SetLoad": 1}.get(name, 0)
    return bool((values[:first] < 0.0).any())
