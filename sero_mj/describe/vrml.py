"""The classic VRML syntax, in which VRML97 and X3D's classic encoding are written: text to nodes.

Sources: ISO/IEC 14772-1 (VRML97), annex A; ISO/IEC 19776-2 (X3D's classic VRML encoding). Values
are kept as they stand, since a syntax alone does not tell a field's type; `read_field` takes
them as one.
"""

from __future__ import annotations

import re
import reprlib
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..errors import DeclarationError, Problem, did_you_mean
from ..frames import Array
from ..paths import read_file

MOST_BYTES = 50_000_000  # of a file, unpacked; a million triangles, say
_MOST_TOKENS = 2_000_000  # that are no numbers in a list; some seconds
_MOST_DEPTH = 120  # of nodes inside nodes; reading one takes a few calls
_MOST_PROBLEMS = 20  # told of one file
_GZIP = b"\x1f\x8b"
_HEADER = re.compile(r"#(?:X3D V\d+\.\d+|VRML V2\.0)\b")
# Signs by which papers and editors show that a line goes on.
_CONTINUED = "←↩↵↲⏎⤶¬\\\\"
_TOKEN = re.compile(
    rf"(?P<space>(?:[\s,\ufeff]|\#[^\r\n]*|[{_CONTINUED}](?=[^\S\n]*(?:\r?\n|\Z)))++)"
    r'|(?P<text>"(?:[^"\\]|\\.)*+")'
    r"|(?P<number>(?:0[xX][0-9a-fA-F]++|[-+]?(?:\d++\.?\d*+|\.\d++)(?:[eE][-+]?\d++)?)"
    r"(?![^\s,\[\]{}\#\"]))"
    r"|(?P<mark>[\[\]{}.])"
    r"|(?P<name>[^\s\"“”„\#',.\[\]\\{}\x00-\x1f\x7f0-9+-][^\s\"\#',.\[\]\\{}\x00-\x1f\x7f]*+)"
    r'|(?P<other>"|[^\s,"\[\]{}\#]++)',
    re.DOTALL,
)
_NUMBERS = re.compile(r"[-+0-9.eE\s,]*+")
_ESCAPED = re.compile(r"\\(.)", re.DOTALL)
_ACCESS = {
    "field": "initializeOnly",
    "eventIn": "inputOnly",
    "eventOut": "outputOnly",
    "exposedField": "inputOutput",
}
_WITH_VALUE = ("initializeOnly", "inputOutput")
# Numbers of one value of a type.
_WIDTHS = {
    "Float": 1, "Double": 1, "Time": 1, "Int32": 1,
    "Vec2f": 2, "Vec2d": 2, "Vec3f": 3, "Vec3d": 3, "Vec4f": 4, "Vec4d": 4,
    "Rotation": 4, "Color": 3, "ColorRGBA": 4,
    "Matrix3f": 9, "Matrix3d": 9, "Matrix4f": 16, "Matrix4d": 16,
}  # fmt: skip
_OTHER_TYPES = ("Bool", "String", "Node", "Image")
TYPES = tuple(f"{many}{kind}" for kind in (*_WIDTHS, *_OTHER_TYPES) for many in ("SF", "MF"))
_LARGEST = 1e30  # no number of a scene is larger


class Is(NamedTuple):
    """`IS name`: the value of a field of the PROTO around it."""

    name: str


@dataclass(frozen=True, eq=False)
class Value:
    """The value of a field as it stands.

    Attributes:
        items: numbers (float, or all of them in an array), texts, true and false, nodes, None for
            NULL, or one `Is`.
        line: of its first token.
    """

    items: Sequence[Any] | Array
    line: int


@dataclass(frozen=True, eq=False)
class Field:
    """A field that a PROTO, an EXTERNPROTO or a Script declares.

    Attributes:
        access: `initializeOnly`, `inputOnly`, `outputOnly` or `inputOutput`.
        type: `SFFloat`, ...
        value: its default; None where it has none.
        line: of its declaration.
    """

    access: str
    type: str
    value: Value | None
    line: int


