"""The light of the sky around a scene: radiance, irradiance and reflections.

The light consists of the sky of the palette, a large lamp above, and light reflected by the ground.
It depends only on the elevation, so it does not tint one side of a robot. Occlusion darkens the
gaps between links. Filament and web pages use this light.
"""

from __future__ import annotations

import numpy as np

from ...base.frames import Array
from ...robots.declared.surroundings import Palette, Rgb

LEVELS = 6  # number of levels of roughness
_SHARPEST, _BLUREST = 0.03, 0.9  # standard deviation of the blur of the first and last level, rad
_LAMP = 0.12  # size of the lamp: 1 minus the sine of the elevation at which it fades
_HORIZON = 0.02  # width of the transition from ground to sky, sine of the elevation
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # weights of red, green and blue (ITU-R BT.709)


def linear(srgb: Array) -> Array:
    """Converts displayed colors (sRGB, 0 to 1) to linear light (0 to 1).

    Source: IEC 61966-2-1.
    """
    srgb = np.clip(srgb, 0.0, None)
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)


def shown(light: Array) -> Array:
    """Converts linear light to displayed colors (sRGB, 0 to 1). This is the inverse of `linear`."""
    light = np.clip(light, 0.0, None)
    return np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def _grey(rgb: Rgb) -> float:
    return float(linear(np.array(rgb)) @ _LUMINANCE)


class SkyLight:
    """The light around a scene with a palette, relative to white, for each elevation."""

    def __init__(self, palette: Palette) -> None:
        light = palette.physical
        self._horizon, self._zenith = (light.sky * _grey(rgb) for rgb in palette.sky)
        self._ground = light.ground * _grey(palette.tiles[1])
        self._lamp = light.softbox

    def radiance(self, up: Array) -> Array:
        """Returns the radiance of directions, given by the sines of their elevations."""
        up = np.asarray(up, float)
        high = np.clip(up, 0.0, 1.0)
        sky = self._horizon + (self._zenith - self._horizon) * np.sqrt(high)
        sky = sky + self._lamp * np.exp(-(((1.0 - high) / _LAMP) ** 2))
        share = 1.0 / (1.0 + np.exp(-np.clip(up / _HORIZON, -50.0, 50.0)))
        return np.asarray(share * sky + (1.0 - share) * self._ground)

    def irradiance(self) -> Array:
        """Returns coefficients (a, b, c) that approximate the irradiance of surfaces.

        The irradiance divided by pi is a + b y + c (3 y^2 - 1), where y is the sine of the
        elevation of the surface normal.
        """
        up, azimuth = np.linspace(-1.0, 1.0, 801), np.linspace(0.0, np.pi, 64)
        light, normals = self.radiance(up), np.linspace(-1.0, 1.0, 21)
        across = np.sqrt(1.0 - up**2)
        found = []
        for normal in normals.tolist():
            level = np.sqrt(1.0 - normal**2)
            cosines = up[:, None] * normal + across[:, None] * level * np.cos(azimuth)
            mean = np.maximum(cosines, 0.0).mean(axis=1)
            found.append(2.0 * np.trapezoid(light * mean, up))
        basis = np.stack([np.ones_like(normals), normals, 3.0 * normals**2 - 1.0], axis=1)
        return np.asarray(np.linalg.lstsq(basis, np.array(found), rcond=None)[0])

    def reflected(self, up: Array, level: int) -> Array:
        """Returns the radiance, shape (...), that surfaces of the same roughness reflect.

        Args:
            up: sines of the elevations of the directions that a mirror would reflect, shape (...).
            level: level of roughness, from 0 for a mirror to `LEVELS` - 1 for the roughest surface.
        """
        spread = _SHARPEST + (_BLUREST - _SHARPEST) * (level / (LEVELS - 1)) ** 2
        angles = np.linspace(-np.pi / 2, np.pi / 2, 181)
        weights = np.exp(-0.5 * ((angles[:, None] - angles) / spread) ** 2) * np.cos(angles)
        blurred = (weights / weights.sum(axis=1, keepdims=True)) @ self.radiance(np.sin(angles))
        return np.asarray(np.interp(np.arcsin(np.clip(up, -1.0, 1.0)), angles, blurred))
