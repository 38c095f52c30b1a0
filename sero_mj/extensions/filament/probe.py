"""Checks whether the Filament renderer works on this machine, and stores the result.

Filament ends the process if the Vulkan loader or a driver is missing, or if an image is too large
for the driver. Therefore, a separate process renders a test image first.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import logging
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

from platformdirs import user_cache_path

from ...viewer.image.backend import library_files

log = logging.getLogger(__name__)

# Debian and Ubuntu packages of the Vulkan loader and of drivers, including a software driver.
PACKAGES = "libvulkan1 mesa-vulkan-drivers"
ALWAYS = 4096  # image side that all Vulkan 1.0 drivers support, pixels
_TRIAL_SIDE = 64  # side of the test image, pixels
_TIMEOUT = 120.0  # maximum time in s for the test image, for which the driver compiles its shaders
_DRIVERS = tuple(
    Path(folder) / "vulkan" / "icd.d" for folder in ("/usr/share", "/usr/local/share", "/etc")
)
# Environment variables that select a driver.
_CHOICES = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_LOADER_DRIVERS_SELECT", "LD_LIBRARY_PATH")


def filament_problem(width: int = _TRIAL_SIDE, height: int = _TRIAL_SIDE) -> str | None:
    """Returns why Filament cannot render images of a size in pixels, or None if it can.

    The first call takes seconds. Later calls read the result from the cache folder of the user,
    until MuJoCo, the Vulkan loader or a driver changes.
    """
    if max(width, height) <= ALWAYS:
        width = height = _TRIAL_SIDE
    return _problem(_digest(width, height), width, height)


@cache
def _problem(digest: str, width: int, height: int) -> str | None:
    known = _read()
    if digest not in known:
        problem = _try(width, height)
        if problem is not None and "no answer" in problem:  # the machine may be busy
            return problem
        known[digest] = problem
        _write(known)
    return known[digest]


def _digest(width: int, height: int) -> str:
    files = [Path(path) for path in library_files("libvulkan")]
    listed = [file for folder in _DRIVERS if folder.is_dir() for file in sorted(folder.iterdir())]
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        listed += [Path(path) for path in os.environ.get(name, "").split(os.pathsep) if path]
    about: list[Any] = [importlib.metadata.version("mujoco"), sys.version, width, height]
    about += [os.environ.get(name) for name in _CHOICES]
    for file in [*files, *listed, *(lib for each in listed for lib in _library_of(each))]:
        about.append([str(file), file.stat().st_mtime_ns if file.exists() else None])
    return hashlib.sha256(json.dumps(about).encode()).hexdigest()[:24]


def _library_of(driver: Path) -> list[Path]:
    try:
        return [Path(json.loads(driver.read_bytes())["ICD"]["library_path"])]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _try(width: int, height: int) -> str | None:
    code = f"from {__name__} import draw_trial; draw_trial({width}, {height})"
    try:
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True, text=True, errors="replace", timeout=_TIMEOUT, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return f"no answer within {_TIMEOUT:g} s"
    if done.returncode == 0:
        return None
    return reason_of(done.stderr, done.returncode)


def reason_of(stderr: str, status: int) -> str:
    """Returns in one line why the test process failed, from its error output and exit status."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    found = [line.partition("reason:")[2].strip() for line in lines if "reason:" in line]
    found = found or [line for line in lines if re.match(r"[\w.]*(Error|Exception)\b", line)]
    reason = (found or lines or [""])[-1][:160]
    if "Vulkan instance" in reason or "libvulkan" in reason or "Vulkan device" in reason:
        reason = f"no Vulkan driver ({reason.rstrip('.')})"
    return reason or f"the test process ended with status {status}"


def draw_trial(width: int, height: int) -> None:
    """Renders a test image of a red sphere. If Filament cannot render it, this process ends.

    Raises:
        RenderError: this version of MuJoCo has no Filament renderer, or the image is empty.
    """
    import mujoco

    from ...base.errors import RenderError
    from .renderer import FilamentRenderer

    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><geom size='.2' rgba='1 0 0 1'/></worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = FilamentRenderer(model, width, height)
    mujoco.mjv_updateScene(
        model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(),
        int(mujoco.mjtCatBit.mjCAT_ALL), renderer.scene,
    )  # fmt: skip
    pixels = renderer.render()
    if int(pixels[..., 0].max()) - int(pixels[..., 2].min()) < 40:
        raise RenderError("the rendered image is empty")
    renderer.close()


def _file() -> Path:
    return user_cache_path("sero-mj", appauthor=False) / "filament.json"


def _read() -> dict[str, str | None]:
    try:
        known = json.loads(_file().read_bytes())
    except (OSError, ValueError):
        return {}
    return known if isinstance(known, dict) else {}


def _write(known: dict[str, str | None]) -> None:
    file = _file()
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        temporary = file.with_suffix(f".{os.getpid()}")
        temporary.write_text(json.dumps(known, indent=1), encoding="utf-8")
        temporary.replace(file)
    except OSError as error:  # the test is repeated in the next process
        log.debug("%s: %s", file, error)
