"""Compile the declaration of a scene into a world, once.

In: a `Scene`. Out: a `World`: the `MjModel`, ids by name, and slots of `MjData.userdata` for values
without a field in `MjData`.
Open first: `world.py`; then `mjcf.py` for building the model.
"""
