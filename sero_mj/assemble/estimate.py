"""What links weigh whose robot file does not say: the hull of their meshes, or grown shapes.

MuJoCo computes volumes, centres and tensors; the density is declared or `LINK_DENSITY`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from .. import frames
from ..errors import DeclarationError
from .mjcf_geoms import mesh_asset, shape_geom
from .robot import SerialRobot
from .shapes import grow_links

Array = NDArray[np.float64]

_STEEL = 7800.0  # kg/m3; no link is denser
# What no shape adds up to, because it is too small for MuJoCo to be a body.
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
    """Convex hulls of the base's and every link's meshes together, in the frame of its row.

    Returns:
        n + 1 times the hull's corners (k, 3), m; None for a link without meshes.

    Raises:
        DeclarationError: a file cannot be read.
        ValueError: MuJoCo cannot compile a mesh, for it is flat, say.
    """
    hulls: list[Array | None] = [None] * (robot.n + 1)
    if not robot.filenames:
        return hulls
    root = mjcf.RootElement(model="meshes")
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
            root.worldbody.add("geom", type="mesh", mesh=asset)
            owners.append(i)
    model = _compile(root)
    clouds: list[list[Array]] = [[] for _ in hulls]
    for mesh_id, i in enumerate(owners):
        clouds[i].append(_corners(model, mesh_id))
    for i, cloud in enumerate(clouds):
        if cloud:
            hulls[i] = _hull(np.concatenate(cloud))
    return hulls


def estimate_links(robot: SerialRobot, hulls: list[Array | None]) -> LinkInertias:
    """Masses of links by their shapes and the density that the robot declares.

    Args:
        robot: of n joints.
        hulls: what `link_hulls` returned; where there is none, shapes grow from the DH table.
    """
    density = min(robot.dynamics.density, _STEEL)
    root = mjcf.RootElement(model="estimate")
    root.default.geom.density = density
    root.compiler.boundmass, root.compiler.boundinertia = _LEAST_MASS, 1e-12
    grown = grow_links(robot.dh, robot.flange_frame, robot.strokes)
    for i, hull in enumerate(hulls):
        body = root.worldbody.add("body", name=f"link{i}")
        if hull is None:
            for shape in grown[i]:
                body.add("geom", **shape_geom(shape))
        else:
            asset = root.asset.add("mesh", name=f"hull{i}", vertex=hull.ravel(), inertia="convex")
            body.add("geom", type="mesh", mesh=asset)
    model = _compile(root)
    tensors = np.empty((robot.n + 1, 3, 3))
    for i in range(robot.n + 1):
        axes = frames.rotation_from_quat(model.body_iquat[i + 1])
        tensors[i] = axes @ np.diag(model.body_inertia[i + 1]) @ axes.T
    return LinkInertias(model.body_mass[1:].copy(), model.body_ipos[1:].copy(), tensors)


def _compile(root: Any) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(root.to_xml_string(), root.get_assets())


def _corners(model: mujoco.MjModel, mesh: int) -> Array:
    """Vertices of a mesh as its file has them; MuJoCo keeps them about the centre of mass."""
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    axes = frames.rotation_from_quat(model.mesh_quat[mesh])
    corners = model.mesh_vert[start : start + count].astype(np.float64)
    return np.asarray(corners @ axes.T + model.mesh_pos[mesh])


def _hull(cloud: Array) -> Array:
    """Corners (k, 3) of the convex hull of points (m, 3)."""
    root = mjcf.RootElement(model="hull")
    asset = root.asset.add("mesh", name="hull", vertex=cloud.ravel(), inertia="convex")
    root.worldbody.add("geom", type="mesh", mesh=asset)
    model = _compile(root)
    # Layout of mesh_graph: number of corners and faces, an address and a vertex per corner, ...
    graph = model.mesh_graph[model.mesh_graphadr[0] :]
    count = int(graph[0])
    return np.asarray(_corners(model, 0)[graph[2 + count : 2 + 2 * count]])
