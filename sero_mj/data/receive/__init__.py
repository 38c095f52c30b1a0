"""Receives packets in one thread per source, and decodes them when they are taken.

In: UDP packets and shared memory. Out: valid packets by event name, and counters of other packets.
Open first: `source.py`, the base of all sources; STRUCTURE.md describes the structure language.
A UDP packet is read by `UdpReceiver._receive` in `udp.py`, checked by `Intake.take` in `intake.py`,
stored by `Mailbox` in `mailbox.py`, and decoded by `Structure.decode_rows` in `structure.py` when
`Source.take` is called.
"""
