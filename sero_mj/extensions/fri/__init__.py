"""KUKA's Fast Research Interface (FRI), version 1.0 of the LWR 4, and 1.x and 2.x of the LBR iiwa.

In: packets of a controller, or an FRI client. Out: the source `fri`, the controller kind `fri`, a
simulated robot for FRI clients, and the emulated controller of `sero-mj send`.
Open first: `receiver.py`, or `robot.py` for the simulated robot; `iiwa.py` has the messages of the
iiwa.
"""
