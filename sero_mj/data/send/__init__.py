"""Sends packets as a robot would, to test receivers.

In: a scene, a motion or a recording. Out: packets in the layout of a source, at an exact rate, by
UDP or shared memory.
Open first: `play.py`; `sender.py` sends packets on time.
"""
