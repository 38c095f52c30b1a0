"""MuJoCo Studio's web viewer, at the address its user names and silent where nothing changes."""

from __future__ import annotations

import contextlib
import io
import logging
import socket
import threading
import time
from typing import Any

import mujoco
from mujoco.studio import endpoints, viewer_protocol, web_viewer
from mujoco.studio.web import web_server
from websockets.exceptions import ConnectionClosed

from ...errors import RenderError
from .guard import Guard, GuardedRun
from .own_socket import OwnSocket
from .site import find_files, read_page

LOOPBACK = "127.0.0.1"
RATE = 60.0  # pictures/s
_UI_RATE = 30.0  # user interfaces/s
_ALIVE = 0.5  # s after which a state is sent although nothing has changed


class _Goodbyes(logging.Filter):
    """Leaves out that a browser was being sent something when the page ended."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is to be logged."""
        return record.exc_info is None or not isinstance(record.exc_info[1], ConnectionClosed)


_NO_GOODBYES = _Goodbyes()  # one, which is added once


class QuietServer(web_server.WebServer):
    """Sends no state twice: a scene in which nothing moves costs no network.

    Args:
        guard: is asked about every request.
        options: see Studio.

    Attributes:
        sent: states that were published.
        sent_bytes: what they came to for one browser.
        is_watched: whether a browser has ever looked.
    """

    def __init__(self, guard: Guard, **options: Any) -> None:
        super().__init__(**options)
        self._guard = guard
        self.sent = self.sent_bytes = 0
        self.is_watched = False
        self._last = b""
        self._last_time = 0.0

    def start(self) -> None:
        """Serves the page on a thread, and every request by way of the guard.

        Raises:
            RenderError: this Studio's server cannot be guarded.
        """
        run = GuardedRun(self._guard)
        self._stop_event.clear()
        self._thread = threading.Thread(target=run, args=(self, self._stop_event), daemon=True)
        self._thread.start()
        try:
            run.wait()
        except RenderError:
            self.stop()
            raise

    @property
    def models_generation(self) -> int:
        """See Studio, which asks for it on behalf of every browser and of nobody else."""
        self.is_watched = True
        return int(super().models_generation)

    def update_state(self, payload: bytes) -> None:
        """Publishes a state, where it differs from the last one or that is long ago."""
        now = time.monotonic()
        if payload == self._last and now - self._last_time < _ALIVE:
            return
        self._last, self._last_time = payload, now
        self.sent += 1
        self.sent_bytes += len(payload)
        super().update_state(payload)


class CalmUi:
    """Studio's user interface, fewer times a second than the scene.

    A browser takes a bounded number of its frames per picture; one that draws slowly would lag
    behind, and more so with every second.

    Args:
        ui: Studio's.

    Attributes:
        is_due: whether the frame of now has one.
    """

    def __init__(self, ui: Any) -> None:
        self._ui = ui
        self.is_due = False
        self._next = self._next_ui = 0.0

    def new_frame(self) -> bool:
        """Sleeps until the next picture and begins its user interface, if it has one."""
        time.sleep(max(self._next - time.monotonic(), 0.0))
        now = time.monotonic()
        self._next = max(self._next, now - 0.5 / RATE) + 1.0 / RATE  # late once is not late ever
        self.is_due = now >= self._next_ui
        if self.is_due:
            self._next_ui = now + 1.0 / _UI_RATE - 0.5 / RATE
            self.is_due = bool(self._ui.new_frame())  # not while a browser is being connected
        return True

    def end_frame(self) -> None:
        """Ends the user interface of the frame, if it has one."""
        if self.is_due:
            self._ui.end_frame()

    def upload_image(self, *image: Any) -> int:
        """See Studio."""
        return int(self._ui.upload_image(*image))


class StudioViewer(web_viewer.WebViewer):
    """Studio's `WebViewer` on one address; Studio 4.0 binds to all of them and cannot be told.

    Args:
        endpoint: see Studio.
        model: shown from the first picture on.
        address: to listen on.
        port: 0 for the first free one from 8080 on.
        token: that the page's address must have; None for none.
        title: of the page's user interface.
        plugins: of the viewer's side.
        camera: to look through; the browser moves it.

    Raises:
        RuntimeError: the port is taken.
        OSError: there is no such address here.
        RenderError: this MuJoCo has no files for browsers.
    """

    _web_server: QuietServer | None
    _headless_ui: Any
    _tcp_sock: socket.socket

    def __init__(
        self,
        endpoint: endpoints.ViewerEndpoint,
        model: mujoco.MjModel,
        *,
        address: str,
        port: int,
        token: str | None,
        title: str,
        plugins: list[Any],
        camera: mujoco.MjvCamera,
    ) -> None:
        self.address = address
        self._token = token
        self._page = read_page(title)
        config = viewer_protocol.ViewerConfig(title=title, http_port=port)
        with quiet():  # its banner does not know what is shown, nor who asked for which address
            super().__init__(config, endpoint, model=model, plugins=plugins, camera=camera)
        self._headless_ui = CalmUi(self._headless_ui)
        # Who connects and leaves is told by the panel; CI logs need not repeat it.
        logging.getLogger("WebServer").setLevel(logging.WARNING)
        # A browser that is killed, or a port scanner, is no error worth a traceback.
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        logging.getLogger("asyncio").addFilter(_NO_GOODBYES)

    @property
    def _host(self) -> str:
        return self.address

    @_host.setter
    def _host(self, value: str) -> None:
        """Studio's constructor wants all interfaces; the user's choice stands."""

    def _start_server(self) -> None:
        self._tcp_sock = OwnSocket(fileno=self._tcp_sock.detach())
        bound = self._http_sock.getsockname()[0]
        self._web_server = QuietServer(
            Guard(self._page, bound, self.address, self._token),
            http_sock=self._http_sock,
            tcp_sock=self._tcp_sock,
            static_files_dir=str(find_files()),
        )
        self._update_model()
        try:
            self._web_server.start()
        except RenderError:
            self._http_sock.close()
            self._tcp_sock.close()
            raise

    @property
    def has_ui(self) -> bool:
        """Whether the frame of now has a user interface."""
        return bool(self._headless_ui.is_due)

    @property
    def port(self) -> int:
        """Where the page is served."""
        return int(self._http_port)

    @property
    def server(self) -> QuietServer:
        """The server of the page."""
        assert self._web_server is not None
        return self._web_server

    def close(self) -> None:
        """Ends the page."""
        super().close()
        # A second one in this process crashes where the first one's still exists.
        self._headless_ui = None

    def change_model(self, bundle: bytes, crc32: int) -> None:
        """Makes browsers show a model that has the same joints and other colours."""
        self._model_crc32 = crc32
        self.server.update_model(bundle, crc32)

    def get_drop_file(self) -> str:
        """No file: what is dropped onto the page would replace the scene; the guard refuses it."""
        return ""


@contextlib.contextmanager
def quiet() -> Any:
    """Keeps what Studio prints to itself."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
