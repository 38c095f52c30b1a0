"""`view`: a scene in a window or on a page that the user's own loop drives."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.scene import Scene
from ..assemble.world import World
from ..drive.mirror import Mirror
from ..drive.watch import Watch
from ..simulate.named_scene import read_named_scene
from .display import has_display
from .headless import DEFAULT_SIZE
from .live import LiveHost, open_page, open_window
from .overlay import Overlay
from .picking import Picked

log = logging.getLogger(__name__)


class Viewer:
    """A window or a page beside the user's own loop; `view` opens one. It is a context manager.

    Attributes:
        world: the compiled scene.
        data: its state; set joint angles and the like with `set`.
        host: the `Window` or `WebHost`, with what is shown, and the clock.
        url: of the page; None for a window.
    """

    def __init__(self, mirror: Mirror, open_host: Callable[..., LiveHost], **options: Any) -> None:
        self.world: World = mirror.world
        self.data: mujoco.MjData = mirror.data
        self._mirror = mirror
        mirror.open()
        try:
            self.host = open_host(mirror, **options)
        except BaseException:
            mirror.close()
            raise
        self.url: str | None = getattr(self.host, "url", None)
        self.host.frame()

    @property
    def is_open(self) -> bool:
        """Whether the user has not closed it."""
        return self.host.is_open

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
        """Shows what is set now, where it is time for a new picture; else returns at once.

        So it may be called in every round of a fast loop. Call it on the thread that opened the
        viewer, and at least a few times a second: it also takes what mouse and keys do.

        Returns:
            whether it is still open.
        """
        if self.host.is_due:
            return self.host.frame(wait=False)
        return self.is_open

    def on_click(self, callback: Callable[[Picked | None, str], None]) -> None:
        """Calls `callback(picked, gesture)` after every click, None for the sky and the floor."""
        self.host.on_click = callback

    def picture(self) -> NDArray[np.uint8]:
        """What is seen, (height, width, 3), without the host's own text."""
        return self.host.picture()

    def close(self) -> None:
        """Closes the host and the sources."""
        self.host.close()
        self._mirror.close()

    def _repr_html_(self) -> str:
        """The page itself in a notebook; where it is, for a window."""
        if self.url is None:
            return f"<p>{self.world.scene.name} is in a window on the screen.</p>"
        frame = 'width="100%" height="600" allow="cross-origin-isolated" style="border:0"'
        return (
            f'<p><a href="{self.url}" target="_blank">{self.url}</a></p>'
            f'<iframe src="{self.url}" {frame}></iframe>'
        )

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


def view(
    scene: Scene | Overlay | Path | str,
    *,
    web: bool | None = None,
    camera: str | None = None,
    size: tuple[int, int] = DEFAULT_SIZE,
    full_screen: bool = False,
    host: str | None = None,
    port: int = 0,
) -> Viewer:
    """Opens a window or a web page on a scene and returns at once.

    Its sources are mirrored, if it has any; all else is set by the caller:

        with sero_mj.view("lwr_udp") as viewer:
            while viewer.sync():
                viewer.set("lwr.torques", my_torques())

    Args:
        scene: a scene; a TOML file or the name of a shipped scene, scenario or robot; or an
            `overlay`, whose data the caller steps.
        web: whether it is a page, and its address is printed; None for a page where there is no
            screen for a window.
        camera: see `find_camera`.
        size: of the window, in screen coordinates.
        full_screen: whether the window covers the screen.
        host: address that the page is served at; None for this machine only.
        port: of the page; 0 for the first free one from 8080 on.

    Raises:
        SeroError: what is wrong with the scene, its sources or the camera, no display for a
            window, or no such address for a page.
    """
    if isinstance(scene, Overlay):
        mirror: Mirror = Watch(scene.world)
    else:
        mirror = Mirror(scene if isinstance(scene, Scene) else read_named_scene(str(scene)))
    if web is None:
        web = not has_display()
    if not web:
        options = {"size": size, "camera": camera, "full_screen": full_screen}
        return Viewer(mirror, open_window, **options)
    page = {"camera": camera, "port": port, **({} if host is None else {"host": host})}
    viewer = Viewer(mirror, open_page, **page)
    if mirror.world.is_borrowed and mirror.world.doubles:  # Studio draws no meshes of ours
        log.warning("a page shows no doubles of an overlay; a window and pictures do")
        viewer.host.toggles.doubles[:] = False
    print(f"{mirror.world.scene.name} is at {viewer.url}", flush=True)
    return viewer
