"""Universal Robots: RTDE, version 2 of its protocol.

The source `rtde` receives data packages of a controller. The controller kind `rtde` is a simulated
robot that an RTDE client controls.
Open first: `receiver.py`, or `robot.py` for the simulated robot; `server.py` has its sockets.
"""
