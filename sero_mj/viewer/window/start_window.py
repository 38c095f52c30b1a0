"""`StartWindow`: the start page in a window."""

from __future__ import annotations

from pathlib import Path
from typing import Self

import mujoco
import numpy as np
from imgui_bundle import ImVec2, imgui
from PIL import Image

from ...data.drive.mirror import Mirror
from ...robots.assemble.world import World
from ...robots.declared.scene import Scene
from ..host import start_page as texts
from ..host.start_page import ExpectedPackets, Opener, PortMonitor, Section, StartPage, Tile
from .gl_blend import make_texture
from .glfw_window import GlWindow
from .imgui_layer import ImguiLayer

_FLAGS = (
    imgui.WindowFlags_.no_decoration
    | imgui.WindowFlags_.no_move
    | imgui.WindowFlags_.no_saved_settings
    | imgui.WindowFlags_.no_bring_to_front_on_focus
)
# Lengths are in units of the text height, unless stated otherwise.
_TILE, _WIDEST = 13.5, 22.0  # minimum and maximum width of tiles
_GAP, _SIDE, _MARGIN = 1.0, 23.0, 1.6
_HEAD = 4.4  # height above the tiles, with a message of one line
_ASPECT = 0.625  # ratio of image height to image width
_LARGE, _SMALL = 1.6, 0.86  # heights of the title and of text below images
_NARROW = 52.0  # window width below which the side column is below the tiles
_BACKGROUND = (0.05, 0.06, 0.08, 1.0)
_RIM = 3.0  # width of the highlight around an image, pixels
_WAIT, _IDLE = 0.05, 0.25  # times between frames with and without events, s


