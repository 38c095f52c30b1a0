"""Writes received values to `MjData` in every frame, according to the routes of a scene.

In: packets of sources and the scene's routes. Out: joint angles, frames and `userdata`, including
the poses of followers and doubles.
Open first: `mirror.py`; `wiring.py` interprets routes, `place.py` applies them and moves what
depends on them; `trigger.py` finds events in received packets.
"""
