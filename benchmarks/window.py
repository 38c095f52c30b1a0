"""Measures windows: the work per frame, the time to the first frame, and the effect on a loop.

    xvfb-run -s "-screen 0 1600x1000x24" .venv/bin/python benchmarks/window.py

Requires a display. The work per frame includes input, sources, MuJoCo's update of the scene, decor,
hovering, plots and the status line, but not the drawing by OpenGL. The loop runs at 1 kHz in the
user's program and updates a window of `sero_mj.view`.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

os.environ.setdefault("MUJOCO_GL", "glfw")

import numpy as np
from worlds import WORLDS, make_world

import sero_mj
from sero_mj import Mirror, Viewer
from sero_mj.viewer.window.host import Window

FRAMES = 200
LOOP_SECONDS = 8.0
_FIRST = """
import os, time
os.environ["MUJOCO_GL"] = "glfw"
from sero_mj.load import load_scene
scene = load_scene("lwr_udp")
from sero_mj.data.drive.mirror import Mirror
from sero_mj.viewer.window.host import Window
with Mirror(scene) as mirror, Window(mirror, size=(1280, 800)) as window:
    window.frame()
    print(time.time())
"""


def work(joints: int) -> tuple[float, float]:
    """Returns the median and 95th percentile of the work per frame with all features, s."""
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
    """Returns the time from the start of a process to the first frame on the screen, s."""
    begin = time.time()
    done = subprocess.run(
        [sys.executable, "-c", _FIRST], check=True, capture_output=True, text=True
    )
    return float(done.stdout.split()[-1]) - begin


def loop_scene() -> sero_mj.Scene:
    """Returns a scene of an LWR with arrows."""
    return sero_mj.Scene(robots=[sero_mj.SerialRobot.from_model("lwr", show_arrows=True)])


def measure_loop(viewer: Viewer) -> str:
    """Measures `set` and `sync` in a loop at 1 kHz three times; returns a text with the results."""
    lines = []
    for _ in range(3):
        sets, syncs = [], []
        shown, begin = viewer.frame_count, time.perf_counter()
        due = begin
        while due < begin + LOOP_SECONDS:
            due += 1e-3
            time.sleep(max(due - time.perf_counter(), 0.0))
            angles, torques = 0.5 * np.sin(due + np.arange(7)), 60 * np.cos(due + np.arange(7))
            marks = [time.perf_counter()]
            for step in (
                lambda angles=angles: viewer.set("lwr.joint_angles", angles),
                lambda torques=torques: viewer.set("lwr.torques", torques),
                viewer.sync,
            ):
                step()
                marks.append(time.perf_counter())
            sets += [marks[1] - marks[0], marks[2] - marks[1]]
            syncs.append(marks[3] - marks[2])
        took = time.perf_counter() - begin
        texts = []
        for name, times in (("set", sets), ("sync", syncs)):
            p50, p99, highest = 1e3 * np.percentile(times, [50, 99, 100])
            texts.append(f"{name} p50 {p50:.4f} ms, p99 {p99:.4f} ms, max {highest:.3f} ms")
        rate = (viewer.frame_count - shown) / took
        lines.append(f"loop at 1 kHz: {'; '.join(texts)}; {rate:.0f} frames/s")
    return "\n".join(lines)


def main() -> None:
    """Prints all measurements."""
    for joints in WORLDS:
        median, slow = work(joints)
        print(f"{joints:3} joints: {1e3 * median:.2f} ms per frame, p95 {1e3 * slow:.2f} ms")
    times = sorted(first_frame() for _ in range(5))
    with sero_mj.view(loop_scene(), size=(640, 480)) as viewer:
        print(measure_loop(viewer))
    print(f"first frame after {times[2]:.2f} s (five starts: {times[0]:.2f} to {times[-1]:.2f} s)")


if __name__ == "__main__":
    main()
