"""The page in a notebook cell: a real kernel, and JupyterLab in a browser."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest
from conftest import ROOT
from jupyter_client.manager import KernelManager
from page_client import read_sections
from polling import until
from web_tools import MISSING

pytestmark = [pytest.mark.gl, pytest.mark.slow]

PATIENCE = 60.0  # s
_RUN = re.compile(r'data-sero-mj-run="(\w+)">([^<]*)<')
_SHOW = "viewer = sero_mj.view('lwr', web=True)\nviewer"
_MOVE = """
import time, numpy as np
begin = time.monotonic()
while time.monotonic() < begin + {seconds}:
    viewer.robot("lwr").joint_angles = np.full(7, 0.1 + 0.1 * (time.monotonic() - begin))
    viewer.sync()
    time.sleep(0.005)
"""


class Kernel:
    """A real kernel, and the messages it sends to browsers.

    Attributes:
        outputs: HTML by display id; outputs without an id are in their order.
        said: messages to pages, by page: kind, text or bytes.
        errors: errors of cells.
        printed: output of cells, and of the kernel when it ends.
    """

    def __init__(self) -> None:
        command = [sys.executable, "-m", "ipykernel_launcher", "-f", "{connection_file}"]
        self._manager = KernelManager()
        self._manager.kernel_spec.argv[:] = command
        self._told = tempfile.TemporaryFile("w+")  # noqa: SIM115 (open as long as the kernel)
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self._manager.start_kernel(cwd=str(ROOT), env=environment, stderr=self._told)
        self._client = self._manager.blocking_client()
        self._client.start_channels()
        self._client.wait_for_ready(timeout=PATIENCE)
        self._comm = ""
        self._idle: set[str] = set()
        self.outputs: dict[str, str] = {}
        self.said: dict[str, list[tuple[str, Any]]] = {}
        self.errors: list[str] = []
        self.printed = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self._client.stop_channels()
        self._manager.shutdown_kernel(now=True)
        self._told.close()

    def ended(self) -> str:
        """Waits until the kernel has ended and returns its standard error."""
        assert until(lambda: not self._manager.is_alive(), PATIENCE)
        self._told.seek(0)
        return self._told.read()

    def begin(self, code: str) -> str:
        """Runs code and returns its id."""
        return self._client.execute(code)

    def run(self, code: str) -> None:
        """Runs code to its end."""
        cell = self.begin(code)
        self.until(lambda: cell in self._idle)
        assert self.errors == []

    def until(self, found: Callable[[], object]) -> None:
        """Reads the kernel's messages until a condition holds."""
        end = time.monotonic() + PATIENCE
        while not found():
            assert time.monotonic() < end, self.said
            with contextlib.suppress(Exception):
                self._take(self._client.get_iopub_msg(timeout=0.2))

    def _take(self, message: dict[str, Any]) -> None:
        kind, content = message["msg_type"], message["content"]
        if kind == "status" and content["execution_state"] == "idle":
            self._idle.add(message["parent_header"].get("msg_id", ""))
        elif kind == "error":
            self.errors.append("\n".join(content["traceback"]))
        elif kind == "stream":
            self.printed += content["text"]
        elif kind == "comm_open":
            self._comm = content["comm_id"]
        elif kind in ("display_data", "update_display_data"):
            name = content["transient"].get("display_id", str(len(self.outputs)))
            self.outputs[name] = content["data"]["text/html"]
        elif kind == "comm_msg" and content["data"].get("method") == "custom":
            found = content["data"]["content"]
            buffers = message["buffers"]
            what = bytes(buffers[0]) if buffers else found.get("message")
            self.said.setdefault(found["to"], []).append((found["kind"], what))

    def page(self, client: str, kind: str, text: Any = None) -> None:
        """Sends a message from a page."""
        data = {"method": "custom", "content": {"from": client, "kind": kind, "message": text}}
        content = {"comm_id": self._comm, "data": data}
        message = self._client.session.msg("comm_msg", content)
        self._client.shell_channel.send(message)

    def state(self, client: str) -> dict[str, Any]:
        """Returns what a page has been sent so far."""
        found: dict[str, Any] = {}
        for kind, what in self.said.get(client, []):
            if kind == "message" and isinstance(what, bytes):
                found.update(read_sections(what))
        return found

    @property
    def frame(self) -> str:
        """Returns the HTML of the page's frame."""
        (found,) = (each for each in self.outputs.values() if "<iframe" in each)
        return found

    def kept(self) -> dict[str, Any]:
        """Returns the header of the run stored in the notebook, or an empty table."""
        (found,) = (each for each in self.outputs.values() if "<iframe" not in each)
        match = _RUN.search(found)
        assert match is not None
        if not match[2]:
            return {}
        data = zlib.decompress(base64.b64decode(match[2]), -15)
        size = int.from_bytes(data[:4], "little")
        head: dict[str, Any] = json.loads(data[4 : 4 + size])
        part, kind, count = head["values"]["joint_angles"]
        assert kind == "f8"
        start = 4 + size + sum(head["lengths"][:part])
        planes = np.frombuffer(data, np.uint8, head["lengths"][part], start).reshape(-1, count)
        head["angles"] = planes.T.copy().view("<f8").reshape(-1, head["frames"])
        return head


