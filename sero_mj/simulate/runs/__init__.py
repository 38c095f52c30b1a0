"""What happened, a row for every step.

In: a simulation, or a recording of a robot with its scene's routes. Out: a `RunLog`, and what can
be asked of it: measures, and faults found.
Open first: `run_log.py`; `run_recording.py` makes one of a recording, `measures.py` lists what can
be asked.
"""
