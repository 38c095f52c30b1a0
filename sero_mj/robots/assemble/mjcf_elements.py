"""Elements of MJCF for `MjSpec`: mesh files, poses, generated shapes."""

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
SITE_GROUP = 5  # frames are drawn by decor; MuJoCo shows groups 0 to 2


def pose(T: Array) -> dict[str, Array]:
    """Returns `pos` and `quat` of an element for a frame (4, 4)."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
    return {"pos": T[:3, 3], "quat": quat}


Hull = Literal["always", "unless flat", "never"]


def mesh_assets(
    spec: mujoco.MjSpec, name: str, path: Path, scale: ArrayLike, *, hull: Hull = "always"
) -> list[tuple[str, Rgba | None]]:
    """Adds a mesh file to the assets, and returns name and color of a mesh for each of its colors.

    A mesh of the same file and scale is reused.

    Args:
        path: a file in any format supported by `read_mesh`.
        scale: m per unit, one number or (3,); negative numbers mirror the mesh.
        hull: convex hull of the mesh: "always" for collisions, for which flat meshes are
            rejected; "unless flat" for masses; "never" for visual geometry.

    Raises:
        DeclarationError: the file cannot be read.
    """
    meshes = []
    for k, piece in enumerate(read_mesh(path)):
        named = path.with_suffix(piece.ending)
        file = add_file(spec, named, piece.contents, piece.digest)
        # The mass is that of the hull, because meshes may have holes. Computing hulls takes most of
        # the time.
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
    """Adds a mesh of vertices (k, 3), m, to the assets and returns its name."""
    spec.add_mesh(name=name, uservert=corners.ravel(), inertia=_CONVEX)
    return name


def finish_material(spec: mujoco.MjSpec, finish: FinishName) -> dict[str, str]:
    """Returns the attribute of geoms with a finish, and adds its material once.

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


# Declared sizes are full lengths, MuJoCo's are half lengths; radii are the same.
_HALF: dict[str, Any] = {"box": 0.5, "cylinder": np.array([1, 0.5]), "capsule": np.array([1, 0.5])}


def half_sizes(kind: str, size: Array) -> Array:
    """Returns MuJoCo's `size` for a declared size of a shape, m."""
    return np.asarray(size * _HALF.get(kind, 1.0))


def geom_type(kind: str) -> Any:
    """Returns MuJoCo's constant for `box`, `sphere`, ..."""
    return getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")


def shape_geom(shape: LinkShape, scale: float = 1.0) -> dict[str, Any]:
    """Returns the attributes of a geom for a generated shape, scaled about its centre."""
    middle = shape.ends.mean(axis=0)
    look = {"type": geom_type(shape.kind), "size": np.atleast_1d(shape.size * scale)}
    if shape.kind == "box":
        return {**look, "pos": middle, "zaxis": shape.ends[1] - shape.ends[0]}
    ends = shape.ends if scale == 1.0 else middle + scale * (shape.ends - middle)
    return {**look, "fromto": ends.ravel()}
