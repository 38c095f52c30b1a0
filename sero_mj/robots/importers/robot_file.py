"""Reads a robot file of any format as the tables of a `robot.toml`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.toml_file import read_toml
from .imported_tables import ImportedTables
from .importer import read_imported


def read_robot_file(
    path: Path,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables:
    """Returns a robot's tables; file names in them are relative to the file's folder.

    Args:
        path: of the file: TOML, or any format with an importer.
        packages: folders of ROS packages by name, for URDF.
        arguments: of xacro by name.

    Raises:
        DeclarationError: the file cannot be read.
    """
    imported = read_imported(path, packages, arguments)
    return ImportedTables(read_toml(path), None) if imported is None else imported
