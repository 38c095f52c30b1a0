"""Opens real windows on a screen of their own (Xvfb), and works them as a user does (xdotool)."""

from __future__ import annotations

import json
import os
import queue
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
SIZE = (640, 480)
MISSING = [tool for tool in ("Xvfb", "xdotool") if shutil.which(tool) is None]

# Shows frames, and answers what is asked about the window on its standard input.
_DRIVER = """
import json, os, queue, sys, threading
os.environ["MUJOCO_GL"] = "glfw"
import numpy as np
from sero_mj.cli.arguments import read_scene_or_model, replay_instead
from sero_mj.drive.mirror import Mirror
from sero_mj.show.window import Window
from pathlib import Path
scene, settings, size, options, replay = json.loads(sys.argv[1])
lines = queue.SimpleQueue()
def read():
    for line in sys.stdin:
        lines.put(line)
threading.Thread(target=read, daemon=True).start()
scene = read_scene_or_model(scene, settings)
if replay:
    replay_instead(scene, Path(replay), None)
clicks = []
with Mirror(scene) as mirror, Window(mirror, size=size, folder=Path(), **options) as w:
    w.on_click = lambda picked, gesture: clicks.append((gesture, picked and picked.kind))
    w.frame()
    print("ready", flush=True)
    frames = 0
    while w.frame():
        frames += 1
        while not lines.empty():
            found = eval(lines.get())
            if isinstance(found, np.ndarray | np.generic):
                found = found.tolist()
            print("=" + json.dumps(found), flush=True)
print("closed", flush=True)
"""


@contextmanager
def screen() -> Iterator[str]:
    """A screen without a monitor; yields its DISPLAY."""
    read, write = os.pipe()
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "1000x700x24", "-nolisten", "tcp"],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    try:
        with os.fdopen(read) as number:
            yield f":{number.readline().strip()}"
    finally:
        server.terminate()
        server.wait()


class Driven:
    """A window of another process."""

    def __init__(
        self,
        display: str,
        folder: Path,
        scene: str,
        *,
        settings: tuple[str, ...] = (),
        replay: str = "",
        **options: Any,
    ) -> None:
        self._environment = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
        self._environment.pop("WAYLAND_DISPLAY", None)
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        arguments = json.dumps([scene, list(settings), list(SIZE), options, replay])
        self.process = subprocess.Popen(
            [sys.executable, "-c", _DRIVER, arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            cwd=folder,
            env=self._environment,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        self._expect("ready", 60)

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line.strip())

    def _expect(self, start: str, seconds: float) -> str:
        end = time.monotonic() + seconds
        while True:
            try:
                line = self._lines.get(timeout=max(end - time.monotonic(), 0.01))
            except queue.Empty:
                raise AssertionError(f"no '{start}' within {seconds} s") from None
            if line.startswith(start):
                return line

    def ask(self, expression: str) -> Any:
        """What an expression about the window `w` is now."""
        assert self.process.stdin is not None
        self.process.stdin.write(expression + "\n")
        self.process.stdin.flush()
        return json.loads(self._expect("=", 20)[1:])

    def until(self, expression: str, seconds: float = 15) -> Any:
        """Waits until an expression is true, and returns it."""
        end = time.monotonic() + seconds
        while True:
            found = self.ask(expression)
            if found:
                return found
            assert time.monotonic() < end, f"never true: {expression}"

    def tool(self, *arguments: object) -> None:
        """Moves, clicks and types: `xdotool` with these arguments."""
        command = ["xdotool", *(str(argument) for argument in arguments)]
        subprocess.run(command, check=True, env=self._environment, timeout=20)

    def key(self, key: str) -> None:
        """Presses a key."""
        self.tool("key", key)
        self.settle()

    def click(self, x: float, y: float, *how: object) -> None:
        """Clicks on a pixel, counted from the upper left corner of the window."""
        self.tool("mousemove", round(x), round(y), *(how or ("click", 1)))
        self.settle()

    def settle(self) -> None:
        """Waits until frames were shown: the first takes what the user did."""
        frames = self.ask("frames")
        self.until(f"frames >= {frames} + 3")

    def close(self) -> None:
        """Ends the process, as a user closes a window."""
        process = self.process
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            if process.poll() is None:
                process.stdin.write("w.gl.close_soon()\n")
                process.stdin.flush()
                process.wait(20)
        finally:
            process.kill()
            process.wait()
            self._reader.join()
            process.stdin.close()
            process.stdout.close()

    def __enter__(self) -> Driven:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
