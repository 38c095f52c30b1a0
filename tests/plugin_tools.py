"""Installs packages of `tests/plugins` and packages written by tests, like pip."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

PLUGINS = Path(__file__).parent / "plugins"


def install(folder: Path, module: str, group: str, name: str, item: str) -> None:
    """Copies a module into a folder, with the metadata for its entry point.

    Args:
        folder: folder on the module search path.
        module: name of a module in `tests/plugins`.
        group: group of the entry point.
        name: name of the entry point.
        item: name of the object in the module.
    """
    shutil.copy(PLUGINS / f"{module}.py", folder)
    register(folder, module, group, [f"{name} = {module}:{item}"])


def write_package(folder: Path, module: str, code: str, group: str, **points: str) -> None:
    """Writes a module into a folder, with the metadata for its entry points.

    Args:
        folder: folder on the module search path.
        module: name of the module.
        code: code of the module.
        group: group of the entry points.
        **points: object in the module for each entry point.
    """
    (folder / f"{module}.py").write_text(code)
    register(folder, module, group, [f"{name} = {module}:{item}" for name, item in points.items()])


def register(folder: Path, module: str, group: str, points: Sequence[str]) -> None:
    """Writes the metadata of a module in a folder with entry points `name = module:item`."""
    about = folder / f"{module}-0.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {module.replace('_', '-')}\nVersion: 0.1\n"
    )
    (about / "entry_points.txt").write_text("\n".join([f"[{group}]", *points, ""]))
