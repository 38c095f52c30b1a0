"""`sero-mj view`: a scene in a window or on a web page, live."""

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
from .arguments import (
    command,
    read_scene,
    replay_instead,
    until_ended,
)
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
  sero-mj view lwr_udp                      the robot, as it moves
  sero-mj view lwr_udp --replay run.mcap    a recording, with a timeline
  sero-mj view impedance_push --web         a simulation, on a page for browsers on this machine

H in the window or on the page shows what mouse and keys do. Ctrl+Q closes the window, Ctrl+C ends
the page. The printed address of a page has a secret token. Browsers on other machines reach it
through `ssh -L 8080:localhost:8080 MACHINE`, or with --host 0.0.0.0; nothing is encrypted.
"""
GROUP, ORDER = "see", 10


class ViewOptions(EyeOptions, OverOptions, ShownOptions):
    """Show a scene in a window or on a web page, live.

    Attributes:
        scene: scene, robot or recording: a file, or a shipped name; a start page without one.
        window: a window on this screen; the default if there is one.
        web: a page for web browsers.
        port: of the page; default the first free from 8080 on.
        host: address the page is served at; default 127.0.0.1, this machine only.
        token: without effect; a page has a token by default.
        no_token: a page without a token, which every user of this machine can see and control.
        no_browser: print the address of the page, and do not open it in a browser.
        simulate: simulate the robots without an end, to be pulled and steered by their targets.
        control: with --simulate: `gravity`, `joint` or `cartesian`, or another kind of a controller
            that can do without declared gains; default joint.
        size: of the window, pixels; default 1280x800.
        full_screen: cover the screen.
        finish_films: finish films of what was kept (K) after the end; else they end with the
            viewer.
        fresh: as the scene declares it, not as it was left the last time.
        trust: let scenarios in this folder start programs, also if they are opened from the page
            or dropped; may be repeated.
        over: draw over the pictures of a camera: its number, 0 say, an address, or a video.
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
    finish_films: bool = False
    fresh: bool = False
    trust: Annotated[list[Path], Option("FOLDER")] = []
    over: Annotated[str | None, Option("CAMERA")] = None

    @property
    def of_page(self) -> list[str]:
        """Which options are given that only a page has."""
        return self.set_among("port", "host", "token", "no_token", "no_browser")

    @property
    def of_window(self) -> list[str]:
        """Which options are given that only a window has."""
        return self.set_among("size", "full_screen", "stereo", "over")

    @model_validator(mode="after")
    def _check_place(self) -> Self:
        if self.window and self.web:
            raise ValueError("--window and --web: one or the other; expected one of them")
        if self.window and self.of_page:
            what = "is for the page; leave --window out, or take --web"
            raise ValueError(f"{self.of_page[0]} {what}")
        if self.token and self.no_token:
            raise ValueError("--token and --no-token: expected one of them")
        if (self.web or self.of_page) and self.of_window:
            name = self.of_window[0]
            reasons = {"--stereo": "has one eye", "--over": "shows no camera's pictures"}
            why = reasons.get(name, "is as large as its browser's")
            raise ValueError(f"{name} is for the window; a page {why}")
        return self

    @model_validator(mode="after")
    def _check_scene(self) -> Self:
        if self.over is not None:
            why = " does not go with --over: the view is the camera's"
            self.refuse(("camera", "stereo"), why)
            if self.replay is not None and Path(self.over).is_file():
                self.refuse(("start",), " does not go with a video; --offset says when it begins")
        if self.control is not None and not self.simulate:
            raise ValueError(f"--control {self.control} is for --simulate, which is not given")
        if self.simulate and self.replay is not None:
            raise ValueError("--simulate and --replay: a recording is played, and not simulated")
        if self.scene is None:
            of_scene = ("camera", "replay", "start", "over", "offset")
            self.refuse(of_scene, " is for a scene; name one: sero-mj view SCENE")
            why = " is for a scene; name one: sero-mj view SCENE --set ..."
            self.refuse(("settings",), why)
        return self


