"""`ImguiWidgets`: the widgets of windows, drawn with Dear ImGui and ImPlot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..session.status_line import Mood
from ..session.widgets import Plot, PlotLine, Rgb, Ticks

# Colors for light and dark themes. The contrast with the window is at least 4.5 (WCAG).
MOODS: dict[Mood, tuple[Rgb, Rgb]] = {
    "good": ((0.04, 0.41, 0.16), (0.55, 0.85, 0.62)),
    "quiet": ((0.47, 0.33, 0.00), (0.95, 0.80, 0.40)),
    "bad": ((0.70, 0.17, 0.02), (1.00, 0.58, 0.44)),
    "dim": ((0.37, 0.39, 0.43), (0.67, 0.71, 0.76)),
    "title": ((0.55, 0.30, 0.00), (1.00, 0.72, 0.30)),
}
_LIMIT: Rgb = (0.85, 0.30, 0.30)
_GRAB = 0.6  # width of the knob of a slider, in text heights
_EDGE = 2.0  # distance of the knob from the ends of the slider, pixels
_TICK = 0.28  # height of marks at the edges of a slider, fraction of the slider height
_BESIDE = 0.9  # margin of a plot for the last number of the axis, in text heights
_LINE = 1.75  # width of lines in plots, pixels
# The text of a mark is shown if the knob is within this fraction of the slider length around the
# mark, and until this time in seconds after the mark.
_NEAR, _AFTER = 0.012, 1.0
_TIP = 22.0  # maximum width of a tooltip, in text heights


class ImguiWidgets:
    """An implementation of `Widgets` for windows."""

    points, interval = 980, 0.0

    def __init__(self, imgui: Any, implot: Any) -> None:
        self._imgui, self._implot = imgui, implot
        self.folds: dict[str, bool] = {}
        self._unfolded: dict[str, bool] = {}  # state of sections in the last frame
        self._scopes: list[str] = []
        # ImGui has functions with the same meaning as these methods.
        self.row, self.cell = imgui.table_next_row, imgui.table_next_column
        self.end_table, self.end_tree = imgui.end_table, imgui.tree_pop
        self.enable, self.check = imgui.end_disabled, imgui.checkbox

    @property
    def _unit(self) -> float:
        return float(self._imgui.get_font_size())

    def _rgba(self, mood: Mood) -> Any:
        imgui = self._imgui
        is_dark = imgui.get_style_color_vec4(imgui.Col_.window_bg).y < 0.5
        return imgui.ImVec4(*MOODS[mood][is_dark], 1.0)

    def room(self) -> tuple[float, float]:
        room = self._imgui.get_content_region_avail()
        return room.x / self._unit, room.y / self._unit

    def wide(self, words: str) -> float:
        return float(self._imgui.calc_text_size(words).x) / self._unit

    def text(self, words: str, mood: Mood = "plain") -> None:
        imgui = self._imgui
        if mood != "plain":
            imgui.push_style_color(imgui.Col_.text, self._rgba(mood))
        imgui.push_text_wrap_pos(0.0)
        imgui.text_unformatted(words)
        imgui.pop_text_wrap_pos()
        if mood != "plain":
            imgui.pop_style_color(1)

    def label(self, words: str) -> None:
        self._imgui.align_text_to_frame_padding()
        self._imgui.text_unformatted(words)

    def title(self, words: str) -> None:
        imgui = self._imgui
        imgui.push_style_color(imgui.Col_.text, self._rgba("title"))
        imgui.separator_text(words)
        imgui.pop_style_color(1)

    def scope(self, name: str) -> None:
        self._imgui.push_id(name)
        self._scopes.append(name)

    def end_scope(self) -> None:
        self._imgui.pop_id()
        self._scopes.pop()

    def header(self, label: str, *, is_open: bool = False) -> bool:
        imgui, id_ = self._imgui, "/".join([*self._scopes, label])
        wanted = self.folds.get(id_, is_open)
        if self._unfolded.get(id_) != wanted:
            imgui.set_next_item_open(wanted)
        is_unfolded = bool(imgui.collapsing_header(label))
        if imgui.is_item_toggled_open():
            wanted = self.folds[id_] = is_unfolded
        self._unfolded[id_] = wanted
        return is_unfolded

    def tree(self, label: str) -> bool:
        return bool(self._imgui.tree_node(label))

    def table(self, name: str, widths: Sequence[float]) -> bool:
        imgui = self._imgui
        if not imgui.begin_table(name, len(widths)):
            return False
        flags = imgui.TableColumnFlags_
        for i, width in enumerate(widths):
            how = flags.width_fixed if width else flags.width_stretch
            imgui.table_setup_column(f"{i}", how, width * self._unit)
        return True

    def same_line(self, left: float = 0.0, gap: float = -1.0) -> None:
        self._imgui.same_line(left * self._unit, gap * self._unit)

    def width(self, width: float) -> None:
        self._imgui.set_next_item_width(width * self._unit or -1.0)

    def tip(self, words: str) -> None:
        imgui = self._imgui
        if imgui.begin_item_tooltip():
            imgui.push_text_wrap_pos(_TIP * self._unit)
            imgui.text_unformatted(words)
            imgui.pop_text_wrap_pos()
            imgui.end_tooltip()

    def disable(self, *, is_off: bool) -> None:
        self._imgui.begin_disabled(is_off)

    def button(self, label: str, width: float = 0.0) -> bool:
        return bool(self._imgui.button(label, self._imgui.ImVec2(width * self._unit, 0.0)))

    def select(self, label: str, *, is_lit: bool) -> bool:
        self._imgui.align_text_to_frame_padding()
        return bool(self._imgui.selectable(label, is_lit)[0])

    def search(self, label: str, text: str, hint: str) -> str:
        return str(self._imgui.input_text_with_hint(label, hint, text)[1])

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        changed, now = self._imgui.combo(label, index, list(names))
        return changed, now

    def slide(
        self, label: str, value: float, low: float, high: float, text: str, ticks: Ticks = ()
    ) -> tuple[bool, float]:
        imgui = self._imgui
        grab = _GRAB * self._unit
        near = _near_text(ticks, value, high - low)
        if near:
            text += f"   {near.replace('%', '%%')}"
        imgui.push_style_var(imgui.StyleVar_.grab_min_size, grab)
        changed, now = imgui.slider_float(label, value, low, high, text)
        imgui.pop_style_var(1)
        begin, end = imgui.get_item_rect_min(), imgui.get_item_rect_max()
        left, right = begin.x + _EDGE + grab / 2, end.x - _EDGE - grab / 2
        tall, draw = _TICK * (end.y - begin.y), imgui.get_window_draw_list()
        for at, mood, _ in ticks if high > low else ():
            x = left + min(max((at - low) / (high - low), 0.0), 1.0) * (right - left)
            color = imgui.get_color_u32(self._rgba(mood))
            for y in (begin.y, end.y - tall):
                draw.add_line(imgui.ImVec2(x, y), imgui.ImVec2(x, y + tall), color, _EDGE)
        return changed, now

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        typed = self._imgui.InputTextFlags_.enter_returns_true
        changed, now = self._imgui.input_double(label, value, 0.0, 0.0, text, typed)
        return changed, now

    def lines(self, label: str, text: str, count: int) -> None:
        imgui = self._imgui
        size = imgui.ImVec2(-1.0, (count + 0.6) * imgui.get_text_line_height())
        imgui.input_text_multiline(label, text, size, imgui.InputTextFlags_.read_only)

    def plot(self, plot: Plot, height: float) -> None:
        implot, imgui, unit = self._implot, self._imgui, self._unit
        padding = imgui.ImVec2(_BESIDE * unit, 0.3 * unit)
        implot.push_style_var(implot.StyleVar_.plot_padding, padding)
        is_shown = implot.begin_plot(f"##{plot.y_label}", imgui.ImVec2(-1.0, height * unit))
        implot.pop_style_var(1)
        if not is_shown:
            return
        implot.setup_axes("", plot.y_label)
        implot.setup_axis_format(implot.ImAxis_.x1, f"%g {plot.x_unit}")
        legend = implot.LegendFlags_
        implot.setup_legend(implot.Location_.north, legend.outside | legend.horizontal)
        implot.setup_axis_limits(implot.ImAxis_.x1, *plot.x_range, implot.Cond_.always)
        implot.setup_axis_limits(implot.ImAxis_.y1, *plot.y_range, implot.Cond_.always)
        for line in plot.lines:
            self._plot_line(line)
        low, high = plot.y_range
        red, flags = imgui.ImVec4(*_LIMIT, 1.0), implot.DragToolFlags_
        for number, limit in enumerate(plot.limits):
            if low <= limit <= high:
                implot.drag_line_y(number, limit, red, 1.5, flags.no_inputs | flags.no_fit)
                implot.tag_y(limit, red, "limit")
        implot.end_plot()

    def _plot_line(self, line: PlotLine) -> None:
        spec = self._implot.Spec()
        spec.line_color, spec.line_weight = self._imgui.ImVec4(*line.rgb, 1.0), _LINE
        self._implot.plot_line(line.name, line.x, line.y, spec)

    def copy(self, text: str) -> None:
        self._imgui.set_clipboard_text(text)


def _near_text(ticks: Sequence[tuple[float, Mood, str]], value: float, length: float) -> str:
    near = _NEAR * length
    there = [each for each in ticks if -near <= value - each[0] <= max(near, _AFTER)]
    return min(there, key=lambda each: abs(value - each[0]))[2] if there else ""
