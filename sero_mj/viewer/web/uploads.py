"""Receives and stores files that the user drops on a page.

Browsers do not send the paths of dropped files. A robot with separate mesh files must therefore be
dropped as a folder or together with the meshes. A drop is deleted when this process ends, when the
file cannot be opened, or when it is no longer shown and another drop needs the space.
"""

from __future__ import annotations

import asyncio
import json
import shutil
import threading
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field, ValidationError
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

FILES = "/sero-mj/files"  # path of the upload websocket
MAX_BYTES, MAX_FILES = 500_000_000, 2000  # limits for all drops of this process together
_MAX_PATH, _MAX_DEPTH = 400, 20
NOT_IN_CONTROL = "another browser has control of this page; take control, then drop the files again"
_TIMEOUT = 60.0  # maximum time until the next part of a file, s

# Function that receives the key of a connection, and returns why its upload is refused, or None.
MayUpload = Callable[[str], str | None]


def is_for_files(request: Request) -> bool:
    """Returns whether a request comes from the upload script."""
    return request.path.partition("?")[0] == FILES


class _Size(NamedTuple):
    files: int
    bytes: int


class Drops:
    """All files that users have dropped on pages of this process. They share one size limit."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._sizes: dict[Path, _Size] = {}  # keys: folders, oldest first
        self._shown: set[Path] = set()  # folders of displayed files
        self._arriving: set[Path] = set()  # folders that are being received or not shown yet

    @property
    def size(self) -> tuple[int, int]:
        sizes = self._sizes.values()
        return sum(each.files for each in sizes), sum(each.bytes for each in sizes)

    def reserve(self, files: int, size: int) -> Path:
        """Creates a folder for a drop. If space is needed, drops that are not shown are deleted.

        Raises:
            UsageError: there is not enough space, because other drops are shown or being received.
        """
        with self._lock:
            while not self._has_space(files, size):
                unused = self._sizes.keys() - self._shown - self._arriving
                if not unused:
                    stored = sum(each.bytes for each in self._sizes.values()) / 1e6
                    raise UsageError(
                        f"no space for {files} files of {size / 1e6:.0f} MB: this viewer already "
                        f"stores {len(self._sizes)} drops of {stored:.0f} MB. The limit is "
                        f"{MAX_FILES} files and {MAX_BYTES / 1e6:.0f} MB in total. "
                        "Restart the viewer, or open the file with `sero-mj view FILE`"
                    )
                self._remove(next(each for each in self._sizes if each in unused))
            folder = make_temporary_folder()
            self._sizes[folder] = _Size(files, size)
            self._arriving.add(folder)
            return folder

    def discard(self, path: Path | str) -> None:
        """Deletes the drop that contains a file, unless the viewer shows it."""
        with self._lock:
            for folder in self._folders([path]) - self._shown:
                self._remove(folder)

    def show(self, *paths: Path | str) -> None:
        """Sets the files that the viewer shows. All other drops may be deleted."""
        with self._lock:
            self._shown = self._folders(paths)
            self._arriving.clear()

    def _has_space(self, files: int, size: int) -> bool:
        stored, space = self.size
        return stored + files <= MAX_FILES and space + size <= MAX_BYTES

    def _folders(self, paths: Sequence[Path | str]) -> set[Path]:
        parents = {parent for path in paths for parent in Path(path).parents}
        return parents & self._sizes.keys()

    def _remove(self, folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        del self._sizes[folder]
        self._arriving.discard(folder)


drops = Drops()


async def take_files(
    connection: Any, may_upload: MayUpload, on_file: Callable[[Path], None]
) -> None:
    """Receives and stores the files that the upload script sends, or sends back an error.

    Args:
        connection: `websockets` connection. Its first message lists the files, and the other
            messages are their contents.
        may_upload: function that checks the key in the first message. It is called again while
            contents arrive.
        on_file: function called with the file to open.
    """
    try:
        try:
            path = await _take(connection, may_upload)
        except UsageError as error:
            await connection.send(json.dumps({"error": str(error)}))
        else:
            on_file(path)
            await connection.send(json.dumps({"opening": path.name}))
    except (ConnectionClosed, TimeoutError):  # The user has closed the page.
        return


async def _take(connection: Any, may_upload: MayUpload) -> Path:
    listed = read_list(await _next(connection))
    sizes = listed.sizes

    def check() -> None:
        if (reason := may_upload(listed.key)) is not None:
            raise UsageError(reason)

    check()
    main = main_file(list(sizes))
    folder = drops.reserve(len(sizes), sum(sizes.values()))
    try:
        for name, size in sizes.items():
            try:
                await _take_file(connection, folder / name, size, check)
            except OSError as error:
                raise UsageError(f"{name} cannot be stored: {error.strerror}") from error
            except ValueError as error:
                raise UsageError(f"{name}: {error}") from error
        check()
    except BaseException:
        drops.discard(folder / main)
        raise
    return folder / main


async def _take_file(connection: Any, file: Path, size: int, check: Callable[[], None]) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    left = size
    with file.open("wb") as stream:
        while left > 0:
            part = await _next(connection)
            check()
            if not isinstance(part, bytes) or len(part) > left:
                raise ValueError(f"found contents of another size; expected {size} bytes")
            stream.write(part)
            left -= len(part)


async def _next(connection: Any) -> str | bytes:
    message: str | bytes = await asyncio.wait_for(connection.recv(), _TIMEOUT)
    return message


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    path: str
    size: int


class _Listed(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    key: Annotated[str, Field(max_length=100)]
    files: list[_Entry]


class Listed(NamedTuple):
    """The list of files of a drop, which the upload script sends first.

    Attributes:
        key: secret key of the connection in control.
        sizes: mapping from paths of files to their sizes in bytes.
    """

    key: str
    sizes: dict[PurePosixPath, int]


def read_list(message: str | bytes) -> Listed:
    """Parses a message with the list of files of a drop. Raises UsageError if it is invalid."""
    try:
        listed = _Listed.model_validate_json(message)
    except (ValidationError, UnicodeEncodeError):
        raise UsageError(
            "the list of dropped files is invalid; expected their paths and sizes"
        ) from None
    if len(listed.files) > MAX_FILES:
        raise UsageError(f"found {len(listed.files)} files; expected at most {MAX_FILES}")
    found = {_checked(entry.path): entry.size for entry in listed.files}
    if not found or min(found.values()) < 0:
        raise UsageError("the drop contains no file; drop a robot, a scene or a recording")
    if sum(found.values()) > MAX_BYTES:
        size, limit = sum(found.values()) / 1e6, MAX_BYTES / 1e6
        raise UsageError(
            f"found {size:.0f} MB; expected at most {limit:.0f} MB. "
            "Open the file with `sero-mj view FILE`"
        )
    return Listed(listed.key, found)


def _checked(text: str) -> PurePosixPath:
    path = PurePosixPath(text)
    is_valid = 0 < len(path.parts) <= _MAX_DEPTH and len(text) <= _MAX_PATH
    is_valid = is_valid and text.isprintable()
    if not is_valid or ".." in path.parts or path.is_absolute() or set(r"\:") & set(text):
        raise UsageError(f"found the path {text[:80]!r}; expected a relative path without '..'")
    return path


def main_file(paths: Sequence[PurePosixPath]) -> PurePosixPath:
    """Returns the file of a drop that must be opened.

    This is the file nearest to the top folder. If there are several candidates, those with the name
    of a robot file, of a scene file or of their folder are preferred, and then the only TOML file.

    Raises:
        UsageError: no file can be opened, or the choice is ambiguous.
    """
    endings = (".toml", *robot_endings(), *scene_endings(), ".mcap")
    found = [path for path in paths if path.suffix.lower() in endings]
    if not found:
        names = ", ".join(path.name for path in paths[:3]) + ", ..." * (len(paths) > 3)
        raise UsageError(f"found {names}; expected a file with the extension {', '.join(endings)}")
    depth = min(len(path.parts) for path in found)
    nearest = [path for path in found if len(path.parts) == depth]
    named = [
        path
        for path in nearest
        if path.name in (ROBOT_FILE, GROUP_FILE, "scene.toml") or path.stem == path.parent.name
    ]
    chosen = named if len(nearest) > 1 and named else nearest
    tables = [path for path in chosen if path.suffix.lower() == ".toml"]
    if len(tables) == 1:
        chosen = tables
    if len(chosen) > 1:
        names = " and ".join(path.name for path in chosen[:3])
        raise UsageError(f"found {names}; drop only one of them, or its folder")
    return chosen[0]
