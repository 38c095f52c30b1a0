"""MuJoCo Studio's web viewer and its page, with a configurable address and a title."""

from __future__ import annotations

import contextlib
import copy
import hashlib
import html
import io
import logging
import socket
import threading
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco.studio import endpoints, viewer_protocol, web_viewer
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.web import state_payload, web_server
from websockets.exceptions import ConnectionClosed

from ...base.errors import RenderError
from ..mujoco_private import PrivateViewer, page_files
from .browsers import Browsers
from .guard import Guard, GuardedRun, SameProcessSocket
from .uploads import SCRIPT

LOOPBACK = "127.0.0.1"
RATE = 60.0  # pictures/s
_UI_RATE = 30.0  # frames/s of the user interface
_ALIVE = 0.5  # maximum time between two states that are sent, s
_HEAD = f"{SCRIPT}\n{Path(__file__).with_name('page_head.html').read_text('utf-8').rstrip()}"


class _DisconnectFilter(logging.Filter):
    """Suppresses records of connections that were closed while data was sent."""

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether a record is to be logged."""
        return record.exc_info is None or not isinstance(record.exc_info[1], ConnectionClosed)


_DISCONNECT_FILTER = _DisconnectFilter()  # a single instance, so that it is added only once


class ChangesOnlyServer(web_server.WebServer):
    """Studio's server, which sends a state only if it has changed.

    Args:
        guard: checks every request.
        options: see Studio.

    Attributes:
        sent: number of published states.
        sent_bytes: their size for one browser, bytes.
        is_watched: whether a browser has ever connected.
        browsers: those that are connected.
    """

    def __init__(self, guard: Guard, **options: Any) -> None:
        super().__init__(**options)
        self._guard = guard
        self.browsers = Browsers()
        self.sent = self.sent_bytes = 0
        self.is_watched = False
        self._last = b""
        self._last_time = 0.0

    def start(self) -> None:
        """Serves the page on a thread, with every request checked by the guard.

        Raises:
            RenderError: the guard does not work with this version of Studio.
        """
        run = GuardedRun(self._guard, self.browsers)
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
        """See Studio, which reads it only when a browser connects."""
        self.is_watched = True
        return int(super().models_generation)

    def set_theme(self, theme: str) -> None:
        """Ignores the theme of a browser's bar, which every browser sends when it takes control.

        The theme of the page is the user's choice in its menu.
        """

    def update_state(self, payload: bytes) -> None:
        """Publishes a state if it differs from the last one, or after a while."""
        now = time.monotonic()
        if payload == self._last and now - self._last_time < _ALIVE:
            return
        self._last, self._last_time = payload, now
        self.sent += 1
        self.sent_bytes += len(payload)
        super().update_state(payload)


class ThrottledUi:
    """Studio's user interface, at a lower frame rate than the scene.

    A browser processes a limited number of its frames per picture, so that a slow one would lag
    behind by an increasing delay.

    Args:
        ui: Studio's.

    Attributes:
        is_due: whether the current frame includes the user interface.
    """

    def __init__(self, ui: Any) -> None:
        self._ui = ui
        self.is_due = False
        self._next = self._next_ui = 0.0

    def new_frame(self) -> bool:
        """Sleeps until the next picture and starts its user interface, if it is due."""
        time.sleep(max(self._next - time.monotonic(), 0.0))
        now = time.monotonic()
        # A late frame does not delay the following ones.
        self._next = max(self._next, now - 0.5 / RATE) + 1.0 / RATE
        self.is_due = now >= self._next_ui
        if self.is_due:
            self._next_ui = now + 1.0 / _UI_RATE - 0.5 / RATE
            self.is_due = bool(self._ui.new_frame())  # false while a browser is connecting
        return True

    def end_frame(self) -> None:
        """Ends the user interface of the frame, if it is due."""
        if self.is_due:
            self._ui.end_frame()

    def upload_image(self, *image: Any) -> int:
        """See Studio."""
        return int(self._ui.upload_image(*image))


class StudioViewer(PrivateViewer, web_viewer.WebViewer):
    """Studio's `WebViewer` on a given address.

    Args:
        endpoint: see Studio.
        model: the initial model.
        address: to listen on.
        port: 0 for the first free one from 8080 on.
        token: required in the page's address; None for none.
        title: of the page's user interface.
        plugins: of the viewer.
        camera: the initial camera; the browser moves it.

    Attributes:
        server: of the page.

    Raises:
        RuntimeError: the port is taken.
        OSError: this machine does not have the address.
        RenderError: this MuJoCo does not include the files for browsers.
    """

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
        self.address, self.wanted_port = address, port
        self._token = token
        self._page = read_page(title, fingerprint(model, title))
        config = viewer_protocol.ViewerConfig(title=title, http_port=port)
        with suppress_output():  # of Studio's banner, which has not the right address
            super().__init__(config, endpoint, model=model, plugins=plugins, camera=camera)
        self.ui = ThrottledUi(self.ui)
        # Connections are shown by the panel and need not be logged.
        logging.getLogger("WebServer").setLevel(logging.WARNING)
        # Killed browsers and port scanners are not worth a traceback.
        logging.getLogger("websockets").setLevel(logging.CRITICAL)
        logging.getLogger("asyncio").addFilter(_DISCONNECT_FILTER)

    def make_server(self, http: socket.socket, tcp: socket.socket) -> ChangesOnlyServer:
        """See `PrivateViewer`."""
        self.server = ChangesOnlyServer(
            Guard(self._page, http.getsockname()[0], self.address, self._token),
            http_sock=http,
            tcp_sock=tcp,
            static_files_dir=str(page_files()),
        )
        return self.server

    def guarded(self, tcp: socket.socket) -> socket.socket:
        """See `PrivateViewer`: nobody else takes the place of the user interface."""
        return SameProcessSocket(fileno=tcp.detach())

    def prepare_next_frame(self) -> bool:
        """Starts the next frame; keeps the camera while the mouse drags a window of the page.

        A browser turns the view until it hears that the pointer is over a window.
        """
        camera, kept = self.camera, copy.copy(self.camera)
        is_ready = bool(super().prepare_next_frame())
        if imgui.GetIO().WantCaptureMouse and imgui.IsMouseDown(int(imgui.MouseButton.Left)):
            camera.lookat[:], camera.distance = kept.lookat, kept.distance
            camera.azimuth, camera.elevation = kept.azimuth, kept.elevation
        return is_ready

    def payload(self, geoms: list[mujoco.MjvGeom]) -> bytes:
        """Returns the current state as `sync` sends it to browsers, with other decor.

        Args:
            geoms: of the decor.
        """
        spec = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self.model, spec))
        mujoco.mj_getState(self.model, self.data, state, spec)
        io = imgui.GetIO()
        return bytes(
            state_payload.serialize_state_payload(
                self.model_checksum,
                int(spec),
                state.tobytes(),
                self.camera,
                self.perturb,
                self.vis_options,
                self.model,
                list(self.render_flags.flags),
                geoms[: state_payload.MAX_EXTRA_GEOMS],
                state_payload.ViewerInputState(
                    mouse_focus=not io.WantCaptureMouse,
                    camera_index=self.camera_index,
                    keyboard_focus=not io.WantCaptureKeyboard,
                    camera_generation=self.client_camera.update_generation(self.camera),
                ),
            )
        )

    @property
    def has_ui(self) -> bool:
        """Whether the current frame includes the user interface."""
        return bool(self.ui.is_due)

    def close(self) -> None:
        """Closes the page."""
        super().close()
        # Another viewer in this process would crash while this one's user interface exists.
        self.ui = None

    def get_drop_file(self) -> str:
        """Returns no file: those that are dropped on the page do not go through Studio."""
        return ""


@contextlib.contextmanager
def suppress_output() -> Any:
    """Suppresses what Studio prints."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


def fingerprint(model: mujoco.MjModel, title: str) -> str:
    """Returns the same text for the same scene, so that its page can go on when it is served again.

    Args:
        model: of the scene.
        title: of the page.
    """
    digest = hashlib.sha256(title.encode())
    for part in (model.names, model.geom_size.tobytes(), model.body_pos.tobytes()):
        digest.update(part)
    return digest.hexdigest()[:16]


def with_head(page: str, title: str, scene: str = "") -> str:
    """Returns Studio's page with title and additions, where its head matches the expected text.

    Args:
        page: Studio's.
        title: of the browser's tab.
        scene: its `fingerprint`.
    """
    start, found, rest = page.partition("<title>")
    if found:
        page = start + found + html.escape(title) + rest[rest.find("</title>") :]
    head = _HEAD.replace('"SCENE"', f'"{scene}"')
    return page.replace("  </head>", head, 1)


def read_page(title: str, scene: str = "") -> bytes:
    """Returns the page, which refers to Studio's files.

    Args:
        title: of the browser's tab.
        scene: its `fingerprint`.

    Raises:
        RenderError: this MuJoCo has no page.
    """
    return with_head((page_files() / "index.html").read_text("utf-8"), title, scene).encode()
