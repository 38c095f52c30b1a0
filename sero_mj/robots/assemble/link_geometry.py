"""Creates geoms for links from declared mesh files and primitive shapes, or generated shapes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...base.errors import Problem, collect, raise_any
from ...base.frames import MIRROR, Array
from ..declared.robot import SerialRobot
from ..declared.robot_parts import LinkGeometry
from ..declared.shapes import SHELL, LinkShape, generate_shapes, trims
from .mjcf_elements import (
    MESH,
    Hull,
    finish_material,
    geom_type,
    half_sizes,
    mesh_assets,
    pose,
    shape_geom,
)
from .mjcf_links import drawn_links, touching_links

Geom = dict[str, Any]
_MAX_TRIMMED = 16  # maximum number of joints of robots with decorative trims


def generated(robot: SerialRobot) -> list[list[LinkShape]]:
    """Returns the generated shapes of the base and the links of a robot."""
    return generate_shapes(robot.kinematics, robot.T_n_flange, robot.strokes, robot.flange_link)


def drawn_geoms(
    root: mujoco.MjSpec,
    robot: SerialRobot,
    problems: list[Problem],
    shrink: float = 1.0,
    hull: Hull = "never",
) -> list[list[Geom]]:
    """Returns the attributes of the visible geoms of the base and of each link, in link frames.

    Sizes are multiplied by `shrink`, about the origin of each link. Errors are added to `problems`.
    """
    scope = "" if shrink == 1.0 else f"double-{robot.name}-"
    if robot.mjcf is not None:
        with collect(problems, ""):
            return drawn_links(root, robot, scope, shrink)
        return [[] for _ in range(robot.n + 1)]
    if not robot.filenames:
        links = generated(robot)
        return [[{"rgba": s.rgba, **shape_geom(s, shrink)} for s in link] for link in links]
    return _declared(root, robot, "filenames", scope, problems, hull, shrink)


def trim_geoms(robot: SerialRobot) -> list[list[Geom]]:
    """Returns the attributes of massless decorative geoms on generated links of small robots."""
    if robot.mjcf is not None or robot.filenames or robot.n > _MAX_TRIMMED:
        return [[] for _ in range(robot.n + 1)]
    found = trims(generated(robot), robot.T_n_flange, robot.flange_link)
    return [[{"rgba": s.rgba, "mass": 0, **shape_geom(s)} for s in link] for link in found]


def touching_geoms(root: mujoco.MjSpec, robot: SerialRobot) -> list[list[Geom]]:
    """Returns the attributes of the collision geoms from `collisions` or MJCF, per link.

    Raises DeclarationError if a mesh file cannot be read.
    """
    if robot.mjcf is not None:
        return touching_links(root, robot)
    problems: list[Problem] = []
    geoms = _declared(root, robot, "collisions", "touching-", problems, "always")
    for geom in (geom for link in geoms for geom in link):
        del geom["rgba"]
        geom.pop("material", None)
    raise_any(problems)
    return geoms


def _declared(
    root: mujoco.MjSpec,
    robot: SerialRobot,
    key: str,
    scope: str,
    problems: list[Problem],
    hull: Hull,
    shrink: float = 1.0,
) -> list[list[Geom]]:
    geoms: list[list[Geom]] = [[] for _ in range(robot.n + 1)]
    for i, parts in enumerate(getattr(robot, key)):
        for k, part in enumerate(parts):
            rgba = None if part.color is None else robot.colors[part.color]
            if part.shape == "generated":
                finish = finish_material(root, part.finish)
                for shape in generated(robot)[i]:
                    look = _faded(shape.rgba if rgba is None else rgba, part)
                    geoms[i].append({"rgba": look, **finish, **shape_geom(shape, shrink)})
                continue
            placed = part.model_copy(
                update={
                    "frame": _placed(robot, part.frame, shrink),
                    "scale": shrink * mesh_scale(robot, part),
                    "size": None if part.size is None else part.size * shrink,
                }
            )
            with collect(problems, f"{key}.{i}"):
                name, folder = f"{scope}link{i}_{k}", Path(robot.directory)
                geoms[i] += part_geoms(root, placed, name, folder, rgba, hull)
    return geoms


def part_geoms(
    root: mujoco.MjSpec, part: LinkGeometry, name: str, folder: Path, rgba: Any, hull: Hull
) -> list[Geom]:
    """Returns the attributes of geoms: one per color of a mesh file, or one for a primitive shape.

    Raises DeclarationError if the file cannot be read.
    """
    at = pose(part.frame) | finish_material(root, part.finish)
    if part.shape is not None:
        assert part.size is not None  # LinkGeometry checks this.
        size = half_sizes(part.shape, part.size)
        look = _faded(SHELL if rgba is None else rgba, part)
        return [{"type": geom_type(part.shape), "size": size, "rgba": look, **at}]
    assert part.scale is not None
    geoms = []
    for mesh, own in mesh_assets(root, name, folder / (part.file or ""), part.scale, hull=hull):
        look = next((each for each in (rgba, own) if each is not None), SHELL)
        geoms.append({"type": MESH, "meshname": mesh, "rgba": _faded(look, part), **at})
    return geoms


def _faded(rgba: Any, part: LinkGeometry) -> Any:
    return rgba if part.opacity == 1.0 else [*rgba[:3], rgba[3] * part.opacity]


def mesh_scale(robot: SerialRobot, part: LinkGeometry) -> Array:
    """Returns the scale of a mesh, shape (3,), m per unit. It is negative along mirrored axes."""
    scale = np.full(3, robot.mesh_scale) if part.scale is None else part.scale
    return scale * (MIRROR.diagonal()[:3] if robot.mirrored else 1.0)


def _placed(robot: SerialRobot, T: Array, shrink: float) -> Array:
    T = MIRROR @ T @ MIRROR if robot.mirrored else T.copy()
    T[:3, 3] *= shrink
    return T
