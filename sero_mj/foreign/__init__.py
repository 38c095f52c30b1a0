"""Somebody else's model, seen as a world.

In: an `MjModel` and `MjData` that sero-mj has not made. Out: a `ModelWorld`, of which decor reads
what it reads of a `World`: robots, joints, frames and sizes, found in the model.
Open first: `model_world.py`; `model_trees.py` finds robots, `model_sizes.py` says how large their
decor is.
"""
