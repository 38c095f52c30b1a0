"""The contents of a file in the classic VRML syntax: nodes, their fields, PROTOs and ROUTEs.

The syntax does not determine the type of a field, so values are stored without a type. `read_field`
converts a value to a given type.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.errors import DeclarationError, Problem, mismatch, problems_of
from ...base.frames import Array

_MAX_PROBLEMS = 20  # maximum number of reported errors per file
# One value of each type has this number of numbers.
_WIDTHS = {
    "Float": 1, "Double": 1, "Time": 1, "Int32": 1,
    "Vec2f": 2, "Vec2d": 2, "Vec3f": 3, "Vec3d": 3, "Vec4f": 4, "Vec4d": 4,
    "Rotation": 4, "Color": 3, "ColorRGBA": 4,
    "Matrix3f": 9, "Matrix3d": 9, "Matrix4f": 16, "Matrix4d": 16,
}  # fmt: skip
_OTHER_TYPES = ("Bool", "String", "Node", "Image")
TYPES = tuple(f"{many}{kind}" for kind in (*_WIDTHS, *_OTHER_TYPES) for many in ("SF", "MF"))
_LARGEST = 1e30  # absolute value above which numbers are errors


class Is(NamedTuple):
    """The value `IS name`, which refers to a field of the enclosing PROTO."""

    name: str


@dataclass(frozen=True, eq=False)
class FieldValue:
    """The value of a field, without a type.

    `items` are numbers (floats or one array), strings, booleans, nodes, None for NULL, or one `Is`.
    """

    items: Sequence[Any] | Array
    line: int


@dataclass(frozen=True, eq=False)
class Field:
    """A field that a PROTO, an EXTERNPROTO or a Script declares."""

    access: str
    type: str
    value: FieldValue | None
    line: int


@dataclass(eq=False)
class Proto:
    """A PROTO, or an EXTERNPROTO, which has no body."""

    name: str
    line: int
    fields: dict[str, Field] = field(default_factory=dict)
    body: list[Node] = field(default_factory=list)
    urls: tuple[str, ...] = ()


@dataclass(eq=False)
class Node:
    """A node of a scene. `name` is the name that DEF gives to the node, or an empty string."""

    kind: str
    line: int
    name: str = ""
    fields: dict[str, FieldValue] = field(default_factory=dict)
    proto: Proto | None = None

    @property
    def label(self) -> str:
        return self.name or self.kind

    def value(self, name: str) -> FieldValue | None:
        """Returns the value of a field, which defaults to the value in the PROTO, or to None."""
        if name in self.fields:
            return self.fields[name]
        declared = None if self.proto is None else self.proto.fields.get(name)
        return None if declared is None else declared.value


@dataclass(frozen=True)
class RouteStatement:
    """A statement `ROUTE node.event TO node.event`."""

    origin: str
    event: str
    target: str
    input: str
    line: int


@dataclass(eq=False)
class Document:
    """The contents of a VRML or X3D file. `nodes` are the nodes at the top level."""

    path: Path
    nodes: list[Node] = field(default_factory=list)
    routes: list[RouteStatement] = field(default_factory=list)
    names: dict[str, Node] = field(default_factory=dict)
    protos: dict[str, Proto] = field(default_factory=dict)


class Problems:
    """Collects the errors of a file, so that all of them can be reported at once."""

    def __init__(self, path: Path, found: list[Problem] | None = None) -> None:
        self.path = path
        self.found: list[Problem] = [] if found is None else found

    def of(self, path: Path) -> Problems:
        """Returns a collection for the errors of another file, which are added to the same list."""
        return Problems(path, self.found)

    def add(self, key: str, message: str, line: int | None) -> None:
        self.found.append(Problem(key, message, str(self.path), line))

    @contextmanager
    def collect(self, key: str, line: int) -> Iterator[None]:
        """Context manager that catches a ValueError, and adds its problems to the collection."""
        try:
            yield
        except ValueError as error:
            found = problems_of(error, key)
            self.found += [replace(each, file=str(self.path), line=line) for each in found]

    def raise_all(self) -> None:
        """Raises a DeclarationError with the first 20 errors, if there are any."""
        if not self.found:
            return
        different = dict.fromkeys(self.found)
        left = len(different) - _MAX_PROBLEMS
        shown = sorted(different, key=lambda each: each.line or 0)[:_MAX_PROBLEMS]
        if left > 0:
            shown.append(Problem("", f"and {left} more", str(self.path)))
        raise DeclarationError(shown)


def instance(node: Node) -> Node | None:
    """Expands a PROTO instance to the first node of the PROTO body, or to None without a body."""
    if node.proto is None or not node.proto.body:
        return None
    made: dict[int, Node] = {}

    def copy(of: Node) -> Node:
        if id(of) in made:
            return made[id(of)]
        new = made[id(of)] = Node(of.kind, of.line, of.name, proto=of.proto)
        for name, value in of.fields.items():
            item = first(value)
            bound = node.value(item.name) if isinstance(item, Is) else value
            if bound is not None:
                new.fields[name] = bound if bound is not value else copied(value)
        return new

    def copied(value: FieldValue) -> FieldValue:
        if isinstance(value.items, np.ndarray):
            return value
        items = [copy(item) if isinstance(item, Node) else item for item in value.items]
        return FieldValue(items, value.line)

    return copy(node.proto.body[0])


def first(value: FieldValue) -> Any:
    """Returns the first item of a value, or None if the value is empty."""
    return value.items[0] if len(value.items) else None


def read_field(value: FieldValue, kind: str) -> Any:
    """Converts the value of a field to an X3D type, such as `SFFloat` or `MFVec3f`.

    Returns:
        bool, int, float or str for SFBool, SFInt32, SFFloat and SFString; `Node` or None for
        SFNode; array of shape (w,) for types with w numbers. MF types become lists of strings,
        nodes or booleans, or arrays of shape (k,) or (k, w). The order of numbers in matrices is
        unchanged.

    Raises:
        ValueError: the value does not have this type.
    """
    many, base = kind[:2] == "MF", kind[2:]
    items = value.items
    if base in _WIDTHS:
        numbers = _as_numbers(items)
        if base == "Int32" and (numbers != np.round(numbers)).any():
            raise ValueError(f"found {_shown(items)}; expected whole numbers")
        width = _WIDTHS[base]
        if many:
            if numbers.size % width:
                raise mismatch(numbers.size, f"{width} for each entry", of="numbers")
            return numbers if width == 1 else numbers.reshape(-1, width)
        if numbers.size != width:
            expected = "one number" if width == 1 else f"{width} numbers"
            raise ValueError(f"found {_counted(numbers)}; expected {expected}")
        if width > 1:
            return numbers
        return int(numbers[0]) if base == "Int32" else float(numbers[0])
    if base == "Image":
        return _as_numbers(items)
    types: dict[str, tuple[tuple[type, ...], str]] = {
        "Bool": ((bool,), "TRUE or FALSE"),
        "String": ((str,), 'a quoted string, "..."'),
        "Node": ((Node, type(None)), "a node"),
    }
    right, expected = types[base]
    if not all(isinstance(item, right) for item in items):
        plural = {"Bool": "TRUE or FALSE", "String": 'quoted strings, "..."', "Node": "nodes"}
        raise ValueError(f"found {_shown(items)}; expected {plural[base] if many else expected}")
    if many:
        return [item for item in items if item is not None]
    if len(items) != 1:
        raise mismatch(len(items), expected, of="values")
    return items[0]


def _as_numbers(items: Sequence[Any] | Array) -> Array:
    if not isinstance(items, np.ndarray) and not all(type(item) is float for item in items):
        raise ValueError(f"found {_shown(items)}; expected numbers")
    numbers = np.asarray(items, dtype=np.float64)
    if not (np.abs(numbers) < _LARGEST).all():
        raise ValueError(f"found {_shown(items)}; expected finite numbers up to {_LARGEST:g}")
    return numbers


def _counted(numbers: Array) -> str:
    return "nothing" if not numbers.size else f"{numbers.size} numbers"


def _shown(items: Sequence[Any] | Array) -> str:
    words = []
    for item in items[:4]:
        if isinstance(item, Node):
            words.append(item.label)
        elif isinstance(item, Is):
            words.append(f"IS {item.name}")
        elif item is None or isinstance(item, bool):
            words.append({None: "NULL", True: "TRUE", False: "FALSE"}[item])
        else:
            words.append(f"{item:g}" if isinstance(item, float) else f'"{item[:40]}"')
    return " ".join(words) + (" ..." if len(items) > 4 else "") or "nothing"


def get(node: Node, name: str, kind: str, default: Any, problems: Problems) -> Any:
    """Returns the value of a node's field, converted to the X3D type `kind` by `read_field`.

    If the field is missing or invalid, returns `default`. Errors are added to `problems`.
    """
    value = node.value(name)
    if value is None:
        return default
    try:
        return read_field(value, kind)
    except ValueError as error:
        problems.add(f"{node.label}.{name}", str(error), value.line)
        return default
