"""Values to `MjData`, every tick.

In: packets of sources and the scene's routes. Out: joint angles, frames and `userdata`, with every
follower and double in its place.
Open first: `mirror.py`; `route.py` says what a route means, `_router.py` applies them, `place.py`
moves what depends on them.
"""