class StartWindow:
    """A window that shows the start page until the user opens a scene, robot or recording."""

    def __init__(
        self,
        opener: Opener,
        listening: PortMonitor,
        size: tuple[int, int],
        *,
        full_screen: bool = False,
    ) -> None:
        self.page = StartPage(opener, listening)
        self.gl = GlWindow(World(Scene(floor=False)), size, texts.TITLE, full_screen=full_screen)
        self._layer = ImguiLayer(self.gl)
        self._textures: dict[Path, int | None] = {}
        self._typed = self._search = ""

    def run(self) -> Mirror | None:
        while self.frame():
            pass
        return self.page.chosen

    def frame(self) -> bool:
        gl, page = self.gl, self.page
        if gl.is_closing or page.chosen is not None:
            return False
        is_opening = page.is_opening
        events = gl.events()
        for event in events:
            if event.kind == "drop":
                page.choose(Path(event.key))
            else:
                self._layer.take(event)
        size = gl.size
        if all(size):
            self._layer.frame(size, self._build)
            mujoco.mjr_rectangle(mujoco.MjrRect(0, 0, *size), *_BACKGROUND)
            self._layer.draw()
            gl.swap()
        if is_opening:  # The frame above has shown the message about opening the file.
            return not page.open_next(0.0)
        if not page.is_opening:
            gl.wait(_WAIT if events else _IDLE)
        return True

    def _build(self) -> None:
        unit, (width, height) = self._layer.text_height, self._layer.size
        imgui.set_next_window_pos(ImVec2(0.0, 0.0))
        imgui.set_next_window_size(ImVec2(width, height))
        imgui.set_next_window_bg_alpha(0.0)
        imgui.push_style_var(imgui.StyleVar_.window_padding, ImVec2(_MARGIN * unit, unit))
        imgui.begin("start", None, _FLAGS)
        self._layer.take_mouse()
        side = 0.0 if width < _NARROW * unit else _SIDE * unit
        self._head()
        top = imgui.get_cursor_pos_y()
        child = imgui.ChildFlags_.always_use_window_padding
        imgui.set_cursor_pos(ImVec2(0.0, top))
        if imgui.begin_child("tiles", ImVec2(width - side, height - top), child):
            if not side:
                self._files()
            for section in self.page.found(self._search):
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
        imgui.end()
        imgui.pop_style_var(1)

    def _head(self) -> None:
        ui, notice = self._layer.widgets, self.page.notice
        imgui.push_font(None, _LARGE * self._layer.text_height)
        ui.text(texts.TITLE, "title")
        imgui.pop_font()
        ui.same_line()
        ui.text(texts.TAGLINE, "dim")
        ui.width(min(_SIDE, ui.room()[0]))
        self._search = ui.search("##search", self._search, texts.SEARCH_HINT)
        if notice.is_shown:
            ui.same_line()
            ui.text(notice.text, "bad" if notice.is_bad else "good")
        # The line of the message is reserved, so that tiles do not move when a message appears.
        bottom = _HEAD * self._layer.text_height
        imgui.set_cursor_pos_y(max(imgui.get_cursor_pos_y(), bottom))

    def _section(self, section: Section) -> None:
        unit = self._layer.text_height
        self._layer.widgets.title(section.title)
        room, gap = imgui.get_content_region_avail().x, _GAP * unit
        columns = max(int((room + gap) / (_TILE * unit + gap)), 1)
        wide = min((room + gap) / columns - gap, _WIDEST * unit)
        for k, tile in enumerate(section.tiles):
            if k % columns:
                imgui.same_line(0.0, gap)
            self._tile(f"{tile.title}##{section.title}{k}", tile, wide)
        imgui.dummy(ImVec2(0.0, 0.5 * unit))

    def _tile(self, label: str, tile: Tile, wide: float) -> None:
        size = ImVec2(wide, _ASPECT * wide)
        texture = self._texture(tile.image) if imgui.is_rect_visible(size) else None
        imgui.begin_group()
        imgui.push_style_var(imgui.StyleVar_.frame_padding, ImVec2(_RIM, _RIM))
        if texture is None:
            is_chosen = imgui.button(f"##{label}", size)
        else:
            inner = ImVec2(size.x - 2 * _RIM, size.y - 2 * _RIM)
            is_chosen = imgui.image_button(label, imgui.ImTextureRef(texture), inner)
        imgui.pop_style_var(1)
        imgui.push_text_wrap_pos(imgui.get_cursor_pos_x() + wide)
        imgui.text(tile.title)
        imgui.push_font(None, _SMALL * self._layer.text_height)
        imgui.text_disabled(tile.about)
        imgui.pop_font()
        imgui.pop_text_wrap_pos()
        imgui.dummy(ImVec2(wide, 0.3 * self._layer.text_height))
        imgui.end_group()
        if is_chosen:
            self.page.choose(tile.view)

    def _texture(self, path: Path | None) -> int | None:
        if path is None:
            return None
        if path not in self._textures:
            try:
                with Image.open(path) as image:
                    pixels = np.ascontiguousarray(image.convert("RGB"))
                self._textures[path] = make_texture(pixels)
            except OSError:  # The image is damaged or was deleted.
                self._textures[path] = None
        return self._textures[path]

    def _files(self) -> None:
        ui = self._layer.widgets
        ui.title("Open a file")
        ui.text(texts.DROP_HINT, "dim")
        ui.width(0.0)
        entered = imgui.InputTextFlags_.enter_returns_true
        hint = "or type its path and press Enter"
        typed, self._typed = imgui.input_text_with_hint("##path", hint, self._typed, entered)
        if typed and self._typed.strip():
            self.page.choose(Path(self._typed.strip()).expanduser())
        imgui.dummy(ImVec2(0.0, 0.5 * self._layer.text_height))

    def _data(self) -> None:
        ui = self._layer.widgets
        ui.title("Data")
        for expected in self.page.expected():
            self._expected(expected)
        ui.text(texts.MORE_HINT, "dim")

    def _expected(self, expected: ExpectedPackets) -> None:
        ui, unit = self._layer.widgets, self._layer.text_height
        ui.text(expected.text, expected.mood)
        ui.scope(expected.where)
        imgui.indent(unit)
        ui.text(expected.packets, "dim")
        for view in expected.shown:
            if ui.button(f"show {Path(view.scene).name}"):
                self.page.choose(view)
        if expected.command:
            ui.text(f"test with: {expected.command}", "dim")
            ui.same_line()
            if imgui.small_button("copy"):
                ui.copy(expected.command)
        imgui.unindent(unit)
        ui.end_scope()

    def close(self) -> None:
        self._layer.close()
        self.gl.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()
