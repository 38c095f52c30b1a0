"""`FriRobot`: a simulated robot's side of FRI: the session with a client, and the control below it.

The thresholds of the link's quality, which KUKA has not published, are ours (`AnswerStatistics`).
"""

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
SOFTEST, STIFFEST = 0.01, 2000.0  # Nm/rad, of joints; N/m and Nm/rad at the flange
RATIOS = 0.1, 1.0
COUNTERS = 0xFFFF  # packets are told apart by as many
_DESIGNED_EVERY = 0.1  # s between two designs of the damping matrix


class FriSession(Reachable):
    """Base of the declaration of a client of FRI: what its session is like.

    Attributes:
        version: `1` of an LWR 4/4+; `iiwa-1`, `iiwa-2` and `iiwa-2.7` (1.x, 2.0 to 2.6 and from
            2.7) of an iiwa or Med, whose clients listen at port 30200 unless another is given.
        control: of the robot: `position`, `joint_impedance` or `cartesian_impedance`.
        command_mode: of clients of an iiwa: `position`, or positions with `torque` under
            `joint_impedance`, with `wrench` under `cartesian_impedance`.
        cycle: s between packets, 0.001 to 0.1; 0 for that of the simulation.
        commands_from: s, when the robot's program calls for the command state, which begins as
            soon as the link is good enough; None for never.
        stiffness: Nm/rad per joint; clients of an LWR may command another one.
        damping: ratio per joint, likewise.
    """

    version: Literal["1", "iiwa-1", "iiwa-2", "iiwa-2.7"] = "1"
    control: Literal["position", "joint_impedance", "cartesian_impedance"] = "joint_impedance"
    command_mode: Literal["position", "torque", "wrench"] = "position"
    cycle: float = Field(0.0, ge=0.0, le=0.1)
    commands_from: float | None = Field(0.2, ge=0.0)
    stiffness: Annotated[PerJoint, within(SOFTEST, STIFFEST, "Nm/rad")] = np.array([1000.0])
    damping: Ratio = np.array([0.7])