def run(options: ViewOptions) -> int:
    """Shows the scene until it is closed, or the start page until something is; returns 0."""
    from .opening import with_scene

    for folder in options.trust:
        if not folder.is_dir():
            raise UsageError(f"--trust {folder}: no such folder")
        trust.trust_folder(folder)
    options = with_scene(options)
    on_page = wants_page(options)
    if not on_page:
        # MuJoCo takes its OpenGL from the window here, whatever is right without one.
        os.environ["MUJOCO_GL"] = "glfw"
    session = Session(options, on_page=on_page)
    mirror = session.first()
    if on_page and not (options.web or options.of_page):
        print("no display for a window, so it is a page for browsers (--web)", file=sys.stderr)
    with until_ended():  # as good as closing it
        while True:
            if mirror is None and session.is_at_start:
                mirror = session.choose()
            if mirror is None:
                return 0
            mirror = session.show(mirror)
    return 0


add_to = command("view", run, ViewOptions, _HELP)


class Session:
    """What one command shows, one thing after the other.

    Attributes:
        plain: the scene that is shown, without being simulated.
        is_at_start: whether the start page is shown next.
    """

    def __init__(self, options: ViewOptions, *, on_page: bool) -> None:
        from ..robots.declared.scene import Scene

        self.options, self.on_page = options, on_page
        self._listener: PageListener | None = None  # as long as the session: see `PageListener`
        self._token: bool | str = not options.no_token  # as browsers know the page
        self.plain = Scene()
        self.is_at_start = options.scene is None
        # Camera, panel with its sections, and switches, to be kept while the same scene is shown.
        self._last: tuple[mujoco.MjvCamera, dict[str, bool], ViewState] | None = None
        self._is_announced = False
        self._told: set[str] = set()  # sources that are waited for
        self._warnings: list[str] = []  # of the files of what is shown next

    @property
    def _listening(self) -> PageListener:
        if self._listener is None:
            from ..viewer.web.server import PageListener

            self._listener = PageListener(self.options.host or _LOOPBACK, self.options.port or 0)
        return self._listener

    def first(self) -> Mirror | None:
        """Returns what shows the scene of the command; None for the start page."""
        name, options = self.options.scene, self.options
        if name is None:
            return None
        if options.over is not None and Path(options.over).is_file():
            self.options = options = options.from_its_begin()  # of a video
        with self._noting_warnings():
            # Its user has typed its path in order to have it simulated.
            return self._begin(options.read(name, by_hand=not options.simulate, trusted=True))

    def _begin(self, scene: Scene, *, is_replayed: bool = False) -> Mirror:
        is_simulated = self.options.simulate and not is_replayed
        control = self.options.control or "joint"
        mirror = _simulated(scene, control) if is_simulated else _mirror_of(scene)
        self.plain, self._last = scene, None
        return mirror

    def choose(self) -> Mirror | None:
        """Shows the start page; returns what shows the scene that was chosen there."""
        options = self.options
        self.is_at_start = False  # unless its user goes back to it
        from ..viewer.host.start_page import listening

        if self.on_page:
            from ..viewer.web.start_host import StartHost
            from ..viewer.web.uploads import drops

            drops.show()

            host = options.host or _LOOPBACK
            with (
                listening() as heard,
                StartHost(self.open, heard, host, self._listening, token=self._token) as page,
            ):
                self._announce("the start page", page.server, host)
                return page.run()
        from ..viewer.window.start_window import StartWindow

        size, full_screen = options.size or _SIZE, options.full_screen
        with (
            listening() as heard,
            StartWindow(self.open, heard, size, full_screen=full_screen) as window,
        ):
            return window.run()

    def open(self, what: RecentView | Path) -> Mirror:
        """Returns what shows the scene that a user has chosen, or a file that was dropped.

        The options are then those of the new scene; nothing changes where it is wrong.
        """
        from .opening import view_of_file

        view = what
        if isinstance(view, Path):
            is_shown = self.options.scene is not None
            view = view_of_file(view, self.options.scene if is_shown else None)
        with self._noting_warnings():
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
        """Shows a scene until it is closed; returns what is to be shown then, if anything."""
        return self._serve(mirror) if self.on_page else self._open_window(mirror)

    @contextmanager
    def _noting_warnings(self) -> Iterator[None]:
        kept, log = _KeptWarnings(), logging.getLogger("sero_mj")
        log.addHandler(kept)
        try:
            yield
            self._warnings = kept.texts
        finally:
            log.removeHandler(kept)

    def _offer(self, host: LiveHost) -> None:
        from ..simulate.runs.run_source import RunSource
        from ..viewer.session.recent_views import RecentView
        from ..viewer.tools.rolling_recorder import RollingRecorder

        options = self.options
        host.others.offers["start page"] = self._go_back
        simulated = [each for each in host.mirror.sources.values() if isinstance(each, RunSource)]
        if any(each.live is not None for each in simulated):
            host.others.offers["end the simulation"] = lambda: _mirror_of(self.plain)
        elif all(each.drag_force is None for each in simulated) and host.world.robots:

            def simulate() -> Mirror:
                parts, data = host.world.robots, host.data
                shown = {name: data.qpos[part.qpos].copy() for name, part in parts.items()}
                # A robot that nobody has posed starts where it can be moved.
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
                tool.finishes_videos = self.options.finish_films
        if self._warnings:
            more = f" (and {len(self._warnings) - 1} more)" if len(self._warnings) > 1 else ""
            # What is wrong is behind the folder.
            folder = f"{Path(self.options.scene or '').parent}{os.sep}"
            host.say(self._warnings.pop(0).replace(folder, "") + more, is_bad=True)
            self._warnings.clear()
        host.command = command_of(self.options)

    def _go_back(self) -> None:
        self.is_at_start = True

    def _show_as_before(
        self,
        host: LiveHost,
        camera: mujoco.MjvCamera,
        panel: Mapping[str, bool],
        state: ViewState,
    ) -> None:
        from ..viewer.image.camera import copy_camera
        from ..viewer.session.view_state import apply_state

        copy_camera(camera, host.view_camera)
        # What is new, the doubles at targets, is as declared.
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
        is_kept = options.over is None and not is_temporary(view)
        for source in host.mirror.sources.values():
            if source.is_live and source.about not in self._told:
                self._told.add(source.about)
                print(f"waiting for {source.awaited} on {source.about}", flush=True)
        try:
            host.run()
        finally:
            save(host)
        if is_kept:
            # A page draws its pictures where it is served, which takes a while.
            is_pictured = self.on_page and (view.image.is_file() or view.is_shipped)
            remember_view(view, None if is_pictured else host.image())
        if self.plain is plain:  # else another one is shown next
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
                self._show_as_before(window, *self._last)
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
                self._show_as_before(page, *self._last)
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
                f"warning: served at {host}: whoever has this address sees the page and can take "
                "control; nothing is encrypted",
                file=sys.stderr,
                flush=True,
            )


class _KeptWarnings(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.texts: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.name != trust.log.name:  # of which a dialog tells
            self.texts.append(record.getMessage())


def _absolute(name: Path | str | None) -> str:
    """A name of what is shipped as it is, a file's path as an absolute one."""
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
    """Whether the scene goes to browsers instead of into a window; raises UsageError."""
    if options.web or options.of_page:
        return True
    from ..viewer.image.backend import has_display

    if has_display():
        return False
    if options.window or options.of_window:
        raise UsageError(
            "no display for a window: neither DISPLAY nor WAYLAND_DISPLAY is set; "
            "--web shows the scene on a page, `sero-mj render` makes pictures and films"
        )
    return True


def command_of(options: ViewOptions) -> list[str]:
    """The scene of a command, and what changes it, for another command."""
    words = [str(options.scene)]
    for setting in options.settings:
        words += ["--set", setting]
    for name in ("look", "replay", "start"):
        value = getattr(options, name)
        words += [] if value is None else [f"--{name}", str(value)]
    return words
