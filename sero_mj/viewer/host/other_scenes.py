"""`OtherScenes`: what the user may open instead of the scene that is shown."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from ...base.errors import SeroError
from ...base.trust import Request, allow
from ...data.drive.mirror import Mirror
from ..panels.request_panel import build_request
from ..session.widgets import Widgets

log = logging.getLogger(__name__)


class OtherScenes:
    """Ends a window or page where the user opens another scene.

    Attributes:
        offers: makes of other scenes, by the label of a button; None of what is no scene.
        opener: returns the mirror of a dropped file; None if files cannot be opened.
        chosen: the mirror to be shown after that, if any.
        request: what the file of the scene asks to run, and may not; None for nothing.
        asks: whether the dialog about that is shown.
    """

    def __init__(self, say: Callable[[str, bool], None], close: Callable[[], object]) -> None:
        self.offers: dict[str, Callable[[], Mirror | None]] = {}
        self.opener: Callable[[Path], Mirror] | None = None
        self.chosen: Mirror | None = None
        self.request: Request | None = None
        self.asks = False
        self._allowed: Callable[[], Mirror] | None = None
        self._say, self._close = say, close

    def build(self, ui: Widgets) -> None:
        for label in self.offers:
            if ui.button(label):
                self.take(label)
        if self.request is not None and ui.button("programs of this file ..."):
            self.asks = True

    def ask(self, request: Request, allowed: Callable[[], Mirror]) -> None:
        """Shows the dialog of a file that asks to run programs.

        Args:
            allowed: returns the mirror that simulates the file once its request is allowed.
        """
        self.request, self._allowed, self.asks = request, allowed, True

    def build_dialog(self, ui: Widgets, *, can_allow: bool) -> None:
        """Builds that dialog; `can_allow`: whether who has control is on this machine."""
        if self.request is not None:
            build_request(
                ui, self.request, can_allow=can_allow, allow=self.allow, dismiss=self.dismiss
            )

    def dismiss(self) -> None:
        self.asks = False

    def allow(self) -> None:
        """Allows what the file asks for, and continues with its simulation."""
        if self.request is not None and self._allowed is not None:
            allow(self.request)
            self.asks = False
            self._go_on_with(self._allowed)

    def take(self, label: str) -> None:
        """Goes on with an offer, or shows an error message."""
        self._go_on_with(self.offers[label])

    def open_file(self, path: Path) -> bool:
        """Goes on with the scene, robot or recording of a file, or shows an error message.

        Returns:
            whether the file is opened.
        """
        opener = self.opener
        if opener is None:
            text = f"{path.name}: files are opened by `sero-mj view` alone"
            self._say(text, True)
            return False
        return self._go_on_with(lambda: opener(path))

    def _go_on_with(self, make: Callable[[], Mirror | None]) -> bool:
        try:
            self.chosen = make()
        except SeroError as error:
            self._say(str(error), True)
            return False
        except Exception as error:  # of a file from anywhere, which must not end the viewer
            log.exception("a file cannot be opened")
            self._say(f"it cannot be opened: {type(error).__name__}: {error}", True)
            return False
        self._close()
        return True
