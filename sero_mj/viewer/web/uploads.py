"""Files that are dropped on a page: the script that sends them, and who takes them.

A browser tells contents, and no paths. So a robot whose meshes are files of their own is dropped as
a folder, or together with them. What was dropped is kept until this process ends.
"""

from __future__ import annotations

import json
import operator
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request

from ...base.errors import UsageError
from ...base.paths import (
    GROUP_FILE,
    ROBOT_FILE,
    make_temporary_folder,
    robot_endings,
    scene_endings,
)

FILES = "/sero-mj/files"  # where the script sends them
MOST_BYTES, MOST_FILES = 500_000_000, 2000
_LONGEST_PATH = 400


def is_for_files(request: Request) -> bool:
    """Whether a request is that of the script."""
    return request.path.partition("?")[0] == FILES


async def take_files(connection: Any, on_file: Callable[[Path], None]) -> None:
    """Takes the files that the script sends by a connection, and answers with what is wrong.

    Args:
        connection: of `websockets`; its first message lists the files, the others are contents.
        on_file: is given the file that is to be opened.
    """
    try:
        try:
            path = await _take(connection)
        except UsageError as error:
            await connection.send(json.dumps({"error": str(error)}))
        else:
            on_file(path)
            await connection.send(json.dumps({"opening": path.name}))
    except ConnectionClosed:  # the page was closed meanwhile
        return


async def _take(connection: Any) -> Path:
    sizes = read_list(await connection.recv())
    main = main_file(list(sizes))
    folder = make_temporary_folder()
    try:
        for name, size in sizes.items():
            try:
                await _take_file(connection, folder / name, size)
            except OSError as error:
                raise UsageError(f"{name}: cannot be kept: {error.strerror}") from error
            except ValueError as error:
                raise UsageError(f"{name}: {error}") from error
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder / main


async def _take_file(connection: Any, file: Path, size: int) -> None:
    """Writes a file of so many bytes; raises ValueError where others come."""
    file.parent.mkdir(parents=True, exist_ok=True)
    left = size
    with file.open("wb") as stream:
        while left > 0:
            part = await connection.recv()
            if not isinstance(part, bytes) or len(part) > left:
                raise ValueError(f"found other contents than its {size} bytes")
            stream.write(part)
            left -= len(part)


def read_list(message: Any) -> dict[PurePosixPath, int]:
    """Reads the list of files: paths below the folder that they are put in, and sizes in bytes.

    Raises:
        UsageError: it is none, or too much.
    """
    try:
        listed = [(str(entry["path"]), operator.index(entry["size"]))
                  for entry in json.loads(message)]  # fmt: skip
    except (ValueError, KeyError, TypeError, RecursionError):
        raise UsageError("found no list of files; expected paths and sizes") from None
    found = {_checked(path): size for path, size in listed}
    if not found or min(found.values()) < 0:
        raise UsageError("found no file; drop a robot, a scene or a recording")
    if len(found) > MOST_FILES:
        raise UsageError(f"found {len(found)} files; at most {MOST_FILES} are taken")
    if sum(found.values()) > MOST_BYTES:
        size, most = sum(found.values()) / 1e6, MOST_BYTES / 1e6
        raise UsageError(
            f"found {size:.0f} MB; a page takes at most {most:.0f}: `sero-mj view FILE` opens it"
        )
    return found


def _checked(text: str) -> PurePosixPath:
    path = PurePosixPath(text)
    is_good = bool(path.parts) and len(text) <= _LONGEST_PATH and text.isprintable()
    if not is_good or ".." in path.parts or path.is_absolute() or set(r"\:") & set(text):
        raise UsageError(f"found the path {text[:80]!r}; expected a plain one")
    return path


def main_file(paths: Sequence[PurePosixPath]) -> PurePosixPath:
    """Returns which of several files is to be opened: the one that is nearest to their folder.

    Of several there, that which is called as a robot's file or as its folder.

    Raises:
        UsageError: there is none, or several.
    """
    endings = (".toml", *robot_endings(), *scene_endings(), ".mcap")
    found = [path for path in paths if path.suffix.lower() in endings]
    if not found:
        names = ", ".join(path.name for path in paths[:3]) + ", ..." * (len(paths) > 3)
        raise UsageError(f"found {names}; expected a file that ends in {', '.join(endings)}")
    depth = min(len(path.parts) for path in found)
    nearest = [path for path in found if len(path.parts) == depth]
    named = [
        path
        for path in nearest
        if path.name in (ROBOT_FILE, GROUP_FILE, "scene.toml") or path.stem == path.parent.name
    ]
    chosen = named if len(nearest) > 1 and named else nearest
    if len(chosen) > 1:
        names = " and ".join(path.name for path in chosen[:3])
        raise UsageError(f"found {names}; drop one of them, or its folder")
    return chosen[0]
