"""`WebHost`: shows a mirror on a web page."""

from __future__ import annotations

import contextlib
import socket
import time
import urllib.parse
from pathlib import Path
from typing import TYPE_CHECKING

import mujoco
from mujoco.studio import launch_thread, messages, sim_history, ux, viewer_handle

from ...base.errors import RenderError, UsageError
from ...base.frames import Array
from ...data.drive.mirror import LiveWorld
from ..camera import find_camera, list_cameras, needed_aspect, standing_back
from ..headless.film import Pixels
from ..session.live import LiveHost
from ..session.picking import Pixel
from ..session.restoring import show_state
from ..session.view_state import ViewState
from .guard import is_loopback, make_token
from .page_windows import PageWindows
from .studio import LOOPBACK, RATE, StudioViewer, suppress_output
from .studio_controls import StudioApp, TimeControl
from .studio_decor import Greying, WebDecor

if TYPE_CHECKING:
    from ..headless.render import HeadlessRenderer

ANY_ADDRESS = ("", "0.0.0.0", "::")


class WebHost(LiveHost):
    """Shows a mirror on a web page, rendered by the browser.

    Any number of browsers can connect; one at a time has control by mouse, keys and panels.

    Args:
        mirror: must be open; is driven by the page's clock.
        camera: see `find_camera`.
        host: address to listen on.
        port: 0 for the first free one from 8080 on.
        token: whether the page's address contains a secret token; for other machines it always
            does. A text is that token.
        waits: whether recordings and simulations start when the first browser connects.
        folder: see `LiveHost`.

    Attributes:
        token: in the page's address; None without.

    Raises:
        RenderError: the page cannot be served there, or this process already serves one.
        UnknownName: no camera of that name.
    """

    decor: WebDecor
    _is_any_open = False  # in this process

    def __init__(
        self,
        mirror: LiveWorld,
        *,
        camera: str | None = None,
        host: str = LOOPBACK,
        port: int = 0,
        token: bool | str = False,
        waits: bool = False,
        folder: Path | None = None,
    ) -> None:
        if WebHost._is_any_open:
            raise RenderError("no second page: Studio serves one at a time in a process")
        super().__init__(mirror, folder)
        self._renderer: HeadlessRenderer | None = None  # of the film
        world = self.world
        self.decor = WebDecor(world, self.toggles)
        self._use(self.decor)
        self._is_closed = False
        self._under: Pixel | None = None
        self._start_camera = camera
        self._needed = needed_aspect(world, find_camera(world))
        self._back = 1.0  # by how much farther away the camera stands, see `standing_back`
        self._app = StudioApp(self)
        self._panels = PageWindows(self, self.decor, self._app)
        self.actions.add({"link": self._copy_link})
        is_private = is_loopback(check_address(host))
        self.token: str | None = None
        if token or not is_private:
            self.token = token if isinstance(token, str) else make_token()
        if not (isinstance(port, int) and 0 <= port < 65536):
            raise RenderError(f"port {port!r}: expected a number from 1 to 65535, or 0 for any")
        viewer_end, sim_end = launch_thread.make_thread_endpoints()
        try:
            self.viewer = StudioViewer(
                viewer_end,
                world.model,
                address=host,
                port=port,
                token=self.token,
                title=f"{world.scene.name} - sero-mj",
                plugins=[self._app, self._panels],
                camera=find_camera(world, camera),
            )
        except (RuntimeError, OSError) as error:
            where = f"{host}:{port}" if port else host
            why = f"{error}".partition(" Pass a different")[0]  # Studio's hint is not for --port
            raise RenderError(f"no page at {where}: {why}") from error
        WebHost._is_any_open = True
        self._app.press_time = self.viewer.server.browsers.press_time
        self._panels.widgets.to_clipboard = self.viewer.server.browsers.copy
        self._app.take_hold = self.viewer.server.browsers.take_hold
        self._app.take_left = self.viewer.server.browsers.take_left
        self._time = TimeControl(self.clock)
        self._time.is_held = waits and not self.clock.is_live
        self._handle = viewer_handle.ViewerHandle(
            sim_end, sim_plugins=[self._time, sim_history.SimHistory()]
        )
        with suppress_output():
            self._handle.set_model(world.model, data=self.data)
            for event in self.viewer.get_sim_events():
                self.viewer.dispatch(event)
        self._greying = Greying(self.viewer)
        self._begin = time.monotonic()

    @property
    def url(self) -> str:
        """Address of the page for browsers on this machine, with its token if it has one."""
        return page_url(self.viewer.address, self.viewer.port, self.token)

    @property
    def urls(self) -> list[str]:
        """All addresses of the page, including that for other machines if they can reach it."""
        return page_urls(self.viewer.address, self.viewer.port, self.token)

    @property
    def port(self) -> int:
        """Port that the server listens on."""
        return self.viewer.port

    @property
    def is_private(self) -> bool:
        """Whether only browsers on this machine can reach it."""
        return is_loopback(str(self.viewer.listening.getsockname()[0]))

    @property
    def is_open(self) -> bool:
        """Whether nobody has chosen File, Quit in the page."""
        return bool(self.viewer.is_running())

    @property
    def is_seen(self) -> bool:
        """Whether a browser is connected."""
        return self.viewer.server.browsers.are_there

    @property
    def is_due(self) -> bool:
        """Whether it is time for the next frame."""
        return time.monotonic() - self._begin >= 1.0 / RATE - 1e-3

    def frame(self, *, wait: bool = True) -> bool:
        """Serves one frame, see `LiveHost.frame`; without waiting only if it is due."""
        if not self.is_open:
            return False
        if not (wait or self.is_due):
            return True
        viewer = self.viewer
        viewer.prepare_next_frame()  # sleeps until then
        self._begin = begin = time.monotonic()
        self._time.is_held &= not viewer.server.is_watched
        self._advance(self._handle.sync)
        for event in viewer.get_sim_events():
            viewer.dispatch(event)
        if not viewer.is_running():
            return False
        self._follow_link()
        if (dropped := viewer.server.browsers.take_dropped()) is not None:
            self.open_file(dropped)
        for snapshot in viewer.get_sim_snapshots():
            viewer.dispatch(snapshot)
        if viewer.has_ui:
            viewer.dispatch(messages.UpdateEvent())
            viewer.server.browsers.forget_presses()
            viewer.dispatch(messages.BuildGuiEvent())
        self.decor.show_in(viewer, self.data, self._panels.inset)
        self._stand_back(viewer.camera)
        self._greying.show(self.decor.buffer.grey)
        viewer.sync()
        self.work = time.monotonic() - begin
        self._give_picture(self.picture)
        if not self.takes_pictures:
            self._end_renderer()
        return self.is_open

    @property
    def link(self) -> str:
        """Address that opens the page with this view: camera, switches, selection, time."""
        return f"{self.url}#view={urllib.parse.quote(self.view_state().to_text(), safe='')}"

    def _follow_link(self) -> None:
        text = self.viewer.server.browsers.take_view()
        if text is None:
            return
        try:
            show_state(self, ViewState.from_text(text))
        except UsageError as error:
            self.say(str(error), is_bad=True)

    def _copy_link(self) -> str:
        self.to_clipboard(self.link)
        return "copied: a link that opens this view"

    def point(self, at: Pixel | None) -> None:
        """Moves the pointer to a pixel of the page, y up; None if it is not over the scene."""
        self._under = at
        super().point(at)

    def _pointer(self) -> Pixel | None:
        return self._under

    def centre(self, point: Array) -> None:
        """Makes a point (3,), m, the camera's look-at point."""
        camera = self.viewer.camera
        camera.type = int(mujoco.mjtCamera.mjCAMERA_FREE)
        camera.lookat[:] = point
        self._app.reset_camera_index(ux.TUMBLE_CAMERA_IDX)

    @property
    def view_camera(self) -> mujoco.MjvCamera:
        """See `LiveHost`."""
        return self.viewer.camera

    @property
    def is_following(self) -> bool:
        """See `LiveHost`."""
        return int(self.viewer.camera.type) == int(mujoco.mjtCamera.mjCAMERA_TRACKING)

    def to_clipboard(self, text: str) -> None:
        """See `LiveHost`: that of the browser in control."""
        self.viewer.server.browsers.copy(text)

    def _stand_back(self, camera: mujoco.MjvCamera) -> None:
        """Lets the camera stand back as the page becomes narrow; the browser moves it as well."""
        width, height = self.decor.size
        if min(width, height) < 1 or camera.type != mujoco.mjtCamera.mjCAMERA_FREE:
            return
        back = standing_back(width, height, self._needed)
        camera.distance *= back / self._back
        self._back = back

    def choose_camera(self, number: int) -> str:
        """Selects a camera by number, 1 for the first; 0 for the scene's own view."""
        names = list_cameras(self.world)
        if number > len(names):
            return f"no camera {number}: the scene has {len(names) or 'none'}"
        camera = find_camera(self.world, self._start_camera if number == 0 else names[number - 1])
        current = self.viewer.camera
        current.type, current.fixedcamid, current.trackbodyid = camera.type, camera.fixedcamid, -1
        if number == 0:
            current.lookat[:], current.distance = camera.lookat, camera.distance
            current.azimuth, current.elevation = camera.azimuth, camera.elevation
            self._back = 1.0
        is_fixed = camera.type == mujoco.mjtCamera.mjCAMERA_FIXED
        self._app.reset_camera_index(camera.fixedcamid if is_fixed else ux.TUMBLE_CAMERA_IDX)
        return f"camera {names[number - 1]}" if number else "initial view"

    def follow(self, frame: str | None) -> str:
        """Starts following a frame with the camera, or stops; returns a message for the user."""
        camera = self.viewer.camera
        if frame is None:
            camera.type, camera.trackbodyid = int(mujoco.mjtCamera.mjCAMERA_FREE), -1
            self._app.reset_camera_index(ux.TUMBLE_CAMERA_IDX)
            return "follows nothing"
        site = self.world.frames.site[self.world.frames.names.index(frame)]
        camera.type = int(mujoco.mjtCamera.mjCAMERA_TRACKING)
        camera.trackbodyid = int(self.world.model.site_bodyid[site])
        self._app.reset_camera_index(ux.TRACKING_CAMERA_IDX)
        return f"follows {frame}"

    @property
    def picture_size(self) -> tuple[int, int]:
        """See `LiveHost`: whatever the size of the page."""
        from ..headless.picture_options import DEFAULT_SIZE

        return DEFAULT_SIZE

    def picture(self) -> Pixels:
        """Returns the current view, (height, width, 3), uint8, rendered by the classic renderer."""
        from ..headless.render import HeadlessRenderer

        if self._renderer is None:
            self._renderer = HeadlessRenderer(self.world, *self.picture_size)
        renderer = self._renderer
        renderer.camera, renderer.toggles = self.viewer.camera, self.toggles
        return renderer.render(self.data).copy()

    def _end_renderer(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def request_close(self) -> None:
        """Lets the next frame be the last."""
        self._app.close()

    def close(self) -> None:
        """Closes the page and informs the browsers."""
        if self._is_closed:
            return
        self._is_closed, WebHost._is_any_open = True, False
        super().close()
        self._end_renderer()
        with contextlib.suppress(RuntimeError):  # already closed from the page
            self._handle.close()
        with suppress_output():
            self.viewer.close()


def check_address(host: str) -> str:
    """Returns the IP address of a host name of this machine; raises RenderError if it has none."""
    try:
        family, *_, address = socket.getaddrinfo(host, 0, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.bind(address)
    except (OSError, UnicodeError) as error:
        raise RenderError(
            f"no page at {host!r}: this machine has no such address ({error}); "
            f"{LOOPBACK} is for browsers here, 0.0.0.0 for those everywhere"
        ) from error
    return str(address[0])


def page_urls(address: str, port: int, token: str | None = None) -> list[str]:
    """Returns all addresses of a page: `page_url`, and that for other machines, if they reach it.

    Args:
        address: see `page_url`.
        port: likewise.
        token: likewise.
    """
    found = [page_url(address, port, token)]
    return found + [page_url(socket.gethostname(), port, token)] * (address in ANY_ADDRESS)


def page_url(address: str, port: int, token: str | None = None) -> str:
    """Returns the address of a page for browsers on this machine.

    Args:
        address: IP address that the server listens on.
        port: of the server.
        token: of the page; None for none.
    """
    if address in (*ANY_ADDRESS, LOOPBACK, "::1"):
        address = "localhost"
    query = "" if token is None else f"?token={token}"
    return f"http://{f'[{address}]' if ':' in address else address}:{port}/{query}"
