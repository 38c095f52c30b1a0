"""Receives packets on a separate thread for each source, and decodes them when they are taken.

In: UDP packets and shared memory. Out: checked packets by event name, and counters of rejected
ones.
Open first: `source.py` (the common base of sources); `structure.py` decodes packets
(`decode_rows`), in the language that STRUCTURE.md explains; `intake.py` checks and counts them.
"""
