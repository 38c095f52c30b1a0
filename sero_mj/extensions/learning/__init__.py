"""Simulated robots as `dm_env` and Gymnasium environments, for reinforcement learning.

In: a robot with a task, or a scenario. Out: episodes of one robot, or of many in parallel.
Open first: `make.py`. `environment.py` has the loop, `tasks.py` the tasks, `actions.py` the
actions, and `many.py` steps many environments together.
"""
