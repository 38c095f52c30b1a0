"""Simulates an LBR iiwa or Med on FRI 1.x and 2.x.

The robot's program holds a position, and a client can overlay another one, as in KUKA's examples.
The session waits until the connection is good (`MONITORING_WAIT`), requests commands
(`COMMANDING_WAIT`, in which a client mirrors the angles of the program) and follows them
(`COMMANDING_ACTIVE`). If the connection is no longer good or a command is invalid, the overlay ends
permanently. On the real robot, this ends the program.
"""

from __future__ import annotations

import logging

import numpy as np

from ...base.frames import Array
from ...simulate.control.controller import Sensed, Target
from ...simulate.control.observer import MomentumObserver
from ...simulate.control.robot_model import RobotModel
from . import iiwa as fri_iiwa
from .iiwa import (
    TORQUE_SIGN,
    float_field,
    integer_field,
    joints_field,
    message_field,
    read_fields,
    read_integer,
    read_message,
    read_numbers,
)
from .robot import JOINTS, FriRobot, FriSession

log = logging.getLogger(__name__)

MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE = 1, 2, 3, 4
_GOOD = 2  # minimum quality at which commands are followed
_CONTROLS = {"position": 0, "cartesian_impedance": 1, "joint_impedance": 2}
_MODES = {"position": 1, "wrench": 2, "torque": 3}
# Number and length of the command field with the quantity in addition to joint positions.
_ADDITIONS = {"wrench": (2, 6), "torque": (3, JOINTS)}
_NORMAL, _ACTIVE_DRIVE, _AUTOMATIC, _JOINT_OVERLAY = 0, 2, 2, 1
_COUNTER_MASK = 0xFFFFFFFF
_MAX_COMMAND_BYTES = 1500
_BANDWIDTH = 25.0  # 1/s; bandwidth of the observer of external torques, chosen by us
_ZYX_TO_XYZ = [0, 1, 2, 5, 4, 3]  # wrenches list moments in the order z, y, x


