"""`sero-mj demo`: a film of a robot that another process plays."""

from __future__ import annotations

import argparse
import socket
import subprocess
import sys
from pathlib import Path

from ._arguments import Commands, add_command, positive, size

_SCENE = "lwr_udp"
_CAMERA = "150,-12,2.0"
_EPILOG = """\
Starts `sero-mj send` as another process, which plays a motion to a free UDP port at 1 kHz, and
writes OUT/lwr.png and OUT/lwr.mp4 of the LWR that mirrors it.
"""
ORDER = 76  # in the help of `sero-mj`


def add_to(commands: Commands) -> None:
    """Adds the command."""
    parser = add_command(
        commands, "demo", run, "film an LWR that is mirrored from UDP packets", _EPILOG
    )
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder (default out)")
    parser.add_argument("--duration", type=positive, default=6.0, metavar="S", help="default 6")
    parser.add_argument("--size", type=size, default=(1280, 800), metavar="WxH")


def run(options: argparse.Namespace) -> int:
    """Renders; returns 0."""
    from ..base import paths
    from ..load import load_scene
    from ..viewer.headless.render import render_picture
    from .render import film_with_progress

    shown = {"lwr.show_billboards": True}
    scene = load_scene(paths.find_scene(_SCENE), shown)
    port = _free_port()
    scene.sources["udp"] = {**scene.sources["udp"], "port": port}
    picture, film = options.out / "lwr.png", options.out / "lwr.mp4"
    sender = subprocess.Popen(
        [sys.executable, "-m", "sero_mj", "send", _SCENE, "--port", str(port)],
        stdout=subprocess.DEVNULL,
    )
    try:
        silent = film_with_progress(
            scene, film, duration=options.duration, size=options.size, camera=_CAMERA, wait=30.0
        )
        silent += render_picture(scene, picture, size=options.size, camera=_CAMERA)
    finally:
        sender.terminate()
        sender.wait()
    if silent:
        print("sero-mj: no packet arrived; is UDP on loopback blocked?", file=sys.stderr)
        return 1
    print(f"an LWR mirrored from UDP packets of another process:\n  {film}\n  {picture}")
    return 0


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
