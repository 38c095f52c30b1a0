"""`Viewer`: a window or page in a separate process, controlled by a loop in the user's program.

In: scenes, models, and the values that the loop sets. Out: clicks, and the values of widgets.
Neither process waits for the other.
Open first: `viewer.py`; `process_main.py` runs in the other process, and both share `memory.py`.
"""