@dataclass(eq=False)
class Proto:
    """A PROTO or an EXTERNPROTO.

    Attributes:
        name: of the nodes that it makes.
        line: of its declaration.
        fields: by name.
        body: what it makes its nodes of; empty for an EXTERNPROTO.
        urls: where an EXTERNPROTO's PROTO stands.
    """

    name: str
    line: int
    fields: dict[str, Field] = field(default_factory=dict)
    body: list[Node] = field(default_factory=list)
    urls: tuple[str, ...] = ()


@dataclass(eq=False)
class Node:
    """A node.

    Attributes:
        kind: its type, `Transform`.
        line: of its type.
        name: that DEF gives it; empty for none.
        fields: values by name.
        proto: that declares its kind; None for X3D's own.
    """

    kind: str
    line: int
    name: str = ""
    fields: dict[str, Value] = field(default_factory=dict)
    proto: Proto | None = None

    @property
    def label(self) -> str:
        """How messages call it."""
        return self.name or self.kind

    def value(self, name: str) -> Value | None:
        """The value of a field, or its PROTO's default; None where there is neither."""
        if name in self.fields:
            return self.fields[name]
        declared = None if self.proto is None else self.proto.fields.get(name)
        return None if declared is None else declared.value


@dataclass(frozen=True)
class Route:
    """`ROUTE node.event TO node.event`."""

    origin: str
    event: str
    target: str
    input: str
    line: int


@dataclass(eq=False)
class Document:
    """What a file holds.

    Attributes:
        path: of the file.
        nodes: at its top.
        routes: all but those inside PROTOs.
        names: nodes by the names that DEF gives them.
        protos: PROTOs and EXTERNPROTOs by name.
    """

    path: Path
    nodes: list[Node] = field(default_factory=list)
    routes: list[Route] = field(default_factory=list)
    names: dict[str, Node] = field(default_factory=dict)
    protos: dict[str, Proto] = field(default_factory=dict)


class Problems:
    """Collects what is wrong in a file."""

    def __init__(self, path: Path, found: list[Problem] | None = None) -> None:
        self.path = path
        self.found: list[Problem] = [] if found is None else found

    def of(self, path: Path) -> Problems:
        """Collects those of another file among these."""
        return Problems(path, self.found)

    def add(self, key: str, message: str, line: int | None) -> None:
        """Adds one."""
        self.found.append(Problem(key, message, str(self.path), line))

    @contextmanager
    def told(self, key: str, line: int) -> Iterator[None]:
        """Adds what a ValueError inside says."""
        try:
            yield
        except ValueError as error:
            self.add(key, str(error), line)

    def raise_all(self) -> None:
        """Raises DeclarationError where there are any, of many the first ones."""
        if not self.found:
            return
        different = dict.fromkeys(self.found)
        left = len(different) - _MOST_PROBLEMS
        shown = sorted(different, key=lambda each: each.line or 0)[:_MOST_PROBLEMS]
        if left > 0:
            shown.append(Problem("", f"and {left} more", str(self.path)))
        raise DeclarationError(shown)


def read_document(path: Path) -> Document:
    """Reads a file of VRML97, or of X3D in the classic encoding; it may be packed by gzip.

    Raises:
        DeclarationError: all that is wrong with it, with lines.
    """
    return parse_document(_read_text(path), path)


def _read_text(path: Path) -> str:
    def wrong(message: str) -> DeclarationError:
        return DeclarationError([Problem("", message, str(path))])

    too_long = f"expected at most {MOST_BYTES / 1e6:g} MB"
    try:
        contents = read_file(path, MOST_BYTES)
    except FileNotFoundError:
        raise wrong("no such file") from None
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise wrong(f"cannot be read: {error}") from error
    if contents.startswith(_GZIP):
        unpacked = zlib.decompressobj(wbits=31)
        try:
            contents = unpacked.decompress(contents, MOST_BYTES)
        except zlib.error as error:
            raise wrong(f"is packed by gzip, and damaged: {error}") from None
        if unpacked.unconsumed_tail:
            raise wrong(f"is packed by gzip, and longer than it may be: {too_long}")
        if not unpacked.eof:
            raise wrong("is packed by gzip, and ends too soon")
    text = contents.decode("utf-8-sig", errors="replace")
    start = text[:400].lstrip()
    if _HEADER.match(start):
        return text
    raise wrong(_what_else(start))


