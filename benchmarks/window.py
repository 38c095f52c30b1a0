"""Measures a window: our own work per frame, the time to the first frame, what it costs a loop.

    xvfb-run -s "-screen 0 1600x1000x24" .venv/bin/python benchmarks/window.py

Needs a display. Frames are drawn as well, in a small window, but only our own work is counted:
input, sources, MuJoCo's update of the scene, decor, hovering, plots and the status line. The loop
is one of the user's own, at 1 kHz, beside a window of `sero_mj.view`.
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


def loop_scene() -> sero_mj.Scene:
    """An LWR with arrows."""
    return sero_mj.Scene(robots=[sero_mj.SerialRobot.from_model("lwr", show_arrows=True)])


def measure_loop(viewer: Viewer) -> str:
    """What `set` and `sync` take in a loop at 1 kHz, three times, and the pictures meanwhile."""
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
            p50, p99, most = 1e3 * np.percentile(times, [50, 99, 100])
            texts.append(f"{name} {p50:.4f} ms, 99 %: {p99:.4f}, most {most:.3f}")
        pictures = (viewer.frame_count - shown) / took
        lines.append(f"loop at 1 kHz: {'; '.join(texts)}; {pictures:.0f} pictures/s")
    return "\n".join(lines)


def main() -> None:
    """Prints what was measured."""
    for joints in WORLDS:
        median, slow = work(joints)
        print(f"{joints:3} joints: {1e3 * median:.2f} ms a frame, 95 %: {1e3 * slow:.2f} ms")
    times = sorted(first_frame() for _ in range(5))
    with sero_mj.view(loop_scene(), size=(640, 480)) as viewer:
        print(measure_loop(viewer))
    print(f"first frame after {times[2]:.2f} s (of five: {times[0]:.2f} to {times[-1]:.2f})")


if __name__ == "__main__":
    main()