@pytest.fixture
def kernel() -> Iterator[Kernel]:
    with Kernel() as kernel:
        kernel.run("import sero_mj")
        yield kernel


@pytest.mark.thorough
def test_page_communicates_through_the_kernel_while_it_is_busy(kernel: Kernel) -> None:
    shown = "viewer = sero_mj.view('lwr', web=True)\ndisplay(viewer)\n" + _MOVE.format(seconds=4)
    cell = kernel.begin(shown)
    kernel.until(lambda: "run" in kernel.state("first"))
    # The page makes no requests.
    assert "default-src &#x27;none&#x27;" in kernel.frame and "localhost" not in kernel.frame
    # Nothing answers before the cell has ended, and the page continues.
    poses = kernel.state("first")["poses"]
    kernel.until(lambda: kernel.state("first")["poses"] != poses)
    assert cell not in kernel._idle
    kernel.until(lambda: cell in kernel._idle)
    # Another browser connects.
    kernel.page("second", "open")
    kernel.until(lambda: "control" in kernel.state("second"))
    assert kernel.said["second"][0] == ("opened", None)
    control = kernel.state("second")["control"]
    assert control["count"] == 2 and control["holder"] != kernel.state("second")["you"]["id"]
    kernel.page("second", "say", '{"t":"control"}')
    kernel.page("second", "say", json.dumps({"t": "size", "w": 500, "h": 400, "page": 500}))
    kernel.page("second", "say", json.dumps({"t": "key", "key": "a", "repeat": False}))
    for _ in range(3):
        kernel.page("second", "say", '{"t":"got"}')
    kernel.until(lambda: any(kernel.state("second").get("arrowOn", b"")))
    # A message that does not come from a page is ignored.
    for wrong in (None, 7, {"t": "got"}, "\0"):
        kernel.page("second", "say", wrong)
        kernel.page("nobody", "say", wrong)
    kernel.page("second", "close")
    kernel.until(lambda: kernel.state("first")["control"]["count"] == 1)
    # Displaying the scene again creates another viewer.
    kernel.run(_SHOW)
    kernel.until(lambda: kernel.said["first"][-1][0] != "closed")


@pytest.mark.thorough
def test_rerun_cell_keeps_its_port_and_runs_between_cells(kernel: Kernel) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    kernel.run(_SHOW.replace("web=True", f"web=True, port={port}"))
    kernel.run(_SHOW)  # the port of the previous viewer, not the first free one
    urls = re.findall(r"lwr is at (http\S+)", kernel.printed)
    # With its own token: another program could have used the previous port in between.
    assert len(set(urls)) == 2
    assert all(url.startswith(f"http://localhost:{port}/?token=") for url in urls)
    assert "lwr is opened again; its previous viewer is closed" in kernel.printed
    kernel.run("print('pictures', viewer.frame_count)")
    seen = len(kernel.said["first"])
    kernel.until(lambda: len(kernel.said["first"]) > seen + 3)  # no cell runs
    kernel.run("print('pictures', viewer.frame_count)")
    first, second = map(int, re.findall(r"pictures (\d+)", kernel.printed))
    assert second > first
    with urllib.request.urlopen(urls[1], timeout=5) as answer:
        assert answer.status == 200


@pytest.mark.thorough
def test_ending_kernel_ends_its_viewers_without_errors(kernel: Kernel) -> None:
    kernel.run(_SHOW)
    (url,) = re.findall(r"lwr is at (http\S+)", kernel.printed)
    kernel.begin("quit()")

    def has_ended() -> bool:
        try:
            urllib.request.urlopen(url, timeout=5).close()
        except (urllib.error.URLError, ConnectionError):
            return True
        return False

    assert until(has_ended, PATIENCE)
    assert "Error" not in kernel.ended()


@pytest.mark.thorough
def test_notebook_stores_the_displayed_run(kernel: Kernel) -> None:
    kernel.run(_SHOW)
    kernel.run(_MOVE.format(seconds=2))
    kernel.run("viewer.close()")
    kernel.until(lambda: kernel.said["first"][-1][0] == "closed")
    kept = kernel.kept()
    assert 1.5 < (kept["frames"] - 1) / kept["fps"] < 4.0
    angles = kept["angles"]
    assert np.allclose(angles, angles[:1])  # the same for all joints
    moving = angles[0, angles[0] > 0.09]
    assert np.all(np.diff(moving) >= 0) and moving[-1] == pytest.approx(0.3, abs=0.02)
    # Twice 0.1 rad/s would mean that the run is played at a wrong speed.
    speed = np.diff(moving)[5:-5].mean() * kept["fps"]
    assert speed == pytest.approx(0.1, rel=0.15)


