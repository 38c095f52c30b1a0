"""Tools for robots that are simulated while they are shown; connects `simulate` with `viewer`.

In: pointer, keys and panel of a window or page. Out: forces on links, targets, controllers and
their gains; bookmarks of faults.
Open first: `steering.py` and `pulling.py`; they are entry points in the group `sero_mj.tools`.
"""
