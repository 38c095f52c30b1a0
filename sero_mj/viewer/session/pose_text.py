"""Poses of robots as text: as a table of a scene, as Python, as a command."""

from __future__ import annotations

import shlex

from ...base.frames import Array
from ...robots.declared.scene import Scene

_DIGITS = 6  # of rad and m


def as_toml(robot: str, angles: Array) -> str:
    """Returns a table of a scene: `[robots.lwr]` with `joint_angles`, rad or m."""
    return f"[robots.{robot}]\njoint_angles = [{_listed(angles)}]  # rad or m\n"


def as_python(robot: str, angles: Array) -> str:
    """Returns a line for a loop with `sero_mj.view`, rad or m."""
    return f'viewer.robot("{robot}").joint_angles = [{_listed(angles)}]\n'


def as_command(scene: Scene, robot: str, angles: Array) -> str:
    """Returns the command that shows the scene with a robot like that."""
    given = setting(robot, angles)
    return f"sero-mj view {shlex.quote(scene.argument)} --set {given}\n"


def setting(robot: str, values: Array, field: str = "joint_angles") -> str:
    """Returns what `--set` takes for a field of a robot with a number for each joint."""
    return f"{robot}.{field}={_listed(values, ',')}"


def _listed(angles: Array, separator: str = ", ") -> str:
    return separator.join(f"{round(float(angle), _DIGITS) + 0.0:g}" for angle in angles)
