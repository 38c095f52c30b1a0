"""`view`: shows a scene in a window or on a web page from the user's own loop."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import mujoco

from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..assemble.surroundings import Look
from ..assemble.world_view import WorldView
from ..drive.mirror import LiveWorld, Mirror, Watch
from ..errors import RenderError, UsageError, did_you_mean
from ..load import load_scene
from .headless.backend import has_display
from .headless.film import Picture
from .headless.render import DEFAULT_SIZE
from .live import LiveHost, OnClick
from .overlay import Overlay
from .robot_inputs import RobotInputs

if TYPE_CHECKING:
    from .web.host import WebHost

log = logging.getLogger(__name__)


class Viewer:
    """A window or web page that the user's own loop updates; a context manager.

    Attributes:
        world: the compiled scene.
        data: its state; set inputs with `set` or `robot`.
        host: the `Window` or `WebHost`, with toggles and clock.
        url: of the page for browsers on this machine; None for a window.
        urls: all addresses of the page, including those for other machines; empty for a window.
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
        """Sets an input, as a route does.

        Args:
            target: `lwr.joint_angles`, `lwr.torques`, `goal.joint_angles`, `push.vector`, ...
            values: of the input's shape, SI units.

        Raises:
            UnknownName: no such input; lists the existing ones.
            ValueError: the values do not fit the input.
        """
        self.world.set_input(self.data, target, values)

    def robot(self, name: str) -> RobotInputs:
        """Returns the inputs of a robot or double as attributes: `robot("lwr").torques = ...`.

        Raises:
            UnknownName: no robot or double of that name; suggests the nearest one.
        """
        return RobotInputs(self.world, self.data, name)

    def sync(self) -> bool:
        """Shows the current state if a new frame is due, and handles mouse and keys.

        Otherwise it returns at once, so that it can be called in every cycle of a fast loop. Call
        it on the thread that opened the viewer, at least a few times a second.

        Returns:
            whether it is still open.
        """
        if self.host.is_due:
            return self.host.frame(wait=False)
        return self.is_open

    def on_click(self, callback: OnClick) -> None:
        """Registers `callback(picked, gesture)`, called after every click.

        Args:
            callback: takes the clicked item, None for the sky and the floor, and the gesture.

        Raises:
            UsageError: it is not callable.
        """
        if not callable(callback):
            found = type(callback).__name__
            raise UsageError(f"on_click: found {found}; expected callback(picked, gesture)")
        self.host.on_click = callback

    def picture(self) -> Picture:
        """Returns the current picture, (height, width, 3), uint8, without the host's own text."""
        picture: Picture = self.host.picture().view(Picture)
        return picture

    def close(self) -> None:
        """Closes the host and the sources."""
        self.host.close()
        self._mirror.close()

    def _repr_html_(self) -> str:
        """Returns the page as an HTML frame, for notebooks; a text for a window."""
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

    The scene's sources are mirrored, if it has any; the caller can set all inputs:

        with sero_mj.view("lwr_udp") as viewer:
            while viewer.sync():
                viewer.robot("lwr").torques = my_torques()

    Args:
        scene: a scene; a TOML file or the name of a shipped scene, scenario or robot; or an
            `overlay`, whose data the caller steps.
        web: True for a page, whose address is printed; None for a page only if there is no
            display for a window.
        camera: see `find_camera`.
        look: `light` or `dark`, overrides the scene's; not for an overlay.
        size: of the window, in screen coordinates; None for 1280 x 800.
        full_screen: whether the window covers the screen.
        host: address that the page is served at; None for this machine only.
        port: of the page; None for the first free one from 8080 on.
        token: whether the page's address contains a secret token; for other machines it always
            does.

    Raises:
        UsageError: arguments that contradict each other, or have another type.
        SeroError: a problem of the scene, its sources or the camera, no display for a window, or
            no such address for a page.
    """
    of_page = {"host": host, "port": port, "token": token or None}
    of_window = {"size": size, "full_screen": full_screen or None}
    if web is None:
        web = not has_display()
    for name, value in (of_window if web else of_page).items():
        if value is not None:
            what = "a window, and this is a page" if web else "a page, and this is a window"
            raise UsageError(f"{name}: found {value!r}; it is for {what}: use web={not web}")
    mirror = _mirror_of(scene, look)
    if not web:
        from .window.host import Window

        options = {"size": size or DEFAULT_SIZE, "camera": camera, "full_screen": full_screen}
        return Viewer(mirror, Window, **options)
    page: dict[str, Any] = {name: value for name, value in of_page.items() if value is not None}
    page["camera"] = camera
    viewer = Viewer(mirror, open_page, **page)
    if not all(double.is_compiled for double in mirror.world.doubles.values()):
        log.warning("a page shows no doubles of an overlay; a window and pictures do")
        viewer.host.toggles.doubles[:] = False
    print(f"{mirror.world.scene.name} is at {' and '.join(viewer.urls)}", flush=True)
    return viewer


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


def _mirror_of(scene: Scene | Overlay | Path | str, look: Look | None) -> LiveWorld:
    """Returns the mirror of a scene with a look, without changing the user's scene."""
    if look is not None and look not in get_args(Look):
        raise UsageError(f"look: found {look!r}{did_you_mean(str(look), get_args(Look))}")
    if isinstance(scene, Overlay):
        if look is not None:
            raise UsageError(f"look: found '{look}'; an overlay has the look of its model")
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
