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

from ...base.errors import DeclarationError, Problem, SeroError, about_fault
from ...base.paths import format_of_file, read_head
from ...base.plugins import IMPORTERS, is_own_class, load_all
from .imported_tables import ImportedTables


class Importer(ABC):
    """A file format; its dependencies are imported in `read`, because all formats are asked often.

    Attributes:
        endings: file extensions, lower-case, with their dots.
        is_scene: whether its files are scenes; else robots.
        object_key: the key of a scene's object for such a file without joints, such as `urdf`;
            empty for none.
        takes_arguments: whether a file may ask for values, as xacro does.
        order: priority among importers that accept a file, lowest first; sero-mj's own have 10 to
            90.
    """

    endings: ClassVar[tuple[str, ...]]
    is_scene: ClassVar[bool] = False
    object_key: ClassVar[str] = ""
    takes_arguments: ClassVar[bool] = True
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
            packages: folders of ROS packages by name.
            arguments: of the file by name, as in xacro.

        Raises:
            DeclarationError: the file cannot be read.
        """


@cache
def importers() -> dict[str, Importer]:
    """All installed importers by name, in their order."""
    kinds = load_all(IMPORTERS, Importer)
    return {name: kinds[name]() for name in sorted(kinds, key=lambda name: kinds[name].order)}


def find_importer(path: Path) -> Importer | None:
    """The importer of a file, by its extension and first bytes; None for an unknown extension.

    Raises DeclarationError if the contents of the file do not match its extension.
    """
    named = {
        name: each for name, each in importers().items() if path.suffix.lower() in each.endings
    }
    if not named:
        return None
    head = read_head(path)
    for each in named.values():
        if each.takes(path, head):
            return each
    found = format_of_file(path) or ("in no format that is known" if head else "empty")
    expected = " or ".join(f"a file of the importer '{name}'" for name in named)
    raise Problem("", f"is {found}; expected {expected}", str(path)).error()


def read_imported(
    path: Path,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables | None:
    """Reads a file by its importer; None where its ending is no one's.

    Raises DeclarationError if the file cannot be read.
    """
    importer = find_importer(path)
    if importer is None:
        return None
    if arguments and not importer.takes_arguments:
        message = "is for xacro; this file takes none"
        raise DeclarationError(
            [Problem(f"arguments.{name}", message, str(path)) for name in arguments]
        )
    try:
        return importer.read(path, packages, arguments)
    except Exception as error:
        if isinstance(error, SeroError) or is_own_class(type(importer)):
            raise
        kind = type(importer)
        reason = f"cannot be read by {kind.__name__}: {about_fault(error, kind)}"
        raise Problem("", reason, str(path)).error() from error
