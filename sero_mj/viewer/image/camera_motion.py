"""Cameras that move in films: turntables, and paths through key frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from pydantic import Field

from ...base.declaration import Declaration, Point
from ...base.errors import DeclarationError, Problem, problems_of
from ...base.frames import Array
from ...base.toml_file import located, read_toml

# Moves a free camera to where it is at a time of the film, s.
CameraMotion = Callable[[mujoco.MjvCamera, float], None]

_EXPECTED = "tables [[keys]] with time and azimuth_deg, elevation_deg, distance or look_at"
_MOST_KEYS = 10_000


class CameraKey(Declaration):
    """Where a camera is at a time of a film; what is not given is as of the keys around it.

    What no key gives stays as it is in the view.

    Attributes:
        time: s since the film began.
        azimuth_deg: viewing direction about the vertical, 90 looks along +y.
        elevation_deg: negative looks down.
        distance: m from the look-at point.
        look_at: the point at the picture's centre, m.
    """

    time: float = Field(ge=0)
    azimuth_deg: float | None = None
    elevation_deg: float | None = Field(None, ge=-90, le=90)
    distance: float | None = Field(None, gt=0)
    look_at: Point | None = None


class CameraPath:
    """A smooth way of a camera through keys; it begins and ends at rest.

    Before the first key it is at the first, behind the last one at the last. From key to key it
    turns by at most 180 degrees, the shorter way.

    Args:
        keys: in the order of their times.

    Raises:
        DeclarationError: there is no key, or their times do not increase.
    """

    def __init__(self, keys: Sequence[CameraKey]) -> None:
        if not keys:
            raise Problem("keys", "is empty", expected=_EXPECTED).error()
        wrong = [
            Problem(f"keys.{i + 1}.time", found=b.time, expected=f"more than {a.time:g} s, before")
            for i, (a, b) in enumerate(pairwise(keys))
            if b.time <= a.time
        ]
        if wrong:
            raise DeclarationError(wrong)
        self._ways: dict[str, tuple[Array, Array]] = {}
        for field in ("azimuth_deg", "elevation_deg", "distance", "look_at"):
            given = [key for key in keys if getattr(key, field) is not None]
            if given:
                values = np.array([getattr(key, field) for key in given], float)
                if field == "azimuth_deg":
                    values = np.unwrap(values, period=360.0)
                self._ways[field] = np.array([key.time for key in given]), values
        self.has_look_at = "look_at" in self._ways

    def __call__(self, camera: mujoco.MjvCamera, time: float) -> None:
        """Moves a free camera to where it is at a time of the film, s."""
        for field, (times, values) in self._ways.items():
            found = monotone_cubic(times, values, time)
            setattr(camera, field.removesuffix("_deg").replace("look_at", "lookat"), found)


def read_camera_path(path: Path) -> CameraPath:
    """Reads the keys of a camera path: `[[keys]]` with the fields of `CameraKey`.

    Raises:
        DeclarationError: all errors of the file, with their lines.
    """
    tables = read_toml(path)
    problems = [
        Problem(key, "unknown section", available=["keys"]) for key in tables if key != "keys"
    ]
    rows: Any = tables.get("keys")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows) or not rows:
        if not problems:
            problems.append(Problem("keys", "is required", expected=_EXPECTED))
        raise DeclarationError(located(problems, path))
    if len(rows) > _MOST_KEYS:
        found = Problem("keys", found=len(rows), of="keys", expected=f"at most {_MOST_KEYS}")
        raise DeclarationError(located([found], path))
    keys = []
    for i, row in enumerate(rows):
        try:
            keys.append(CameraKey(**row))
        except DeclarationError as error:
            problems += problems_of(error, f"keys.{i}")
    if problems:
        raise DeclarationError(located(problems, path))
    try:
        return CameraPath(keys)
    except DeclarationError as error:
        raise DeclarationError(located(error.problems, path)) from None


def orbit(camera: mujoco.MjvCamera, degrees: float, duration: float) -> CameraMotion:
    """Returns a motion about the look-at point, at constant speed, from where a camera is now.

    Args:
        degrees: by which its azimuth increases; less than 0 for the other way round.
        duration: s, after which it has turned by them.
    """
    start = float(camera.azimuth)

    def move(moved: mujoco.MjvCamera, time: float) -> None:
        moved.azimuth = start + degrees * time / duration

    return move


def monotone_cubic(times: Array, values: Array, at: float) -> Array:
    """Interpolates by cubic polynomials that do not overshoot, with slopes of 0 at both ends.

    Args:
        at: a time; before the first it is the first value, behind the last one the last.

    Source: Fritsch and Butland, "A method for constructing local monotone piecewise cubic
    interpolants", SIAM J. Sci. Stat. Comput. 5(2), 1984.
    """
    if len(times) == 1 or at <= times[0]:
        return np.asarray(values[0])
    if at >= times[-1]:
        return np.asarray(values[-1])
    step = np.diff(times).reshape(-1, *[1] * (values.ndim - 1))
    rise = np.diff(values, axis=0) / step
    slopes = np.zeros_like(values)
    before, after = rise[:-1], rise[1:]
    w_before, w_after = 2 * step[1:] + step[:-1], step[1:] + 2 * step[:-1]
    goes_on = before * after > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w_before + w_after) / (w_before / before + w_after / after)
    slopes[1:-1] = np.where(goes_on, mean, 0.0)
    i = int(np.searchsorted(times, at, side="right")) - 1
    width = times[i + 1] - times[i]
    s = (at - times[i]) / width
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * values[i]
        + s * (1 - s) ** 2 * width * slopes[i]
        + s**2 * (3 - 2 * s) * values[i + 1]
        + s**2 * (s - 1) * width * slopes[i + 1]
    )
