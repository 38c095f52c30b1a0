"""Converts a URDF without joints, such as a table or a tool, to MJCF for a scene object."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import mujoco

from ..declared.robot_parts import LinkGeometry
from .link_geometry import part_geoms
from .mjcf_dynamics import HULL_GROUP
from .mjcf_elements import Hull

log = logging.getLogger(__name__)


def urdf_piece(path: Path) -> mujoco.MjSpec:
    """Returns a spec with the visual and collision geometry of a URDF file without joints.

    Raises DeclarationError if the file cannot be read or has joints.
    """
    from ..importers.urdf import read_rigid_urdf  # Few scenes need this import.

    described = read_rigid_urdf(path)
    for warning in described.warnings:
        log.warning("%s: %s", path, warning)
    tables, root = described.tables, mujoco.MjSpec()
    colors: dict[str, Any] = tables.get("colors", {})
    folder = Path(tables.get("directory", ""))
    kinds: tuple[tuple[str, Hull, dict[str, Any]], ...] = (
        ("filenames", "never", {"contype": 0, "conaffinity": 0}),
        ("collisions", "always", {"group": HULL_GROUP}),
    )
    for key, hull, attributes in kinds:
        for k, table in enumerate(tables.get(key, [[]])[0]):
            part = LinkGeometry(**{"scale": 1.0, **table})
            rgba = None if part.color is None else colors[part.color]
            for geom in part_geoms(root, part, f"{key}{k}", folder, rgba, hull):
                root.worldbody.add_geom(**geom, **attributes, mass=0)
    return root