class FriRobot(Controller, ABC):
    """Sends a packet in each cycle, takes the command that answers it, and acts on it.

    Args:
        timestep: s between two steps.
        largest: bytes of a command.

    Attributes:
        logged: (3,), state and quality as FRI numbers them, and how late this step began, s.
        quality: of the link, 0 to 3.
    """

    def __init__(
        self, declared: FriSession, model: RobotModel, timestep: float, steps: int, largest: int
    ) -> None:
        self._declared, self._model, self._timestep = declared, model, timestep
        self._steps, self._step, self._counter = steps, 0, 0
        self._cycle, self._time = steps * timestep, 0.0
        self._link = Link(declared, model.name, largest)
        self._statistics = AnswerStatistics()
        self.logged: Array = np.zeros(3)
        self.state = self.quality = self.wrong = 0
        self.error = False
        self._is_new = Once()
        self._base: Array = np.zeros(JOINTS)  # commanded by the robot's program
        self._offset: Array = np.zeros(JOINTS)  # by the client
        self._extra: Array = np.zeros(JOINTS)
        self._stiffness = declared.per_joint("stiffness", JOINTS)
        self._damping = declared.per_joint("damping", JOINTS)
        self._damper: Array = np.zeros((JOINTS, JOINTS))
        self._designed, self._design_due = (b"", b""), 0  # for which gains, and until which step
        self._own = Target(JOINTS)
        self._cartesian = CartesianImpedance()
        self._holder: Any = None  # the control of positions, or of the flange
        self._base_frame: Array = np.eye(4)

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,); raises SimulationError."""
        self._step += 1
        self._model.update(sensed.motor_angles, sensed.motor_velocities)
        if self._step == 1:
            self._begin(sensed)
        if (self._step - 1) % self._steps == 0:
            self._exchange(sensed)
        self.logged[:2] = self.state, self.quality
        self._act(sensed, out)

    def close(self) -> None:
        self._link.close()
        if self.wrong:
            log.warning("%s: %d packets were no commands", self._link.name, self.wrong)
        self.wrong = 0

    @property
    def commanded_angles(self) -> Array | None:
        """What the robot's springs draw to, (n,), rad; None under Cartesian control."""
        is_cartesian = self._declared.control == "cartesian_impedance"
        return None if is_cartesian else self._base + self._offset

    # ---- what the versions of FRI do differently

    @abstractmethod
    def _follow_quality(self) -> None:
        """Changes the state where the quality of the link, or the robot's program, asks for it."""

    @abstractmethod
    def _packet(self, sensed: Sensed) -> bytes | bytearray:
        """The packet of this cycle, with `_counter`."""

    @abstractmethod
    def _read(self, packet: memoryview) -> int | None:
        """The counter of the packet that a command answers; None where it is no command."""

    @abstractmethod
    def _obey(self) -> None:
        """Does what the command that was read last asks for."""

    @abstractmethod
    def _end_command(self) -> None:
        """Sets the state that follows the command state."""

    # ---- the session

    def _begin(self, sensed: Sensed) -> None:
        self._base[:] = sensed.angles
        self._base_frame = self._model.flange()
        self._link.open(sensed.time)
        self._make_holder()

    def _exchange(self, sensed: Sensed) -> None:
        link, time, declared = self._link, sensed.time, self._declared
        self._time = time
        self.quality = self._statistics.quality
        self._follow_quality()
        packet = self._packet(sensed)
        counter = self._counter & COUNTERS
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
                    self._tell(f"no answer of {link.name} at {time:.3f} s")
        link.check(time)

    def _take(self, size: int) -> bool:
        reflected = self._read(memoryview(self._link.buffer)[:size])
        if reflected is None:
            self.wrong += 1
            return False
        self._statistics.answer(reflected & COUNTERS, self._time)
        is_last = reflected & COUNTERS == (self._counter - 1) & COUNTERS
        if is_last:
            self._link.answered = self._counter
        self._obey()
        return is_last

    def _hold_again(self, why: str) -> None:
        log.warning("%s: command ends at %.3f s: %s", self._model.name, self._time, why)
        self._base += self._offset
        self._offset[:] = self._extra[:] = 0.0
        self._own.wrench[:] = 0.0
        self._end_command()

    def _fail(self, why: str) -> None:
        self.error = True
        self._hold_again(why)

    def _tell(self, text: str) -> None:
        if self._is_new(text):
            log.warning("%s: %s", self._model.name, text)

    def _command_angles(self, angles: Array, most: Array) -> bool:
        offset = angles - self._base
        speeds = np.abs(offset - self._offset) / self._cycle
        if (speeds > most).any():
            joint = int(np.argmax(speeds / most))
            name = self._model.joint_names[joint]
            self._fail(
                f"interpolation error: {name} is commanded at {speeds[joint]:.3g} rad/s; "
                f"expected up to {most[joint]:.3g}"
            )
            return False
        self._offset[:] = offset
        return True

    # ---- control

    def _make_holder(self) -> None:
        control = self._declared.control
        if control == "position":
            self._holder = JointPosition().make(self._model, self._timestep)
        elif control == "cartesian_impedance":
            if self._holder is None:
                self._own.pose[:] = self._base_frame
            self._holder = self._cartesian.make(self._model, self._timestep)

    def _act(self, sensed: Sensed, out: Array) -> None:
        wanted = self._base + self._offset
        if self._declared.control != "joint_impedance":
            self._own.angles[:] = self._own.posture[:] = wanted
            self._own.torques[:] = 0.0
            self._holder.torques(sensed, self._own, out)
            return
        model, gains = self._model, (self._stiffness.tobytes(), self._damping.tobytes())
        if gains != self._designed or self._step >= self._design_due:
            self._damper[:] = design_damping(model.mass(), np.diag(self._stiffness), self._damping)
            self._designed = gains
            self._design_due = self._step + round(_DESIGNED_EVERY / self._timestep)
        np.subtract(wanted, sensed.motor_angles, out)
        out *= self._stiffness
        out -= self._damper @ sensed.motor_velocities
        out += model.gravity()
        out += self._extra

    def __getstate__(self) -> Any:
        raise TypeError("a controller that talks to a program is of this process")
