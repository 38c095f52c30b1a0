"""`IiwaFri`: the simulated robot as an LBR iiwa or Med on FRI 1.x and 2.x.

Its program holds the position and lets a client overlay its own, as KUKA's examples do. The session
waits until the link is good (`MONITORING_WAIT`), calls for commands (`COMMANDING_WAIT`, in which a
client mirrors the angles of the program), and follows them (`COMMANDING_ACTIVE`). A link that is
not good any more, or a wrong command, ends the overlay for good, as it ends the robot's program.
Measured and commanded torques are sent with KUKA's sign, see `fri_iiwa.TORQUE_SIGN`.
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
    double,
    inner,
    per_joint,
    read_fields,
    read_message,
    read_numbers,
    read_whole,
    whole,
)
from .robot import JOINTS, FriRobot, FriSession

log = logging.getLogger(__name__)

MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE = 1, 2, 3, 4
_GOOD = 2  # quality from which commands are followed
_CONTROLS = {"position": 0, "cartesian_impedance": 1, "joint_impedance": 2}
_MODES = {"position": 1, "wrench": 2, "torque": 3}
# In which field of a command what each of these adds is, and how many numbers it has.
_ADDED = {"wrench": (2, 6), "torque": (3, JOINTS)}
_NORMAL, _ACTIVE_DRIVE, _AUTOMATIC, _JOINT_OVERLAY = 0, 2, 2, 1
_COUNTERS = 0xFFFFFFFF
_LARGEST = 1500  # bytes of a command
_BANDWIDTH = 25.0  # 1/s, of the observer of external torques; our choice
_ABOUT_XYZ = [0, 1, 2, 5, 4, 3]  # wrenches have moments about z, y, x


class IiwaFri(FriRobot):
    """FRI 1.x or 2.x; see `FriRobot`. `state` is one of `fri_iiwa.STATES`."""

    def __init__(
        self, declared: FriSession, model: RobotModel, timestep: float, steps: int
    ) -> None:
        super().__init__(declared, model, timestep, steps, _LARGEST)
        self.state = MONITORING_WAIT
        self._is_framed = declared.version == "iiwa-2.7"
        self._robot = inner(
            2,
            whole(1, JOINTS),
            whole(2, _NORMAL),
            *[whole(5, _ACTIVE_DRIVE)] * JOINTS,
            whole(6, _AUTOMATIC),
            whole(7, _CONTROLS[declared.control]),
        )
        self._observer = MomentumObserver(model, _BANDWIDTH, timestep)
        self._torques: Array = np.zeros(JOINTS)  # of the last step, commanded
        self._reflected = 0
        self._asked: fri_iiwa.Fields = {}  # what a command has besides its header

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        self._observer.update(sensed)
        super().torques(sensed, target, out)
        self._torques[:] = out

    def _follow_quality(self) -> None:
        is_good, begins = self.quality >= _GOOD, self._declared.commands_from
        if self.state >= COMMANDING_WAIT:
            if not is_good:
                self.error = True
                self._hold_again(f"quality {fri_iiwa.QUALITIES[self.quality]}")
            return
        is_called = begins is not None and self._time >= begins and not self.error
        if not is_good:
            self.state = MONITORING_WAIT
        elif self.state == MONITORING_READY and is_called:  # which clients prepare commands in
            self.state = COMMANDING_WAIT
        else:
            self.state = MONITORING_READY

    def _end_command(self) -> None:
        self.state = MONITORING_WAIT

    def _packet(self, sensed: Sensed) -> bytes:
        declared, is_called = self._declared, self.state >= COMMANDING_WAIT
        seconds, rest = divmod(round(sensed.time * 1e9), 10**9)
        monitor = [per_joint(1, sensed.angles), per_joint(2, TORQUE_SIGN * sensed.torques)]
        if declared.version == "iiwa-1":
            monitor.append(per_joint(3, self._base + self._offset))
        monitor += [
            per_joint(4, TORQUE_SIGN * self._torques),
            per_joint(5, self._observer.external),
            inner(15, whole(1, seconds), whole(2, rest)),
        ]
        ipo = [
            whole(10, _MODES[declared.command_mode] if is_called else 0),
            whole(11, _JOINT_OVERLAY if is_called else 0),
            double(12, float(self.state == COMMANDING_ACTIVE)),
        ]
        if is_called:
            ipo.insert(0, per_joint(1, self._base))
        message = b"".join(
            (
                inner(
                    1,
                    whole(1, fri_iiwa.MONITORING_ID),
                    whole(2, self._counter & _COUNTERS),
                    whole(3, self._reflected),
                ),
                self._robot,
                inner(3, *monitor),
                inner(
                    4,
                    whole(1, self.state),
                    whole(2, self.quality),
                    whole(3, round(self._cycle * 1e3)),
                    whole(4, 1),  # each message is answered
                ),
                inner(5, *ipo),
            )
        )
        return fri_iiwa.framed(message) if self._is_framed else message

    # ---- commands

    def _read(self, packet: memoryview) -> int | None:
        try:
            message, is_framed = fri_iiwa.unframed(bytes(packet))
            fields = read_fields(message)
            header = read_fields(read_message(fields, 1))
            number, sent, reflected = (read_whole(header, k, 0, _COUNTERS) for k in (1, 2, 3))
            self._asked = read_fields(read_message(fields, 2))
        except ValueError:
            return None
        if is_framed != self._is_framed:
            self._tell(
                f"commands come {'with' if is_framed else 'without'} length and checksum; "
                f"version = '{'iiwa-2.7' if is_framed else 'iiwa-2'}' has them so"
            )
            return None
        if number != fri_iiwa.COMMAND_ID:
            return None
        self._reflected = sent
        return reflected

    def _obey(self) -> None:
        if self.state < COMMANDING_WAIT:
            return
        mode = self._declared.command_mode
        try:
            angles = self._numbers("joint positions", 1, JOINTS)
            added = self._numbers(f"a {mode}", *_ADDED[mode]) if mode in _ADDED else None
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
            log.info("%s: command begins at %.3f s", self._model.name, self._time)
        elif mode == "torque":  # with our sign, unlike the torques that the robot reports
            self._extra[:] = added
        elif added is not None:
            turn = np.kron(np.eye(2), self._model.base()[:3, :3])
            self._own.wrench[:] = turn @ added[_ABOUT_XYZ]

    def _numbers(self, what: str, field: int, count: int) -> Array:
        if field not in self._asked:
            raise ValueError(f"a command has not {what}")
        numbers = np.array(read_numbers(self._asked, field, count))
        if not np.isfinite(numbers).all():
            raise ValueError(f"{what} of a command: not finite")
        return numbers
