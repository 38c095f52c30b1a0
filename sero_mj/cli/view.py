"""`sero-mj view`: shows a scene live in a window or on a web page."""

from __future__ import annotations

import copy
import logging
import os
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Self

from pydantic import model_validator

from ..base import trust
from ..base.errors import UsageError
from ..base.options import Option, Port, Size, positional
from .arguments import command, read_scene, replay_instead, until_ended
from .browser import can_open_browser, open_in_browser
from .shared_options import EyeOptions, OverOptions, ShownOptions

if TYPE_CHECKING:
    import mujoco

    from ..base.frames import Array
    from ..data.drive.mirror import Mirror
    from ..robots.declared.scene import Scene
    from ..viewer.host.live import LiveHost
    from ..viewer.session.recent_views import RecentView
    from ..viewer.session.view_state import ViewState
    from ..viewer.web.server import PageListener, PageServer

_SIZE = (1280, 800)
_LOOPBACK = "127.0.0.1"
_HELP = """\
examples:
  sero-mj view lwr_udp                      the robot as it moves
  sero-mj view lwr_udp --replay run.mcap    a recording, with a timeline
  sero-mj view impedance_push --web         a simulation, on a page for browsers on this machine

Press H in the window or on the page for the functions of mouse and keys. Ctrl+Q closes the window,
Ctrl+C ends the page. The printed address of a page contains a secret token. To reach the page from
another machine, use `ssh -L 8080:localhost:8080 MACHINE`, or --host 0.0.0.0 without encryption.
"""
GROUP, ORDER = "see", 10


class ViewOptions(EyeOptions, OverOptions, ShownOptions):
    """Show a scene live in a window or on a web page.

    Attributes:
        scene: file or included name of a scene, robot or recording (default: show a start page).
        window: open a window on this screen (default: on if there is a display).
        web: serve a web page instead of opening a window.
        port: port of the page (default: the first free port from 8080).
        host: address at which the page is served (default: 127.0.0.1, only for this machine).
        token: ignored, because pages have a token by default.
        no_token: serve the page without a token, so that all users of this machine can control it.
        no_browser: print the address of the page without opening it in a browser.
        simulate: simulate the robots, which users can pull or move by target poses.
        control: controller for --simulate: `gravity`, `joint`, `cartesian`, or another kind that
            needs no declared gains (default: joint).
        size: size of the window in pixels (default: 1280x800).
        full_screen: show the window on the whole screen.
        finish_videos: finish rendering the videos of recorded clips (key K) after closing.
        fresh: show the scene as declared instead of restoring the last view.
        trust: folder whose scenarios may start programs, even if a scenario is dropped on the page
            or opened there; repeatable.
        over: draw over the images of a camera (a number such as 0, or an address) or a video file.
    """

    scene: Annotated[str | None, positional("SCENE")] = None
    window: bool = False
    web: bool = False
    port: Port | None = None
    host: Annotated[str | None, Option("ADDR")] = None
    token: bool = False
    no_token: bool = False
    no_browser: bool = False
    simulate: bool = False
    control: Annotated[str | None, Option("KIND")] = None
    size: Size | None = None
    full_screen: bool = False
    finish_videos: bool = False
    fresh: bool = False
    trust: Annotated[list[Path], Option("FOLDER")] = []
    over: Annotated[str | None, Option("CAMERA")] = None

    @property
    def page_options(self) -> list[str]:
        """Options on the command line that require a page."""
        return self.set_among("port", "host", "token", "no_token", "no_browser")

    @property
    def window_options(self) -> list[str]:
        """Options on the command line that require a window."""
        return self.set_among("size", "full_screen", "stereo", "over")

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if self.window and self.web:
            raise ValueError("--window cannot be combined with --web")
        if self.window and self.page_options:
            raise ValueError(f"{self.page_options[0]} needs --web instead of --window")
        if self.token and self.no_token:
            raise ValueError("--token cannot be combined with --no-token")
        if (self.web or self.page_options) and self.window_options:
            raise ValueError(f"{self.window_options[0]} needs a window instead of a page")
        return self

    @model_validator(mode="after")
    def _check_scene(self) -> Self:
        if self.over is not None:
            self.refuse(("camera", "stereo"), " cannot be combined with --over")
            if self.replay is not None and Path(self.over).is_file():
                self.refuse(("start",), " cannot be combined with a video. Use --offset instead.")
        if self.control is not None and not self.simulate:
            raise ValueError(f"--control {self.control} needs --simulate")
        if self.simulate and self.replay is not None:
            raise ValueError("--simulate cannot be combined with --replay")
        if self.scene is None:
            of_scene = ("camera", "replay", "start", "over", "offset", "settings")
            self.refuse(of_scene, " needs a scene: sero-mj view SCENE")
        return self


