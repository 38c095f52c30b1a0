"""Lights and view options of Filament: the sky, and the lights of an `MjvScene`."""

from __future__ import annotations

import logging
from typing import Any

import mujoco
import numpy as np

from ...robots.declared.surroundings import Palette
from ...viewer.image.image_options import Quality
from ...viewer.image.mujoco_private import filament
from ...viewer.image.sky_light import linear
from .environment import environment

log = logging.getLogger(__name__)

# Luminance in cd/m^2 that the camera of Filament (f/16, 1/125 s, ISO 100) displays as white.
# Source: documentation of Filament, 8.1.2: exposure = 1 / (1.2 * 2^EV100), EV100 = log2(N^2 / t).
_WHITE = 1.2 * 16**2 * 125
PREFIX = "filament."
# Linear tone mapping with clipping displays colors as declared. An exposure of -1 stop compensates
# the brightness, which MuJoCo 4.0.0 doubles.
_OPTIONS: dict[str, str | float] = {
    "cg.tone_mapping": "linear",
    "cg.exposure": -1.0,
    "bloom.enabled": 0.0,
    "ao.enabled": 1.0,
}
# Shadows whose softness grows with distance (`pcss`) double the render time of software renderers.
# Fewer occlusion samples save 3 % and look the same.
_QUICK: dict[str, str | float] = {"shadows.type": "pcf", "ao.quality": "low"}
_BY_QUALITY: dict[Quality, dict[str, str | float]] = {
    "draft": _QUICK,
    "normal": _QUICK,
    "fine": {"shadows.type": "pcss"},
}
_SHADOW_MAP = 2048  # side of each of the four shadow maps (cascades), pixels
_FAR = 20.0  # distance of directional lights that are rendered as spotlights, in model extents
_SPOT, _DIRECTIONAL, _POINT, _IMAGE = (
    int(getattr(mujoco.mjtLightType, f"mjLIGHT_{name}"))
    for name in ("SPOT", "DIRECTIONAL", "POINT", "IMAGE")
)
_KNOWN = frozenset(
    {
        f"{group}.{name}"
        for group, names in {
            "ao": "bent_normals bilateral_threshold enabled low_pass_filter quality ssct "
            "upsampling",
            "bloom": "dirt_strength enabled levels quality resolution strength",
            "cg": "contrast exposure gamut_mapping highlight_scale highlights luminance_scaling "
            "mid_point midtones offset output_color_space power saturation shadow_gamma shadows "
            "slope temperature tint tonal_ranges tone_mapping vibrance",
            "fallback": "environment_light_intensity head_light_intensity scene_light_intensity",
            "fog": "color cut_off_distance density distance enabled height height_falloff "
            "in_scattering_size in_scattering_start maximum_opacity",
            "material": "base_color_type",
            "msaa": "enabled",
            "phong": "emissive_multiplier shininess_multiplier specular_multiplier",
            "shadows": "map_size type",
            "vignette": "enabled midpoint",
        }.items()
        for name in names.split()
    }
    | {"clear_color"}
)

_SIZES = {  # number of values of each option that is not a scalar
    **dict.fromkeys(("clear_color", "fog.color"), 3),
    **{f"cg.{name}": 3 for name in ("slope", "offset", "power")},
    **{f"cg.{name}": 3 for name in ("shadow_gamma", "mid_point", "highlight_scale")},
    **{f"cg.{name}": 4 for name in ("shadows", "midtones", "highlights", "tonal_ranges")},
}


def options_model(
    model: mujoco.MjModel, quality: Quality, *, has_occlusion: bool = True
) -> mujoco.MjModel:
    """Returns a model whose custom fields contain the view options that Filament reads.

    Options of the shown model override the defaults of sero-mj. The shown model is not changed,
    because web pages also read it.

    Args:
        has_occlusion: whether ambient occlusion is allowed. False overrides the option of a model.
    """
    spec = mujoco.MjSpec()
    own = _own_options(model)
    no_occlusion = {} if has_occlusion else {"ao.enabled": 0.0}
    ours = _OPTIONS | _BY_QUALITY[quality]
    for name, value in (ours | own | no_occlusion).items():
        if isinstance(value, str):
            text = spec.add_text()
            text.name, text.data = PREFIX + name, value
        else:
            numbers = np.atleast_1d(value).tolist()
            numeric = spec.add_numeric()
            numeric.name, numeric.data, numeric.size = PREFIX + name, numbers, len(numbers)
    options = spec.compile()
    # Filament expects linear light.
    options.vis.rgba.haze[:3] = linear(model.vis.rgba.haze[:3])
    options.vis.map.haze = model.vis.map.haze
    options.stat.extent = model.stat.extent
    return options


