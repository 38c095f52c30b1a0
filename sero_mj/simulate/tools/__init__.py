"""Tools for what is simulated while it is shown: the one place where `simulate` knows `viewer`.

In: pointer, keys and panel of a window or page. Out: forces on links, targets, controllers and
their gains; bookmarks at faults of runs.
Open first: `steering.py` and `pulling.py`; they are entry points in the group `sero_mj.tools`.
"""
