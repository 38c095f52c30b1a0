"""A TOML file with the line of every key, for errors that say where."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from .errors import DeclarationError, Problem

_MOST_ROWS = 300  # of an array whose entries are told apart; looking takes the square of it


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
    inline tables and values over several lines mean what they mean in TOML. An entry of an array
    has the line where it begins; any other key inside a value has that of its statement.
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
            depth, within = _entry_lines(statement, parsed)
            for key in _keys(parsed):
                entry = ".".join(key.split(".")[:depth])
                line = number + within.get(entry, 0)
                lines.setdefault(f"{table}.{key}" if table else key, line)
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


def _entry_lines(statement: str, parsed: dict[str, Any]) -> tuple[int, dict[str, int]]:
    """How many lines below its statement's first one each entry of an array begins.

    What stands up to the end of a line is an array as well, once it is closed there.

    Returns:
        how many parts the dotted key of an entry has, and the lines by that key.
    """
    key = _array_in(parsed)
    rows = statement.rstrip("\n").split("\n")
    if not key or not 1 < len(rows) <= _MOST_ROWS:
        return 0, {}
    found: dict[str, int] = {}
    known = begin = 0
    for count in range(1, len(rows) + 1):
        text = "\n".join(rows[:count])
        try:
            value: Any = tomllib.loads(text if count == len(rows) else f"{text}\n]")
        except (ValueError, RecursionError):
            continue  # it ends in the middle of an entry
        for part in key.split("."):
            value = value[part]
        found |= {f"{key}.{index}": begin for index in range(known, len(value))}
        known, begin = len(value), count
    return key.count(".") + 2, found


def _array_in(parsed: dict[str, Any]) -> str:
    """The dotted key of the array that a statement declares; empty where it declares none."""
    keys: list[str] = []
    value: Any = parsed
    while isinstance(value, dict) and len(value) == 1:
        ((key, value),) = value.items()
        keys.append(key)
    return ".".join(keys) if isinstance(value, list) and not any("." in k for k in keys) else ""


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
