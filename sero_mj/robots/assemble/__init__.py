"""Compiles the declaration of a scene into a world.

In: a `Scene`. Out: a `World` with the `MjModel`, ids by name, and slots of `MjData.userdata` for
values without a field in `MjData`.
Open first: `world.py`, then `mjcf.py`, which builds the model.
"""
