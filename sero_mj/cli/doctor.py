"""`sero-mj check` without a scene: reports which OpenGL backends and viewers are available.

Each backend is tested in its own process, because importing MuJoCo fixes the backend of a process.
"""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import re
import subprocess
import sys
from typing import Any

from ..viewer.image.backend import BACKENDS, PACKAGES, has_display, has_osmesa

_NO_DM_CONTROL = """\
  dm-control is not installed. Only PyMJCF and composer models need it:
  pip install 'sero-mj[dm-control]' (up to Python 3.12: labmaze, on which it depends, has no
  wheels for later versions)"""

_TRIAL = """
import time, mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 2'/><geom size='.2' rgba='1 0 0 1'/></worldbody></mujoco>")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
with mujoco.Renderer(model, 64, 64) as renderer:
    renderer.update_scene(data)
    pixels = renderer.render()
    start = time.perf_counter()
    renderer.render()
    took = time.perf_counter() - start
    assert pixels[32, 32, 0] > 40, "the image is empty"
    try:
        from OpenGL import GL
        name = GL.glGetString(GL.GL_RENDERER).decode()
    except Exception:
        name = "unknown renderer"
print(f"{name}|{took * 1e3:.1f}")
"""

# Prints the render time of one frame in seconds at each quality.
_SPEED = """
import time
from sero_mj import HeadlessRenderer, World
from sero_mj.load import load_scene
world = World(load_scene("lwr"))
data = world.make_data()
for quality in ("normal", "draft"):
    with HeadlessRenderer(world, quality=quality) as renderer:
        renderer.render(data)
        start, frames = time.perf_counter(), 0
        while frames < 20 and time.perf_counter() - start < 0.5:
            renderer.render(data)
            frames += 1
        print(quality, (time.perf_counter() - start) / frames)
"""
_FIFO = """\
real time: `chrt -f 50 sero-mj simulate ...` and `chrt -f 50 my_controller` run with the real-time
  priority SCHED_FIFO"""
_NO_FIFO = """\
real time: SCHED_FIFO is not permitted, so steps may be delayed by other programs. On Linux, run
  echo "USER - rtprio 80" > /etc/security/limits.d/rtprio.conf as root, and log in again"""
_SMOOTH = 0.04  # maximum render time of a frame for a smooth view, s
_TRIAL_SIDE = 64  # width and height of test images, pixels


def check_machine(*, as_json: bool) -> int:
    """Prints which backends and renderers work; returns 0 if a backend works, otherwise 1."""
    from ..viewer.image.renderer import renderers

    versions = {name: _version(name) for name in ("sero-mj", "mujoco", "numpy", "av")}
    versions["dm-control"] = _version("dm-control")
    backends = {name: try_backend(name) for name in BACKENDS}
    live = {"window": window_problem(), "page": None}
    chosen = os.environ.get("MUJOCO_GL")
    works = [name for name, found in backends.items() if found["works"]]
    used = chosen if chosen in works else next(iter(works), None)
    speed = None if used is None else frame_times(used)
    side = _TRIAL_SIDE
    problems = {name: each.problem(side, side) for name, each in renderers().items()}
    if as_json:
        found: dict[str, Any] = {"versions": versions, "backends": backends}
        found["python"] = platform.python_version()
        found |= {"chosen": chosen, "live": live, "frame_times": speed, "fifo": is_fifo_allowed()}
        found |= {name: {"works": each is None, "reason": each} for name, each in problems.items()}
        print(json.dumps(found, indent=2))
        return 0 if works else 1
    print(
        f"Python {platform.python_version()}, "
        + ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    )
    if versions["dm-control"] is None:
        print(_NO_DM_CONTROL)
    for name, found in backends.items():
        if found["works"]:
            print(f"  {name:7} works: {found['renderer']}, {found['ms']} ms for 64x64")
        else:
            print(f"  {name:7} does not work: {found['reason']}")
            print(f"  {'':7} Debian, Ubuntu: apt install {PACKAGES[name]}")
    for name, problem in problems.items():
        kind = renderers()[name]
        if problem is None:
            fine = "; used by --quality fine" if kind.is_for_fine else ""
            print(f"  {kind.title} works: --renderer {name}{fine}")
        else:
            print(f"  {kind.title} does not work: {problem}; the classic renderer is used instead")
            print(f"  {'':7} Debian, Ubuntu: apt install {kind.packages}")
    print(f"sero-mj uses {chosen or 'the default backend of MuJoCo'}; MUJOCO_GL overrides it")
    if speed is not None:
        print(_about_speed(used or "", speed))
    for name, problem in live.items():
        print(f"sero-mj view: {name} {f'unavailable: {problem}' if problem else 'available'}")
    print(_FIFO if is_fifo_allowed() else _NO_FIFO)
    if not works:
        print("no backend works: this machine cannot render images")
    return 0 if works else 1


def is_fifo_allowed() -> bool:
    """Whether this user may run programs with the real-time policy SCHED_FIFO."""
    trial = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    done = subprocess.run([sys.executable, "-c", trial], check=False, capture_output=True)
    return done.returncode == 0


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def window_problem() -> str | None:
    """Returns the reason why no window can be opened, or None if windows are available."""
    return None if has_display() else "neither DISPLAY nor WAYLAND_DISPLAY is set"


def frame_times(backend: str) -> dict[str, float] | None:
    """Returns the render time in seconds of one 1280x800 LWR frame at each quality.

    Returns None if rendering fails.
    """
    try:
        done = _python(_SPEED, backend)
    except subprocess.SubprocessError:
        return None
    if done.returncode:
        return None
    return {name: float(time) for name, time in map(str.split, done.stdout.splitlines())}


def _python(code: str, backend: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "MUJOCO_GL": backend}
    environment.pop("PYOPENGL_PLATFORM", None)
    command = [sys.executable, "-c", code]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=60, check=False
    )


def _about_speed(backend: str, times: dict[str, float]) -> str:
    listed = ", ".join(f"{name} {time * 1e3:.3g} ms" for name, time in times.items())
    text = f"one 1280x800 frame of an LWR with {backend}: {listed}"
    if times["normal"] <= _SMOOTH:
        return f"{text}; fast enough for live views"
    return (
        f"{text}\n  slow for live views: windows omit shadows and antialiasing while the view\n"
        "  moves; --quality draft renders videos faster"
    )


def try_backend(name: str) -> dict[str, Any]:
    """Renders a test image with a backend in another process.

    Returns `works`, with the `renderer` and its render time `ms`, or the `reason` of a failure.
    """
    try:
        done = _python(_TRIAL, name)
    except subprocess.TimeoutExpired:
        return {"works": False, "reason": "no answer within 60 s"}
    if done.returncode == 0:
        renderer, _, milliseconds = done.stdout.strip().splitlines()[-1].rpartition("|")
        return {"works": True, "renderer": renderer, "ms": float(milliseconds)}
    lines = [line for line in done.stderr.strip().splitlines() if line.strip()]
    errors = [line for line in lines if "Error" in line and not line.startswith(" ")]
    reason = errors[0] if errors else lines[-1] if lines else f"signal {-done.returncode}"
    if name == "osmesa" and not has_osmesa():
        reason = "libOSMesa is not installed"
    return {"works": False, "reason": re.sub(r"^\S+\.py:\d+: ", "", reason)[:160]}
