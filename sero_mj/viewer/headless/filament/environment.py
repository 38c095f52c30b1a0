"""The light of the sky around a scene, as the cube map that Filament's image-based light takes.

Its radiance depends on the elevation only: the sky of the palette, a large lamp above, and light
that comes back from the ground. So occlusion darkens where links meet, and no side is tinted.
"""

from __future__ import annotations

import struct
from functools import lru_cache

import numpy as np

from ....base.frames import Array
from ....robots.declared.surroundings import Palette, Rgb

_SIDE, _LEVELS = 32, 6  # pixels of the sharpest level, and levels down to one pixel
_SHARPEST, _BLUREST = 0.03, 0.9  # rad, standard deviation of the blur of the first and last level
_LAMP = 0.12  # of the lamp above, 1 - sine of the elevation at which it fades
_HORIZON = 0.02  # sine of the elevation over which the ground becomes the sky
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of red, green and blue; ITU-R BT.709
# KTX 1.1 of three small floats (OpenGL's R11F_G11F_B10F) a pixel, the format of MuJoCo's own.
_MAGIC = b"\xabKTX 11\xbb\r\n\x1a\n"
_ENDIANNESS, _GL_RGB, _R11F_G11F_B10F = 0x04030201, 0x1907, 0x8C3A


def linear(srgb: Array) -> Array:
    """Returns linear light, 0 to 1, of colours as they are shown, 0 to 1.

    Source: IEC 61966-2-1 (sRGB).
    """
    srgb = np.clip(srgb, 0.0, None)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def shown(light: Array) -> Array:
    """Returns colours as they are shown, the inverse of `linear`."""
    light = np.clip(light, 0.0, None)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


@lru_cache(maxsize=4)
def environment(look: str, palette: Palette) -> bytes:
    """Returns a cube map, a file of KTX, of the light around a scene.

    Args:
        look: of the palette, whose name it is.
        palette: colours, and how bright the sky, the ground and the lamp are.
    """
    radiance = _Radiance(palette)
    header = struct.pack(
        "<13I", _ENDIANNESS, _R11F_G11F_B10F, 1, _GL_RGB, _R11F_G11F_B10F, _R11F_G11F_B10F,
        _SIDE, _SIDE, 0, 0, 6, _LEVELS, len(about := _harmonics(radiance)),
    )  # fmt: skip
    return b"".join([_MAGIC, header, about, *(_level(radiance, k) for k in range(_LEVELS))])


def _grey(rgb: Rgb) -> Array:
    """Returns linear light (3) without a tint: colours are to look as they are declared."""
    return np.full(3, linear(np.array(rgb)) @ _LUMINANCE)


class _Radiance:
    """Radiance by the sine of the elevation, relative to white."""

    def __init__(self, palette: Palette) -> None:
        light = palette.physical
        self._horizon, self._zenith = (light.sky * _grey(rgb) for rgb in palette.sky)
        self._ground = light.ground * _grey(palette.tiles[1])
        self._lamp = light.softbox

    def __call__(self, up: Array) -> Array:
        """Radiance (..., 3) for the sines (...)."""
        up = np.asarray(up, float)[..., None]
        high = np.clip(up, 0.0, 1.0)
        sky = self._horizon + (self._zenith - self._horizon) * np.sqrt(high)
        sky = sky + self._lamp * np.exp(-(((1.0 - high) / _LAMP) ** 2))
        share = 1.0 / (1.0 + np.exp(-np.clip(up / _HORIZON, -50.0, 50.0)))
        return np.asarray(share * sky + (1.0 - share) * self._ground)


def _harmonics(radiance: _Radiance) -> bytes:
    """Returns KTX's metadata: spherical harmonics of the irradiance, as Filament reads them.

    It evaluates c0 + c1 y + c2 z + c3 x + c4 xy + c5 yz + c6 (3 z^2 - 1) + c7 xz + c8 (x^2 - y^2)
    for the normal (x, y, z) with y up, of which a + b y + c (3 y^2 - 1) are left here: with
    x^2 + y^2 + z^2 = 1, 3 y^2 - 1 is -(3 z^2 - 1) / 2 - 3/2 (x^2 - y^2).
    """
    up, azimuth = np.linspace(-1.0, 1.0, 801), np.linspace(0.0, np.pi, 64)
    light, normals = radiance(up), np.linspace(-1.0, 1.0, 21)
    across = np.sqrt(1.0 - up**2)
    found = []
    for normal in normals.tolist():
        level = np.sqrt(1.0 - normal**2)
        cosines = up[:, None] * normal + across[:, None] * level * np.cos(azimuth)
        mean = np.maximum(cosines, 0.0).mean(axis=1)[:, None]
        found.append(2.0 * np.trapezoid(light * mean, up, axis=0))  # irradiance over pi
    basis = np.stack([np.ones_like(normals), normals, 3.0 * normals**2 - 1.0], axis=1)
    a, b, c = np.linalg.lstsq(basis, np.array(found), rcond=None)[0]
    rows = np.zeros((9, 3))
    rows[0], rows[1], rows[6], rows[8] = a, b, -c / 2.0, -1.5 * c
    text = "".join(" ".join(f"{value:.6g}" for value in row) + "\n" for row in rows)
    entry = b"sh\0" + text.encode()
    return struct.pack("<I", len(entry)) + entry + b"\0" * (-len(entry) % 4)


def _level(radiance: _Radiance, level: int) -> bytes:
    """Returns a level of the cube map: all faces, blurred as surfaces of a roughness reflect it."""
    side = _SIDE >> level
    centres = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    right, down = np.meshgrid(centres, centres)
    one = np.ones_like(right)
    # The vertical coordinates of directions of +x, -x, +y, -y, +z and -z, before normalization.
    heights = np.stack([-down, -down, one, -one, -down, -down])
    up = heights / np.sqrt(1.0 + right**2 + down**2)
    spread = _SHARPEST + (_BLUREST - _SHARPEST) * (level / (_LEVELS - 1)) ** 2
    angles = np.linspace(-np.pi / 2, np.pi / 2, 181)
    weights = np.exp(-0.5 * ((angles[:, None] - angles) / spread) ** 2) * np.cos(angles)
    blurred = (weights / weights.sum(axis=1, keepdims=True)) @ radiance(np.sin(angles))
    at = np.arcsin(np.clip(up, -1.0, 1.0))
    rgb = np.stack([np.interp(at, angles, blurred[:, k]) for k in range(3)], axis=-1)
    # Of a half float without its sign, the upper 11 or 10 bits.
    bits = rgb.astype(np.float16).view(np.uint16).astype(np.uint32)
    packed = (bits[..., 0] >> 4) | ((bits[..., 1] >> 4) << 11) | ((bits[..., 2] >> 5) << 22)
    return struct.pack("<I", 4 * side * side) + packed.astype("<u4").tobytes()
