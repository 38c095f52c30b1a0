"""Sends the state of a Universal Robots arm to sero-mj, with ur_rtde: `python ur.py ROBOT_IP`."""

import itertools
import socket
import struct
import sys
import time

from rtde_receive import RTDEReceiveInterface

JOINTS = 6
HOST, PORT = "127.0.0.1", 32000  # where sero-mj runs
RATE = 125.0  # 1/s

robot = RTDEReceiveInterface(sys.argv[1], RATE)
# Torques from motor currents (newer controllers), or the commanded torques as a replacement.
measured = getattr(robot, "getActualCurrentAsTorque", robot.getTargetMoment)
to = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for count in itertools.count(1):
    values = (*robot.getActualQ(), *measured(), *robot.getTargetMoment())  # rad, Nm, Nm
    to.sendto(struct.pack(f"<Id{3 * JOINTS}d", count, time.time(), *values), (HOST, PORT))
    time.sleep(1.0 / RATE)
