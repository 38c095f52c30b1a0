"""`Importer`: reads robots or scenes in another format as the tables of our own files.

A package adds a format by an entry point in the group `sero_mj.importers`:

    [project.entry-points."sero_mj.importers"]
    sdf = "my_package:Sdf"
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from ...base.errors import DeclarationError, Problem
from ...base.paths import format_of_file, read_head
from ...base.plugins import IMPORTERS, load_plugin, plugins
from .imported_tables import ImportedTables


class Importer(ABC):
    """A file format; its dependencies are imported in `read`, because all formats are asked often.

    Attributes:
        endings: file extensions, lower-case, with their dots.
        is_scene: whether its files are scenes; else robots.
        object_key: the key of a scene's object for such a file without joints, such as `urdf`;
            empty for none.
        order: priority among importers that accept a file, lowest first; sero-mj's own have 10 to
            90.
    """

    endings: ClassVar[tuple[str, ...]]
    is_scene: ClassVar[bool] = False
    object_key: ClassVar[str] = ""
    order: ClassVar[int] = 100

    @classmethod
    def takes(cls, path: Path, head: bytes) -> bool:
        """Whether it can read a file.

        Args:
            path: with one of its endings.
            head: the first 100 kB; empty where the file cannot be read.
        """
        return True

    @abstractmethod
    def read(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> ImportedTables:
        """Reads a file; file names in the tables are relative to its folder.

        Args:
            path: of the file.
            packages: folders of ROS packages by name.
            arguments: of the file by name, as in xacro.

        Raises:
            DeclarationError: the file cannot be read.
        """


@cache
def importers() -> tuple[Importer, ...]:
    """All installed importers, sorted by `order`.

    Raises:
        PluginError: the package of an importer cannot be imported.
    """
    kinds: list[type[Importer]] = [load_plugin(IMPORTERS, name) for name in plugins(IMPORTERS)]
    return tuple(kind() for kind in sorted(kinds, key=lambda kind: kind.order))


def find_importer(path: Path) -> Importer | None:
    """The importer of a file, by its extension and first bytes; None for an unknown extension.

    Raises:
        DeclarationError: the contents of the file do not match its extension.
    """
    named = [each for each in importers() if path.suffix.lower() in each.endings]
    if not named:
        return None
    head = read_head(path)
    for each in named:
        if each.takes(path, head):
            return each
    found = format_of_file(path) or "in no format that is known"
    expected = " or ".join(type(each).__name__ for each in named)
    raise DeclarationError([Problem("", f"is {found}; expected {expected}", str(path))])
