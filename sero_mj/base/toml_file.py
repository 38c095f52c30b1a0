"""Reads TOML files together with the line number of each key, for error messages."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from .errors import DeclarationError, Problem
from .paths import format_of, read_file

_MCAP = b"\x89MCAP"
_MAX_BYTES = 20_000_000
_MAX_PARTS = 100  # parts of a dotted key, because the parsing time grows with their square
# A key or table takes 1 kB of memory while parsing.
_MAX_NAMES, _MAX_VALUES = 100_000, 2_000_000
# Quotes and comments match as a whole. An unclosed quote ends with its line.
_LONG_TEXT = (
    r'"""(?:[^"\\]|\\.|"(?!""))*+(?:"{3,5}|\Z)'
    r"|'''(?:[^']|'(?!''))*+(?:'{3,5}|\Z)"
)
_TOKENS = re.compile(
    rf"{_LONG_TEXT}"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|\#[^\n]*+"
    r"|[\[\]{}\n]",
    re.DOTALL,
)
_PART = r"""(?>[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_PARTS = re.compile(_PART, re.DOTALL)
# Possible keys match as a whole. A key is followed by an equals sign, or is a header.
_NAMES_AND_VALUES = re.compile(
    rf"{_LONG_TEXT}|\#[^\n]*+"
    r"|(?P<numbers>(?:[-+]?[0-9][-+0-9.eE_]*+\s*+,\s*+)++)"
    rf"|(?P<header>^[ \t]*+\[\[?[ \t]*+)?(?P<key>{_PART}(?:[ \t]*+\.[ \t]*+{_PART})*+)[ \t]*+"
    r"(?P<ends>=|(?(header)\]\]?[ \t]*+(?=[\n#]|\Z)|=))?",
    re.DOTALL | re.MULTILINE,
)
_MAX_CACHED = 100_000  # characters of a text whose results are cached
_Found = TypeVar("_Found")
_MAX_ROWS = 300  # rows of an array whose entries get line numbers, in quadratic time


def read_toml(path: Path) -> dict[str, Any]:
    """Parses a TOML file.

    Raises:
        DeclarationError: the file is missing, unreadable, too large, not UTF-8, or not valid TOML.
    """

    def wrong(message: str) -> DeclarationError:
        line = re.search(r"at line (\d+)", message)
        return Problem("", message, str(path), int(line[1]) if line else None).error()

    try:
        contents = read_file(path, _MAX_BYTES)
        other = _other_format(contents)
        if other is None:
            return parse_toml(_as_text(contents))
    except FileNotFoundError:
        raise wrong("no such file") from None
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise wrong(f"is not UTF-8 text (byte {error.start})") from error
    except ValueError as error:
        raise wrong(f"not valid TOML: {error}") from error
    raise wrong(other)


def parse_toml(text: str) -> dict[str, Any]:
    """Parses TOML.

    Raises ValueError if the text is invalid, too large, or too deeply nested.
    """
    return {key: _copied(value) for key, value in _tables_of(text).items()}


def _parse(text: str) -> dict[str, Any]:
    _check_counts(text)
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError("the tables or lists are nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"{error}{_hint(text, str(error))}") from None


def _hint(text: str, message: str) -> str:
    place = re.search(r"at line (\d+), column (\d+)", message)
    if place is None:
        return ""
    line, column = int(place[1]), int(place[2])
    word = re.match(r"\w*", text.split("\n")[line - 1][column - 1 :])
    lower = word[0].lower() if word else ""
    return f"; write {lower} in lower case" if lower in ("true", "false") else ""


def _cached(function: Callable[[str], _Found]) -> Callable[[str], _Found]:
    """Caches the results of recent texts, because all variants of a sweep read the same files."""
    cached = lru_cache(8)(function)
    return lambda text: cached(text) if len(text) <= _MAX_CACHED else function(text)


_tables_of = _cached(_parse)  # copying the result takes a tenth of the time of parsing


def _copied(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _copied(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_copied(each) for each in value]
    return value


def _check_counts(text: str) -> None:
    names = values = 0
    for found in _NAMES_AND_VALUES.finditer(text):
        key = found["key"]
        if key is None:
            values += found.group().count(",") if found["numbers"] else 1
            parts = 0
        else:
            parts = key.count(".") + 1
            if parts > _MAX_PARTS:
                parts = len(_PARTS.findall(key))  # without the dots in quotes
            names += parts if found["ends"] else 0
            values += 0 if found["ends"] else 1
        for count, maximum, what in (
            (parts, _MAX_PARTS, "parts of a dotted key"),
            (names, _MAX_NAMES, "keys and tables"),
            (values, _MAX_VALUES, "values"),
        ):
            if count > maximum:
                line = text.count("\n", 0, found.start("key") if key else found.start()) + 1
                raise ValueError(f"expected at most {maximum} {what} (at line {line})")


def _as_text(contents: bytes) -> str:
    return contents.decode("utf-8-sig").replace("\r\n", "\n")


def _other_format(contents: bytes) -> str | None:
    if contents.startswith(_MCAP):
        return "is a recording; expected a TOML file. Use view, render or export to open it"
    if (found := format_of(contents)) is None:
        return None
    how = "a robot is a Denavit-Hartenberg table in TOML, or URDF or MJCF in .urdf or .xml"
    return f"is {found}; expected a TOML file: {how}"


def key_lines(path: Path) -> dict[str, int]:
    """Returns the line number of each dotted key and table header.

    The file is split into statements that are parsed separately, so that quotes, dots, inline
    tables and multi-line values are handled as in TOML. An entry of an array has the line of its
    first character. Other keys inside a value have the line of the statement.
    """
    try:
        return dict(_lines_of(_as_text(read_file(path, _MAX_BYTES))))
    except (OSError, UnicodeDecodeError):
        return {}


@_cached
def _lines_of(text: str) -> dict[str, int]:
    lines: dict[str, int] = {}
    table = ""
    entries: Counter[str] = Counter()  # number of entries per array of tables
    for number, statement in _statements(text):
        try:
            parsed = _parse(statement)  # not cached: statements would displace whole files
        except ValueError:
            continue
        if statement.lstrip().startswith("["):
            *outer, table = _keys(parsed)
            for key in outer:
                lines.setdefault(key, number)
            if statement.lstrip().startswith("[["):
                lines.setdefault(table, number)
                entries[table] += 1
                table += f".{entries[table] - 1}"
            # A table inside an array of tables belongs to the last entry of the array.
            for array, count in entries.items():
                if table.startswith(f"{array}.") and not table.startswith(f"{array}.{count - 1}"):
                    table = f"{array}.{count - 1}{table.removeprefix(array)}"
            lines.setdefault(table, number)
        else:
            depth, within = _entry_lines(statement, parsed)
            for key in (*within, *_keys(parsed)):
                entry = ".".join(key.split(".")[:depth])
                line = number + within.get(entry, 0)
                lines.setdefault(f"{table}.{key}" if table else key, line)
    return lines


def _statements(text: str) -> Iterator[tuple[int, str]]:
    depth = begin = 0
    line = first = 1  # current line, first line of the statement
    for token in chain(_TOKENS.finditer(text), [None]):
        what = "" if token is None else token.group()
        depth += (what in ("[", "{")) - (what in ("]", "}"))
        line += what.count("\n")
        if token is not None and (what != "\n" or depth > 0):
            continue
        end = len(text) if token is None else token.end()
        statement = text[begin:end]
        bare = statement.lstrip(" \t\n")
        if bare and not bare.startswith("#"):
            yield first, bare if bare.endswith("\n") else f"{bare}\n"
        begin, first, depth = end, line, 0


def _entry_lines(statement: str, parsed: dict[str, Any]) -> tuple[int, dict[str, int]]:
    """Returns the number of key parts of an array entry, and the line offset of each entry.

    Parses the text up to the end of each line, after closing the array there.
    """
    key = _array_in(parsed)
    rows = statement.rstrip("\n").split("\n")
    if not key or not 1 < len(rows) <= _MAX_ROWS:
        return 0, {}
    found: dict[str, int] = {}
    known = begin = 0
    for count in range(1, len(rows) + 1):
        text = "\n".join(rows[:count])
        try:
            value: Any = parse_toml(text if count == len(rows) else f"{text}\n]")
        except ValueError:
            continue  # the line ends in the middle of an entry
        for part in key.split("."):
            value = value[part]
        found |= {f"{key}.{index}": begin for index in range(known, len(value))}
        known, begin = len(value), count
    return key.count(".") + 2, found


def _array_in(parsed: dict[str, Any]) -> str:
    keys: list[str] = []
    value: Any = parsed
    while isinstance(value, dict) and len(value) == 1:
        ((key, value),) = value.items()
        keys.append(key)
    return ".".join(keys) if isinstance(value, list) and not any("." in k for k in keys) else ""


def _keys(value: Any, prefix: str = "") -> Iterator[str]:
    pairs = value.items() if isinstance(value, dict) else enumerate(value)
    for key, inner in pairs:
        name = f"{prefix}.{key}" if prefix else str(key)
        if isinstance(value, dict):
            yield name
        if isinstance(inner, dict | list):
            yield from _keys(inner, name)


def located(
    problems: Iterable[Problem], path: Path, lines: Mapping[str, int] | None = None
) -> list[Problem]:
    """Adds a file to problems, and the line number of their key or of a parent key.

    Problems that already name a file are returned unchanged. `lines` contains the line numbers by
    dotted key (default: read from the file).
    """
    problems = list(problems)
    if lines is None:
        lines = key_lines(path) if problems else {}

    def line_of(key: str) -> int | None:
        while key and key not in lines:
            key = key.rpartition(".")[0]
        return lines.get(key)

    return [
        each if each.file else replace(each, file=str(path), line=line_of(each.key))
        for each in problems
    ]