def _own_options(model: mujoco.MjModel) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for index in range(model.nnumeric):
        start, size = int(model.numeric_adr[index]), int(model.numeric_size[index])
        found[model.numeric(index).name] = model.numeric_data[start : start + size].copy()
    for index in range(model.ntext):
        start, size = int(model.text_adr[index]), int(model.text_size[index])
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, index)
        found[name or ""] = model.text_data[start : start + size - 1].decode("utf-8", "replace")
    taken: dict[str, Any] = {}
    for name, value in found.items():
        if not name.startswith(PREFIX):
            continue
        key = name.removeprefix(PREFIX)
        # MuJoCo 4.0.0 ends the process if the size is wrong.
        size, expected = 0 if isinstance(value, str) else len(value), _SIZES.get(key, 1)
        if key not in _KNOWN:
            log.warning("unknown option '%s' of MuJoCo's Filament renderer is ignored", name)
        elif size and (size != expected or not np.isfinite(value).all()):
            numbers = " ".join(f"{each:g}" for each in value)
            log.warning("%s: found %s; expected %d finite numbers", name, numbers, expected)
        else:
            taken[key] = value
    return taken


class SceneLights:
    """The lights of a Filament scene: the sky, and the lights of an `MjvScene`."""

    def __init__(
        self, context: Any, scene: Any, model: mujoco.MjModel, look: str, palette: Palette
    ) -> None:
        self._module, self._context, self._scene = filament(), context, scene
        self._palette = palette
        self._centre, self._extent = model.stat.center.copy(), float(model.stat.extent)
        self._lights: dict[tuple[int, int, bool], Any] = {}
        self._on: set[tuple[int, int, bool]] = set()
        module = self._module
        config = module.TextureConfig(
            width=1, height=1, format=module.PixelFormat.PIXEL_FORMAT_KTX,
            sampler_type=module.SamplerType.TEXTURE_CUBE,
            color_space=module.ColorSpace.COLORSPACE_AUTO,
        )  # fmt: skip
        # The texture must exist as long as a light refers to it.
        self._texture = upload(context, config, environment(look, palette))
        params = module.LightParams(
            type=module.LightType.LIGHT_IMAGE, texture=self._texture, intensity=_WHITE
        )
        self._sky = context.create_light(params)
        scene.add_light(self._sky)

    def update(self, scene: mujoco.MjvScene) -> None:
        lights = [each for each in scene.lights[: scene.nlight] if each.type != _IMAGE]
        # The sky replaces the headlight of the classic renderer as fill light.
        lights = [each for each in lights if not each.headlight] or lights
        on, has_directional = set(), False
        for number, light in enumerate(lights):
            kind = int(light.type)
            place, towards = np.array(light.pos, float), np.array(light.dir, float)
            share = np.array(light.diffuse, float)
            level = float(share.max()) or 1.0
            illuminance = self._palette.physical.key * np.pi * _WHITE * level / self._palette.key
            if kind == _DIRECTIONAL and has_directional:  # Filament has only one directional light
                kind, distance = _SPOT, _FAR * self._extent
                place = self._centre - distance * towards
            distance = max(float(np.linalg.norm(place - self._centre)), 0.1)
            is_directional = kind == _DIRECTIONAL
            has_directional |= is_directional
            intensity = illuminance if is_directional else illuminance * distance**2  # lx, cd
            if light.intensity > 0.0:
                intensity = float(light.intensity)
            key = (number, kind, bool(light.castshadow and not light.headlight))
            if key not in self._lights:
                self._lights[key] = self._make(key, light)
            own = self._lights[key]
            own.set_color((share / level).astype(np.float32))
            own.set_intensity(intensity)
            own.set_pose(place.astype(np.float32), towards.astype(np.float32))
            on.add(key)
        for key in self._on - on:
            self._scene.remove_light(self._lights[key])
        for key in on - self._on:
            self._scene.add_light(self._lights[key])
        self._on = on

    def _make(self, key: tuple[int, int, bool], light: Any) -> Any:
        _, kind, casts = key
        types = self._module.LightType
        by_kind = {_DIRECTIONAL: types.LIGHT_DIRECTIONAL, _POINT: types.LIGHT_POINT}
        bulb = float(light.bulbradius)
        params = self._module.LightParams(
            type=by_kind.get(kind, types.LIGHT_SPOT), cast_shadow=casts,
            shadow_map_size=_SHADOW_MAP, range=100.0 * self._extent,
            cutoff=float(np.clip(light.cutoff, 1.0, 89.0)), softness=0.2,
            bulb_radius=self._palette.physical.bulb if kind == _DIRECTIONAL else bulb,
        )  # fmt: skip
        return self._context.create_light(params)

    def close(self) -> None:
        for key in self._on:
            self._scene.remove_light(self._lights[key])
        self._scene.remove_light(self._sky)
        self._on.clear()
        self._lights.clear()
        del self._sky, self._texture


def upload(context: Any, config: Any, data: bytes) -> Any:
    """Creates a Filament texture with a copy of an image."""
    module = filament()
    texture, image = context.create_texture(config), module.TextureData()
    image.set_image(data)
    texture.upload(image)
    return texture
