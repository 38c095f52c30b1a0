"""Values to files and back.

In: packets of sources, or rows of a run. Out: MCAP recordings and CSV tables, whole also when the
process is killed; and `Replay`, a source that plays them.
Open first: `recorder.py` to write, `recording.py` to read, `replay.py` to play.
"""
