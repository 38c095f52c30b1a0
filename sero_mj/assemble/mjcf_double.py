"""Builds a double as MJCF: one mocap body per link under the world (flat, as in Fig. 4(a))."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ._mjcf_geoms import MESH, SITE_GROUP, joint_centre, mesh_asset, pose, shape_geom
from .double import PATH_FADE, Double
from .robot import SerialRobot
from .shapes import generate_shapes

DOUBLE_GROUP = 2
OUT_OF_SIGHT = np.array([0.0, 0.0, -1000.0])
# A double is slightly smaller than its robot, so that its surface is inside the robot's where
# they nearly coincide: no flicker (z-fighting).
_SHRINK = 0.985


def body_names(double: Double, robot: SerialRobot) -> list[list[str]]:
    """Returns the names of the bodies of every double of a declaration, base to last link."""
    rows = 1 if double.path is None else double.path_length
    return [
        [f"double-{double.name}-{row}-link{i}" for i in range(robot.n + 1)] for row in range(rows)
    ]


def frame_names(double: Double, robot: SerialRobot) -> list[str]:
    """Returns the names of the bodies with the frames of a double's joints; empty for a path."""
    if double.path is not None:
        return []
    return [f"double-{double.name}-frame{i + 1}" for i in range(robot.n)]


def add_double(root: mujoco.MjSpec, double: Double, robot: SerialRobot) -> None:
    """Adds the bodies of a double, at zero joint angles.

    The world hides them after compilation. Compiled out of sight they would make MuJoCo scale
    near plane, far plane and shadows for a scene of a kilometre.

    Args:
        root: the scene, changed in place.
        double: the declaration.
        robot: the robot it copies.
    """
    rows = body_names(double, robot)
    fade = np.linspace(*PATH_FADE, len(rows)) if len(rows) > 1 else np.ones(1)
    shapes = [] if robot.filenames else generate_shapes(robot.dh, robot.flange_frame, robot.strokes)
    at_zero = robot.dh.frames(np.zeros(robot.n), robot.base_frame)
    for names, share in zip(rows, fade, strict=True):
        look = {"rgba": double.rgba * [1, 1, 1, share], "group": DOUBLE_GROUP}
        for i, name in enumerate(names):
            body = root.worldbody.add_body(name=name, mocap=True, **pose(at_zero[i]))
            geoms = (
                [shape_geom(s, _SHRINK) for s in shapes[i]] if shapes else _meshes(root, robot, i)
            )
            for geom in geoms:
                body.add_geom(**look, contype=0, conaffinity=0, mass=0, **geom)
    # Bodies of their own, since a link that coincides with the robot's is moved out of sight.
    for i, name in enumerate(frame_names(double, robot)):
        body = root.worldbody.add_body(name=name, mocap=True, **pose(at_zero[i + 1]))
        body.add_site(name=name, group=SITE_GROUP)
        centre = f"double-{double.name}-centre{i + 1}"
        body.add_site(name=centre, group=SITE_GROUP, **pose(joint_centre(robot, i)))
        if i == robot.n - 1:
            flange = f"double-{double.name}-flange"
            body.add_site(name=flange, group=SITE_GROUP, **pose(robot.flange_frame))


def _meshes(root: mujoco.MjSpec, robot: SerialRobot, i: int) -> list[dict[str, Any]]:
    """Returns the geoms of a link's meshes, slightly smaller; doubles of a robot share assets."""
    geoms = []
    for k, mesh in enumerate(robot.filenames[i]):
        name = f"double-{robot.name}-link{i}-{k}"
        if root.mesh(name) is None:
            path = Path(robot.directory) / mesh.file
            mesh_asset(root, name, path, _SHRINK * robot.mesh_scale)
        geoms.append({"type": MESH, "meshname": name})
    return geoms
