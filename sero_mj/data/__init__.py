"""Receives packets, applies them to a world, and records, replays and sends them.

In: packets, shared memory, recordings. Out: the state of a world for each frame; recordings;
packets.
Open first: `receive/source.py`; then `drive/mirror.py`, `record/recorder.py`, `send/play.py`.
"""
