"""`Importer`: base class of readers that convert robots or scenes of other formats to tables.

A package adds a file format with an entry point in the group `sero_mj.importers`:

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
from ...base.paths import ROBOT_FILE, format_of_file, read_head, robot_endings
from ...base.plugins import IMPORTERS, is_own_class, load_all
from ...base.toml_file import read_toml
from .imported_tables import ImportedTables

# Keys that exist in robot files but not in scene files.
_ROBOT_KEYS = ("dh_params", "dh_params_deg", "joint_frames")


class Importer(ABC):
    """Base class of importers, each of which reads one file format.

    Import dependencies inside `read`, because all importers are loaded to select the matching one.

    Attributes:
        endings: file extensions of the format, in lowercase and including the dots.
        is_scene: whether files of this format describe scenes instead of robots.
        object_key: key of scene objects for files of this format without joints, such as `urdf`;
            empty if there is no such key.
        takes_arguments: whether files of this format can have arguments, as in xacro.
        order: priority among importers that accept a file; the lowest comes first. Built-in
            importers use 10 to 90.
    """

    endings: ClassVar[tuple[str, ...]]
    is_scene: ClassVar[bool] = False
    object_key: ClassVar[str] = ""
    takes_arguments: ClassVar[bool] = True
    order: ClassVar[int] = 100

    @classmethod
    def takes(cls, path: Path, head: bytes) -> bool:
        """Returns whether the importer accepts a file that has one of its extensions.

        `head` contains the first 100 kB of the file, and is empty if the file is unreadable.
        """
        return True

    @abstractmethod
    def read(
        self,
        path: Path,
        packages: Mapping[str, Path | str] | None = None,
        arguments: Mapping[str, Any] | None = None,
    ) -> ImportedTables:
        """Reads a file as tables, in which file names are relative to the folder of the file.

        Args:
            packages: folders of ROS packages, by package name.
            arguments: values of the file's arguments by name, as in xacro.

        Raises:
            DeclarationError: the file cannot be read.
        """


class Urdf(Importer):
    """Importer of ROS robots in URDF or xacro."""

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
    """Importer of MuJoCo robots in MJCF."""

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


@cache
def importers() -> dict[str, Importer]:
    """Returns all installed importers by name, sorted by `order`."""
    kinds = load_all(IMPORTERS, Importer)
    return {name: kinds[name]() for name in sorted(kinds, key=lambda name: kinds[name].order)}


def find_importer(path: Path) -> Importer | None:
    """Returns the importer for the extension and contents of a file.

    Returns None if no importer has this extension. Raises DeclarationError if the contents do not
    match the extension.
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
    found = format_of_file(path) or ("in an unknown format" if head else "empty")
    expected = " or ".join(f"a file of the importer '{name}'" for name in named)
    raise Problem("", f"is {found}; expected {expected}", str(path)).error()


def read_imported(
    path: Path,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables | None:
    """Reads a file with the matching importer, or returns None if no importer has the extension."""
    importer = find_importer(path)
    if importer is None:
        return None
    if arguments and not importer.takes_arguments:
        message = "only xacro files have arguments"
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


def is_robot_file(path: Path) -> bool:
    """Returns whether a file describes a robot, according to its name, extension and keys."""
    if path.name == ROBOT_FILE or path.suffix in robot_endings():
        return True
    if path.suffix != ".toml":
        return False
    try:
        keys = read_toml(path).keys()
    except DeclarationError:
        return False  # The error is reported when the file is read as a scene.
    return not keys.isdisjoint(_ROBOT_KEYS) and "robots" not in keys


def read_robot_file(
    path: Path,
    packages: Mapping[str, Path | str] | None = None,
    arguments: Mapping[str, Any] | None = None,
) -> ImportedTables:
    """Reads a robot file in TOML or in any format that has an importer.

    File names in the tables are relative to the folder of the file.
    """
    imported = read_imported(path, packages, arguments)
    return ImportedTables(read_toml(path), None) if imported is None else imported
