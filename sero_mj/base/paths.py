"""Finds included and named files, and opens files without blocking and with size limits.

`models/` and `scenes/` are inside the wheel, or beside the package in a checkout.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, BinaryIO
from unicodedata import normalize

from .errors import Problem, UnknownName, nearest
from .plugins import IMPORTERS, ROBOTS, load_all

ROBOT_FILE, GROUP_FILE = "robot.toml", "group.toml"  # in the folder of a model
# Names of robot files that do not include the name of the robot.
_GENERIC_NAMES = ("robot", "model", "scene", "main")
# In third-party folders: the scene with a floor, and subfolders that may contain models.
_SCENE_FILE, _INNER = "scene.xml", ("mjcf", "urdf", "robots")
BAG_ENDINGS = (".mcap", ".db3")  # file name extensions of ROS 2 recordings
_MODELS = ("a URDF file", "an MJCF file")
_PACKAGE = Path(__file__).resolve().parents[1]
_KINDS = (
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)
_MB = 1_000_000
_XML = re.compile(rb"\s*+(?:<[?!](?:--.*?--|[^>]*+)>\s*+)*+<([A-Za-z_][\w.-]{0,40})", re.DOTALL)
# The packed form of USD is a ZIP archive with a file of USD first.
_USD = re.compile(rb"#usda |PXR-USDC|PK\x03\x04.{26}[^\0]{1,200}?\.usd[ac]?", re.DOTALL)
_ROOTS = {
    "robot": "a URDF file",
    "mujoco": "an MJCF file",
    "sdf": "an SDF file",
    "COLLADA": "a mesh (COLLADA)",
    "X3D": "X3D in the XML encoding",
}
_HEAD_BYTES = 100_000  # bytes used to detect a file's format


def _shipped(folder: str) -> Path:
    inside = _PACKAGE / folder
    return inside if inside.is_dir() else _PACKAGE.parent / folder


def models_dir() -> Path:
    """Returns the folder with one subfolder per included robot."""
    return _shipped("models")


def scenes_dir() -> Path:
    """Returns the folder with the included scene files."""
    return _shipped("scenes")


def robot_endings() -> tuple[str, ...]:
    """Returns the file name extensions of robot files in other formats than TOML."""
    return _endings(of_scenes=False)


def scene_endings() -> tuple[str, ...]:
    """Returns the file name extensions of scene files in other formats than TOML."""
    return _endings(of_scenes=True)


@cache
def _endings(*, of_scenes: bool) -> tuple[str, ...]:
    found = [kind for kind in load_all(IMPORTERS).values() if hasattr(kind, "is_scene")]
    kinds = [kind for kind in found if kind.is_scene == of_scenes]
    kinds.sort(key=lambda kind: kind.order)
    return tuple(dict.fromkeys(ending for kind in kinds for ending in kind.endings))


def list_models() -> list[str]:
    """Returns the names of the included robots."""
    return _models_in(models_dir(), ROBOT_FILE)


def list_group_models() -> list[str]:
    """Returns the names of the included groups of robots."""
    return _models_in(models_dir(), GROUP_FILE)


def list_scenes() -> list[str]:
    """Returns the names of the included scenes."""
    return _toml_files(scenes_dir())


def list_all() -> list[str]:
    """Returns the names of all included robots, groups of robots, scenes and scenarios."""
    return [*list_models(), *list_group_models(), *list_scenes(), *list_scenarios()]


def shipped_file(name: str) -> Path | None:
    """Returns the file of an included scene, scenario, robot or group; None for other names.

    If a name is ambiguous, this is the file that `load_scene` uses.
    """
    candidates = (
        scenes_dir() / f"{name}.toml",
        scenarios_dir() / f"{name}.toml",
        models_dir() / name / ROBOT_FILE,
        models_dir() / name / GROUP_FILE,
    )
    return next((file for file in candidates if file.is_file()), None)


def find_model(name: str, beside: Path | None = None) -> Path:
    """Returns the file of a robot.

    Args:
        name: name of an included robot, or path of a file or folder. In a folder, the robot is
            `robot.toml`, or else `scene.xml`, or else the only URDF or MJCF file.
        beside: folder to which relative paths refer (default: the working directory).

    Raises:
        UnknownName: there is no such robot. The error lists the available robots.
        DeclarationError: a folder contains several models, or the format is not supported.
    """
    return _find_model("robot model", name, beside, ROBOT_FILE)


def find_group_model(name: str, beside: Path | None = None) -> Path:
    """Returns the file of a group of robots.

    `name` is the name of an included group, a folder with a `group.toml`, or a TOML file. Raises
    UnknownName if there is no such group. The error lists the available groups.
    """
    return _find_model("model of a group", name, beside, GROUP_FILE)


def _find_model(kind: str, name: str, beside: Path | None, file: str) -> Path:
    local = (beside or Path.cwd()) / name
    endings = (".toml", *(robot_endings() if file == ROBOT_FILE else ()))
    shipped = () if name.endswith(("/", os.sep)) else (models_dir() / name / file,)
    for candidate in (local / file, local, *shipped):
        if candidate.suffix in endings and os.path.isfile(candidate):
            return _plain(candidate)
    _refuse_path(name, beside)
    if file == ROBOT_FILE and name and (inside := model_in(local)) is not None:
        return _plain(inside)
    available = [*_models_in(beside or Path.cwd(), file), *_models_in(models_dir(), file)]
    hint = ""
    if file == ROBOT_FILE and name:
        places = robot_places()
        for place in places:
            if (elsewhere := place.find(name)) is not None:
                return _plain(Path(elsewhere))
        if nearest(name, available) is None:
            near = filter(None, (place.near(name) for place in places))
            hint = next((f"; did you mean '{each}'?" for each in near), "")
    raise UnknownName(kind, name, available, hint)


def robot_places() -> list[Any]:
    """Returns all installed collections of robots, see `robots.importers.robot_places`."""
    return [kind() for kind in sorted(load_all(ROBOTS).values(), key=lambda kind: kind.order)]


def _plain(path: Path) -> Path:
    plain = Path(os.path.normpath(path))  # if a is a link, a/../b may differ from b
    return plain if plain.exists() and plain.samefile(path) else path


def model_in(folder: Path) -> Path | None:
    """Returns `scene.xml` or the only model file in a third-party folder, or None.

    Raises DeclarationError if there are several models.
    """
    if os.path.isfile(folder / _SCENE_FILE):
        return folder / _SCENE_FILE
    for inner in (folder, *(folder / each for each in _INNER)):
        named = [inner / each for ending in robot_endings() for each in _files(inner, ending)]
        found = [path for path in named if path.is_file() and format_of_file(path) in _MODELS]
        if len(found) > 1:
            names = ", ".join(sorted(str(path.relative_to(folder)) for path in found))
            raise Problem(
                found=len(found),
                of="models in this folder",
                expected=f"one of {names}",
                file=str(folder),
            ).error()
        if found:
            return found[0]
    return None


def _models_in(folder: Path, file: str) -> list[str]:
    try:
        return sorted(path.parent.name for path in folder.glob(f"*/{file}"))
    except OSError:
        return []


def _refuse_path(name: str, beside: Path | None = None) -> None:
    path = (beside or Path()) / name
    ending = path.suffix.lower()
    if "\0" in name or "://" in name:
        return
    is_read = ending in (read := (".toml", *robot_endings(), *scene_endings()))
    if not is_read and os.path.exists(path) and not os.path.isdir(path):
        try:
            with open_file(path) as file:
                found = format_of(file.read(_HEAD_BYTES)) or "not a robot or scene file"
        except OSError as error:
            what = f"cannot be read: {error.strerror}"
        else:
            what = f"is {found}; expected a file that ends in {', '.join(read)}"
        raise Problem("", what, str(path)).error()
    if is_read:
        try:
            open_file(path).close()
            return  # the file has another kind than the requested one
        except IsADirectoryError:
            what = "is a folder; expected a file"
        except (FileNotFoundError, NotADirectoryError):
            others = [Path(n).stem for n in _files(path.parent, path.suffix) if n != path.name]
            near = nearest(path.stem, others)
            what = "no such file" + (f"; did you mean '{near}{path.suffix}'?" if near else "")
            if path.is_symlink():
                what = f"is a link to {os.readlink(path)}, which does not exist"
        except OSError as error:
            what = f"cannot be read: {error.strerror}"
        raise Problem("", what, str(path)).error()


def _toml_files(folder: Path) -> list[str]:
    return [Path(name).stem for name in _files(folder, ".toml")]


def format_of(contents: bytes) -> str | None:
    """Returns the third-party format of a robot or scene, such as `an SDF file`, or None."""
    contents = contents.removeprefix(b"\xef\xbb\xbf")
    if _USD.match(contents):
        return "a USD file"
    if contents.lstrip().startswith((b"#VRML V1", b"#Inventor")):
        return "a VRML 1.0 file"
    root = _XML.match(contents)
    return None if root is None else _ROOTS.get(tag := root[1].decode(), f"XML <{tag}>")


def read_head(path: Path) -> bytes:
    """Returns the first 100 kB of a file; empty if the file is unreadable."""
    try:
        with open_file(path) as file:
            return file.read(_HEAD_BYTES)
    except (OSError, ValueError):
        return b""


def format_of_file(path: Path) -> str | None:
    """Returns the third-party format of a robot or scene file, or None, see `format_of`."""
    return format_of(read_head(path))


def _files(folder: Path, ending: str) -> list[str]:
    try:
        return sorted(path.name for path in folder.glob(f"*{ending}"))
    except (OSError, ValueError):
        return []


def model_name(path: Path) -> str:
    """Returns the name of the robot or group in a file.

    This is the name of the folder for `robot.toml`, `group.toml` and MJCF files with generic names,
    such as `panda/robot.xml`, and otherwise the name of the file. Accents and characters that are
    not ASCII are removed: `Arm` for `Ärm_机械臂.xml`.
    """
    name, folder = path.stem.removesuffix(".urdf"), path.absolute().parent.name
    is_generic = path.suffix == ".xml" and name.lower() in _GENERIC_NAMES
    if folder and (is_generic or path.name in (ROBOT_FILE, GROUP_FILE)):
        name = folder
    if not name.isascii():
        bare = normalize("NFKD", name).encode("ascii", "ignore").decode()
        name = re.sub(r"_{2,}", "_", bare).strip("_ ") or "robot"
    return re.sub(r"^(?=[^A-Za-z_])|[^A-Za-z0-9_-]", "_", name)


def file_hint(name: str) -> str:
    """Returns a hint to enter NAME.toml instead of NAME if this file exists, or an empty text."""
    if "\0" in name or not os.path.isfile(Path(f"{name}.toml")):
        return ""
    return f"; did you mean the file {name}.toml?"


def scenarios_dir() -> Path:
    """Returns the folder with the included scenarios."""
    return scenes_dir() / "scenarios"


def list_scenarios() -> list[str]:
    """Returns the names of the included scenarios."""
    return _toml_files(scenarios_dir())


def find_scenario(name: str) -> Path:
    """Returns the file of a scenario, which may be a TOML file or an included scenario.

    Raises UnknownName if there is no such scenario. The error lists the included scenarios.
    """
    return _find("scenario", name, scenarios_dir(), list_scenarios)


def find_scene(name: str) -> Path:
    """Returns the file of a scene, which may be a TOML file or an included scene.

    Raises UnknownName if there is no such scene. The error lists the included scenes.
    """
    return _find("scene", name, scenes_dir(), list_scenes)


def _find(kind: str, name: str, folder: Path, shipped: Callable[[], list[str]]) -> Path:
    for candidate in (Path(name), folder / f"{name}.toml"):
        if candidate.suffix not in robot_endings() and os.path.isfile(candidate):
            return candidate
    _refuse_path(name)
    raise UnknownName(kind, name, shipped(), file_hint(name))


@cache
def _temporary() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="sero-mj-")


def make_temporary_folder() -> Path:
    """Creates a folder that is removed when this process ends."""
    return Path(tempfile.mkdtemp(dir=_temporary().name)).resolve()


def is_temporary(path: Path | str) -> bool:
    """Returns whether a file is in a temporary folder of this process."""
    if not _temporary.cache_info().currsize:  # none was created
        return False
    return Path(path).is_relative_to(Path(_temporary().name).resolve())


def without_temporary(text: str) -> str:
    """Returns a message in which paths in temporary folders are relative."""
    if not _temporary.cache_info().currsize:
        return text
    folder = re.escape(str(Path(_temporary().name).resolve()))
    return re.sub(rf"{folder}[/\\][^/\\\s]+[/\\]", "", text)


def bag_files_in(folder: Path | str) -> list[Path]:
    """Returns the files of a ROS 2 recording in order, without using its metadata.yaml.

    The recorder writes metadata.yaml at the end, so it is missing after a crash. A recording is a
    single file, or `NAME_0.mcap`, `NAME_1.mcap` and so on, into which `ros2 bag record` splits long
    recordings. The list is empty if the folder also contains robots or scenes, or if the files do
    not form one recording.
    """
    try:
        files = [each for each in Path(folder).iterdir() if not each.name.startswith(".")]
    except OSError:
        return []
    if any(each.suffix.lower() in (".toml", *robot_endings()) for each in files):
        return []
    found = [each for each in files if each.suffix.lower() in BAG_ENDINGS]
    parts = {}
    for each in found:
        stem, _, number = each.stem.rpartition("_")
        if number.isdecimal():
            parts[int(number)] = each, (stem, each.suffix)
    numbers = sorted(parts)
    is_split = len({name for _, name in parts.values()}) == 1 and len(parts) == len(found)
    if is_split and numbers == [*range(numbers[0], numbers[0] + len(numbers))]:
        return [parts[number][0] for number in numbers]
    return found if len(found) == 1 else []


def bag_file_in(folder: Path | str) -> Path | None:
    """Returns the file of a ROS 2 recording that consists of a single file, or None."""
    found = bag_files_in(folder)
    return found[0] if len(found) == 1 else None


def open_file(path: Path | str, max_bytes: int | None = None) -> BinaryIO:
    """Opens a file of at most `max_bytes` for reading.

    Raises:
        OSError: the file cannot be opened, is too large, or is not a regular file. A pipe would
            block, and a device may have no end.
        ValueError: the name is invalid.
    """
    # Without O_NONBLOCK, opening a pipe would block.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    file = os.open(path, flags)
    try:
        status = os.fstat(file)
        if stat.S_ISDIR(status.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
        if not stat.S_ISREG(status.st_mode):
            what = next((name for is_it, name in _KINDS if is_it(status.st_mode)), "something else")
            raise OSError(errno.EINVAL, f"found {what}; expected a file", str(path))
        if max_bytes is not None and status.st_size > max_bytes:
            found = f"found {status.st_size / _MB:.1f} MB; expected at most {max_bytes / _MB:g} MB"
            raise OSError(errno.EFBIG, found, str(path))
        return os.fdopen(file, "rb")
    except BaseException:
        os.close(file)
        raise


def read_file(path: Path | str, max_bytes: int) -> bytes:
    """Returns the contents of a file of at most `max_bytes`. Raises the errors of `open_file`."""
    with open_file(path, max_bytes) as file:
        return file.read(max_bytes)


def argument_of(file: Path) -> str:
    """Returns the command-line argument for a file, which is its included name or its path."""
    name = model_name(file) if file.name == ROBOT_FILE else file.stem
    # Other names are not searched for, because that might download a robot (`robot_places`).
    is_near = shipped_file(name) is not None or os.path.exists(name)
    for find in (find_scene, find_scenario, find_model, find_group_model) if is_near else ():
        try:
            if find(name).samefile(file):
                return name
        except (UnknownName, OSError):
            continue
    here, file = Path.cwd(), file.resolve()
    return str(file.relative_to(here)) if file.is_relative_to(here) else str(file)
