"""`Viewer`: a window or page in a separate process, controlled by the user's program.

In: scenes, models, and the values that the program sets. Out: clicks, and the values of widgets.
Neither process waits for the other.
Open first: `viewer.py`. `process_main.py` runs in the viewer's process. Both use `memory.py`.
"""
