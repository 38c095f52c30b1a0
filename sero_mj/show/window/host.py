"""`Window`: shows a mirror in a window, with mouse and keys."""

from __future__ import annotations

import time
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...decor.toggles import Toggles
from ...drive.mirror import LiveWorld
from ...errors import SeroError
from ..clock import Clock, time_text
from ..headless.render import DEFAULT_SIZE
from ..input import Clicked, Event, Mouse, Moved
from ..interaction import ClickDetector, OnClick, handle_click, hover
from ..keys import KeyHandler
from ..picking import Picked
from ..status_line import Message, Piece, status_pieces
from ..torque_history import TorqueHistory
from .arrange import Layout, arrange
from .capture import Capture
from .glfw_window import GlWindow
from .help import Row, help_columns, pages
from .hud import Hud, TimeLine
from .navigator import Navigator
from .torque_plot import TorquePlot
from .viewport import Viewport

_HINT = "H help"


class Window:
    """Shows a mirror in a window.

    It never waits for a packet: every frame shows the latest one.

    Args:
        mirror: must be open; is driven by the window's clock.
        size: of the window, in screen coordinates.
        camera: see `find_camera`.
        full_screen: whether it covers the screen.
        folder: where screenshots and films go; the current one when None.

    Attributes:
        toggles: what is shown.
        clock: pause, speed and time line.
        navigator: moves the camera.
        camera: records screenshots and films.
        joint: the joint of the world whose torques are plotted.
        work: time spent by sero-mj for the last frame, s: input, sources, decor and plots,
            without rendering.
        on_click: called with the clicked item and the gesture.

    Raises:
        RenderError: there is no display, or no OpenGL.
        UnknownName: no camera of that name.
    """

    def __init__(
        self,
        mirror: LiveWorld,
        *,
        size: tuple[int, int] = DEFAULT_SIZE,
        camera: str | None = None,
        full_screen: bool = False,
        folder: Path | None = None,
    ) -> None:
        world = mirror.world
        self.mirror, self.world, self.data = mirror, world, mirror.data
        self.toggles = Toggles(world)
        self.clock = Clock(mirror)
        self.navigator = Navigator(world, camera)
        self.camera = Capture(world.scene.name, folder)
        self.joint = 0
        self.work = 0.0
        self.on_click: OnClick | None = None
        self.shows_plot = self.shows_help = False
        self.shows_status = True
        self.help_page = 0
        self.wants_picture = False
        title = f"{world.scene.name} - sero-mj"
        self.gl = GlWindow(world, size, title, full_screen=full_screen)
        self._frame = Viewport(world, self.toggles)
        self._hud = Hud(self.gl)
        self._clicks = ClickDetector(world, self.toggles)
        self._mouse = Mouse()
        self._keys = KeyHandler(
            self,
            {
                "follow": self._follow,
                "plot": self._toggle_plot,
                "status_line": self._toggle_status,
                "screenshot": self._take_screenshot,
                "film": self._toggle_film,
                "full_screen": self.gl.toggle_full_screen,
                "help": self.next_help_page,
            },
        )
        self._history, self._plot = TorqueHistory(world), TorquePlot(world)
        self._help = help_columns()
        self._layout = self._arrange(self.gl.size)
        self._line: TimeLine | None = None
        self._is_scrubbing = False
        self._notice = Message()
        self._last = self._end = time.monotonic()  # start and end of the last frame
        self._interval = 1.0 / self.gl.refresh_rate

    @property
    def frame_rate(self) -> float:
        """Frames/s, averaged over the last frames."""
        return 1.0 / max(self._interval, 1e-6)

    def run(self) -> None:
        """Shows frames until the user closes the window."""
        while self.frame():
            pass

    @property
    def is_open(self) -> bool:
        """Whether the user has not closed the window."""
        return not self.gl.is_closing

    @property
    def is_due(self) -> bool:
        """Whether the screen is ready for the next frame.

        If rendering is slow, half of the time is left to the caller.
        """
        took = self._end - self._last
        if not self.is_open:
            return False
        return time.monotonic() - self._end >= max(1.0 / self.gl.refresh_rate - 1e-3 - took, took)

    def frame(self, *, wait: bool = True) -> bool:
        """Shows one frame.

        Args:
            wait: whether to wait until the screen is ready for the next one.

        Returns:
            whether the window is still open.
        """
        begin = time.monotonic()
        passed, self._last = begin - self._last, begin
        self._interval += 0.1 * (passed - self._interval)
        if self.gl.is_closing:
            return False
        width, height = self.gl.size
        if not (width and height):  # minimized
            self.gl.wait(0.1)
            return True
        for event in self.gl.events():
            self._take(event, height)
        self._advance(passed)
        self._layout = self._arrange((width, height))
        rect = self._layout.picture
        self._frame.lay_out(self.data, self.navigator.camera, rect, self.gl.fit_font(rect.height))
        self._hover()
        figures = self._plot.fill(self._history, self.joint) if self._has_plot else []
        pieces = status_pieces(self.mirror.sources.values(), self.clock, self.frame_rate)
        self._line = None
        if self._has_line:
            end = float(self.clock.end or 0.0)
            self._line = self._hud.time_line(width, self._layout.line_bottom, end)
        self.work = time.monotonic() - begin
        self._draw(figures, pieces, (width, height))
        self.gl.swap()
        self._end = time.monotonic()
        # Limits the frame rate where swapping does not wait for the screen's refresh.
        if wait:
            self.gl.wait(1.0 / self.gl.refresh_rate - 1e-3 - (self._end - begin))
        return not self.gl.is_closing

    def _arrange(self, size: tuple[int, int]) -> Layout:
        hud = self._hud
        return arrange(
            size,
            hud.font.height,
            bar=hud.bar_height if self.shows_status else 0,
            line=hud.line_height if self._has_line else 0,
            has_plot=self._has_plot,
        )

    @property
    def _has_line(self) -> bool:
        return self.shows_status and bool(self.clock.end)

    @property
    def _has_plot(self) -> bool:
        return self.shows_plot and len(self.world.joints.names) > 0

    def _advance(self, passed: float) -> None:
        self.clock.on_moment = self._sample if self._has_plot else None
        try:
            self.clock.advance(passed)
        except SeroError as error:  # for example a deleted file; the display does not change
            self.clock.is_paused = True
            self.say(str(error), is_bad=True)
        if not self.clock.is_paused:
            self._sample()
        self.navigator.advance(self.data)
        message = self.camera.next_message()
        if message is not None:
            self.say(message[0], is_bad=message[1])

    def _sample(self) -> None:
        self._history.add(self.data)

    def _draw(
        self, figures: list[mujoco.MjvFigure], pieces: list[Piece], size: tuple[int, int]
    ) -> None:
        width, height = size
        hud, layout, now = self._hud, self._layout, time.monotonic()
        self._frame.draw(self.gl.context)
        for rect, figure in zip(layout.plots, figures, strict=False):  # only one in a narrow window
            mujoco.mjr_figure(rect, figure, self.gl.hud)
        if self.wants_picture or self.camera.wants(now):
            pixels = self._frame.pixels(self.gl.context)
            if self.wants_picture:
                self.camera.picture(pixels)
            self.camera.add(pixels, now)
            self.wants_picture = False
        if self.camera.is_filming:
            hud.filming(f"filming {time_text(self.camera.seconds)}", layout.picture.width, height)
        if self._line is not None:
            hud.draw_time_line(self._line, self.clock.time, width, layout.line_bottom)
        if self.shows_status:
            hud.status(pieces, _HINT, width)
        if self._notice.is_shown:
            text, is_bad = self._notice.text, self._notice.is_bad
            hud.message(text, layout.picture.width, layout.picture.bottom, is_bad=is_bad)
        if self.shows_help:
            found = self.help_pages(size)
            hud.help(found[min(self.help_page, len(found) - 1)], width, height)

    @property
    def picture_size(self) -> tuple[int, int]:
        """Width and height of the picture in the window, pixels."""
        return self._frame.rect.width, self._frame.rect.height

    def picture(self) -> NDArray[np.uint8]:
        """Renders the last frame again without status line and messages, (height, width, 3)."""
        self._frame.draw(self.gl.context)
        return self._frame.pixels(self.gl.context)

    def help_pages(self, size: tuple[int, int]) -> list[list[list[Row]]]:
        """Returns the help in pages of columns that fit a window of that size."""
        return pages(self._help, self._hud.help_room(size))

    def next_help_page(self) -> None:
        """Shows the help, shows its next page, or hides it after the last page."""
        self.help_page = self.help_page + 1 if self.shows_help else 0
        self.shows_help = self.help_page < len(self.help_pages(self.gl.size))

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Shows a message in the window for a few seconds."""
        self._notice.say(text, is_bad=is_bad)

    def pick_under_pointer(self) -> Picked | None:
        """Returns the item under the pointer."""
        at = self._mouse.position
        return None if at is None else self._frame.pick(self.data, *at)

    def _hover(self) -> None:
        at = self._mouse.position
        if at is None or self._mouse.is_down or self.shows_help:
            self.toggles.hover = None
            return
        picked = self._frame.pick(self.data, *at)
        hover(self.toggles, picked, self._frame.to_picture(*at))

    def _take(self, event: Event, height: int) -> None:
        """Handles an event."""
        if event.kind == "key":
            self._press(event)
            return
        line = self._line
        if event.kind == "press" and line is not None and line.hits(event.x, event.y):
            self._is_scrubbing = True
        if self._is_scrubbing and line is not None:
            self._is_scrubbing = event.kind != "release"
            self.clock.seek(line.time_at(event.x))
            self._mouse.position = (event.x, event.y)
            return
        found = self._mouse.take(event)
        if isinstance(found, Moved):
            self._move(found, height)
        elif isinstance(found, Clicked):
            self._click(found)

    def _move(self, moved: Moved, height: int) -> None:
        view, navigator = self._frame.decor.view, self.navigator
        if view is None:
            return
        navigator.free(view.position, view.forward)
        right, down = moved.right / height, moved.down / height
        if moved.how == "zoom":
            navigator.zoom(moved.down)
        elif moved.how == "pan":
            navigator.pan(right, down, view.tan_half_fovy)
        else:
            navigator.orbit(right, down)

    def _click(self, clicked: Clicked) -> None:
        at = (clicked.x, clicked.y)
        if self.shows_help:
            self.shows_help = False
            return
        if not self._frame.contains(*at):
            return
        if clicked.centre:
            self._centre(at)
            return
        picked = self._frame.pick(self.data, *at)
        handle_click(self, self._clicks, picked, clicked, self._centre)

    def _centre(self, at: tuple[float, float]) -> None:
        view, point = self._frame.decor.view, self._frame.point_at(self.data, *at)
        if point is None or view is None or not np.isfinite(point).all():
            return
        self.navigator.free(view.position, view.forward)
        self.navigator.centre(point)

    def _press(self, event: Event) -> None:
        if event.key != "escape":
            self._keys.press(event.key, is_repeat=event.is_repeat)
        elif self.shows_help:
            self.shows_help = False
        elif self.gl.is_full_screen:
            self.gl.toggle_full_screen()

    def choose_camera(self, number: int) -> str:
        """Selects a camera by number, 1 for the first, 0 for the initial view."""
        return self.navigator.choose(number)

    def _follow(self) -> str:
        picked = self.pick_under_pointer()
        is_frame = picked is not None and picked.name in self.world.frames.names
        return self.navigator.follow(self.data, picked.name if picked and is_frame else None)

    def _toggle_plot(self) -> str:
        self.shows_plot = not self.shows_plot
        return "" if self.world.joints.names else "no joint to plot"

    def _toggle_status(self) -> None:
        self.shows_status = not self.shows_status

    def _take_screenshot(self) -> None:
        self.wants_picture = True

    def _toggle_film(self) -> str:
        if self.camera.is_filming:
            self.camera.stop()
            return "the film is complete"
        try:
            return self.camera.start(self.picture_size, time.monotonic())
        except SeroError as error:
            self.say(str(error), is_bad=True)
            return ""

    def close(self) -> None:
        """Closes the window after pictures and films are written."""
        self.camera.close()
        self.gl.close()

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
