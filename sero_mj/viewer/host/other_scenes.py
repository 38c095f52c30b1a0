"""`OtherScenes`: the scenes that a user can open from a window or page."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from ...base.errors import SeroError
from ...base.trust import Request, allow
from ...data.drive.mirror import Mirror
from ..panels.dialogs import build_request
from ..session.widgets import Widgets

log = logging.getLogger(__name__)


class OtherScenes:
    """Opens another scene from a window or page, which then closes.

    Attributes:
        offers: mapping from button labels to functions that open a scene. If a function returns
            None, the viewer closes without opening another scene.
        opener: function that opens a dropped file; None if files cannot be opened.
        chosen: mirror of the next scene, or None.
        request: request of the scene's file to run programs that are not allowed yet, or None.
        asks: whether the dialog about `request` is shown.
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

    def take(self, label: str) -> None:
        """Opens the scene of a button label in `offers`, or shows an error message."""
        self._open(self.offers[label])

    def ask(self, request: Request, allowed: Callable[[], Mirror]) -> None:
        """Shows the dialog that asks the user to allow the programs of a file.

        Args:
            request: request to run the programs.
            allowed: function that opens the file as a simulation after the user has agreed.
        """
        self.request, self._allowed, self.asks = request, allowed, True

    def build_dialog(self, ui: Widgets, *, can_allow: bool) -> None:
        if self.request is not None:
            build_request(
                ui, self.request, can_allow=can_allow, allow=self._allow, dismiss=self.dismiss
            )

    def dismiss(self) -> None:
        self.asks = False

    def _allow(self) -> None:
        if self.request is not None and self._allowed is not None:
            allow(self.request)
            self.asks = False
            self._open(self._allowed)

    def open_file(self, path: Path) -> bool:
        """Opens a scene, robot or recording. Returns False and shows an error if this fails."""
        opener = self.opener
        if opener is None:
            self._say(f"{path.name}: only `sero-mj view` opens dropped files", True)
            return False
        return self._open(lambda: opener(path))

    def _open(self, make: Callable[[], Mirror | None]) -> bool:
        try:
            self.chosen = make()
        except SeroError as error:
            self._say(str(error), True)
            return False
        except Exception as error:  # A malformed file must not end the viewer.
            log.exception("a file cannot be opened")
            self._say(f"the file cannot be opened: {type(error).__name__}: {error}", True)
            return False
        self._close()
        return True
