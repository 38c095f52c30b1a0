"""`sero-mj view`: a scene in a window or on a web page, live."""

from __future__ import annotations

import argparse
import os
import sys
from contextlib import ExitStack
from functools import partial

from ..assemble.scene import Scene
from ..errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    add_over_options,
    add_scene_options,
    add_stereo_options,
    check_over_options,
    check_stereo_options,
    port,
    read_shown_scene,
    refuse,
    size,
    until_ended,
)

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
    parser.add_argument("--size", type=size, metavar="WxH", help="of the window; default 1280x800")
    parser.add_argument("--full-screen", action="store_true", help="cover the screen")
    add_stereo_options(parser)
    add_over_options(parser, is_live=True)
    add_scene_options(parser)


def run(options: argparse.Namespace) -> int:
    """Shows the scene until it is closed; returns 0."""
    check_stereo_options(options)
    check_over_options(options)
    if options.over is not None:
        refuse(options, ("camera", "stereo"), " does not go with --over: the view is the camera's")
    on_page = wants_page(options)
    if not on_page:
        # MuJoCo takes its OpenGL from the window here, whatever is right without one.
        os.environ["MUJOCO_GL"] = "glfw"
    scene = read_shown_scene(options, by_hand=True)
    if on_page and not (options.web or _of_page(options)):
        print("no display for a window, so it is a page for browsers (--web)", file=sys.stderr)
    with until_ended():  # as good as closing it
        _serve(scene, options) if on_page else _open_window(scene, options)
    return 0


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


def _open_window(scene: Scene, options: argparse.Namespace) -> None:
    from ..drive.mirror import Mirror
    from ..show.window.host import Window

    with ExitStack() as stack:
        make_viewport = None
        if options.over is not None:
            from ..show.camera_feed import CameraFeed
            from ..show.window.photo_viewport import PhotoViewport

            feed = stack.enter_context(CameraFeed(options.over, options.camera_file))
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
        window.run()


def _serve(scene: Scene, options: argparse.Namespace) -> None:
    from ..drive.mirror import Mirror
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
        print(f"{scene.name} is at {' and '.join(page.urls)}  (Ctrl+C ends it)", flush=True)
        if not page.is_private:
            print(
                f"warning: served at {host}: whoever has this address sees the page and can take "
                "control; nothing is encrypted",
                file=sys.stderr,
                flush=True,
            )
        page.run()
