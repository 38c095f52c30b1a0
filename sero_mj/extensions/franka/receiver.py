"""`FrankaReceiver`: the state of a Franka arm from its Franka Control Interface (FCI).

A client connects to TCP port 1337 and requests states, which the robot then sends to a UDP port of
the client once per millisecond. The receiver sends only this request, so it cannot command the
robot. All messages are little-endian and packed. The protocol and the names of fields are those of
`research_interface::robot` in libfranka-common, server versions 3 (Panda) to 10 (FR3).
"""

from __future__ import annotations

import socket
import struct
import time as clock
from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from typing import ClassVar, NoReturn

import numpy as np
from pydantic import Field, PrivateAttr

from ...base.frames import Array, Ints
from ...data.receive import connecting
from ...data.receive.connecting import ConnectingSource, Connection, ProtocolError
from ...data.receive.structure import Rows, Structure, TorqueSign
from ...data.receive.udp_socket import (
    DEFAULT_BUFFER,
    Batch,
    Datagrams,
    canonical_address,
    pack_address,
)

PORT = 1337
CONNECT = 0  # number of the request to connect
_HEAD = struct.Struct("<III")  # command, id of the request, number of bytes
_REQUEST = struct.Struct("<HH")  # version, UDP port
_ANSWER = struct.Struct("<BH")  # status, version of the server
_SUCCESS, _INCOMPATIBLE = 0, 1
_MAX_BYTES = 1024  # maximum size of an answer; current servers send 15 bytes
OLDEST, NEWEST = 3, 10  # supported server versions
_SINGLE_SINCE = 10  # first version with float32 values in states instead of float64
_BOOLEANS = {3: 37, 4: 37}  # mapping from versions to the number of errors (default: 41)

# All fields of `RobotState` in order: name, first version, and number of values or `struct` type.
FIELDS: tuple[tuple[str, int, int | str], ...] = (
    ("message_id", 3, "Q"),
    ("O_T_EE", 3, 16), ("O_T_EE_d", 3, 16), ("F_T_EE", 3, 16), ("EE_T_K", 3, 16),
    ("F_T_NE", 4, 16), ("NE_T_EE", 4, 16),
    ("m_ee", 3, 1), ("I_ee", 3, 9), ("F_x_Cee", 3, 3),
    ("m_load", 3, 1), ("I_load", 3, 9), ("F_x_Cload", 3, 3),
    ("elbow", 3, 2), ("elbow_d", 3, 2),
    ("tau_J", 3, 7), ("tau_J_d", 3, 7), ("dtau_J", 3, 7),
    ("q", 3, 7), ("q_d", 3, 7), ("dq", 3, 7), ("dq_d", 3, 7), ("ddq_d", 3, 7),
    ("joint_contact", 3, 7), ("cartesian_contact", 3, 6),
    ("joint_collision", 3, 7), ("cartesian_collision", 3, 6),
    ("tau_ext_hat_filtered", 3, 7), ("O_F_ext_hat_K", 3, 6), ("K_F_ext_hat_K", 3, 6),
    ("O_dP_EE_d", 3, 6), ("O_ddP_O", 5, 3),
    ("elbow_c", 3, 2), ("delbow_c", 3, 2), ("ddelbow_c", 3, 2),
    ("O_T_EE_c", 3, 16), ("O_dP_EE_c", 3, 6), ("O_ddP_EE_c", 3, 6),
    ("theta", 3, 7), ("dtheta", 3, 7),
    ("accelerometer_top", 10, 18), ("accelerometer_bottom", 10, 18),
    ("motion_generator_mode", 3, "B"), ("controller_mode", 3, "B"),
    ("errors", 3, "?"), ("reflex_reason", 3, "?"),
    ("robot_mode", 3, "B"), ("control_command_success_rate", 3, 1),
)  # fmt: skip
# Mapping from the fields that are events, in the same order, to their structures.
EVENTS = {
    "message_id": "message_id:1Q",
    "tau_J": "torques:7d",
    "tau_J_d": "commanded_torques:7d",
    "q": "joint_angles:7d",
    "q_d": "commanded_angles:7d",
    "dq": "joint_velocities:7d",
    "tau_ext_hat_filtered": "external_torques:7d",
    "O_F_ext_hat_K": "tcp_force:1Vd tcp_moment:1Vd",
    "errors": "errors:41?",
    "reflex_reason": "reflex_reasons:41?",
    "robot_mode": "robot_mode:1B",
}
STRUCTURE = " ".join(EVENTS.values())
# External torques and forces in FCI are exerted by the robot on its environment, so their sign is
# opposite to ours. Sources: libfranka include/franka/robot_state.h (O_F_ext_hat_K) and issue 26,
# drake manipulation/README.md; docs/conventions.md.
_EXTERNAL_SIGN = -1.0
_PACKET = struct.Struct("<Q48d41s41sB")  # `struct` pads shorter strings with zeros

