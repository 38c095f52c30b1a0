"""`GeomPool`: the geoms of an `MjvScene` as objects of a Filament scene.

Every geom is an object of its own: those of a model with its meshes, all others from a pool by
type. Decor as one mesh would have to be uploaded again in every frame, once for each of its
colours, since materials have one colour.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ..mujoco_private import filament
from .filament_environment import linear, shown
from .filament_light import upload

_TYPES = mujoco.mjtGeom
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_PLANE, _MESH = int(_TYPES.mjGEOM_PLANE), int(_TYPES.mjGEOM_MESH)
_OF_MODEL = (_MESH, int(_TYPES.mjGEOM_SDF), int(_TYPES.mjGEOM_HFIELD))
_FLEX, _SKIN = int(_TYPES.mjGEOM_FLEX), int(_TYPES.mjGEOM_SKIN)
_PRIMITIVES = frozenset(
    int(getattr(_TYPES, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "ARROW", "ARROW1",
                 "ARROW2", "LINE", "LINEBOX", "TRIANGLE")
)  # fmt: skip
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_ROLES = int(mujoco.mjtTextureRole.mjNTEXROLE)
_CUBE = int(mujoco.mjtTexture.mjTEXTURE_CUBE)
SKYBOX = int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)
# A surface of this fraction of a colour that glows with the colour is independent of light.
_DARK = 1 / 256
_FAINTEST = 0.01  # opacity


class ModelGeoms:
    """The geoms of a model, each as often as a scene shows it.

    Args:
        context: of the scene.
        scene: of Filament.
        model: compiled.
    """

    def __init__(self, context: Any, scene: Any, model: mujoco.MjModel) -> None:
        module = filament()
        self.model, self._scene, self._module = model, scene, module
        self._resources = module.ModelResources(context, model)
        self._copies: list[tuple[Any, list[Any]]] = []
        self.textures = [own_texture(context, model, k) for k in range(model.ntex)]
        roles = model.mat_texid.reshape(-1, _ROLES)
        self._images = [-1 if k < 0 else int(roles[k, _RGB]) for k in model.geom_matid]
        has_roughness = (model.mat_metallic >= 0) | (model.mat_roughness >= 0)
        self._is_physical = [bool(k >= 0 and has_roughness[k]) for k in model.geom_matid]
        # Flexes and skins are meshes that MuJoCo computes anew in every frame.
        self.soft: Any = self._objects()[0] if model.nflex or model.nskin else None

    def _objects(self) -> tuple[Any, list[Any]]:
        model, scene = self.model, self._scene
        objects = self._module.ModelRenderables(scene, self._resources)
        geoms = [objects.get_renderable(mujoco.mjtObj.mjOBJ_GEOM, k) for k in range(model.ngeom)]
        for geom in geoms:
            scene.remove_renderable(geom)
        for site in range(model.nsite):
            scene.remove_renderable(objects.get_renderable(mujoco.mjtObj.mjOBJ_SITE, site))
        return objects, geoms

    def get(self, geom: int, copy: int) -> Any:
        """Returns the object of a geom for the copy-th time that a scene shows it."""
        while copy >= len(self._copies):
            objects, geoms = self._objects()
            self._copies.append((objects, geoms))
        return self._copies[copy][1][geom]

    def material(self, geom: int, row: Any) -> Any:
        """Returns the material of a geom that is lit, with the colour of a scene's row."""
        material = self.get(geom, 0).get_material()
        material.color = row["rgba"]
        image = self._images[geom]
        if image >= 0 and self.textures[image] is not None:
            material.color_texture = self.textures[image]
        elif not self._is_physical[geom]:
            material.metallic, material.roughness = 0.0, roughness(float(row["shininess"]))
        return material

    def close(self) -> None:
        """Frees the objects."""
        self._copies.clear()
        self.soft = None
        self.textures.clear()
        del self._resources


