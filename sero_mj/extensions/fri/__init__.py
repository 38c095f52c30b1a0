"""KUKA's Fast Research Interface: 1.0 of the LWR 4, 1.x and 2.x of the LBR iiwa.

In: packets of a controller, or a simulated robot. Out: the source `fri`, the controller kind `fri`
(a simulated robot for a client of FRI), and what `sero-mj send` does as a controller.
Open first: `receiver.py`; `iiwa.py` has the messages of the iiwa, `client.py` the controller kind,
`robot.py` the simulated robot, `controller.py` the emulated controller of `send`.
"""
