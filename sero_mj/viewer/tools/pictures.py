"""Screenshots and videos of what is shown, and the command that renders it."""

from __future__ import annotations

import shlex
import time
from collections.abc import Collection, Mapping
from typing import ClassVar

from ..image.image_files import Pixels
from ..session.capture import PictureWriter
from ..session.clock import time_text
from ..session.keys import Key
from ..session.status_line import Piece
from ..session.tool import Action, Shown, Tool


class Pictures(Tool):
    """F2 and F3."""

    order: ClassVar[int] = 88
    keys: ClassVar[Mapping[str, Key]] = {
        "f2": Key("screenshot", "screenshot of the scene"),
        "f3": Key("film", "film on or off"),
    }

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self.capture = PictureWriter(shown.world.scene.name, shown.folder)
        self._is_screenshot_due = False

    def actions(self) -> Mapping[str, Action]:
        return {"screenshot": self._take_screenshot, "film": self._toggle_film}

    def _take_screenshot(self) -> None:
        self._is_screenshot_due = True

    def _toggle_film(self) -> str:
        if self.capture.is_filming:
            self.capture.stop()
            return "the film is complete"
        return self.capture.start(self.shown.picture_size, time.monotonic())

    @property
    def active(self) -> Collection[str]:
        return ["film"] if self.capture.is_filming else []

    @property
    def takes_pictures(self) -> bool:
        return self._is_screenshot_due or self.capture.is_filming

    def wants_picture(self, now: float) -> bool:
        return self._is_screenshot_due or self.capture.wants(now)

    def take_picture(self, pixels: Pixels, now: float) -> None:
        if self._is_screenshot_due:
            self.capture.picture(pixels)
        self.capture.add(pixels, now)
        self._is_screenshot_due = False

    def ongoing(self) -> Piece | None:
        capture = self.capture
        return (f"filming {time_text(capture.seconds)}", "bad") if capture.is_filming else None

    def next_message(self) -> tuple[str, bool] | None:
        return self.capture.next_message()

    def close(self) -> None:
        self.capture.close()


class CopyCommand(Tool):
    """Ctrl+C: the command, on the clipboard."""

    order: ClassVar[int] = 85
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "ctrl+c": ("copy", "copy the command that renders this picture")
    }

    def actions(self) -> Mapping[str, Action]:
        return {"copy": self._copy}

    def _copy(self) -> str:
        shown = self.shown
        if shown.decor.fixed:
            return f"{shown.decor.fixed}; no command makes this picture, F2 keeps it"
        state, (width, height) = shown.view_state(), shown.picture_size
        words = ["sero-mj", "render", *shown.render_words()]
        words += [] if state.time is None else ["--at", f"{state.time:g}"]
        words += ["--size", f"{width}x{height}", "-o", "picture.png"]
        shown.to_clipboard(shlex.join(words))
        live = "; what is live will have gone on" if shown.clock.is_live else ""
        return f"copied: the command that renders this picture{live}"
