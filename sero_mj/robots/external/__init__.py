"""Provides a `WorldView` of external models, which sero-mj did not compile.

In: an `MjModel` and its `MjData`. Out: a `ModelWorld` with the robots, joints and frames of the
model, and the sizes of their decor.
Open first: `model_world.py`; `_model_trees.py` finds robots, `_model_robot.py` declares them.
"""