class IiwaFri(FriRobot):
    """Simulates an iiwa on FRI 1.x or 2.x.

    Attributes:
        state: state of the session, an index in `iiwa.STATES`.
    """

    def __init__(
        self, declared: FriSession, model: RobotModel, timestep: float, steps: int
    ) -> None:
        super().__init__(declared, model, timestep, steps, _MAX_COMMAND_BYTES)
        self.state = MONITORING_WAIT
        self._is_framed = declared.version == "iiwa-2.7"
        self._robot = message_field(
            2,
            integer_field(1, JOINTS),
            integer_field(2, _NORMAL),
            *[integer_field(5, _ACTIVE_DRIVE)] * JOINTS,
            integer_field(6, _AUTOMATIC),
            integer_field(7, _CONTROLS[declared.control]),
        )
        self._observer = MomentumObserver(model, _BANDWIDTH, timestep)
        self._torques: Array = np.zeros(JOINTS)  # torques commanded in the last step
        self._reflected = 0
        self._command_fields: fri_iiwa.Fields = {}  # fields of the last command

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._observer.update(sensed)
        super().torques(sensed, target, out)
        self._torques[:] = out

    def _update_state(self) -> None:
        is_good, begins = self.quality >= _GOOD, self._declared.commands_from
        if self.state >= COMMANDING_WAIT:
            if not is_good:
                self.error = True
                self._end_command(f"quality {fri_iiwa.QUALITIES[self.quality]}")
            return
        is_requested = begins is not None and self._time >= begins and not self.error
        if not is_good:
            self.state = MONITORING_WAIT
        elif self.state == MONITORING_READY and is_requested:
            self.state = COMMANDING_WAIT
        else:
            self.state = MONITORING_READY

    def _set_monitor_state(self) -> None:
        self.state = MONITORING_WAIT

    def _encode(self, sensed: Sensed) -> bytes:
        declared, is_commanding = self._declared, self.state >= COMMANDING_WAIT
        seconds, rest = divmod(round(sensed.time * 1e9), 10**9)
        monitor = [joints_field(1, sensed.angles), joints_field(2, TORQUE_SIGN * sensed.torques)]
        if declared.version == "iiwa-1":
            monitor.append(joints_field(3, self._base + self._offset))
        monitor += [
            joints_field(4, TORQUE_SIGN * self._torques),
            joints_field(5, self._observer.external),
            message_field(15, integer_field(1, seconds), integer_field(2, rest)),
        ]
        ipo = [
            integer_field(10, _MODES[declared.command_mode] if is_commanding else 0),
            integer_field(11, _JOINT_OVERLAY if is_commanding else 0),
            float_field(12, float(self.state == COMMANDING_ACTIVE)),
        ]
        if is_commanding:
            ipo.insert(0, joints_field(1, self._base))
        message = b"".join(
            (
                message_field(
                    1,
                    integer_field(1, fri_iiwa.MONITORING_ID),
                    integer_field(2, self._counter & _COUNTER_MASK),
                    integer_field(3, self._reflected),
                ),
                self._robot,
                message_field(3, *monitor),
                message_field(
                    4,
                    integer_field(1, self.state),
                    integer_field(2, self.quality),
                    integer_field(3, round(self._cycle * 1e3)),
                    integer_field(4, 1),  # each message is answered
                ),
                message_field(5, *ipo),
            )
        )
        return fri_iiwa.framed(message) if self._is_framed else message

    def _decode(self, packet: memoryview) -> int | None:
        try:
            message, is_framed = fri_iiwa.unframed(bytes(packet))
            fields = read_fields(message)
            header = read_fields(read_message(fields, 1))
            number, sent, reflected = (read_integer(header, k, 0, _COUNTER_MASK) for k in (1, 2, 3))
            self._command_fields = read_fields(read_message(fields, 2))
        except ValueError:
            return None
        if is_framed != self._is_framed:
            self._warn_once(
                f"commands arrive {'with' if is_framed else 'without'} length and checksum; "
                f"set version = '{'iiwa-2.7' if is_framed else 'iiwa-2'}'"
            )
            return None
        if number != fri_iiwa.COMMAND_ID:
            return None
        self._reflected = sent
        return reflected

    def _apply_command(self) -> None:
        if self.state < COMMANDING_WAIT:
            return
        mode = self._declared.command_mode
        try:
            angles = self._numbers("joint positions", 1, JOINTS)
            added = self._numbers(mode, *_ADDITIONS[mode]) if mode in _ADDITIONS else None
        except ValueError as error:
            self._fail(str(error))
            return
        low, high = self._model.position_limits.T
        if ((angles < low) | (angles > high)).any():
            joint = int(np.argmax((angles < low) | (angles > high)))
            name = self._model.joint_names[joint]
            expected = f"{low[joint]:.4g} to {high[joint]:.4g}"
            self._fail(f"{name} is commanded to {angles[joint]:.4g} rad; expected {expected}")
            return
        if not self._command_angles(angles, self._model.velocity_limits):
            return
        if self.state == COMMANDING_WAIT:
            self.state = COMMANDING_ACTIVE
            self._offset[:] = 0.0
            log.info("%s: command state begins at %.3f s", self._model.name, self._time)
        elif mode == "torque":  # commanded torques have our sign, unlike reported torques
            self._extra_torques[:] = added
        elif added is not None:
            rotate = np.kron(np.eye(2), self._model.base()[:3, :3])
            self._target.wrench[:] = rotate @ added[_ZYX_TO_XYZ]

    def _numbers(self, what: str, field: int, count: int) -> Array:
        if field not in self._command_fields:
            raise ValueError(f"a command has no {what}")
        numbers = np.array(read_numbers(self._command_fields, field, count))
        if not np.isfinite(numbers).all():
            raise ValueError(f"{what} of a command is not finite")
        return numbers
