"""Measures live pages and exported pages.

For live pages: the work per frame, the data sent to a browser, the effect on a loop of the user,
the latency from a packet to the image, and the first image over a slow link. For exported pages:
the time to write a page, and the time in which a browser draws a frame.

    .venv/bin/python benchmarks/web.py

Requires Chromium and Playwright. Robots move, and all visual features are shown. The browser draws
a small page, because it uses both cores without a GPU.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

os.environ.setdefault("MUJOCO_GL", "egl")

import numpy as np
from window import loop_scene, measure_loop
from worlds import WORLDS, make_world

import sero_mj
from sero_mj import Mirror
from sero_mj.viewer.web.host import WebHost

SECONDS = 10.0
SHOWN = "() => globalThis.player?.calls > 0"  # whether the first image is drawn
_ARGUMENTS = [
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--no-sandbox",
]


def serve(joints: int) -> None:
    """Serves a page with moving robots for some seconds, and prints measurements as JSON."""
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
                begin = now + 5.0  # by then, the browser has drawn its first images
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
    """Returns the number of bytes that a port has sent over the open connections."""
    words = subprocess.run(
        ["ss", "-tiHn", "state", "established", f"( sport = :{port} )"],
        capture_output=True, text=True, check=True,
    ).stdout.split()  # fmt: skip
    return sum(int(each.partition(":")[2]) for each in words if each.startswith("bytes_sent:"))


def measure_viewer(browser: Any) -> None:
    """Prints the effect of a page that a browser shows on a loop of the user."""
    with sero_mj.view(loop_scene(), web=True) as viewer:
        page = browser.new_page(viewport={"width": 480, "height": 320})
        page.goto(viewer.url)
        page.wait_for_function(SHOWN)
        print(measure_loop(viewer), flush=True)
        page.close()


def measure(browser: Any, joints: int) -> None:
    """Prints the measurements of a live page with moving robots."""
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
        f"{1e3 * found['median']:.2f} ms per frame, p95 {1e3 * found['slow']:.2f} ms; "
        f"{found['states']:.1f} states/s of {found['bytes'] / 1e3:.1f} kB; "
        f"first image after {opened:.2f} s",
        flush=True,
    )


# Returns times of frames of an exported page, ms: the whole frame, the frame without the parts that
# are omitted on slow machines, and only the surfaces of robots and doubles. Reading a pixel waits
# until the frame is drawn.
_FRAMES = """() => {
    const { stage } = player, gl = stage.renderer.getContext(), pixel = new Uint8Array(4);
    const { robots, items, floor } = stage, all = [items.group, floor];
    const time = (draw) => {
        const took = [];
        for (let k = 0; k < 25; k++) {
            const begin = performance.now();
            draw(k % 20);
            gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
            took.push(performance.now() - begin);
        }
        return took.slice(5).sort((a, b) => a - b)[10];
    };
    const whole = (frame) => { player.clock.at = frame; player.draw(); };
    player.switches.shadows = robots.depth.visible = true;
    const full = time(whole);
    player.switches.shadows = robots.depth.visible = false;
    const less = time(whole);
    for (const each of all) each.visible = false;
    const alone = time(() => stage.draw());
    return [full, less, alone];
}"""


def measure_frames(browser: Any, folder: Path) -> None:
    """Prints the times to write an exported page and to draw its frames in a browser."""
    for name in ("impedance_push", "justin_push"):
        path, scene = folder / f"{name}.html", sero_mj.load_scene(name)
        begin = time.monotonic()
        sero_mj.export_html(scene, path)
        took = time.monotonic() - begin
        page = browser.new_page(viewport={"width": 640, "height": 480})
        page.goto(f"{path.as_uri()}#t=1")
        page.wait_for_function("() => document.documentElement.dataset.ready === '1'")
        full, less, alone = page.evaluate(_FRAMES)
        calls = page.evaluate("player.calls")
        page.close()
        print(
            f"{name}: written in {took:.1f} s, {path.stat().st_size / 1e6:.2f} MB; {calls} draw "
            f"calls; {full:.0f} ms per frame, {less:.0f} ms without shadows and depth of doubles, "
            f"{alone:.0f} ms for surfaces only (ratios {full / alone:.2f} and {less / alone:.2f})",
            flush=True,
        )


def measure_latency(browser: Any) -> None:
    """Prints the latency from a packet to the image that shows it."""
    scene = sero_mj.load_scene("lwr_udp")
    scene.sources["udp"]["port"] = 0
    with Mirror(scene) as mirror, WebHost(mirror) as host:
        port = mirror.sources["udp"].port
        page = browser.new_page(viewport={"width": 480, "height": 320})
        thread = threading.Thread(target=lambda: [None for _ in iter(host.frame, False)])
        thread.start()
        page.goto(host.url)
        page.wait_for_function(SHOWN)
        page.evaluate(_WATCH)
        took = []
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for k in range(60):
                angle = 0.2 + 0.01 * k
                sent = time.time()
                sender.sendto(struct.pack("=14d", *[angle] * 7, *[5.0] * 7), ("127.0.0.1", port))
                shown = page.evaluate("angle => drawnWith(angle)", angle)
                took.append(shown / 1e3 - sent)
        host.request_close()
        thread.join()
        page.close()
    p50, p90 = np.percentile(took, [50, 90]) * 1e3
    print(f"packet to image: p50 {p50:.0f} ms, p90 {p90:.0f} ms", flush=True)


# Defines a function that returns the time at which an image with an angle was drawn, ms since 1970.
_WATCH = """() => {
    const { view, state } = player, draw = view.draw.bind(view);
    let wanted = null;
    view.draw = (frame) => {
        draw(frame);
        const gl = view.renderer.getContext();
        gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
        const angles = player.state.run.values.joint_angles;
        if (wanted && angles && Math.abs(angles[0] - wanted[0]) < 1e-4)
            wanted[1](performance.timeOrigin + performance.now());
    };
    globalThis.drawnWith = (angle) => new Promise((done) => { wanted = [angle, done]; });
}"""


class SlowLink:
    """A proxy for connections to a port, which transfers `rate` bytes per second in total."""

    def __init__(self, port: int, rate: float) -> None:
        self._to, self._rate = port, rate
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._server.getsockname()[1]
        self._lock, self._free = threading.Lock(), 0.0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        while True:
            here, _ = self._server.accept()
            there = socket.create_connection(("127.0.0.1", self._to))
            for one, other in ((here, there), (there, here)):
                threading.Thread(target=self._carry, args=(one, other), daemon=True).start()

    def _carry(self, one: socket.socket, other: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := one.recv(4096):
                with self._lock:  # all connections share the link
                    self._free = max(self._free, time.monotonic()) + len(data) / self._rate
                    until = self._free
                time.sleep(max(until - time.monotonic(), 0.0))
                other.sendall(data)
        other.close()


def measure_slow_link(browser: Any, name: str) -> None:
    """Prints the time to the first image of a page over a link with 200 kB/s."""
    with sero_mj.view(name, web=True) as viewer:
        assert viewer.url is not None
        link = SlowLink(urlsplit(viewer.url).port or 0, 200e3)
        context = browser.new_context(viewport={"width": 480, "height": 320})
        page = context.new_page()
        begin = time.monotonic()
        page.goto(f"http://localhost:{link.port}/?{urlsplit(viewer.url).query}")
        page.wait_for_function(SHOWN)
        opened = time.monotonic() - begin
        context.close()
    print(f"{name} over 200 kB/s: first image after {opened:.1f} s", flush=True)


def main() -> None:
    """Prints all measurements."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = shutil.which("chromium") or shutil.which("chromium-browser")
        browser = playwright.chromium.launch(executable_path=chromium, args=_ARGUMENTS)
        for joints in WORLDS:
            measure(browser, joints)
        measure_viewer(browser)
        measure_latency(browser)
        for name in ("impedance_push", "justin_push"):
            measure_slow_link(browser, name)
        with tempfile.TemporaryDirectory() as folder:
            measure_frames(browser, Path(folder))
        browser.close()


if __name__ == "__main__":
    serve(int(sys.argv[1])) if len(sys.argv) > 1 else main()
