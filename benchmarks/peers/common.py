"""What every peer's script shares: what it is given, how it measures, how it tells.

A script runs as `python SCRIPT FOLDER WORK`, in an environment of its own, where sero-mj is not
installed. It prints one line of JSON for every work: what took how many seconds, which version, and
where there is one the result, so that who calls can see that all did the same.

FOLDER has robot7.urdf, robot51.urdf and poses7.npy, poses51.npy, (1000, n), rad.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

RATE, SHOW_SECONDS = 100.0, 4.0  # calls/s of a loop that shows a robot, and for how long
STIFFNESS, DAMPING = 1000.0, 50.0  # Nm/rad, Nms/rad


def folder() -> Path:
    """Where the robots are."""
    return Path(sys.argv[1])


def urdf(joints: int) -> str:
    """The file of the robot with so many joints."""
    return str(folder() / f"robot{joints}.urdf")


def poses(joints: int) -> np.ndarray:
    """(1000, n), rad."""
    return np.load(folder() / f"poses{joints}.npy")


def best(call: Callable[[], object], calls: int = 200, chunks: int = 60) -> float:
    """Seconds of one call, in the fastest of many chunks."""
    times = []
    for _ in range(chunks):
        begin = time.perf_counter()
        for _ in range(calls):
            call()
        times.append((time.perf_counter() - begin) / calls)
    return min(times)


def tell(package: str, seconds: float, result: Any = None, **more: Any) -> None:
    """Prints what was measured."""
    found = {"package": package, "version": version(package), "seconds": seconds, **more}
    if result is not None:
        found["result"] = np.asarray(result, float).ravel().tolist()
    print(json.dumps(found), flush=True)


def open_page(url: str, until: str = "") -> None:
    """Lets who called open a page, and waits until it is there, and a function of it is true."""
    print(json.dumps({"url": url, "until": until}), flush=True)
    sys.stdin.readline()


def measure_shown(
    package: str, joints: int, show: Callable[[np.ndarray, np.ndarray], object]
) -> None:
    """Tells what a call of `show` with angles (rad) and torques (Nm) costs a loop at 100 Hz."""
    took, begin = [], time.perf_counter()
    due = begin
    while time.perf_counter() < begin + SHOW_SECONDS:
        due = max(due + 1.0 / RATE, time.perf_counter())  # a slow one is not hurried on
        time.sleep(max(due - time.perf_counter(), 0.0))
        now = time.perf_counter() - begin
        angles = 0.5 * np.sin(now + np.arange(joints))
        torques = 30.0 * np.cos(now + np.arange(joints))
        start = time.perf_counter()
        show(angles, torques)
        took.append(time.perf_counter() - start)
    p50, p99 = np.percentile(took[len(took) // 10 :], [50, 99])
    tell(package, float(p50), slow=float(p99))


def tell_picture(package: str, pixels: np.ndarray) -> None:
    """Tells that a picture, (h, w, 3 or more), is there now.

    Raises:
        ValueError: it is of one colour.
    """
    at = time.time()
    if np.ptp(np.asarray(pixels)[..., :3]) < 20:
        raise ValueError("found a picture of one colour; expected a robot in it")
    tell(package, 0.0, at=at)


def main(works: dict[str, Callable[[], None]]) -> None:
    """Does the work that was asked for."""
    works[sys.argv[2]]()
