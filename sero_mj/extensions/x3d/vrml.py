"""Parses the classic VRML syntax of VRML97 and X3D's classic encoding.

Sources: ISO/IEC 14772-1 (VRML97), annex A; ISO/IEC 19776-2 (X3D's classic VRML encoding).
"""

from __future__ import annotations

import re
import reprlib
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...base.errors import DeclarationError, Problem, did_you_mean
from ...base.frames import Array
from ...base.paths import read_file
from .vrml_nodes import (
    TYPES,
    Document,
    Field,
    FieldValue,
    Is,
    Node,
    Problems,
    Proto,
    RouteStatement,
    first,
    read_field,
)

MAX_BYTES = 50_000_000  # maximum size of an uncompressed file, with about a million triangles
_MAX_TOKENS = 2_000_000  # maximum number of tokens; a list of numbers is one token
_MAX_DEPTH = 120  # maximum depth of nested nodes; each level needs several function calls
_GZIP = b"\x1f\x8b"
_HEADER = re.compile(r"#(?:X3D V\d+\.\d+|VRML V2\.0)\b")
_OLDER = ("#VRML V1", "#Inventor")
# Inlined files often have no header.
_HEADLESS = re.compile(r"(?:#[^\n]*\n\s*)*(?:(?:DEF\s+\S+\s+)?[A-Z]\w*\s*\{|(?:EXTERN)?PROTO\s)")
# In text copied from papers or editors, these characters at the end of a line mark a wrapped line.
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


def read_document(path: Path) -> Document:
    """Reads a VRML97 file or an X3D file in the classic encoding, which may be gzip-compressed.

    Raises:
        DeclarationError: the file has errors. The message lists all errors and their lines.
    """
    return parse_document(_read_text(path), path)


