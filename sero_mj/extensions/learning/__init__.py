"""Simulated robots as `dm_env` and Gymnasium environments, for reinforcement learning.

In: a robot with a task, or a scenario. Out: episodes of one robot, or of many in parallel.
Open first: `make.py`. `environment.py` runs episodes, `tasks.py` and `actions.py` define tasks and
actions, and `many.py` steps many environments together.
"""
