"""Lists words in docs, docstrings and messages that this project does not use, see CONTRIBUTING.md.

Code in Markdown (fenced or in backticks) is skipped. A line of `.ci/words.allow` is a phrase in
which a listed word is right.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# A pattern, and what to write instead.
WORDS = {
    r"tell|tells|told|telling": "report, print, show",
    r"says|said|saying": "report, print; the message",
    r"mend|mends|mended|mending": "fix",
    r"film|films|filmed|filming": "video",
    r"pictures?": "image; a photo",
    r"endless": "continuous joint",
    r"joints? that (?:turns?|slides?)": "revolute or prismatic joint",
    r"cards?": "billboard; panel",
    r"ahead": "early",
    r"lateness": "delay, latency",
    r"asked|meant": "requested, intended",
    r"keeps|kept|goes on|likewise|whichever|whoever": "stores, continues, the same, anyone",
    r"by itself|by themselves": "automatically",
    r"of others": "third-party",
    r"foreign": "external, third-party; an unexpected sender",
    r"good packets?": "valid packet",
    r"besides": "in addition",
    r"time lines?": "timeline",
    r"routes of numbers": "numeric routes",
    r"(?<!control )laws?": "control law",
    r"without a word|silently dropped": "without a warning",
    r"nonsense": "invalid data",
    r"wings?": "package",
}
FORBIDDEN = {re.compile(rf"\b(?:{words})\b", re.IGNORECASE): use for words, use in WORDS.items()}
FENCE = re.compile(r"^(```|~~~).*?^\1", re.DOTALL | re.MULTILINE)
CODE = re.compile(r"``.+?``|`[^`]+`|\]\([^)]*\)|<[^>]+>")


def blank(match: re.Match[str]) -> str:
    """Returns as many lines as the match has, without their text."""
    return "\n" * match[0].count("\n")


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Yields line number and text of each sentence or message of a file."""
    source = path.read_text("utf-8")
    if path.suffix == ".md":
        yield from enumerate(FENCE.sub(blank, source).splitlines(), 1)
    elif path.suffix == ".toml":
        for number, line in enumerate(source.splitlines(), 1):
            comment = re.search(r'#.*|description = ".*"', line)
            if comment:
                yield number, comment[0]
    else:
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
                for offset, line in enumerate(node.value.splitlines()):
                    yield node.lineno + offset, line


def main(names: list[str]) -> int:
    """Prints the words in the named files and folders, or in all; returns 1 if there are any."""
    allowed = (ROOT / ".ci" / "words.allow").read_text("utf-8").splitlines()
    named = [Path(name).resolve() for name in names]
    files = [
        file for path in named for file in (sorted(path.rglob("*.py")) if path.is_dir() else [path])
    ] or [
        path
        for pattern in (
            "*.md",
            "docs/**/*.md",
            "sero_mj/**/*.py",
            "scenes/**/*.toml",
            "models/*/*.toml",
        )
        for path in sorted(ROOT.glob(pattern))
        if "_made" not in path.parts
    ]
    found = 0
    for path in files:
        for number, line in texts(path):
            text = CODE.sub("", line)
            for phrase in filter(None, allowed):
                text = text.replace(phrase, "")
            for pattern, use in FORBIDDEN.items():
                for match in pattern.finditer(text):
                    found += 1
                    print(f"{path.relative_to(ROOT)}:{number}: {match[0]!r}; write: {use}")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
