"""What the user's pointer and keys do to robots and to time.

In: a host's events and its world. Out: poses, pushes and targets of robots; the past of what is
live: kept, marked, undone.
Open first: `jogging.py`, `pulling.py` and `steering.py` (robots without data, simulated ones, and
their targets); `bookmarks.py` and `rolling_recorder.py` for the past.
"""
