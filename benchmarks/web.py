"""Measures the web page: our own work per frame, what goes to a browser, what it costs a loop.

    .venv/bin/python benchmarks/web.py

Needs Chromium and Playwright. Robots move and everything is shown, axes and numbers included.
The browser draws a small page, for without a GPU it takes both cores.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import numpy as np
from window import loop_scene, measure_loop
from worlds import WORLDS, make_world

import sero_mj
from sero_mj import Mirror
from sero_mj.viewer.web.host import WebHost

SECONDS = 10.0
SHOWN = "() => globalThis.player?.calls > 0"  # the first picture is drawn
_ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
]


def serve(joints: int) -> None:
    """Serves moving robots; after some seconds with a browser it prints what that cost."""
    rng = np.random.default_rng(1)
    with Mirror(make_world(WORLDS[joints]).scene) as mirror, WebHost(mirror) as page:
        print(page.url, flush=True)
        world = mirror.world
        page.toggles.frame_names[:] = False
        page.toggles.billboards[:] = page.toggles.arrows[:] = page.toggles.axes[:] = True
        targets = [
            (name, key, part.robot.n, rng.uniform(0.1, 0.8, part.robot.n))
            for name, part in world.robots.items()
            for key in ("joint_angles", "torques")
        ]
        times, begin, states, sent = [], float("inf"), 0, 0
        while page.frame():
            now = time.monotonic()
            for name, key, n, scale in targets:
                wave = scale * np.sin(now + np.arange(n))
                world.set_input(
                    mirror.data, f"{name}.{key}", wave * (1 if key != "torques" else 20)
                )
            if page.is_seen and begin == float("inf"):
                begin = now + 5.0  # until the browser has drawn its first pictures
            if now < begin:
                states, sent = page.browsers.sent, sent_by(page.server.port)
                continue
            times.append(page.work)
            if now > begin + SECONDS:
                break
        found = {
            "geoms": page.decor.buffer.count,
            "median": float(np.median(times)),
            "slow": float(np.percentile(times, 95)),
            "states": (page.browsers.sent - states) / SECONDS,
            "bytes": (sent_by(page.server.port) - sent) / max(page.browsers.sent - states, 1),
        }
        print(json.dumps(found), flush=True)


def sent_by(port: int) -> int:
    """How many bytes a port of this machine has sent over connections that are open now."""
    words = subprocess.run(
        ["ss", "-tiHn", "state", "established", f"( sport = :{port} )"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    return sum(int(each.partition(":")[2]) for each in words if each.startswith("bytes_sent:"))


def measure_viewer(browser: Any) -> None:
    """Prints what a page costs a loop of the user's own while a browser shows it."""
    with sero_mj.view(loop_scene(), web=True) as viewer:
        page = browser.new_page(viewport={"width": 480, "height": 320})
        page.goto(viewer.url)
        page.wait_for_function(SHOWN)
        print(measure_loop(viewer), flush=True)
        page.close()


def measure(browser: Any, joints: int) -> None:
    """Prints what a page costs."""
    server = subprocess.Popen(
        [sys.executable, __file__, str(joints)], stdout=subprocess.PIPE, text=True
    )
    assert server.stdout is not None
    url = server.stdout.readline().strip()
    page = browser.new_page(viewport={"width": 480, "height": 320})
    begin = time.monotonic()
    page.goto(url)
    page.wait_for_function(SHOWN)
    opened = time.monotonic() - begin
    found = json.loads(server.stdout.readline())
    page.close()
    server.wait()
    print(
        f"{joints:3} joints, {found['geoms']} geoms: "
        f"{1e3 * found['median']:.2f} ms a frame, 95 %: {1e3 * found['slow']:.2f} ms; "
        f"{found['states']:.1f} states/s, {found['bytes'] / 1e3:.1f} kB each; "
        f"page with the robot after {opened:.2f} s",
        flush=True,
    )


def main() -> None:
    """Prints what was measured."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = playwright.chromium.launch(executable_path=chromium, args=_ARGUMENTS)
        for joints in WORLDS:
            measure(browser, joints)
        measure_viewer(browser)
        browser.close()


if __name__ == "__main__":
    serve(int(sys.argv[1])) if len(sys.argv) > 1 else main()
