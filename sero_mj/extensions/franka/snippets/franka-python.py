"""Sends robot states to sero-mj. Call `send(state)` in your control loop with pylibfranka."""

import contextlib
import itertools
import socket
import struct
import time

JOINTS = 7
HOST, PORT = "127.0.0.1", 32000  # machine that runs sero-mj

_counts = itertools.count(1)
_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
_socket.setblocking(False)


def send(state):
    """Sends the joint angles (q) in rad, and the torques tau_J and tau_J_d in Nm."""
    values = (*state.q, *state.tau_J, *state.tau_J_d)
    packet = struct.pack(f"<Id{3 * JOINTS}d", next(_counts), time.time(), *values)
    with contextlib.suppress(OSError):  # HOST is unreachable
        _socket.sendto(packet, (HOST, PORT))


if __name__ == "__main__":  # mirror a robot that has no other client
    import sys

    import pylibfranka

    robot = pylibfranka.Robot(sys.argv[1])
    while True:
        send(robot.read_once())
