"""Simulates an LWR 4+ on FRI 1.0."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from ...base.frames import inverse
from ...data.receive.structure import Structure
from ...simulate.control.controller import Sensed
from ...simulate.control.robot_model import RobotModel
from .receiver import ALL_DRIVES, COMMAND, MEASUREMENT, QUALITIES
from .robot import COUNTER_MASK, MAX_STIFFNESS, MIN_STIFFNESS, FriRobot, FriSession

log = logging.getLogger(__name__)

MONITOR, COMMANDED = 1, 2
_UNACCEPTABLE, _OK = 0, 2
# All flags of a command, and the flags that have an effect in each control mode.
ANGLES, TORQUES, STIFFNESS, DAMPING = 0x1, 0x4, 0x10, 0x20
FRAME, WRENCH, CARTESIAN_STIFFNESS, CARTESIAN_DAMPING = 0x100, 0x400, 0x1000, 0x2000
CONTROLS = {"position": 1, "cartesian_impedance": 2, "joint_impedance": 3}
_EFFECTIVE_FLAGS = {
    "position": ANGLES,
    "joint_impedance": ANGLES | TORQUES | STIFFNESS | DAMPING,
    "cartesian_impedance": ANGLES | FRAME | WRENCH | CARTESIAN_STIFFNESS | CARTESIAN_DAMPING,
}
_EVENTS = {
    ANGLES: "joint_angles",
    TORQUES: "joint_torques",
    STIFFNESS: "joint_stiffness",
    DAMPING: "joint_damping",
    FRAME: "tcp_frame",
    WRENCH: "tcp_wrench",
    CARTESIAN_STIFFNESS: "cartesian_stiffness",
    CARTESIAN_DAMPING: "cartesian_damping",
}
# Maximum joint velocities of the LWR 4+ in rad/s. Commands that exceed them are rejected.
MAX_SPEEDS = np.deg2rad([110.0, 110.0, 128.0, 128.0, 204.0, 184.0, 184.0])
_DAMPING_RATIOS = 0.1, 1.0
_MAX_FLANGE_STIFFNESS = 5000.0  # N/m, Nm/rad
_STATISTICS_INTERVAL = 10  # packets between two updates of the averages
_ERROR = 1
_XYZ_TO_ZYX = [0, 1, 2, 5, 4, 3]  # FRI lists moments in the order z, y, x


class LwrFri(FriRobot):
    """Simulates an LWR on FRI 1.0.

    Attributes:
        state: state of the session, `MONITOR` or `COMMANDED`.
    """

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
        self._command_values = {name: _view(self._command, self._commands, name)
                       for name in self._commands.events}  # fmt: skip
        self._command_header = bytes(self._commands.encode({}))[4:8]  # size and id
        for name, value in (("packet_size", 0), ("power", ALL_DRIVES), ("safety_limits", 1.0),
                            ("measurement_cycle", self._cycle), ("command_cycle", self._cycle),
                            ("control", CONTROLS[declared.control])):  # fmt: skip
            if name in self._views and value:
                self._views[name][:] = value

    def _update_state(self) -> None:
        begins = self._declared.commands_from
        quality = QUALITIES[self.quality]
        if self.state == COMMANDED and self.quality == _UNACCEPTABLE:
            self._end_command(f"quality {quality}")
        elif (
            self.state == MONITOR
            and begins is not None
            and self._time >= begins
            and self.quality >= _OK
            and not self.error
        ):
            self.state = COMMANDED
            name = self._model.name
            log.info("%s: command state begins at %.3f s, quality %s", name, self._time, quality)

    def _set_monitor_state(self) -> None:
        self.state = MONITOR
        if self.error:
            self._views["error"][0] = _ERROR

    def _encode(self, sensed: Sensed) -> bytearray:
        views, model = self._views, self._model
        views["send_counter"][0] = self._counter & COUNTER_MASK
        views["timestamp"][0] = sensed.time
        views["state"][0], views["quality"][0] = self.state, self.quality
        if self._counter % _STATISTICS_INTERVAL == 0:
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

    def _decode(self, packet: memoryview) -> int | None:
        if len(packet) != len(self._command) or packet[4:8] != self._command_header:
            return None
        self._command[:] = packet
        self._views["reflected_counter"][0] = self._command_values["send_counter"][0]
        return int(self._command_values["reflected_counter"][0])

    def _apply_command(self) -> None:
        if self.state != COMMANDED:
            return
        values, control = self._command_values, self._declared.control
        flags, effective = int(values["command_flags"][0]), _EFFECTIVE_FLAGS[control]
        if ignored := flags & ~effective:
            self._warn_once(f"command flags {ignored:#x} have no effect with control = '{control}'")
        flags &= effective
        for flag, name in _EVENTS.items():
            if flags & flag and not np.isfinite(values[name]).all():
                self._fail(f"{name} of a command is not finite")
                return
        if flags & ANGLES and not self._command_angles(values["joint_angles"], MAX_SPEEDS):
            return
        if control == "joint_impedance":
            if flags & STIFFNESS:
                self._stiffness = np.clip(values["joint_stiffness"], MIN_STIFFNESS, MAX_STIFFNESS)
            if flags & DAMPING:
                self._damping = np.clip(values["joint_damping"], *_DAMPING_RATIOS)
            self._extra_torques[:] = values["joint_torques"] if flags & TORQUES else 0.0
        elif control == "cartesian_impedance":
            self._apply_at_flange(flags)

    def _apply_at_flange(self, flags: int) -> None:
        values, base = self._command_values, self._model.base()
        if flags & FRAME:
            pose = np.eye(4)
            pose[:3] = np.reshape(values["tcp_frame"], (3, 4))
            self._target.pose[:] = base @ pose
        rotate = np.kron(np.eye(2), base[:3, :3])
        wrench = np.asarray(values["tcp_wrench"], float)[_XYZ_TO_ZYX]
        self._target.wrench[:] = rotate @ wrench if flags & WRENCH else 0.0
        changes: dict[str, Any] = {}
        if flags & CARTESIAN_STIFFNESS:
            commanded = np.asarray(values["cartesian_stiffness"], float)[_XYZ_TO_ZYX]
            stiffness = np.clip(commanded, MIN_STIFFNESS, _MAX_FLANGE_STIFFNESS)
            changes["stiffness"] = rotate @ np.diag(stiffness) @ rotate.T
        if flags & CARTESIAN_DAMPING:
            changes["damping"] = float(
                np.clip(values["cartesian_damping"], *_DAMPING_RATIOS).mean()
            )
        declared = self._cartesian
        if any(not np.allclose(getattr(declared, key), value) for key, value in changes.items()):
            self._cartesian = declared.changed(changes)
            self._make_inner()


def _view(packet: bytearray, structure: Structure, event: str) -> Any:
    item = structure.field(event)
    return np.frombuffer(packet, item.dtype, item.numbers, item.offset)
