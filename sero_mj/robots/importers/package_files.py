"""Finds the files to which robot descriptions refer, without ROS or Gazebo."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import unquote

from ...base.paths import open_file

# Environment variables with folders that are packages, or contain them up to two levels deep.
_PACKAGE_PATHS = (
    "ROS_PACKAGE_PATH",
    "GZ_SIM_RESOURCE_PATH",
    "IGN_GAZEBO_RESOURCE_PATH",
    "GAZEBO_MODEL_PATH",
)
_PREFIX_PATHS = ("AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH", "CMAKE_PREFIX_PATH")
# Entries NAME=DIR that `--package` sets, separated as in PATH.
PACKAGES_VARIABLE = "SERO_MJ_PACKAGES"
# Xacro arguments that `--arg` sets, as a JSON object.
ARGUMENTS_VARIABLE = "SERO_MJ_XACRO_ARGUMENTS"
_MAX_ABOVE = 12  # maximum number of parent folders of a file that are searched
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/*")
# Substitutions in xacro and launch files.
_FIND = re.compile(r"(?:file:/*)?\$\(find(?:-pkg-share)?\s+([^)\s]+)\s*\)/*")
_MANIFEST_NAME = re.compile(rb"<name>\s*([^<\s]+)\s*</name>")


def find_file(name: str, beside: Path, packages: Mapping[str, Path] | None = None) -> Path | None:
    """Finds a file to which a robot description refers. Returns None if the file does not exist.

    Args:
        name: file name as in the description: `package://NAME/...`, `model://NAME/...`,
            `file:///...`, `$(find NAME)/...`, or a path. Relative paths are searched for in the
            folder of the description and its parent folders. Case is ignored if there is no exact
            match.
        beside: file of the robot description.
        packages: folders of packages by name, which take precedence over other folders.
    """
    if "\0" in name:
        return None
    candidates = list(dict.fromkeys(_candidates(name.strip(), beside, packages or {})))
    for find in (lambda path: path, _in_other_case):
        for candidate in candidates:
            try:
                found = find(candidate)
                if found is not None and found.is_file():
                    return Path(os.path.abspath(found))
            except OSError:
                continue  # The name is too long, or the folder is not accessible.
    return None


def _in_other_case(path: Path) -> Path | None:
    if path.exists():
        return path
    above = _in_other_case(path.parent) if path.parent != path else None
    if above is None or not above.is_dir():
        return None
    name = path.name.casefold()
    return min((each for each in above.iterdir() if each.name.casefold() == name), default=None)


def package_of(name: str) -> str | None:
    """Returns the package to which a file name such as `package://NAME/...` refers, or None."""
    if (sought := _FIND.match(name)) is not None:
        return sought[1]
    found = _SCHEME.match(name)
    if found is None or found[1].lower() not in ("package", "model"):
        return None
    return unquote(name[found.end() :]).replace("\\", "/").split("/")[0] or None


def _candidates(name: str, beside: Path, packages: Mapping[str, Path]) -> Iterator[Path]:
    name = _FIND.sub(r"package://\1/", name)
    scheme = _SCHEME.match(name)
    kind = scheme[1].lower() if scheme is not None else ""
    rest = name if scheme is None else unquote(name[scheme.end() :])
    rest = rest.replace("\\", "/")
    if kind == "file":
        yield Path(rest if re.match(r"[A-Za-z]:/", rest) else f"/{rest}")
        yield from (above / rest for above in _above(beside))
    elif kind in ("package", "model"):
        package, _, inside = rest.partition("/")
        inside = inside.lstrip("/")
        yield from (folder / inside for folder in package_folders(package, beside, packages))
        # The package may be in a folder with a different name.
        yield from (above / inside for above in _above(beside))
    elif not kind:
        yield from (above / rest for above in _above(beside))


def package_folders(
    package: str, beside: Path, packages: Mapping[str, Path] | None = None
) -> Iterator[Path]:
    """Yields the possible folders of a package in order of precedence.

    The folders are the entry of the package in `packages`, the parent folders of the file `beside`,
    and the folders in the environment variables of ROS and Gazebo.
    """
    if packages and package in packages:
        yield Path(packages[package])
    for entry in os.environ.get(PACKAGES_VARIABLE, "").split(os.pathsep):
        name, _, at = entry.partition("=")
        if name == package and at:
            yield Path(at)
    for above in _above(beside):
        if above.name == package or _manifest_name(above) == package:
            yield above
        yield above / package
    for variable in _PACKAGE_PATHS:
        for folder in _listed(variable):
            if folder.name == package:
                yield folder
            yield folder / package
            yield from _inside(folder, package)
    for variable in _PREFIX_PATHS:
        yield from (folder / "share" / package for folder in _listed(variable))


def _above(file: Path) -> list[Path]:
    paths = dict.fromkeys((Path(os.path.abspath(file)), Path(os.path.realpath(file))))
    return list(dict.fromkeys(above for path in paths for above in [*path.parents][:_MAX_ABOVE]))


def _listed(variable: str) -> list[Path]:
    return [Path(entry) for entry in os.environ.get(variable, "").split(os.pathsep) if entry]


def _inside(folder: Path, package: str) -> Iterator[Path]:
    try:
        yield from (inner / package for inner in sorted(folder.iterdir()) if inner.is_dir())
    except OSError:
        return


def _manifest_name(folder: Path) -> str:
    try:
        with open_file(folder / "package.xml") as file:
            found = _MANIFEST_NAME.search(file.read(10_000))
    except OSError:
        return ""
    return "" if found is None else found[1].decode(errors="replace")