def run(options: ViewOptions) -> int:
    """Shows a scene or the start page until the user closes it; returns 0."""
    from .opening import with_scene

    for folder in options.trust:
        if not folder.is_dir():
            raise UsageError(f"--trust {folder}: no such folder")
        trust.trust_folder(folder)
    options = with_scene(options)
    on_page = wants_page(options)
    if not on_page:
        # MuJoCo must use the OpenGL context of the window.
        os.environ["MUJOCO_GL"] = "glfw"
    session = Session(options, on_page=on_page)
    mirror = session.first()
    if on_page and not (options.web or options.page_options):
        print("no display for a window, serving a web page instead (--web)", file=sys.stderr)
    with until_ended():
        while True:
            if mirror is None and session.is_at_start:
                mirror = session.choose()
            if mirror is None:
                return 0
            mirror = session.show(mirror)
    return 0


add_to = command("view", run, ViewOptions, _HELP)


class Session:
    """A run of `sero-mj view`, which shows the start page and scenes one after another.

    Attributes:
        plain: current scene as declared, without a simulation.
        is_at_start: whether the start page is shown next.
    """

    def __init__(self, options: ViewOptions, *, on_page: bool) -> None:
        from ..robots.declared.scene import Scene

        self.options, self.on_page = options, on_page
        self._listener: PageListener | None = None  # open until the session ends
        self._token: bool | str = not options.no_token  # the same for all pages of the session
        self.plain = Scene()
        self.is_at_start = options.scene is None
        # Camera, panel and switches, restored when the same scene is shown again.
        self._last: tuple[mujoco.MjvCamera, dict[str, bool], ViewState] | None = None
        self._is_announced = False
        self._announced_sources: set[str] = set()
        self._warnings: list[str] = []  # warnings from reading the next scene

    @property
    def _listening(self) -> PageListener:
        if self._listener is None:
            from ..viewer.web.server import PageListener

            self._listener = PageListener(self.options.host or _LOOPBACK, self.options.port or 0)
        return self._listener

    def first(self) -> Mirror | None:
        """Returns the mirror of the scene in the options, or None if there is no scene."""
        name, options = self.options.scene, self.options
        if name is None:
            return None
        if options.over is not None and Path(options.over).is_file():
            self.options = options = options.from_its_begin()  # --offset aligns the video
        with self._collecting_warnings():
            # The user has typed the path, so the programs of the scenario may run.
            return self._begin(options.read(name, by_hand=not options.simulate, trusted=True))

    def _begin(self, scene: Scene, *, is_replayed: bool = False) -> Mirror:
        is_simulated = self.options.simulate and not is_replayed
        control = self.options.control or "joint"
        mirror = _simulated(scene, control) if is_simulated else _mirror_of(scene)
        self.plain, self._last = scene, None
        return mirror

    def choose(self) -> Mirror | None:
        """Shows the start page; returns the mirror of the scene that the user opens there."""
        options = self.options
        self.is_at_start = False
        from ..viewer.host.start_page import listening

        if self.on_page:
            from ..viewer.web.start_host import StartHost
            from ..viewer.web.uploads import drops

            drops.show()

            host = options.host or _LOOPBACK
            with (
                listening() as received,
                StartHost(self.open, received, host, self._listening, token=self._token) as page,
            ):
                self._announce("the start page", page.server, host)
                return page.run()
        from ..viewer.window.start_window import StartWindow

        size, full_screen = options.size or _SIZE, options.full_screen
        with (
            listening() as received,
            StartWindow(self.open, received, size, full_screen=full_screen) as window,
        ):
            return window.run()

    def open(self, what: RecentView | Path) -> Mirror:
        """Returns the mirror of an opened scene or a dropped file, and updates the options.

        If the scene has an error, the options do not change.
        """
        from .opening import view_of_file

        view = what
        if isinstance(view, Path):
            is_shown = self.options.scene is not None
            view = view_of_file(view, self.options.scene if is_shown else None)
        with self._collecting_warnings():
            scene = read_scene(
                view.scene,
                by_hand=not (self.options.simulate or view.replay),
                replay=Path(view.replay) if view.replay else None,
            )
            if self.options.look is not None:
                scene.view.look = self.options.look
            if view.replay:
                replay_instead(scene, Path(view.replay), None)
            shown = self._begin(scene, is_replayed=bool(view.replay))
        self.options = self.options.model_copy(
            update={
                "scene": view.scene, "replay": Path(view.replay) if view.replay else None,
                "settings": [], "start": None, "camera": None, "over": None,
            }
        )  # fmt: skip
        return shown

    def show(self, mirror: Mirror) -> Mirror | None:
        """Shows a scene until it is closed; returns the mirror of the next scene, if any."""
        return self._serve(mirror) if self.on_page else self._open_window(mirror)

    @contextmanager
    def _collecting_warnings(self) -> Iterator[None]:
        collector, log = _WarningCollector(), logging.getLogger("sero_mj")
        log.addHandler(collector)
        try:
            yield
            self._warnings = collector.texts
        finally:
            log.removeHandler(collector)

    def _offer(self, host: LiveHost) -> None:
        from ..simulate.runs.run_source import RunSource
        from ..viewer.session.recent_views import RecentView
        from ..viewer.tools.rolling_recorder import RollingRecorder

        options = self.options
        host.others.offers["start page"] = self._go_to_start
        simulated = [each for each in host.mirror.sources.values() if isinstance(each, RunSource)]
        if any(each.live is not None for each in simulated):
            host.others.offers["end the simulation"] = lambda: _mirror_of(self.plain)
        elif all(each.drag_force is None for each in simulated) and host.world.robots:

            def simulate() -> Mirror:
                parts, data = host.world.robots, host.data
                shown = {name: data.qpos[part.qpos].copy() for name, part in parts.items()}
                # Robots that nobody has moved start at their default pose for simulations.
                angles = {
                    name: q
                    for name, q in shown.items()
                    if parts[name].robot.joint_angles is not None
                    or (q != parts[name].robot.home).any()
                }
                return _simulated(self.plain, self.options.control or "joint", angles)

            host.others.offers["simulate"] = simulate
        host.others.opener = self.open
        if self.plain.withheld is not None and not options.simulate:
            name = options.scene or ""
            host.others.ask(self.plain.withheld, lambda: self.open(RecentView(name)))
        for tool in host.tools.values():
            if isinstance(tool, RollingRecorder):
                tool.finishes_videos = self.options.finish_videos
        if self._warnings:
            more = f" (and {len(self._warnings) - 1} more)" if len(self._warnings) > 1 else ""
            # The folder is omitted, so that the message fits.
            folder = f"{Path(self.options.scene or '').parent}{os.sep}"
            host.say(self._warnings.pop(0).replace(folder, "") + more, is_bad=True)
            self._warnings.clear()
        host.command = command_of(self.options)

    def _go_to_start(self) -> None:
        self.is_at_start = True

    def _restore_last(
        self,
        host: LiveHost,
        camera: mujoco.MjvCamera,
        panel: Mapping[str, bool],
        state: ViewState,
    ) -> None:
        from ..viewer.image.camera import copy_camera
        from ..viewer.session.view_state import apply_state

        copy_camera(camera, host.view_camera)
        # New elements, such as the doubles at targets, are shown as declared.
        _, joint, _ = apply_state(host.world, host.toggles, state._replace(camera=""))
        if joint is not None:
            host.select(joint)
        host.show_layout({**host.layout, **panel})

    def _run(self, host: LiveHost) -> None:
        from ..viewer.host.live import SECTION
        from ..viewer.host.restoring import save
        from ..viewer.session.recent_views import RecentView, remember_view
        from .opening import is_temporary

        options, plain = self.options, self.plain
        view = RecentView(_absolute(options.scene), _absolute(options.replay))
        is_remembered = options.over is None and not is_temporary(view)
        for source in host.mirror.sources.values():
            if source.is_live and source.about not in self._announced_sources:
                self._announced_sources.add(source.about)
                print(f"waiting for {source.awaited} on {source.about}", flush=True)
        try:
            host.run()
        finally:
            save(host)
        if is_remembered:
            # Rendering the preview of a page on the server takes a while.
            has_preview = self.on_page and (view.image.is_file() or view.is_shipped)
            remember_view(view, None if has_preview else host.image())
        if self.plain is plain:  # the same scene is shown next
            panel = {
                name: is_shown
                for name, is_shown in host.layout.items()
                if name == "panel" or name.startswith(SECTION)
            }
            self._last = copy.copy(host.view_camera), panel, host.view_state()

    def _open_window(self, mirror: Mirror) -> Mirror | None:
        from ..viewer.host.restoring import restore
        from ..viewer.window.host import Window
        from ..viewer.window.viewport import StereoViewport, Viewport

        options = self.options
        with ExitStack() as stack:
            make_viewport: Callable[..., Viewport] = Viewport
            if options.stereo is not None:
                make_viewport = partial(
                    StereoViewport, stereo=options.stereo, eye_distance=options.eye_distance
                )
            if options.over is not None:
                from .shared_options import find_background

                make_viewport = stack.enter_context(find_background().viewport(mirror, options))
            stack.enter_context(mirror)
            window = Window(
                mirror,
                size=options.size or _SIZE,
                camera=options.camera,
                full_screen=options.full_screen,
                make_viewport=make_viewport,
            )
            stack.enter_context(window)
            self._offer(window)
            if self._last is not None:
                self._restore_last(window, *self._last)
            elif not options.fresh:
                restore(window, with_camera=options.camera is None)
            self._run(window)
            return window.others.chosen

    def _serve(self, mirror: Mirror) -> Mirror | None:
        from ..viewer.host.restoring import restore
        from ..viewer.program.viewer import open_page
        from ..viewer.web.uploads import drops

        options = self.options
        drops.show(options.scene or "", options.replay or "")
        host = options.host or _LOOPBACK
        with (
            mirror,
            open_page(
                mirror,
                camera=options.camera,
                host=host,
                port=self._listening,
                token=self._token,
                waits=True,
            ) as page,
        ):
            self._offer(page)
            self._announce(mirror.world.scene.name, page.server, host)
            if self._last is not None:
                self._restore_last(page, *self._last)
            elif not options.fresh:
                restore(page, with_camera=options.camera is None)
            self._run(page)
            return page.others.chosen

    def _announce(self, name: str, server: PageServer, host: str) -> None:
        self._token = server.token or False
        if self._is_announced:
            return
        self._is_announced = True
        print(f"{name} is at {' and '.join(server.urls)}  (Ctrl+C ends it)", flush=True)
        if can_open_browser() and not self.options.no_browser:
            open_in_browser(server.url)
        if not server.is_private:
            print(
                f"warning: the page is served at {host} without encryption; anyone with this "
                "address can view and control it",
                file=sys.stderr,
                flush=True,
            )


