"""`sero-mj view`: a scene in a window or on a web page, live."""

from __future__ import annotations

import argparse
import copy
import os
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from ..assemble.scene import Scene
from ..errors import UsageError
from ..frames import Array
from ._arguments import (
    Commands,
    add_command,
    add_over_options,
    add_scene_options,
    add_stereo_options,
    check_over_options,
    check_stereo_options,
    offset_of_video,
    port,
    read_scene,
    read_shown_scene,
    refuse,
    replay_instead,
    size,
    until_ended,
)

if TYPE_CHECKING:
    from ..show.camera_feed import CameraFeed, VideoFeed
    from ..show.live import LiveHost
    from ..show.web.host import WebHost

Control = Literal["gravity", "joint", "cartesian"]
CONTROLS: tuple[Control, ...] = get_args(Control)
_SIZE = (1280, 800)
_LOOPBACK = "127.0.0.1"
_EPILOG = """\
examples:
  sero-mj view lwr_udp                                the robot, as it moves
  sero-mj view impedance_push                         a simulation, with a time line
  sero-mj view lwr_udp --replay run.mcap              a recording, with a time line
  sero-mj view lwr_udp --web                          on a page for browsers on this machine
  sero-mj view lwr --set lwr.show_axes=true --camera 150,-15,2.2
  sero-mj view lwr_udp --over 0 --camera-file cell.yaml   over what a camera sees of the robot
  sero-mj view lwr_udp --over video.mp4 --camera-file cell.yaml --replay run.mcap
  sero-mj view lwr --simulate --control joint         a robot to play with, without an end

H in the window or on the page shows what mouse and keys do. Ctrl+Q closes the window, Ctrl+C ends
the page. Browsers on other machines reach it through `ssh -L 8080:localhost:8080 MACHINE`, or with
--host 0.0.0.0 under the printed address, which has a token; nothing is encrypted.
"""


def add_to(commands: Commands) -> None:
    """Adds the command."""
    summary = "show a scene in a window or on a web page, live"
    parser = add_command(commands, "view", run, summary, _EPILOG)
    parser.add_argument("scene", metavar="SCENE", help="scene or robot: a file, or a shipped name")
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--window", action="store_true", help="a window on this screen; the default if there is one"
    )
    where.add_argument("--web", action="store_true", help="a page for web browsers")
    parser.add_argument(
        "--port", type=port, metavar="N", help="of the page; default the first free from 8080 on"
    )
    parser.add_argument(
        "--host",
        metavar="ADDR",
        help="address the page is served at; default 127.0.0.1, this machine only",
    )
    parser.add_argument(
        "--token",
        action="store_true",
        help="the page's address has a token on this machine, too (its other users do not know it)",
    )
    parser.add_argument(
        "--simulate",
        action="store_true",
        help="simulate the robots without an end, to be pulled and steered by their targets",
    )
    parser.add_argument(
        "--control",
        choices=CONTROLS,
        help="with --simulate: gravity compensation, joint or Cartesian impedance; default joint",
    )
    parser.add_argument("--size", type=size, metavar="WxH", help="of the window; default 1280x800")
    parser.add_argument("--full-screen", action="store_true", help="cover the screen")
    parser.add_argument(
        "--fresh",
        action="store_true",
        help="as the scene declares it, not as it was left the last time",
    )
    add_stereo_options(parser)
    add_over_options(parser, is_live=True)
    add_scene_options(parser)
    parser.set_defaults(last=None, plain=None, is_opened=False)


def run(options: argparse.Namespace) -> int:
    """Shows the scene until it is closed; returns 0."""
    check_stereo_options(options)
    check_over_options(options)
    if options.over is not None:
        refuse(options, ("camera", "stereo"), " does not go with --over: the view is the camera's")
        if options.replay is not None and Path(options.over).is_file():
            if options.start is not None:
                raise UsageError("--start does not go with a video; --offset says when it begins")
            options.start = 0.0  # times are those of the recording
    on_page = wants_page(options)
    if not on_page:
        # MuJoCo takes its OpenGL from the window here, whatever is right without one.
        os.environ["MUJOCO_GL"] = "glfw"
    if options.control is not None and not options.simulate:
        raise UsageError(f"--control {options.control} is for --simulate, which is not given")
    if options.simulate and options.replay is not None:
        raise UsageError("--simulate and --replay: a recording is played, and not simulated")
    scene = read_shown_scene(options, by_hand=not options.simulate)
    if on_page and not (options.web or _of_page(options)):
        print("no display for a window, so it is a page for browsers (--web)", file=sys.stderr)
    shown: Scene | None = scene
    options.plain = scene
    if options.simulate:
        shown = _simulated(scene, options.control or "joint")
    show = _serve if on_page else _open_window
    with until_ended():  # as good as closing it
        while shown is not None:
            shown = show(shown, options)
    return 0


def _simulated(scene: Scene, control: Control, angles: Mapping[str, Array] | None = None) -> Scene:
    from ..simulate.endless_run import endless_scene

    return endless_scene(scene, control, angles)


def _offer(host: LiveHost, plain: Scene, control: Control) -> None:
    """Offers to simulate the robots that are shown, or to show them without."""
    if host.steering.robots:
        host.offers["end the simulation"] = lambda: plain
    elif not host.pulling.can_pull and host.world.robots:

        def simulate() -> Scene:
            parts, data = host.world.robots, host.data
            angles = {name: data.qpos[part.qpos].copy() for name, part in parts.items()}
            return _simulated(plain, control, angles)

        host.offers["simulate"] = simulate


