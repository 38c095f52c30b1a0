"""External models: a `WorldView` of a model not compiled by sero-mj.

In: an `MjModel` and its `MjData`. Out: a `ModelWorld`, with the robots, joints, frames and decor
sizes that decor reads of a `World`, derived from the model.
Open first: `model_world.py`; `_model_trees.py` finds robots, `_model_robot.py` declares them.
"""
