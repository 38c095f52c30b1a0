"""What sero-mj uses of MuJoCo that is not public: all of it stands here, each with its reason.

Therefore `mujoco>=4.0,<4.1`. Where another version lacks a part, `RenderError` names it.
"""

from __future__ import annotations

import socket
import types
from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import mujoco

from ..base.errors import RenderError

_EXPECTED = "4.0"


def _private(owner: Any, name: str, wanted_for: str) -> Any:
    """A private part; raises RenderError where this MuJoCo has none."""
    try:
        return getattr(owner, name)
    except AttributeError:
        raise RenderError(
            f"MuJoCo {mujoco.__version__} has no {getattr(owner, '__name__', type(owner).__name__)}"
            f".{name}, which is needed for {wanted_for}; expected MuJoCo {_EXPECTED}"
        ) from None


def context_of(renderer: mujoco.Renderer) -> mujoco.MjrContext:
    """The OpenGL context of a renderer.

    `mujoco.Renderer` hands it out nowhere; textures of drafts are uploaded into it, and the widths
    of its letters lay out panels.
    """
    context: mujoco.MjrContext = _private(renderer, "_mjr_context", "pictures")
    return context


def page_files() -> Path:
    """The folder with the files of Studio's page, of which ours has another head.

    Raises:
        RenderError: this MuJoCo does not include them.
    """
    from mujoco.studio.web import web_server

    found = _private(web_server, "_find_static_files_dir", "web pages")()
    if found is None:
        raise RenderError(
            "no web page: this MuJoCo does not include the files of Studio's web client; "
            "`sero-mj view SCENE --window` needs none"
        )
    return Path(found)


def server_program(most_browsers: int, most_states: int, serve: Any) -> Any:
    """Studio's function that runs its server, with limits and a `serve` of ours.

    Studio has no option for additional request handlers, and none for how many browsers there may
    be. So the function runs in a namespace with other values; Studio itself is not changed.

    Args:
        most_browsers: that may look on.
        most_states: that may be on their way to a browser.
        serve: is called in the place of `websockets.serve`.
    """
    from mujoco.studio.web import web_server

    theirs: types.FunctionType = _private(web_server, "_run_server", "web pages")
    ours: Mapping[str, Any] = {
        "serve": serve,
        "_MAX_SPECTATORS_DEFAULT": most_browsers,
        "_MAX_SPECTATOR_HARD_CAP": most_browsers,
        "_STATE_MAX_IN_FLIGHT": most_states,
    }
    return types.FunctionType(
        theirs.__code__,
        {**theirs.__globals__, **ours},
        theirs.__name__,
        theirs.__defaults__,
        theirs.__closure__,
    )


class Server(Protocol):
    """What `PrivateViewer` needs of a server."""

    def start(self) -> None: ...  # noqa: D102
    def update_model(self, bundle: bytes, crc32: int) -> None: ...  # noqa: D102


class PrivateViewer(ABC):
    """Replaces private parts of Studio's `WebViewer`, before which it stands in a class's bases.

    Studio 4.0 listens on all interfaces, with a server of its own, and cannot be told otherwise.
    A subclass sets `address` and `wanted_port` before it calls Studio's constructor.

    Attributes:
        address: to listen on.
        wanted_port: 0 for the first free one.
    """

    address: str
    wanted_port: int
    _headless_ui: Any
    _tcp_sock: socket.socket
    _web_server: Any
    _model_crc32: int
    _http_port: int

    @abstractmethod
    def make_server(self, http: socket.socket, tcp: socket.socket) -> Server:
        """Returns the server.

        Args:
            http: listens for browsers.
            tcp: for Studio's own user interface.
        """

    @abstractmethod
    def guarded(self, tcp: socket.socket) -> socket.socket:
        """Returns the socket for Studio's own user interface as it is to be used."""

    @property
    def _host(self) -> str:
        return self.address

    @_host.setter
    def _host(self, value: str) -> None:
        """Ignores the value of Studio's constructor, which is all interfaces."""
        del value

    @property
    def _http_sock(self) -> socket.socket:
        return self.listening

    @_http_sock.setter
    def _http_sock(self, bound: socket.socket) -> None:
        """Listens at once: until somebody does, other pages that start can bind the same port."""
        from mujoco.studio.web import web_server

        while True:
            try:
                bound.listen()
            except OSError:  # another one has been faster
                bound.close()
                bound = web_server.bind_public_socket(self.address, self.wanted_port)
            else:
                self.listening = bound
                return

    def _start_server(self) -> None:
        self._tcp_sock = self.guarded(self._tcp_sock)
        self._web_server = self.make_server(self.listening, self._tcp_sock)
        _private(self, "_update_model", "web pages")()
        try:
            self._web_server.start()
        except RenderError:
            self.listening.close()
            self._tcp_sock.close()
            raise

    @property
    def ui(self) -> Any:
        """Studio's user interface, or what stands for it."""
        return self._headless_ui

    @ui.setter
    def ui(self, ui: Any) -> None:
        self._headless_ui = ui

    @property
    def port(self) -> int:
        """Port of the page."""
        return int(self._http_port)

    @property
    def model_checksum(self) -> int:
        """Of the model that browsers have."""
        return self._model_crc32

    def change_model(self, bundle: bytes, crc32: int) -> None:
        """Switches browsers to a model that differs only in colours.

        Args:
            bundle: the model as Studio sends it.
            crc32: checksum of the bundle.
        """
        self._model_crc32 = crc32
        self._web_server.update_model(bundle, crc32)
