"""Writes the visual geometry of a robot's base and links as VRML97 files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ...base.errors import Problem, raise_any
from ...base.frames import Array, frame, rotation_about, rotation_from_quat
from ...robots.assemble.link_geometry import drawn_geoms
from .writer import face_set, shape_lines

if TYPE_CHECKING:
    from ...robots.declared.robot import SerialRobot

_CREASE = 0.7  # rad; MuJoCo shades sharper edges as edges
_UPRIGHT = frame(rotation_about(0, np.pi / 2))  # from z, the cylinder axis of MuJoCo, to y
Geom = mujoco.mjtGeom


def link_files(robot: SerialRobot) -> dict[str, str]:
    """Returns the texts of the files of base and links by file name, in the order of links."""
    root, problems = mujoco.MjSpec(), list[Problem]()
    links = drawn_geoms(root, robot, problems)
    raise_any(problems)
    owners = [i for i, geoms in enumerate(links) for _ in geoms]
    for geom in (geom for geoms in links for geom in geoms):
        root.worldbody.add_geom(contype=0, conaffinity=0, mass=0, **geom)
    model = root.compile()
    files = {}
    for i in range(len(links)):
        lines = ["#VRML V2.0 utf8", f"# {robot.name}, {'base' if i == 0 else f'link {i}'}; m"]
        for k in (k for k, owner in enumerate(owners) if owner == i):
            lines += _shapes(model, k)
        files[f"link{i}.wrl" if i else "base.wrl"] = "\n".join([*lines, ""])
    return files


def _shapes(model: Any, k: int) -> list[str]:
    kind, size = Geom(model.geom_type[k]), model.geom_size[k]
    T = frame(rotation_from_quat(model.geom_quat[k]), model.geom_pos[k])
    rgba = model.geom_rgba[k].round(6).tolist()
    if kind == Geom.mjGEOM_MESH:
        return shape_lines(_face_set(model, int(model.geom_dataid[k]), T), rgba)
    if kind == Geom.mjGEOM_BOX:
        lengths = " ".join(f"{2 * length:.7g}" for length in size)
        return shape_lines(f"Box {{ size {lengths} }}", rgba, T)
    if kind == Geom.mjGEOM_SPHERE:
        return shape_lines(f"Sphere {{ radius {size[0]:.7g} }}", rgba, T)
    if kind == Geom.mjGEOM_ELLIPSOID:
        return shape_lines("Sphere { radius 1 }", rgba, T, size)
    tube = f"Cylinder {{ radius {size[0]:.7g} height {2 * size[1]:.7g} }}"
    lines = shape_lines(tube, rgba, T @ _UPRIGHT)
    if kind == Geom.mjGEOM_CAPSULE:
        for end in (-size[1], size[1]):
            there = T @ frame(position=np.array([0.0, 0.0, end]))
            lines += shape_lines(f"Sphere {{ radius {size[0]:.7g} }}", rgba, there)
    return lines


def _face_set(model: Any, mesh: int, T: Array) -> str:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[first : first + count].astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return face_set(points, model.mesh_face[face : face + faces], _CREASE)
