"""Writes an LWR's joint angles and torques to shared memory at 500 Hz, for lwr_shm.toml.

python lwr_shm_writer.py [block [seconds]]
"""

import math
import struct
import sys
import time
from multiprocessing.shared_memory import SharedMemory

PACKET = struct.Struct("<7d7d")  # behind the lock; structure = "lock:1Q angles:7d torques:7d"
LOCK = struct.Struct("<Q")

name = (sys.argv[1] if len(sys.argv) > 1 else "sero_lwr").lstrip("/")
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 3600.0
try:
    block = SharedMemory(name, create=True, size=LOCK.size + PACKET.size)
except FileExistsError:  # a writer before us was killed
    old = SharedMemory(name)
    old.close()
    old.unlink()
    block = SharedMemory(name, create=True, size=LOCK.size + PACKET.size)
start = time.monotonic()
try:
    for k in range(round(seconds * 500)):
        angles = [0.6 * math.sin(k / 500 + joint) for joint in range(7)]
        torques = [20.0 * math.cos(k / 500 + joint) for joint in range(7)]
        # Odd while the packet is being written. Processors of Intel and AMD keep this order; on
        # others (ARM) Python cannot demand it: see the writer in C.
        LOCK.pack_into(block.buf, 0, 2 * k + 1)
        PACKET.pack_into(block.buf, LOCK.size, *angles, *torques)
        LOCK.pack_into(block.buf, 0, 2 * k + 2)
        time.sleep(max(start + (k + 1) / 500 - time.monotonic(), 0.0))
except KeyboardInterrupt:
    pass
block.close()
block.unlink()
