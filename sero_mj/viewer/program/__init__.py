"""`Viewer`: a window or page in its own process, which a user's loop controls.

In: scenes, models, and the values that the loop sets. Out: clicks and the values of the user's
widgets. Neither process waits for the other.
Open first: `viewer.py`; `process_main.py` runs in the other process, and both share `memory.py`.
"""
