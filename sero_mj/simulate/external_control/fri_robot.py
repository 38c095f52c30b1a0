"""`kind = "fri"`: a client of KUKA's Fast Research Interface (FRI 1.0) holds the simulated LWR.

The simulated controller sends measurements and takes commands as the robot's own does: monitor and
command state, quality of the link, flags of commands, limits, and the way back to monitor. The
thresholds of quality, which are not public, are ours (`AnswerStatistics`).
"""

from __future__ import annotations

import logging
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ...base.errors import Problem
from ...base.frames import Array, inverse
from ...data.receive.fri import ALL_DRIVES, COMMAND, CYCLES, MEASUREMENT, PORT, QUALITIES
from ...data.receive.structure import Structure
from ...data.send.fri_controller import AnswerStatistics
from ..control.cartesian_control import CartesianImpedance
from ..control.controller import PerJoint, Ratio, Sensed, Target, within
from ..control.joint_control import JointPosition, design_damping
from ..control.robot_model import RobotModel
from .datagrams import Link, Reachable

log = logging.getLogger(__name__)

JOINTS = 7
MONITOR, COMMANDED = 1, 2
_UNACCEPTABLE, _OK = 0, 2
# Flags of a command, and those that act under each control of the robot.
ANGLES, TORQUES, STIFFNESS, DAMPING = 0x1, 0x4, 0x10, 0x20
FRAME, WRENCH, CARTESIAN_STIFFNESS, CARTESIAN_DAMPING = 0x100, 0x400, 0x1000, 0x2000
CONTROLS = {"position": 1, "cartesian_impedance": 2, "joint_impedance": 3}
_ACTS = {
    "position": ANGLES,
    "joint_impedance": ANGLES | TORQUES | STIFFNESS | DAMPING,
    "cartesian_impedance": ANGLES | FRAME | WRENCH | CARTESIAN_STIFFNESS | CARTESIAN_DAMPING,
}
_OF_FLAGS = {
    ANGLES: "joint_angles",
    TORQUES: "joint_torques",
    STIFFNESS: "joint_stiffness",
    DAMPING: "joint_damping",
    FRAME: "tcp_frame",
    WRENCH: "tcp_wrench",
    CARTESIAN_STIFFNESS: "cartesian_stiffness",
    CARTESIAN_DAMPING: "cartesian_damping",
}
# rad/s, of the axes of the LWR 4+; a command may not ask for more.
MOST_SPEED = np.deg2rad([110.0, 110.0, 128.0, 128.0, 204.0, 184.0, 184.0])
_SOFTEST, _STIFFEST = 0.01, 2000.0  # Nm/rad, of joints; N/m and Nm/rad at the flange
_RATIOS = 0.1, 1.0
_DESIGNED_EVERY = 0.1  # s between two designs of the damping matrix
_REFRESHED = 10  # packets between two computations of the averages over 100
_ERROR = 1
_REVERSED = [0, 1, 2, 5, 4, 3]  # FRI has moments about z, y, x


