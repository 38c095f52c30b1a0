"""Tools that need no simulation: what pointer and keys do to robots and to time.

In: a host's events and its world. Out: poses, pushes and targets of robots; the past of what is
live kept; changes undone.
Open first: `jogging.py` (robots without data) and `undo.py`; all are entry points in the group
`sero_mj.tools`, see `session.tool`.
"""
