"""Writes joint angles and torques of an LWR to shared memory at 500 Hz, for lwr_shm.toml.

Usage: python lwr_shm_writer.py [block [seconds]]
"""

import math
import struct
import sys
import time
from multiprocessing.shared_memory import SharedMemory

PACKET = struct.Struct("<7d7d")  # after the lock; structure = "lock:1Q angles:7d torques:7d"
LOCK = struct.Struct("<Q")

name = (sys.argv[1] if len(sys.argv) > 1 else "sero_lwr").lstrip("/")
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 3600.0
try:
    block = SharedMemory(name, create=True, size=LOCK.size + PACKET.size)
except FileExistsError:  # left over from a writer that was killed
    old = SharedMemory(name)
    old.close()
    old.unlink()
    block = SharedMemory(name, create=True, size=LOCK.size + PACKET.size)
start = time.monotonic()
try:
    for k in range(round(seconds * 500)):
        angles = [0.6 * math.sin(k / 500 + joint) for joint in range(7)]
        torques = [20.0 * math.cos(k / 500 + joint) for joint in range(7)]
        # The lock is odd while the packet is being written. x86 processors preserve the order of
        # these writes. On ARM, Python cannot enforce it: use the C writer there.
        LOCK.pack_into(block.buf, 0, 2 * k + 1)
        PACKET.pack_into(block.buf, LOCK.size, *angles, *torques)
        LOCK.pack_into(block.buf, 0, 2 * k + 2)
        time.sleep(max(start + (k + 1) / 500 - time.monotonic(), 0.0))
except KeyboardInterrupt:
    pass
block.close()
block.unlink()
