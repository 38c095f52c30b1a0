"""Universal Robots: RTDE, version 2 of its protocol.

In: a controller, or a client of one. Out: the source `rtde` and the controller kind `rtde` (a
simulated robot for a client).
Open first: `receiver.py`; `client.py` has the controller kind, `server.py` the simulated robot's
side of the protocol, `variables.py` its variables.
"""
