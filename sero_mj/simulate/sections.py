"""Section names of scenario files.

With this separate module, commands can distinguish scenarios from scenes without importing the
simulator.
"""

from __future__ import annotations

from pathlib import Path

from ..base.errors import DeclarationError
from ..base.toml_file import read_toml

SECTIONS = ("controllers", "targets", "sensors", "disturbances", "faults", "expect", "monitor")
OTHERS = ("scene", "run", "description", "extends", "set")


def is_scenario(path: Path) -> bool:
    """Returns whether a file declares a scenario."""
    try:
        tables = read_toml(path)
    except DeclarationError:
        return False
    return bool({*SECTIONS, "run", "extends"} & set(tables))
