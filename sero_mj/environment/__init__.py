"""Simulated robots as `dm_env` environments, for learning.

In: a robot with a task, or a scenario. Out: episodes of control steps, each of several
steps of the simulation, with a checked action.
Open first: `make.py`; `environment.py` is the loop, `tasks.py` what tasks do, `actions.py` what an
agent commands.
"""
