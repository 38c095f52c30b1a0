"""Logs of runs, with one row per step.

A `RunLog` comes from a simulation, or from a recording of a robot and the routes of its scene. Its
measures and faults can be computed.
Open first: `run_log.py`; `run_recording.py` reads recordings, `measures.py` lists all measures.
"""
