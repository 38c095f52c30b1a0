"""Compiles the declaration of a scene into a world.

The input is a `Scene`. The output is a `World`, which contains the `MjModel`, ids by name, and
slots of `MjData.userdata` for values without a field in `MjData`.
Start with `world.py`, and continue with `mjcf.py`, which builds the model.
"""
