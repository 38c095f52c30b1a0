"""The viewer of a program: `Viewer`, which a loop of the user's own steers and reads.

In: scenes, models, and what the loop sets. Out: the same into a process of its own, which draws at
its own rate, so that neither waits for the other; clicks and the user's widgets come back.
Open first: `viewer.py`; `process_main.py` is what runs in the other process, `memory.py` what both
share.
"""
