"""Writes results as JUnit XML, which CI servers display."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as xml


@dataclass(frozen=True)
class TestCase:
    """A test case. At most one of the texts `failure`, `error` and `skipped` is not empty.

    Attributes:
        group: class name of the test case.
        name: name of the test case.
        failure: reason of the failure.
        error: error because of which there is no result.
        skipped: reason why there is no result.
        details: text that is added to a failure.
    """

    __test__ = False  # not a class of tests for pytest

    group: str
    name: str
    failure: str = ""
    error: str = ""
    skipped: str = ""
    details: str = ""


def write_junit(path: Path, name: str, cases: Sequence[TestCase], *, seconds: float) -> None:
    """Writes a file with one test suite; `seconds` is the time it took. Raises OSError."""
    counts = {
        "tests": len(cases),
        "failures": sum(bool(each.failure) for each in cases),
        "errors": sum(bool(each.error) for each in cases),
        "skipped": sum(bool(each.skipped) for each in cases),
    }
    numbers = {key: str(count) for key, count in counts.items()}
    suites = xml.Element("testsuites", numbers)
    suite = xml.SubElement(
        suites, "testsuite", {"name": _printable(name), "time": f"{seconds:.3f}", **numbers}
    )
    for each in cases:
        case = xml.SubElement(
            suite, "testcase", classname=_printable(each.group), name=_printable(each.name)
        )
        for kind in ("failure", "error", "skipped"):
            if text := _printable(getattr(each, kind)):
                found = xml.SubElement(case, kind, message=text)
                if each.details:
                    found.text = f"{text}; {each.details}"
    xml.ElementTree(suites).write(path, encoding="utf-8", xml_declaration=True)


def _printable(text: str) -> str:
    # XML cannot contain control characters.
    return "".join(each if each.isprintable() or each == "\n" else "?" for each in text)
