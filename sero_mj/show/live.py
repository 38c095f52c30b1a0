"""`LiveHost`: the common interface of window and web page, and functions that open them."""

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
    """The common interface of window and web page.

    Attributes:
        world: the compiled scene.
        data: its state.
        toggles: what is shown.
        clock: pause, speed and time line.
        joint: the joint of the world whose torques are plotted.
        work: time spent by sero-mj for the last frame, s.
        on_click: called with the clicked item and the gesture.
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
        """Returns the current picture, (height, width, 3), uint8."""

    def say(self, text: str, *, is_bad: bool = False) -> None:
        """Shows a message for a few seconds."""

    def close(self) -> None:
        """Closes the host."""


def open_window(mirror: LiveWorld, **options: Any) -> Window:
    """Opens a window on a mirror.

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
    """Serves a web page of a mirror.

    Args:
        mirror: must be open.
        options: see `WebHost`.

    Raises:
        RenderError: the page cannot be served there, or this MuJoCo does not include Studio.
        UnknownName: no camera of that name.
    """
    try:
        from .web.host import WebHost
    except ImportError as error:  # Studio is not built for every platform
        raise RenderError(
            f"no web page: this MuJoCo does not include Studio's web viewer ({error}); "
            "`sero-mj view SCENE --window` needs none"
        ) from error
    return WebHost(mirror, **options)