class FriClient(Reachable):
    """A client of FRI 1.0; the simulated robot is an LWR, or another one of seven joints.

    Attributes:
        control: of the robot: `position`, `joint_impedance` or `cartesian_impedance`.
        cycle: s between packets, 0.001 to 0.1; 0 for that of the simulation.
        commands_from: s, when the robot's program calls for the command state, which begins as
            soon as the link is good enough; None for never.
        stiffness: Nm/rad per joint, until the client commands another one.
        damping: ratio per joint, likewise.
    """

    logged: ClassVar[tuple[str, ...]] = ("fri_state", "fri_quality", "step_lateness")
    title: ClassVar[str] = "client of FRI"
    order: ClassVar[int] = 75

    kind: Literal["fri"] = "fri"
    port: int = Field(PORT, ge=0, le=65535)
    control: Literal["position", "joint_impedance", "cartesian_impedance"] = "joint_impedance"
    cycle: float = Field(0.0, ge=0.0, le=CYCLES[1])
    commands_from: float | None = Field(0.2, ge=0.0)
    stiffness: Annotated[PerJoint, within(_SOFTEST, _STIFFEST, "Nm/rad")] = np.array([1000.0])
    damping: Ratio = np.array([0.7])

    @model_validator(mode="after")
    def _cycle_is_possible(self) -> Self:
        if 0.0 < self.cycle < CYCLES[0]:
            raise Problem(
                "cycle", found=self.cycle, expected=f"{CYCLES[0]} to {CYCLES[1]} s"
            ).error()
        return self

    def make(self, model: RobotModel, timestep: float) -> FriRobot:
        """The controller; the program is started with its first step."""
        if model.n != JOINTS:
            found = f"FRI is for {JOINTS} joints"
            raise Problem("kind", found, found=model.n, expected="a robot with as many").error()
        steps = round((self.cycle or timestep) / timestep)
        if steps < 1 or abs(steps * timestep - (self.cycle or timestep)) > 1e-9:
            expected = f"a multiple of the time step, {timestep:g} s"
            raise Problem("cycle", found=self.cycle, expected=expected).error()
        if steps * timestep < CYCLES[0] - 1e-9:
            expected = f"{CYCLES[0]} s or more: the time step is {timestep:g} s"
            raise Problem("cycle", found=self.cycle, expected=expected).error()
        return FriRobot(self, model, timestep, steps)


