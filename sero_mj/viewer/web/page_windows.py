"""The windows of the page: sources, robots, time, areas of tools, help."""

from __future__ import annotations

from mujoco.studio import messages, plugin
from mujoco.studio.dear_imgui import dear_imgui as imgui

from ..decor.geom_buffer import MAX_GEOMS
from ..panels import help as help_panel
from ..panels.robot_panel import build_handle
from ..panels.time_line import build_time_line
from ..session.interaction import help_columns
from ..session.live import LiveHost
from ..session.tool import Tool, tool_keys
from .studio_controls import StudioApp
from .studio_decor import CUT_OFF, WebDecor
from .studio_widgets import StudioWidgets

_ONCE = int(imgui.Cond.FirstUseEver)
_ALWAYS = int(imgui.Cond.Always)
_MARGIN = 12.0
_WIDTH = 318.0
_TOP = 34.0  # below Studio's menu bar


def _flags(*names: str) -> int:
    return sum(int(getattr(imgui.WindowFlags, name)) for name in names)


_BAR_FLAGS = _flags(
    "NoTitleBar", "NoResize", "NoScrollbar", "NoDocking", "NoMove", "NoSavedSettings"
)
_HANDLE_FLAGS = _BAR_FLAGS | _flags("AlwaysAutoResize", "NoBackground", "NoFocusOnAppearing")
_NOTE_FLAGS = _BAR_FLAGS | _flags("NoInputs", "NoFocusOnAppearing")
_PANEL_FLAGS = _flags("AlwaysAutoResize", "NoSavedSettings")
_NARROW = 3.2 * _WIDTH  # width below which panel and billboards would cover the robot
# Labels of Studio's menus, which are empty, and of ours: their key and action.
_CLOCK_MENU = {
    "Pause": ("Space", "pause"),
    "Step": (".", "step"),
    "Step back": (",", "step_back"),
    "Slower": ("-", "slower"),
    "Faster": ("+", "faster"),
    "Back to the start": ("Backspace", "reset"),
}
_ROBOT_MENU = {
    "Panel": ("T", "status_line"),
    "Torques": ("P", "plot"),
    "Undo": ("Ctrl+Z", "undo"),
    "Redo": ("Ctrl+Y", "redo"),
    "Copy as command": ("Ctrl+C", "copy"),
    "Copy a link to this view": ("", "link"),
    "Screenshot": ("F2", "screenshot"),
    "Film": ("F3", "film"),
    "Mouse and keys": ("H", "help"),
}
_NEEDS_PAST = ("step_back", "slower", "faster")  # actions
_TALL = 0.35  # fraction of the page's height above which a window counts as covering its edge


