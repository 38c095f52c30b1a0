"""Bytes to values, on a thread of each source's own.

In: UDP packets, shared memory, KUKA FRI. Out: checked packets by event name, and counters of all
that was not applied.
Open first: `source.py` (what a source is, and what all of them share); `structure.py` and
STRUCTURE.md are the packet language, `intake.py` is what a packet has to pass.
"""
