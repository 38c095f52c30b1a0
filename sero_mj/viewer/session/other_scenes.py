"""`OtherScenes`: what the user may open instead of the scene that is shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ...base.errors import SeroError
from ...data.drive.mirror import Mirror
from ..panels.widgets import Widgets


class OtherScenes:
    """Ends a window or page where the user opens another scene.

    Args:
        say: shows a message, and whether it is an error.
        close: ends the window or page.

    Attributes:
        offers: makes of other scenes, by the label of a button; None of what is no scene.
        opener: returns the mirror of a dropped file; None if files cannot be opened.
        chosen: the mirror to be shown after that, if any.
    """

    def __init__(self, say: Callable[[str, bool], None], close: Callable[[], object]) -> None:
        self.offers: dict[str, Callable[[], Mirror | None]] = {}
        self.opener: Callable[[Path], Mirror] | None = None
        self.chosen: Mirror | None = None
        self._say, self._close = say, close

    def build(self, ui: Widgets) -> None:
        """Builds a button for each offer."""
        for label in self.offers:
            if ui.button(label):
                self.take(label)

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
        self._close()
        return True
