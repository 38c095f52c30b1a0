"""Reads a robot file of any format as the tables of a `robot.toml`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ...base.toml_file import read_toml
from .imported_tables import ImportedTables
from .mjcf_robot import read_mjcf
from .xml_file import root_name


def is_urdf(path: Path) -> bool:
    """Whether a file that ends in .xml is a URDF: its first element is `<robot>`."""
    return path.suffix == ".xml" and root_name(path) == "robot"


def read_robot_file(
    path: Path,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables:
    """Returns a robot's tables; file names in them are relative to the file's folder.

    Args:
        path: of the file, whose ending says its format: TOML, or one of `paths.ROBOT_ENDINGS`;
            of XML the first element does.
        packages: folders of ROS packages by name, for URDF.
        arguments: of xacro by name.

    Raises:
        DeclarationError: the file cannot be read.
    """
    if path.suffix in (".urdf", ".xacro") or is_urdf(path):
        from .urdf import read_urdf

        return read_urdf(path, packages, arguments)
    if path.suffix == ".xml":
        return read_mjcf(path)
    return ImportedTables(read_toml(path), None)
