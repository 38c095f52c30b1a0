"""Poses, mesh files and grown shapes as PyMJCF writes them, for robots and their doubles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from .. import frames
from ..errors import DeclarationError, Problem
from .robot import SerialRobot
from .shapes import LinkShape

Array = NDArray[np.float64]

SITE_GROUP = 5  # frames are drawn by decor; MuJoCo shows groups 0 to 2


def set_pose(element: Any, T: Array) -> None:
    """Sets `pos` and `quat` of an element from a frame (4, 4)."""
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, T[:3, :3].ravel())
    element.pos, element.quat = T[:3, 3], quat


def joint_axis_frame(robot: SerialRobot, i: int) -> Array:
    """The frame (4, 4) in body i + 1 whose z is the axis of joint i, in both conventions."""
    if robot.dh_convention == "craig":
        return np.eye(4)
    return frames.inverse(robot.dh.link_transforms(np.zeros(robot.n))[i])


def joint_centre(robot: SerialRobot, i: int) -> Array:
    """Where the arrow and billboard of joint i stand in body i + 1, (4, 4)."""
    return joint_axis_frame(robot, i) @ frames.frame(position=robot.offsets[i])


def mesh_asset(root: mjcf.RootElement, name: str, path: Path, scale: float) -> Any:
    """Adds a mesh file to the assets and returns the element.

    Raises:
        DeclarationError: the file cannot be read.
    """
    try:
        contents = path.read_bytes()
    except OSError as error:
        raise DeclarationError([Problem("", f"mesh {path}: {error.strerror}")]) from error
    asset = mjcf.Asset(contents, path.suffix.lower(), prefix=path.stem)
    # The hull gives a mass even to a mesh with holes; the surface is drawn as it is.
    return root.asset.add("mesh", name=name, file=asset, scale=[scale] * 3, inertia="convex")


def shape_geom(shape: LinkShape, scale: float = 1.0) -> dict[str, Any]:
    """Attributes of a geom for a grown shape, scaled about its own middle."""
    middle = shape.ends.mean(axis=0)
    size = shape.size * scale
    if shape.kind == "box":
        axis = shape.ends[1] - shape.ends[0]
        return {"type": "box", "size": size, "pos": middle, "zaxis": axis}
    ends = shape.ends if scale == 1.0 else middle + scale * (shape.ends - middle)
    return {"type": shape.kind, "size": size, "fromto": ends.ravel()}
