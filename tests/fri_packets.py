"""Measurement packets of FRI, encoded with `struct`."""

from __future__ import annotations

import socket
import struct
from typing import Any

from polling import until

from sero_mj.extensions.fri.receiver import FriReceiver

FORMAT = "<4H16f16i2Hf2H3f4fI4H7f7f12f7f7f12f12f7f7f6f42f49f7f"
# First byte, count, type and name of every field.
TABLE = [
    (0, 1, "H", "send_counter"),
    (2, 1, "H", "reflected_counter"),
    (4, 1, "H", "packet_size"),
    (6, 1, "H", "datagram_id"),
    (8, 16, "f", "krl_real"),
    (72, 16, "i", "krl_int"),
    (136, 1, "H", "krl_bool"),
    (140, 1, "f", "timestamp"),
    (144, 1, "H", "state"),
    (146, 1, "H", "quality"),
    (148, 1, "f", "measurement_cycle"),
    (152, 1, "f", "command_cycle"),
    (156, 1, "f", "safety_limits"),
    (160, 1, "f", "answer_rate"),
    (164, 1, "f", "latency"),
    (168, 1, "f", "jitter"),
    (172, 1, "f", "miss_rate"),
    (176, 1, "I", "miss_counter"),
    (180, 1, "H", "power"),
    (182, 1, "H", "control"),
    (184, 1, "H", "error"),
    (186, 1, "H", "warning"),
    (188, 7, "f", "temperatures"),
    (216, 7, "f", "joint_angles"),
    (244, 12, "f", "flange_frame"),
    (292, 7, "f", "commanded_before_fri"),
    (320, 7, "f", "commanded_offset"),
    (348, 12, "f", "commanded_frame"),
    (396, 12, "f", "commanded_frame_offset"),
    (444, 7, "f", "torques"),
    (472, 7, "f", "external_torques"),
    (500, 3, "f", "tcp_force"),
    (512, 3, "f", "tcp_moment"),
    (524, 42, "f", "jacobian"),
    (692, 49, "f", "mass_matrix"),
    (888, 7, "f", "gravity_torques"),
]
UPRIGHT = [1, 0, 0, 0.1, 0, 1, 0, 0.2, 0, 0, 1, 0.3]  # 3 x 4, row-major


def measurement(counter: int = 0, **fields: Any) -> bytes:
    """Returns a packet of an idle robot, in which `fields` are set to encoded values."""
    packet = bytearray(struct.calcsize(FORMAT))
    given = {"send_counter": counter, "packet_size": 916, "datagram_id": 0x2006, "state": 1}
    given |= {"quality": 3, "flange_frame": UPRIGHT, **fields}
    for offset, count, kind, name in TABLE:
        numbers = given.pop(name, None)
        if numbers is not None:
            numbers = numbers if isinstance(numbers, list) else [numbers] * count
            struct.pack_into(f"<{count}{kind}", packet, offset, *numbers)
    assert not given
    return bytes(packet)


def give(receiver: FriReceiver, controller: socket.socket, *packets: bytes) -> None:
    """Sends packets to a receiver and waits until the last packet has been processed."""
    before = receiver.counters.received
    for packet in packets:
        controller.sendto(packet, ("127.0.0.1", receiver.port))
    assert until(lambda: receiver.counters.received == before + len(packets))
