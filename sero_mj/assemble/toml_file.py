"""A TOML file with the line of every key, for errors that say where."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from ..errors import DeclarationError, Problem

_HEADER = re.compile(r"^\s*\[\[?\s*([^\]]+?)\s*\]\]?\s*(?:#.*)?$")
_KEY = re.compile(r"""^\s*((?:"[^"]*"|'[^']*'|[\w.-])+)\s*=""")


def read_toml(path: Path) -> dict[str, Any]:
    """Parses a TOML file.

    Raises:
        DeclarationError: the file is missing, unreadable, not UTF-8, or not TOML; for the
            latter the text has the line and column.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise DeclarationError([Problem("", "no such file", str(path))]) from None
    except OSError as error:
        raise DeclarationError(
            [Problem("", f"cannot be read: {error.strerror}", str(path))]
        ) from error
    except UnicodeDecodeError as error:
        raise DeclarationError(
            [Problem("", f"is not UTF-8 text (byte {error.start})", str(path))]
        ) from error
    except tomllib.TOMLDecodeError as error:
        raise DeclarationError([Problem("", f"is not TOML: {error}", str(path))]) from error


def key_lines(path: Path) -> dict[str, int]:
    """Returns the line number of each dotted key and table header.

    Reads line by line, so a key inside a multi-line value or an inline table is not found; the
    line of the key that holds it is.
    """
    lines: dict[str, int] = {}
    table = ""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return lines
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = _plain(header[1])
            lines.setdefault(table, number)
        elif key := _KEY.match(line):
            name = _plain(key[1])
            lines.setdefault(f"{table}.{name}" if table else name, number)
    return lines


def _plain(key: str) -> str:
    return re.sub(r"""["']|\s*(?=\.)|(?<=\.)\s*""", "", key)


def located(problem: Problem, path: Path, lines: dict[str, int]) -> Problem:
    """Returns the problem with its file, and the line of its key or of the nearest one above."""
    key = problem.key
    while key and key not in lines:
        key = key.rpartition(".")[0]
    return Problem(problem.key, problem.message, str(path), lines.get(key))
