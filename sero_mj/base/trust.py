"""What may run: the one place that decides whether a file may start a program or load code.

A file is data. What it asks for (to run a controller's program, to load a library or an FMU, to
exchange packets with a program on the network) is read and checked, but not done, unless the file
is trusted. A file is trusted in three cases:

- Its user typed its path in order to simulate it: `sero-mj simulate`, `sweep`, `send --play` and
  `view`, or `read_scenario` and `view` in Python. It then runs as FILE does in `python FILE`.
- It is in a folder that the user trusts (`view --trust FOLDER`).
- The user allowed exactly this content in the dialog of a window or page.

Everything else that arrives (dropped or uploaded files, files opened from a page, scenarios in
recordings) is shown without simulating. Declarations made in Python have no file. They are part of
the user's own program and run.

Two more rules concern modules. A module that a file names is imported only if an installed package
lists it, see `import_listed`. Expressions of xacro never reach Python, see
`robots.importers.xacro_file`.
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

log = logging.getLogger(__name__)  # what was withheld; windows and pages show a dialog instead

_folders: set[Path] = set()
_allowed: set[str] = set()  # digests of requests


@dataclass(frozen=True)
class RequestedAction:
    """Something that a file asks to do besides showing robots.

    Attributes:
        key: table that asks, `controllers.lwr` for example.
        text: what it does, as a verb phrase in one line: `run the program ./controller 5000`.
        files: the files that would be run, as far as they are known.
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
    """Everything that a file asks for.

    Attributes:
        tables: the other files that say what is run, such as an extended scenario.
        digest: SHA-256 of the contents of all its files, and of what is run, as they were when the
            request was made: what a user allows is what was shown.
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
    """Allows the files in a folder, and in those below it, to run what they ask for."""
    _folders.add(Path(folder).resolve())


def allow(request: Request) -> None:
    """Allows a request as long as the contents of its files stay as they were when it was made."""
    _allowed.add(request.digest)


def is_allowed(request: Request) -> bool:
    """Whether a request was allowed, or all of its files are in trusted folders."""
    if _folders:
        files = [request.file, *request.tables, *(f for a in request.actions for f in a.files)]
        if all(any(f.resolve().is_relative_to(each) for each in _folders) for f in files):
            return True
    return request.digest in _allowed


def require(origin: FileOrigin | None, actions: Collection[RequestedAction]) -> None:
    """Checks that a declaration may run what it asks for.

    Raises NotTrusted if its file is not trusted.
    """
    if actions and origin is not None and not origin.is_trusted:
        raise NotTrusted(origin.file, [str(action) for action in actions])


def import_listed(package: str, module: str, listed: Iterable[str]) -> Any:
    """Imports a module that a file may have named.

    Raises UnknownName if the package does not list it.
    """
    known = list(listed)
    if module not in known:
        raise UnknownName(f"module of {package}", module, known)
    return pkgutil.resolve_name(f"{package}.{module}")
