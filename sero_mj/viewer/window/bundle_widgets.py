"""`BundleWidgets`: the widgets of panels by imgui-bundle, for windows; and their look."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path

from imgui_bundle import ImVec2, ImVec4, imgui

from ..session.status_line import Mood
from .hud import DIM, MOODS, TEXT, TITLE

_OPEN = imgui.TreeNodeFlags_.default_open
_TYPED = imgui.InputTextFlags_.enter_returns_true
_READ_ONLY = imgui.InputTextFlags_.read_only
_FIXED = imgui.TableColumnFlags_.width_fixed
_STRETCHED = imgui.TableColumnFlags_.width_stretch
_GROUND = (0.07, 0.09, 0.12)
_RAISED, _HOVERED, _PRESSED = (0.16, 0.20, 0.25), (0.21, 0.27, 0.34), (0.26, 0.34, 0.43)
_ACCENT = (0.30, 0.60, 0.86)
_BRIGHT = (0.52, 0.76, 0.96)
_COLOURS = {
    "text": (*TEXT, 1.0),
    "text_disabled": (*DIM, 1.0),
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


def set_style(height: float) -> None:
    """Gives the current context of imgui the fonts and colours of the window.

    Args:
        height: of the text, pixels.
    """
    io, style = imgui.get_io(), imgui.get_style()
    font = files("sero_mj.viewer") / "fonts" / "Inter-Medium.ttf"
    io.fonts.add_font_from_file_ttf(str(Path(str(font))), height)
    imgui.style_colors_dark()
    for name, rgba in _COLOURS.items():
        style.set_color_(getattr(imgui.Col_, name), ImVec4(*rgba))
    style.window_rounding = style.popup_rounding = 0.4 * height
    style.frame_rounding = style.grab_rounding = style.scrollbar_rounding = 0.25 * height
    style.window_border_size = 0.0
    # Whole pixels: else what is as high as its contents seems to be a little too low.
    style.window_padding = ImVec2(round(0.7 * height), round(0.6 * height))
    style.frame_padding = ImVec2(round(0.4 * height), round(0.2 * height))
    style.item_spacing = ImVec2(round(0.45 * height), round(0.3 * height))
    style.cell_padding = ImVec2(round(0.2 * height), round(0.12 * height))
    style.indent_spacing = round(0.9 * height)
    style.grab_min_size = round(0.6 * height)
    style.scrollbar_size = round(0.6 * height)


class BundleWidgets:
    """See `Widgets`."""

    def text(self, words: str, mood: Mood = "plain") -> None:
        """Writes a text."""
        rgb = MOODS[mood] if mood != "plain" else TEXT
        imgui.push_style_color(imgui.Col_.text, ImVec4(*rgb, 1.0))
        imgui.push_text_wrap_pos(0.0)
        imgui.text_unformatted(words)
        imgui.pop_text_wrap_pos()
        imgui.pop_style_color()

    def label(self, words: str) -> None:
        """Writes a text beside a field."""
        imgui.align_text_to_frame_padding()
        imgui.text_unformatted(words)

    def title(self, words: str) -> None:
        """Writes a heading."""
        imgui.push_style_color(imgui.Col_.text, ImVec4(*TITLE, 1.0))
        imgui.separator_text(words)
        imgui.pop_style_color()

    def header(self, label: str, *, is_open: bool = False) -> bool:
        """Begins a section."""
        return bool(imgui.collapsing_header(label, _OPEN if is_open else 0))

    def tree(self, label: str) -> bool:
        """Begins a node."""
        return bool(imgui.tree_node(label))

    def end_tree(self) -> None:
        """Ends it."""
        imgui.tree_pop()

    def table(self, name: str, widths: Sequence[float]) -> bool:
        """Begins a table."""
        if not imgui.begin_table(name, len(widths)):
            return False
        for i, width in enumerate(widths):
            flags = _FIXED if width else _STRETCHED
            imgui.table_setup_column(f"{i}", flags, width * imgui.get_font_size())
        return True

    def row(self) -> None:
        """Begins a row."""
        imgui.table_next_row()

    def cell(self) -> None:
        """Begins a cell."""
        imgui.table_next_column()

    def end_table(self) -> None:
        """Ends a table."""
        imgui.end_table()

    def scope(self, name: str) -> None:
        """Begins a scope."""
        imgui.push_id(name)

    def end_scope(self) -> None:
        """Ends it."""
        imgui.pop_id()

    def same_line(self, left: float = 0.0) -> None:
        """Goes on in the same line."""
        imgui.same_line(left * imgui.get_font_size())

    def width(self, width: float) -> None:
        """Sets the next width."""
        imgui.set_next_item_width(width * imgui.get_font_size() or -1.0)

    def tip(self, words: str) -> None:
        """Explains the last widget."""
        if imgui.is_item_hovered(imgui.HoveredFlags_.for_tooltip) and imgui.begin_tooltip():
            imgui.push_text_wrap_pos(22.0 * imgui.get_font_size())
            imgui.text_unformatted(words)
            imgui.pop_text_wrap_pos()
            imgui.end_tooltip()

    def disable(self, *, is_off: bool) -> None:
        """Begins what takes no input."""
        imgui.begin_disabled(is_off)

    def enable(self) -> None:
        """Ends it."""
        imgui.end_disabled()

    def button(self, label: str) -> bool:
        """Builds a button."""
        return bool(imgui.button(label))

    def select(self, label: str, *, is_lit: bool) -> bool:
        """Builds a text that can be clicked on."""
        imgui.align_text_to_frame_padding()
        return bool(imgui.selectable(label, is_lit)[0])

    def search(self, label: str, text: str, hint: str) -> str:
        """Builds a field for a text."""
        return str(imgui.input_text_with_hint(label, hint, text)[1])

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        """Builds a check box."""
        return imgui.checkbox(label, is_on)

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        """Builds a list."""
        return imgui.combo(label, index, list(names))

    def slide(
        self, label: str, value: float, low: float, high: float, text: str
    ) -> tuple[bool, float]:
        """Builds a slider."""
        return imgui.slider_float(label, value, low, high, text)

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        """Builds a field for a number."""
        return imgui.input_double(label, value, 0.0, 0.0, text, _TYPED)

    def lines(self, label: str, text: str, count: int) -> None:
        """Shows text to copy from."""
        size = ImVec2(-1.0, (count + 0.6) * imgui.get_text_line_height())
        imgui.input_text_multiline(label, text, size, _READ_ONLY)

    def copy(self, text: str) -> None:
        """Puts a text onto the clipboard."""
        imgui.set_clipboard_text(text)
