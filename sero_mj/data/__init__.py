"""Bytes to values, values to poses, and both to files and back.

In: packets, shared memory, recordings. Out: the state of a world, every frame; recordings; packets
of robots that we play.
Open first: `receive/source.py`; then `drive/mirror.py`, `record/recorder.py`, `send/play.py`.
"""
