"""Franka Robotics: the Franka Control Interface (FCI).

In: a robot, or a client that uses libfranka. Out: the source `franka` and the controller kind
`franka` (a simulated robot for a client).
Open first: `receiver.py`; `client.py` has the controller kind, `robot.py` the simulated robot,
`messages.py` the protocol.
"""
