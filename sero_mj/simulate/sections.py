"""What a scenario file has beside a scene; by itself, for every command that reads a scene asks."""

from __future__ import annotations

from pathlib import Path

from ..errors import DeclarationError
from ..toml_file import read_toml

SECTIONS = ("controllers", "targets", "sensors", "disturbances", "faults", "expect", "monitor")
OTHERS = ("scene", "run", "description")


def is_scenario(path: Path) -> bool:
    """Whether a file declares something to be simulated."""
    try:
        tables = read_toml(path)
    except DeclarationError:
        return False
    return bool({*SECTIONS, "run"} & set(tables))
