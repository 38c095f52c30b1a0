"""Installs an example package of `tests/plugins`, as pip would."""

from __future__ import annotations

import shutil
from pathlib import Path

PLUGINS = Path(__file__).parent / "plugins"


def install(folder: Path, module: str, group: str, name: str, item: str) -> None:
    """Puts a module into a folder, with the metadata by which its entry point is found.

    Args:
        folder: to be put on the module search path.
        module: a file in `tests/plugins`.
        group: of the entry point.
        name: of the entry point.
        item: what it names in the module.
    """
    shutil.copy(PLUGINS / f"{module}.py", folder)
    about = folder / f"{module}-0.1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text(
        f"Metadata-Version: 2.1\nName: {module.replace('_', '-')}\nVersion: 0.1\n"
    )
    (about / "entry_points.txt").write_text(f"[{group}]\n{name} = {module}:{item}\n")
