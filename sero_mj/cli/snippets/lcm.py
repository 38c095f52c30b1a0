"""Forwards IIWA_STATUS from drake-iiwa-driver to sero-mj. Requires the packages lcm and drake."""

import itertools
import socket
import struct

import lcm
from drake import lcmt_iiwa_status

JOINTS = 7
HOST, PORT = "127.0.0.1", 32000  # the computer that runs sero-mj

counts = itertools.count(1)
to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)


def send(channel, data):
    """Sends the joint angles (rad) and torques (Nm) of one status message.

    The driver publishes KUKA's torques, which have the opposite sign.
    """
    status = lcmt_iiwa_status.decode(data)
    values = (
        *status.joint_position_measured,
        *(-torque for torque in status.joint_torque_measured),
        *(-torque for torque in status.joint_torque_commanded),
    )
    packet = struct.pack(f"<Id{3 * JOINTS}d", next(counts), 1e-6 * status.utime, *values)
    to.sendto(packet, (HOST, PORT))


line = lcm.LCM()
line.subscribe("IIWA_STATUS", send)
while True:
    line.handle()
