"""Creates MJCF elements for an `MjSpec`, such as meshes, materials, poses and generated shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...base.frames import Array
from ..declared.shapes import LinkShape
from ..declared.surroundings import FINISHES, FinishName
from ..importers.mesh_files import Rgba, read_mesh
from ..importers.mjcf_file import add_file

MESH = mujoco.mjtGeom.mjGEOM_MESH
_CONVEX = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
_SHELL = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
SITE_GROUP = 5  # hidden group of frames, as MuJoCo shows groups 0 to 2


def pose(T: Array) -> dict[str, Array]:
    """Converts a frame (4, 4) to the attributes `pos` and `quat` of an MJCF element."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
    return {"pos": T[:3, 3], "quat": quat}


Hull = Literal["always", "unless flat", "never"]


def mesh_assets(
    spec: mujoco.MjSpec, name: str, path: Path, scale: ArrayLike, *, hull: Hull = "always"
) -> list[tuple[str, Rgba | None]]:
    """Adds a mesh file to the assets of a spec, as one mesh per color of the file.

    If the spec contains a mesh of the same file and scale, it is reused.

    Args:
        path: mesh file in any supported format.
        scale: unit of the file in m, as one number or shape (3,). Negative numbers mirror the mesh.
        hull: whether the mesh has a convex hull: "always" for collisions, for which flat meshes
            are rejected, "unless flat" for masses, or "never" for visual geometry.

    Returns:
        names and colors of the meshes.

    Raises:
        DeclarationError: the file cannot be read.
    """
    meshes = []
    for k, piece in enumerate(read_mesh(path)):
        named = path.with_suffix(piece.ending)
        file = add_file(spec, named, piece.contents, piece.digest)
        # The mass is that of the hull, because meshes may have holes. Hulls take most of the time.
        has_hull = hull == "always" or (hull == "unless flat" and not piece.is_flat)
        inertia = _CONVEX if has_hull else _SHELL
        same = [mesh for mesh in spec.meshes if (mesh.file, mesh.inertia) == (file, inertia)]
        mesh = next((mesh for mesh in same if (mesh.scale == scale).all()), None)
        if mesh is None:
            mesh = spec.add_mesh(
                name=f"{name}_{k}" if k else name,
                file=file,
                scale=np.broadcast_to(scale, 3),
                inertia=inertia,
            )
        meshes.append((mesh.name, piece.rgba))
    return meshes


def hull_asset(spec: mujoco.MjSpec, name: str, corners: Array) -> str:
    """Adds the convex hull of vertices (k, 3), m, as a mesh to the assets, and returns `name`."""
    spec.add_mesh(name=name, uservert=corners.ravel(), inertia=_CONVEX)
    return name


def finish_material(spec: mujoco.MjSpec, finish: FinishName) -> dict[str, str]:
    """Returns the material attribute of geoms with a surface finish, and adds the material.

    Geoms without a material are plastic.
    """
    if finish == "plastic":
        return {}
    if spec.material(finish) is None:
        look = FINISHES[finish]
        # This color means "none" to MuJoCo, so geoms of this color do not change.
        spec.add_material(
            name=finish, rgba=[0.5, 0.5, 0.5, 1], roughness=look.roughness, metallic=look.metallic,
            specular=look.specular, shininess=look.shininess,
        )  # fmt: skip
    return {"material": finish}


# Declared sizes are full lengths, and sizes in MuJoCo are half lengths. Radii are the same.
_HALF: dict[str, Any] = {"box": 0.5, "cylinder": np.array([1, 0.5]), "capsule": np.array([1, 0.5])}


def half_sizes(kind: str, size: Array) -> Array:
    """Converts the declared size of a primitive shape to the attribute `size` of a geom, in m."""
    return np.asarray(size * _HALF.get(kind, 1.0))


def geom_type(kind: str) -> Any:
    """Returns MuJoCo's `mjtGeom` constant for a shape such as `box` or `sphere`."""
    return getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")


def shape_geom(shape: LinkShape, scale: float = 1.0) -> dict[str, Any]:
    """Returns the attributes of a geom for a generated shape, scaled about its center."""
    middle = shape.ends.mean(axis=0)
    look = {"type": geom_type(shape.kind), "size": np.atleast_1d(shape.size * scale)}
    if shape.kind == "box":
        return {**look, "pos": middle, "zaxis": shape.ends[1] - shape.ends[0]}
    ends = shape.ends if scale == 1.0 else middle + scale * (shape.ends - middle)
    return {**look, "fromto": ends.ravel()}
