"""`GeomPool`: shows the geoms of an `MjvScene` as objects of a Filament scene.

Each geom is a separate object. Geoms of the model have objects with their own meshes, and all other
geoms use a pool of objects for each type. If arrows and axes were combined into meshes, one mesh
for each color would be uploaded in each frame, because a material has only one color.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ...viewer.decor.arrow_shapes import shapes_model
from ...viewer.decor.geom_buffer import FIRST_SHAPE
from ...viewer.image.mujoco_private import filament
from ...viewer.image.sky_light import linear, shown
from .light import upload

_TYPES = mujoco.mjtGeom
_GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)
_DECOR = int(mujoco.mjtCatBit.mjCAT_DECOR)
_PLANE, _MESH = int(_TYPES.mjGEOM_PLANE), int(_TYPES.mjGEOM_MESH)
_PRIMITIVES = frozenset(
    int(getattr(_TYPES, f"mjGEOM_{name}"))
    for name in ("PLANE", "SPHERE", "CAPSULE", "ELLIPSOID", "CYLINDER", "BOX", "ARROW", "ARROW1",
                 "ARROW2", "LINE", "LINEBOX", "TRIANGLE")
)  # fmt: skip
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_ROLES = int(mujoco.mjtTextureRole.mjNTEXROLE)
_CUBE = int(mujoco.mjtTexture.mjTEXTURE_CUBE)
SKYBOX = int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)
# Fraction of the color of other decor that depends on light. The rest is emitted, so that panels
# look almost the same in any light.
_DARK = 1 / 256
_REFLECTANCE = 0.08  # reflectance per specular: the default specular of 0.5 gives 0.04 (plastic)
# Fraction of the color of doubles, and of arrows and axes, that depends on light
_LIT, _SHAPE_LIT = 0.7, 0.5
# Filament compresses colors near white. Rows: displayed linear color, and the light it requires.
# Source: grays and colors rendered by MuJoCo 4.0.0, with an accuracy of 2 of 255.
_NEAR_WHITE = (
    (0.0, 0.83, 0.871, 0.905, 0.931, 0.992, 1.0),
    (0.0, 0.83, 0.9, 0.95, 1.0, 1.1, 1.3),
)
_FAINTEST = 0.01  # minimum opacity


class ModelGeoms:
    """The objects of the geoms of a model that receive light, with their meshes and textures."""

    def __init__(self, context: Any, scene: Any, model: mujoco.MjModel) -> None:
        module = filament()
        self.model, self._context = model, context
        self._resources = module.ModelResources(context, model)
        self._objects = module.ModelRenderables(scene, self._resources)
        get = self._objects.get_renderable
        self.geoms = [get(mujoco.mjtObj.mjOBJ_GEOM, k) for k in range(model.ngeom)]
        for item in (*self.geoms, *(get(mujoco.mjtObj.mjOBJ_SITE, k) for k in range(model.nsite))):
            scene.remove_renderable(item)
        self.textures = [own_texture(context, model, k) for k in range(model.ntex)]
        roles = model.mat_texid.reshape(-1, _ROLES)
        self._images = [-1 if k < 0 else int(roles[k, _RGB]) for k in model.geom_matid]
        has_roughness = (model.mat_metallic >= 0) | (model.mat_roughness >= 0)
        self._is_physical = [bool(k >= 0 and has_roughness[k]) for k in model.geom_matid]
        self._meshes: dict[int, Any] = {}

    def follow(self, data: mujoco.MjData) -> None:
        if self.model.nflex or self.model.nskin:
            self._objects.update(data)

    def material(self, geom: int, row: Any) -> Any:
        """Returns the material of a geom of the model, with the color of a row of the scene."""
        material = self.geoms[geom].get_material()
        material.color = seen_rgba(row)
        image = self._images[geom]
        if image >= 0 and self.textures[image] is not None:
            material.color_texture = self.textures[image]
        if not self._is_physical[geom]:
            material.specular, material.glossiness = finish(row)
        return material

    def mesh(self, index: int) -> Any:
        if index not in self._meshes:
            self._meshes[index] = upload_mesh(self._context, self.model, index)
        return self._meshes[index]

    def close(self) -> None:
        self.geoms.clear()
        del self._objects
        self._meshes.clear()
        self.textures.clear()
        del self._resources


class GeomPool:
    """The objects of a Filament scene that show the geoms of an `MjvScene`.

    Args:
        models: shown model, optionally followed by the model of the surroundings.
        doubles: mask of the geoms of the shown model that belong to doubles, shape (ngeom,).
        is_dark: whether the background of transparent geoms is mostly dark.
    """

    def __init__(
        self,
        context: Any,
        scene: Any,
        models: Sequence[mujoco.MjModel],
        doubles: Bools,
        *,
        is_dark: bool = False,
    ) -> None:
        self._module, self._context, self._scene = filament(), context, scene
        self._models = [ModelGeoms(context, scene, model) for model in models]
        self._doubles, self._is_dark = doubles, is_dark
        # Keys consist of the geom type, the number of the mesh or -1, and whether objects cast
        # shadows, which cannot be changed after an object is created.
        self._pool: dict[tuple[int, int, bool], list[Any]] = {}
        self._shapes: dict[int, Any] = {}  # meshes of arrows and axes
        self._shown: set[Any] = set()
        self._looks: dict[Any, tuple[bytes, float, int]] = {}  # last material of each object
        quality = models[0].vis.quality
        self._quality = int(quality.numstacks), int(quality.numslices), int(quality.numquads)

    @property
    def skybox(self) -> Any | None:
        for geoms in self._models:
            for kind, texture in zip(geoms.model.tex_type, geoms.textures, strict=True):
                if kind == SKYBOX and texture is not None:
                    return texture
        return None

    def follow(self, data: mujoco.MjData) -> None:
        self._models[0].follow(data)

    def update(self, rows: np.ndarray) -> None:
        """Shows exactly the geoms in an array of type `GEOM`."""
        shown: set[Any] = set()
        used: Counter[tuple[int, int, bool]] = Counter()
        model = self._models[0].model
        kinds, of, ids, meshes = (
            rows[name].tolist() for name in ("type", "objtype", "objid", "dataid")
        )
        decor = (rows["category"] == _DECOR).tolist()
        casts = (rows["castshadow"].astype(bool) & (rows["rgba"][:, 3] >= 1.0)).tolist()
        sizes, places = list(rows["size"].copy()), list(rows["pos"].copy())
        turned = list(rows["mat"].reshape(-1, 9))
        finishes = np.stack([rows["specular"], rows["shininess"]], axis=1)
        looks = np.concatenate([rows["rgba"], finishes], axis=1, dtype=np.float32).tobytes()
        width = len(looks) // max(len(rows), 1)
        for k in np.flatnonzero(rows["rgba"][:, 3] > 0).tolist():
            kind, geom, geoms = kinds[k], ids[k], self._models[0]
            is_own = of[k] == _GEOM and 0 <= geom < model.ngeom and model.geom_type[geom] == kind
            is_double = of[k] == _GEOM and (decor[k] or (is_own and bool(self._doubles[geom])))
            is_shape = kind == _MESH and meshes[k] >= FIRST_SHAPE
            lit = _LIT if is_double else _SHAPE_LIT if is_shape else 0.0 if decor[k] else 1.0
            if kind == _PLANE and not is_own and len(self._models) > 1:
                geoms, geom = self._models[1], 0  # the floor of the surroundings
                is_own = geoms.model.ngeom > 0
            place = places[k]
            if is_own and lit == 1.0:
                item = geoms.geoms[geom]
                if kind == _PLANE and not geoms.model.geom_bodyid[geom]:
                    # MuJoCo moves infinite planes with the camera, and their textures in the
                    # opposite direction. This plane is large enough to stay in place.
                    place = geoms.model.geom_pos[geom].astype(np.float32)
            elif kind in _PRIMITIVES or kind == _MESH:
                key = (kind, meshes[k] // 2 if kind == _MESH else -1, casts[k] and lit == 1.0)
                item = self._pooled(key, used[key])
                used[key] += 1
                if kind != _MESH:
                    item.set_size(sizes[k])
            else:
                continue
            item.set_pose(place, turned[k])
            look = (looks[k * width : (k + 1) * width], lit, geom if is_own else -1)
            if self._looks.get(item) != look:
                self._looks[item] = look
                item.set_material(self._material(rows[k], geoms if is_own else None, geom, lit))
            shown.add(item)
        for item in self._shown - shown:
            self._scene.remove_renderable(item)
        for item in shown - self._shown:
            self._scene.add_renderable(item)
        self._shown = shown

    def _pooled(self, key: tuple[int, int, bool], number: int) -> Any:
        pool = self._pool.setdefault(key, [])
        if number == len(pool):
            kind, mesh, casts = key
            # With soft shadows, objects that receive shadows also cast them.
            params = self._module.RenderableParams(cast_shadow=casts, receive_shadow=casts)
            item = self._context.create_renderable(params)
            if kind == _MESH:
                item.set_mesh(self._mesh(mesh), 0, 0)
            else:
                item.set_geom_mesh(mujoco.mjtGeom(kind), *self._quality)
            pool.append(item)
        return pool[number]

    def _mesh(self, index: int) -> Any:
        if index < FIRST_SHAPE // 2:
            return self._models[0].mesh(index)
        shape = index - FIRST_SHAPE // 2
        if shape not in self._shapes:
            self._shapes[shape] = upload_mesh(self._context, shapes_model(), shape)
        return self._shapes[shape]

    def _material(self, row: Any, geoms: ModelGeoms | None, geom: int, lit: float) -> Any:
        if lit < 1.0:
            return self._glowing(row["rgba"], max(lit, _DARK))
        if geoms is not None:
            return geoms.material(geom, row)
        specular, glossiness = finish(row)
        return self._module.Material(color=seen_rgba(row), specular=specular, glossiness=glossiness)

    def _glowing(self, rgba: Array, lit: float) -> Any:
        light, opacity = glow(tuple(rgba.tolist()), self._is_dark)
        surface = shown(np.array(light) * lit / opacity)
        # Filament multiplies emission by the opacity twice.
        return self._module.Material(
            color=np.array([*surface, opacity], np.float32), specular=0.0, glossiness=0.0,
            emissive=(1.0 - lit) / (lit * opacity),
        )  # fmt: skip

    def close(self) -> None:
        for item in self._shown:
            self._scene.remove_renderable(item)
        self._shown.clear()
        self._looks.clear()
        self._pool.clear()
        self._shapes.clear()
        for geoms in self._models:
            geoms.close()
        self._models.clear()


def opacity_of(alpha: float) -> float:
    """Returns the effective opacity of a geom in the classic renderer, which blends geoms twice."""
    return 1.0 - (1.0 - min(float(alpha), 1.0)) ** 2


def seen_rgba(row: Any) -> Array:
    """Returns the color of a geom with its effective opacity in the classic renderer."""
    rgba: Array = row["rgba"].copy()
    rgba[3] = opacity_of(rgba[3])
    return rgba


@lru_cache(maxsize=4096)
def glow(rgba: tuple[float, ...], is_dark: bool) -> tuple[tuple[float, ...], float]:
    """Returns the light (3,) and opacity with which Filament shows a color of the classic renderer.

    The classic renderer mixes displayed colors, but Filament mixes light, so that the same opacity
    looks paler. The result minimizes the difference over gray backgrounds, which are mostly dark if
    `is_dark` is true.
    """
    colour, alpha = np.array(rgba[:3]), opacity_of(rgba[3])
    if alpha >= 1.0:
        return tuple(np.interp(linear(colour), *_NEAR_WHITE).tolist()), 1.0
    behind = np.linspace(0.05, 0.5, 10) if is_dark else np.linspace(0.5, 0.95, 10)
    wanted = linear(alpha * colour + (1.0 - alpha) * behind[:, None])  # (10, 3)
    there = linear(behind)[:, None]
    spread = there - there.mean()
    through = float((spread * (wanted - wanted.mean(axis=0))).sum() / (3.0 * (spread**2).sum()))
    opacity = float(np.clip(1.0 - through, _FAINTEST, 1.0 - 1e-3))
    # Use at least the light of the color itself, so that several layers have the same hue.
    own = opacity * linear(colour)
    light = np.maximum((wanted - (1.0 - opacity) * there).mean(axis=0), own)
    return tuple(light.tolist()), opacity


def finish(row: Any) -> tuple[float, float]:
    """Returns the specular color and the glossiness, 0 to 1, of a geom in Filament.

    The default specular of MuJoCo, 0.5, becomes the reflectance of plastic at normal incidence,
    0.04. The Blinn-Phong exponent n is 128 times the shininess in MuJoCo. It is converted to the
    width alpha of a microfacet lobe by alpha^2 = 2 / (n + 2). The roughness in Filament is
    sqrt(alpha), and the glossiness is 1 - roughness.

    Source: Walter et al., Microfacet Models for Refraction, 2007.
    """
    exponent = 128.0 * max(float(row["shininess"]), 0.0)
    return _REFLECTANCE * float(row["specular"]), 1.0 - (2.0 / (exponent + 2.0)) ** 0.25


def upload_mesh(context: Any, model: mujoco.MjModel, index: int) -> Any:
    """Creates a Filament mesh from a mesh of a model, with separate corners for each face."""
    module = filament()
    first, count = int(model.mesh_faceadr[index]), int(model.mesh_facenum[index])
    faces = model.mesh_face[first : first + count].ravel()
    corners = model.mesh_vert[model.mesh_vertadr[index] :][faces]
    faces = model.mesh_facenormal[first : first + count].ravel()
    normals = model.mesh_normal[model.mesh_normaladr[index] :][faces]
    usage, kinds = module.VertexAttributeUsage, module.VertexAttributeType
    attributes = [
        module.VertexAttribute(
            usage.VERTEX_ATTRIBUTE_USAGE_POSITION, kinds.VERTEX_ATTRIBUTE_TYPE_FLOAT3
        ),
        module.VertexAttribute(
            usage.VERTEX_ATTRIBUTE_USAGE_TANGENTS, kinds.VERTEX_ATTRIBUTE_TYPE_FLOAT4
        ),
    ]
    config = module.MeshConfig(
        max_vertices=3 * count, max_indices=3 * count, attributes=attributes, interleaved=True,
        index_type=module.IndexType.INDEX_TYPE_U32,
        primitive_type=module.MeshPrimitiveType.MESH_PRIMITIVE_TYPE_TRIANGLES,
    )  # fmt: skip
    data = module.MeshData(compute_bounds=True)
    vertices = np.concatenate([corners, _tangents(normals)], axis=1).astype(np.float32)
    data.set_vertices(config, vertices.tobytes())
    data.set_indices(config, np.arange(3 * count, dtype=np.uint32).tobytes())
    mesh = context.create_mesh(config)
    mesh.upload(data)
    return mesh


def _tangents(normals: Array) -> Array:
    # The returned quaternions (x, y, z, w), shape (k, 4), rotate z to the unit normals (k, 3).
    x, y, z = normals.T.astype(float)
    turned = np.stack([-y, x, np.zeros_like(z), 1.0 + z], axis=1)
    turned[z < -1.0 + 1e-6] = (1.0, 0.0, 0.0, 0.0)  # rotation by 180 deg about x
    return np.asarray(turned / np.linalg.norm(turned, axis=1, keepdims=True))


def own_texture(context: Any, model: mujoco.MjModel, index: int) -> Any | None:
    """Creates a Filament texture from a texture of a model, or returns None if it has no colors.

    The texture contains displayed colors. By default, Filament interprets textures as linear light,
    which makes them look pale.
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
