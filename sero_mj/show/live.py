"""The live hosts: a window where there is a screen, else a web page."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world_view import WorldView
from ..decor.toggles import Toggles
from ..drive.mirror import LiveWorld
from ..errors import RenderError
from .clock import Clock
from .interaction import OnClick

if TYPE_CHECKING:
    from .web.host import WebHost
    from .window.host import Window


class LiveHost(Protocol):
    """What a window and a page have in common.

    Attributes:
        world: the compiled scene.
        data: its state.
        toggles: what is shown.
        clock: pause, speed and time line.
        joint: the joint of the world whose torques are plotted.
        work: our own work for the last frame, s.
        on_click: called with what was clicked on and the gesture.
    """

    world: WorldView
    data: mujoco.MjData
    toggles: Toggles
    clock: Clock
    joint: int
    work: float
    on_click: OnClick | None

    @property
    def is_open(self) -> bool:
        """Whether the user has not closed it."""

    @property
    def is_due(self) -> bool:
        """Whether it is time for the next frame."""

    def frame(self, *, wait: bool = True) -> bool:
        """Shows one frame; returns whether it is still open."""

    def picture(self) -> NDArray[np.uint8]:
        """What is seen, (height, width, 3)."""

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Tells the user something for a few seconds."""

    def close(self) -> None:
        """Closes it."""


def open_window(mirror: LiveWorld, **options: Any) -> Window:
    """Shows a mirror in a window.

    Args:
        mirror: must be open.
        options: see `Window`.

    Raises:
        RenderError: there is no display, or no OpenGL.
        UnknownName: no camera of that name.
    """
    from .window.host import Window

    return Window(mirror, **options)


def open_page(mirror: LiveWorld, **options: Any) -> WebHost:
    """Serves a mirror on a web page.

    Args:
        mirror: must be open.
        options: see `WebHost`.

    Raises:
        RenderError: the page cannot be served there, or MuJoCo came without Studio.
        UnknownName: no camera of that name.
    """
    try:
        from .web.host import WebHost
    except ImportError as error:  # Studio is not built for every platform
        raise RenderError(
            f"no web page: this MuJoCo comes without Studio's web viewer ({error}); "
            "`sero-mj view SCENE --window` needs none"
        ) from error
    return WebHost(mirror, **options)
