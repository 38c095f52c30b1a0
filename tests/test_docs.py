"""Runs the README and every page of docs/: files, commands and Python code, in order."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import textwrap
import urllib.request
from importlib.util import find_spec
from pathlib import Path

import pytest
from commands import UNSET, run_command
from conftest import ROOT, sampled
from polling import until
from window_tools import MISSING, screen

BLOCK = re.compile(r"(?:<!-- test: (.+?) -->\n)?```(\w+)\n(.*?)```", re.DOTALL)
PICTURE = re.compile(r"((?:-o|--render) \S+\.(?:mp4|png))")
SAMPLES = re.compile(r"--samples 8\b")
# The recording's extra of `compare`.
WITH_FPS = re.compile(r"(sero-mj (?:render|simulate) .*\.mp4)")
DURATION = re.compile(r"--duration [23]\b")
SENDER = re.compile(r"(sero-mj send \w+)$", re.MULTILINE)
LOOP = re.compile(r"\bbegin \+ 3\b")  # s, of a loop in Python
FILM_IN_PYTHON = re.compile(r"(render_video\(.+)\)$", re.MULTILINE)
# Files that a block writes: the output file of a command, or the text of a Python call.
OUTPUT = re.compile(r"(?:[ \"(])(out/[\w.]+\.(?:png|gif|mp4|webm|mcap|csv|pdf|xml|html|glb))")
# A command without shell syntax.
ALONE = re.compile(r"(?:\.venv/bin/)?sero-mj [^|&;<>$*`#]*(#.*)?|#.*|\s*")
# A minute of windows, videos and processes.
LONGEST = ("compare", "control_laws", "controllers", "first_arm", "groups", "headless", "interact",
           "learning", "mirror", "player", "program_view", "recordings", "robots", "simulate",
           "tutorial", "view")  # fmt: skip
PAGES = sorted(
    [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), *(ROOT / "docs/extensions").glob("*.md")],
    key=lambda page: (page.stem in LONGEST, page),
)
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
# Videos and images take most of the time of this test, because they are rendered in software.
SMALL, FPS = (480, 320), 10


def shortened(text: str) -> str:
    """Shortens a block: small drafts, videos with few frames, short recordings, slow senders."""
    text = PICTURE.sub(r"\1 --quality draft --size {}x{}".format(*SMALL), text)
    text = SAMPLES.sub("--samples 4", text)
    text = DURATION.sub("--duration 1", text)
    text = LOOP.sub("begin + 1", text)
    text = SENDER.sub(r"\1 --rate 250", text)  # 1000 packets/s take a quarter of a CPU core
    text = WITH_FPS.sub(rf"\1 --fps {FPS}", text)
    return FILM_IN_PYTHON.sub(rf'\1, size={SMALL}, fps={FPS}, quality="draft")', text)


def lacks(note: str) -> bool:
    """Returns whether a block needs a package that is not installed: `needs NAME`."""
    return note.startswith("needs ") and find_spec(note.removeprefix("needs ")) is None


def open_window(language: str, text: str, folder: Path, environment: dict[str, str]) -> None:
    """Runs commands that open windows on a virtual screen, and closes windows that stay open."""
    if MISSING:
        return
    script = folder / "window.py"
    script.write_text(text)
    with screen() as display:
        here = {**environment, "DISPLAY": display}
        if language == "python":
            subprocess.run(
                [sys.executable, str(script)], cwd=folder, env=here, check=True, timeout=60
            )
            return
        opened = ["xdotool", "search", "--sync", "--onlyvisible", "--name", "sero-mj"]
        for line in text.splitlines():
            process = subprocess.Popen(line.partition("#")[0].split(), cwd=folder, env=here)
            try:
                # xdotool does not find a window that is replaced while it searches.
                assert until(lambda: subprocess.call(opened, env=here, timeout=20) == 0)
                assert process.poll() is None, f"{line}: it has ended"
            finally:
                process.kill()
                process.wait()


def open_page(text: str, folder: Path, environment: dict[str, str]) -> None:
    """Runs a command that serves a page, requests the page, and ends the command."""
    for line in text.splitlines():
        arguments = line.partition("#")[0].split()
        process = subprocess.Popen(
            arguments, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True
        )
        try:
            assert process.stdout is not None
            url = re.search(r"http://\S+", process.stdout.readline())
            assert url, f"{line}: no address"
            with urllib.request.urlopen(url[0], timeout=10) as answer:
                assert b"<html" in answer.read().lower()
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
        finally:
            process.kill()
            process.communicate()


class Shell:
    """The shell of a user, in its own folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # As on a server, where the user has set neither.
        self.environment = {key: each for key, each in os.environ.items() if key not in UNSET}
        command = folder / ".venv" / "bin" / "sero-mj"
        self.environment["PATH"] = f"{command.parent}:{os.environ['PATH']}"  # as if activated
        command.parent.mkdir(parents=True)
        for name, module in (("sero-mj", " -m sero_mj"), ("python", "")):
            script = command.with_name(name)
            script.write_text(f'#!/bin/sh\nexec "{sys.executable}"{module} "$@"\n')
            script.chmod(0o755)

    def run(self, *arguments: str) -> None:
        done = subprocess.run(
            arguments, cwd=self.folder, env=self.environment, capture_output=True, text=True,
            check=False,
        )  # fmt: skip
        self._check(arguments[-1], done.returncode, done.stdout + done.stderr)

    def type(self, text: str) -> None:
        lines = text.replace("\\\n", " ").splitlines()
        if not all(ALONE.fullmatch(line) for line in lines):
            self.run("bash", "-ec", text)
            return
        for line in lines:
            arguments = shlex.split(line, comments=True)[1:]
            if arguments:
                self._check(line, *run_command(arguments, self.folder, self.environment))

    def begin(self, text: str) -> subprocess.Popen[bytes]:
        """Starts a background process and waits until it reports that it is ready."""
        process = subprocess.Popen(
            text.split(), cwd=self.folder, env=self.environment, stdout=subprocess.PIPE
        )
        assert process.stdout is not None and process.stdout.readline()
        return process

    def _check(self, command: str, status: int, said: str) -> None:
        assert status == 0, f"{command}\n{said}"
        assert "no valid packet" not in said or "--wait 0" in command


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize(
    "page", sampled(PAGES, len(PAGES) - len(LONGEST)), ids=[page.stem for page in PAGES]
)
def test_every_block_of_the_documentation_runs(page: Path, tmp_path: Path) -> None:
    shell = Shell(tmp_path)
    environment = shell.environment
    (tmp_path / "out").mkdir()
    background: list[subprocess.Popen[bytes]] = []
    wanted: set[str] = set()
    try:
        for note, language, text in BLOCK.findall(page.read_text("utf-8")):
            left_out = language in ("yaml", "{literalinclude}", "{include}", "{toctree}")
            left_out |= lacks(note) or "pip install" in text
            if "make demo" in text or left_out:
                continue  # .ci/run has just run `make`, and the demo is tested below
            if note == "window":
                open_window(language, shortened(text), tmp_path, environment)
                continue
            if note == "page":
                open_page(text, tmp_path, environment)
                continue
            wanted |= {*OUTPUT.findall(text)}
            if language in ("toml", "text", "xml") and note:
                path = tmp_path / note
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text)
            elif language == "toml":
                shipped = [path.read_text() for path in (ROOT / "scenes").glob("*.toml")]
                is_entry_point = text.startswith("[project.entry-points")
                known = is_entry_point or any(text in scene for scene in shipped)
                assert known, f"no included scene has this part: {text}"
            elif note == "background":
                background.append(shell.begin(shortened(text)))
            elif language == "bash":
                shell.type(shortened(text))
            elif language == "python":
                script = tmp_path / "script.py"
                script.write_text(shortened(textwrap.dedent(text)))
                shell.run(sys.executable, str(script))
    finally:
        for process in background:
            process.terminate()
            process.communicate()
    made = {f"out/{path.name}" for path in (tmp_path / "out").iterdir()}
    assert wanted <= made, f"not made: {wanted - made}"
    assert all((tmp_path / file).stat().st_size > 100 for file in wanted)


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.slow
def test_demo_writes_a_video_and_an_image_and_reports_where(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sero_mj", "demo", "--duration", "0.5", "--size", "320x200"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "out/lwr.mp4" in done.stdout and "out/lwr.png" in done.stdout
    assert (tmp_path / "out" / "lwr.mp4").stat().st_size > 3000
    assert (tmp_path / "out" / "lwr.png").stat().st_size > 3000


@pytest.mark.gl
@pytest.mark.parametrize("script", EXAMPLES, ids=[script.stem for script in EXAMPLES])
def test_example_is_short_and_writes_its_image(script: Path, tmp_path: Path) -> None:
    assert len(script.read_text("utf-8").splitlines()) <= 40
    subprocess.run([sys.executable, str(script)], cwd=tmp_path, check=True, timeout=100)
    image = f"{script.stem}.webp"
    assert (tmp_path / image).stat().st_size > 3_000
    page = (ROOT / "docs" / "examples.md").read_text("utf-8")
    assert f"examples/{script.name}\n" in page and f"(pictures/examples/{image})" in page


def test_images_and_links_of_pages_exist() -> None:
    for page in PAGES:
        text = page.read_text("utf-8")
        for picture in re.findall(r"!\[.+?\]\((.+?)\)", text):
            assert (page.parent / picture).stat().st_size > 3_000
        for link in re.findall(r"(?<!!)\[[^\]]+\]\(([\w/.]+)\)", text):
            assert "_made/" in link or (page.parent / link).is_file(), f"{page.name}: {link}"


def test_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 200


def test_every_command_is_documented() -> None:
    text = (ROOT / "docs" / "commands.md").read_text("utf-8")
    from test_cli import COMMANDS

    for command in COMMANDS:
        assert f"| `sero-mj {command}" in text


def test_make_targets_of_the_readme_exist() -> None:
    make = shutil.which("make")
    if make is None:
        pytest.skip("no make on this machine")
    done = subprocess.run(
        [make, "-n", "test"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert "pytest" in done.stdout
