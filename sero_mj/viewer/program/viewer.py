"""`view`: shows a scene in a window or on a web page while the user's loop runs."""

from __future__ import annotations

import atexit
import copy
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, get_args
from urllib.parse import urlsplit

import mujoco

from ...base.errors import UsageError, did_you_mean, shown
from ...base.plugins import NOTEBOOKS, load_all
from ...data.drive.mirror import LiveWorld, Mirror
from ...load import load_scene
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from ...robots.declared.surroundings import Look
from ...robots.external.model_world import ModelWorld
from ..host.pointer import OnClick
from ..image.backend import has_display
from ..image.image_files import ImageArray
from ..image.image_options import DEFAULT_SIZE
from ..panels.user_widgets import TOOL as PANELS
from .memory import OverlayMemory, SceneMemory, ViewerMemory
from .outbox import Outbox, UserSignals
from .overlay import Overlay
from .panels import UserPanel, UserPanels
from .process import ViewerProcess
from .robot_inputs import RobotInputs

if TYPE_CHECKING:
    from ..web.host import WebHost

# Toggles that the first torques of a robot switch on, unless its file or the program sets them.
_OF_TORQUES = ("show_arrows", "show_billboards")

_shown: list[Viewer] = []  # open viewers, to which notebooks may have no other reference


class NotebookCells(Protocol):
    """Notebook cells that display a viewer, created by an entry point of `sero_mj.notebooks`."""

    def show(self) -> None: ...

    def store_last(self) -> None:
        """Stores the run up to now in the notebook. Must be called before the viewer is closed."""

    def close(self, *, is_exit: bool = False) -> None: ...


