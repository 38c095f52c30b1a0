"""What an error states apart from its words: its class, and the key and the values of each problem.

`found -1; expected greater than 0` at `arm.size` states `arm.size: -1, 0`. A test asserts that, and
the words of all messages are in messages.txt: a line each, with `…` in place of values. A message
whose words are not there fails the test.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

MESSAGES = Path(__file__).with_name("messages.txt")
_KNOWN = frozenset(MESSAGES.read_text("utf-8").splitlines())
# Of `scene.toml:3: robots.arm.model: found 5`, all before `found`.
_WHERE = re.compile(r"""(?:(?!(?:found|expected|is|has|no|unknown|are)\ |['"`])
    [^\s;]+(?:\ [^\s;]+){0,2}:\ )*""", re.VERBOSE)  # fmt: skip
_VALUE = re.compile(r"""
      (?<=available:\ ).*                     # names without quotes
    | (?<!\w)'(?:[^'\\\n]|\\.)*'(?!\w) | "[^"\n]*" | `[^`\n]*`
    | \[(?:[^\[\]]|\[[^\[\]]*\])*\] | \((?:[-\d.e, ]*)\) | <\w+>
    | (?<![\w-])--?[a-z][\w-]*
    | (?<![\w.])(?:0x[0-9a-f]+|\d+x\d+|[-+]?\d[\d.]*(?:e[-+]?\d+)?)(?!\w*[_=])
    | (?<!\w)-?(?:nan|inf)\b
    | (?<!\w)\.[a-z]\w* | (?!e\.g)\w+(?:[._=/:]\w+)+ | [A-Z]{3,}\w* | \w+_
    | is\ required | unknown\ key
""", re.VERBOSE)  # fmt: skip
_SEVERAL = re.compile(r"…(?:(?:, | or |, or | and | x )…)+")


def _lines(error: BaseException | str | Sequence[str]) -> list[str]:
    text = str(error) if isinstance(error, BaseException | str) else "\n".join(error)
    return [line.strip() for line in text.splitlines()]


def facts(error: BaseException | str | Sequence[str]) -> list[str]:
    """The place, key and values of each line of an error, such as `a.toml:3: arm.size: -1, 0`."""
    stated = []
    for line in _lines(error):
        where = _WHERE.match(line).group()  # type: ignore[union-attr]
        values = [value.rstrip(".,") for value in _VALUE.findall(line, len(where))]
        stated.append((where + ", ".join(dict.fromkeys(values))).rstrip(": "))
    return stated


def words(line: str) -> str:
    """The words of one line of an error, with `…` in place of values."""
    return _SEVERAL.sub("…", _VALUE.sub("…", _WHERE.sub("", line, count=1)))


def states(error: BaseException | str | Sequence[str], *expected: str) -> None:
    """Asserts the facts of an error line by line, and that the words of each are known.

    Each expected line may lack the first parts of the place and the last values. Where a problem
    has no values, its line is a part of the message: its words tell it from others.
    """
    stated, lines = facts(error), _lines(error)
    assert len(stated) == len(expected) and all(
        re.search(rf"(?:^|: ){re.escape(some)}(?:[,:]|$)", fact)
        or (some in line and re.search("[a-z]{2}", words(some)))
        for line, fact, some in zip(lines, stated, expected, strict=True)
    ), f"stated {stated}, expected {list(expected)}, by:\n{error}"
    new = set(map(words, lines)) - _KNOWN
    assert not new, f"words that are not in {MESSAGES.name}: {sorted(new)}"


@contextmanager
def refused(kind: type[BaseException], *expected: str) -> Iterator[pytest.ExceptionInfo]:
    """Expects an error of a kind that states some lines, see `states`."""
    with pytest.raises(kind) as caught:
        yield caught
    states(caught.value, *expected)
