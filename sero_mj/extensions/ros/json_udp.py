"""Receives joint states in JSON, one message per UDP packet."""

from __future__ import annotations

import time as clock
from typing import ClassVar

import numpy as np
from pydantic import PrivateAttr

from ...base.errors import Problem, SourceError
from ...base.frames import Array, Ints
from ...data.receive.intake import pad_packets
from ...data.receive.structure import Rows
from ...data.receive.udp import UdpReceiver
from .dds import Ros2
from .joined_packets import JOINT_STATES, JoinedPackets
from .json_messages import joint_state_of, message_of
from .messages import MalformedMessage
from .ros_source import MAX_REJECTED_BYTES, Listener, RosSource


class JsonUdp(UdpReceiver, RosSource):
    """Receives joint states in the formats of `json_messages` over UDP.

    Joints are matched by name, as in ROS sources. Several devices can send to the same port, each
    with a part of the joints.
    """

    name: str = "json"
    structure: str = ""
    time: str = "stamp"
    commands: ClassVar[str] = ""  # type: ignore[misc]
    wrench: ClassVar[str] = ""  # type: ignore[misc]
    odometry: ClassVar[str] = ""  # type: ignore[misc]
    pose: ClassVar[str] = ""  # type: ignore[misc]
    frames: ClassVar[list[str]] = []  # type: ignore[misc]
    root: ClassVar[str] = ""  # type: ignore[misc]
    namespace: ClassVar[str] = ""  # type: ignore[misc]
    joint_states: ClassVar[str] = "joint_states"  # type: ignore[misc]

    _fixed_by: ClassVar[str] = "JSON"
    _structure_is: ClassVar[str] = "derived from the messages"
    _min_row_bytes: ClassVar[int] = 1 << 16  # the maximum size of a UDP packet
    _joined: JoinedPackets | None = PrivateAttr(None)

    @property
    def about(self) -> str:
        return f"JSON, {super().about}"

    def open(self) -> None:
        if not self.joint_names:
            problem = Problem("joints", "no route to a robot", expected="the joint names")
            raise SourceError(self.name, problem)
        self._joined = self.joined()
        super().open()

    @property
    def of_messages(self) -> RosSource:
        fields = RosSource.model_fields.keys() & type(self).model_fields.keys()
        source = Ros2(**{key: getattr(self, key) for key in fields & self.model_fields_set})
        source.set_joints(self._led)
        source._links = self._links
        return source

    def message_of(self, packet: bytes) -> bytes:
        values = self.layout.decode(packet)
        constants = 1.0 if self.torque_constants is None else self.torque_constants
        efforts = values["torques"] / (self.torque_sign * np.asarray(constants, float))
        velocities = values["joint_velocities"]
        if not velocities.any():  # no route leads to velocities
            velocities = np.full(len(velocities), np.nan)
        stamp = float(values["stamp"][0])
        return message_of(self.joint_names, stamp, values["joint_angles"], velocities, efforts)

    def _subscribe(self, listener: Listener) -> None: ...

    def _accept(
        self, rows: Rows, lengths: Ints, arrivals: Array, senders: Rows | None = None
    ) -> None:
        assert self._joined is not None
        packets, kept = [], []
        for k, (row, length) in enumerate(zip(rows, lengths.tolist(), strict=True)):
            raw = row[:length].tobytes()
            try:
                packet = self._joined.take(JOINT_STATES, joint_state_of(raw), clock.time())
            except MalformedMessage as error:
                self.layout.fault = str(error)
                packet = self.layout.never(raw[:MAX_REJECTED_BYTES])
            if packet is not None:
                packets.append(packet)
                kept.append(k)
        if packets:
            joined = pad_packets(packets, self.size)
            super()._accept(*joined, arrivals[kept], None if senders is None else senders[kept])
