"""`StudioWidgets`: the widgets of panels by MuJoCo Studio's Dear ImGui and ImPlot, for pages."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mujoco.studio.dear_imgui import dear_imgui
from mujoco.studio.implot import implot

from ..panels.imgui_widgets import ImguiWidgets
from ..panels.widgets import Line

_UPPER = {"id": "ID"}


def _camel(name: str) -> str:
    return "".join(_UPPER.get(part, part.capitalize()) for part in name.split("_"))


class _Spelled:
    """A module of Studio by imgui-bundle's names: `push_id` is `PushID`, `ImVec2` is `Vec2`."""

    def __init__(self, module: Any) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        if name.endswith("_"):
            return _Flags(getattr(self._module, name.strip("_").removeprefix("Im")))
        return getattr(self._module, name[2:] if name.startswith("Im") else _camel(name))


class _Flags:
    """Flags of Studio by imgui-bundle's names: `Col_.window_bg` is `Col.WindowBg`."""

    def __init__(self, flags: Any) -> None:
        self._flags = flags

    def __getattr__(self, name: str) -> int:
        return int(getattr(self._flags, _camel(name)))


class _Imgui(_Spelled):
    def selectable(self, label: str, is_lit: bool) -> tuple[bool, bool]:
        """See imgui-bundle."""
        return self._module.Selectable(label, is_lit), is_lit

    def get_window_draw_list(self) -> _Spelled:
        """See imgui-bundle."""
        return _Spelled(self._module.GetWindowDrawList())


class StudioWidgets(ImguiWidgets):
    """See `Widgets`; plots would be most of the data sent to the browser.

    Attributes:
        to_clipboard: takes a text to the clipboard of the browser in control.
    """

    points, interval = 320, 1.0 / 15.0

    def __init__(self) -> None:
        super().__init__(_Imgui(dear_imgui), _Spelled(implot))
        self.to_clipboard: Callable[[str], None] = dear_imgui.SetClipboardText

    def _plot_line(self, line: Line) -> None:
        # Colours cannot be set in Studio's ImPlot; its defaults start with blue and orange.
        implot.PlotLine(line.name, line.x.tolist(), line.y.tolist())

    def copy(self, text: str) -> None:
        """Puts a text onto the browser's clipboard."""
        self.to_clipboard(text)
