"""What the process of a viewer runs: it shows a scene or an overlay until it is told to end.

Messages come from `process.py` on the standard input. It ends when the last of them has come,
so it never outlives the process that has started it.
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
from ..host.live import LiveHost
from .memory import OverlayMemory, SceneMemory, ViewerMemory

log = logging.getLogger(__name__)

_HIDDEN_INTERVAL = 0.1  # s between two frames of a page that no browser shows
_CLOSE_TIMEOUT = 5.0  # s after which it ends, even if the host does not come back from drawing


def main() -> None:
    """Shows the scene or overlay of its arguments, and ends the process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    user = _User()
    status = 0
    try:
        _show(user)
        user.send("closed")
    except SeroError as error:
        user.send("failed", error)
        if user.is_shown:
            status = 1
            print(error, file=sys.stderr)
    except Exception:
        status = 1
        print_exc()
    except SystemExit:
        pass  # it was closed before it was shown
    sys.stderr.flush()
    # At once: drivers and threads have nothing left to do, and the reader of messages still waits.
    os._exit(status)


class _User:
    """The process that uses the viewer."""

    def __init__(self) -> None:
        self.is_shown = False
        self._process = os.getppid()
        self.messages: queue.SimpleQueue[tuple[Any, ...] | None] = queue.SimpleQueue()
        # What anybody else prints here is kept apart from the messages.
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
        with suppress(OSError), self._sending:  # it is gone; `_listen` hears of it as well
            self._out.write(pickle.dumps(message))
            self._out.flush()


class _LogSender(logging.Handler):
    def __init__(self, user: _User) -> None:
        super().__init__()
        self._user = user

    def emit(self, record: logging.LogRecord) -> None:
        self._user.send("log", record.name, record.levelno, record.getMessage())


class _SceneMirror(Mirror):
    """Follows the sources of a scene, and before these what its user sets."""

    take: Callable[[], None]

    def advance(self, now: float | None = None) -> bool:
        self.take()
        return super().advance(now)


class _OverlayMirror(Watch):
    """Follows the state of a model that its user steps."""

    take: Callable[[], None]

    def advance(self, now: float | None = None) -> bool:
        self.take()
        return super().advance(now)


def _show(user: _User) -> None:
    pickled, level = user.receive("describe")
    mirror, make_memory = _mirror_of(pickled)
    # From here on: the user's process has compiled the same, and warned of the same.
    logging.getLogger("sero_mj").setLevel(level)
    logging.getLogger().addHandler(_LogSender(user))
    path, options = user.receive("open")
    memory = make_memory(Path(path))
    mirror.take = memory.apply
    mirror.take()
    mirror.open()
    try:
        with _open_host(mirror, options) as host:
            host.pointer.on_click = lambda picked, gesture: user.send("click", picked, gesture)
            host.frame()
            memory.show()
            user.send("ready", getattr(host, "urls", []))
            user.is_shown = True
            _serve(user, host, memory)
    finally:
        mirror.close()


def _mirror_of(pickled: bytes) -> tuple[Any, Callable[[Path], ViewerMemory]]:
    try:
        shown = pickle.loads(pickled)
    except (AttributeError, ImportError) as error:
        raise UsageError(
            f"scene: cannot be read by the viewer's process ({error}); sources and other classes "
            "of your own must be defined in a module that can be imported, not in the script or "
            "notebook itself"
        ) from None
    if isinstance(shown, Scene):
        scene = _SceneMirror(shown)
        return scene, lambda path: SceneMemory(scene.world, scene.data, path)
    model, options = shown
    world = ModelWorld(model, mujoco.MjData(model), **options)
    return _OverlayMirror(world), lambda path: OverlayMemory(world, path)


def _open_host(mirror: LiveWorld, options: dict[str, Any]) -> LiveHost:
    last = options.pop("last", {})  # the port of the page that is opened again
    if options.pop("web"):
        from .viewer import open_page

        try:
            page = open_page(mirror, **{**last, **options})
        except RenderError:
            if not last or "port" in options:
                raise
            # Another program has the port by now.
            page = open_page(mirror, **options)
        return page
    from ..window.host import Window

    return Window(mirror, **options)


def _serve(user: _User, host: LiveHost, memory: ViewerMemory) -> None:
    while host.frame() and not user.is_gone:
        memory.show()
        for name, tool in host.tools.items():
            answer = host.tools.call(tool, lambda tool: tool.answer())
            if answer is not None:
                user.send("answer", name, answer)
        timeout = 0.0 if host.is_seen else _HIDDEN_INTERVAL
        with suppress(queue.Empty):
            while True:
                message = user.messages.get(timeout=timeout)
                if message is None:
                    return
                _take(message, user, host, memory)
                timeout = 0.0


def _take(message: tuple[Any, ...], user: _User, host: LiveHost, memory: ViewerMemory) -> None:
    kind, *rest = message
    if kind == "tell":
        name, words = rest
        if name in host.tools:
            host.tools.call(host.tools[name], lambda tool: tool.hear(words))
    else:
        (number,) = rest
        host.frame()  # with all that was set before it was asked for
        memory.show()
        user.send("picture", number, _picture(host))


def _picture(host: LiveHost) -> Any:
    try:
        return host.picture()
    except SeroError as error:
        return error