class GeomPool:
    """Objects of a Filament scene for the geoms of an `MjvScene`.

    Args:
        context: of the scene.
        scene: of Filament.
        models: the shown model, and that of added surroundings if any.
        is_unlit: geoms of the shown model whose colours light does not change, (ngeom,).
        is_dark: whether what is behind transparent geoms is mostly dark.
    """

    def __init__(
        self,
        context: Any,
        scene: Any,
        models: Sequence[mujoco.MjModel],
        is_unlit: Bools,
        *,
        is_dark: bool = False,
    ) -> None:
        self._module, self._context, self._scene = filament(), context, scene
        self._models = [ModelGeoms(context, scene, model) for model in models]
        self._is_unlit, self._is_dark = is_unlit, is_dark
        self._pool: dict[int, list[Any]] = {}
        self._shown: set[Any] = set()
        self._materials: dict[Any, tuple[Any, ...]] = {}
        quality = models[0].vis.quality
        self._quality = int(quality.numstacks), int(quality.numslices), int(quality.numquads)

    @property
    def skybox(self) -> Any | None:
        """The texture of the sky, of the first model that has one."""
        for geoms in self._models:
            for kind, texture in zip(geoms.model.tex_type, geoms.textures, strict=True):
                if kind == SKYBOX and texture is not None:
                    return texture
        return None

    def follow(self, data: mujoco.MjData) -> None:
        """Takes the shapes of skins and flexes from a state, which a scene's geoms do not tell."""
        if self._models[0].soft is not None:
            self._models[0].soft.update(data)

    def update(self, rows: np.ndarray) -> None:
        """Shows the geoms of a scene, and nothing else.

        Args:
            rows: (k,) of `GEOM`.
        """
        shown: set[Any] = set()
        used: Counter[int] = Counter()
        taken: Counter[int] = Counter()
        model = self._models[0].model
        kinds, of, ids = (rows[name].tolist() for name in ("type", "objtype", "objid"))
        decor = (rows["category"] == _DECOR).tolist()
        visible = (rows["rgba"][:, 3] > 0).tolist()
        for k, row in enumerate(rows):
            kind, geom, geoms = kinds[k], ids[k], self._models[0]
            if not visible[k]:
                continue
            is_own = of[k] == _GEOM and 0 <= geom < model.ngeom and model.geom_type[geom] == kind
            if kind == _PLANE and not is_own and len(self._models) > 1:
                geoms, geom = self._models[1], 0  # the floor of the surroundings
                is_own = geoms.model.ngeom > 0
            if is_own and (kind in _OF_MODEL or kind == _PLANE or not decor[k]):
                item = geoms.get(geom, taken[geom] if geoms is self._models[0] else 0)
                taken[geom] += geoms is self._models[0]
                self._place_own(item, geoms.model, geom, row)
            elif kind in _PRIMITIVES:
                item = self._primitive(kind, used[kind])
                used[kind] += 1
                item.set_size(row["size"])
                item.set_pose(row["pos"], row["mat"].ravel())
                is_own = False
            else:
                continue
            unlit = decor[k] or (is_own and geoms is self._models[0] and self._is_unlit[geom])
            self._paint(item, row, geoms if is_own else None, geom, unlit=bool(unlit))
            shown.add(item)
        for item in self._shown - shown:
            self._scene.remove_renderable(item)
        for item in shown - self._shown:
            self._scene.add_renderable(item)
        self._shown = shown

    def _place_own(self, item: Any, model: mujoco.MjModel, geom: int, row: Any) -> None:
        position, turned = row["pos"], row["mat"].ravel()
        if row["type"] == _PLANE and not model.geom_bodyid[geom]:
            # MuJoCo moves infinite planes with the camera, and textures of theirs the other way;
            # Filament draws this one so large that it can stay.
            position = model.geom_pos[geom].astype(np.float32)
        item.set_pose(position, turned)

    def _primitive(self, kind: int, number: int) -> Any:
        pool = self._pool.setdefault(kind, [])
        if number == len(pool):
            item = self._context.create_renderable(self._module.RenderableParams())
            item.set_geom_mesh(mujoco.mjtGeom(kind), *self._quality)
            pool.append(item)
        return pool[number]

    def _paint(
        self, item: Any, row: Any, geoms: ModelGeoms | None, geom: int, *, unlit: bool
    ) -> None:
        """Sets the material of an object, where it is another one than in the last frame."""
        casts = bool(row["castshadow"]) and not unlit and float(row["rgba"][3]) >= 1.0
        look = (row["rgba"].tobytes(), float(row["shininess"]), unlit, casts, id(geoms))
        if self._materials.get(item) == look:
            return
        self._materials[item] = look
        if unlit:
            material = self._unlit(row["rgba"])
        elif geoms is not None:
            material = geoms.material(geom, row)
        else:
            material = self._module.Material(
                color=row["rgba"], metallic=0.0, roughness=roughness(float(row["shininess"]))
            )
        item.set_material(material)
        item.set_cast_shadow(casts)

    def _unlit(self, rgba: Array) -> Any:
        colour, opacity = glow(tuple(rgba.tolist()), self._is_dark)
        dark = shown(np.array(colour) * _DARK)
        return self._module.Material(
            color=np.array([*dark, opacity], np.float32), specular=0.0, glossiness=0.0,
            emissive=1.0 / _DARK,
        )  # fmt: skip

    def close(self) -> None:
        """Frees the objects."""
        for item in self._shown:
            self._scene.remove_renderable(item)
        self._shown.clear()
        self._materials.clear()
        self._pool.clear()
        for geoms in self._models:
            geoms.close()
        self._models.clear()


