"""`ViewerProcess`: starts and controls the process of a viewer from the user's program.

Both processes exchange pickled messages over the standard input and output of the viewer's process,
which ends when its input is closed. If the process dies, its standard error is reported.
"""

from __future__ import annotations

import io
import logging
import os
import pickle
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import mujoco

from ...base.child_process import ChildProcess
from ...base.errors import RenderError, UsageError
from ...robots.importers.mjcf_file import as_spec, is_mjcf_object
from ..image.image_files import Pixels
from ..image.picking import Picked

log = logging.getLogger(__name__)

# The viewer's process uses the module search path of the user's program.
_PROGRAM = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from sero_mj.viewer.program.process_main import main; main()"
)
_CLOSE_TIMEOUT = 5.0  # time after which the process is killed, s
_IMAGE_TIMEOUT = 30.0  # s; software rendering takes several seconds for the first image
_MAX_CLICKS = 1000  # maximum number of clicks that have not been handled


class ViewerProcess:
    """The process of a viewer, which shows a scene or an overlay.

    The process imports modules while the user's program compiles the scene. Call `describe`, then
    `open`.

    Attributes:
        clicks: clicked items and gestures, oldest first. The caller removes each click that it
            handles.
        is_open: whether the process is running.
        answers: mapping from tool names to functions that receive the messages of the tool. They
            are called on another thread.
    """

    def __init__(self, *, is_window: bool) -> None:
        environment = {**os.environ, **({"MUJOCO_GL": "glfw"} if is_window else {})}
        # The child has its own process group, so that Ctrl+C only interrupts the user's program.
        self._child = ChildProcess(
            [sys.executable, "-c", _PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
        )
        self._process = self._child.process
        self.clicks: deque[tuple[Picked | None, str]] = deque(maxlen=_MAX_CLICKS)
        self.is_open = True
        self.answers: dict[str, Callable[[Any], None]] = {}
        self._owner = os.getpid()
        self._is_closing = False  # also True if the user has closed the viewer
        self._images: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self._requested = 0  # number of the last requested image
        self._listener = threading.Thread(target=self._listen, daemon=True, name="sero-mj viewer")
        self._sending = threading.Lock()
        self._send(sys.path)

    def _send(self, message: Any) -> bool:
        assert self._process.stdin is not None
        try:
            with self._sending:
                self._process.stdin.write(pickle.dumps(message))
                self._process.stdin.flush()
        except (OSError, ValueError):  # The process has ended, and `_listen` reports the reason.
            return False
        return True

    def send(self, tool: str, message: Any) -> bool:
        """Sends a message to a tool of the viewer, and returns whether the process is running."""
        return self._send(("message", tool, message))

    def describe(self, shown: Any) -> None:
        """Sends a scene or model to the viewer's process, which compiles it.

        Raises:
            UsageError: the scene cannot be pickled.
        """
        level = logging.getLogger("sero_mj").getEffectiveLevel()
        self._send(("describe", _pickled(shown), level))

    def open(self, memory: str, options: dict[str, Any]) -> list[str]:
        """Opens the window or page and the scene's sources, and returns the addresses of the page.

        Args:
            memory: path of the shared memory.

        Raises:
            SeroError: an error in the viewer's process.
            RenderError: the process has died.
        """
        self._send(("open", memory, options))
        assert self._process.stdout is not None
        while True:
            try:
                kind, *rest = pickle.load(self._process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):
                how = self._ending()
                raise RenderError(f"the viewer process ended before it opened: {how}") from None
            if kind == "ready":
                self._listener.start()
                urls: list[str] = rest[0]
                return urls
            if kind == "failed":
                error: Exception = rest[0]
                raise error
            self._take(kind, rest)

    def _listen(self) -> None:
        stdout = self._process.stdout
        assert stdout is not None
        with suppress(EOFError, OSError, ValueError, pickle.UnpicklingError):
            while True:
                kind, *rest = pickle.load(stdout)
                self._take(kind, rest)
        self.is_open = False
        self._images.put((-1, None))
        if not self._is_closing:
            log.warning("the viewer process ended; your program continues: %s", self._ending())

    def _take(self, kind: str, rest: list[Any]) -> None:
        if kind == "click":
            picked, gesture = rest
            self.clicks.append((picked, gesture))
        elif kind == "image":
            number, found = rest
            self._images.put((number, found))
        elif kind == "answer":
            tool, answer = rest
            if tool in self.answers:
                self.answers[tool](answer)
        elif kind == "log":
            name, level, text = rest
            logging.getLogger(name).log(level, "%s", text)
        elif kind == "closed":
            self._is_closing, self.is_open = True, False

    def _ending(self) -> str:
        try:
            self._process.wait(_CLOSE_TIMEOUT)
        except subprocess.TimeoutExpired:  # The process runs, but its output is not a message.
            self._process.kill()
            self._process.wait()
        how, lines = self._child.status, self._child.lines()
        return f"{how}; last output: {lines[-1]}" if lines else how

    def image(self) -> Pixels:
        """Returns the next image of the viewer, shape (height, width, 3), uint8.

        Raises:
            RenderError: the viewer is closed, or cannot render.
        """
        self._requested += 1
        is_there = self.is_open and self._send(("image", self._requested))
        end = time.monotonic() + _IMAGE_TIMEOUT
        while is_there:
            try:
                number, found = self._images.get(timeout=max(end - time.monotonic(), 0.0))
            except queue.Empty:
                text = f"the viewer has not rendered an image within {_IMAGE_TIMEOUT:g} s"
                raise RenderError(text) from None
            if number == -1:
                break
            if number != self._requested:
                continue  # This is the image of an earlier request.
            if isinstance(found, Exception):
                raise found
            pixels: Pixels = found
            return pixels
        raise RenderError("cannot render an image: the viewer is closed")

    def close(self, *, at_once: bool = False) -> None:
        if os.getpid() != self._owner:
            return  # This process is a fork of the process that started the viewer.
        self._is_closing, self.is_open = True, False
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        is_mine = self._sending.acquire(timeout=_CLOSE_TIMEOUT)
        if at_once or not is_mine:  # Another thread may be blocked in `_send`.
            process.kill()
        with suppress(OSError, ValueError):
            process.stdin.close()
        if is_mine:
            self._sending.release()
        try:
            process.wait(_CLOSE_TIMEOUT)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if self._listener.is_alive() and self._listener is not threading.current_thread():
            self._listener.join()
        if not self._listener.is_alive():
            self._child.end()


class _Pickler(pickle.Pickler):
    def reducer_override(self, item: Any) -> Any:
        if isinstance(item, type) or not is_mjcf_object(item):
            return NotImplemented
        spec = as_spec(item, Path())
        return _spec_of, (spec.to_xml(), dict(spec.assets))


def _spec_of(text: str, assets: dict[str, bytes]) -> mujoco.MjSpec:
    return mujoco.MjSpec.from_string(text, assets=assets)


def _pickled(shown: Any) -> bytes:
    buffer = io.BytesIO()
    try:
        _Pickler(buffer).dump(shown)
    except (TypeError, AttributeError, pickle.PicklingError) as error:
        raise UsageError(
            f"the scene cannot be sent to the viewer's process ({error}). Its sources and "
            "functions must be picklable; define them at the top level of a module"
        ) from error
    return buffer.getvalue()