def _what_else(start: str) -> str:
    """What a file is that has not the header of one of these."""
    expected = "expected a first line #X3D V3.0 utf8 or #VRML V2.0 utf8"
    if re.match(r"<\?xml|<!DOCTYPE X3D|<X3D", start):
        return f"is X3D in the XML encoding; {expected} (X3D's classic encoding)"
    if start.startswith(("#VRML V1", "#Inventor")):
        return f"is {' '.join(start.split()[:2])[1:]}, which is older than VRML97; {expected}"
    if not start:
        return f"is empty; {expected}"
    return f"begins with {reprlib.repr(start.splitlines()[0])}; {expected}"


def parse_document(text: str, path: Path) -> Document:
    """Parses a text; the first line need not be the header.

    Raises:
        DeclarationError: all that is wrong with it, with lines of `path`.
    """
    parser = _Parser(text, path)
    document = parser.document()
    parser.problems.raise_all()
    return document


class _Token(NamedTuple):
    kind: str  # number, numbers, text, name, mark, other, end
    text: str
    line: int
    numbers: Array | None = None  # of a whole list


class _TooMuch(Exception):
    """There is more than is read of any file; it has been told."""


class _Scope:
    """What names mean: in the document, or in the body of a PROTO."""

    def __init__(self, protos: dict[str, Proto]) -> None:
        self.names: dict[str, Node] = {}
        self.open: list[Node] = []  # those with a name around what is being read
        self.protos = protos
        self.routes: list[Route] = []