def _read_text(path: Path) -> str:
    def invalid(message: str) -> DeclarationError:
        return Problem("", message, str(path)).error()

    limit = f"expected at most {MAX_BYTES / 1e6:g} MB"
    try:
        contents = read_file(path, MAX_BYTES)
    except FileNotFoundError:
        raise invalid("no such file") from None
    except OSError as error:
        raise invalid(f"cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise invalid(f"cannot be read: {error}") from error
    if contents.startswith(_GZIP):
        unpacked = zlib.decompressobj(wbits=31)
        try:
            contents = unpacked.decompress(contents, MAX_BYTES)
        except zlib.error as error:
            raise invalid(f"is a damaged gzip file: {error}") from None
        if unpacked.unconsumed_tail:
            raise invalid(f"is a gzip file with contents that are too large; {limit}")
        if not unpacked.eof:
            raise invalid("is a truncated gzip file")
    text = contents.decode("utf-8-sig", errors="replace")
    start = text[:400].lstrip()
    is_older = start.startswith(_OLDER)
    if not is_older and (_HEADER.match(start) or _HEADLESS.match(start)):
        return text
    raise invalid(_describe_start(start))


def _describe_start(start: str) -> str:
    expected = "expected the first line `#X3D V3.0 utf8` or `#VRML V2.0 utf8`"
    if re.match(r"<\?xml|<!DOCTYPE X3D|<X3D", start):
        return f"is X3D in the XML encoding; {expected} (X3D's classic encoding)"
    if start.startswith(_OLDER):
        return f"is {' '.join(start.split()[:2])[1:]}, which precedes VRML97; {expected}"
    if not start:
        return f"is empty; {expected}"
    return f"begins with {reprlib.repr(start.splitlines()[0])}; {expected}"


def parse_document(text: str, path: Path) -> Document:
    """Parses VRML text with an optional header. Raises DeclarationError with all errors."""
    parser = _VrmlParser(text, path)
    document = parser.document()
    parser.problems.raise_all()
    return document


class _Token(NamedTuple):
    kind: str  # number, numbers, text, name, mark, other or end
    text: str
    line: int
    numbers: Array | None = None  # values of a token of the kind `numbers`


class _TooMuch(Exception):
    """Ends parsing after an error about an exceeded limit has been collected."""


class _NameScope:
    def __init__(self, protos: dict[str, Proto]) -> None:
        self.names: dict[str, Node] = {}
        self.open: list[Node] = []  # named nodes that enclose the current one
        self.protos = protos
        self.routes: list[RouteStatement] = []


class _VrmlParser:
    def __init__(self, text: str, path: Path) -> None:
        self.problems = Problems(path)
        self._tokens = self._scan(text)
        self._depth = 0
        # After an error, other errors are not reported until a statement or field is valid again.
        self._is_lost = False
        self._errors = 0  # number of reported and unreported errors
        self._scope = _NameScope({})
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
            assert found is not None and found.lastgroup is not None  # `other` matches all text.
            word = found.group()
            if found.lastgroup != "space":
                yield _Token(found.lastgroup, word, line)
            line += word.count("\n")
            position = found.end()
            if count > _MAX_TOKENS:
                message = f"has more than {_MAX_TOKENS:,} words; expected fewer words"
                self.problems.add("", message, line)
                raise _TooMuch
        while True:
            yield _Token("end", "the end of the file", line)

    def _next(self) -> _Token:
        token = self._token
        self._token = next(self._tokens)
        return token

    def _unexpected(self, expected: str, token: _Token | None = None, key: str = "") -> None:
        token = token or self._token
        shown = token.text if token.kind == "end" else reprlib.repr(token.text)
        if token.kind == "text":
            shown = reprlib.repr(token.text[1:-1])
        if token.text[:1] in ("“", "”", "„"):
            expected += ' (use " as quotation mark)'
        elif token.text == '"':
            shown = 'an unclosed "'
        self._report(f"found {shown}; expected {expected}", token.line, key)

    def _report(self, message: str, line: int, key: str = "") -> None:
        if not self._is_lost:
            self.problems.add(key, message, line)
        self._is_lost = True
        self._errors += 1

    def _takes(self, mark: str) -> bool:
        is_it = self._token.kind == "mark" and self._token.text == mark
        if is_it:
            self._next()
        return is_it

    def _name(self, what: str) -> str | None:
        if self._token.kind == "name":
            return self._next().text
        self._unexpected(what)
        return None

    @contextmanager
    def _deeper(self) -> Iterator[None]:
        self._depth += 1
        if self._depth > _MAX_DEPTH:
            message = f"nodes are nested more than {_MAX_DEPTH} levels deep; expected fewer levels"
            self._is_lost = False
            self._report(message, self._token.line)
            raise _TooMuch
        yield
        self._depth -= 1

    # Statements.

    def _statement(self, nodes: list[Node]) -> None:
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
            self._unexpected("a node, PROTO, EXTERNPROTO or ROUTE")
            self._skip()

    def _skip(self) -> None:
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
                self._unexpected("ROUTE node.event TO node.event")
                return
            if word:
                self._next()
            for dot in ("", "."):
                if dot and not self._takes(dot):
                    self._unexpected("ROUTE node.event TO node.event")
                    return
                name = self._name("ROUTE node.event TO node.event")
                if name is None:
                    return
                ends.append(name)
        self._scope.routes.append(RouteStatement(ends[0], ends[1], ends[2], ends[3], line))
        self._is_lost = False

    def _proto(self) -> None:
        self._next()
        line = self._token.line
        name = self._name("the name of a PROTO")
        proto = Proto(name or "", line)
        proto.fields = self._interface()
        outside, self._scope = self._scope, _NameScope(dict(self._scope.protos))
        if not self._takes("{"):
            self._unexpected(f"{{ and the body of PROTO {proto.name}")
        else:
            with self._deeper():
                while not self._takes("}"):
                    if self._token.kind == "end":
                        self._report(f"the {{ of PROTO {proto.name} is not closed", line)
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
        urls = () if value is None else tuple(each for each in value.items if isinstance(each, str))
        if not urls:
            self._unexpected(f'the URL of EXTERNPROTO {name}, such as "PROTO_{name}.wrl"')
        if name is not None:
            self._scope.protos[name] = Proto(name, line, fields, urls=urls)
            self._is_lost = False

    def _interface(self, *, has_values: bool = True) -> dict[str, Field]:
        fields: dict[str, Field] = {}
        if self._token.numbers is not None and not self._token.numbers.size:
            self._next()  # [ ] without fields
            return fields
        if not self._takes("["):
            self._unexpected("[ and the fields of the PROTO")
            return fields
        while not self._takes("]"):
            token = self._token
            if token.kind == "end" or (token.kind == "mark" and token.text in "{}"):
                self._unexpected("] after the fields of the PROTO")
                break
            if not self._is_interface():
                known = [*_ACCESS, *_ACCESS.values()]
                self._unexpected(f"{', '.join(_ACCESS)}{did_you_mean(token.text, known)}")
                self._skip()
                continue
            self._field(fields, has_values=has_values)
        return fields

    def _is_interface(self) -> bool:
        text = self._token.text
        return self._token.kind == "name" and (text in _ACCESS or text in _ACCESS.values())

    def _field(self, fields: dict[str, Field], *, has_values: bool) -> str | None:
        token = self._next()
        access = _ACCESS.get(token.text, token.text)
        kind, line = self._token.text, self._token.line
        if self._name("a type such as SFFloat") is None:
            return None
        if kind not in TYPES:
            self._report(f"no type '{kind}'{did_you_mean(kind, TYPES)}", line)
            return None
        name = self._name("the name of the field")
        if name is None:
            return None
        value = None
        if has_values and (access in _WITH_VALUE or self._token.text == "IS"):
            value = self._value(name)
            if value is not None and not isinstance(first(value), Is):
                with self.problems.collect(name, line):
                    read_field(value, kind)
        fields[name] = Field(access, kind, value, line)
        self._is_lost = False
        return name

    # Nodes and values.

    def _node(self) -> Node | None:
        token = self._next()
        name = ""
        if token.text == "NULL":
            return None
        if token.text == "USE":
            return self._used()
        if token.text == "DEF":
            name = self._name("a name after DEF") or ""
            token = self._token
            if self._name("the type of a node") is None:
                return None
        if not (self._token.kind == "mark" and self._token.text == "{"):
            self._unexpected(f"{{ after {token.text}")
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
        name = self._name("a name after USE")
        if name is None:
            return None
        node = self._scope.names.get(name)
        if node is None:
            near = did_you_mean(name, self._scope.names)
            self.problems.add("", f"USE {name}: no preceding node has this name{near}", line)
        elif node in self._scope.open:
            # A Script may refer to an enclosing node without drawing it.
            if all(each.kind != "Script" for each in self._scope.open):
                self.problems.add("", f"USE {name}: the node would contain itself", line)
            return None
        return node

    def _body(self, node: Node) -> None:
        self._next()
        while not self._takes("}"):
            token = self._token
            if token.kind == "end":
                self._is_lost = False
                self._report(f"the {{ of {node.label} is not closed", node.line)
                return
            if token.kind != "name":
                self._unexpected(f"a field of {node.label}, or }}", key=node.label)
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
                key, before = f"{node.label}.{token.text}", self._errors
                value = self._value(key)
                if value is not None and token.text in node.fields:
                    self._report("is set twice", token.line, key)
                elif value is not None:
                    node.fields[token.text] = value
                    self._is_lost &= self._errors > before

    def _value(self, key: str) -> FieldValue | None:
        token = self._token
        if token.kind == "numbers":
            self._next()
            assert token.numbers is not None
            return FieldValue(token.numbers, token.line)
        if token.text == "IS" and token.kind == "name":
            self._next()
            name = self._name("the name of a field after IS")
            return None if name is None else FieldValue((Is(name),), token.line)
        items: list[Any] = []
        if self._takes("["):
            while not self._takes("]"):
                if self._token.kind == "end" or (
                    self._token.kind == "mark" and self._token.text in "{}"
                ):
                    self._unexpected("] after the values", key=key)
                    break
                if not self._item(items):
                    self._unexpected("a value", key=key)
                    self._skip()
            return FieldValue(items, token.line)
        if not self._item(items):
            self._unexpected("its value", key=key)
            return None
        if not isinstance(items[-1] if items else None, Node):
            # Numbers or strings without brackets end at the next name.
            while self._token.kind in ("number", "text") and self._item(items):
                pass
        return FieldValue(items, token.line)

    def _item(self, items: list[Any]) -> bool:
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
        else:
            return False
        return True


# These statements of X3D are ignored. The numbers are the words after each statement.
_SKIPPED = {"PROFILE": 1, "COMPONENT": 1, "META": 2, "UNIT": 3, "EXPORT": 1, "IMPORT": 1}


def _numbers(text: str, begin: int) -> tuple[int, Array | None]:
    found = _NUMBERS.match(text, begin)
    end = begin if found is None else found.end()
    if not text.startswith("]", end):
        return end, None
    try:
        return end, np.array(text[begin:end].replace(",", " ").split(), dtype=np.float64)
    except ValueError:
        return end, None
