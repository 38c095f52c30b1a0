"""A controller for sero-mj as a separate program, over UDP. It requires only numpy.

sero-mj simulate controller.toml     (sero-mj new --snippet controller-udp-python --scene prints it)
"""

import socket
import sys

import numpy as np

JOINTS = 7
STATE = np.dtype([("step", "<u4"), ("flags", "<u4"), ("time", "<f8")] + [
    (name, "<f8", JOINTS)  # rad, rad/s, Nm
    for name in ("angles", "velocities", "torques", "target_angles", "target_velocities", "gravity")
])  # fmt: skip
ANSWER = np.dtype([("step", "<u4"), ("unused", "<u4"), ("torques", "<f8", JOINTS)])
port = int(sys.argv[1]) if len(sys.argv) > 1 else 32010

received, answer = bytearray(STATE.itemsize), np.zeros(1, ANSWER)
state = np.frombuffer(received, STATE)[0]
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
    peer.bind(("127.0.0.1", port))
    while True:
        size, robot = peer.recvfrom_into(received)
        # Joint impedance: stiffness and damping about the target, plus gravity compensation.
        answer["step"] = state["step"]
        answer["torques"] = (
            800.0 * (state["target_angles"] - state["angles"])
            + 40.0 * (state["target_velocities"] - state["velocities"])
            + state["gravity"]
        )
        peer.sendto(answer, robot)
