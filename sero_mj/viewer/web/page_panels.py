"""`PagePanels`: builds the panels of a page as trees of nodes, with the same code as windows."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from ..host.live import LiveHost
from ..panels import dialogs
from ..panels.dom_widgets import DomWidgets, Node
from ..panels.status_line import build_timeline
from ..session.keys import help_columns
from ..session.status_line import status_pieces
from ..session.tool import Tool, tool_keys
from .sections import Sections

REQUEST = "request"  # tree of the dialog that asks whether a file may run programs
_EM = 14.0  # text height in `page.css`, pixels
_INTERVAL = 1.0 / 15.0  # time between two updates of panels, s
_NARROW = 800  # page width below which the panel is initially hidden, pixels
# The lengths below are in text heights. `_FRAME` is the height of title and margins of an area.
_PANEL_WIDTH, _AREA_WIDTH, _AREA_HEIGHT, _FRAME = 23.0, 32.0, 48.0, 4.0
_TALL = 400.0  # height of a panel with a scroll bar


class PagePanels:
    """Builds the panels of a page, and writes them to the page's `Sections`."""

    def __init__(self, host: LiveHost, sections: Sections) -> None:
        self._host, self._sections = host, sections
        self._trees: dict[str, DomWidgets] = {}
        self._built = float("-inf")
        self._has_input = False
        self._is_narrow, self._width = False, 1280
        self._help_columns = help_columns(tool_keys(), on_page=True)

    def act(self, tree: str, id_: str, value: Any) -> None:
        if tree in self._trees:
            self._trees[tree].act(id_, value)
            self._has_input = True

    def fold(self, tree: str, id_: str, *, is_open: bool) -> None:
        if tree in self._trees:
            self._trees[tree].fold(id_, is_open=is_open)
            self._has_input = True

    def fit(self, width: int) -> None:
        """Hides the panel if the page becomes narrow, and shows it if the page becomes wide."""
        if self._is_narrow != (width < _NARROW):
            self._is_narrow = width < _NARROW
            self._host.shows_panel = not self._is_narrow
        self._width = width

    def put(
        self, frame_rate: float, geoms: int, size: tuple[int, int], *, is_local: bool | None = None
    ) -> None:
        """Updates the panels about 15 times per second, and immediately after user input.

        Args:
            frame_rate: number of frames per second.
            geoms: number of geoms of overlays.
            size: width and height of the image in pixels.
            is_local: whether the browser in control is on this machine; None if no browser is in
                control.
        """
        host, put, now = self._host, self._sections.put, time.monotonic()
        ongoing = host.tools.ongoing
        put("message", list(host.notice.piece) if host.notice.is_shown else None)
        put("ongoing", None if ongoing is None else list(ongoing))
        if not self._has_input and now - self._built < _INTERVAL:
            return
        self._built, self._has_input = now, False
        put("about", {"title": host.world.scene.name, "geoms": geoms})
        sources = host.mirror.sources.values()
        put("status", [list(piece) for piece in status_pieces(sources, host.clock, frame_rate)])
        self._put_tree("panel", self._host.shows_panel, self._panel, (_PANEL_WIDTH, _TALL))
        wide = self._width / _EM
        self._put_tree("timeLine", host.has_timeline, self._time_line, (wide, 2.0))
        room = min(dialogs.help_width(self._help_columns), wide - 2), _TALL
        self._put_tree("help", host.shows_help, self._help, room)
        room = min(dialogs.REQUEST_WIDTH, wide - 2), _TALL
        is_asked = host.others.asks and is_local is not None
        put("request", self._request(room, is_local=bool(is_local)) if is_asked else None)
        areas = host.tools.areas
        high = size[1] / _EM / max(len(areas), 1) - _FRAME
        room = min(_AREA_WIDTH, wide), max(min(_AREA_HEIGHT, high), 0.0)
        put("areas", [self._area(tool, room) for tool in areas])

    def _put_tree(
        self,
        name: str,
        is_shown: bool,
        build: Callable[[DomWidgets], object],
        size: tuple[float, float],
    ) -> None:
        self._sections.put(name, self._nodes(name, build, size) if is_shown else None)

    def _nodes(
        self, name: str, build: Callable[[DomWidgets], object], size: tuple[float, float]
    ) -> list[Node]:
        if name not in self._trees:
            self._trees[name] = DomWidgets(self._host.to_clipboard)
            self._trees[name].folds = self._host.folds
        ui = self._trees[name]
        return ui.tree_of(lambda: build(ui), size)

    def _request(self, size: tuple[float, float], *, is_local: bool) -> Node:
        def build(ui: DomWidgets) -> None:
            self._host.others.build_dialog(ui, can_allow=is_local)

        return {"title": dialogs.REQUEST_TITLE, "nodes": self._nodes(REQUEST, build, size)}

    def _area(self, tool: Tool, size: tuple[float, float]) -> Node:
        def build(ui: DomWidgets) -> None:
            self._host.tools.call(tool, lambda each: each.build_area(ui))

        nodes = self._nodes(f"area:{tool.area}", build, size)
        return {"title": tool.area, "name": tool.area, "nodes": nodes}

    def _panel(self, ui: DomWidgets) -> None:
        self._host.build_panel(ui, unfolds_sources=True)
        if ui.button("copy link to this view"):
            self._host.actions.perform("link")

    def _time_line(self, ui: DomWidgets) -> None:
        build_timeline(ui, self._host.clock, self._host.tools.ticks)

    def _help(self, ui: DomWidgets) -> None:
        dialogs.build_help(ui, self._help_columns)