class Viewer:
    """A window or web page in a separate process, which displays values that the program sets.

    A viewer renders independently of the program until it is closed or the program ends. It can be
    used as a context manager.

    Attributes:
        urls: all addresses of the page, including addresses for other machines; empty for a window.
        url: address of the page for browsers on this machine; None for a window.
    """

    def __init__(
        self, world: WorldView, process: ViewerProcess, memory: ViewerMemory, urls: list[str]
    ) -> None:
        self.world = world
        self.urls = urls
        self.url: str | None = urls[0] if urls else None
        self._process, self._memory = process, memory
        self._undecided = _undecided_toggles(world)
        self._on_click: OnClick | None = None
        self._outbox = Outbox(process.send)
        self._panels = UserPanels(self._outbox, lambda: self.is_open)
        self._signals = UserSignals(self._outbox)
        process.answers[PANELS] = self._panels.receive
        self._cells: NotebookCells | None = None
        _shown.append(self)

    @property
    def is_open(self) -> bool:
        return self._process.is_open

    @property
    def data(self) -> mujoco.MjData:
        """State of the scene at the last `sync`, or the user's own data for an overlay.

        The state contains the values set by the program and the data of the scene's sources. Change
        it only with `set` and `robot`. After the first access, every `sync` updates the state,
        which takes about 50 us per frame.
        """
        if not self._memory.is_read:
            self._memory.is_read = True
            self._memory.sync()
        return self._memory.data

    @property
    def frame_count(self) -> int:
        """Number of rendered frames."""
        return self._memory.frame_count

    @property
    def pictures(self) -> int:
        """Old name of `frame_count`."""
        warnings.warn("`pictures` is now named `frame_count`", DeprecationWarning, stacklevel=2)
        return self.frame_count

    def set(self, target: str, values: Any) -> None:
        """Sets an input. The next frame shows the values.

        The first torques of a robot switch on its arrows and billboards, unless the robot or the
        program has set `show_arrows` or `show_billboards`.

        Args:
            target: name of the input of a robot, double, arrow or group, or of a switch. Examples:
                `lwr.torques`, `goal.joint_angles`, `push.vector`, `justin.joint_angles`,
                `lwr.show_axes`, `toggles.legend`.
            values: values in the shape of the input, in SI units. A group needs the values of all
                joints or of the independent joints, in the order of its robots.

        Raises:
            UnknownName: there is no such input. The message lists the existing inputs.
            ValueError: the values do not have the shape or range of the input.
        """
        self._memory.set(target, values)
        if self._undecided:
            self._show_torques(target)

    def _show_torques(self, target: str) -> None:
        name, _, key = target.partition(".")
        for owner in self.world.scene.members(name) or [name]:
            if key in _OF_TORQUES:
                self._undecided.discard((owner, key))
            elif key == "torques":
                for toggle in _OF_TORQUES:
                    if (owner, toggle) in self._undecided:
                        self._undecided.remove((owner, toggle))
                        self._memory.set(f"{owner}.{toggle}", True)

    def robot(self, name: str) -> RobotInputs:
        """Returns the inputs of a robot or double as attributes: `robot("lwr").torques = ...`.

        The inputs of a group contain the values of its robots, in the order of the robots.

        Raises:
            UnknownName: there is no such robot, double or group. The message suggests a similar
                name.
        """
        return RobotInputs(self, name)

    def sync(self) -> bool:
        """Exchanges states with the viewer, and calls callbacks of clicks and widgets.

        For an overlay, `sync` sends the state of the model. It never blocks and takes 1 us for a
        scene and about 30 us for an overlay, so a fast loop can call it in every cycle. Errors of
        the viewer are not raised. A program that only calls `set` does not need `sync`.

        Returns:
            whether the viewer is open.
        """
        self._memory.sync()
        clicks = self._process.clicks
        while clicks:
            picked, gesture = clicks.popleft()
            if self._on_click is not None:
                self._on_click(picked, gesture)
        if self._panels.has_changes:
            self._panels.call()
        return self.is_open

    def on_click(self, callback: OnClick) -> None:
        """Registers a function that `sync` calls with the picked item and gesture of each click."""
        if not callable(callback):
            found = type(callback).__name__
            raise UsageError(f"on_click: found {found}; expected callback(picked, gesture)")
        self._on_click = callback

    def panel(self, title: str) -> UserPanel:
        """Returns a section of the viewer's panel, to which the program can add widgets.

            stiffness = viewer.panel("Tuning").slider("stiffness", 0, 2000, value=500)

        Here, `stiffness.value` is the value that the user has set. See `UserPanel`.

        Raises:
            UsageError: the title is invalid.
            RenderError: the viewer is closed.
        """
        return self._panels.panel(title)

    def plot(self, name: str, value: float) -> None:
        """Adds the current value of a signal to the plot beside the image.

        The call takes about 1 us, so a fast loop can plot in every cycle. Lines show the minimum
        and maximum of each 2 ms. A closed viewer ignores the value.

        Args:
            name: name of the signal, which has its own line in the plot.
            value: current value; NaN for a gap.

        Raises:
            UsageError: the name or value is invalid, or there are too many signals.
        """
        self._signals.add(name, value)

    def image(self) -> ImageArray:
        """Renders an image with all values that were set, without status line and messages.

        Raises:
            RenderError: the viewer is closed, or cannot render.
        """
        self._memory.sync()
        image: ImageArray = self._process.image().view(ImageArray)
        return image

    def picture(self) -> ImageArray:
        """Old name of `image`."""
        warnings.warn("`picture` is now named `image`", DeprecationWarning, stacklevel=2)
        return self.image()

    def close(self) -> None:
        if self._cells is not None and self.is_open:
            self._cells.store_last()
        self._end()

    def _end(self, *, at_exit: bool = False) -> None:
        if self in _shown:
            _shown.remove(self)
        if self._cells is not None:
            self._cells.close(is_exit=at_exit)
        self._outbox.close()
        self._process.close()

    def _ipython_display_(self) -> None:
        scene = self.world.scene
        if self.url is None:
            print(f"{scene.name} is shown in a window")
            return
        if self._cells is None:
            for make in load_all(NOTEBOOKS).values():
                self._cells = make(scene, self.url, self._process)
        if self._cells is None:
            print(f"{scene.name} is at {self.url}")
        else:
            self._cells.show()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


