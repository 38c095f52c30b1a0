"""Receives packets in one thread per source, and decodes them when they are taken.

In: UDP packets and shared memory. Out: valid packets by event name, and counters of other packets.
The path of a UDP packet: `udp.UdpReceiver._receive` reads it, `intake.Intake.take` checks it,
`mailbox.Mailbox` stores it, and `structure.Structure.decode_rows` decodes it when `Source.take` is
called. STRUCTURE.md describes the structure language; `source.Source` is the base of all sources.
"""
