"""KUKA's Fast Research Interface: 1.0 of the LWR 4, 1.x and 2.x of the LBR iiwa.

Registers the source `fri`, the controller kind `fri`, a simulated robot for clients of FRI, and
the emulated controller of `sero-mj send`. Start with `receiver.py`, or with `robot.py` for the
simulated robot.
"""
