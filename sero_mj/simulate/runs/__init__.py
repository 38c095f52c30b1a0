"""Logs of runs, with one row per step.

In: a simulation, or a recording of a robot and the routes of its scene. Out: a `RunLog`, its
measures, and detected faults.
Open first: `run_log.py`; `run_recording.py` reads recordings, `measures.py` lists all measures.
"""
