"""XML of others, read without what is dangerous in it."""

from __future__ import annotations

from typing import Any, TypeAlias

from lxml import etree

Element: TypeAlias = Any  # lxml has no types


class XmlError(ValueError):
    """XML that cannot be read; `reasons` are pairs of a line, or None, and what is wrong there."""

    def __init__(self, reasons: list[tuple[int | None, str]]) -> None:
        self.reasons = reasons
        super().__init__("; ".join(reason for _, reason in reasons))


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