class _Parser:
    """Reads tokens into nodes, and goes on behind what is wrong."""

    def __init__(self, text: str, path: Path) -> None:
        self.problems = Problems(path)
        self._tokens = self._scan(text)
        self._depth = 0
        # After a mistake nothing more is told until something is right again.
        self._is_lost = False
        self._scope = _Scope({})
        self._token = _Token("mark", "", 1)
        self._next()

    def document(self) -> Document:
        nodes: list[Node] = []
        try:
            while self._token.kind != "end":
                self._statement(nodes)
        except _TooMuch:
            pass
        scope = self._scope
        return Document(self.problems.path, nodes, scope.routes, scope.names, scope.protos)

    # Tokens.

    def _scan(self, text: str) -> Iterator[_Token]:
        position, line, count = 0, 1, 0
        while position < len(text):
            count += 1
            if text[position] == "[":
                end, numbers = _numbers(text, position + 1)
                if numbers is not None:
                    yield _Token("numbers", "[", line, numbers)
                    line += text.count("\n", position, end)
                    position = end + 1
                    continue
            found = _TOKEN.match(text, position)
            assert found is not None and found.lastgroup is not None  # `other` takes all
            word = found.group()
            if found.lastgroup != "space":
                yield _Token(found.lastgroup, word, line)
            line += word.count("\n")
            position = found.end()
            if count > _MOST_TOKENS:
                message = f"has more than {_MOST_TOKENS:,} words; nothing as long is read"
                self.problems.add("", message, line)
                raise _TooMuch
        while True:
            yield _Token("end", "the end of the file", line)

    def _next(self) -> _Token:
        """Goes on, and returns the token that was there."""
        token = self._token
        self._token = next(self._tokens)
        return token

    def _wrong(self, expected: str, token: _Token | None = None, key: str = "") -> None:
        """Tells that something else was found than expected."""
        token = token or self._token
        shown = token.text if token.kind == "end" else reprlib.repr(token.text)
        if token.kind == "text":
            shown = reprlib.repr(token.text[1:-1])
        if token.text[:1] in ("“", "”", "„"):
            expected += ' (quotes are ")'
        elif token.text == '"':
            shown = 'a " that is not closed'
        self._tell(f"found {shown}; expected {expected}", token.line, key)

    def _tell(self, message: str, line: int, key: str = "") -> None:
        if not self._is_lost:
            self.problems.add(key, message, line)
        self._is_lost = True

    def _takes(self, mark: str) -> bool:
        """Whether this mark is there; if so goes on."""
        is_it = self._token.kind == "mark" and self._token.text == mark
        if is_it:
            self._next()
        return is_it

    def _name(self, what: str) -> str | None:
        """A name; None, and told, where there is none."""
        if self._token.kind == "name":
            return self._next().text
        self._wrong(what)
        return None

    @contextmanager
    def _deeper(self) -> Iterator[None]:
        self._depth += 1
        if self._depth > _MOST_DEPTH:
            message = f"nodes inside nodes are deeper than {_MOST_DEPTH}; nothing as deep is read"
            self._is_lost = False
            self._tell(message, self._token.line)
            raise _TooMuch
        yield
        self._depth -= 1

    # Statements.

    def _statement(self, nodes: list[Node]) -> None:
        """Reads one statement of the top of a file or of a PROTO's body."""
        token = self._token
        if token.kind == "name" and token.text in ("PROTO", "EXTERNPROTO", "ROUTE"):
            self._declaration()
        elif token.kind == "name" and token.text in _SKIPPED:
            self._next()
            for _ in range(_SKIPPED[token.text]):
                if self._token.kind in ("name", "text", "number", "other"):
                    self._next()
        elif token.kind == "name":
            node = self._node()
            if node is not None:
                nodes.append(node)
                self._is_lost = False
        else:
            self._wrong("a node, PROTO, EXTERNPROTO or ROUTE")
            self._skip()

    def _skip(self) -> None:
        """Goes past what is not understood, as a whole where it is in brackets."""
        opened = 0
        while self._token.kind != "end":
            token = self._next()
            if token.kind == "mark":
                opened += (token.text in "[{") - (token.text in "]}")
            if opened <= 0:
                return

    def _declaration(self) -> None:
        word = self._token.text
        if word == "ROUTE":
            self._route()
        elif word == "PROTO":
            self._proto()
        else:
            self._extern_proto()

    def _route(self) -> None:
        line = self._next().line
        ends: list[str] = []
        for word in ("", "TO"):
            if word and self._token.text != word:
                self._wrong("ROUTE node.event TO node.event")
                return
            if word:
                self._next()
            for dot in ("", "."):
                if dot and not self._takes(dot):
                    self._wrong("ROUTE node.event TO node.event")
                    return
                name = self._name("ROUTE node.event TO node.event")
                if name is None:
                    return
                ends.append(name)
        self._scope.routes.append(Route(ends[0], ends[1], ends[2], ends[3], line))
        self._is_lost = False

    def _proto(self) -> None:
        self._next()
        line = self._token.line
        name = self._name("the name of a PROTO")
        proto = Proto(name or "", line)
        proto.fields = self._interface()
        outside, self._scope = self._scope, _Scope(dict(self._scope.protos))
        if not self._takes("{"):
            self._wrong(f"{{ and the body of PROTO {proto.name}")
        else:
            with self._deeper():
                while not self._takes("}"):
                    if self._token.kind == "end":
                        self._tell(f"the {{ of PROTO {proto.name} is not closed", line)
                        break
                    self._statement(proto.body)
        self._scope = outside
        if name is not None:
            self._scope.protos[name] = proto

    def _extern_proto(self) -> None:
        self._next()
        line = self._token.line
        name = self._name("the name of an EXTERNPROTO")
        fields = self._interface(has_values=False)
        value = self._value(f"EXTERNPROTO {name}")
        urls = () if value is None else tuple(each for each in value.items if is_text(each))
        if not urls:
            self._wrong(f'the address of EXTERNPROTO {name}, as in "PROTO_{name}.wrl"')
        if name is not None:
            self._scope.protos[name] = Proto(name, line, fields, urls=urls)
            self._is_lost = False

    def _interface(self, *, has_values: bool = True) -> dict[str, Field]:
        fields: dict[str, Field] = {}
        if self._token.numbers is not None and not self._token.numbers.size:
            self._next()  # an empty list
            return fields
        if not self._takes("["):
            self._wrong("[ and the fields of the PROTO")
            return fields
        while not self._takes("]"):
            token = self._token
            if token.kind == "end" or (token.kind == "mark" and token.text in "{}"):
                self._wrong("] behind the fields of the PROTO")
                break
            if not self._is_interface():
                known = [*_ACCESS, *_ACCESS.values()]
                self._wrong(f"{', '.join(_ACCESS)}{did_you_mean(token.text, known)}")
                self._skip()
                continue
            self._field(fields, has_values=has_values)
        return fields

    def _is_interface(self) -> bool:
        text = self._token.text
        return self._token.kind == "name" and (text in _ACCESS or text in _ACCESS.values())

    def _field(self, fields: dict[str, Field], *, has_values: bool) -> str | None:
        """Reads the declaration of a field; its value is that of `fields` afterwards."""
        token = self._next()
        access = _ACCESS.get(token.text, token.text)
        kind, line = self._token.text, self._token.line
        if self._name("a type such as SFFloat") is None:
            return None
        if kind not in TYPES:
            self._tell(f"no type '{kind}'{did_you_mean(kind, TYPES)}", line)
            return None
        name = self._name("the name of the field")
        if name is None:
            return None
        value = None
        if has_values and (access in _WITH_VALUE or self._token.text == "IS"):
            value = self._value(name)
            if value is not None and not isinstance(_first(value), Is):
                with self.problems.told(name, line):
                    read_field(value, kind)
        fields[name] = Field(access, kind, value, line)
        self._is_lost = False
        return name

    # Nodes and values.

    def _node(self) -> Node | None:
        """Reads `DEF name Type { ... }`, `USE name` or `NULL`; None for no node."""
        token = self._next()
        name = ""
        if token.text == "NULL":
            return None
        if token.text == "USE":
            return self._used()
        if token.text == "DEF":
            name = self._name("a name behind DEF") or ""
            token = self._token
            if self._name("the type of a node") is None:
                return None
        if not (self._token.kind == "mark" and self._token.text == "{"):
            self._wrong(f"{{ behind {token.text}")
            return None
        node = Node(token.text, token.line, name, proto=self._scope.protos.get(token.text))
        if name:
            self._scope.names[name] = node
        self._scope.open.append(node)
        with self._deeper():
            self._body(node)
        self._scope.open.pop()
        return node

    def _used(self) -> Node | None:
        line = self._token.line
        name = self._name("a name behind USE")
        if name is None:
            return None
        node = self._scope.names.get(name)
        if node is None:
            near = did_you_mean(name, self._scope.names)
            self.problems.add("", f"USE {name}: no node has this name above here{near}", line)
        elif node in self._scope.open:
            # A script may refer to a node around it; it is not drawn as a part of it.
            if all(each.kind != "Script" for each in self._scope.open):
                self.problems.add("", f"USE {name}: the node would be inside itself", line)
            return None
        return node

    def _body(self, node: Node) -> None:
        self._next()
        while not self._takes("}"):
            token = self._token
            if token.kind == "end":
                self._is_lost = False
                self._tell(f"the {{ of {node.label} is not closed", node.line)
                return
            if token.kind != "name":
                self._wrong(f"a field of {node.label}, or }}", key=node.label)
                self._skip()
            elif token.text in ("PROTO", "EXTERNPROTO", "ROUTE"):
                self._declaration()
            elif self._is_interface():
                declared: dict[str, Field] = {}
                name = self._field(declared, has_values=True)
                value = declared[name].value if name is not None else None
                if name is not None and value is not None:
                    node.fields[name] = value
            else:
                self._next()
                key = f"{node.label}.{token.text}"
                value = self._value(key)
                if value is not None and token.text in node.fields:
                    self._tell("stands there twice", token.line, key)
                elif value is not None:
                    node.fields[token.text] = value
                    self._is_lost = False

    def _value(self, key: str) -> Value | None:
        """Reads the value of a field; None, and told, where there is none."""
        token = self._token
        if token.kind == "numbers":
            self._next()
            assert token.numbers is not None
            return Value(token.numbers, token.line)
        if token.text == "IS" and token.kind == "name":
            self._next()
            name = self._name("the name of a field behind IS")
            return None if name is None else Value((Is(name),), token.line)
        items: list[Any] = []
        if self._takes("["):
            while not self._takes("]"):
                if self._token.kind == "end" or (
                    self._token.kind == "mark" and self._token.text in "{}"
                ):
                    self._wrong("] behind the values", key=key)
                    break
                if not self._item(items):
                    self._wrong("a value", key=key)
                    self._skip()
            return Value(items, token.line)
        if not self._item(items):
            self._wrong("its value", key=key)
            return None
        if not isinstance(items[-1] if items else None, Node):
            # Several numbers, or texts without brackets, end where a name is.
            while self._token.kind in ("number", "text") and self._item(items):
                pass
        return Value(items, token.line)

    def _item(self, items: list[Any]) -> bool:
        """Reads one value; whether there was one."""
        token = self._token
        if token.kind == "number":
            self._next()
            is_hex = token.text[:2] in ("0x", "0X")
            items.append(float(int(token.text, 16)) if is_hex else float(token.text))
        elif token.kind == "text":
            self._next()
            items.append(_ESCAPED.sub(r"\1", token.text[1:-1]))
        elif token.kind == "name" and token.text in ("TRUE", "FALSE"):
            self._next()
            items.append(token.text == "TRUE")
        elif token.kind == "name":
            node = self._node()
            if node is not None or token.text == "NULL":
                items.append(node)
            # What could not be read has been told.
        else:
            return False
        return True


