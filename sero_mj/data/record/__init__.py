"""Writes packets to files and reads them.

In: packets of sources, or rows of a run. Out: MCAP recordings that are readable even if the process
is killed, CSV tables, and `Replay`, a source that plays recordings.
Open first: `recorder.py` to write (`triggered_recorder.py` around events), `recording.py` to read,
`replay.py` to play, `formats.py` to add a format.
"""
