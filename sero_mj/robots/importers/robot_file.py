"""Reads a robot file of any format as the tables of a `robot.toml`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.errors import DeclarationError
from ...base.paths import ROBOT_FILE, robot_endings
from ...base.toml_file import read_toml
from .imported_tables import ImportedTables
from .importer import read_imported

# keys that files of scenes do not have
_ONLY_OF_ROBOTS = ("dh_params", "dh_params_deg", "joint_frames")


def is_robot_file(path: Path) -> bool:
    """Whether a file describes a robot: by its name, its ending, or keys that only robots have."""
    if path.name == ROBOT_FILE or path.suffix in robot_endings():
        return True
    if path.suffix != ".toml":
        return False
    try:
        keys = read_toml(path).keys()
    except DeclarationError:
        return False  # read as a scene, it reports what is wrong
    return not keys.isdisjoint(_ONLY_OF_ROBOTS) and "robots" not in keys


def read_robot_file(
    path: Path,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables:
    """Returns a robot's tables; file names in them are relative to the file's folder.

    The file is TOML, or any format with an importer. Raises DeclarationError if it cannot be read.
    """
    imported = read_imported(path, packages, arguments)
    return ImportedTables(read_toml(path), None) if imported is None else imported
