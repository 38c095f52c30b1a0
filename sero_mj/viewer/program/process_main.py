"""The main function of a viewer's process, which shows a scene or an overlay.

`process.py` sends messages to the standard input. The end of this input means that the user's
program has ended, so the viewer closes.
"""

from __future__ import annotations

import logging
import os
import pickle
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from traceback import print_exc
from typing import Any

import mujoco

from ...base.errors import RenderError, SeroError, UsageError
from ...data.drive.mirror import LiveWorld, Mirror, Watch
from ...robots.declared.scene import Scene
from ...robots.external.model_world import ModelWorld
from ..host.live import HIDDEN_INTERVAL, LiveHost
from .memory import OverlayMemory, SceneMemory, ViewerMemory

log = logging.getLogger(__name__)

_CLOSE_TIMEOUT = 5.0  # time after which the process ends, even while it renders, s


def main() -> None:
    """Shows the scene or overlay of the first message until it is closed, then ends the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    program = _Program()
    status = 0
    try:
        _show(program)
        program.send("closed")
    except SeroError as error:
        program.send("failed", error)
        if program.is_shown:
            status = 1
            print(error, file=sys.stderr)
    except Exception:
        status = 1
        print_exc()
    except SystemExit:
        pass  # The program has ended before the viewer was open.
    sys.stderr.flush()
    # The process must end at once, because a thread is still waiting for messages.
    os._exit(status)


class _Program:
    def __init__(self) -> None:
        self.is_shown = False
        self._process = os.getppid()
        self.messages: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
        # Messages use a copy of the standard output, and printed text goes to the standard error.
        self._out = os.fdopen(os.dup(1), "wb")
        os.dup2(2, 1)
        self._sending = threading.Lock()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self.messages.put(pickle.load(sys.stdin.buffer))
        self.messages.put(None)
        time.sleep(_CLOSE_TIMEOUT)
        os._exit(1)

    @property
    def is_gone(self) -> bool:
        return os.getppid() != self._process

    def receive(self, kind: str) -> tuple[Any, ...]:
        message = self.messages.get()
        if message is None:
            raise SystemExit
        assert message[0] == kind
        return message[1:]

    def send(self, *message: Any) -> None:
        # If the program has ended, `_listen` detects it.
        with suppress(OSError), self._sending:
            self._out.write(pickle.dumps(message))
            self._out.flush()


class _LogSender(logging.Handler):
    def __init__(self, program: _Program) -> None:
        super().__init__()
        self._program = program

    def emit(self, record: logging.LogRecord) -> None:
        self._program.send("log", record.name, record.levelno, record.getMessage())


class _SceneMirror(Mirror):
    """A mirror that applies the inputs of the user's program before those of the sources."""

    take: Callable[[], None]

    def advance(self, now: float | None = None) -> bool:
        self.take()
        return super().advance(now)


class _OverlayMirror(Watch):
    """A mirror of a model that the user's program steps."""

    take: Callable[[], None]

    def advance(self, now: float | None = None) -> bool:
        self.take()
        return super().advance(now)


def _show(program: _Program) -> None:
    pickled, level = program.receive("describe")
    mirror, make_memory = _mirror_of(pickled)
    # The user's program has already logged the warnings that occur above.
    logging.getLogger("sero_mj").setLevel(level)
    logging.getLogger().addHandler(_LogSender(program))
    path, options = program.receive("open")
    memory = make_memory(Path(path))
    mirror.take = memory.apply
    mirror.take()
    mirror.open()
    try:
        with _open_host(mirror, options) as host:
            host.pointer.on_click = lambda picked, gesture: program.send("click", picked, gesture)
            host.frame()
            memory.show()
            program.send("ready", getattr(host, "urls", []))
            program.is_shown = True
            _serve(program, host, memory)
    finally:
        mirror.close()


def _mirror_of(pickled: bytes) -> tuple[Any, Callable[[Path], ViewerMemory]]:
    try:
        shown = pickle.loads(pickled)
    except (AttributeError, ImportError) as error:
        raise UsageError(
            f"the scene cannot be read by the viewer's process ({error}). Define your own sources "
            "and other classes in a module that can be imported, not in the script or notebook "
            "itself"
        ) from None
    if isinstance(shown, Scene):
        scene = _SceneMirror(shown)
        return scene, lambda path: SceneMemory(scene.world, scene.data, path)
    model, options = shown
    world = ModelWorld(model, mujoco.MjData(model), **options)
    return _OverlayMirror(world), lambda path: OverlayMemory(world, path)


def _open_host(mirror: LiveWorld, options: dict[str, Any]) -> LiveHost:
    last = options.pop("last", {})  # port of the page that is opened again
    if options.pop("web"):
        from .viewer import open_page

        try:
            page = open_page(mirror, **{**last, **options})
        except RenderError:
            if not last or "port" in options:
                raise
            # Another program may use the port now.
            page = open_page(mirror, **options)
        return page
    from ..window.host import Window

    return Window(mirror, **options)


def _serve(program: _Program, host: LiveHost, memory: ViewerMemory) -> None:
    while host.frame() and not program.is_gone:
        memory.show()
        for name, tool in host.tools.items():
            answer = host.tools.call(tool, lambda tool: tool.reply())
            if answer is not None:
                program.send("answer", name, answer)
        timeout = 0.0 if host.is_seen else HIDDEN_INTERVAL
        with suppress(queue.Empty):
            while True:
                message = program.messages.get(timeout=timeout)
                if message is None:
                    return
                _take(message, program, host, memory)
                timeout = 0.0


def _take(
    message: tuple[Any, ...], program: _Program, host: LiveHost, memory: ViewerMemory
) -> None:
    kind, *rest = message
    if kind == "message":
        name, contents = rest
        if name in host.tools:
            host.tools.call(host.tools[name], lambda tool: tool.receive(contents))
    else:
        (number,) = rest
        host.frame()  # The image must show the inputs that were set before the request.
        memory.show()
        program.send("image", number, _image(host))


def _image(host: LiveHost) -> Any:
    try:
        return host.image()
    except SeroError as error:
        return error