ROBOT_MODES = (
    "in another mode", "idle", "moving", "being guided", "stopped by a reflex",
    "stopped by its user", "recovering from an error",
)  # fmt: skip
_GOOD = (1, 2, 3)
# Names of `errors` and `reflex_reason` in libfranka.
ERRORS = (
    "joint_position_limits_violation", "cartesian_position_limits_violation",
    "self_collision_avoidance_violation", "joint_velocity_violation",
    "cartesian_velocity_violation", "force_control_safety_violation", "joint_reflex",
    "cartesian_reflex", "max_goal_pose_deviation_violation", "max_path_pose_deviation_violation",
    "cartesian_velocity_profile_safety_violation",
    "joint_position_motion_generator_start_pose_invalid",
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    "cartesian_position_motion_generator_start_pose_invalid",
    "cartesian_motion_generator_elbow_limit_violation",
    "cartesian_motion_generator_velocity_limits_violation",
    "cartesian_motion_generator_velocity_discontinuity",
    "cartesian_motion_generator_acceleration_discontinuity",
    "cartesian_motion_generator_elbow_sign_inconsistent",
    "cartesian_motion_generator_start_elbow_invalid",
    "force_controller_desired_force_tolerance_violation", "start_elbow_sign_inconsistent",
    "communication_constraints_violation", "power_limit_violation",
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    "cartesian_position_motion_generator_invalid_frame_flag", "controller_torque_discontinuity",
    "joint_p2p_insufficient_torque_for_planning", "tau_J_range_violation", "instability_detected",
    "joint_move_in_wrong_direction", "cartesian_spline_motion_generator_violation",
    "joint_via_motion_generator_planning_joint_limit_violation",
    "base_acceleration_initialization_timeout", "base_acceleration_invalid_reading",
)  # fmt: skip


def state_fields(version: int) -> dict[str, tuple[int, str]]:
    """Returns the offset in bytes and the `struct` format of each field of a state."""
    number = "f" if version >= _SINGLE_SINCE else "d"
    fields, at = {}, 0
    for name, since, count in FIELDS:
        if version < since:
            continue
        if isinstance(count, int):
            kind = f"{count}{number}"
        else:
            kind = f"{_BOOLEANS.get(version, 41)}?" if count == "?" else f"1{count}"
        fields[name] = at, kind
        at += struct.calcsize(f"<{kind}")
    return fields


def state_size(version: int) -> int:
    """Returns the size in bytes of the states that servers of a version send."""
    return sum(struct.calcsize(f"<{kind}") for _, kind in state_fields(version).values())


def _picker(version: int) -> struct.Struct:
    kinds = (
        kind.replace("?", "s") if name in EVENTS else f"{struct.calcsize(f'<{kind}')}x"
        for name, (_, kind) in state_fields(version).items()
    )
    return struct.Struct("<" + "".join(kinds))


# Mapping from state sizes to structs. Versions with the same size have the same layout.
_PICKERS = {state_size(version): _picker(version) for version in range(OLDEST, NEWEST + 1)}
_LONGEST_STATE = max(_PICKERS)


