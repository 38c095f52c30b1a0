"""Many variants of a scenario, and mutations of it, here or on a Dask cluster.

In: a scenario and ranges of its values. Out: the command `sweep` and the engine `dask`.
Open first: `sweep.py`; `variant.py` runs variants together, `cluster.py` on other machines.
"""
