"""`StudioWidgets`: the widgets of panels by MuJoCo Studio's imgui, for pages; colours of text."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mujoco.studio.dear_imgui import dear_imgui as imgui

from ..session.status_line import Mood

_OPEN = int(imgui.TreeNodeFlags.DefaultOpen)
_TYPED = int(imgui.InputTextFlags.EnterReturnsTrue)
_FIXED = int(imgui.TableColumnFlags.WidthFixed)
_STRETCHED = int(imgui.TableColumnFlags.WidthStretch)
Rgb = tuple[float, float, float]
# On Studio's light themes and on its dark ones. Contrast with the window is at least 4.5 (WCAG).
MOODS: dict[Mood, tuple[Rgb, Rgb] | None] = {
    "good": ((0.04, 0.41, 0.16), (0.45, 0.82, 0.56)),
    "quiet": ((0.37, 0.39, 0.43), (0.72, 0.74, 0.77)),
    "bad": ((0.70, 0.17, 0.02), (1.00, 0.62, 0.46)),
    "plain": None,
}


def mood_rgb(mood: Mood) -> Rgb | None:
    """Returns the colour of a mood on the page's current theme; None for the theme's own."""
    colours, window = MOODS[mood], imgui.GetStyleColorVec4(int(imgui.Col.WindowBg))
    return None if colours is None else colours[window.y < 0.5]


def write_line(text: str, mood: Mood = "plain", *, is_wrapped: bool = True) -> None:
    """Writes a line in the colour of a mood.

    Args:
        text: the line.
        mood: of the line.
        is_wrapped: whether to wrap it at the window's width.
    """
    write, rgb = imgui.TextWrapped if is_wrapped else imgui.TextUnformatted, mood_rgb(mood)
    if rgb is None:
        write(text)
        return
    imgui.PushStyleColor(int(imgui.Col.Text), imgui.Vec4(*rgb, 1.0))
    write(text)
    imgui.PopStyleColor(1)


class StudioWidgets:
    """See `Widgets`.

    Attributes:
        to_clipboard: takes a text to the clipboard of the browser in control.
    """

    def __init__(self) -> None:
        self.to_clipboard: Callable[[str], None] = imgui.SetClipboardText

    text = staticmethod(write_line)

    def label(self, words: str) -> None:
        """Writes a text beside a field."""
        imgui.AlignTextToFramePadding()
        imgui.TextUnformatted(words)

    def title(self, words: str) -> None:
        """Writes a heading."""
        imgui.SeparatorText(words)

    def header(self, label: str, *, is_open: bool = False) -> bool:
        """Begins a section."""
        return bool(imgui.CollapsingHeader(label, _OPEN if is_open else 0))

    def tree(self, label: str) -> bool:
        """Begins a node."""
        return bool(imgui.TreeNode(label))

    def end_tree(self) -> None:
        """Ends it."""
        imgui.TreePop()

    def table(self, name: str, widths: Sequence[float]) -> bool:
        """Begins a table."""
        if not imgui.BeginTable(name, len(widths)):
            return False
        for i, width in enumerate(widths):
            flags = _FIXED if width else _STRETCHED
            imgui.TableSetupColumn(f"{i}", flags, width * imgui.GetFontSize())
        return True

    def row(self) -> None:
        """Begins a row."""
        imgui.TableNextRow()

    def cell(self) -> None:
        """Begins a cell."""
        imgui.TableNextColumn()

    def end_table(self) -> None:
        """Ends a table."""
        imgui.EndTable()

    def scope(self, name: str) -> None:
        """Begins a scope."""
        imgui.PushID(name)

    def end_scope(self) -> None:
        """Ends it."""
        imgui.PopID()

    def same_line(self, left: float = 0.0) -> None:
        """Goes on in the same line."""
        imgui.SameLine(left * imgui.GetFontSize())

    def width(self, width: float) -> None:
        """Sets the next width."""
        imgui.SetNextItemWidth(width * imgui.GetFontSize() or -1.0)

    def tip(self, words: str) -> None:
        """Explains the last widget."""
        imgui.SetItemTooltip(words)

    def disable(self, *, is_off: bool) -> None:
        """Begins what takes no input."""
        imgui.BeginDisabled(is_off)

    def enable(self) -> None:
        """Ends it."""
        imgui.EndDisabled()

    def button(self, label: str) -> bool:
        """Builds a button."""
        return bool(imgui.Button(label))

    def select(self, label: str, *, is_lit: bool) -> bool:
        """Builds a text that can be clicked on."""
        imgui.AlignTextToFramePadding()
        return bool(imgui.Selectable(label, is_lit))

    def search(self, label: str, text: str, hint: str) -> str:
        """Builds a field for a text."""
        return str(imgui.InputTextWithHint(label, hint, text)[1])

    def check(self, label: str, is_on: bool) -> tuple[bool, bool]:
        """Builds a check box."""
        changed, now = imgui.Checkbox(label, is_on)
        return changed, now

    def choose(self, label: str, index: int, names: Sequence[str]) -> tuple[bool, int]:
        """Builds a list."""
        changed, now = imgui.Combo(label, index, names)
        return changed, now

    def slide(
        self, label: str, value: float, low: float, high: float, text: str
    ) -> tuple[bool, float]:
        """Builds a slider."""
        changed, now = imgui.SliderFloat(label, value, low, high, text)
        return changed, now

    def number(self, label: str, value: float, text: str) -> tuple[bool, float]:
        """Builds a field for a number."""
        changed, now = imgui.InputDouble(label, value, 0.0, 0.0, text, _TYPED)
        return changed, now

    def lines(self, label: str, text: str, count: int) -> None:
        """Shows text to copy from."""
        size = imgui.Vec2(-1.0, (count + 0.6) * imgui.GetTextLineHeight())
        imgui.InputTextMultiline(label, text, size, int(imgui.InputTextFlags.ReadOnly))

    def copy(self, text: str) -> None:
        """Puts a text onto the browser's clipboard."""
        self.to_clipboard(text)