class FrankaReceiver(ConnectingSource):
    """A source that receives the state of a Franka arm without commanding the arm.

    The server version of the robot is detected automatically. A robot accepts only one client at a
    time, so your own program cannot connect while this source is open. `torques` include gravity,
    but `commanded_torques` do not. The environment exerts `external_torques`, `tcp_force` and
    `tcp_moment` on the robot. `tcp_force` and `tcp_moment` act at the stiffness frame, are given in
    the base frame, and are 0 near a singularity.

    Attributes:
        host: address of the robot controller.
        port: port of the robot controller.
        torque_sign: factor of measured and commanded torques, 1 or -1.
    """

    name: str = "franka"
    port: int = Field(PORT, ge=1, le=65535)
    structure: str = STRUCTURE
    sequence: str = "message_id"
    time: str = "message_id"
    time_scale: float = 1e-3
    torque_sign: TorqueSign = 1

    _fixed_by: ClassVar[str] = "FCI"
    protocol: ClassVar[str] = "Franka FCI"
    if_refused: ClassVar[str] = "; is FCI activated in Desk?"
    _version: int = PrivateAttr(NEWEST)  # requested version

    @cached_property
    def layout(self) -> Structure:
        return FrankaLayout(self.torque_sign)

    def describe_link(self, values: Mapping[str, Array]) -> str:
        texts = [f"robot {_mode(float(values['robot_mode'][0]))}", *_errors(values["errors"])]
        if not values["errors"].any():
            texts += [f"last: {name}" for name in _errors(values["reflex_reasons"])]
        return ", ".join(texts)

    def link_state(self, values: Mapping[str, Array]) -> tuple[float, float]:
        errors = values["errors"] != 0
        first = 1 + int(np.argmax(errors)) if errors.any() else 0
        return float(values["robot_mode"][0]), float(first)

    def link_faults(self, state: float, quality: float) -> list[str]:
        if state in _GOOD and quality <= 0:
            return []
        error = f": {ERRORS[int(quality) - 1]}" if 1 <= quality <= len(ERRORS) else ""
        return [f"robot {_mode(state)}{error}"]

    def converse(self, wake: socket.socket) -> None:
        requested = set[int]()
        while True:
            with Connection(self.host, self.port, wake) as connection:
                requested.add(self._version)
                version = self._run_session(connection)
            # A server that does not support the requested version sends its own version.
            if not OLDEST <= version <= NEWEST:
                supported = f"supported versions are {OLDEST} to {NEWEST}"
                raise ProtocolError(f"the robot has server version {version}; {supported}")
            if version in requested:
                has = f"has server version {version} and rejects version {self._version}"
                raise ProtocolError(f"the robot {has}")
            self._version = version

    # Returns the version of the server if it rejects the requested one. Otherwise, this method
    # receives states until an error occurs.
    def _run_session(self, connection: Connection) -> int:
        with socket.socket(connection.socket.family, socket.SOCK_DGRAM) as states:
            with suppress(OSError):  # some systems reject large buffers
                states.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, DEFAULT_BUFFER)
            here = connection.socket.getsockname()
            states.bind((here[0], 0, *here[2:]))
            port = int(states.getsockname()[1])
            status, version = self._request_states(connection, port)
            if status == _INCOMPATIBLE:
                return version
            if status != _SUCCESS:
                raise ProtocolError(f"the robot rejects the connection with status {status}")
            if not OLDEST <= version <= NEWEST:
                return version
            peer = connection.socket.getpeername()[0]
            self._receive_states(connection, states, peer, version)

    def _request_states(self, connection: Connection, port: int) -> tuple[int, int]:
        number = 1
        size = _HEAD.size + _REQUEST.size
        request = _HEAD.pack(CONNECT, number, size) + _REQUEST.pack(self._version, port)
        connection.socket.sendall(request)
        deadline = clock.monotonic() + connecting.PATIENCE
        hint = "is another client connected?"
        answer = b""
        while True:
            connection.wait(deadline, f"the robot does not answer; {hint}")
            try:
                answer += connection.read()
            except ConnectionError as error:
                raise ConnectionError(
                    f"the robot does not answer ({error.strerror or error}); {hint}"
                ) from None
            if len(answer) < _HEAD.size:
                continue
            command, found, size = _HEAD.unpack_from(answer)
            min_size = _HEAD.size + _ANSWER.size
            if (command, found) != (CONNECT, number) or not min_size <= size <= _MAX_BYTES:
                raise ProtocolError("the robot sends an invalid FCI message", answer)
            if len(answer) < size:
                continue
            if len(answer) > size:
                raise ProtocolError("the robot sends more bytes than one answer", answer)
            status, version = _ANSWER.unpack_from(answer, _HEAD.size)
            return status, version

    def _receive_states(
        self, connection: Connection, states: socket.socket, peer: str, version: int
    ) -> NoReturn:
        expected = canonical_address(pack_address(peer, 0))[0]
        datagrams = Datagrams(states, _LONGEST_STATE + 1)
        connection.watch(states)
        self.note_connected(f"version {version}")
        port = int(states.getsockname()[1])
        silent = f"the robot sends no states to UDP port {port}; is it blocked by a firewall?"
        deadline = clock.monotonic() + connecting.PATIENCE
        while True:
            ready = connection.wait(deadline, silent)
            if states in ready and (batch := datagrams.receive()) is not None:
                if batch.dropped is not None:
                    self.counters.dropped = batch.dropped
                if self._accept_batch(batch, expected):
                    silent = f"the robot sends nothing for {connecting.PATIENCE:g} s"
                    deadline = clock.monotonic() + connecting.PATIENCE
                elif clock.monotonic() > deadline:  # packets of other senders can prevent a timeout
                    raise TimeoutError(silent)
            if connection.socket in ready:
                raise ProtocolError("the robot sends an unexpected message", connection.read())

    def _accept_batch(self, batch: Batch, expected: bytes) -> bool:
        rows, lengths, arrivals = batch.rows, batch.lengths, batch.arrivals
        known = np.array([canonical_address(s.tobytes())[0] == expected for s in batch.senders])
        if not known.all():
            unexpected = int((~known).sum())
            self.counters.foreign += unexpected
            self.counters.received += unexpected
            rows, lengths, arrivals = rows[known], lengths[known], arrivals[known]
        if len(rows):
            self._accept(rows, lengths, arrivals)
        return bool(len(rows))


class FrankaLayout(Structure):
    """The structure of `FrankaReceiver` packets, which are extracted from states of any version."""

    message = "state"

    def __init__(self, torque_sign: TorqueSign = 1) -> None:
        own = dict.fromkeys(("torques", "commanded_torques"), float(torque_sign))
        external = dict.fromkeys(("external_torques", "tcp_force", "tcp_moment"), _EXTERNAL_SIGN)
        super().__init__(STRUCTURE, signs={**own, **external})

    def unpack(self, rows: Rows, lengths: Ints) -> tuple[Rows, Ints]:
        packets = np.zeros((len(rows), self.size), np.uint8)
        sizes = np.full(len(rows), -1)
        for i, length in enumerate(lengths.tolist()):
            picker = _PICKERS.get(length)
            if picker is not None and length <= rows.shape[1]:
                packet = _PACKET.pack(*picker.unpack_from(rows[i]))
                packets[i], sizes[i] = np.frombuffer(packet, np.uint8), self.size
        return packets, sizes

    def describe_wrong_size(self, packet: bytes, length: int) -> str:
        sizes = ", ".join(map(str, sorted(_PICKERS)))
        return f"{length} bytes; expected a {self.message} of {sizes} bytes"


def _mode(state: float) -> str:
    known = 0 <= state < len(ROBOT_MODES)
    return ROBOT_MODES[int(state)] if known else f"in mode {state:.0f}"


def _errors(flags: Array) -> list[str]:
    return [ERRORS[i] for i in np.flatnonzero(flags)]
