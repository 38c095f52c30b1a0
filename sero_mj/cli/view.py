"""`sero-mj view`: a scene in a window, live."""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

from ..errors import UsageError
from .arguments import (
    Commands,
    add_command,
    not_negative,
    read_scene_or_model,
    replay_instead,
    size,
)

_EPILOG = """\
examples:
  sero-mj view lwr_udp                                the robot, as it moves
  sero-mj view impedance_push                         a simulation, with a time line
  sero-mj view lwr_udp --replay run.mcap              a recording, with a time line
  sero-mj view lwr --set lwr.show_axes=true --camera 150,-15,2.2

F1 in the window shows what mouse and keys do. Ctrl+Q closes it.
"""


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(commands, "view", run, "show a scene in a window, live", _EPILOG)
    parser.add_argument("scene", metavar="SCENE", help="scene or robot: a file, or a shipped name")
    parser.add_argument(
        "--window", action="store_true", help="a window on this screen, and nothing else"
    )
    parser.add_argument(
        "--size", type=size, default=(1280, 800), metavar="WxH", help="default 1280x800"
    )
    parser.add_argument("--full-screen", action="store_true", help="cover the screen")
    parser.add_argument(
        "--camera",
        metavar="CAM",
        help="name of a camera, or azimuth,elevation,distance in degrees and m",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="settings",
        metavar="ROBOT.FIELD=VALUE",
        help="set a field over the scene's; may be repeated",
    )
    parser.add_argument(
        "--replay", type=Path, metavar="REC", help="play a recording instead of the live sources"
    )
    parser.add_argument(
        "--start", type=not_negative, metavar="S", help="where in the recording to begin"
    )


def run(options: argparse.Namespace) -> int:
    """Shows the window until it is closed; returns 0."""
    if not has_display():
        raise UsageError(
            "no display for a window: neither DISPLAY nor WAYLAND_DISPLAY is set; "
            "`sero-mj render` makes pictures and films without one"
        )
    # MuJoCo takes its OpenGL from the window here, whatever is right without one.
    os.environ["MUJOCO_GL"] = "glfw"
    scene = read_scene_or_model(options.scene, options.settings)
    if options.replay is not None:
        replay_instead(scene, options.replay, options.start)
    elif options.start is not None:
        raise UsageError("--start is for recordings; give --replay REC.mcap as well")
    from ..drive.mirror import Mirror
    from ..show.window import Window

    try:
        with (
            Mirror(scene) as mirror,
            Window(
                mirror,
                size=options.size,
                camera=options.camera,
                full_screen=options.full_screen,
            ) as window,
        ):
            window.run()
    except KeyboardInterrupt:
        pass  # as good as closing it
    return 0


def has_display() -> bool:
    """Whether there is a screen to open a window on."""
    if sys.platform != "linux":
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
