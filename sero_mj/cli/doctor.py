"""`sero-mj check` without a scene: working OpenGL backends and viewers, and what to install.

Each backend renders in a process of its own: importing MuJoCo fixes the backend of a process.
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
  dm-control is not installed; only models made with PyMJCF or composer need it:
  pip install 'sero-mj[dm-control]' (before Python 3.13: labmaze, which it needs, has no
  later release)"""

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
    assert pixels[32, 32, 0] > 40, "the picture is empty"
    try:
        from OpenGL import GL
        name = GL.glGetString(GL.GL_RENDERER).decode()
    except Exception:
        name = "unknown renderer"
print(f"{name}|{took * 1e3:.1f}")
"""

# A frame of a robot with arrows and numbers, s, by quality.
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
_FIRST = """\
real time: chrt -f 50 sero-mj simulate ... comes before all other programs (SCHED_FIFO), and so does
  chrt -f 50 my_controller"""
_NOT_FIRST = """\
real time: no program may come before all others (SCHED_FIFO), so that steps may be late; on Linux,
  as root: echo "USER - rtprio 80" > /etc/security/limits.d/rtprio.conf, and log in again"""
_SMOOTH = 0.04  # s, of a frame
_TRIAL_SIDE = 64  # pixels


def check_machine(*, as_json: bool) -> int:
    """Prints which backends and renderers work; returns 0 if a backend works, else 1."""
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
        found |= {"chosen": chosen, "live": live, "frame_times": speed, "fifo": may_be_first()}
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
            fine = ", and what --quality fine takes" if kind.is_for_fine else ""
            print(f"  {kind.title} works: --renderer {name}{fine}")
        else:
            print(f"  {kind.title} does not work: {problem}; pictures are classic ones")
            print(f"  {'':7} Debian, Ubuntu: apt install {kind.packages}")
    print(f"sero-mj uses {chosen or 'what MuJoCo chooses'}; MUJOCO_GL overrides it")
    if speed is not None:
        print(_about_speed(used or "", speed))
    for name, problem in live.items():
        print(f"sero-mj view: {name} {f'not here: {problem}' if problem else 'can be opened'}")
    print(_FIRST if may_be_first() else _NOT_FIRST)
    if not works:
        print("no backend works: pictures cannot be rendered on this machine")
    return 0 if works else 1


def may_be_first() -> bool:
    """Whether a program of this user may have the scheduler's policy for real time, SCHED_FIFO."""
    trial = "import os; os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))"
    done = subprocess.run([sys.executable, "-c", trial], check=False, capture_output=True)
    return done.returncode == 0


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def window_problem() -> str | None:
    """Returns why no window can be opened; None if one can."""
    return None if has_display() else "neither DISPLAY nor WAYLAND_DISPLAY is set"


def frame_times(backend: str) -> dict[str, float] | None:
    """Returns times of a frame of an LWR at 1280x800, s, by quality; None if none can be drawn."""
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
    said = ", ".join(f"{name} {time * 1e3:.3g} ms" for name, time in times.items())
    text = f"a frame of an LWR with {backend}, 1280x800: {said}"
    if times["normal"] <= _SMOOTH:
        return f"{text}; fast enough for all that is shown live"
    return (
        f"{text}\n  slow for what is live: windows leave out shadows and smooth edges while the "
        "view\n  moves; --quality draft makes films quickly"
    )


def try_backend(name: str) -> dict[str, Any]:
    """Renders in another process, with the given backend."""
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
