"""A slow reference implementation for checking packets, and a generator of malformed packets."""

from __future__ import annotations

import math
import struct

import numpy as np

# The structure under attack: an id, the size, a counter, values, a vector, a frame, an integer.
TEXT = "1H=0x2006 1H=size number:1I 7F 1Vf tool:1M 1h"
FORMAT = struct.Struct("<HHI7d3f16dh")
SPECIAL = np.array(
    [math.nan, math.inf, -math.inf, 5e-324, -5e-324, 1e-310, 1.7e308, -1.7e308, 0.0, -0.0]
)
LENGTHS = (0, 1, 7, 8, 9, 100, FORMAT.size - 1, FORMAT.size + 1, 1472, 1473, 9000, 65_507)


def good_packet(random: np.random.Generator, number: int) -> bytes:
    """Returns a packet that must be applied, whatever its finite values are."""
    matrix = np.eye(4)
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    matrix[:3, 3] = random.normal(size=3)
    values = random.normal(size=7) * 10.0 ** random.integers(-300, 300)
    vector = random.normal(size=3).astype(np.float32)
    return FORMAT.pack(
        0x2006, FORMAT.size, number % 2**32, *values, *vector, *matrix.T.ravel(), number % 2**15
    )


def bad_packet(random: np.random.Generator, number: int) -> bytes:
    """Returns a modified packet or noise; by chance it may be valid."""
    packet = bytearray(good_packet(random, number))
    kind = random.integers(8)
    if kind == 0:  # any length, truncated or with noise appended
        length = int(random.choice(LENGTHS) if random.random() < 0.1 else random.integers(0, 400))
        return bytes(packet[:length]) + random.bytes(max(length - len(packet), 0))
    if kind == 1:
        return random.bytes(FORMAT.size)
    if kind == 2:  # a flipped bit
        packet[random.integers(len(packet))] ^= 1 << int(random.integers(8))
    elif kind == 3:  # a special value among the values
        struct.pack_into("<d", packet, 8 + 8 * int(random.integers(7)), random.choice(SPECIAL))
    elif kind == 4:
        special = np.float32(random.choice(SPECIAL[[0, 1, 2, 8, 9]]))
        struct.pack_into("<f", packet, 64 + 4 * int(random.integers(3)), special)
    elif kind == 5:  # or in the frame
        struct.pack_into("<d", packet, 76 + 8 * int(random.integers(16)), random.choice(SPECIAL))
    elif kind == 6:  # another id, another size
        struct.pack_into("<H", packet, 2 * int(random.integers(2)), int(random.integers(65536)))
    else:
        start = int(random.integers(len(packet)))
        packet[start:] = bytes(len(packet) - start)
    return bytes(packet)


def cause(packet: bytes) -> str:
    """Returns the name of the counter that must reject a packet, or "" for a valid packet."""
    if len(packet) != FORMAT.size:
        return "wrong_size"
    numbers = FORMAT.unpack(packet)
    if numbers[0] != 0x2006 or numbers[1] != FORMAT.size:
        return "wrong_constant"
    if not all(map(math.isfinite, numbers)):
        return "not_finite"
    return "" if _is_frame(numbers[13:29]) else "not_frames"


def _is_frame(numbers: tuple[float, ...]) -> bool:
    columns = [numbers[4 * k : 4 * k + 4] for k in range(4)]
    if any(abs(columns[k][3] - (k == 3)) > 1e-6 for k in range(4)):
        return False
    axes = [column[:3] for column in columns[:3]]
    if any(abs(entry) > 2.0 for axis in axes for entry in axis):  # otherwise products overflow
        return False
    # Rows of the rotation, because orthonormal rows imply orthonormal columns.
    rows = list(zip(*axes, strict=True))
    for i in range(3):
        for j in range(3):
            product = sum(a * b for a, b in zip(rows[i], rows[j], strict=True))
            if abs(product - (i == j)) > 1e-3:
                return False
    (a, b, c), (d, e, f), (g, h, i_) = rows
    determinant = a * (e * i_ - f * h) - b * (d * i_ - f * g) + c * (d * h - e * g)
    return determinant > 0


def values_of(packet: bytes) -> dict[str, list[float]]:
    """Returns the values of a valid packet as flat lists by event."""
    numbers = FORMAT.unpack(packet)
    frame = [numbers[13 + 4 * column + row] for row in range(4) for column in range(4)]
    return {
        "number": [float(numbers[2])],
        "values0": list(numbers[3:10]),
        "vectors0": list(numbers[10:13]),
        "tool": frame,
        "values1": [float(numbers[29])],
    }
