"""Encodes the appearance of a model: geoms, sites, meshes, materials, textures, skins and lights.

Only visible meshes and textures are stored, and equal ones are stored once. Height fields are
stored as meshes.
"""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints
from .packing import PackedArrays, differing, rounded

_GROUPS = 3  # number of geom and site groups that MuJoCo shows by default
_DEFAULT_RGBA = np.array(
    [0.5, 0.5, 0.5, 1.0], np.float32
)  # color of geoms whose color comes from a material
_PLANE = int(mujoco.mjtGeom.mjGEOM_PLANE)
_HFIELD = int(mujoco.mjtGeom.mjGEOM_HFIELD)
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_SDF = int(mujoco.mjtGeom.mjGEOM_SDF)
_COLOR = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_FLAT = int(mujoco.mjtTexture.mjTEXTURE_2D)
_FACES = 6  # number of faces of a cube texture, stored one below the other
_MAX_PIXELS = 2048  # maximum width and height of a texture; larger textures are halved
_MESH_STEPS = 65535  # number of steps along the longest side of a mesh
_NORMAL_STEPS = 127
_OUR_LIGHT = "key"
_OUR_FLOOR = "floor"

# Vertices (n, 3) in m, normals (n, 3), vertex indices of triangles (3 * m,), and texture
# coordinates (n, 2) or None.
Corners = tuple[Array, Array, Ints, Array | None]


def visible_geoms(model: mujoco.MjModel) -> Ints:
    """Returns the ids of the geoms that MuJoCo draws by default, except the scene's floor."""
    shown = (model.geom_group < _GROUPS) & (geom_colors(model)[:, 3] > 0)
    shown &= model.geom_type <= _SDF
    floor = our_floor(model)
    if floor is not None:
        shown[floor] = False
    found: Ints = shown.nonzero()[0]
    return found


def geom_colors(model: mujoco.MjModel) -> Array:
    """Returns the RGBA colors of all geoms, taken from their materials where needed, (ngeom, 4)."""
    return _colors(model, model.geom_rgba, model.geom_matid)


def drawn_bodies(model: mujoco.MjModel) -> Ints:
    """Returns the ids of the bodies with visible geoms, sites or skins, or with lights."""
    sites = model.site_bodyid[_visible_sites(model)]
    bones = model.skin_bonebodyid if model.nskin else np.zeros(0, int)
    lights = np.append(model.light_bodyid, 0) if _has_own_lights(model) else np.zeros(0, int)
    ids = [model.geom_bodyid[visible_geoms(model)], sites, bones, lights]
    return np.unique(np.concatenate(ids)).astype(np.intp)


def _visible_sites(model: mujoco.MjModel) -> Ints:
    alpha = _colors(model, model.site_rgba, model.site_matid)[:, 3]
    found: Ints = ((model.site_group < _GROUPS) & (alpha > 0)).nonzero()[0]
    return found


def _colors(model: mujoco.MjModel, rgba: np.ndarray, material: np.ndarray) -> Array:
    colors = np.array(rgba)
    of_material = (material >= 0) & (colors == _DEFAULT_RGBA).all(axis=1)
    colors[of_material] = model.mat_rgba[material[of_material]]
    return colors


def our_floor(model: mujoco.MjModel) -> int | None:
    """Returns the id of the floor geom that the scene adds to a model, or None."""
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, _OUR_FLOOR)
    if floor < 0 or model.geom_type[floor] != _PLANE or model.geom_matid[floor] < 0:
        return None
    return floor if model.mat(model.geom_matid[floor]).name == _OUR_FLOOR else None


def _has_own_lights(model: mujoco.MjModel) -> bool:
    return [model.light(i).name for i in range(model.nlight)] != [_OUR_LIGHT]


