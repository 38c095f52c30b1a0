"""Values to files and back.

In: packets of sources, or rows of a run. Out: MCAP recordings, whole also when the process is
killed; CSV tables; and `Replay`, a source that plays recordings.
Open first: `recorder.py` to write (`triggered_recorder.py` what is about events), `recording.py` to
read, `replay.py` to play. Another format has what `RecordingWriter` has to be written, `Recording`
to be read: raw packets, byte for byte, with the declaration of their source. The rooms `drive`
(live sources) and `simulate` (runs) use them.
"""
