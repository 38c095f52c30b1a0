"""Output of commands: text from a file cannot control the terminal."""

from __future__ import annotations

import io
import logging
import pickle
import re
import sys
import unicodedata
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sero_mj.base.errors import (
    CsvError,
    DeclarationError,
    Problem,
    SourceError,
    UnknownName,
    UsageError,
    printable,
)
from sero_mj.cli import main
from sero_mj.cli.terminal import EscapedStream, escape_output, make_console, plain

TITLE = "\x1b]0;owned\x07"  # sets the title of a terminal
HOSTILE = f"{TITLE}\x1b[31m\u202eevil\u202c\0\u200b\x9b2J\r\ud800"
ESCAPED = r"\x1b]0;owned\x07\x1b[31m\u202eevil\u202c\x00\u200b\x9b2J\r\ud800"
CONTROLS = ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp")  # categories of characters


def is_harmless(text: str) -> bool:
    return all(each in "\n\t" or unicodedata.category(each) not in CONTROLS for each in text)


@given(st.text(max_size=50))
@example(HOSTILE)
def test_any_text_is_printable_and_escaped_once(text: str) -> None:
    escaped = printable(text)
    assert is_harmless(escaped)
    assert printable(escaped) == escaped
    if is_harmless(text):
        assert escaped == text


def test_text_without_control_characters_is_unchanged() -> None:
    assert printable(HOSTILE) == ESCAPED
    for text in ("A1\tqäß 手首 Ω 😀\n", "840\u00a0kg/m³", ""):
        assert printable(text) == text


@pytest.mark.parametrize("error", [
    UsageError(HOSTILE), DeclarationError([Problem(HOSTILE, HOSTILE, HOSTILE, found=HOSTILE)]),
    UnknownName(HOSTILE, HOSTILE, [HOSTILE]), CsvError(HOSTILE, HOSTILE, column=HOSTILE),
    SourceError(HOSTILE, Problem(HOSTILE, HOSTILE, expected=HOSTILE)),
], ids=lambda error: type(error).__name__)  # fmt: skip
def test_error_messages_are_printable(error: Exception) -> None:
    for each in (error, pickle.loads(pickle.dumps(error))):
        assert is_harmless(str(each))
        assert r"\u202eevil" in str(each)


# Keys, names and values, as in an untrusted file.
FILE = rf"""
description = "{TITLE.encode("unicode_escape").decode().replace(chr(92) + "x", chr(92) + "u00")}"
[robots."\u001b[31mX\u202e"]
model = "lwr"
[robots.a]
model = "lwr"
"\u0000key" = 1
look = "\u009b2J"
[sources."\u200bs"]
kind = "\u001b[2J"
"""


def test_keys_and_values_of_a_file_are_escaped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "na\x1b[31mme.toml"
    file.write_text(FILE)
    for command in (
        ["check"],
        ["check", "--fk"],
        ["simulate"],
        ["status"],
        ["render", "-o", "x.png"],
    ):
        with pytest.raises(SystemExit) as ended:
            main([*command, str(file)])
        out, err = capsys.readouterr()
        assert ended.value.code == 2
        assert is_harmless(out + err), command
        for expected in (r"robots.\x1b[31mX\u202e", r"\x00key", r"na\x1b[31mme.toml"):
            assert expected in out + err, command


def test_streams_escape_what_is_printed_logged_and_raised(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "excepthook", sys.excepthook)
    escape_output()
    escape_output()  # the second call does nothing
    assert isinstance(sys.stdout, EscapedStream)
    assert not isinstance(plain(sys.stdout), EscapedStream)
    print(HOSTILE, end="|")
    sys.stdout.writelines([HOSTILE, "\n"])
    handler = logging.StreamHandler(sys.stderr)
    handler.emit(logging.LogRecord("x", 30, "", 0, "%s", (HOSTILE,), None))
    try:
        raise ValueError(HOSTILE)
    except ValueError as error:
        sys.excepthook(ValueError, error, error.__traceback__)
    with pytest.raises(SystemExit):
        main(["check", "--" + HOSTILE])
    out, err = capsys.readouterr()
    assert out == f"{ESCAPED}|{ESCAPED}\n"
    assert err.startswith(f"{ESCAPED}\nTraceback")
    assert f"ValueError: {ESCAPED}" in err
    assert is_harmless(err)


def test_tables_have_only_the_colors_of_rich(monkeypatch: pytest.MonkeyPatch) -> None:
    from rich.live import Live
    from rich.progress import Progress, TextColumn
    from rich.table import Table
    from rich.text import Text

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    screen = Terminal()
    monkeypatch.setenv("TERM", "xterm-256color")  # like terminals
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(sys, "stdout", EscapedStream(screen))
    console = make_console(width=400)
    # Rich itself drops these two.
    hostile = HOSTILE.replace("\r", "").replace("\x07", "")
    escaped = ESCAPED.replace(r"\r", "").replace(r"\x07", "")
    table = Table(hostile, title=hostile)
    table.add_row(f"[bold]{hostile}[/bold] [link=http://evil.example]x[/link] :smile:", style="red")
    table.add_row(Text(hostile, style="green"))
    with Live(table, console=console, auto_refresh=False) as live:
        live.refresh()
        print(hostile)  # rich catches it
    with Progress(TextColumn("{task.description}", markup=False), console=console) as bar:
        bar.add_task(hostile)
    console.print(hostile, style="bold")
    shown = screen.getvalue()
    assert "\x1b[31m" in shown  # of the first row, by its style
    assert shown.count(escaped) >= 5
    # Everything else is rich's own sequences for colors and the cursor.
    rest = re.sub(r"\x1b\[[\d;?]*[A-Za-z]|\r", "", shown)
    assert is_harmless(rest), [c for c in rest if not is_harmless(c)]
    assert "evil.example]x[/link] :smile:" in rest