def field_corners(model: mujoco.MjModel, field: int) -> Corners:
    """Converts a height field to a closed mesh."""
    rows, columns = int(model.hfield_nrow[field]), int(model.hfield_ncol[field])
    begin = model.hfield_adr[field]
    wide, deep, high, under = model.hfield_size[field]
    heights = high * model.hfield_data[begin : begin + rows * columns].reshape(rows, columns)
    x, y = np.meshgrid(np.linspace(-wide, wide, columns), np.linspace(-deep, deep, rows))
    top = np.stack([x, y, heights], axis=-1)
    slope_y, slope_x = np.gradient(heights, y[:, 0], x[0])
    normals = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    here = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = here[:-1, :-1], here[:-1, 1:], here[1:, 1:], here[1:, :-1]
    points, facing, index = [top.reshape(-1, 3)], [normals.reshape(-1, 3)], []
    index.append(np.stack([a, b, c, a, c, d], axis=-1).ravel())
    # The edges of the field are in counterclockwise order, seen from above.
    edges = ((top[0], (0, -1)), (top[:, -1], (1, 0)), (top[-1, ::-1], (0, 1)),
             (top[::-1, 0], (-1, 0)))  # fmt: skip
    for edge, (to_x, to_y) in edges:
        count, start = len(edge), sum(map(len, points))
        below = edge * (1, 1, 0) - (0, 0, under)
        points += [edge, below]
        facing += [np.tile((float(to_x), float(to_y), 0.0), (2 * count, 1))]
        one = start + np.arange(count - 1)
        index.append(np.stack([one, one + count, one + 1, one + 1, one + count, one + count + 1],
                              axis=-1).ravel())  # fmt: skip
    start = sum(map(len, points))
    points.append(np.array([[-wide, -deep, -under], [-wide, deep, -under], [wide, deep, -under],
                            [wide, -deep, -under]]))  # fmt: skip
    facing.append(np.tile((0.0, 0.0, -1.0), (4, 1)))
    index.append(start + np.array([0, 1, 2, 0, 2, 3]))
    corners = np.concatenate(index).astype(np.intp)
    return np.concatenate(points), np.concatenate(facing), corners, None


def mesh_corners(model: mujoco.MjModel, mesh: int, *, is_textured: bool = False) -> Corners:
    """Returns a mesh of a model. It has texture coordinates if `is_textured` is set."""
    vertex, normal = model.mesh_vertadr[mesh], model.mesh_normaladr[mesh]
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    columns = [model.mesh_face[faces].ravel(), model.mesh_facenormal[faces].ravel()]
    if is_textured:
        columns.append(model.mesh_facetexcoord[faces].ravel())
    corners, first, index = np.unique(
        np.stack(columns, axis=1), axis=0, return_index=True, return_inverse=True
    )
    # If vertices are in the order of their first use, differences between indices are small.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    corners = corners[order]
    points = model.mesh_vert[vertex + corners[:, 0]].astype(float)
    normals = model.mesh_normal[normal + corners[:, 1]].astype(float)
    uv = None
    if is_textured:
        uv = model.mesh_texcoord[model.mesh_texcoordadr[mesh] + corners[:, 2]].astype(float)
    return points, normals, rank[index.ravel()], uv


