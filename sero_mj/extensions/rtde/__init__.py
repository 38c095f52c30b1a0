"""Universal Robots: RTDE, version 2 of its protocol.

In: data packages of a controller, or an RTDE client. Out: the source `rtde`, and the controller
kind `rtde`, a simulated robot that RTDE clients control.
Open first: `receiver.py`, or `robot.py` for the simulated robot; `server.py` has its sockets.
"""
