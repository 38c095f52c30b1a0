"""Formats tables as readable TOML."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

_WIDTH = 100
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_LONG_TEXT = 400  # maximum length of text on one line, characters


def toml_text(tables: Mapping[str, Any], comments: Sequence[str] = ()) -> str:
    """Formats tables as TOML text that starts with comments, which are given without `#`."""
    lines = [f"# {line}".rstrip() for line in comments]
    plain = {key: value for key, value in tables.items() if not _is_section(value)}
    lines += [*([""] if lines and plain else []), *_entries(plain)]
    for key, value in tables.items():
        if _is_section(value):
            lines += _section(toml_key(key), value)
    return "\n".join(lines).strip("\n") + "\n"


def _is_section(value: Any) -> bool:
    entries = value if isinstance(value, list) and value else [value]
    return all(isinstance(entry, Mapping) for entry in entries)


def _section(name: str, value: Any) -> list[str]:
    if isinstance(value, list):
        return [line for each in value for line in ["", f"[[{name}]]", *_body(name, each)]]
    body = _body(name, value)
    # Headers of inner tables declare this table implicitly.
    has_header = bool(body) and body[0] == ""
    return body if has_header else ["", f"[{name}]", *body]


def _body(name: str, table: Mapping[str, Any]) -> list[str]:
    # Small inner tables, such as frames and couplings, are written inline.
    depth = len(re.findall(r'"[^"]*"|[^.]+', name))
    inner = {key: value for key, value in table.items() if _is_section(value)}
    small = {
        key: value
        for key, value in inner.items()
        if depth > 1 and isinstance(value, Mapping) and len(inline(value)) + len(key) < _WIDTH - 3
    }
    plain = {key: value for key, value in table.items() if key not in inner or key in small}
    lines = _entries(plain)
    for key, value in inner.items():
        if key not in small:
            lines += _section(f"{name}.{toml_key(key)}", value)
    return lines


def _entries(table: Mapping[str, Any]) -> list[str]:
    return [line for key, value in table.items() for line in toml_entry(key, value)]


def toml_entry(key: str, value: Any) -> list[str]:
    """Returns the lines of TOML text that set a key."""
    line = f"{toml_key(key)} = {inline(value)}"
    if isinstance(value, str) and len(value) > _LONG_TEXT and "'''" not in value:
        line = f"{toml_key(key)} = '''\n{value}'''"
    elif isinstance(value, list) and len(line) > _WIDTH:
        rows = _rows(value)
        line = f"{toml_key(key)} = [\n" + "".join(f"  {row},\n" for row in rows) + "]"
    return line.split("\n")


def _rows(values: list[Any]) -> list[str]:
    texts = [inline(value) for value in values]
    if any(isinstance(value, list | Mapping) for value in values):
        return texts
    rows: list[str] = []
    for text in texts:
        if rows and len(rows[-1]) + len(text) < _WIDTH - 5:
            rows[-1] += f", {text}"
        else:
            rows.append(text)
    return rows


def toml_key(key: str) -> str:
    """Returns a key as TOML text, quoted if necessary."""
    return key if _BARE.fullmatch(key) else _quoted(key)


def _quoted(text: str) -> str:
    # JSON and TOML have the same escapes, except for DEL, which JSON does not escape.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def inline(value: Any) -> str:
    """Returns a value as one line of TOML text."""
    if isinstance(value, Mapping):
        entries = ", ".join(f"{toml_key(key)} = {inline(each)}" for key, each in value.items())
        return f"{{ {entries} }}" if entries else "{}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(inline, value))}]"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        if not math.isfinite(value):
            return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
        return repr(float(value))
    return str(int(value)) if isinstance(value, int) else _quoted(str(value))
