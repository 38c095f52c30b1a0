"""Tools that save screenshots and videos, and copy the command that renders the image."""

from __future__ import annotations

import shlex
import time
from collections.abc import Collection, Mapping
from typing import ClassVar

from ..image.image_files import Pixels
from ..session.capture import ImageWriter
from ..session.clock import time_text
from ..session.keys import Key
from ..session.status_line import Piece
from ..session.tool import Action, Shown, Tool


class Images(Tool):
    """Tool that takes screenshots with F2 and records videos with F3."""

    order: ClassVar[int] = 88
    keys: ClassVar[Mapping[str, Key]] = {
        "f2": Key("screenshot", "screenshot of the scene"),
        "f3": Key("video", "video recording on or off"),
    }

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        self.writer = ImageWriter(shown.world.scene.name, shown.folder)
        self._is_screenshot_due = False

    def actions(self) -> Mapping[str, Action]:
        return {"screenshot": self._take_screenshot, "video": self._toggle_video}

    def _take_screenshot(self) -> None:
        self._is_screenshot_due = True

    def _toggle_video(self) -> str:
        if self.writer.is_recording:
            self.writer.stop()
            return "video recording stopped"
        return self.writer.start(self.shown.image_size, time.monotonic())

    @property
    def active(self) -> Collection[str]:
        return ["video"] if self.writer.is_recording else []

    @property
    def takes_images(self) -> bool:
        return self._is_screenshot_due or self.writer.is_recording

    def wants_image(self, now: float) -> bool:
        return self._is_screenshot_due or self.writer.wants(now)

    def take_image(self, pixels: Pixels, now: float) -> None:
        if self._is_screenshot_due:
            self.writer.save_screenshot(pixels)
        self.writer.add(pixels, now)
        self._is_screenshot_due = False

    def ongoing(self) -> Piece | None:
        writer = self.writer
        return (f"recording {time_text(writer.seconds)}", "bad") if writer.is_recording else None

    def next_message(self) -> tuple[str, bool] | None:
        return self.writer.next_message()

    def close(self) -> None:
        self.writer.close()


class CopyCommand(Tool):
    """Tool that copies the command that renders the displayed image with Ctrl+C."""

    order: ClassVar[int] = 85
    keys: ClassVar[Mapping[str, tuple[str, str]]] = {
        "ctrl+c": ("copy", "copy the command that renders this image")
    }

    def actions(self) -> Mapping[str, Action]:
        return {"copy": self._copy}

    def _copy(self) -> str:
        shown = self.shown
        if shown.decor.fixed:
            return f"{shown.decor.fixed}; no command renders this image, but F2 saves it"
        state, (width, height) = shown.view_state(), shown.image_size
        words = ["sero-mj", "render", *shown.render_words()]
        words += [] if state.time is None else ["--at", f"{state.time:g}"]
        words += ["--size", f"{width}x{height}", "-o", "image.png"]
        shown.to_clipboard(shlex.join(words))
        live = "; its image will show newer data" if shown.clock.is_live else ""
        return f"copied the command that renders this image{live}"
