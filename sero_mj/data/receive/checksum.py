"""Checksums of packets: sums, XOR, and common cyclic redundancy checks (CRC).

Names, parameters and check values of CRCs are from the catalogue of parametrised CRC algorithms
by G. Cook (https://reveng.sourceforge.io/crc-catalogue/).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

_Words = NDArray[np.uint32]

_BLOCK = 256  # bytes of a message that the tables of a CRC cover


@dataclass(frozen=True)
class Crc:
    """Parameters of a cyclic redundancy check, named as in the catalogue.

    Attributes:
        width: number of bits: 8, 16 or 32.
        is_reflected: value of both `refin` and `refout` in the catalogue.
        check: CRC of the ASCII text `123456789`.
    """

    width: int
    poly: int
    init: int
    is_reflected: bool
    xorout: int
    check: int


CRCS = {
    "CRC-8/SMBUS": Crc(8, 0x07, 0x00, False, 0x00, 0xF4),
    "CRC-8/MAXIM-DOW": Crc(8, 0x31, 0x00, True, 0x00, 0xA1),
    "CRC-8/SAE-J1850": Crc(8, 0x1D, 0xFF, False, 0xFF, 0x4B),
    "CRC-8/AUTOSAR": Crc(8, 0x2F, 0xFF, False, 0xFF, 0xDF),
    "CRC-16/MODBUS": Crc(16, 0x8005, 0xFFFF, True, 0x0000, 0x4B37),
    "CRC-16/IBM-3740": Crc(16, 0x1021, 0xFFFF, False, 0x0000, 0x29B1),
    "CRC-16/XMODEM": Crc(16, 0x1021, 0x0000, False, 0x0000, 0x31C3),
    "CRC-16/ARC": Crc(16, 0x8005, 0x0000, True, 0x0000, 0xBB3D),
    "CRC-16/KERMIT": Crc(16, 0x1021, 0x0000, True, 0x0000, 0x2189),
    "CRC-16/IBM-SDLC": Crc(16, 0x1021, 0xFFFF, True, 0xFFFF, 0x906E),
    "CRC-16/MCRF4XX": Crc(16, 0x1021, 0xFFFF, True, 0x0000, 0x6F91),
    "CRC-16/UMTS": Crc(16, 0x8005, 0x0000, False, 0x0000, 0xFEE8),
    "CRC-16/USB": Crc(16, 0x8005, 0xFFFF, True, 0xFFFF, 0xB4C8),
    "CRC-32/ISO-HDLC": Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xCBF43926),
    "CRC-32/ISCSI": Crc(32, 0x1EDC6F41, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xE3069283),
    "CRC-32/BZIP2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0xFFFFFFFF, 0xFC891918),
    "CRC-32/MPEG-2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0x00000000, 0x0376E6E7),
}
# Other names of CRCs in the catalogue and in libraries.
ALIASES = {
    "CRC-8": "CRC-8/SMBUS",
    "CRC-16": "CRC-16/ARC",
    "CRC-16/CCITT-FALSE": "CRC-16/IBM-3740",
    "CRC-16/AUTOSAR": "CRC-16/IBM-3740",
    "CRC-16/CCITT": "CRC-16/KERMIT",
    "CRC-16/X-25": "CRC-16/IBM-SDLC",
    "CRC-16/BUYPASS": "CRC-16/UMTS",
    "CRC-32": "CRC-32/ISO-HDLC",
    "CRC-32C": "CRC-32/ISCSI",
}
SUMS = ("sum", "-sum", "~sum", "xor")


def find_checksum(name: str) -> str | None:
    """Returns the official name of a checksum for an alias in any letter case; None if unknown."""
    for spelled in (name.lower(), name.upper()):
        if spelled in (*SUMS, *CRCS):
            return spelled
        if spelled in ALIASES:
            return ALIASES[spelled]
    return None


def width_of(name: str) -> int | None:
    """Returns the width of a checksum in bits, or None for sums, which can have any width."""
    return CRCS[name].width if name in CRCS else 8 if name == "xor" else None


def compute(name: str, rows: NDArray[np.uint8], bits: int) -> NDArray[np.uint64]:
    """Computes the checksums of n packets, shape (n,).

    Args:
        name: name in `CRCS`, or `sum` (sum of all bytes), `-sum` (two's complement of the sum),
            `~sum` (sum with inverted bits) or `xor` (exclusive or of all bytes).
        rows: covered bytes of each packet, shape (n, k), k >= 1.
        bits: width of the checksum in bits; sums are computed modulo 2**bits.
    """
    if name in CRCS:
        return _crcs(CRCS[name], rows).astype(np.uint64)
    if name == "xor":
        combined: NDArray[np.uint8] = np.bitwise_xor.reduce(rows, axis=1)
        return combined.astype(np.uint64)
    total = rows.sum(axis=1, dtype=np.uint64)
    if name != "sum":
        total = ~total + np.uint64(name == "-sum")
    within: NDArray[np.uint64] = total & np.uint64(2**bits - 1)
    return within


def _crcs(crc: Crc, rows: NDArray[np.uint8]) -> _Words:
    # A CRC is affine: it is the XOR of contributions of single bytes, which a table contains by
    # position and value. For longer messages, the register of a block is combined with the first
    # bytes of the next block.
    count = rows.shape[1]
    tables, width = _tables(crc), crc.width // 8
    register = np.zeros(len(rows), np.uint32)
    begin = 0
    while begin < count:
        # The first block is the shortest, so that the register fits into all others.
        end = begin + ((count - begin) % _BLOCK or _BLOCK)
        block = rows[:, begin:end]
        if begin:
            block = block.copy()
            block[:, :width] ^= _as_bytes(crc, register)
        places = np.arange(_BLOCK - (end - begin), _BLOCK)
        register = np.bitwise_xor.reduce(tables[places, block], axis=1)
        begin = end
    return register ^ np.uint32(_of_zeros(crc, count))


def _as_bytes(crc: Crc, registers: _Words) -> NDArray[np.uint8]:
    width = crc.width // 8
    order = "<" if crc.is_reflected else ">"
    registers = registers if crc.is_reflected else registers << np.uint32(32 - crc.width)
    return registers.astype(f"{order}u4").view(np.uint8).reshape(-1, 4)[:, :width]


def _step(crc: Crc, registers: Any, table: Any) -> Any:
    if crc.is_reflected:
        return registers >> 8 ^ table[registers & 0xFF]
    return (registers << 8) & (2**crc.width - 1) ^ table[registers >> (crc.width - 8)]


@cache
def _tables(crc: Crc) -> _Words:
    tables = np.empty((_BLOCK, 256), np.uint32)
    registers = table = np.array([_after_bits(crc, value) for value in range(256)], np.int64)
    for place in reversed(range(_BLOCK)):
        tables[place] = registers
        registers = _step(crc, registers, table)
    return tables


def _after_bits(crc: Crc, value: int) -> int:
    if crc.is_reflected:
        poly = int(f"{crc.poly:0{crc.width}b}"[::-1], 2)
        for _ in range(8):
            value = value >> 1 ^ (poly if value & 1 else 0)
        return value
    value <<= crc.width - 8
    for _ in range(8):
        high = value >> (crc.width - 1)
        value = (value << 1) & (2**crc.width - 1) ^ (crc.poly if high else 0)
    return value


@lru_cache(256)
def _of_zeros(crc: Crc, count: int) -> int:
    table = _tables(crc)[-1].tolist()
    register = crc.init  # equal to its reflection for all entries of `CRCS`
    for _ in range(count):
        register = _step(crc, register, table)
    return int(register) ^ crc.xorout
