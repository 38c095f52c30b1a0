"""Simulated robots as `dm_env` environments, for learning.

In: a robot with a task, or a scenario. Out: episodes of control steps with a checked action each.
Open first: `make.py`; `episodes.py` is what all environments share, `task.py` what tasks do.
"""
