"""`sero-mj demo`: renders a video of a robot whose joint values come from another process."""

from __future__ import annotations

import socket
import subprocess
import sys
from pathlib import Path
from typing import Annotated

from ..base.options import Duration, Option, Options, Size
from ..viewer.image.image_options import DEFAULT_SIZE, VideoOptions
from .arguments import command

_SCENE = "lwr_udp"
_CAMERA = "150,-12,2.0"
_HELP = """\
examples:
  sero-mj demo                              out/lwr.png and out/lwr.mp4
  sero-mj demo --duration 2 --size 640x400
  sero-mj demo --out /tmp/demo

Starts `sero-mj send` in another process, which sends a motion to a free UDP port at 1 kHz, and
renders an image and a video of the LWR that mirrors it.
"""
GROUP, ORDER = "see", 14


class DemoOptions(Options):
    """Render a video of an LWR that is mirrored from UDP packets.

    Attributes:
        out: output folder (default: out).
        duration: duration of the video in seconds.
        size: width and height of the image and the video in pixels.
    """

    out: Annotated[Path, Option("OUT", ("-o", "--out"))] = Path("out")
    duration: Duration = 6.0
    size: Size = DEFAULT_SIZE


def run(options: DemoOptions) -> int:
    """Renders an image and a video; returns 0, or 1 if no packet arrived."""
    from ..base import paths
    from ..base.child_process import ChildProcess
    from ..load import load_scene
    from ..viewer.image.render import render_image
    from .render import video_with_progress

    shown = {"lwr.show_billboards": True}
    scene = load_scene(paths.find_scene(_SCENE), shown)
    port = _free_port()
    scene.sources["udp"] = {**scene.sources["udp"], "port": port}
    image, video = options.out / "lwr.png", options.out / "lwr.mp4"
    sender = ChildProcess(
        [sys.executable, "-m", "sero_mj", "send", _SCENE, "--port", str(port)],
        stdout=subprocess.DEVNULL,
    )
    try:
        chosen = VideoOptions(
            size=options.size, duration=options.duration, camera=_CAMERA, wait=30.0
        )
        silent = video_with_progress(scene, video, chosen)
        silent += render_image(scene, image, chosen)
    finally:
        sender.end()
    if silent:
        hint = "Check whether a firewall blocks UDP on 127.0.0.1."
        print(f"sero-mj: no packet arrived. {hint}", file=sys.stderr)
        return 1
    print(f"LWR mirrored from UDP packets of another process:\n  {video}\n  {image}")
    return 0


add_to = command("demo", run, DemoOptions, _HELP)


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
