"""The environment of tools without a window: mirror, clock, toggles, decor, and messages."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco

from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.scene_decor import SceneDecor
from sero_mj.viewer.session.clock import Clock
from sero_mj.viewer.session.view_state import ViewState, view_state_of


class Shown:
    """An implementation of `sero_mj.viewer.session.tool.Shown` without a window.

    Attributes:
        said: messages, and whether they are errors.
        copied: text on the clipboard.
        shows_panel: whether the panel was opened.
    """

    image_size = (640, 480)
    is_following = is_window = False

    def __init__(
        self,
        mirror: Any,
        *,
        toggles: Any = None,
        clock: Any = None,
        decor: Any = None,
        folder: Path | None = None,
    ) -> None:
        self.mirror, self.folder = mirror, folder
        self.world, self.data = mirror.world, mirror.data
        self.toggles = Toggles(self.world) if toggles is None else toggles
        self.clock = Clock(mirror) if clock is None else clock
        self.decor = SceneDecor(self.world, self.toggles) if decor is None else decor
        self.view_camera = mujoco.MjvCamera()
        self.tools: dict[str, Any] = {}
        self.said: list[tuple[str, bool]] = []
        self.copied = ""
        self.shows_panel = False

    def say(self, text: str, is_bad: bool = False) -> None:
        self.said.append((text, is_bad))

    def select(self, joint: int) -> None:
        self.toggles.selected = joint

    def view_state(self) -> ViewState:
        return view_state_of(self.world, self.view_camera, self.toggles, self.clock)

    def render_words(self) -> list[str]:
        return [self.world.scene.name]

    def to_clipboard(self, text: str) -> None:
        self.copied = text
