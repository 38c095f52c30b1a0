"""`view`: a scene in a window or on a page that the user's own loop drives."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import mujoco

from ..assemble.looks import Look
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..assemble.world_view import WorldView
from ..drive.mirror import LiveWorld, Mirror
from ..drive.watch import Watch
from ..errors import UsageError, did_you_mean
from ..load import load_scene
from .headless.backend import has_display
from .headless.film import Picture
from .headless.renderer import DEFAULT_SIZE
from .interaction import OnClick
from .live import LiveHost, open_page, open_window
from .overlay import Overlay

log = logging.getLogger(__name__)


class Viewer:
    """A window or a page beside the user's own loop; `view` opens one. It is a context manager.

    Attributes:
        world: the compiled scene.
        data: its state; set joint angles and the like with `set`.
        host: the `Window` or `WebHost`, with what is shown, and the clock.
        url: of the page for browsers on this machine; None for a window.
        urls: the same, and where the page is for browsers elsewhere; none for a window.
    """

    def __init__(
        self, mirror: LiveWorld, open_host: Callable[..., LiveHost], **options: Any
    ) -> None:
        self.world: WorldView = mirror.world
        self.data: mujoco.MjData = mirror.data
        self._mirror = mirror
        mirror.open()
        try:
            self.host = open_host(mirror, **options)
        except BaseException:
            mirror.close()
            raise
        self.urls: list[str] = getattr(self.host, "urls", [])
        self.url: str | None = self.urls[0] if self.urls else None
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

    def on_click(self, callback: OnClick) -> None:
        """Calls `callback(picked, gesture)` after every click, None for the sky and the floor.

        Raises:
            UsageError: it cannot be called.
        """
        if not callable(callback):
            found = type(callback).__name__
            raise UsageError(f"on_click: found {found}; expected callback(picked, gesture)")
        self.host.on_click = callback

    def picture(self) -> Picture:
        """What is seen, (height, width, 3), without the host's own text."""
        picture: Picture = self.host.picture().view(Picture)
        return picture

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
    look: Look | None = None,
    size: tuple[int, int] | None = None,
    full_screen: bool = False,
    host: str | None = None,
    port: int | None = None,
    token: bool = False,
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
        look: `light` or `dark`, over the scene's; an overlay has its model's.
        size: of the window, in screen coordinates; None for 1280 x 800.
        full_screen: whether the window covers the screen.
        host: address that the page is served at; None for this machine only.
        port: of the page; None for the first free one from 8080 on.
        token: whether the page's address has a token that nobody else knows; beyond this machine
            it has one in any case.

    Raises:
        UsageError: these do not go together, or are something else.
        SeroError: what is wrong with the scene, its sources or the camera, no display for a
            window, or no such address for a page.
    """
    of_page = {"host": host, "port": port, "token": token or None}
    of_window = {"size": size, "full_screen": full_screen or None}
    if web is None:
        web = not has_display()
    for name, value in (of_window if web else of_page).items():
        if value is not None:
            what = "the window, and this is a page" if web else "a page, and this is a window"
            raise UsageError(f"{name}: found {value!r}; it is for {what}: say web={not web}")
    mirror = _mirror_of(scene, look)
    if not web:
        options = {"size": size or DEFAULT_SIZE, "camera": camera, "full_screen": full_screen}
        return Viewer(mirror, open_window, **options)
    page: dict[str, Any] = {name: value for name, value in of_page.items() if value is not None}
    page["camera"] = camera
    viewer = Viewer(mirror, open_page, **page)
    if not all(double.is_compiled for double in mirror.world.doubles.values()):
        log.warning("a page shows no doubles of an overlay; a window and pictures do")
        viewer.host.toggles.doubles[:] = False
    print(f"{mirror.world.scene.name} is at {' and '.join(viewer.urls)}", flush=True)
    return viewer


def _mirror_of(scene: Scene | Overlay | Path | str, look: Look | None) -> LiveWorld:
    """What is to be shown, in a look of its own where one is given; the user's scene stays."""
    if look is not None and look not in get_args(Look):
        raise UsageError(f"look: found {look!r}{did_you_mean(str(look), get_args(Look))}")
    if isinstance(scene, Overlay):
        if look is not None:
            raise UsageError(f"look: found '{look}'; an overlay looks as its model does")
        return Watch(scene.world)
    if isinstance(scene, str | Path):
        scene = load_scene(scene)
    elif not isinstance(scene, Scene):
        hint = "; Scene(robots=[...]) holds robots" if isinstance(scene, SerialRobot) else ""
        raise UsageError(
            f"scene: found {type(scene).__name__}; expected a Scene, an overlay, a file, or the "
            f"name of a scene, scenario or robot{hint}"
        )
    if look is not None:
        scene = copy.copy(scene)
        scene.view = scene.view.model_copy(update={"look": look})
    return Mirror(scene)
