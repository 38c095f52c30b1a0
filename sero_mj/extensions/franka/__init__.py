"""Receives states of Franka robots, and simulates Franka robots for clients that use libfranka.

In: states of a robot, or a client that uses the Franka Control Interface (FCI). Out: the source
`franka`, and the controller kind `franka`, a simulated robot for such a client.
Open first: `receiver.py`, or `robot.py` for the simulated robot. `messages.py` has the protocol.
"""
