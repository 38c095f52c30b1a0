"""`X3d`: the importer of X3D scenes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from ...robots.importers.imported_tables import ImportedTables
from ...robots.importers.importer import Importer


class X3d(Importer):
    """Importer of scenes in X3D's classic encoding or in VRML97."""

    endings: ClassVar[tuple[str, ...]] = (".x3d", ".x3dv", ".wrl")
    is_scene: ClassVar[bool] = True
    takes_arguments: ClassVar[bool] = False
    order: ClassVar[int] = 30

    def read(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> ImportedTables:
        from .reader import read_x3d

        return read_x3d(path)
