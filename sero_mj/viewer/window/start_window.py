"""`StartWindow`: the start page in a window."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Self

import mujoco
import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui
from PIL import Image

from ...base.errors import SeroError
from ...data.drive.mirror import Mirror
from ...robots.assemble.scene import Scene
from ...robots.assemble.world import World
from ..panels.imgui_widgets import MOODS
from ..panels.message import Message
from ..session.recent_views import RecentView
from ..session.start_page import (
    DROP_HINT,
    MORE_HINT,
    TAGLINE,
    TITLE,
    ExpectedPackets,
    Opener,
    PortMonitor,
    Section,
    Tile,
    sections,
)
from .gl_blend import make_texture
from .glfw_window import GlWindow
from .imgui_layer import ImguiLayer

_FLAGS = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
)
# Lengths in units of the text's height.
_TILE, _WIDEST = 13.5, 22.0  # widths of tiles
_GAP, _SIDE, _MARGIN = 1.0, 23.0, 1.6
_ASPECT = 0.625  # height of a picture over its width
_LARGE, _SMALL = 2.0, 0.86  # heights of texts
_NARROW = 52.0  # width of a window with the side column below
_BACKGROUND = (0.05, 0.06, 0.08)
_RIM = (0.52, 0.76, 0.96)
_WAIT, _IDLE = 0.05, 0.25  # s between two frames, while the pointer moves and else
_ERROR_TIME = 12.0  # s
DIM, TITLE_COLOUR = MOODS["dim"][1], MOODS["title"][1]


class StartWindow:
    """Shows what can be opened, until something is.

    Args:
        opener: returns what shows what was chosen.
        listening: hears the data that is awaited.
        size: of the window, in screen coordinates.
        full_screen: whether it covers the screen.

    Attributes:
        notice: the last message to the user.
        chosen: the scene that was opened; None for none so far.
        places: of what can be pressed, by its label: left, top, width, height, pixels.
    """

    def __init__(
        self,
        opener: Opener,
        listening: PortMonitor,
        size: tuple[int, int],
        *,
        full_screen: bool = False,
    ) -> None:
        self._opener = opener
        self.notice = Message()
        self.chosen: Mirror | None = None
        self.places: dict[str, tuple[float, float, float, float]] = {}
        self.gl = GlWindow(World(Scene(floor=False)), size, TITLE, full_screen=full_screen)
        self._layer = _WholeWindow(self.gl)
        self._sections = sections()
        self._textures: dict[Path, int | None] = {}
        self._wanted: RecentView | Path | None = None  # to be opened after this frame
        self._typed = ""
        self._listening = listening

    def run(self) -> Mirror | None:
        """Shows frames until something is opened; returns None when the window was closed."""
        while self.frame():
            pass
        return self.chosen

    def frame(self) -> bool:
        """Shows one frame; returns whether it goes on."""
        gl = self.gl
        if gl.is_closing or self.chosen is not None:
            return False
        wanted = self._wanted  # its name was shown by the last frame
        if wanted is not None:
            self._wanted = None
            self._open(wanted)
            return self.chosen is None
        events = gl.events()
        for event in events:
            if event.kind == "drop":
                self._choose(Path(event.key))
            else:
                self._layer.take(event)
        if all(gl.size):
            self._draw()
        if self._wanted is None:
            gl.wait(_WAIT if events else _IDLE)
        return True

    def _draw(self) -> None:
        width, height = self.gl.size
        self._layer.frame(self._build)
        whole = mujoco.MjrRect(0, 0, width, height)
        mujoco.mjr_rectangle(whole, *_BACKGROUND, 1.0)
        self._layer.draw()
        self.gl.swap()

    def _choose(self, what: RecentView | Path) -> None:
        name = what.name if isinstance(what, Path) else what.replay or what.scene
        self.notice = Message(f"opening {Path(name).name} ...", until=float("inf"))
        self._wanted = what

    def _open(self, what: RecentView | Path) -> None:
        try:
            self.chosen = self._opener(what)
        except SeroError as error:
            until = time.monotonic() + _ERROR_TIME
            self.notice = Message(str(error), is_bad=True, until=until)

    def _build(self) -> None:
        unit, (width, height) = self._layer.text_height, self.gl.size
        self._layer.begin()
        margin = _MARGIN * unit
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(margin, unit))
        side = 0.0 if width < _NARROW * unit else _SIDE * unit
        self._title(margin)
        top = imgui.get_cursor_pos_y()
        child = imgui.ChildFlags_.always_use_window_padding
        imgui.set_cursor_pos(ImVec2(0.0, top))
        if imgui.begin_child("tiles", ImVec2(width - side, height - top), child):
            if not side:
                self._files()
            for section in self._sections:
                self._section(section)
            if not side:
                self._data()
        imgui.end_child()
        if side:
            imgui.set_cursor_pos(ImVec2(width - side, top))
            if imgui.begin_child("side", ImVec2(side, height - top), child):
                self._files()
                self._data()
            imgui.end_child()
        imgui.pop_style_var()
        self._layer.end()

    def _title(self, margin: float) -> None:
        unit = self._layer.text_height
        imgui.set_cursor_pos(ImVec2(margin, 0.9 * unit))
        _text(TITLE, _LARGE * unit, TITLE_COLOUR)
        imgui.same_line(0.0, unit)
        imgui.set_cursor_pos_y(0.9 * unit + (_LARGE - 1.0) * 0.78 * unit)
        _text(TAGLINE, 1.0 * unit, DIM)
        imgui.set_cursor_pos(ImVec2(margin, 3.4 * unit))
        if self.notice.is_shown:
            imgui.push_text_wrap_pos(self.gl.size[0] - margin)
            _text(self.notice.text, unit, MOODS["bad" if self.notice.is_bad else "good"][1])
            imgui.pop_text_wrap_pos()
        # One line has its place whether there is one or not, so that nothing moves.
        imgui.set_cursor_pos_y(max(imgui.get_cursor_pos_y(), 5.0 * unit))

    def _section(self, section: Section) -> None:
        unit = self._layer.text_height
        _text(section.title, 1.25 * unit, TITLE_COLOUR)
        room, gap = imgui.get_content_region_avail().x, _GAP * unit
        columns = max(int((room + gap) / (_TILE * unit + gap)), 1)
        wide = (room + gap) / columns - gap
        for k, tile in enumerate(section.tiles):
            if k % columns:
                imgui.same_line(0.0, gap)
            self._tile(section, tile, min(wide, _WIDEST * unit))
        imgui.dummy(ImVec2(0.0, 0.5 * unit))

    def _tile(self, section: Section, tile: Tile, wide: float) -> None:
        unit, high = self._layer.text_height, _ASPECT * wide
        imgui.begin_group()
        corner = imgui.get_cursor_screen_pos()
        size = ImVec2(wide, high + 3.9 * unit)
        pressed = imgui.invisible_button(f"{section.title} {tile.view}", size)
        is_lit = imgui.is_item_hovered()
        self._note(tile.title, corner, size)
        if imgui.is_item_visible():
            draw, round_ = imgui.get_window_draw_list(), 0.4 * unit
            low, end = corner, ImVec2(corner.x + wide, corner.y + high)
            texture = self._texture(tile.picture)
            if texture is not None:
                whole = ImVec2(0.0, 0.0), ImVec2(1.0, 1.0)
                shade = _packed((1.0, 1.0, 1.0), 1.0 if is_lit else 0.9)
                draw.add_image_rounded(imgui.ImTextureRef(texture), low, end, *whole, shade, round_)
            else:
                draw.add_rect_filled(low, end, _packed((0.16, 0.20, 0.25)), round_)
            if is_lit:
                draw.add_rect(low, end, _packed(_RIM), round_, max(0.1 * unit, 1.5))
            font, at = imgui.get_font(), ImVec2(low.x, end.y + 0.25 * unit)
            clip = ImVec4(low.x, low.y, end.x, corner.y + size.y)
            draw.add_text(font, unit, at, _packed((0.95, 0.96, 0.97)), tile.title, 0.0, clip)
            at = ImVec2(low.x, at.y + 1.2 * unit)
            small = _SMALL * unit
            draw.add_text(font, small, at, _packed(DIM), _two_lines(tile.about, wide, small), 0.0)
        imgui.end_group()
        if pressed:
            self._choose(tile.view)

    def _texture(self, picture: Path | None) -> int | None:
        if picture is None:
            return None
        if picture not in self._textures:
            try:
                with Image.open(picture) as image:
                    pixels = np.ascontiguousarray(image.convert("RGB"))
                self._textures[picture] = make_texture(pixels)
            except OSError:  # damaged, or gone meanwhile
                self._textures[picture] = None
        return self._textures[picture]

    def _files(self) -> None:
        unit = self._layer.text_height
        _text("Open a file", 1.25 * unit, TITLE_COLOUR)
        corner, wide = imgui.get_cursor_screen_pos(), imgui.get_content_region_avail().x
        imgui.begin_group()
        pad = 0.7 * unit
        imgui.dummy(ImVec2(wide, 0.4 * pad))
        imgui.indent(pad)
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + wide - 2.0 * pad)
        _text(DROP_HINT, unit, DIM)
        imgui.pop_text_wrap_pos()
        imgui.set_next_item_width(wide - 2.0 * pad)
        entered = imgui.InputTextFlags_.enter_returns_true
        typed, text = imgui.input_text_with_hint(
            "##path", "or type its path, Enter", self._typed, entered
        )
        self._note("path", imgui.get_item_rect_min(), imgui.get_item_rect_size())
        self._typed = text
        if typed and text.strip():
            self._choose(Path(text.strip()).expanduser())
        imgui.unindent(pad)
        imgui.dummy(ImVec2(wide, 0.4 * pad))
        imgui.end_group()
        end = ImVec2(corner.x + wide, imgui.get_item_rect_max().y)
        draw = imgui.get_window_draw_list()
        draw.add_rect(corner, end, _packed((0.30, 0.36, 0.43)), 0.4 * unit, 1.0)
        imgui.dummy(ImVec2(0.0, 0.5 * unit))

    def _data(self) -> None:
        unit = self._layer.text_height
        _text("Data", 1.25 * unit, TITLE_COLOUR)
        for awaited in self._listening.awaited():
            self._awaited(awaited)
        imgui.dummy(ImVec2(0.0, 0.5 * unit))
        imgui.push_text_wrap_pos(0.0)
        _text(MORE_HINT, unit, DIM)
        imgui.pop_text_wrap_pos()

    def _awaited(self, awaited: ExpectedPackets) -> None:
        ui, unit = self._layer.widgets, self._layer.text_height
        ui.text(awaited.text, awaited.mood)
        ui.scope(awaited.where)
        imgui.indent(unit)
        imgui.push_text_wrap_pos(0.0)
        _text(awaited.expected, _SMALL * unit, DIM)
        imgui.pop_text_wrap_pos()
        for view in awaited.shown:
            name = Path(view.scene).name
            if ui.button(f"show {name}"):
                self._choose(view)
            self._note(f"show {name}", imgui.get_item_rect_min(), imgui.get_item_rect_size())
        if awaited.command:
            _text(f"try {awaited.command}", _SMALL * unit, DIM)
            imgui.same_line()
            if imgui.small_button("copy"):
                self.gl.set_clipboard(awaited.command)
        imgui.unindent(unit)
        ui.end_scope()
        imgui.dummy(ImVec2(0.0, 0.1 * unit))

    def _note(self, label: str, corner: ImVec2, size: ImVec2) -> None:
        self.places[label] = (corner.x, corner.y, size.x, size.y)

    def close(self) -> None:
        """Closes the window."""
        self._layer.close()
        self.gl.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


class _WholeWindow(ImguiLayer):
    """Widgets that cover the whole window."""

    def begin(self) -> None:
        """Begins what is shown."""
        width, height = self._gl.size
        imgui.set_next_window_pos(ImVec2(0.0, 0.0))
        imgui.set_next_window_size(ImVec2(width, height))
        imgui.push_style_color(imgui.Col_.window_bg, ImVec4(*_BACKGROUND, 1.0))
        imgui.begin("start", None, _FLAGS)
        self.take_mouse()

    def end(self) -> None:
        """Ends it."""
        imgui.end()
        imgui.pop_style_color()


def _text(words: str, height: float, rgb: tuple[float, float, float]) -> None:
    """Writes a text of that height, pixels."""
    imgui.push_font(None, height)
    imgui.push_style_color(imgui.Col_.text, ImVec4(*rgb, 1.0))
    imgui.text_unformatted(words)
    imgui.pop_style_color()
    imgui.pop_font()


def _packed(rgb: tuple[float, float, float], alpha: float = 1.0) -> int:
    return int(imgui.get_color_u32(ImVec4(*rgb, alpha)))


def _two_lines(text: str, width: float, height: float) -> str:
    """Breaks a text into at most two lines of a width, pixels."""
    imgui.push_font(None, height)
    lines, words = [""], text.split()
    while words:
        longer = f"{lines[-1]} {words[0]}".strip()
        if imgui.calc_text_size(longer).x <= width or not lines[-1]:
            lines[-1] = longer
        elif len(lines) < 2:
            lines.append(words[0])
        else:
            while imgui.calc_text_size(f"{lines[-1]} ...").x > width and " " in lines[-1]:
                lines[-1] = lines[-1].rpartition(" ")[0]
            lines[-1] += " ..."
            break
        words.pop(0)
    imgui.pop_font()
    return "\n".join(lines)