class PageWindows(plugin.ViewerPlugin):
    """The windows of the page, in addition to Studio's menus.

    Args:
        host: the host of the page.
        decor: of the page.
        studio: whose docked windows these stay beside.

    Attributes:
        widgets: of the panels.
    """

    def __init__(self, host: LiveHost, decor: WebDecor, studio: StudioApp) -> None:
        self._host, self._decor, self._studio = host, decor, studio
        self.widgets = StudioWidgets()
        self._is_narrow = False
        # Page sizes, and what is docked there, for which windows were placed.
        self._pages: dict[str, tuple[float, ...]] = {}
        # Margins that windows at the edges of the page cover, see `PictureView.inset`.
        self.inset = (0.0, 0.0, 0.0, 0.0)

    @messages.handler
    def on_build_gui(self, event: messages.BuildGuiEvent) -> None:
        """Builds all windows of a frame."""
        host, size = self._host, imgui.GetIO().DisplaySize
        left, right = self._studio.docked
        self.inset = (max(CUT_OFF[0], left), 0.0, right, CUT_OFF[1])
        # In every frame, since the size is unknown before a browser is connected.
        if self._is_narrow != (size.x < _NARROW):
            self._is_narrow = size.x < _NARROW
            host.shows_status = not self._is_narrow
        self._menu()
        self._time(size)
        if host.shows_status:
            self._panel(size)
        else:
            self._handle()
        for tool in host.areas:
            self._area(tool, size)
        if host.shows_help:
            self._help(size)
        self._message(size)

    def _when(self, window: str, size: imgui.Vec2) -> int:
        """Returns when to place a window: once for every page size and what is docked there."""
        now = (size.x, size.y, *self._studio.docked)
        last, self._pages[window] = self._pages.get(window), now
        return _ONCE if last == now else _ALWAYS

    def _menu(self) -> None:
        host = self._host
        lit = {
            "pause": host.clock.is_paused,
            "status_line": host.shows_status,
            "help": host.shows_help,
        }
        for active in host.tools.ask(lambda tool: tool.active):
            lit |= dict.fromkeys(active, True)
        if not imgui.BeginMainMenuBar():
            return
        for menu, items in (("Simulation", _CLOCK_MENU), ("Robot", _ROBOT_MENU)):
            if not imgui.BeginMenu(menu):
                continue
            for label, (key, action) in items.items():
                is_possible = host.clock.can_go_back or action not in _NEEDS_PAST
                if is_possible and imgui.MenuItem(label, key, lit.get(action, False)):
                    host.actions.perform(action)
            imgui.EndMenu()
        imgui.EndMainMenuBar()

    def _handle(self) -> None:
        """Builds the button that shows the hidden panel again."""
        imgui.SetNextWindowPos(imgui.Vec2(self._studio.docked[0] + _MARGIN, _TOP), _ALWAYS)
        imgui.Begin("##handle", True, _HANDLE_FLAGS)
        if build_handle(self.widgets, "t"):
            self._host.toggle_status()
        imgui.End()

    def _panel(self, size: imgui.Vec2) -> None:
        left = self._studio.docked[0] + _MARGIN
        imgui.SetNextWindowPos(imgui.Vec2(left, _TOP), self._when("panel", size))
        room = max(size.y - _TOP - 3 * _MARGIN - self.inset[1], 160.0)
        imgui.SetNextWindowSizeConstraints(imgui.Vec2(_WIDTH, 0.0), imgui.Vec2(_WIDTH, room))
        host = self._host
        shown, host.shows_status = imgui.Begin(
            f"{host.world.scene.name}###sero", True, _PANEL_FLAGS
        )
        self._cover(size.y)
        if shown:
            host.build_panel(self.widgets, unfolds_sources=True)
            self._count()
        imgui.End()

    def _cover(self, height: float) -> None:
        """Adds the current window to the inset, if it is at an edge of the page."""
        place, size = imgui.GetWindowPos(), imgui.GetWindowSize()
        width = imgui.GetIO().DisplaySize.x
        left, below, right, above = self.inset
        if size.y < _TALL * height or imgui.IsWindowCollapsed():
            return
        docked = self._studio.docked
        if place.x < docked[0] + 2 * _MARGIN:
            left = max(left, place.x + size.x)
        elif place.x + size.x > width - docked[1] - 2 * _MARGIN:
            right = max(right, width - place.x)
        if left + right < 0.7 * width:
            self.inset = (left, below, right, above)

    def _count(self) -> None:
        decor, ui = self._decor, self.widgets
        ui.text(f"decor: {decor.count} of {MAX_GEOMS} geoms", "dim")
        if decor.dropped:
            ui.text(
                f"{decor.dropped} more are not shown: the limit is {MAX_GEOMS}. "
                "Switch something off.",
                "bad",
            )

    def _time(self, size: imgui.Vec2) -> None:
        """Builds the time line, if there is one."""
        if not self._host.has_time_line:
            return
        height = imgui.GetFrameHeight() + 2 * 8.0
        begin, end = (docked + _MARGIN for docked in self._studio.docked)
        imgui.SetNextWindowPos(imgui.Vec2(begin, size.y - height - _MARGIN), _ALWAYS)
        imgui.SetNextWindowSize(imgui.Vec2(max(size.x - begin - end, 200.0), height), _ALWAYS)
        imgui.Begin("Time###time", True, _BAR_FLAGS)
        left, _, right, above = self.inset
        self.inset = (left, height + _MARGIN, right, above)
        build_time_line(self.widgets, self._host.clock, self._host.ticks)
        imgui.End()

    def _area(self, tool: Tool, size: imgui.Vec2) -> None:
        """Builds the area of a tool as a window."""
        width = min(460.0, max(0.31 * size.x, 240.0))
        height, when = min(520.0, max(size.y - 220.0, 240.0)), self._when(tool.area, size)
        left = size.x - self._studio.docked[1] - width - _MARGIN
        imgui.SetNextWindowPos(imgui.Vec2(left, _TOP + 80.0), when)
        imgui.SetNextWindowSize(imgui.Vec2(width, height), when)
        shown, tool.shows_area = imgui.Begin(f"{tool.area}###{tool.area.lower()}", tool.shows_area)
        self._cover(size.y)
        if shown:
            self._host.tools.call(tool, lambda tool: tool.build_area(self.widgets))
        imgui.End()

    def _help(self, size: imgui.Vec2) -> None:
        """Builds the help in the middle of the page, to be scrolled where it finds no room."""
        host = self._host
        room = size.y - _TOP - 2 * _MARGIN
        wide = min(help_panel.WIDTH * imgui.GetFontSize(), size.x - 2 * _MARGIN)
        middle = imgui.Vec2(size.x / 2, (_TOP + size.y) / 2)
        imgui.SetNextWindowPos(middle, _ALWAYS, imgui.Vec2(0.5, 0.5))
        imgui.SetNextWindowSizeConstraints(imgui.Vec2(wide, 0.0), imgui.Vec2(wide, room))
        title = f"{help_panel.TITLE}###help"
        _, host.shows_help = imgui.Begin(title, host.shows_help, _PANEL_FLAGS)
        help_panel.build_help(self.widgets, help_columns(tool_keys(), on_page=True))
        imgui.End()

    def _message(self, size: imgui.Vec2) -> None:
        host = self._host
        if host.notice.is_shown:
            piece = host.notice.piece
        elif (ongoing := host.ongoing) is not None:
            piece = ongoing
        else:
            return
        # Above the picture: the legend and what is said of a robot are below.
        left, _, right, above = self.inset
        room = size.x - left - right
        wide = min(imgui.CalcTextSize(piece[0]).x + 2 * _MARGIN, room)
        imgui.SetNextWindowPos(imgui.Vec2(left + (room - wide) / 2, above), _ALWAYS)
        imgui.SetNextWindowSize(imgui.Vec2(wide, 0.0), _ALWAYS)
        imgui.Begin("##message", True, _NOTE_FLAGS)
        self.widgets.text(*piece)
        imgui.End()
