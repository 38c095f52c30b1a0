"""Parses XML safely, even if its origin is unknown."""

from __future__ import annotations

import codecs
import re
from typing import Any, TypeAlias

from lxml import etree

Element: TypeAlias = Any  # lxml has no types
_MAX_HEAD = 100_000  # number of bytes in which the first element must begin
_NO_ELEMENT = re.compile(rb"<!--.*?-->|<\?.*?\?>|<!.*?>", re.DOTALL)
_ELEMENT = re.compile(rb"<([A-Za-z_][\w.-]*)")
# Text that is valid before the first element, and tolerated before the XML declaration.
_BEFORE = rb"\s|\xef\xbb\xbf|<!--(?>.*?-->)"
_DECLARATION = re.compile(rb"((?>%b)*+)(<\?xml\s[^>]*?\?>)" % _BEFORE, re.DOTALL)
_VERSION = re.compile(rb"version\s*=\s*[\"']1\.")
_STATED = re.compile(rb"(?:\xef\xbb\xbf)?<\?xml\s[^>]*?encoding\s*=\s*[\"']([\w.-]+)")
_ENCODING = re.compile(rb"encoding\s*=\s*[\"']([\w.-]+)")
_ROOT = re.compile(
    rb"(?>\s|\xef\xbb\xbf|<!--(?>.*?-->)|<\?(?>.*?\?>))*+<[A-Za-z_][^\s/>]*", re.DOTALL
)
_PREFIX = re.compile(rb"[<\s]([A-Za-z_][\w.-]*):[A-Za-z_][\w.-]*(?=[\s=/>])")
_MAX_PREFIXES = 100


class XmlError(ValueError):
    """Raised for invalid XML. `reasons` contains pairs of line number (or None) and message."""

    def __init__(self, reasons: list[tuple[int | None, str]]) -> None:
        self.reasons = reasons
        super().__init__("; ".join(reason for _, reason in reasons))


def first_element(head: bytes) -> str | None:
    """Returns the name of the first XML element in `head`, or None if there is no element."""
    found = _ELEMENT.search(_NO_ELEMENT.sub(b"", head))
    return None if found is None else found[1].decode()


def parse_xml(contents: bytes, encoding: str | None = None) -> Element:
    """Returns the root element of XML contents. Raises XmlError if the XML is invalid.

    Entity declarations are rejected, because they can expand a few bytes to gigabytes or insert
    other files. The network is not used. `encoding` overrides the declared encoding.
    """
    stated = None
    if encoding is None and (found := _STATED.match(contents)) is not None:
        stated = found[1].decode()
    known = None if (name := encoding or stated) is None else _known(name)
    encoding = None if known == stated else known  # lxml uses a declared encoding that it knows.
    try:
        parser = etree.XMLParser(
            resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False,
            recover=False, remove_comments=True, remove_pis=True, encoding=encoding,
        )  # fmt: skip
    except LookupError:
        raise XmlError([(None, f"the encoding '{encoding}' is unknown")]) from None
    try:
        root = etree.fromstring(contents, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        log = [(entry.line, _plain(entry.message)) for entry in parser.error_log]
        raise XmlError([*dict.fromkeys(log)] or [(None, str(error) or "it is empty")]) from None
    declared = root.getroottree().docinfo.internalDTD
    if declared is not None and (entities := list(declared.iterentities())):
        names = ", ".join(f"'{entity.name}'" for entity in entities[:3])
        raise XmlError([(None, f"it declares entities ({names}); expected no entity declarations")])
    return root


def _known(encoding: str) -> str:
    try:
        etree.XMLParser(encoding=encoding)
    except LookupError:
        try:
            return codecs.lookup(encoding).name
        except LookupError:
            return encoding
    return encoding


def parse_loose_xml(contents: bytes) -> tuple[Element, list[str]]:
    """Parses XML like `parse_xml`, but corrects two kinds of errors and returns warnings.

    The errors are undeclared prefixes, and an XML declaration that has an unknown version or is not
    at the start. The corrections do not change line numbers.
    """
    try:
        return parse_xml(contents), []
    except XmlError as error:
        first = error
    warnings: list[str] = []
    encoding = None
    found = _DECLARATION.match(contents[:_MAX_HEAD])
    is_first = found is not None and not found[1].strip(b"\xef\xbb\xbf")
    if found is not None and not (is_first and _VERSION.search(found[2])):
        stated = _ENCODING.search(found[2])
        encoding = None if stated is None else stated[1].decode()
        blank = re.sub(rb"[^\n]", b" ", found[2])
        contents = contents[: found.start(2)] + blank + contents[found.end(2) :]
        warnings.append(f"the invalid XML declaration is ignored: {_shown(found[2])}")
    root = _ROOT.match(contents)
    if root is not None:
        tag = contents[root.end() : contents.find(b">", root.end())]
        known = {b"xml", b"xmlns", *re.findall(rb"xmlns:([\w.-]+)", tag)}
        unknown = sorted({*_PREFIX.findall(contents)} - known)
        if 0 < len(unknown) <= _MAX_PREFIXES:
            added = b"".join(b' xmlns:%b="%b"' % (each, each) for each in unknown)
            contents = contents[: root.end()] + added + contents[root.end() :]
            warnings.append(f"undeclared prefixes: {_shown(b', '.join(unknown))}")
    if not warnings:
        raise first
    return parse_xml(contents, encoding), warnings


def _shown(text: bytes) -> str:
    return text.decode(errors="replace")[:100]


def _plain(message: str) -> str:
    if "amplification" in message:
        return "declares entities that expand without limit; expected no such entities"
    return message.partition(", use XML_PARSE_HUGE")[0].strip()