def test_cell_without_anywidget_reports_the_missing_package(kernel: Kernel) -> None:
    kernel.run("import sys; sys.modules['anywidget'] = None\n" + _SHOW)
    (said,) = kernel.outputs.values()
    assert "pip install 'sero-mj[notebook]'" in said and "http://localhost" in said


@contextlib.contextmanager
def lab(folder: Path) -> Iterator[str]:
    """Runs JupyterLab in a folder and yields its address."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = ["--no-browser", "--allow-root", "--IdentityProvider.token=t", f"--port={port}"]
    server = subprocess.Popen(
        [sys.executable, "-m", "jupyterlab", *words, f"--notebook-dir={folder}"],
        stderr=subprocess.DEVNULL,
        env={**os.environ, "HOME": str(folder), "PYTHONPATH": str(ROOT)},
        cwd=folder,
    )
    url = f"http://localhost:{port}"

    def answers() -> bool:
        with contextlib.suppress(urllib.error.URLError, ConnectionError):
            urllib.request.urlopen(f"{url}/lab?token=t", timeout=5).close()
            return True
        return False

    try:
        assert until(answers, PATIENCE)
        yield f"{url}/lab/tree/run.ipynb?reset&token=t"
    finally:
        server.terminate()
        try:
            server.wait(20)
        except subprocess.TimeoutExpired:  # it sometimes hangs if a kernel ends meanwhile
            server.kill()
            server.wait()


_READY = "() => document.documentElement.dataset.ready === '1'"


def cell_page(page: Any) -> Any:
    """Returns the frame of the page in its cell once it has drawn."""
    page.wait_for_selector("iframe[srcdoc]", timeout=60_000)
    frame = page.query_selector("iframe[srcdoc]").content_frame()
    frame.wait_for_function(_READY, timeout=60_000)
    return frame


@pytest.mark.thorough
@pytest.mark.timeout(240)
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_jupyterlab_shows_the_scene_live_and_plays_it_after_reopening(
    browser: Any, tmp_path: Path
) -> None:
    import nbformat  # takes seconds, which each worker would spend

    book = nbformat.v4.new_notebook()
    python = {"name": "python3", "display_name": "Python 3", "language": "python"}
    book.metadata["kernelspec"] = python
    sources = ["import sero_mj", _SHOW, _MOVE.format(seconds=3), "viewer.close()"]
    book.cells = [nbformat.v4.new_code_cell(source) for source in sources]
    nbformat.write(book, tmp_path / "run.ipynb")
    with lab(tmp_path) as url:
        page = browser.new_page(viewport={"width": 900, "height": 900})
        page.goto(url)
        page.locator(".jp-Notebook .jp-CodeCell .cm-content").first.click()
        page.wait_for_selector(".jp-Notebook-ExecutionIndicator[data-status=idle]", timeout=60_000)
        for _ in range(2):
            page.keyboard.press("Shift+Enter")
        frame = cell_page(page)
        frame.wait_for_function("() => player.state && player.isInControl", timeout=60_000)
        frame.get_by_role("button", name="panel").click()
        page.keyboard.press("Escape")
        page.locator(".jp-Notebook .jp-CodeCell .cm-content").nth(2).click()
        page.keyboard.press("Shift+Enter")
        frame.wait_for_function("() => player.state.run.values.joint_angles[6] > 0.2")
        page.locator(".jp-Notebook .jp-CodeCell .cm-content").nth(3).click()
        page.keyboard.press("Shift+Enter")
        # The kernel shows nothing now: the cell plays the stored run.
        page.wait_for_function(
            "() => document.querySelector('[data-sero-mj-run]').textContent.length > 1000",
            timeout=60_000,
        )
        wait = "() => globalThis.player?.run?.frames > 20 && !document.body.matches('.live')"
        assert until(lambda: cell_page(page).evaluate(wait), PATIENCE)
        page.locator(".jp-Notebook .jp-CodeCell .cm-content").first.click()
        page.keyboard.press("Control+s")
        saved = tmp_path / "run.ipynb"
        assert until(lambda: len(saved.read_text()) > 100_000, PATIENCE)
        page.close()
    with lab(tmp_path) as url:
        page = browser.new_page(viewport={"width": 900, "height": 900})
        page.goto(url)
        frame = cell_page(page)
        frame.wait_for_function("() => player.run.frames > 20 && player.recording.clock.frame > 3")
        last = frame.evaluate(
            "() => { const { values, frames } = player.run;"
            " return [1, 2, 3, 4, 5, 6, 7].map((j) => values.joint_angles[j * frames - 1]); }"
        )
        assert last == pytest.approx([last[0]] * 7) and 0.3 < last[0] < 0.45
        page.close()