def wants_page(options: argparse.Namespace) -> bool:
    """Whether the scene goes to browsers instead of into a window; raises UsageError."""
    of_page = _of_page(options)
    of_window = ["size"] * (options.size is not None) + ["full-screen"] * options.full_screen
    of_window += ["stereo"] * (options.stereo is not None) + ["over"] * (options.over is not None)
    if options.window and of_page:
        raise UsageError(f"--{of_page[0]} is for the page; leave --window out, or take --web")
    if (options.web or of_page) and of_window:
        reasons = {"stereo": "has one eye", "over": "shows no camera's pictures"}
        why = reasons.get(of_window[0], "is as large as its browser's")
        raise UsageError(f"--{of_window[0]} is for the window; a page {why}")
    if options.web or of_page:
        return True
    from ..show.headless.backend import has_display

    if has_display():
        return False
    if options.window or of_window:
        raise UsageError(
            "no display for a window: neither DISPLAY nor WAYLAND_DISPLAY is set; "
            "--web shows the scene on a page, `sero-mj render` makes pictures and films"
        )
    return True


def _of_page(options: argparse.Namespace) -> list[str]:
    """Which options are given that only a page has."""
    given = [name for name in ("port", "host") if getattr(options, name) is not None]
    return given + ["token"] * options.token


def _open_window(scene: Scene, options: argparse.Namespace) -> Scene | None:
    from ..drive.mirror import Mirror
    from ..show.camera import copy_camera
    from ..show.window.host import Window

    with ExitStack() as stack:
        make_viewport = None
        if options.over is not None:
            from ..show.window.photo_viewport import PhotoViewport

            feed = _feed(scene, options)
            stack.callback(feed.close)
            make_viewport = partial(PhotoViewport, feed=feed)
        mirror = stack.enter_context(Mirror(scene))
        window = Window(
            mirror,
            size=options.size or _SIZE,
            camera=options.camera,
            full_screen=options.full_screen,
            stereo=options.stereo,
            eye_distance=options.eye_distance,
            make_viewport=make_viewport,
        )
        stack.enter_context(window)
        _offer(window, options.plain, options.control or "joint")
        window.opener = partial(_open_file, options=options)
        if options.last is not None:  # as it was seen before
            camera, has_panel = options.last
            copy_camera(camera, window.view_camera)
            if has_panel:
                window.toggle_panel()
        if options.last is None and not options.fresh:
            window.restore_view(with_camera=options.camera is None)
        window.command = command_of(options)
        try:
            window.run()
        finally:
            window.keep_view()
        options.last = copy.copy(window.view_camera), window.has_panel
        if options.is_opened:
            options.last, options.is_opened = None, False
        return window.next_scene


def _open_file(path: Path, options: argparse.Namespace) -> Scene:
    """The scene of a file that is dropped on the window; it is checked while the old one is seen.

    Args:
        path: of a scene, scenario or robot, or a recording of what the scene that is shown mirrors.
        options: are then those of the new scene.
    """
    from ..assemble.world import World
    from ..drive.wiring import wire

    if path.suffix.lower() == ".mcap":
        scene = read_scene(options.scene, options.settings)
        replay_instead(scene, path, None)
        given: dict[str, Any] = {"replay": path}
    else:
        scene = read_scene(str(path), by_hand=True)
        given = {"scene": str(path), "settings": [], "replay": None}
    wire(scene).check(scene)
    World(scene)
    given |= {"start": None, "camera": None, "over": None, "plain": scene, "is_opened": True}
    vars(options).update(given)
    return scene


def _feed(scene: Scene, options: argparse.Namespace) -> CameraFeed | VideoFeed:
    """The camera, or the video, that the scene is drawn over."""
    from ..drive.wiring import wire
    from ..show.camera_feed import CameraFeed, VideoFeed

    sources = wire(scene).check(scene).sources.values()
    file = Path(options.over)
    if not file.is_file() or not sources or any(source.is_live for source in sources):
        if options.offset is not None:
            raise UsageError("--offset is for a video over a recording or a scenario")
        return CameraFeed(options.over, options.camera_file)
    if options.offset in (None, "auto"):
        options.offset = offset_of_video(scene, file, options.camera_file)
    return VideoFeed(file, options.camera_file, options.offset)


def _serve(scene: Scene, options: argparse.Namespace) -> Scene | None:
    from ..drive.mirror import Mirror
    from ..show.camera import copy_camera
    from ..show.viewer import open_page

    host = options.host or _LOOPBACK
    with (
        Mirror(scene) as mirror,
        open_page(
            mirror,
            camera=options.camera,
            host=host,
            port=options.port or 0,
            token=options.token,
            waits=True,
        ) as page,
    ):
        _offer(page, options.plain, options.control or "joint")
        if options.last is None:
            _announce(scene, page, host)
            if not options.fresh:
                page.restore_view(with_camera=options.camera is None)
        else:
            copy_camera(options.last, page.view_camera)
        options.port, options.token = page.port, page.token or False  # as its browsers know it
        page.command = command_of(options)
        try:
            page.run()
        finally:
            page.keep_view()
        options.last = copy.copy(page.view_camera)
        return page.next_scene


def command_of(options: argparse.Namespace) -> list[str]:
    """The scene of a command with `add_scene_options`, and what changes it, for another command."""
    words = [str(options.scene)]
    for setting in options.settings:
        words += ["--set", setting]
    for name in ("look", "replay", "start"):
        value = getattr(options, name)
        words += [] if value is None else [f"--{name}", str(value)]
    return words


def _announce(scene: Scene, page: WebHost, host: str) -> None:
    """Says where the page is, and who else may see it."""
    print(f"{scene.name} is at {' and '.join(page.urls)}  (Ctrl+C ends it)", flush=True)
    if not page.is_private:
        print(
            f"warning: served at {host}: whoever has this address sees the page and can take "
            "control; nothing is encrypted",
            file=sys.stderr,
            flush=True,
        )
