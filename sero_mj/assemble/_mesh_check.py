"""Finds the mesh files that MuJoCo cannot compile."""

from __future__ import annotations

from pathlib import Path

import mujoco

from ..errors import Problem
from .robot import SerialRobot
from .scene import Scene


def mesh_problems(scene: Scene) -> list[Problem]:
    """Compiles every mesh of a scene by itself and returns the problems, by robot and file."""
    problems = []
    for name, robot in scene.robots.items():
        for i, meshes in enumerate(robot.filenames):
            for mesh in meshes:
                path = Path(robot.directory) / mesh.file
                problems += _problem(f"robots.{name}.filenames.{i}", path)
        problems += _object_problems(f"robots.{name}.children", robot)
    problems += _object_problems("objects", scene)
    return problems


def _object_problems(key: str, owner: SerialRobot | Scene) -> list[Problem]:
    problems = []
    named = (
        [(str(k), child) for k, child in enumerate(owner.children)]
        if isinstance(owner, SerialRobot)
        else [(item.name, item) for item in owner.objects]
    )
    for name, item in named:
        if item.mesh is not None:
            problems += _problem(f"{key}.{name}.mesh", Path(item.directory) / item.mesh)
    return problems


def _problem(key: str, path: Path) -> list[Problem]:
    file = f"mesh{path.suffix.lower()}"
    xml = (
        f'<mujoco><asset><mesh name="mesh" file="{file}" inertia="convex"/></asset>'
        '<worldbody><geom type="mesh" mesh="mesh"/></worldbody></mujoco>'
    )
    try:
        mujoco.MjModel.from_xml_string(xml, {file: path.read_bytes()})
    except (ValueError, OSError) as error:
        reason = str(error).splitlines()[0].removeprefix("Error: ").replace(file, path.name)
        if path.suffix.lower() == ".stl" and b"facet normal" in path.read_bytes()[:1000]:
            reason = "it is an ASCII STL; save it as a binary one"
        return [Problem(key, f"{path} is not a mesh that MuJoCo reads: {reason}")]
    return []
