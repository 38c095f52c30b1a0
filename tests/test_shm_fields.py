"""Errors of shared-memory declarations, readers and writers."""

from __future__ import annotations

import errno
import os
import sys
from typing import Any

import pytest
from conftest import raises_with
from pydantic import ValidationError
from shm_tools import block, needs_posix

from sero_mj.base.errors import DeclarationError, SourceError
from sero_mj.cli import main
from sero_mj.data.receive import shm, shm_block
from sero_mj.data.receive.shm import ShmReader
from sero_mj.data.receive.shm_block import block_path
from sero_mj.data.receive.source import make_source
from sero_mj.data.receive.structure import Structure
from sero_mj.data.send.sender import ShmWriter

__all__ = ["block"]  # a fixture
pytestmark = needs_posix
LINUX = sys.platform == "linux"


def run(arguments: list[str]) -> int:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    return int(ended.value.code or 0)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("", "found ''; expected a name such as robot or /robot"),
        ("/", "found '/'"),
        ("..", "found '..'; expected a name"),
        ("a/b", "found '/' in 'a/b'"),
        ("//a", "found '/' in '//a'"),
        ("a\0b", r"found '\x00' in 'a\x00b'"),
        ("a\nb", r"found '\n' in 'a\nb'"),
        ("\udc80", r"found '\udc80' in '\udc80'"),
        ("ö" * 200, "found 400 bytes; expected at most"),
    ],
)
def test_invalid_block_names_are_reported(name: str, message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        make_source("robot", {"kind": "shm", "block": name, "structure": "1F"})
    assert message in str(caught.value)
    with pytest.raises(SourceError) as reported:
        ShmWriter(name, Structure("1F"))
    assert message in str(reported.value)


def test_block_name_can_begin_with_a_slash() -> None:
    assert block_path("robot") == block_path("/robot") == "/robot"


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"lock": "lok"}, "no event 'lok' in the structure; did you mean 'lock'?"),
        ({"lock": "v"}, "'v' has 2 numbers; expected one, as in v:1I"),
        (
            {"lock": "lock", "sequence": "lock"},
            "'lock' is both lock and sequence, but a lock increases by two",
        ),
        ({"lock": "late"}, "lock 'late' is at byte 9; expected a multiple of 8"),
        ({"lock": "lock", "offset": 2}, "lock 'lock' is at byte 2; expected a multiple of 8"),
        ({"poll_rate": 0.0}, "poll_rate"),
        ({"settle": -1.0}, "settle"),
        ({"offset": -1}, "offset"),
    ],
)
def test_invalid_fields_are_reported(fields: dict[str, Any], message: str) -> None:
    with pytest.raises((DeclarationError, ValidationError)) as caught:
        ShmReader(block="x", structure="lock:1Q v:2d gap:1B late:1Q", **fields)
    assert message in str(caught.value)


@pytest.mark.skipif(not LINUX, reason="blocks are files on Linux only")
def test_unreadable_blocks_are_reported(block: str, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkdir(f"/dev/shm{block}")
    try:
        with pytest.raises(SourceError) as caught:
            ShmReader(block=block, structure="1F").open()
    finally:
        os.rmdir(f"/dev/shm{block}")
    assert (
        str(caught.value)
        == f"source 'shm': shared memory {block}: it is a special file, not shared memory"
    )

    def refuse(*_: object) -> None:
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr(shm, "Block", refuse)
    with raises_with(
        SourceError,
        source="shm",
        reason=(f"shared memory {block}: no permission to read it; its writer must set mode 0644"),
    ):
        ShmReader(block=block, structure="1F").open()


def test_missing_shared_memory_support_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shm_block, "_posixshmem", None)
    with raises_with(
        SourceError, source="shm", reason="shared memory /x: this system has no POSIX shared memory"
    ):
        ShmReader(block="x", structure="1F").open()


def test_check_prints_block_size_and_events(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["check", "lwr_shm"]) == 0
    output = capsys.readouterr().out
    events = "lock (1), angles (7), torques (7)"
    assert f"source  robot: shared memory /sero_lwr, 120 bytes: {events}" in output


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["lwr_shm", "--shm", "x", "--port", "5"], "--shm cannot be combined with --port"),
        (
            ["lwr_shm", "--host", "h"],
            "source 'robot' is shared memory /sero_lwr; --host needs --port",
        ),
        (["lwr_shm", "--shm", "a/b"], "source 'writer': shared memory a/b: found '/' in 'a/b'"),
    ],
)
def test_invalid_send_options_are_reported(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["send", *options]) != 0
    assert message in capsys.readouterr().err


def test_robot_without_a_scene_is_sent_to_shared_memory(
    block: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["send", "lwr", "--shm", block, "--duration", "0.05"]) == 0
    output = capsys.readouterr().out
    assert f"sending 7F7F (112 bytes) to shared memory {block} at 1000 Hz" in output
    assert "sent 50 packets" in output
