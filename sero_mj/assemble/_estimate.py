"""Estimates link inertias that a robot file does not state, from mesh hulls or generated shapes.

MuJoCo computes volumes, centres of mass and tensors; the density is declared or `LINK_DENSITY`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from .. import frames
from ..errors import DeclarationError
from ._mjcf_geoms import MESH, hull_asset, mesh_asset, shape_geom
from .robot import SerialRobot
from .shapes import generate_shapes

Array = NDArray[np.float64]

_STEEL = 7800.0  # kg/m3; no link is denser
# Lower bound: MuJoCo refuses bodies of smaller mass.
_LEAST_MASS = 1e-6  # kg


@dataclass(frozen=True, eq=False)
class LinkInertias:
    """Masses of the base and every link, in the frames of the DH rows.

    Attributes:
        masses: (n + 1,), kg.
        centers: (n + 1, 3), centres of mass, m.
        tensors: (n + 1, 3, 3), about these, kg m2.
    """

    masses: Array
    centers: Array
    tensors: Array


def link_hulls(robot: SerialRobot) -> list[Array | None]:
    """Returns the convex hull of the meshes of the base and of every link, in its DH frame.

    Returns:
        n + 1 arrays of hull vertices (k, 3), m; None for a link without meshes.

    Raises:
        DeclarationError: a file cannot be read.
        ValueError: MuJoCo cannot compile a mesh, for example a flat one.
    """
    hulls: list[Array | None] = [None] * (robot.n + 1)
    if not robot.filenames:
        return hulls
    root = mujoco.MjSpec()
    owners = []
    for i, meshes in enumerate(robot.filenames):
        for k, mesh in enumerate(meshes):
            path = Path(robot.directory) / mesh.file
            try:
                asset = mesh_asset(root, f"link{i}_{k}", path, robot.mesh_scale)
            except DeclarationError as error:
                raise DeclarationError([p.inside(f"filenames.{i}") for p in error.problems]) from (
                    error
                )
            root.worldbody.add_geom(type=MESH, meshname=asset)
            owners.append(i)
    model = root.compile()
    clouds: list[list[Array]] = [[] for _ in hulls]
    for mesh_id, i in enumerate(owners):
        clouds[i].append(_corners(model, mesh_id))
    for i, cloud in enumerate(clouds):
        if cloud:
            hulls[i] = _hull(np.concatenate(cloud))
    return hulls


def estimate_links(robot: SerialRobot, hulls: list[Array | None]) -> LinkInertias:
    """Estimates link masses from their shapes and the declared density.

    Args:
        robot: of n joints.
        hulls: as returned by `link_hulls`; a link without one gets shapes generated from the
            DH table.
    """
    density = min(robot.dynamics.density, _STEEL)
    root = mujoco.MjSpec()
    root.compiler.boundmass, root.compiler.boundinertia = _LEAST_MASS, 1e-12
    generated = generate_shapes(robot.dh, robot.flange_frame, robot.strokes)
    for i, hull in enumerate(hulls):
        body = root.worldbody.add_body(name=f"link{i}")
        if hull is None:
            for shape in generated[i]:
                body.add_geom(density=density, **shape_geom(shape))
        else:
            asset = hull_asset(root, f"hull{i}", hull)
            body.add_geom(type=MESH, meshname=asset, density=density)
    model = root.compile()
    tensors = np.empty((robot.n + 1, 3, 3))
    for i in range(robot.n + 1):
        axes = frames.rotation_from_quat(model.body_iquat[i + 1])
        tensors[i] = axes @ np.diag(model.body_inertia[i + 1]) @ axes.T
    return LinkInertias(model.body_mass[1:].copy(), model.body_ipos[1:].copy(), tensors)


def _corners(model: mujoco.MjModel, mesh: int) -> Array:
    """Returns the vertices of a mesh in its file's frame; MuJoCo stores them about its centre."""
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    axes = frames.rotation_from_quat(model.mesh_quat[mesh])
    corners = model.mesh_vert[start : start + count].astype(np.float64)
    return np.asarray(corners @ axes.T + model.mesh_pos[mesh])


def _hull(cloud: Array) -> Array:
    """Returns the vertices (k, 3) of the convex hull of points (m, 3)."""
    root = mujoco.MjSpec()
    root.worldbody.add_geom(type=MESH, meshname=hull_asset(root, "hull", cloud))
    model = root.compile()
    # Layout of mesh_graph: number of corners and faces, an address and a vertex per corner, ...
    graph = model.mesh_graph[model.mesh_graphadr[0] :]
    count = int(graph[0])
    return np.asarray(_corners(model, 0)[graph[2 + count : 2 + 2 * count]])
