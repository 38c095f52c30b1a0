"""In your control loop: `send(state)`, with the state that pylibfranka has read."""

import contextlib
import itertools
import socket
import struct
import time

JOINTS = 7
HOST, PORT = "127.0.0.1", 32000  # where sero-mj runs

_counts = itertools.count(1)
_socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
_socket.setblocking(False)


def send(state):
    """Sends a state of the robot: q in rad, tau_J and tau_J_d in Nm."""
    values = (*state.q, *state.tau_J, *state.tau_J_d)
    packet = struct.pack(f"<Id{3 * JOINTS}d", next(_counts), time.time(), *values)
    with contextlib.suppress(OSError):  # where there is no way to HOST
        _socket.sendto(packet, (HOST, PORT))


if __name__ == "__main__":  # shows a robot that nothing else is connected to
    import sys

    import pylibfranka

    robot = pylibfranka.Robot(sys.argv[1])
    while True:
        send(robot.read_once())
