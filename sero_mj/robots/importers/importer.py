"""`Importer`: reads robots or scenes in a format of others as the tables of our own files.

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
    """A format; what it needs to read is imported in `read`, for all formats are asked often.

    Attributes:
        endings: of its files, lower-case, with their dots.
        is_scene: whether its files are scenes; else robots.
        object_key: the key of an object of a scene that takes such a file where it has no joints,
            as `urdf`; empty where none does.
        order: of several that take a file, lowest first; sero-mj's own have 10 to 90.
    """

    endings: ClassVar[tuple[str, ...]]
    is_scene: ClassVar[bool] = False
    object_key: ClassVar[str] = ""
    order: ClassVar[int] = 100

    @classmethod
    def takes(cls, path: Path, head: bytes) -> bool:
        """Whether it reads a file.

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
            arguments: of the file by name, as xacro has them.

        Raises:
            DeclarationError: the file cannot be read.
        """


@cache
def importers() -> tuple[Importer, ...]:
    """All installed importers, in their order.

    Raises:
        PluginError: the package of one cannot be imported.
    """
    kinds: list[type[Importer]] = [load_plugin(IMPORTERS, name) for name in plugins(IMPORTERS)]
    return tuple(kind() for kind in sorted(kinds, key=lambda kind: kind.order))


def find_importer(path: Path) -> Importer | None:
    """The importer of a file, by its ending and its first bytes; None where its ending is no one's.

    Raises:
        DeclarationError: the file is in another format than its ending says.
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
