"""A double as MJCF: one mocap body per link, under the world (the flat hierarchy of Fig. 4(a))."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from dm_control import mjcf

from .double import Double
from .robot import SerialRobot
from .shapes import LinkShape, grow_links

DOUBLE_GROUP = 2
OUT_OF_SIGHT = np.array([0.0, 0.0, -1000.0])
# A double is a little smaller than its robot, so that where they nearly coincide its surface lies
# inside and does not flicker through the robot's.
_SHRINK = 0.985
_PATH_FADE = (
    0.12,
    0.6,
)  # opacity of a path's first and last double: the row must not hide the robot


def body_names(double: Double, robot: SerialRobot) -> list[list[str]]:
    """Names of the bodies of every double (one, or the row of a path), base to last link."""
    rows = 1 if double.path is None else double.path_length
    return [
        [f"double-{double.name}-{row}-link{i}" for i in range(robot.n + 1)] for row in range(rows)
    ]


def add_double(root: mjcf.RootElement, double: Double, robot: SerialRobot) -> None:
    """Adds the bodies of a double, where MuJoCo has its robot at first: at zero.

    A world hides them at once; were they compiled out of sight, MuJoCo would take the scene for
    a kilometre large and scale near plane, far plane and shadows by it.
    """
    rows = body_names(double, robot)
    fade = np.linspace(*_PATH_FADE, len(rows)) if len(rows) > 1 else np.ones(1)
    grown = [] if robot.filenames else grow_links(robot.dh, robot.flange_frame, robot.strokes)
    home = robot.dh.frames(np.zeros(robot.n), robot.base_frame)
    for names, share in zip(rows, fade, strict=True):
        rgba = double.rgba * [1, 1, 1, share]
        for i, name in enumerate(names):
            axes = home[i, :3, :2].T.ravel()
            body = root.worldbody.add(
                "body", name=name, mocap=True, pos=home[i, :3, 3], xyaxes=axes
            )
            for geom in _geoms(root, double, robot, grown, i):
                body.add(
                    "geom", rgba=rgba, group=DOUBLE_GROUP, contype=0, conaffinity=0, mass=0, **geom
                )


def _geoms(
    root: mjcf.RootElement,
    double: Double,
    robot: SerialRobot,
    grown: list[list[LinkShape]],
    i: int,
) -> list[dict[str, Any]]:
    if grown:
        return [_shape(shape) for shape in grown[i]]
    geoms = []
    for k, mesh in enumerate(robot.filenames[i]):
        name = f"double-{robot.name}-link{i}-{k}"
        asset = root.find("mesh", name)
        if asset is None:
            path = Path(robot.directory) / mesh.file
            file = mjcf.Asset(path.read_bytes(), path.suffix.lower(), prefix=path.stem)
            scale = [_SHRINK * robot.mesh_scale] * 3
            asset = root.asset.add("mesh", name=name, file=file, scale=scale, inertia="convex")
        geoms.append({"type": "mesh", "mesh": asset})
    return geoms


def _shape(shape: LinkShape) -> dict[str, Any]:
    ends = shape.ends
    size = shape.size * _SHRINK
    if shape.kind == "box":
        return {"type": "box", "size": size, "pos": ends.mean(axis=0), "zaxis": ends[1] - ends[0]}
    middle = ends.mean(axis=0)
    shrunk = middle + _SHRINK * (ends - middle)
    return {"type": shape.kind, "size": size, "fromto": shrunk.ravel()}
