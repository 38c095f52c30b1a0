"""MuJoCo Studio's web viewer, at the address its user names and silent where nothing changes."""

from __future__ import annotations

import contextlib
import io
import logging
import time
from typing import Any

import mujoco
from mujoco.studio import endpoints, viewer_protocol, web_viewer
from mujoco.studio.web import web_server

LOOPBACK = "127.0.0.1"
_ALIVE = 0.5  # s after which a state is sent although nothing has changed


class QuietServer(web_server.WebServer):
    """Sends no state twice: a scene in which nothing moves costs no network.

    Attributes:
        sent: states that were published.
        sent_bytes: what they came to for one browser.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.sent = self.sent_bytes = 0
        self._last = b""
        self._last_time = 0.0

    def update_state(self, payload: bytes) -> None:
        """Publishes a state, where it differs from the last one or that is long ago."""
        now = time.monotonic()
        if payload == self._last and now - self._last_time < _ALIVE:
            return
        self._last, self._last_time = payload, now
        self.sent += 1
        self.sent_bytes += len(payload)
        super().update_state(payload)


class StudioViewer(web_viewer.WebViewer):
    """Studio's `WebViewer` on one address; Studio 4.0 binds to all of them and cannot be told.

    Args:
        endpoint: see Studio.
        model: shown from the first picture on.
        address: to listen on.
        port: 0 for the first free one from 8080 on.
        title: of the page's user interface.
        plugins: of the viewer's side.
        camera: to look through; the browser moves it.

    Raises:
        RuntimeError: the port is taken.
        OSError: there is no such address here.
    """

    _web_server: QuietServer | None

    def __init__(
        self,
        endpoint: endpoints.ViewerEndpoint,
        model: mujoco.MjModel,
        *,
        address: str,
        port: int,
        title: str,
        plugins: list[Any],
        camera: mujoco.MjvCamera,
    ) -> None:
        self.address = address
        config = viewer_protocol.ViewerConfig(title=title, http_port=port)
        with quiet():  # its banner does not know what is shown, nor who asked for which address
            super().__init__(config, endpoint, model=model, plugins=plugins, camera=camera)
        # Who connects and leaves is told by the panel; CI logs need not repeat it.
        logging.getLogger("WebServer").setLevel(logging.WARNING)

    @property
    def _host(self) -> str:
        return self.address

    @_host.setter
    def _host(self, value: str) -> None:
        """Studio's constructor wants all interfaces; the user's choice stands."""

    def _start_server(self) -> None:
        self._web_server = QuietServer(
            http_sock=self._http_sock, tcp_sock=self._tcp_sock, drop_queue=self._drop_queue
        )
        self._update_model()
        self._web_server.start()

    @property
    def port(self) -> int:
        """Where the page is served."""
        return int(self._http_port)

    @property
    def server(self) -> QuietServer:
        """The server of the page."""
        assert self._web_server is not None
        return self._web_server

    def change_model(self, bundle: bytes, crc32: int) -> None:
        """Makes browsers show a model that has the same joints and other colours."""
        self._model_crc32 = crc32
        self.server.update_model(bundle, crc32)

    def get_drop_file(self) -> str:
        """No file: what is dropped onto the page would replace the scene, and is refused."""
        while not self._drop_queue.empty():
            self._drop_queue.get_nowait()
            logging.getLogger(__name__).warning(
                "a file was dropped onto the page and left out: the page shows one scene"
            )
        return ""


@contextlib.contextmanager
def quiet() -> Any:
    """Keeps what Studio prints to itself."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield
