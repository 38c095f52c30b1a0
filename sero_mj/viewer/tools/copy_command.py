"""`CopyCommand`: the command that renders the picture which is shown."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import ClassVar

from ..session.tool import Action, Tool


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
