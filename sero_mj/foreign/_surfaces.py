"""Points on the surfaces of an external model's geoms, from which its robots are measured."""

from __future__ import annotations

import mujoco
import numpy as np

from ..frames import Array, Bools, Ints

_MOST_POINTS = 1500  # of a mesh
_SHOWN_GROUPS = 3  # MuJoCo shows the groups 0 to 2
_ROUND = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
_RING = np.stack([np.cos(_ROUND), np.sin(_ROUND), np.zeros(len(_ROUND))], axis=1)
_TYPES = mujoco.mjtGeom


def surface(
    model: mujoco.MjModel, data: mujoco.MjData, bodies: Ints, trunk: Ints | None = None
) -> tuple[Array, Ints]:
    """Returns points on the visible geoms of bodies (k, 3), m, and the body of each, (k,).

    Of the world's geoms only those of a fused trunk count.
    """
    mine = np.isin(model.geom_bodyid, bodies) & (model.geom_bodyid > 0)
    if trunk is not None:
        mine[trunk] = True
    shown = mine & is_shown(model)
    points, owners = [np.empty((0, 3))], [np.empty(0, np.intp)]
    for geom in (shown if shown.any() else mine).nonzero()[0]:
        points.append(placed_points(model, data, int(geom)))
        owners.append(np.full(len(points[-1]), model.geom_bodyid[geom], np.intp))
    return np.concatenate(points), np.concatenate(owners)


def is_shown(model: mujoco.MjModel) -> Bools:
    """Returns whether MuJoCo shows each geom by default, (ngeom,)."""
    return np.asarray((model.geom_group < _SHOWN_GROUPS) & (model.geom_rgba[:, 3] > 0))


def geom_boxes(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Returns the lowest and highest corners of boxes about all geoms, (ngeom, 3) each, m."""
    rotation = data.geom_xmat.reshape(-1, 3, 3)
    centre = data.geom_xpos + np.einsum("nij,nj->ni", rotation, model.geom_aabb[:, :3])
    half = np.einsum("nij,nj->ni", np.abs(rotation), model.geom_aabb[:, 3:])
    return centre - half, centre + half


def placed_points(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> Array:
    """Returns points on the surface of a geom in the world, (k, 3), m."""
    rotation = data.geom_xmat[geom].reshape(3, 3)
    return np.asarray(data.geom_xpos[geom] + _geom_points(model, geom) @ rotation.T)


def _geom_points(model: mujoco.MjModel, geom: int) -> Array:
    """Returns points on the surface of a geom in its own frame, (k, 3), m."""
    kind, size = _TYPES(int(model.geom_type[geom])), np.array(model.geom_size[geom])
    if kind == _TYPES.mjGEOM_MESH:
        mesh = int(model.geom_dataid[geom])
        first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        step = max(count // _MOST_POINTS, 1)
        return np.array(model.mesh_vert[first : first + count : step], np.float64)
    ring = _RING
    if kind in (_TYPES.mjGEOM_SPHERE, _TYPES.mjGEOM_ELLIPSOID):
        return _ball(np.full(3, size[0]) if kind == _TYPES.mjGEOM_SPHERE else size)
    if kind in (_TYPES.mjGEOM_CAPSULE, _TYPES.mjGEOM_CYLINDER, _TYPES.mjGEOM_BOX):
        if kind == _TYPES.mjGEOM_BOX:  # the ring projected onto a rectangle
            ring = ring / np.abs(ring).max(axis=1, keepdims=True) * [size[0], size[1], 1.0]
            half = size[2]
        else:
            ring, half = ring * size[0], size[1]
        heights = np.linspace(-half, half, 15)[:, None, None]
        points = (ring + heights * [0.0, 0.0, 1.0]).reshape(-1, 3)
        if kind == _TYPES.mjGEOM_CAPSULE:
            ends = _ball(np.full(3, size[0]))
            points = np.concatenate([points, ends + np.sign(ends[:, 2:]) * [0.0, 0.0, half]])
        return np.asarray(points)
    return np.empty((0, 3))  # planes and height fields are not part of a robot


def _ball(radii: Array) -> Array:
    """Returns points on an ellipsoid, (k, 3)."""
    polar = np.linspace(0.0, np.pi, 13)[:, None, None]
    return np.asarray(
        ((np.sin(polar) * _RING + np.cos(polar) * [0.0, 0.0, 1.0]) * radii).reshape(-1, 3)
    )
