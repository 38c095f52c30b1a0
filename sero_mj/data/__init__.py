"""Decodes bytes to values, values to poses, and records and replays both.

In: packets, shared memory, recordings. Out: the state of a world, every frame; recordings; packets
of simulated robots.
Open first: `receive/source.py`; then `drive/mirror.py`, `record/recorder.py`, `send/play.py`.
"""
