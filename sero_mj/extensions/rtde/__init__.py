"""Universal Robots: RTDE, version 2 of its protocol.

Registers the source `rtde`, and the controller kind `rtde`, a simulated robot for clients of RTDE.
Start with `receiver.py`, or with `robot.py` for the simulated robot.
"""
