"""Poses, mesh files and generated shapes in the form `MjSpec` takes, for robots and doubles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from .. import frames
from ..errors import DeclarationError, Problem
from ..files import read_file
from .mjcf_piece import MOST_ASSET_BYTES, add_file
from .robot import SerialRobot
from .shapes import LinkShape

Array = NDArray[np.float64]

MESH = mujoco.mjtGeom.mjGEOM_MESH
_CONVEX = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
SITE_GROUP = 5  # frames are drawn by decor; MuJoCo shows groups 0 to 2


def pose(T: Array) -> dict[str, Array]:
    """Returns `pos` and `quat` of an element for a frame (4, 4)."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
    return {"pos": T[:3, 3], "quat": quat}


def joint_axis_frame(robot: SerialRobot, i: int) -> Array:
    """Returns the frame (4, 4) in body i + 1 whose z is the axis of joint i."""
    if robot.dh_convention == "craig":
        return np.eye(4)
    return frames.inverse(robot.dh.link_transforms(np.zeros(robot.n))[i])


def joint_centre(robot: SerialRobot, i: int) -> Array:
    """Returns the frame (4, 4) in body i + 1 of the arrow and billboard of joint i."""
    return joint_axis_frame(robot, i) @ frames.frame(position=robot.offsets[i])


def mesh_asset(spec: mujoco.MjSpec, name: str, path: Path, scale: float) -> str:
    """Adds a mesh file to the assets and returns the mesh's name.

    Args:
        spec: changed in place.
        name: of the mesh.
        path: of the file.
        scale: metres per unit of the file.

    Raises:
        DeclarationError: the file cannot be read.
    """
    try:
        contents = read_file(path, MOST_ASSET_BYTES)
    except OSError as error:
        raise DeclarationError([Problem("", f"mesh {path}: {error.strerror}")]) from error
    # Inertia by the convex hull, so that a mesh with holes has a mass; drawing is not affected.
    file = add_file(spec, path, contents)
    spec.add_mesh(name=name, file=file, scale=[scale] * 3, inertia=_CONVEX)
    return name


def hull_asset(spec: mujoco.MjSpec, name: str, corners: Array) -> str:
    """Adds a mesh to the assets and returns its name.

    Args:
        spec: changed in place.
        name: of the mesh.
        corners: its vertices, (k, 3), m.
    """
    spec.add_mesh(name=name, uservert=corners.ravel(), inertia=_CONVEX)
    return name


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
