"""Measures a window: our own work per frame, without rendering, and the time to the first frame.

    xvfb-run -s "-screen 0 1600x1000x24" .venv/bin/python benchmarks/window.py

Needs a display. Frames are drawn as well, in a small window, but only our own work is counted:
input, sources, MuJoCo's update of the scene, decor, hovering, plots and the status line.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

os.environ["MUJOCO_GL"] = "glfw"

import numpy as np
from worlds import WORLDS, make_world

from sero_mj import Mirror
from sero_mj.show.window.host import Window

FRAMES = 200
_FIRST = """
import os, time
os.environ["MUJOCO_GL"] = "glfw"
from sero_mj.load import load_scene
scene = load_scene("lwr_udp")
from sero_mj.drive.mirror import Mirror
from sero_mj.show.window.host import Window
with Mirror(scene) as mirror, Window(mirror, size=(1280, 800)) as window:
    window.frame()
    print(time.time())
"""


def work(joints: int) -> tuple[float, float]:
    """Median and 95th percentile of our own work for a frame with everything shown, s."""
    scene = make_world(WORLDS[joints]).scene
    times = []
    with Mirror(scene) as mirror, Window(mirror, size=(400, 300)) as window:
        window.shows_plot = True
        window.toggles.frame_names[:] = False
        for k in range(FRAMES + 20):
            window._mouse.position = (200.0, 160.0 + k % 20)
            window.frame()
            times.append(window.work)
    return float(np.median(times[20:])), float(np.percentile(times[20:], 95))


def first_frame() -> float:
    """From the start of the process until the first frame is on the screen, s."""
    begin = time.time()
    done = subprocess.run(
        [sys.executable, "-c", _FIRST], check=True, capture_output=True, text=True
    )
    return float(done.stdout.split()[-1]) - begin


def main() -> None:
    """Prints what was measured."""
    for joints in WORLDS:
        median, slow = work(joints)
        print(f"{joints:3} joints: {1e3 * median:.2f} ms a frame, 95 %: {1e3 * slow:.2f} ms")
    times = sorted(first_frame() for _ in range(5))
    print(f"first frame after {times[2]:.2f} s (of five: {times[0]:.2f} to {times[-1]:.2f})")


if __name__ == "__main__":
    main()
