"""A TOML file with the line of every key, for errors that say where."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..errors import DeclarationError, Problem


def read_toml(path: Path) -> dict[str, Any]:
    """Parses a TOML file.

    Raises:
        DeclarationError: the file is missing, unreadable, not UTF-8, or not TOML; for the
            latter the text has the line and column.
    """

    def wrong(message: str) -> DeclarationError:
        line = re.search(r"at line (\d+)", message)
        return DeclarationError([Problem("", message, str(path), int(line[1]) if line else None)])

    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise wrong("no such file") from None
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise wrong(f"is not UTF-8 text (byte {error.start})") from error
    except RecursionError:
        raise wrong("is not TOML: nested too deeply") from None
    except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
        raise wrong(f"is not TOML: {error}") from error


def key_lines(path: Path) -> dict[str, int]:
    """Returns the line number of each dotted key and table header.

    The file is cut into its statements, and each is parsed by itself, so that quotes, dots,
    inline tables and values over several lines mean what they mean in TOML. A key inside a value
    has the line where the value's statement begins.
    """
    lines: dict[str, int] = {}
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError):
        return lines
    table = ""
    entries: Counter[str] = Counter()  # of arrays of tables
    for number, statement in _statements(text):
        parsed = tomllib.loads(statement)
        if statement.lstrip().startswith("["):
            *outer, table = _keys(parsed)
            for key in outer:
                lines.setdefault(key, number)
            if statement.lstrip().startswith("[["):
                table = table.removesuffix(".0")
                lines.setdefault(table, number)
                entries[table] += 1
                table += f".{entries[table] - 1}"
            # A table inside an array of tables belongs to the array's latest entry.
            for array, count in entries.items():
                if table.startswith(f"{array}.") and not table.startswith(f"{array}.{count - 1}"):
                    table = f"{array}.{count - 1}{table.removeprefix(array)}"
            lines.setdefault(table, number)
        else:
            for key in _keys(parsed):
                lines.setdefault(f"{table}.{key}" if table else key, number)
    return lines


def _statements(text: str) -> Iterator[tuple[int, str]]:
    """Yields the line number and the text of every header and every `key = value`."""
    start, pending = 0, ""
    for number, line in enumerate(text.split("\n"), start=1):
        if not pending and (not line.strip() or line.lstrip().startswith("#")):
            continue
        start = start if pending else number
        pending += line + "\n"
        try:
            tomllib.loads(pending)
        except (ValueError, RecursionError):
            continue  # goes on in the next line
        yield start, pending
        pending = ""


def _keys(value: Any, prefix: str = "") -> Iterator[str]:
    """Yields every dotted key in a parsed value, the outer ones first."""
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in pairs:
        name = f"{prefix}.{key}" if prefix else str(key)
        yield name
        if isinstance(inner, dict | list):
            yield from _keys(inner, name)


def located(problem: Problem, path: Path, lines: dict[str, int]) -> Problem:
    """Returns the problem with its file, and the line of its key or of the nearest one above."""
    key = problem.key
    while key and key not in lines:
        key = key.rpartition(".")[0]
    return Problem(problem.key, problem.message, str(path), lines.get(key))
