"""The robustness report: its table names existing tests, and it counts and judges correctly."""

from __future__ import annotations

import re
from types import ModuleType
from xml.etree import ElementTree

import pytest
from conftest import ROOT, import_script


@pytest.fixture(scope="module")
def robustness() -> ModuleType:
    return import_script(ROOT / "benchmarks" / "robustness.py")


def test_every_test_of_the_table_exists(robustness: ModuleType) -> None:
    named = {test for target in (*robustness.FUZZED, *robustness.FAULTS) for test in target.tests}
    for test in named:
        file, _, name = test.partition("::")
        text = (ROOT / "tests" / file).read_text()
        assert not name or re.search(rf"^def {name}\(", text, re.MULTILINE), test


@pytest.mark.extensions
def test_every_limit_of_the_table_is_read_from_the_code(robustness: ModuleType) -> None:
    limits = robustness.limits()
    assert dict(limits)["TOML file"] == "20 MB"
    assert dict(limits)["packet"] == "65,507 bytes"
    assert dict(limits)["movable joints of a URDF"] == "128"
    assert len(limits) == len(robustness.LIMITS)


def test_cases_are_counted_as_hypothesis_prints_them(robustness: ModuleType) -> None:
    text = """
tests/test_a.py::test_one:

  - during reuse phase (0.01 seconds):
    - 2 passing, 0 failing, and 1 invalid test cases
  - during generate phase (6.69 seconds):
    - 120 passing, 1 failing, and 10 invalid test cases

tests/test_a.py::test_two[x::y]:

  - during generate phase (0.50 seconds):
    - 25 passing, 0 failing, and 0 invalid test cases
"""
    made = robustness.cases_made(text)
    assert made == {"test_a.py::test_one": 123, "test_a.py::test_two": 25}
    cases = ElementTree.fromstring("""<testsuite>
        <testcase classname="tests.test_a" name="test_one" time="1.5"><failure/></testcase>
        <testcase classname="tests.test_a" name="test_two[x::y]" time="0.5"/>
        <testcase classname="tests.test_a" name="test_two[z]" time="0">
            <skipped message="no"/></testcase>
        <testcase classname="tests.test_b" name="test_one" time="9"/>
        </testsuite>""")
    target = robustness.Target("bytes", ("test_a.py::test_one", "test_a.py::test_two"))
    outcome = robustness.outcome_of(target, [*cases], made)
    assert outcome.tests == {"failed": 1, "passed": 1, "skipped": 1}
    assert (outcome.cases, outcome.seconds) == (148, 2.0)
    assert outcome.failed == ["test_a.py::test_one"]
    assert outcome.skipped == ["no"]
    whole = robustness.outcome_of(robustness.Target("all", ("test_a.py",)), [*cases], made)
    assert whole.tests == outcome.tests


def rows(memory: list[float], received: int, handles: int = 9) -> list[dict[str, float]]:
    told = [{"memory": each, "handles": 9, "threads": 5, "received": 0} for each in memory]
    told[-1] |= {"received": received, "handles": handles}
    return told


@pytest.mark.parametrize(
    ("memory", "received", "handles", "expected"),
    [
        ([100.0, 130.0, *[140.0] * 30], 1000, 9, []),  # initial growth of memory is not a leak
        (
            [100.0 + 10 * k for k in range(32)], 1000, 9,
            ["memory grew by a factor of 2.11; expected at most 1.25"],
        ),
        ([100.0] * 9, 990, 9, ["received 990 of 1000 packets; expected 99.9%"]),
        ([100.0] * 9, 1000, 12, ["handles: 9 at the start, 12 at the end"]),
    ],
)  # fmt: skip
def test_losses_leaks_and_growth_are_problems(
    robustness: ModuleType, memory: list[float], received: int, handles: int, expected: list[str]
) -> None:
    assert robustness.problems_of(rows(memory, received, handles), 1000, judged=True) == expected
