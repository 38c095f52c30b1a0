"""`ViewerProcess`: the process that shows a viewer, from the side of the one that uses it.

The two talk in pickled messages over the standard input and output of the process, which ends by
itself when its input ends: when this process closes it, has ended, or was killed. What it writes
on its standard error is kept in a file, and told when it dies.
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

# The package is found where this process has found it, whatever the folder.
_PROGRAM = (
    "import pickle, sys; sys.path[:] = pickle.load(sys.stdin.buffer); "
    "from sero_mj.viewer.program.process_main import main; main()"
)
_CLOSE_TIMEOUT = 5.0  # s that it has to close by itself
_PICTURE_TIMEOUT = 30.0  # s to wait for a picture; software takes a second or two for the first
_MAX_CLICKS = 1000  # that wait to be taken


class ViewerProcess:
    """A process of its own, which shows a scene or an overlay.

    It begins to load while this process compiles the scene; then comes `describe`, then `open`.

    Attributes:
        clicks: what was clicked on and how, oldest first; whoever handles them takes them out.
        is_open: whether it shows, or is about to.
        answers: takes what a tool of the view sends, by the tool's name; called by another thread.
    """

    def __init__(self, *, is_window: bool) -> None:
        environment = {**os.environ, **({"MUJOCO_GL": "glfw"} if is_window else {})}
        # A group of its own: Ctrl+C in the terminal is for the user's loop.
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
        self._is_closing = False  # or has said that its user has closed it
        self._pictures: queue.SimpleQueue[tuple[int, Any]] = queue.SimpleQueue()
        self._wanted = 0  # number of the last picture that was asked for
        self._listener = threading.Thread(target=self._listen, daemon=True, name="sero-mj viewer")
        self._sending = threading.Lock()
        self._send(sys.path)

    def _send(self, message: Any) -> bool:
        assert self._process.stdin is not None
        try:
            with self._sending:
                self._process.stdin.write(pickle.dumps(message))
                self._process.stdin.flush()
        except (OSError, ValueError):  # it has ended; `_listen` tells why
            return False
        return True

    def tell(self, tool: str, message: Any) -> bool:
        """Sends a message to a tool of the view; returns whether it was there to receive it."""
        return self._send(("tell", tool, message))

    def describe(self, shown: Any) -> None:
        """Says what is shown, so that it is compiled there while this process goes on.

        Raises:
            UsageError: it cannot be handed over.
        """
        level = logging.getLogger("sero_mj").getEffectiveLevel()
        self._send(("describe", _pickled(shown), level))

    def open(self, memory: str, options: dict[str, Any]) -> list[str]:
        """Opens window or page, and the scene's sources; returns the page's addresses.

        Args:
            memory: path of what is shared with it.

        Raises:
            SeroError: as raised there.
            RenderError: it has died.
        """
        self._send(("open", memory, options))
        assert self._process.stdout is not None
        while True:
            try:
                kind, *rest = pickle.load(self._process.stdout)
            except (EOFError, OSError, pickle.UnpicklingError):
                how = self._ending()
                raise RenderError(f"the viewer has died before it opened: {how}") from None
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
        self._pictures.put((-1, None))
        if not self._is_closing:
            log.warning("the viewer has died, your program goes on: %s", self._ending())

    def _take(self, kind: str, rest: list[Any]) -> None:
        if kind == "click":
            picked, gesture = rest
            self.clicks.append((picked, gesture))
        elif kind == "picture":
            number, found = rest
            self._pictures.put((number, found))
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
        except subprocess.TimeoutExpired:  # it lives, and says nothing that can be understood
            self._process.kill()
            self._process.wait()
        how, said = self._child.status, self._child.lines()
        return f"{how}; it wrote: {said[-1]}" if said else how

    def picture(self) -> Pixels:
        """Returns the picture that is shown next, (height, width, 3), uint8.

        Raises:
            RenderError: it is closed, or cannot make one.
        """
        self._wanted += 1
        is_there = self.is_open and self._send(("picture", self._wanted))
        end = time.monotonic() + _PICTURE_TIMEOUT
        while is_there:
            try:
                number, found = self._pictures.get(timeout=max(end - time.monotonic(), 0.0))
            except queue.Empty:
                raise RenderError(
                    f"the viewer has made no picture in {_PICTURE_TIMEOUT:g} s"
                ) from None
            if number == -1:
                break
            if number != self._wanted:
                continue  # one that came too late
            if isinstance(found, Exception):
                raise found
            pixels: Pixels = found
            return pixels
        raise RenderError("no picture: the viewer is closed")

    def close(self, *, at_once: bool = False) -> None:
        if os.getpid() != self._owner:
            return  # a copy of the process that started it, see `os.fork`
        self._is_closing, self.is_open = True, False
        process = self._process
        assert process.stdin is not None
        assert process.stdout is not None
        is_mine = self._sending.acquire(timeout=_CLOSE_TIMEOUT)
        if at_once or not is_mine:  # it takes nothing any more, and another thread waits for it
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
    """Pickles what scenes are made of."""

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
            f"scene: cannot be handed to the viewer's process ({error}); sources and functions in "
            "it must be picklable: defined at the top of a module"
        ) from error
    return buffer.getvalue()
