"""Converts the light of the sky to a cube map for image-based lighting in Filament."""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np

from ...robots.declared.surroundings import Palette
from ...viewer.image.sky_light import LEVELS, SkyLight

_SIDE = 32  # side of the sharpest level in pixels; the last level has one pixel
# The file has the format KTX 1.1 with three small floats per pixel (R11F_G11F_B10F), as in MuJoCo.
_MAGIC = b"\xabKTX 11\xbb\r\n\x1a\n"
_ENDIANNESS, _GL_RGB, _R11F_G11F_B10F = 0x04030201, 0x1907, 0x8C3A


@lru_cache(maxsize=4)
def environment(look: str, palette: Palette) -> bytes:
    """Returns a cube map of the light around a scene as the contents of a KTX file."""
    light = SkyLight(palette)
    header = struct.pack(
        "<13I", _ENDIANNESS, _R11F_G11F_B10F, 1, _GL_RGB, _R11F_G11F_B10F, _R11F_G11F_B10F,
        _SIDE, _SIDE, 0, 0, 6, LEVELS, len(about := _harmonics(light)),
    )  # fmt: skip
    return b"".join([_MAGIC, header, about, *(_level(light, k) for k in range(LEVELS))])


def _harmonics(light: SkyLight) -> bytes:
    """Returns KTX metadata with the spherical harmonics of the irradiance for Filament.

    Filament evaluates c0 + c1 y + c2 z + c3 x + c4 xy + c5 yz + c6 (3 z^2 - 1) + c7 xz + c8 (x^2 -
    y^2) for the normal (x, y, z) with y up. The irradiance of the sky is a + b y + c (3 y^2 - 1).
    With x^2 + y^2 + z^2 = 1, the last term follows from 3 y^2 - 1 = -(3 z^2 - 1) / 2 - 3/2 (x^2 -
    y^2).
    """
    a, b, c = light.irradiance()
    rows = np.zeros((9, 3))
    rows[0], rows[1], rows[6], rows[8] = a, b, -c / 2.0, -1.5 * c
    text = "".join(" ".join(f"{value:.6g}" for value in row) + "\n" for row in rows)
    entry = b"sh\0" + text.encode()
    return struct.pack("<I", len(entry)) + entry + b"\0" * (-len(entry) % 4)


def _level(light: SkyLight, level: int) -> bytes:
    side = _SIDE >> level
    centres = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    right, down = np.meshgrid(centres, centres)
    one = np.ones_like(right)
    # Vertical coordinates of the directions on the faces +x, -x, +y, -y, +z and -z.
    heights = np.stack([-down, -down, one, -one, -down, -down])
    up = heights / np.sqrt(1.0 + right**2 + down**2)
    # Small floats are the upper 11 or 10 bits of half floats without their sign.
    bits = light.reflected(up, level).astype(np.float16).view(np.uint16).astype(np.uint32)
    packed = (bits >> 4) | ((bits >> 4) << 11) | ((bits >> 5) << 22)
    return struct.pack("<I", 4 * side * side) + packed.astype("<u4").tobytes()
