"""XML of others, read without what is dangerous in it."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, TypeAlias

from lxml import etree

from ..paths import open_file

Element: TypeAlias = Any  # lxml has no types
_MOST_HEAD = 100_000  # bytes in which a file's first element begins
_NO_ELEMENT = re.compile(rb"<!--.*?-->|<\?.*?\?>|<!.*?>", re.DOTALL)
_ELEMENT = re.compile(rb"<([A-Za-z_][\w.-]*)")


class XmlError(ValueError):
    """XML that cannot be read; `reasons` are pairs of a line, or None, and what is wrong there."""

    def __init__(self, reasons: list[tuple[int | None, str]]) -> None:
        self.reasons = reasons
        super().__init__("; ".join(reason for _, reason in reasons))


def root_name(path: Path) -> str | None:
    """Returns the name of a file's first element; None for a file that cannot be read."""
    try:
        with open_file(path) as file:
            head = file.read(_MOST_HEAD)
    except (OSError, ValueError):
        return None
    found = _ELEMENT.search(_NO_ELEMENT.sub(b"", head))
    return None if found is None else found[1].decode()


def parse_xml(contents: bytes) -> Element:
    """Returns the root element; its descendants know their lines (`sourceline`).

    Declarations of entities are refused: of a few bytes they make gigabytes, or the contents of
    other files. Nothing is fetched from elsewhere.

    Raises:
        XmlError: it is no XML, or declares entities.
    """
    parser = etree.XMLParser(
        resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False, recover=False,
        remove_comments=True, remove_pis=True,
    )  # fmt: skip
    try:
        root = etree.fromstring(contents, parser)
    except (etree.XMLSyntaxError, ValueError) as error:
        log = [(entry.line, _plain(entry.message)) for entry in parser.error_log]
        raise XmlError([*dict.fromkeys(log)] or [(None, str(error) or "is empty")]) from None
    declared = root.getroottree().docinfo.internalDTD
    if declared is not None and (entities := list(declared.iterentities())):
        names = ", ".join(f"'{entity.name}'" for entity in entities[:3])
        raise XmlError([(None, f"declares entities ({names}); expected none")])
    return root


def _plain(message: str) -> str:
    """libxml2's message without what only its callers can do about it."""
    if "amplification" in message:
        return "declares entities that grow without end; expected none"
    return message.partition(", use XML_PARSE_HUGE")[0].strip()
