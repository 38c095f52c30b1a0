"""`view`: a scene in a window that the user's own loop drives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.scene import Scene
from ..assemble.world import World
from ..drive.mirror import Mirror, load_scene
from ..drive.watch import Watch
from .headless import DEFAULT_SIZE
from .overlay import Overlay
from .picking import Picked
from .window import Window


class Viewer:
    """A window beside the user's own loop; `view` opens one. Use it as a context manager.

    Attributes:
        world: the compiled scene.
        data: its state; set joint angles and the like with `set`.
        window: with the camera, what is shown, and the clock.
    """

    def __init__(self, mirror: Mirror, **options: Any) -> None:
        self.world: World = mirror.world
        self.data: mujoco.MjData = mirror.data
        self._mirror = mirror
        mirror.open()
        try:
            self.window = Window(mirror, **options)
        except BaseException:
            mirror.close()
            raise
        self.window.frame()

    @property
    def is_open(self) -> bool:
        """Whether the user has not closed the window."""
        return not self.window.gl.is_closing

    def set(self, target: str, values: Any) -> None:
        """Sets an input, as a packet would.

        Args:
            target: `lwr.joint_angles`, `lwr.torques`, `goal.joint_angles`, `push.vector`, ...
            values: as many as it takes, SI units.

        Raises:
            UnknownName: no such input; lists those that exist.
            ValueError: they do not fit it.
        """
        self.world.set_input(self.data, target, values)

    def sync(self) -> bool:
        """Shows what is set now, where the screen is due for a new picture; else returns at once.

        So it may be called in every round of a fast loop. Call it on the thread that opened the
        window, and at least a few times a second: it also takes what mouse and keys do.

        Returns:
            whether the window is still open.
        """
        if self.window.is_due:
            return self.window.frame(wait=False)
        return self.is_open

    def on_click(self, callback: Callable[[Picked | None, str], None]) -> None:
        """Calls `callback(picked, gesture)` after every click, None for the sky and the floor."""
        self.window.on_click = callback

    def picture(self) -> NDArray[np.uint8]:
        """What is seen, (height, width, 3), without the window's own text."""
        return self.window.picture()

    def close(self) -> None:
        """Closes the window and the sources."""
        self.window.close()
        self._mirror.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def view(
    scene: Scene | Overlay | Path | str,
    *,
    size: tuple[int, int] = DEFAULT_SIZE,
    camera: str | None = None,
    full_screen: bool = False,
) -> Viewer:
    """Opens a window on a scene and returns at once.

    Its sources are mirrored, if it has any; all else is set by the caller:

        with sero_mj.view("lwr_udp") as viewer:
            while viewer.sync():
                viewer.set("lwr.torques", my_torques())

    Args:
        scene: a scene, a TOML file, a shipped scene's name, or an `overlay`, whose data the caller
            steps.
        size: of the window, in screen coordinates.
        camera: see `find_camera`.
        full_screen: whether it covers the screen.

    Raises:
        SeroError: what is wrong with the scene, its sources or the camera, or no display.
    """
    if isinstance(scene, Overlay):
        mirror: Mirror = Watch(scene.world)
    else:
        mirror = Mirror(scene if isinstance(scene, Scene) else load_scene(scene))
    return Viewer(mirror, size=size, camera=camera, full_screen=full_screen)
