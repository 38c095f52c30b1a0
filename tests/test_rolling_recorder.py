"""Background exports of recorded views: one at a time, reported, and ended with the viewer."""

import logging
import os
import select
import signal
import socket
import subprocess
import sys
from datetime import datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import pytest
from polling import until

from sero_mj.base.child_process import ChildProcess
from sero_mj.cli.arguments import read_scene
from sero_mj.data.drive.mirror import Mirror
from sero_mj.viewer.session import background_exports
from sero_mj.viewer.session.background_exports import BackgroundExports
from sero_mj.viewer.tools.rolling_recorder import RollingRecorder

pytestmark = pytest.mark.gl

SHORT = ["render", "lwr", "--size", "64x48", "--quality", "draft", "--duration", "0.1"]
LONG = ["render", "lwr", "--size", "640x480", "--duration", "600"]


def wait_for(films: BackgroundExports, count: int) -> list[tuple[str, bool]]:
    """Returns the messages until `count` exports are finished, waiting for each."""
    said = []
    while len(said) < count:
        told = films.advance()
        if told is not None:
            said.append(told)
        elif films._made is not None:
            films._made[0].process.wait(60)
    return said


def has_ended(process: int, seconds: float = 30.0) -> bool:
    try:
        handle = os.pidfd_open(process)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([handle], [], [], seconds)[0])
    finally:
        os.close(handle)


@pytest.mark.thorough
def test_exports_are_made_one_after_the_other_and_reported(tmp_path: Path) -> None:
    films = BackgroundExports()
    paths = [tmp_path / f"{k}.mp4" for k in range(3)]
    assert [films.add(SHORT, path) for path in paths] == [0, 1, 2]
    assert films.advance() is None
    assert (len(films._waiting), films.count) == (2, 3)
    films.advance()
    assert len(films._waiting) == 2  # the first one is still running
    expected = [(f"video saved: {path.name}", False) for path in paths]
    assert wait_for(films, 3) == expected
    assert sorted(tmp_path.iterdir()) == paths
    films.add(["render", "no_such_robot"], tmp_path / "no.mp4")
    ((text, is_bad),) = wait_for(films, 1)
    assert is_bad and text.startswith("video no.mp4 failed: ") and "no_such_robot" in text
    films.add(["export", "lwr"], tmp_path / "pose.html")
    assert wait_for(films, 1) == [("page saved: pose.html", False)]
    films.close(finish=False)


def test_export_with_much_output_does_not_block_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = ChildProcess
    noisy = "import sys; sys.stderr.write('a line of a warning\\n' * 50_000); sys.exit(1)"

    def noisy_child(command: list[str], **options: Any) -> ChildProcess:
        return real([sys.executable, "-c", noisy], **options)

    monkeypatch.setattr(background_exports, "ChildProcess", noisy_child)
    films = BackgroundExports()
    for name in ("first.mp4", "second.mp4"):
        films.add(SHORT, tmp_path / name)
    messages = []
    assert until(
        lambda: messages.append(films.advance()) or len([*filter(None, messages)]) == 2, 60.0
    )
    assert [*filter(None, messages)] == [
        ("video first.mp4 failed: a line of a warning", True),
        ("video second.mp4 failed: a line of a warning", True),
    ]


def test_two_saves_within_a_second_write_two_recordings(tmp_path: Path) -> None:
    with socket.socket(type=socket.SOCK_DGRAM) as robot:
        robot.bind(("127.0.0.1", 0))
        port = robot.getsockname()[1]
    scene = read_scene("lwr_udp", [f"sources.udp.port={port}"])
    with Mirror(scene) as mirror:
        recorder = RollingRecorder(SimpleNamespace(mirror=mirror, folder=tmp_path,
                                                   render_words=list))  # fmt: skip
        recorder._exports.add_page = lambda recording: 0
        recorder._exports.add = lambda words, path: 0
        with socket.socket(type=socket.SOCK_DGRAM) as robot:
            robot.connect(("127.0.0.1", port))
            assert until(lambda: robot.send(bytes(112)) and recorder._recorder.statistics.packets)
        now = datetime(2026, 5, 4, 17, 3, 12)
        with patch("sero_mj.viewer.tools.rolling_recorder.datetime") as clock:
            clock.now.return_value = now
            said = [recorder._save(), recorder._save()]
        recorder.close()
    names = [text.rpartition(" ")[2] for text in said]
    assert len({*names}) == 2
    assert sorted(path.name for path in tmp_path.glob("*.mcap")) == sorted(names)


def test_unfinished_exports_end_with_the_viewer_and_leave_no_files(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    films = BackgroundExports()
    paths = [tmp_path / "first.mp4", tmp_path / "second.mp4"]
    for path in paths:
        films.add(LONG, path)
    films.advance()
    assert films._made is not None
    process = films._made[0].process.pid
    with caplog.at_level(logging.WARNING):
        films.close(finish=False)
    assert has_ended(process, 0)
    assert list(tmp_path.iterdir()) == []
    assert films.count == 0
    told = [record.getMessage() for record in caplog.records]
    assert [text.rpartition(" ")[2] for text in told] == [str(path) for path in paths]
    assert all(": sero-mj render lwr --size 640x480" in text for text in told)


@pytest.mark.thorough
def test_exports_are_finished_on_request(tmp_path: Path) -> None:
    films = BackgroundExports()
    for k in range(2):
        films.add(SHORT, tmp_path / f"{k}.mp4")
    films.close(finish=True)
    assert films.count == 0
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["0.mp4", "1.mp4"]


@pytest.mark.skipif(not hasattr(os, "pidfd_open"), reason="waits for a process by Linux's pidfd")
def test_export_ends_with_a_viewer_that_is_killed(tmp_path: Path) -> None:
    viewer = (
        "import sys, pathlib;"
        " from sero_mj.viewer.session.background_exports import BackgroundExports;"
        " films = BackgroundExports();"
        f"films.add({LONG!r}, pathlib.Path('long.mp4')); films.advance();"
        "print(films._made[0].process.pid, flush=True); sys.stdin.read()"
    )
    with subprocess.Popen(
        [sys.executable, "-c", viewer],
        cwd=tmp_path, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        assert process.stdout is not None
        renderer = int(process.stdout.readline())
        process.kill()
    assert has_ended(renderer)
    assert not [path for path in tmp_path.iterdir() if ".part" in path.name]


@pytest.mark.thorough
def test_terminated_export_leaves_no_partial_file(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-m", "sero_mj", *LONG, "-o", "long.mp4"],
        cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        while not list(tmp_path.glob(".long*")) and process.poll() is None:
            select.select([], [], [], 0.05)  # Python has no event for new files in a directory
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=60)[1].endswith("sero-mj: interrupted\n")
        assert process.returncode == 130
    assert not list(tmp_path.glob(".long*"))
