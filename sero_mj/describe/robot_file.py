"""Reads a robot file of any format as the tables of a `robot.toml`."""

from __future__ import annotations

from pathlib import Path

from ..toml_file import key_lines, read_toml
from .described import Described


def read_robot_file(path: Path) -> Described:
    """Returns a robot's tables; file names in them are relative to the file's folder.

    Args:
        path: of the file, whose ending says its format: TOML, or one of `paths.ROBOT_ENDINGS`.

    Raises:
        DeclarationError: the file cannot be read.
    """
    return Described(read_toml(path), key_lines(path))
