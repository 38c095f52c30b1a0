"""Plays a robot, to test receivers.

In: a scene, a motion, a recording or a table. Out: packets in the layout of a source, at an exact
rate, by UDP or shared memory.
Open first: `play.py`; `sender.py` keeps the rate.
"""