class _WarningCollector(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != trust.log.name:  # shown in a dialog instead
            self.texts.append(record.getMessage())


def _absolute(name: Path | str | None) -> str:
    if name is None:
        return ""
    return str(Path(name).resolve()) if Path(name).exists() else str(name)


def _mirror_of(scene: Scene) -> Mirror:
    from ..data.drive.mirror import Mirror

    return Mirror(scene)


def _simulated(scene: Scene, control: str, angles: Mapping[str, Array] | None = None) -> Mirror:
    from ..simulate.endless_run import endless_scene

    return _mirror_of(endless_scene(scene, control, angles))


def wants_page(options: ViewOptions) -> bool:
    """Whether to serve a page instead of opening a window.

    Raises UsageError if a window is required and there is no display.
    """
    if options.web or options.page_options:
        return True
    from ..viewer.image.backend import has_display

    if has_display():
        return False
    if options.window or options.window_options:
        raise UsageError(
            "no display for a window: neither DISPLAY nor WAYLAND_DISPLAY is set. Use --web for "
            "a web page, or `sero-mj render` for images and videos."
        )
    return True


def command_of(options: ViewOptions) -> list[str]:
    """Returns command-line arguments with the scene and the options that modify the scene."""
    words = [str(options.scene)]
    for setting in options.settings:
        words += ["--set", setting]
    for name in ("look", "replay", "start"):
        value = getattr(options, name)
        words += [] if value is None else [f"--{name}", str(value)]
    return words
