"""Writes packets to files and reads them back.

In: packets of sources, or rows of a run. Out: MCAP recordings, readable even after the process is
killed; CSV tables; and `Replay`, a source that plays recordings.
Open first: `recorder.py` to write (`triggered_recorder.py` around events), `recording.py` to read,
`replay.py` to play. Another format needs the interfaces of `RecordingWriter` and `Recording`: raw
packets, byte for byte, with the declaration of their source. The rooms `drive` (live sources) and
`simulate` (runs) use them.
"""
