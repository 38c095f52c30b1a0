"""Tools for robots that are simulated while they are shown. They connect `simulate` with `viewer`.

In: pointer, keys and panel of a window or page. Out: forces on links, changes of targets,
controllers and gains, and bookmarks of faults.
Open first: `steering.py` and `pulling.py`; they are entry points in the group `sero_mj.tools`.
"""
