"""`WebHost`: shows a mirror on a web page."""

from __future__ import annotations

import time
import urllib.parse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ...data.drive.mirror import LiveWorld
from ..host.live import HIDDEN_INTERVAL, LiveHost
from ..image.image_files import Pixels
from ..image.image_options import DEFAULT_SIZE
from ..image.scene_decor import SceneDecor
from ..player.page import live_page, player_files, requested_look
from .browsers import Browsers
from .messages import ForScene
from .page_input import PageInput
from .page_panels import PagePanels
from .page_state import PageState
from .page_view import PageView
from .sections import Sections
from .server import LOOPBACK, PageListener, PageServer
from .uploads import NOT_IN_CONTROL, drops

if TYPE_CHECKING:
    from ..image.render import HeadlessRenderer

RATE = 60.0  # number of frames per second


class WebHost(LiveHost):
    """Shows a mirror on a web page, which browsers render with the player.

    Several browsers can connect. Only the browser in control can use mouse, keys and panels.

    Args:
        mirror: open mirror, which the clock of the page advances.
        camera: initial camera, see `find_camera`; None for the view of the scene.
        host: address to listen on.
        port: port to listen on; 0 for the first free port from 8080.
        token: token of the page; True to create a token, False for none.
        waits: whether recordings and simulations wait until the first browser connects.
        folder: directory for exported files, images and videos; None for the current directory.

    Raises:
        RenderError: the page cannot be served at this address and port.
        UnknownName: there is no camera with this name.
    """

    def __init__(
        self,
        mirror: LiveWorld,
        *,
        camera: str | None = None,
        host: str = LOOPBACK,
        port: int | PageListener = 0,
        token: bool | str = True,
        waits: bool = False,
        folder: Path | None = None,
    ) -> None:
        super().__init__(mirror, folder, camera)
        world = self.world
        self.view = PageView(world, self.navigator)
        self.shows_panel = True
        self._renderer: HeadlessRenderer | None = None  # for screenshots and videos
        self.decor = SceneDecor(world, self.toggles)
        self._sections = Sections()
        self._state = PageState(world, self._sections)
        self._use(self.decor)
        self.decor.add(self._state)  # The last feature captures the output of all others.
        self._is_held = waits and not self.clock.is_live
        self._is_put = False  # whether browsers have a state to start with
        self._is_closing = self._is_closed = False
        self.actions.add(
            {"link": self._copy_link, "status_line": partial(self.toggle, "shows_panel")}
        )
        self.browsers = Browsers(self._sections, ForScene)
        self._panels = PagePanels(self, self._sections)
        self._input = PageInput(self, self.view, self._panels)
        self._dropped: list[Path] = []
        self.server = PageServer(
            live_page(requested_look(world.scene)),
            player_files(),
            self.browsers.talk,
            "/live",
            self._may_upload,
            self._dropped.append,
            host=host,
            port=port,
            token=token,
        )
        self._begin = self._last = time.monotonic()
        self._interval = 1.0 / RATE  # mean time between the last frames, s
        navigator = self.navigator
        self._state.begin(self.data, navigator.camera, navigator.needed, world.scene.name)

    @property
    def url(self) -> str:
        return self.server.url

    @property
    def urls(self) -> list[str]:
        return self.server.urls

    @property
    def is_open(self) -> bool:
        return self.server.is_running and not (self._is_closing or self._is_closed)

    @property
    def is_seen(self) -> bool:
        return self.browsers.is_any

    @property
    def is_due(self) -> bool:
        return time.monotonic() - self._begin >= 1.0 / RATE - 1e-3

    def run(self) -> None:
        while self.frame():
            # Simulations that someone has started continue in real time.
            if not self.is_seen and (self.clock.is_live or self._is_held):
                time.sleep(HIDDEN_INTERVAL)

    def frame(self, *, wait: bool = True) -> bool:
        """Serves one frame. If `wait` is False, does nothing until it is time for the next one."""
        if not self.is_open:
            return False
        if not (wait or self.is_due):
            return True
        time.sleep(max(self._begin + 1.0 / RATE - time.monotonic(), 0.0))
        self._begin = begin = time.monotonic()
        passed, self._last = begin - self._last, begin
        self._interval += 0.1 * (passed - self._interval)
        self._is_held &= not self.is_seen
        self._input.take(self.browsers.take())
        while self._dropped:
            path = self._dropped.pop(0)
            if not self.others.open_file(path):
                drops.discard(path)
        self._advance(0.0 if self._is_held else passed)
        self.navigator.advance(self.data)
        if self.is_seen or not self._is_put:
            self._put()
        self.work = time.monotonic() - begin
        self.tools.distribute_image(self.image)
        if not self.tools.takes_images:
            self._end_renderer()
        return self.is_open

    def _put(self) -> None:
        self._is_put = True
        self.decor.lay_out(self.data, self.view.of_data(self.data))
        self._input.point()
        self._state.put(self.data, self.decor)
        self.view.put(self._sections, self.browsers.holder)
        self._sections.put("dragging", self._input.is_dragging)
        self._sections.put("onHandle", self._input.is_on_handle)
        self._panels.put(
            1.0 / max(self._interval, 1e-6),
            self._state.count,
            self.view.size,
            is_local=self.browsers.holder_is_local,
        )
        self.server.call(self.browsers.wake)

    # ---- the view

    @property
    def link(self) -> str:
        """Address of the page with the current view, without the token."""
        view = urllib.parse.quote(self.view_state().to_text(), safe="")
        return f"{self.server.plain_url}#view={view}"

    def _copy_link(self) -> str:
        self.to_clipboard(self.link)
        return "copied a link to this view"

    def to_clipboard(self, text: str) -> None:
        self.browsers.send_event({"copy": text})

    # ---- images

    @property
    def image_size(self) -> tuple[int, int]:
        return DEFAULT_SIZE

    def image(self) -> Pixels:
        from ..image.render import HeadlessRenderer

        if self._renderer is None:
            self._renderer = HeadlessRenderer(self.world, *self.image_size)
        renderer = self._renderer
        renderer.camera, renderer.toggles = self.navigator.camera, self.toggles
        return renderer.render(self.data).copy()

    def _may_upload(self, key: str) -> str | None:
        if self.others.opener is None:
            return "only `sero-mj view` opens dropped files"
        return None if self.browsers.is_in_control(key) else NOT_IN_CONTROL

    def _end_renderer(self) -> None:
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def request_close(self) -> None:
        self._is_closing = True

    def close(self) -> None:
        if self._is_closed:
            return
        self._is_closed = True
        super().close()
        self._end_renderer()
        self.server.close()
