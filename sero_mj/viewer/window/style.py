"""Sets the fonts, colors and spacing of Dear ImGui in windows."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from imgui_bundle import ImVec2, ImVec4, imgui, implot

from ..decor.font import more_fonts

_TEXT, _DIM = (0.90, 0.92, 0.94), (0.60, 0.65, 0.71)
_GROUND = (0.07, 0.09, 0.12)
_RAISED, _HOVERED, _PRESSED = (0.16, 0.20, 0.25), (0.21, 0.27, 0.34), (0.26, 0.34, 0.43)
_ACCENT = (0.30, 0.60, 0.86)
_BRIGHT = (0.52, 0.76, 0.96)
_COLORS = {
    "text": (*_TEXT, 1.0),
    "text_disabled": (*_DIM, 1.0),
    "window_bg": (*_GROUND, 0.94),
    "popup_bg": (*_GROUND, 0.98),
    "border": (0.22, 0.26, 0.31, 0.8),
    "frame_bg": (*_RAISED, 1.0),
    "frame_bg_hovered": (*_HOVERED, 1.0),
    "frame_bg_active": (*_PRESSED, 1.0),
    "title_bg": (*_GROUND, 1.0),
    "title_bg_active": (*_GROUND, 1.0),
    "check_mark": (*_BRIGHT, 1.0),
    "slider_grab": (*_ACCENT, 1.0),
    "slider_grab_active": (*_BRIGHT, 1.0),
    "button": (*_RAISED, 1.0),
    "button_hovered": (*_HOVERED, 1.0),
    "button_active": (*_PRESSED, 1.0),
    "header": (*_RAISED, 1.0),
    "header_hovered": (*_HOVERED, 1.0),
    "header_active": (*_PRESSED, 1.0),
    "separator": (0.22, 0.26, 0.31, 1.0),
    "scrollbar_bg": (0.0, 0.0, 0.0, 0.0),
    "scrollbar_grab": (*_HOVERED, 1.0),
    "text_selected_bg": (*_ACCENT, 0.45),
}


_PLOT_COLORS = {
    "frame_bg": (0.0, 0.0, 0.0, 0.0),
    "plot_bg": (0.10, 0.12, 0.16, 1.0),
    "plot_border": (0.32, 0.36, 0.42, 1.0),
    "axis_grid": (0.32, 0.36, 0.42, 0.9),
    "axis_text": (*_DIM, 1.0),
    "legend_text": (*_TEXT, 1.0),
    "legend_bg": (0.0, 0.0, 0.0, 0.0),
    "legend_border": (0.0, 0.0, 0.0, 0.0),
}


def set_style(height: float) -> None:
    """Sets the style of the current ImGui and ImPlot contexts for a text height in pixels."""
    io, style = imgui.get_io(), imgui.get_style()
    font = files("sero_mj.viewer") / "fonts" / "Inter-Medium.ttf"
    io.fonts.add_font_from_file_ttf(str(Path(str(font))), height)
    for more in more_fonts():  # Each font adds characters that are missing in the previous ones.
        merged = imgui.ImFontConfig()
        merged.merge_mode = True
        io.fonts.add_font_from_file_ttf(more, height, merged)
    imgui.style_colors_dark()
    for name, rgba in _COLORS.items():
        style.set_color_(getattr(imgui.Col_, name), ImVec4(*rgba))
    style.window_rounding = style.popup_rounding = 0.4 * height
    style.frame_rounding = style.grab_rounding = style.scrollbar_rounding = 0.25 * height
    style.window_border_size = 0.0
    style.window_min_size = ImVec2(1.0, 1.0)
    # Sizes must be whole pixels. Otherwise, windows that fit their contents are slightly too low.
    style.window_padding = ImVec2(round(0.7 * height), round(0.6 * height))
    style.frame_padding = ImVec2(round(0.4 * height), round(0.2 * height))
    style.item_spacing = ImVec2(round(0.45 * height), round(0.3 * height))
    style.cell_padding = ImVec2(round(0.2 * height), round(0.12 * height))
    style.indent_spacing = round(0.9 * height)
    style.grab_min_size = round(0.6 * height)
    style.scrollbar_size = round(0.6 * height)
    plots = implot.get_style()
    for name, rgba in _PLOT_COLORS.items():
        plots.set_color_(getattr(implot.Col_, name), ImVec4(*rgba))
    plots.legend_padding = ImVec2(0.0, round(0.3 * height))
