"""Camera motion in videos: turntables, and paths through key frames."""

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

# Function that moves a free camera to its pose at a time of the video in seconds.
CameraMotion = Callable[[mujoco.MjvCamera, float], None]

_EXPECTED = "tables [[keys]] with time and with azimuth_deg, elevation_deg, distance or look_at"
_MAX_KEYS = 10_000


class CameraKey(Declaration):
    """A key frame: the pose of the camera at one time of a video.

    Missing values are interpolated between other keys. Values that no key declares are those of the
    view.

    Attributes:
        time: time since the start of the video, s.
        azimuth_deg: viewing direction about the vertical axis; 90 is the direction of +y.
        elevation_deg: viewing direction above the horizontal plane; negative values look down.
        distance: distance from the look-at point, m.
        look_at: point at the center of the image, m.
    """

    time: float = Field(ge=0)
    azimuth_deg: float | None = None
    elevation_deg: float | None = Field(None, ge=-90, le=90)
    distance: float | None = Field(None, gt=0)
    look_at: Point | None = None


class CameraPath:
    """A smooth camera path through key frames, which starts and ends at rest.

    Before the first key, the camera has the pose of the first key. After the last key, it has the
    pose of the last key. Between two keys, it rotates by at most 180 degrees.

    Raises:
        DeclarationError: there is no key, or the times of the keys do not increase.
    """

    def __init__(self, keys: Sequence[CameraKey]) -> None:
        if not keys:
            raise Problem("keys", "is empty", expected=_EXPECTED).error()
        wrong = [
            Problem(f"keys.{i + 1}.time", found=b.time, expected=f"more than {a.time:g} s")
            for i, (a, b) in enumerate(pairwise(keys))
            if b.time <= a.time
        ]
        if wrong:
            raise DeclarationError(wrong)
        self._fields: dict[str, tuple[Array, Array]] = {}  # times and values
        for field in ("azimuth_deg", "elevation_deg", "distance", "look_at"):
            own = [key for key in keys if getattr(key, field) is not None]
            if own:
                values = np.array([getattr(key, field) for key in own], float)
                if field == "azimuth_deg":
                    values = np.unwrap(values, period=360.0)
                self._fields[field] = np.array([key.time for key in own]), values
        self.has_look_at = "look_at" in self._fields

    def __call__(self, camera: mujoco.MjvCamera, time: float) -> None:
        """Moves a free camera to its pose at a time of the video in seconds."""
        for field, (times, values) in self._fields.items():
            found = monotone_cubic(times, values, time)
            setattr(camera, field.removesuffix("_deg").replace("look_at", "lookat"), found)


def read_camera_path(path: Path) -> CameraPath:
    """Reads a camera path from the tables `[[keys]]` (`CameraKey`) of a TOML file.

    Raises:
        DeclarationError: the file is invalid. The error lists all problems with their lines.
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
    if len(rows) > _MAX_KEYS:
        found = Problem("keys", found=len(rows), of="keys", expected=f"at most {_MAX_KEYS}")
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
    """Returns a camera motion that rotates about the look-at point at constant speed.

    Args:
        camera: camera in its initial pose.
        degrees: increase of the azimuth over the video; negative for the other direction.
        duration: duration of the video, s.
    """
    start = float(camera.azimuth)

    def move(moved: mujoco.MjvCamera, time: float) -> None:
        moved.azimuth = start + degrees * time / duration

    return move


def monotone_cubic(times: Array, values: Array, at: float) -> Array:
    """Interpolates values with cubic polynomials that do not overshoot.

    The slope is 0 at the first and at the last time. Outside of `times`, this returns the first or
    last value. Source: Fritsch and Butland, "A method for constructing local monotone piecewise
    cubic interpolants", SIAM J. Sci. Stat. Comput. 5(2), 1984.
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
    is_monotone = before * after > 0
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w_before + w_after) / (w_before / before + w_after / after)
    slopes[1:-1] = np.where(is_monotone, mean, 0.0)
    i = int(np.searchsorted(times, at, side="right")) - 1
    width = times[i + 1] - times[i]
    s = (at - times[i]) / width
    return np.asarray(
        (1 + 2 * s) * (1 - s) ** 2 * values[i]
        + s * (1 - s) ** 2 * width * slopes[i]
        + s**2 * (3 - 2 * s) * values[i + 1]
        + s**2 * (s - 1) * width * slopes[i + 1]
    )