class FriRobot:
    """The robot's side of FRI: measurements out, commands in, and the control that they act on.

    Args:
        declared: how.
        model: of the robot, for itself.
        timestep: s between two steps.
        steps: of the simulation in a cycle.

    Attributes:
        logged: (3,), state and quality as FRI numbers them, and how late this step began, s.
        state: `MONITOR` or `COMMANDED`.
        error: whether a command has ended the command state.
        wrong: received packets that are no commands.
    """

    def __init__(self, declared: FriClient, model: RobotModel, timestep: float, steps: int) -> None:
        self._declared, self._model, self._timestep = declared, model, timestep
        self._steps, self._step, self._counter = steps, 0, 0
        self._cycle = steps * timestep
        self._layout = Structure(MEASUREMENT, is_double=False, column_major=False)
        self._packet = bytearray(self._layout.encode({}))
        self._views = {
            name: _view(self._packet, self._layout, name) for name in self._layout.events
        }
        self._commands = Structure(COMMAND)
        self._command = bytearray(self._commands.size)
        self._asked = {name: _view(self._command, self._commands, name)
                       for name in self._commands.events}  # fmt: skip
        self._expected = bytes(self._commands.encode({}))[4:8]  # size and id of a command
        self._link = Link(declared, model.name, self._commands.size)
        self._statistics = AnswerStatistics()
        self.logged: Array = np.zeros(3)
        self.state, self.error, self.wrong = MONITOR, False, 0
        self._told: set[str] = set()
        self._base: Array = np.zeros(JOINTS)  # commanded by the robot's program
        self._offset: Array = np.zeros(JOINTS)  # by the client
        self._extra: Array = np.zeros(JOINTS)
        self._stiffness = declared.per_joint("stiffness", JOINTS)
        self._damping = declared.per_joint("damping", JOINTS)
        self._damper: Array = np.zeros((JOINTS, JOINTS))
        self._designed, self._design_due = (b"", b""), 0  # for which gains, and until which step
        self._quality = _UNACCEPTABLE
        self._own = Target(JOINTS)
        self._cartesian = CartesianImpedance()
        self._holder: Any = None  # the control of positions, or of the flange
        self._base_frame: Array = np.eye(4)
        for name, value in (("packet_size", 0), ("power", ALL_DRIVES), ("safety_limits", 1.0),
                            ("measurement_cycle", self._cycle), ("command_cycle", self._cycle),
                            ("control", CONTROLS[declared.control])):  # fmt: skip
            if name in self._views and value:
                self._views[name][:] = value

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,).

        Raises:
            SimulationError: the program has ended, or no client has ever answered.
        """
        self._step += 1
        self._model.update(sensed.motor_angles, sensed.motor_velocities)
        if self._step == 1:
            self._begin(sensed)
        if (self._step - 1) % self._steps == 0:
            self._exchange(sensed)
        self.logged[:2] = self.state, self._quality
        self._act(sensed, out)

    def close(self) -> None:
        """Ends the program; harmless when it has ended."""
        self._link.close()
        if self.wrong:
            log.warning("%s: %d packets were no commands", self._link.name, self.wrong)
        self.wrong = 0

    # ---- the session

    def _begin(self, sensed: Sensed) -> None:
        self._base[:] = sensed.angles
        self._base_frame = self._model.flange()
        self._link.open(sensed.time)
        self._make_holder()

    def _exchange(self, sensed: Sensed) -> None:
        """Sends a measurement, and takes the command that answers it."""
        link, time, declared = self._link, sensed.time, self._declared
        self._change_state(time)
        self._measure(sensed)
        counter = self._counter & 0xFFFF
        self._counter += 1
        if declared.clock == "real_time":
            self.logged[2] = link.wait_until(time)
            link.receive(self._take)
            link.send(self._packet)
            if not link.answered:
                link.wait_for_first(self._packet, time, self._take)
            self._statistics.send(counter, time)
            link.receive_until(time + self._cycle, self._counter, self._take)
        else:
            self._statistics.send(counter, time)
            self._now = time
            if link.is_silent:
                link.send(self._packet)
                link.receive(self._take)
                link.is_silent = link.answered != self._counter
            elif not link.ask(self._packet, self._counter, time, self._take, declared.patience):
                if link.is_given_up:
                    what = f"no client answers at {link.name} within {declared.first_patience:g} s"
                    raise link.error(time, what)
                if link.answered:
                    link.is_silent = True
                    self._tell(f"no answer of {link.name} at {time:.3f} s")
        link.check(time)

    _now = 0.0

    def _take(self, size: int) -> bool:
        """Takes what is in the buffer if it is a command; whether it answers the last packet."""
        packet = self._link.buffer
        if size != len(self._command) or packet[4:8] != self._expected:
            self.wrong += 1
            return False
        self._command[:] = packet[:size]
        asked = self._asked
        reflected = int(asked["reflected_counter"][0])
        self._views["reflected_counter"][0] = asked["send_counter"][0]
        self._statistics.answer(reflected, self._now)
        is_last = reflected == (self._counter - 1) & 0xFFFF
        if is_last:
            self._link.answered = self._counter
        if self.state == COMMANDED:
            self._obey(int(asked["command_flags"][0]))
        return is_last

    def _change_state(self, time: float) -> None:
        quality, begins = self._statistics.quality, self._declared.commands_from
        self._quality = quality
        if self.state == COMMANDED and quality == _UNACCEPTABLE:
            self._to_monitor(f"quality {QUALITIES[quality]}", time)
        elif (
            self.state == MONITOR
            and begins is not None
            and time >= begins
            and quality >= _OK
            and not self.error
        ):
            self.state = COMMANDED
            log.info(
                "%s: command at %.3f s, quality %s", self._model.name, time, QUALITIES[quality]
            )

    def _to_monitor(self, why: str, time: float) -> None:
        """Ends the command state; the robot stays where it is commanded to."""
        log.warning("%s: command -> monitor at %.3f s: %s", self._model.name, time, why)
        self.state = MONITOR
        self._base += self._offset
        self._offset[:] = self._extra[:] = 0.0
        self._own.wrench[:] = 0.0

    def _fail(self, why: str) -> None:
        self.error = True
        self._views["error"][0] = _ERROR
        self._to_monitor(why, self._now)

    def _tell(self, text: str) -> None:
        if text not in self._told:
            self._told.add(text)
            log.warning("%s: %s", self._model.name, text)

    def _measure(self, sensed: Sensed) -> None:
        """Writes the measurement packet."""
        views, model = self._views, self._model
        self._now = sensed.time
        views["send_counter"][0] = self._counter & 0xFFFF
        views["timestamp"][0] = sensed.time
        views["state"][0], views["quality"][0] = self.state, self._quality
        if self._counter % _REFRESHED == 0:
            for name, value in self._statistics.values().items():
                views[name][0] = value
        views["joint_angles"][:] = sensed.angles
        views["torques"][:] = sensed.torques
        views["commanded_before_fri"][:] = self._base
        views["commanded_offset"][:] = self._offset
        back = inverse(model.base())
        views["flange_frame"][:] = (back @ model.flange())[:3].ravel()
        views["commanded_frame"][:] = (back @ self._base_frame)[:3].ravel()
        jacobian = model.jacobian()
        views["jacobian"][:42] = np.vstack(
            [back[:3, :3] @ jacobian[:3], (back[:3, :3] @ jacobian[3:])[::-1]]
        ).ravel()
        views["mass_matrix"][:] = model.mass().ravel()
        views["gravity_torques"][:] = model.gravity()

    # ---- commands

    def _obey(self, flags: int) -> None:
        """Takes what a command asks for."""
        acts = _ACTS[self._declared.control]
        if flags & ~acts:
            self._tell(
                f"flags {flags & ~acts:#x} of commands have no effect in {self._declared.control}"
            )
        asked = self._asked
        for flag, name in _OF_FLAGS.items():
            if flags & flag & acts and not np.isfinite(asked[name]).all():
                self._fail(f"{name} of a command is not finite")
                return
        if flags & ANGLES:
            offset = asked["joint_angles"] - self._base
            speeds = np.abs(offset - self._offset) / self._cycle
            if (speeds > MOST_SPEED).any():
                joint = int(np.argmax(speeds / MOST_SPEED))
                name = self._model.joint_names[joint]
                self._fail(
                    f"interpolation error: {name} is commanded at {speeds[joint]:.3g} rad/s; "
                    f"expected up to {MOST_SPEED[joint]:.3g}"
                )
                return
            self._offset[:] = offset
        flags &= acts
        if self._declared.control == "joint_impedance":
            if flags & STIFFNESS:
                self._stiffness = np.clip(asked["joint_stiffness"], _SOFTEST, _STIFFEST)
            if flags & DAMPING:
                self._damping = np.clip(asked["joint_damping"], *_RATIOS)
            self._extra[:] = asked["joint_torques"] if flags & TORQUES else 0.0
        elif self._declared.control == "cartesian_impedance":
            self._obey_at_flange(flags)

    def _obey_at_flange(self, flags: int) -> None:
        asked, base = self._asked, self._model.base()
        if flags & FRAME:
            wanted = np.eye(4)
            wanted[:3] = np.reshape(asked["tcp_frame"], (3, 4))
            self._own.pose[:] = base @ wanted
        turn = np.kron(np.eye(2), base[:3, :3])
        wrench = np.asarray(asked["tcp_wrench"], float)[_REVERSED]
        self._own.wrench[:] = turn @ wrench if flags & WRENCH else 0.0
        changes: dict[str, Any] = {}
        if flags & CARTESIAN_STIFFNESS:
            asked_for = np.asarray(asked["cartesian_stiffness"], float)[_REVERSED]
            stiffness = np.clip(asked_for, _SOFTEST, 5000.0)
            changes["stiffness"] = turn @ np.diag(stiffness) @ turn.T
        if flags & CARTESIAN_DAMPING:
            changes["damping"] = float(np.clip(asked["cartesian_damping"], *_RATIOS).mean())
        declared = self._cartesian
        if any(not np.allclose(getattr(declared, key), value) for key, value in changes.items()):
            self._cartesian = declared.changed(changes)
            self._make_holder()

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
        """Writes the torques of the robot's own control, (n,)."""
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


def _view(packet: bytearray, structure: Structure, event: str) -> Any:
    item = structure.field(event)
    return np.frombuffer(packet, item.dtype, item.numbers, item.offset)
