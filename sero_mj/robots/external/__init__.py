"""Provides a `WorldView` of external models, which sero-mj did not compile.

In: an `MjModel` and its `MjData`. Out: a `ModelWorld` with the robots, joints and frames of the
model, and the sizes of their arrows and axes.
Open first: `model_world.py`. `_model_trees.py` finds robots, and `_model_robot.py` declares them.
"""
