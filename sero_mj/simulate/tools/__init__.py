"""Tools for robots that are simulated while they are shown. They connect `simulate` with `viewer`.

With pointer, keys and panel of a window or page, users apply forces to links, move targets, change
controllers and gains, and go to bookmarks of faults.
Open first: `steering.py` and `pulling.py`; they are entry points in the group `sero_mj.tools`.
"""
