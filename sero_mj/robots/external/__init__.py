"""Provides a `WorldView` of external models, which sero-mj did not compile.

The input is an `MjModel` with its `MjData`. The output is a `ModelWorld` with the robots, joints
and frames of the model, and the sizes of their arrows and axes.
Start with `model_world.py`. `_model_trees.py` finds robots, and `_model_robot.py` declares them.
"""
