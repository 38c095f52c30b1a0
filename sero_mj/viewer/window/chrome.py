"""`Chrome`: the status line, timeline, areas, panel and help of a window."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

import mujoco
from imgui_bundle import ImVec2, imgui

from ..host.live import LiveHost
from ..panels import dialogs
from ..panels.robot_panel import build_handle
from ..panels.status_line import build_status_line, build_timeline
from ..session.keys import Row
from ..session.status_line import Piece
from .glfw_window import GlWindow
from .imgui_layer import ImguiLayer

_HINT = "H help"
# These distances from the upper edge of the image are in lines of the window's text.
_MESSAGE_TOP, _ONGOING_TOP, _HANDLE_TOP = 2.5, 0.5, 0.8
_BESIDE_HANDLE = 2.0  # width of the panel button, in lines
_PANEL = 21.5  # width of the panel, in text heights
_MAX_PANEL = 0.97  # maximum height of the panel, as a fraction of the window height
_FLAGS = imgui.WindowFlags_
_STILL = _FLAGS.no_move | _FLAGS.no_resize | _FLAGS.no_collapse | _FLAGS.no_saved_settings
_PANEL_FLAGS = _STILL | _FLAGS.no_nav
_BAR_FLAGS = (
    _PANEL_FLAGS | _FLAGS.no_title_bar | _FLAGS.no_scrollbar | _FLAGS.no_bring_to_front_on_focus
)
_NOTE_FLAGS = _BAR_FLAGS | _FLAGS.no_inputs | _FLAGS.no_focus_on_appearing
_HANDLE_FLAGS = _BAR_FLAGS | _FLAGS.no_background | _FLAGS.always_auto_resize


class Chrome(ImguiLayer):
    """The user interface around and over the image of a window.

    Attributes:
        covered: width in pixels that the panel covers at the left edge of the image.
    """

    def __init__(self, gl: GlWindow, host: LiveHost, columns: Sequence[Sequence[Row]]) -> None:
        super().__init__(gl)
        self._host, self._columns = host, columns
        self.widgets.folds = host.folds
        self.covered = 0.0

    def places(self, size: tuple[int, int]) -> Places:
        host = self._host
        return arrange(
            size,
            self._line,
            has_status=host.shows_status,
            has_time=host.shows_status and host.has_timeline,
            has_area=bool(host.tools.areas),
        )

    @property
    def _line(self) -> int:
        return self._gl.typesetter.font.height

    def build(
        self,
        size: tuple[int, int],
        places: Places,
        image: mujoco.MjrRect,
        pieces: Sequence[Piece],
    ) -> None:
        self.frame(size, lambda: self._build(places, image, pieces))

    def _build(self, places: Places, image: mujoco.MjrRect, pieces: Sequence[Piece]) -> None:
        host, ui = self._host, self.widgets
        if places.area is not None and host.tools.areas:
            first = host.tools.areas[0]
            with self._part(first.area, places.area, 0.5, 0.4):
                host.tools.call(first, lambda tool: tool.build_area(ui))
        if places.time is not None:
            with self._part("time", places.time, 0.45, 0.1):
                build_timeline(ui, host.clock, host.tools.ticks)
        if places.status is not None:
            over = (places.status.height - self.text_height) / 2 / self.text_height
            with self._part("status", places.status, 0.55, over):
                build_status_line(ui, pieces, _HINT)
        top = self.size[1] - image.bottom - image.height
        if host.notice.is_shown:
            self._note("message", host.notice.piece, image, top + _MESSAGE_TOP * self._line)
        ongoing = host.tools.ongoing
        if ongoing is not None:
            self._note("ongoing", ongoing, image, top + _ONGOING_TOP * self._line)
        if host.shows_panel:
            self._panel(places.image.bottom if places.area is None else places.area.bottom)
        else:
            self._handle()
        if host.shows_help:
            self._help()
        if host.others.asks:
            self._request()

    @contextmanager
    def _part(self, name: str, rect: Rect, beside: float, above: float) -> Iterator[None]:
        unit = self.text_height
        padding = ImVec2(round(beside * unit), round(above * unit))
        imgui.push_style_var(imgui.StyleVar_.window_padding, padding)
        imgui.push_style_var(imgui.StyleVar_.window_rounding, 0.0)
        imgui.set_next_window_pos(ImVec2(rect.left, self.size[1] - rect.bottom - rect.height))
        imgui.set_next_window_size(ImVec2(rect.width, rect.height))
        imgui.set_next_window_bg_alpha(1.0)
        imgui.begin(name, None, _BAR_FLAGS)
        imgui.pop_style_var(2)
        self.take_mouse()
        yield
        imgui.end()

    def _note(self, name: str, piece: Piece, image: mujoco.MjrRect, top: float) -> None:
        room = image.width - self.covered - self._line
        padding = 2 * imgui.get_style().window_padding.x
        wide = min(imgui.calc_text_size(piece[0]).x + padding + 1, max(room, 1.0))
        middle = image.left + (self.covered + image.width) / 2
        imgui.set_next_window_pos(ImVec2(round(middle - wide / 2), round(top)))
        imgui.set_next_window_size(ImVec2(wide, 0.0))  # The text determines the height.
        imgui.begin(name, None, _NOTE_FLAGS)
        self.widgets.text(*piece)
        imgui.end()

    def _handle(self) -> None:
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(0.0, 0.0))
        imgui.set_next_window_pos(ImVec2(0.0, round(_HANDLE_TOP * self._line)))
        imgui.begin("handle", None, _HANDLE_FLAGS)
        imgui.pop_style_var(1)
        self.take_mouse()
        if build_handle(self.widgets, "Tab"):
            self._host.shows_panel = True
        self.covered = _BESIDE_HANDLE * self._line
        imgui.end()

    def _panel(self, bottom: float) -> None:
        width, height = self.size
        margin = round(0.4 * self.text_height)
        room = max(_MAX_PANEL * (height - bottom) - margin, 100.0)
        wide = round(min(_PANEL * self.text_height, 0.6 * width))
        imgui.set_next_window_pos(ImVec2(margin, margin))
        imgui.set_next_window_size(ImVec2(wide, 0.0))  # The contents determine the height.
        imgui.set_next_window_size_constraints(ImVec2(wide, 0.0), ImVec2(wide, room))
        title = self._host.world.scene.name
        shown, is_open = imgui.begin(f"{title}###panel", True, _PANEL_FLAGS)
        self.take_mouse()
        self.covered = float(margin + wide)
        if shown:
            self._host.build_panel(self.widgets, unfolds_sources=False)
        imgui.end()
        self._host.shows_panel = bool(is_open)

    def _help(self) -> None:
        host = self._host
        shown, is_open = self._dialog(
            f"{dialogs.HELP_TITLE}###help", dialogs.help_width(self._columns)
        )
        if shown:
            dialogs.build_help(self.widgets, self._columns)
        is_pressed = imgui.is_window_hovered() and imgui.is_mouse_clicked(0)
        host.shows_help = is_open and not (is_pressed and not imgui.is_any_item_hovered())
        imgui.end()

    def _request(self) -> None:
        others = self._host.others
        shown, is_open = self._dialog(f"{dialogs.REQUEST_TITLE}###request", dialogs.REQUEST_WIDTH)
        if shown:
            others.build_dialog(self.widgets, can_allow=True)  # The user of a window is local.
        if not is_open:
            others.dismiss()
        imgui.end()

    def _dialog(self, title: str, width: float) -> tuple[bool, bool]:
        """Begins a centered dialog, which scrolls if the window is too small."""
        wide, high = self.size
        margin = round(0.4 * self.text_height)
        width = min(width * self.text_height, wide - 2 * margin)
        imgui.set_next_window_pos(ImVec2(wide / 2, high / 2), 0, ImVec2(0.5, 0.5))
        imgui.set_next_window_size(ImVec2(width, 0.0))
        largest = ImVec2(width, max(high - 2 * margin, 1.0))
        imgui.set_next_window_size_constraints(ImVec2(width, 0.0), largest)
        shown, is_open = imgui.begin(title, True, _PANEL_FLAGS)
        self.take_mouse()
        return shown, bool(is_open)


# All lengths below are in lines of the window's text.
_STATUS, _TIME = 1.6, 1.3  # heights of the status line and the timeline
_AREA_SHARE = 0.34  # fraction of the width for the area beside the image
_STRIP_SHARE = 0.36  # fraction of the height for the area below the image, in a narrow window
_NARROW = 46.0  # window width below which the area is below the image
_MIN_STRIP = 10.0  # minimum height of the area below the image
_MIN_AREA = 20.0  # minimum width of the area beside the image


class Rect(NamedTuple):
    """A rectangle in a window, in pixels from the lower left corner of the window."""

    left: int
    bottom: int
    width: int
    height: int


class Places(NamedTuple):
    """The rectangles of the parts of a window. A hidden part is None."""

    image: Rect
    area: Rect | None
    time: Rect | None
    status: Rect | None


def arrange(
    size: tuple[int, int], text: int, *, has_status: bool, has_time: bool, has_area: bool
) -> Places:
    """Arranges the parts of a window, so that they do not overlap.

    Args:
        size: width and height of the window in pixels.
        text: height of a line of text in pixels.
    """
    width, whole = size
    low = round(_STATUS * text) if has_status else 0
    high = round(_TIME * text) if has_time else 0
    status = Rect(0, 0, width, low) if low else None
    line = Rect(0, low, width, high) if high else None
    bottom, height = low + high, max(whole - low - high, 1)
    if not has_area:
        return Places(Rect(0, bottom, width, height), None, line, status)
    if width < _NARROW * text:
        strip = round(min(max(_STRIP_SHARE * height, _MIN_STRIP * text), 0.5 * height))
        image = Rect(0, bottom + strip, width, max(height - strip, 1))
        return Places(image, Rect(0, bottom, width, strip), line, status)
    beside = round(max(_AREA_SHARE * width, _MIN_AREA * text))
    left = width - beside
    area = Rect(left, bottom, beside, height)
    return Places(Rect(0, bottom, left, height), area, line, status)
