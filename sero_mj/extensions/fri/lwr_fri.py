"""`LwrFri`: the simulated robot as an LWR 4+ on FRI 1.0.

It sends measurements and takes commands as the robot's own controller does: monitor and command
state, flags of commands, limits, and the way back to monitor.
"""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from ...base.frames import inverse
from ...data.receive.structure import Structure
from ...simulate.control.controller import Sensed
from ...simulate.control.robot_model import RobotModel
from .receiver import ALL_DRIVES, COMMAND, MEASUREMENT, QUALITIES
from .robot import COUNTERS, RATIOS, SOFTEST, STIFFEST, FriRobot, FriSession

log = logging.getLogger(__name__)

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
_STIFFEST_FLANGE = 5000.0  # N/m, Nm/rad
_REFRESHED = 10  # packets between two computations of the averages over 100
_ERROR = 1
_REVERSED = [0, 1, 2, 5, 4, 3]  # FRI has moments about z, y, x


class LwrFri(FriRobot):
    """FRI 1.0; see `FriRobot`. `state` is `MONITOR` or `COMMANDED`."""

    def __init__(
        self, declared: FriSession, model: RobotModel, timestep: float, steps: int
    ) -> None:
        self._commands = Structure(COMMAND)
        super().__init__(declared, model, timestep, steps, self._commands.size)
        self.state = MONITOR
        layout = Structure(MEASUREMENT, is_double=False, column_major=False)
        self._measured = bytearray(layout.encode({}))
        self._views = {name: _view(self._measured, layout, name) for name in layout.events}
        self._command = bytearray(self._commands.size)
        self._asked = {name: _view(self._command, self._commands, name)
                       for name in self._commands.events}  # fmt: skip
        self._expected = bytes(self._commands.encode({}))[4:8]  # size and id of a command
        for name, value in (("packet_size", 0), ("power", ALL_DRIVES), ("safety_limits", 1.0),
                            ("measurement_cycle", self._cycle), ("command_cycle", self._cycle),
                            ("control", CONTROLS[declared.control])):  # fmt: skip
            if name in self._views and value:
                self._views[name][:] = value

    def _follow_quality(self) -> None:
        begins = self._declared.commands_from
        quality = QUALITIES[self.quality]
        if self.state == COMMANDED and self.quality == _UNACCEPTABLE:
            self._hold_again(f"quality {quality}")
        elif (
            self.state == MONITOR
            and begins is not None
            and self._time >= begins
            and self.quality >= _OK
            and not self.error
        ):
            self.state = COMMANDED
            name = self._model.name
            log.info("%s: command begins at %.3f s, quality %s", name, self._time, quality)

    def _end_command(self) -> None:
        self.state = MONITOR
        if self.error:
            self._views["error"][0] = _ERROR

    def _packet(self, sensed: Sensed) -> bytearray:
        views, model = self._views, self._model
        views["send_counter"][0] = self._counter & COUNTERS
        views["timestamp"][0] = sensed.time
        views["state"][0], views["quality"][0] = self.state, self.quality
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
        return self._measured

    # ---- commands

    def _read(self, packet: memoryview) -> int | None:
        if len(packet) != len(self._command) or packet[4:8] != self._expected:
            return None
        self._command[:] = packet
        self._views["reflected_counter"][0] = self._asked["send_counter"][0]
        return int(self._asked["reflected_counter"][0])

    def _obey(self) -> None:
        if self.state != COMMANDED:
            return
        asked, control = self._asked, self._declared.control
        flags, acts = int(asked["command_flags"][0]), _ACTS[control]
        if flags & ~acts:
            self._tell(f"flags {flags & ~acts:#x} of commands have no effect in {control}")
        for flag, name in _OF_FLAGS.items():
            if flags & flag & acts and not np.isfinite(asked[name]).all():
                self._fail(f"{name} of a command is not finite")
                return
        if flags & ANGLES and not self._command_angles(asked["joint_angles"], MOST_SPEED):
            return
        flags &= acts
        if control == "joint_impedance":
            if flags & STIFFNESS:
                self._stiffness = np.clip(asked["joint_stiffness"], SOFTEST, STIFFEST)
            if flags & DAMPING:
                self._damping = np.clip(asked["joint_damping"], *RATIOS)
            self._extra[:] = asked["joint_torques"] if flags & TORQUES else 0.0
        elif control == "cartesian_impedance":
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
            stiffness = np.clip(asked_for, SOFTEST, _STIFFEST_FLANGE)
            changes["stiffness"] = turn @ np.diag(stiffness) @ turn.T
        if flags & CARTESIAN_DAMPING:
            changes["damping"] = float(np.clip(asked["cartesian_damping"], *RATIOS).mean())
        declared = self._cartesian
        if any(not np.allclose(getattr(declared, key), value) for key, value in changes.items()):
            self._cartesian = declared.changed(changes)
            self._make_holder()


def _view(packet: bytearray, structure: Structure, event: str) -> Any:
    item = structure.field(event)
    return np.frombuffer(packet, item.dtype, item.numbers, item.offset)
