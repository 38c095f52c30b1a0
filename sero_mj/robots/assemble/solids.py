"""Finds the visible geoms of a compiled model, their boxes, and what they hide."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints

_SHOWN_GROUPS = 3  # MuJoCo shows the groups 0 to 2
_ROUND = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))  # corners of a box in half lengths
_MAX_CROSSINGS = 24  # maximum number of surfaces that a ray crosses
_SKIN_DISTANCE = 2.5  # maximum distance of skin faces, relative to the largest radius
_STEP = 1e-6  # step of a ray beyond a surface, relative to the largest radius
_ALL = int(mujoco.mjtCatBit.mjCAT_ALL)
_EXTRA_GEOMS = 100  # number of geoms that MuJoCo adds to those of a model


def is_shown(model: mujoco.MjModel) -> Bools:
    """Returns a mask of the geoms that are visible by default, shape (ngeom,)."""
    return np.asarray((model.geom_group < _SHOWN_GROUPS) & (model.geom_rgba[:, 3] > 0))


def geoms_of(model: mujoco.MjModel, bodies: Ints, trunk: Ints | None = None) -> Ints:
    """Returns the ids of the visible (or else all) geoms of bodies, and of the geoms `trunk`."""
    mine = np.isin(model.geom_bodyid, bodies) & (model.geom_bodyid > 0)
    if trunk is not None:
        mine[trunk] = True
    shown = mine & is_shown(model)
    return np.asarray((shown if shown.any() else mine).nonzero()[0])


def geom_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Returns minima and maxima of axis-aligned boxes around all geoms, shapes (ngeom, 3), m."""
    rotation = data.geom_xmat.reshape(-1, 3, 3)
    centre = data.geom_xpos + np.einsum("nij,nj->ni", rotation, model.geom_aabb[:, :3])
    half = np.einsum("nij,nj->ni", np.abs(rotation), model.geom_aabb[:, 3:])
    return centre - half, centre + half


def geom_corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: Bools | None = None) -> Array:
    """Returns corners of oriented boxes around (default: all) geoms, shape (k, 8, 3), m."""
    which = slice(None) if geoms is None else geoms
    rotation = data.geom_xmat.reshape(-1, 3, 3)[which]
    box = model.geom_aabb[which]
    local = box[:, None, :3] + _CORNERS * box[:, None, 3:]
    return np.asarray(data.geom_xpos[which][:, None] + local @ rotation.transpose(0, 2, 1))


def lowest_height(model: mujoco.MjModel, data: mujoco.MjData, geoms: Ints) -> float:
    """Returns the height of the lowest point of geoms, m.

    The height is exact for meshes. Other geoms are approximated by axis-aligned boxes.
    """
    heights = geom_boxes(model, data)[0][:, 2]
    for geom in geoms[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH]:
        mesh = int(model.geom_dataid[geom])
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        upwards = data.geom_xmat[geom, 6:]  # vertical direction in the frame of the geom
        rise = model.mesh_vert[start : start + count] @ upwards
        heights[geom] = data.geom_xpos[geom, 2] + rise.min()
    return float(heights[geoms].min())


class Solids:
    """The visible geoms and skins of a model, in a pose that `mj_fwdPosition` has computed."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        moving = model.body_weldid[model.geom_bodyid] > 0
        self._groups = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._groups[:_SHOWN_GROUPS] = 1
        if not (moving & is_shown(model)).any() and not model.nskin:
            self._groups[:] = 1  # The model has only collision geoms.
        self._geom, self._normal = np.full(1, -1, np.int32), np.zeros(3)  # results of the last ray
        self._skins = _posed_skins(model, data) if model.nskin else []

    def hidden_shares(self, centre: Array, axis: Array, radii: Array, height: float) -> Array:
        """Returns the fractions of rings about an axis that geoms or skins hide, shape (k,).

        Args:
            centre: center of the rings, shape (3,), m.
            axis: unit vector of the axis, shape (3,).
            radii: ascending radii of the rings, shape (k,), m.
            height: height of the rings along the axis, m.
        """
        side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
        side /= np.linalg.norm(side)
        other = np.cross(axis, side)
        skins = [_near(skin, centre, _SKIN_DISTANCE * float(radii[-1])) for skin in self._skins]
        starts = centre + np.array([[-height / 2], [0.0], [height / 2]]) * axis
        directions = np.cos(_ROUND)[:, None] * side + np.sin(_ROUND)[:, None] * other
        reach, count = float(radii[-1]), len(_ROUND) * len(starts)
        spans: list[tuple[int, float, float]] = []  # rays, with intervals inside a geom or skin
        for ray, (direction, start) in enumerate(product(directions, starts)):
            entered: dict[int, float] = {}  # last entry point of the ray by geom or skin
            for what, at, is_exit in self._crossings(start, direction, reach, skins):
                if is_exit:
                    spans.append((ray, entered.get(what, 0.0), at))
                entered[what] = at
        inside = np.zeros((count, len(radii)), bool)
        if spans:
            rays, begins, ends = np.array(spans).T[:, :, None]
            np.logical_or.at(inside, rays[:, 0].astype(int), (radii > begins) & (radii < ends))
        return np.asarray(inside.mean(axis=0))

    def _crossings(
        self, start: Array, direction: Array, reach: float, skins: list[_Skin]
    ) -> Iterator[tuple[int, float, bool]]:
        geom, normal, step = self._geom, self._normal, _STEP * reach
        at = 0.0
        for _ in range(_MAX_CROSSINGS):
            if at > reach:
                break
            point = start + at * direction
            gap = mujoco.mj_ray(
                self._model, self._data, point, direction, self._groups, True, -1, geom, normal
            )
            if gap < 0:
                break
            yield int(geom[0]), at + gap, bool(normal @ direction > 0)
            at += gap + step
        for i, (faces, vertices, normals) in enumerate(skins):
            at = 0.0
            for _ in range(_MAX_CROSSINGS if len(faces) else 0):
                point = start + at * direction
                gap = mujoco.mju_raySkin(
                    len(faces), len(vertices), faces, vertices, point, direction, geom
                )
                if gap < 0 or at > reach:
                    break
                yield -1 - i, at + gap, bool(normals[geom[0]] @ direction > 0)
                at += gap + step


_Skin = tuple[Array, Array, Array]  # faces (f, 3), vertices (v, 3) and their normals (v, 3)


def _posed_skins(model: mujoco.MjModel, data: mujoco.MjData) -> list[_Skin]:
    scene = mujoco.MjvScene(model, maxgeom=model.ngeom + _EXTRA_GEOMS)
    option, camera = mujoco.MjvOption(), mujoco.MjvCamera()
    mujoco.mjv_updateScene(model, data, option, None, camera, _ALL, scene)
    skins = []
    for i in range(model.nskin):
        if model.skin_group[i] < _SHOWN_GROUPS and model.skin_rgba[i, 3] > 0:
            first, count = model.skin_vertadr[i], model.skin_vertnum[i]
            mine = slice(first, first + count)
            start = model.skin_faceadr[i]
            faces = model.skin_face[start : start + model.skin_facenum[i]]
            vertices = scene.skinvert.reshape(-1, 3)[mine].copy()
            skins.append((faces.copy(), vertices, scene.skinnormal.reshape(-1, 3)[mine].copy()))
    return skins


def _near(skin: _Skin, centre: Array, reach: float) -> _Skin:
    faces, vertices, normals = skin
    corners = vertices[faces]
    near = corners.min(axis=1) <= centre + reach
    near &= corners.max(axis=1) >= centre - reach
    return np.ascontiguousarray(faces[near.all(axis=1)]), vertices, normals
