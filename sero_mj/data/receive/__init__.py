"""Decodes bytes to values, on a separate thread for each source.

In: UDP packets, shared memory, KUKA FRI, UR RTDE, Franka FCI. Out: checked packets by event name,
and counters of rejected ones.
Open first: `source.py` (the common base of sources); `structure.py` decodes packets, in the
language that STRUCTURE.md explains; `intake.py` checks and counts them.
"""
