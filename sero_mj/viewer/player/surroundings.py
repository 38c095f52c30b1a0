"""The surroundings of robots in pages: the palettes of the light and dark look, and the floor.

Pages use the same light as Filament, see `image/sky_light.py`.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import mujoco
import numpy as np

from ...robots.assemble.world_view import WorldView
from ...robots.declared.surroundings import KEY_DIRECTION, PALETTES, Palette
from ..image.sky_light import LEVELS, SkyLight
from .model import our_floor
from .packing import rounded

_END = 0.77  # end of floors as a fraction of the far plane's distance (measured, MuJoCo 4.0.0)
_ELEVATIONS = 33  # number of elevations of reflections, whose sines are equidistant


def surroundings_head(world: WorldView) -> dict[str, Any]:
    """Returns the surroundings of a world for the JSON head of a page."""
    return {
        "looks": _looks(),
        "towards": rounded(KEY_DIRECTION),
        "floor": _floor(world),
    }


@cache
def _looks() -> dict[str, dict[str, Any]]:
    return {look: _look(palette) for look, palette in PALETTES.items()}


def _look(palette: Palette) -> dict[str, Any]:
    """Encodes a palette. Its light is relative to white, separately for each linear color channel.

    `fill` holds the coefficients (a, b, c) of `SkyLight.irradiance`. `reflections` has one row
    per roughness.
    """
    light, up = SkyLight(palette), np.linspace(-1.0, 1.0, _ELEVATIONS)
    return {
        "sky": palette.sky,
        "tiles": palette.tiles,
        "haze": palette.haze,
        "key": palette.physical.key,
        "bulb": palette.physical.bulb,
        "fill": rounded(light.irradiance(), 4),
        "reflections": [rounded(light.reflected(up, level), 3) for level in range(LEVELS)],
    }


def _floor(world: WorldView) -> dict[str, float] | None:
    shown = world.model
    for model in (shown, world.surroundings()):
        geom = None if model is None else our_floor(model)
        if model is not None and geom is not None:
            return _floor_of(model, geom, _END * float(shown.vis.map.zfar * shown.stat.extent))
    return None


def _floor_of(model: mujoco.MjModel, geom: int, far: float) -> dict[str, float]:
    repeat = float(model.mat_texrepeat[model.geom_matid[geom], 0])
    haze = (1.0 - float(model.vis.map.haze)) * far
    return {
        "height": round(float(model.geom_pos[geom, 2]), 6),
        "tile": round(1.0 / repeat, 6),
        "far": round(far, 3),
        "haze": round(haze, 3),
    }