class Look:
    """Encodes the appearance of a model for the JSON head of a page.

    Args:
        model: model to encode.
        parts: storage for the arrays.
        body_index: function that converts a body id to the index of the body in the page.
    """

    def __init__(
        self, model: mujoco.MjModel, parts: PackedArrays, body_index: Callable[[int], int]
    ) -> None:
        self._model, self._parts, self._index = model, parts, body_index
        self._meshes: list[dict[str, Any]] = []
        self._textures: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._known: dict[Any, int] = {}

    def head(self) -> dict[str, Any]:
        """Returns the entries of the JSON head. Rarely used entries are omitted if empty."""
        model = self._model
        found: dict[str, Any] = {
            "meshes": self._meshes,
            "geoms": [self._geom(i) for i in visible_geoms(model).tolist()]
            + [self._shape("site", i) for i in _visible_sites(model).tolist()],
        }
        if self._has_infinite_plane():
            found["reach"] = round(float(model.vis.map.zfar * model.stat.extent), 3)
        shown = (model.skin_group < _GROUPS).nonzero()[0] if model.nskin else []
        skins = [self._skin(int(i)) for i in shown]
        flexes = [self._flex(int(i)) for i in np.arange(model.nflex)[self.shown_flexes]]
        lights = self._lights() if _has_own_lights(model) else None
        extra = {"materials": self._materials, "textures": self._textures, "skins": skins,
                 "flexes": flexes, "lights": lights}  # fmt: skip
        return found | {key: each for key, each in extra.items() if each}

    def _has_infinite_plane(self) -> bool:
        model, shown = self._model, visible_geoms(self._model)
        planes = shown[model.geom_type[shown] == _PLANE]
        return bool((model.geom_size[planes, :2] <= 0).any())

    @cached_property
    def shown_flexes(self) -> Bools:
        return shown_flexes(self._model)

    def material(self, material: int) -> int:
        if material < 0:
            return -1
        key = ("material", material)
        if key not in self._known:
            model = self._model
            numbers = (model.mat_emission, model.mat_specular, model.mat_shininess,
                       model.mat_reflectance)  # fmt: skip
            self._known[key] = len(self._materials)
            self._materials.append(
                {
                    "finish": rounded([each[material] for each in numbers], 3),
                    "texture": self._texture(int(model.mat_texid[material, _COLOR])),
                    "repeat": rounded(model.mat_texrepeat[material]),
                    "uniform": bool(model.mat_texuniform[material]),
                    **self._physical(material),
                }
            )
        return self._known[key]

    def _physical(self, material: int) -> dict[str, float]:
        numbers = {"roughness": self._model.mat_roughness, "metallic": self._model.mat_metallic}
        return {
            name: round(float(each[material]), 3)
            for name, each in numbers.items()
            if each[material] >= 0
        }

    def _geom(self, i: int) -> dict[str, Any]:
        model = self._model
        found = self._shape("geom", i)
        kind, data = int(model.geom_type[i]), int(model.geom_dataid[i])
        if kind == _HFIELD:
            found["type"] = _MESH
            found["mesh"] = self._mesh(("field", data), lambda: field_corners(model, data))
        elif kind in (_MESH, _SDF):
            found["type"] = _MESH
            is_textured = self._is_flat(found) and bool(model.mesh_texcoordadr[data] >= 0)
            found["mesh"] = self._mesh(
                (data, is_textured), lambda: mesh_corners(model, data, is_textured=is_textured)
            )
        return found

    def copied(self, geom: int, body: int, rgba: Array) -> dict[str, Any]:
        """Encodes a geom again, in one color, for a double's body with this index in the page."""
        found = self._geom(geom)
        found.pop("material", None)
        return found | {"body": body, "rgba": np.round(rgba * 255).astype(int).tolist()}

    def _is_flat(self, found: dict[str, Any]) -> bool:
        """Whether a geom has a texture that is not a cube map."""
        texture = self._materials[found["material"]]["texture"] if "material" in found else -1
        return texture >= 0 and not self._textures[texture]["cube"]

    def _shape(self, what: str, i: int) -> dict[str, Any]:
        model = self._model

        def of(name: str) -> Any:
            return getattr(model, f"{what}_{name}")

        (rgba,) = _colors(model, of("rgba")[i : i + 1], of("matid")[i : i + 1])
        found = {
            "body": self._index(int(of("bodyid")[i])),
            "type": int(of("type")[i]),
            "pos": rounded(of("pos")[i]),
            "quat": rounded(of("quat")[i]),
            "size": rounded(of("size")[i]),
            "rgba": np.round(rgba * 255).astype(int).tolist(),
        }
        material = self.material(int(of("matid")[i]))
        return found | ({"material": material} if material >= 0 else {})

    def _mesh(self, name: Any, corners: Callable[[], Corners]) -> int:
        known = self._known
        if name in known:
            return known[name]
        points, normals, index, uv = corners()
        digest = hashlib.sha256(points.tobytes() + normals.tobytes() + index.tobytes())
        digest.update(b"" if uv is None else uv.tobytes())
        key = digest.digest()
        if key not in known:
            known[key] = len(self._meshes)
            mesh = self._steps(points, "vertices")
            mesh["normals"] = self._parts.put(_octahedral(normals))
            mesh["triangles"] = self._parts.put(differing(index))
            if uv is not None:
                mesh["uv"] = self._steps(uv, "places")
            self._meshes.append(mesh)
        known[name] = known[key]
        return known[name]

    def _steps(self, places: Array, name: str) -> dict[str, Any]:
        low = places.min(axis=0)
        step = max(float(np.ptp(places, axis=0).max()) / _MESH_STEPS, 1e-9)
        whole = np.round((places - low) / step).astype(np.int64)
        packed = self._parts.put(_differences(whole.T).astype(np.uint16))
        return {"low": low.tolist(), "step": step, name: packed}

    def _texture(self, texture: int) -> int:
        if texture < 0:
            return -1
        model = self._model
        wide, tall = int(model.tex_width[texture]), int(model.tex_height[texture])
        channels, begin = int(model.tex_nchannel[texture]), int(model.tex_adr[texture])
        is_cube = int(model.tex_type[texture]) != _FLAT
        faces = _FACES if is_cube else 1
        pixels = model.tex_data[begin : begin + wide * tall * channels]
        key = ("texture", wide, channels, is_cube, hashlib.sha256(pixels.tobytes()).digest())
        if key not in self._known:
            self._known[key] = len(self._textures)
            image = pixels.reshape(faces, tall // faces, wide, channels)
            while max(image.shape[1:3]) > _MAX_PIXELS:
                image = _halved(image)
            rows = image.reshape(-1, *image.shape[2:])
            way, packed = _filtered(rows)
            self._textures.append(
                {
                    "cube": is_cube, "width": image.shape[2], "height": image.shape[1],
                    "channels": channels, "way": way, "pixels": self._parts.put(packed),
                }
            )  # fmt: skip
        return self._known[key]

    def _skin(self, i: int) -> dict[str, Any]:
        """Returns the vertices of a skin in the bind pose, and the weights of each bone."""
        model, parts = self._model, self._parts
        begin, count = int(model.skin_vertadr[i]), int(model.skin_vertnum[i])
        faces = slice(model.skin_faceadr[i], model.skin_faceadr[i] + model.skin_facenum[i])
        bones = range(model.skin_boneadr[i], model.skin_boneadr[i] + model.skin_bonenum[i])
        of_bones = [
            slice(model.skin_bonevertadr[b], model.skin_bonevertadr[b] + model.skin_bonevertnum[b])
            for b in bones
        ]
        moved = np.concatenate([model.skin_bonevertid[each] for each in of_bones])
        weights = np.concatenate([model.skin_bonevertweight[each] for each in of_bones])
        found = self._soft(model.skin_rgba[i], int(model.skin_matid[i]))
        found |= self._steps(model.skin_vert[begin : begin + count].astype(float), "vertices")
        found |= {
            "inflate": round(float(model.skin_inflate[i]), 6),
            "triangles": self._parts.put(differing(model.skin_face[faces].ravel())),
            "bones": [
                {
                    "body": self._index(int(model.skin_bonebodyid[b])),
                    "pos": rounded(model.skin_bonebindpos[b]),
                    "quat": rounded(model.skin_bonebindquat[b]),
                    "count": int(model.skin_bonevertnum[b]),
                }
                for b in bones
            ],
            "moved": parts.put(differing(moved)),
            "weights": parts.put(np.round(weights * 65535).astype(np.uint16)),
        }
        first = int(model.skin_texcoordadr[i])
        if first >= 0:
            found["uv"] = self._steps(
                model.skin_texcoord[first : first + count].astype(float), "places"
            )
        return found

    def _soft(self, rgba: Array, material: int) -> dict[str, Any]:
        ids = np.array([material])
        (color,) = _colors(self._model, np.asarray(rgba)[None], ids)
        found: dict[str, Any] = {"rgba": np.round(color * 255).astype(int).tolist()}
        number = self.material(material)
        return found | ({"material": number} if number >= 0 else {})

    def _flex(self, i: int) -> dict[str, Any]:
        model = self._model
        dim, shown = int(model.flex_dim[i]), self.shown_flexes
        before = int(model.flex_vertnum[:i][shown[:i]].sum())
        first = int(model.flex_elemdataadr[i])
        elements = model.flex_elem[first : first + (dim + 1) * int(model.flex_elemnum[i])]
        begin = int(model.flex_shelldataadr[i])
        shell = model.flex_shell[begin : begin + dim * int(model.flex_shellnum[i])]
        triangles, edges = {
            1: (np.zeros(0, int), elements), 2: (elements, shell), 3: (shell, np.zeros(0, int)),
        }[dim]  # fmt: skip
        found = self._soft(model.flex_rgba[i], int(model.flex_matid[i])) | {
            "dim": dim, "radius": round(float(model.flex_radius[i]), 6), "first": before,
            "count": int(model.flex_vertnum[i]), "flat": bool(model.flex_flatskin[i]),
            "triangles": self._parts.put(differing(triangles)),
            "edges": self._parts.put(differing(edges)),
        }  # fmt: skip
        place = int(model.flex_texcoordadr[i])
        own = model.flex_elemtexcoord[first : first + len(elements)]
        if place >= 0 and dim == 2 and self._is_flat(found):
            uv = np.zeros((found["count"], 2))
            uv[elements] = model.flex_texcoord[place + own]
            found["uv"] = self._steps(uv, "places")
        return found

    def _lights(self) -> dict[str, Any]:
        model = self._model
        head, on = model.vis.headlight, model.light_active.astype(bool)
        is_fixed = model.light_mode == int(mujoco.mjtCamLight.mjCAMLIGHT_FIXED)
        at, axis, body = model.light_pos, model.light_dir, model.light_bodyid
        if not is_fixed[on].all():  # The player cannot move lights that track a body.
            data = mujoco.MjData(model)
            mujoco.mj_fwdPosition(model, data)
            at = np.where(is_fixed[:, None], at, data.light_xpos)
            axis = np.where(is_fixed[:, None], axis, data.light_xdir)
            body = np.where(is_fixed, body, 0)
        others = [
            {
                "body": self._index(int(body[i])),
                "type": int(model.light_type[i]),
                "pos": rounded(at[i]),
                "dir": rounded(axis[i]),
                "diffuse": rounded(model.light_diffuse[i], 3),
                "ambient": rounded(model.light_ambient[i], 3),
                "cutoff": round(float(model.light_cutoff[i]), 3),
                "exponent": round(float(model.light_exponent[i]), 3),
                "shadow": bool(model.light_castshadow[i]),
            }
            for i in on.nonzero()[0].tolist()
        ]
        lit = float(bool(head.active))
        bright = lit * head.diffuse.sum() + model.light_diffuse[on].sum()
        glossy = lit * head.specular.sum() + model.light_specular[on].sum()
        return {
            "ambient": rounded(lit * head.ambient, 3), "diffuse": rounded(lit * head.diffuse, 3),
            "gloss": round(float(glossy / max(bright, 1e-6)), 3), "others": others,
        }  # fmt: skip


def shown_flexes(model: mujoco.MjModel) -> Bools:
    """Returns a mask of the flexes that MuJoCo draws by default, shape (nflex,)."""
    if not model.nflex:
        return np.zeros(0, bool)
    return np.asarray(model.flex_group < _GROUPS)


def _differences(places: Array) -> Array:
    return np.asarray(np.diff(places, axis=1, prepend=0) % (_MESH_STEPS + 1))


def _octahedral(normals: Array) -> np.ndarray:
    """Converts unit vectors, shape (n, 3), to octahedral encoding, shape (2, n), int8."""
    normals = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-12)
    over = (1 - np.abs(normals[:, 1::-1])) * np.where(normals[:, :2] >= 0, 1, -1)
    square = np.where(normals[:, 2:] < 0, over, normals[:, :2])
    return np.round(square.T * _NORMAL_STEPS).astype(np.int8)


def _halved(image: np.ndarray) -> np.ndarray:
    """Halves images of shape (k, h, w, c) along each axis that is too long."""
    for axis in (1, 2):
        size = image.shape[axis] // 2 * 2
        if size > _MAX_PIXELS:
            even = np.take(image, range(0, size, 2), axis=axis).astype(np.uint16)
            image = ((even + np.take(image, range(1, size, 2), axis=axis) + 1) // 2).astype(
                np.uint8
            )
    return image


def _filtered(rows: np.ndarray) -> tuple[int, np.ndarray]:
    """Returns an image of shape (h, w, c), or its pixel differences if these compress better.

    The first returned value is the axis of the differences, or -1 for the image.
    """
    tries = {-1: rows}
    for axis in (0, 1):
        tries[axis] = np.diff(rows, axis=axis, prepend=np.uint8(0))
    best = min(tries, key=lambda way: len(zlib.compress(tries[way].tobytes(), 6)))
    return best, tries[best]
