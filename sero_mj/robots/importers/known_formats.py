"""The built-in importers: URDF and xacro, and MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from .imported_tables import ImportedTables
from .importer import Importer


class Urdf(Importer):
    """Robots of ROS."""

    endings: ClassVar[tuple[str, ...]] = (".urdf", ".xacro", ".xml")
    object_key: ClassVar[str] = "urdf"
    order: ClassVar[int] = 10

    @classmethod
    def takes(cls, path: Path, head: bytes) -> bool:
        from .xml_file import first_element

        return path.suffix.lower() != ".xml" or first_element(head) == "robot"

    def read(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> ImportedTables:
        from .urdf import read_urdf

        return read_urdf(path, packages, arguments)


class Mjcf(Importer):
    """Robots of MuJoCo."""

    endings: ClassVar[tuple[str, ...]] = (".xml",)
    takes_arguments: ClassVar[bool] = False
    object_key: ClassVar[str] = "mjcf"
    order: ClassVar[int] = 20

    def read(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> ImportedTables:
        from .mjcf_robot import read_mjcf

        return read_mjcf(path)
