"""Base class of simulated robots on FRI, with the session of a client and the joint control."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ...base.frames import Array
from ...base.once import Once
from ...simulate.control.cartesian_control import CartesianImpedance
from ...simulate.control.controller import Controller, PerJoint, Ratio, Sensed, Target, within
from ...simulate.control.joint_control import JointPosition, design_damping
from ...simulate.control.robot_model import RobotModel
from ...simulate.external_control.program_controller import Link, Reachable
from .controller import AnswerStatistics

log = logging.getLogger(__name__)

JOINTS = 7
MIN_STIFFNESS, MAX_STIFFNESS = 0.01, 2000.0  # Nm/rad of joints
COUNTER_MASK = 0xFFFF  # packets are distinguished by the lower 16 bits of their counter
_DAMPING_INTERVAL = 0.1  # s between two computations of the damping matrix


class FriSession(Reachable):
    """Fields of `FriClient` that the simulated robot uses.

    Attributes:
        version: FRI version: `1` for an LWR 4/4+; `iiwa-1`, `iiwa-2` or `iiwa-2.7` (1.x, 2.0 to
            2.6, 2.7 and later) for an iiwa or Med. For the latter, the default port is 30200.
        control: control mode of the robot.
        command_mode: quantity that a client of an iiwa commands: `position`; `torque` in addition
            to positions (with `joint_impedance`); or `wrench` in addition to positions (with
            `cartesian_impedance`).
        cycle: time between packets from 0.001 to 0.1 s; 0 for the time step of the simulation.
        commands_from: time in s from which the robot's program requests the command state, which
            begins as soon as the connection quality is sufficient; None for never.
        stiffness: joint stiffness in Nm/rad, which clients of an LWR can change.
        damping: damping ratio per joint, which clients of an LWR can change.
    """

    version: Literal["1", "iiwa-1", "iiwa-2", "iiwa-2.7"] = "1"
    control: Literal["position", "joint_impedance", "cartesian_impedance"] = "joint_impedance"
    command_mode: Literal["position", "torque", "wrench"] = "position"
    cycle: float = Field(0.0, ge=0.0, le=0.1)
    commands_from: float | None = Field(0.2, ge=0.0)
    stiffness: Annotated[PerJoint, within(MIN_STIFFNESS, MAX_STIFFNESS, "Nm/rad")] = np.array(
        [1000.0]
    )
    damping: Ratio = np.array([0.7])


class FriRobot(Controller, ABC):
    """Sends a packet every `steps` time steps, and applies the command in the client's answer.

    Attributes:
        logged: FRI numbers of state and quality, and the delay of this step in seconds.
        quality: connection quality from 0 to 3. The thresholds are ours, see `AnswerStatistics`.
        wrong: number of received packets that are not commands.
    """

    def __init__(
        self,
        declared: FriSession,
        model: RobotModel,
        timestep: float,
        steps: int,
        max_command_bytes: int,
    ) -> None:
        self._declared, self._model, self._timestep = declared, model, timestep
        self._steps, self._step, self._counter = steps, 0, 0
        self._cycle, self._time = steps * timestep, 0.0
        self._link = Link(declared, model.name, max_command_bytes)
        self._statistics = AnswerStatistics()
        self.logged: Array = np.zeros(3)
        self.state = self.quality = self.wrong = 0
        self.error = False
        self._is_new = Once()
        self._base: Array = np.zeros(JOINTS)  # angles commanded by the robot's program
        self._offset: Array = np.zeros(JOINTS)  # angles added by the client
        self._extra_torques: Array = np.zeros(JOINTS)
        self._stiffness = declared.per_joint("stiffness", JOINTS)
        self._damping = declared.per_joint("damping", JOINTS)
        self._damping_matrix: Array = np.zeros((JOINTS, JOINTS))
        self._designed_gains, self._design_due = (b"", b""), 0  # step of the next computation
        self._target = Target(JOINTS)
        self._cartesian = CartesianImpedance()
        self._inner: Any = None  # joint position or Cartesian impedance controller
        self._base_frame: Array = np.eye(4)

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._step += 1
        self._model.update(sensed.motor_angles, sensed.motor_velocities)
        if self._step == 1:
            self._begin(sensed)
        if (self._step - 1) % self._steps == 0:
            self._exchange(sensed)
        self.logged[:2] = self.state, self.quality
        self._control(sensed, out)

    def close(self) -> None:
        self._link.close()
        if self.wrong:
            log.warning("%s: %d received packets are not commands", self._link.name, self.wrong)
        self.wrong = 0

    @property
    def commanded_angles(self) -> Array | None:
        is_cartesian = self._declared.control == "cartesian_impedance"
        return None if is_cartesian else self._base + self._offset

    # ---- differences between the versions of FRI

    @abstractmethod
    def _update_state(self) -> None: ...

    @abstractmethod
    def _encode(self, sensed: Sensed) -> bytes | bytearray: ...

    # Returns the counter of the packet that a command answers, or None if it is not a command.
    @abstractmethod
    def _decode(self, packet: memoryview) -> int | None: ...

    # Applies the command that was decoded last.
    @abstractmethod
    def _apply_command(self) -> None: ...

    # Sets the state that follows the command state.
    @abstractmethod
    def _set_monitor_state(self) -> None: ...

    # ---- the session

    def _begin(self, sensed: Sensed) -> None:
        self._base[:] = sensed.angles
        self._base_frame = self._model.flange()
        self._link.open(sensed.time)
        self._make_inner()

    def _exchange(self, sensed: Sensed) -> None:
        link, time, declared = self._link, sensed.time, self._declared
        self._time = time
        self.quality = self._statistics.quality
        self._update_state()
        packet = self._encode(sensed)
        counter = self._counter & COUNTER_MASK
        self._counter += 1
        if declared.clock == "real_time":
            self.logged[2] = link.wait_until(time)
            link.receive(self._take)
            link.send(packet)
            if not link.answered:
                link.wait_for_first(packet, time, self._take)
            self._statistics.send(counter, time)
            link.receive_until(time + self._cycle, self._counter, self._take)
        else:
            self._statistics.send(counter, time)
            if link.is_silent:
                link.send(packet)
                link.receive(self._take)
                link.is_silent = link.answered != self._counter
            elif not link.ask(packet, self._counter, time, self._take, declared.patience):
                if link.is_given_up:
                    what = f"no client answers at {link.name} within {declared.first_patience:g} s"
                    raise link.error(time, what + link.why_silent)
                if link.answered:
                    link.is_silent = True
                    self._warn_once(f"no answer from {link.name} at {time:.3f} s")
        link.check(time)

    def _take(self, size: int) -> bool:
        reflected = self._decode(memoryview(self._link.buffer)[:size])
        if reflected is None:
            self.wrong += 1
            return False
        self._statistics.answer(reflected & COUNTER_MASK, self._time)
        is_newest = reflected & COUNTER_MASK == (self._counter - 1) & COUNTER_MASK
        if is_newest:
            self._link.answered = self._counter
        self._apply_command()
        return is_newest

    def _end_command(self, why: str) -> None:
        log.warning("%s: command state ends at %.3f s: %s", self._model.name, self._time, why)
        self._base += self._offset
        self._offset[:] = self._extra_torques[:] = 0.0
        self._target.wrench[:] = 0.0
        self._set_monitor_state()

    def _fail(self, why: str) -> None:
        self.error = True
        self._end_command(why)

    def _warn_once(self, text: str) -> None:
        if self._is_new(text):
            log.warning("%s: %s", self._model.name, text)

    def _command_angles(self, angles: Array, max_speeds: Array) -> bool:
        offset = angles - self._base
        speeds = np.abs(offset - self._offset) / self._cycle
        if (speeds > max_speeds).any():
            joint = int(np.argmax(speeds / max_speeds))
            name = self._model.joint_names[joint]
            self._fail(
                f"interpolation error: {name} is commanded at {speeds[joint]:.3g} rad/s; "
                f"expected up to {max_speeds[joint]:.3g}"
            )
            return False
        self._offset[:] = offset
        return True

    # ---- control

    def _make_inner(self) -> None:
        control = self._declared.control
        if control == "position":
            self._inner = JointPosition().make(self._model, self._timestep)
        elif control == "cartesian_impedance":
            if self._inner is None:
                self._target.pose[:] = self._base_frame
            self._inner = self._cartesian.make(self._model, self._timestep)

    def _control(self, sensed: Sensed, out: Array) -> None:
        desired = self._base + self._offset
        if self._declared.control != "joint_impedance":
            self._target.angles[:] = self._target.posture[:] = desired
            self._target.torques[:] = 0.0
            self._inner.torques(sensed, self._target, out)
            return
        model, gains = self._model, (self._stiffness.tobytes(), self._damping.tobytes())
        if gains != self._designed_gains or self._step >= self._design_due:
            self._damping_matrix[:] = design_damping(
                model.mass(), np.diag(self._stiffness), self._damping
            )
            self._designed_gains = gains
            self._design_due = self._step + round(_DAMPING_INTERVAL / self._timestep)
        out[:] = (
            self._stiffness * (desired - sensed.motor_angles)
            - self._damping_matrix @ sensed.motor_velocities
            + model.gravity()
            + self._extra_torques
        )

    def __getstate__(self) -> Any:
        raise TypeError("a controller that communicates with a program cannot be pickled")