# Statements of X3D that say nothing about what is drawn, and how many words follow them.
_SKIPPED = {"PROFILE": 1, "COMPONENT": 1, "META": 2, "UNIT": 3, "EXPORT": 1, "IMPORT": 1}


def _numbers(text: str, begin: int) -> tuple[int, Array | None]:
    """Where a list ends that holds nothing but numbers, and these; None for any other."""
    found = _NUMBERS.match(text, begin)
    end = begin if found is None else found.end()
    if not text.startswith("]", end):
        return end, None
    try:
        return end, np.array(text[begin:end].replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        return end, None


def instance(node: Node) -> Node | None:
    """The node that a PROTO of the same file makes of one of its own; None for one without body."""
    if node.proto is None or not node.proto.body:
        return None
    made: dict[int, Node] = {}

    def copy(of: Node) -> Node:
        if id(of) in made:
            return made[id(of)]
        new = made[id(of)] = Node(of.kind, of.line, of.name, proto=of.proto)
        for name, value in of.fields.items():
            given = _first(value)
            bound = node.value(given.name) if isinstance(given, Is) else value
            if bound is not None:
                new.fields[name] = bound if bound is not value else copied(value)
        return new

    def copied(value: Value) -> Value:
        if isinstance(value.items, np.ndarray):
            return value
        items = [copy(item) if isinstance(item, Node) else item for item in value.items]
        return Value(items, value.line)

    return copy(node.proto.body[0])


def _first(value: Value) -> Any:
    return value.items[0] if len(value.items) else None


def is_text(item: Any) -> bool:
    """Whether an item of a value is a text."""
    return isinstance(item, str)


def read_field(value: Value, kind: str) -> Any:
    """Takes a value as one of a type; with and without brackets.

    Args:
        value: as it stands.
        kind: `SFFloat`, `MFVec3f`, ...

    Returns:
        bool, int, float, str, `Node` or None for SFBool, SFInt32, SFFloat, SFString and SFNode; an
        array (w,) for what has w numbers; for MF a list of texts, nodes, or true and false, an
        array (k,) or (k, w) else. Matrices as their numbers stand.

    Raises:
        ValueError: it is none; says what was found and expected.
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
                raise ValueError(f"found {numbers.size} numbers; expected {width} for each entry")
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
        "String": ((str,), 'a text in quotes, "..."'),
        "Node": ((Node, type(None)), "a node"),
    }
    right, expected = types[base]
    if not all(isinstance(item, right) for item in items):
        plural = {"Bool": "TRUE or FALSE", "String": 'texts in quotes, "..."', "Node": "nodes"}
        raise ValueError(f"found {_shown(items)}; expected {plural[base] if many else expected}")
    if many:
        return [item for item in items if item is not None]
    if len(items) != 1:
        raise ValueError(f"found {len(items)} values; expected {expected}")
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
    """A value for messages."""
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


def walk(nodes: Sequence[Node], most: int = 200_000) -> Iterator[Node]:
    """Yields every node once, those inside it behind it; not those of PROTOs' bodies.

    Args:
        nodes: to begin with.
        most: how many are told at most.
    """
    todo, seen = list(reversed(nodes)), set[int]()
    while todo and len(seen) < most:
        node = todo.pop()
        if id(node) in seen:
            continue
        seen.add(id(node))
        yield node
        inner = [
            item
            for value in node.fields.values()
            if not isinstance(value.items, np.ndarray)
            for item in value.items
            if isinstance(item, Node)
        ]
        todo += reversed(inner)
