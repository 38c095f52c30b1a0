"""Decides whether a file may start programs or load code. No other module decides this.

A file can request actions: run the program of a controller, load a library or an FMU, exchange
packets with a program on the network. sero-mj reads and checks these requests, but performs them
only if the file is trusted. A file is trusted in three cases:

- The user typed its path in order to simulate it: `sero-mj simulate`, `sweep`, `send --play` and
  `view`, or `read_scenario` and `view` in Python. This is like `python FILE`.
- It is in a folder that the user trusts (`view --trust FOLDER`).
- The user allowed exactly this content in the dialog of a window or page.

All other files (dropped or uploaded files, files opened from a page, scenarios in recordings) are
displayed without simulation. Declarations made in Python have no file. They belong to the program
of the user and are trusted.

A module that a file names is imported only if an installed package lists it, see `import_listed`.
Expressions of xacro are not evaluated by Python, see `robots.importers.xacro_file`.
"""

from __future__ import annotations

import hashlib
import logging
import pkgutil
from collections.abc import Collection, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import NotTrusted, UnknownName, in_one_line

# Reports withheld actions on the command line. Windows and pages show a dialog instead.
log = logging.getLogger(__name__)

_folders: set[Path] = set()
_allowed: set[str] = set()  # digests of requests


@dataclass(frozen=True)
class RequestedAction:
    """An action that a file requests in addition to displaying robots.

    Attributes:
        key: table that requests the action, for example `controllers.lwr`.
        text: verb phrase in one line, for example `run the program ./controller 5000`.
        files: files that would be run, as far as they are known.
    """

    key: str
    text: str
    files: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", in_one_line(self.text))

    def __str__(self) -> str:
        return f"{self.text} ({self.key})"


@dataclass(frozen=True)
class FileOrigin:
    """The file that a declaration was read from."""

    file: Path
    is_trusted: bool = False


@dataclass(frozen=True)
class Request:
    """All actions that a file requests.

    Attributes:
        tables: other files that declare actions, such as an extended scenario.
        digest: SHA-256 digest of the actions and of the contents of all files at the time of the
            request. A permission is valid only for the content that the user was shown.
    """

    file: Path
    actions: tuple[RequestedAction, ...]
    tables: tuple[Path, ...] = ()
    digest: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "digest", self._digest())

    def _digest(self) -> str:
        named = {self.file, *self.tables, *(each for one in self.actions for each in one.files)}
        digest = hashlib.sha256()
        for path in sorted(each.absolute() for each in named):
            digest.update(f"{path}\0".encode())
            try:
                digest.update(hashlib.sha256(path.read_bytes()).digest())
            except OSError:
                digest.update(b"missing")
        for action in self.actions:
            digest.update(f"{action}\0".encode())
        return digest.hexdigest()


def trust_folder(folder: Path | str) -> None:
    """Trusts the files in a folder and its subfolders."""
    _folders.add(Path(folder).resolve())


def allow(request: Request) -> None:
    """Allows a request until the content of one of its files changes."""
    _allowed.add(request.digest)


def is_allowed(request: Request) -> bool:
    """Returns whether a request was allowed, or all of its files are in trusted folders."""
    if _folders:
        files = [request.file, *request.tables, *(f for a in request.actions for f in a.files)]
        if all(any(f.resolve().is_relative_to(each) for each in _folders) for f in files):
            return True
    return request.digest in _allowed


def require(origin: FileOrigin | None, actions: Collection[RequestedAction]) -> None:
    """Raises NotTrusted if a declaration requests actions and its file is not trusted."""
    if actions and origin is not None and not origin.is_trusted:
        raise NotTrusted(origin.file, [str(action) for action in actions])


def import_listed(package: str, module: str, listed: Iterable[str]) -> Any:
    """Imports a module whose name may come from a file.

    Raises UnknownName if the package does not list the module.
    """
    known = list(listed)
    if module not in known:
        raise UnknownName(f"module of {package}", module, known)
    return pkgutil.resolve_name(f"{package}.{module}")
