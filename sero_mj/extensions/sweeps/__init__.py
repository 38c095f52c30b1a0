"""Runs many variants or mutations of a scenario, locally or on a Dask cluster.

In: a scenario and ranges of values. Out: the command `sweep` and the engine `dask`.
Open first: `sweep.py`; `variant.py` runs variants together, `cluster.py` runs them on other
machines.
"""
