"""Simulated robots as `dm_env` and gymnasium environments, for learning.

In: a robot with a task, or a scenario. Out: episodes of control steps, each of several
steps of the simulation, with a checked action; of one robot, or of many that are stepped together.
Open first: `make.py`; `environment.py` is the loop, `tasks.py` what tasks do, `actions.py` what an
agent commands; `many.py` steps many; `gymnasium_env.py`, `gymnasium_vector.py` are for gymnasium.
"""
