"""Runs: logs with one row per step.

In: a simulation, or a recording of a robot with its scene's routes. Out: a `RunLog`, measures of
it, and detected faults.
Open first: `run_log.py`; `run_recording.py` reads recordings, `measures.py` lists all measures.
"""