@atexit.register
def _close_all() -> None:
    for viewer in list(_shown):
        viewer._end(at_exit=True)


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
    token: bool = True,
) -> Viewer:
    """Opens a window or a web page that shows a scene, in a separate process.

    The viewer shows the data of the scene's sources, if any. The program can set all inputs:

        with sero_mj.view("lwr_udp") as viewer:
            while viewer.sync():
                viewer.robot("lwr").torques = my_torques()
                time.sleep(0.001)

    The viewer stays open without further calls, for example in a notebook. Another call for a scene
    with the same name and robots, for example when a cell is run again, replaces the window or
    page. The new page has the same port.

    Args:
        scene: a `Scene`, the path of a TOML file, the name of an included scene, scenario or robot,
            or an `overlay` whose model the program steps.
        web: True for a page, whose address is printed; False for a window; None for a page only if
            there is no display for a window.
        camera: initial camera: a camera's name, or `azimuth,elevation,distance` (degrees, degrees,
            m); None for the view of the scene.
        look: `light` or `dark`, which overrides the look of the scene; not available for overlays.
        size: width and height of the window in pixels.
        full_screen: whether the window covers the screen.
        host: address at which the page is served; None for this machine only.
        port: port of the page; None for the first free port from 8080.
        token: whether the page needs a secret token, which the printed address contains. A page
            for other machines always needs a token.

    Raises:
        UsageError: arguments contradict each other, or have a wrong type.
        SeroError: the scene, a source or the camera has a problem, there is no display for a
            window, or the address of the page does not exist.
    """
    of_page = {"host": host, "port": port, "token": None if token else False}
    of_window = {"size": size, "full_screen": full_screen or None}
    if web is None:
        web = not has_display()
    for name, value in (of_window if web else of_page).items():
        if value is not None:
            what = "windows" if web else "web pages"
            raise UsageError(
                f"{name}: found {shown(value)}; only {what} have this option. Set web={not web}"
            )
    subject = _to_show(scene, look)
    options: dict[str, Any] = {"web": web, "camera": camera}
    if web:
        options |= {name: value for name, value in of_page.items() if value is not None}
    else:
        options |= {"size": size or DEFAULT_SIZE, "full_screen": full_screen}
    process = ViewerProcess(is_window=not web)
    try:
        viewer = _open(subject, process, options)
    except BaseException:
        process.close(at_once=True)
        raise
    if web:
        print(f"{viewer.world.scene.name} is at {' and '.join(viewer.urls)}", flush=True)
    return viewer


def _undecided_toggles(world: WorldView) -> set[tuple[str, str]]:
    """Returns the toggles of torques that no robot file and no scene sets, by robot."""
    if isinstance(world, ModelWorld):
        return set()
    robots = world.scene.robots.values()
    return {
        (robot.name, toggle)
        for robot in robots
        for toggle in _OF_TORQUES
        if toggle not in robot.model_fields_set
    }


def _open(shown: Scene | ModelWorld, process: ViewerProcess, options: dict[str, Any]) -> Viewer:
    memory: ViewerMemory
    if isinstance(shown, Scene):
        process.describe(shown)
        mirror = Mirror(shown)  # This also raises errors of sources and routes.
        world: WorldView = mirror.world
        memory = SceneMemory(world, mirror.data)
    else:
        process.describe((shown.model, shown.options))
        world, memory = shown, OverlayMemory(shown)
    try:
        memory.sync()
        _replace(world.scene, options)
        urls = process.open(str(memory.arrays.path), options)
    finally:
        memory.arrays.remove_name()
    return Viewer(world, process, memory, urls)


def _replace(scene: Scene, options: dict[str, Any]) -> None:
    for viewer in list(_shown):
        other = viewer.world.scene
        is_same = other.name == scene.name and [*other.robots] == [*scene.robots]
        if viewer.is_open and not (is_same and (viewer.url is not None) == options["web"]):
            continue
        if viewer.is_open:
            print(f"{other.name} is opened again; its previous viewer is closed", flush=True)
        if viewer.is_open and viewer.url is not None:
            options["last"] = {"port": urlsplit(viewer.url).port}
        viewer._end()


def open_page(mirror: LiveWorld, **options: Any) -> WebHost:
    """Serves a web page that shows a mirror.

    Raises:
        RenderError: the page cannot be served at this address and port.
        UnknownName: there is no camera with this name.
    """
    from ..web.host import WebHost

    return WebHost(mirror, **options)


def _to_show(scene: Scene | Overlay | Path | str, look: Look | None) -> Scene | ModelWorld:
    if look is not None and look not in get_args(Look):
        raise UsageError(f"look: found {shown(look)}{did_you_mean(str(look), get_args(Look))}")
    if isinstance(scene, Overlay):
        if look is not None:
            raise UsageError(f"look: found '{look}'; an overlay always has the look of its model")
        return scene.world
    if isinstance(scene, str | Path):
        scene = load_scene(scene, by_hand=True, trusted=True)
    elif not isinstance(scene, Scene):
        hint = "; use Scene(robots=[...])" if isinstance(scene, SerialRobot) else ""
        raise UsageError(
            f"scene: found {type(scene).__name__}; expected a Scene, an overlay, a file, or the "
            f"name of a scene, scenario or robot{hint}"
        )
    if look is not None:
        scene = copy.copy(scene)
        scene.view = scene.view.model_copy(update={"look": look})
    return scene