@lru_cache(maxsize=4096)
def glow(rgba: tuple[float, ...], is_dark: bool) -> tuple[tuple[float, ...], float]:
    """Returns light (3) and opacity of a material that looks as the classic renderer draws a colour.

    The classic renderer mixes colours as they are shown, Filament mixes light, in which the same
    opacity looks paler. Light and opacity are those that differ least over greys behind them.

    Args:
        rgba: as it is declared.
        is_dark: whether what is behind is mostly dark.
    """
    colour, alpha = np.array(rgba[:3]), float(rgba[3])
    if alpha >= 1.0:
        return tuple(linear(colour).tolist()), 1.0
    behind = np.linspace(0.05, 0.5, 10) if is_dark else np.linspace(0.5, 0.95, 10)
    wanted = linear(alpha * colour + (1.0 - alpha) * behind[:, None])  # (10, 3)
    there = linear(behind)[:, None]
    spread = there - there.mean()
    through = float((spread * (wanted - wanted.mean(axis=0))).sum() / (3.0 * (spread**2).sum()))
    opacity = float(np.clip(1.0 - through, _FAINTEST, 1.0 - 1e-3))
    light = np.maximum((wanted - (1.0 - opacity) * there).mean(axis=0), 0.0)
    # Filament multiplies what glows by the opacity twice: as a glow and as a colour.
    return tuple((light / opacity**2).tolist()), opacity


def roughness(shininess: float) -> float:
    """Returns Filament's roughness of a surface with MuJoCo's shininess, 0 to 1.

    Source: Blinn-Phong's exponent n as the width of a microfacet lobe, alpha^2 = 2 / (n + 2)
    (Walter et al., Microfacet Models for Refraction, 2007); Filament's roughness is sqrt(alpha), and
    MuJoCo's n is 128 times the shininess.
    """
    return float((2.0 / (128.0 * max(shininess, 0.0) + 2.0)) ** 0.25)


def own_texture(context: Any, model: mujoco.MjModel, index: int) -> Any | None:
    """Returns a texture of a model as colours that are shown; None for no colours.

    Of its own accord Filament takes them for linear light, and shows them pale.
    """
    module = filament()
    channels = int(model.tex_nchannel[index])
    if channels not in (3, 4):
        return None
    width, height = int(model.tex_width[index]), int(model.tex_height[index])
    kind = int(model.tex_type[index])
    kinds = module.SamplerType
    sampler = {_CUBE: kinds.TEXTURE_CUBE, SKYBOX: kinds.TEXTURE_SKYBOX}.get(kind, kinds.TEXTURE_2D)
    formats = module.PixelFormat
    config = module.TextureConfig(
        width=width, height=height, sampler_type=sampler,
        format=formats.PIXEL_FORMAT_RGB8 if channels == 3 else formats.PIXEL_FORMAT_RGBA8,
        color_space=module.ColorSpace.COLORSPACE_SRGB,
    )  # fmt: skip
    start = int(model.tex_adr[index])
    pixels = model.tex_data[start : start + width * height * channels]
    return upload(context, config, pixels.tobytes())
