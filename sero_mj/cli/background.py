"""`Background`: what a scene is drawn over by `--over`.

A package adds one by an entry point in the group `sero_mj.backgrounds`. The first one is taken.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import UsageError
from ..base.options import Options
from ..base.plugins import BACKGROUNDS, load_first

if TYPE_CHECKING:
    from ..data.drive.mirror import Mirror
    from ..viewer.window.viewport import Viewport
    from .shared_options import OverOptions


class Background(ABC):
    """Draws scenes over pictures of the real robot. Objects are made without arguments."""

    @abstractmethod
    def render(self, options: Options, over: Path) -> list[str]:
        """Renders a picture or a film over a file; returns the silent sources.

        Args:
            options: those of `sero-mj render`.
            over: a photo or a video.

        Raises:
            SeroError: a problem of the scene, its sources, the camera or a file.
        """

    @abstractmethod
    def viewport(
        self, mirror: Mirror, options: OverOptions
    ) -> AbstractContextManager[Callable[..., Viewport]]:
        """Opens a camera or a video; yields what makes the viewport of a window that shows it.

        Args:
            mirror: of the scene.
            options: what it is drawn over.
        """


def find_background() -> Background:
    """Returns the installed background; raises UsageError without."""
    found: Background | None = load_first(BACKGROUNDS, Background)
    if found is None:
        raise UsageError("--over needs an extension that draws over photos and videos")
    return found
