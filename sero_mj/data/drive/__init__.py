"""Values to `MjData`, every frame: from routes to poses.

In: packets of sources and the scene's routes. Out: joint angles, frames and `userdata`, with every
follower and double in its place.
Open first: `mirror.py`; `wiring.py` says what a route means, `place.py` applies routes and moves
what depends on them; `trigger.py` finds events in what comes.
"""
