"""Computes the pose of a camera from points of the robot with known pixels (PnP with OpenCV).

A point is described by a frame of the scene (`lwr/flange`) or a joint (`lwr/A3`, the middle of its
axis), and an offset along the axes of the frame.
"""

from __future__ import annotations

import csv
import io
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...base.declaration import numbers
from ...base.errors import DeclarationError, Problem, UsageError, mismatch, problems_of, reason_of
from ...base.frames import Array, Bools, frame, inverse
from ...base.paths import open_file
from ...base.toml_file import key_lines, located, read_toml
from ...robots.assemble.world_view import WorldView
from .photo_camera import PhotoCamera, opencv

_MIN_POINTS, _MIN_WITH_FOCAL = 4, 6
_FLATNESS = 1e-3  # maximum deviation of coplanar or collinear points, fraction of their extent
_AMBIGUOUS = 1.5  # another camera pose also fits up to this multiple of the smallest error
_CLICK_ERROR = 3.0  # maximum error of a careful click, pixels
_MAX_SUBSETS = 1000
_MAX_MEAN_ERROR = 0.05  # maximum mean error of a valid camera, fraction of the image width
_NO_CAMERA = Problem(
    "",
    "no camera fits the points",
    expected="the pose of the robot in the photo, and the correct names of points",
)
_FOCAL = (0.3, 6.0)  # range of the focal length, fractions of the larger image side
_SAME_POINT = 2e-3  # distance below which two points are the same, m
_LINK = re.compile(r"link\d+")
_COLUMNS = ("point", "x", "y")
_OFFSETS = ("dx", "dy", "dz")


@dataclass(frozen=True, eq=False)
class ClickedPoint:
    """A point of the robot and its pixel in a photo.

    Attributes:
        pixel: coordinates to the right and down from the center of the upper left pixel, shape
            (2,), pixels.
        offset: offset from the frame or joint along the axes of the frame, shape (3,), m.
        place: file and line that declare the point.
    """

    name: str
    pixel: Array
    offset: Array
    place: str = ""


@dataclass(frozen=True, eq=False)
class Calibration:
    """The result of a calibration.

    Attributes:
        errors: reprojection errors of all points, shape (k, 2), pixels.
        used: mask of the points that were used, shape (k,). All other points are outliers.
        position_error: standard error of the camera position, shape (3,), m.
        focal_error: standard error of the focal length, pixels; 0 if the focal length was known.
    """

    camera: PhotoCamera
    errors: Array
    used: Bools
    position_error: Array
    focal_error: float = 0.0

    @property
    def rms(self) -> float:
        """Root mean square reprojection error of the used points, pixels."""
        return _rms(self.errors[self.used])


def point_names(world: WorldView) -> list[str]:
    """Returns the names of all frames and joints that can be used as points."""
    return [*world.frames.names, *_joints(world)]


def _joints(world: WorldView) -> dict[str, int]:
    found: dict[str, int] = {}
    for name, part in world.owners.items():
        if name in world.robots:
            joints = range(part.joints.start, part.joints.stop)
            found |= {f"{name}/{world.joints.names[k]}": k for k in joints}
    return found


def points_apart(world: WorldView, data: mujoco.MjData) -> list[str]:
    """Returns the names of all points at different places, from base to flange of each robot.

    If several frames or joints coincide, only one of them is included.
    """
    ends = [name for name in world.frames.names if not _LINK.fullmatch(name.partition("/")[2])]
    found: dict[str, Array] = {}
    for name in [*ends, *_joints(world), *world.frames.names]:
        point = point_of(world, data, name, np.zeros(3))
        if all(np.linalg.norm(point - other) > _SAME_POINT for other in found.values()):
            found[name] = point
    joints, robots = _joints(world), list(world.owners)

    def along(name: str) -> tuple[int, int]:
        robot, _, point = name.partition("/")
        return (
            robots.index(robot) if robot in robots else len(robots),
            1 if name in joints else 0 if point == "base" else 2,
        )

    return sorted(found, key=along)


def write_points(path: Path, points: Sequence[ClickedPoint]) -> None:
    """Writes points to a .csv file, which `read_points` can read.

    Raises:
        UsageError: the file cannot be written.
    """
    rows = [
        f"{point.name},{point.pixel[0]:.2f},{point.pixel[1]:.2f},"
        + ",".join(map(str, point.offset))
        for point in points
    ]
    try:
        path.write_text("\n".join([",".join((*_COLUMNS, *_OFFSETS)), *rows, ""]), "utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def full_name(world: WorldView, name: str) -> str:
    """Returns the full name of a point, whose robot may be omitted if the name is unambiguous.

    Raises:
        ValueError: no point has this name, or points of several robots have it.
    """
    names = point_names(world)
    if name in names:
        return name
    ends = [each for each in names if each.partition("/")[2] == name]
    if len(ends) == 1:
        return ends[0]
    if ends:
        raise mismatch(name, f"one of {', '.join(ends)}")
    short = [each.partition("/")[2] for each in names] if "/" not in name else []
    raise Problem("", "no frame or joint", found=name, available=short or names).error()


def point_of(world: WorldView, data: mujoco.MjData, name: str, offset: Array) -> Array:
    """Returns the world position (3,), m, of a point with an offset (3,), m, in its frame."""
    joints = _joints(world)
    if name not in joints:
        T = world.frame(data, name)
    else:
        state, site = world.state(data), world.joints.centre_site[joints[name]]
        T = frame(state.site_xmat[site].reshape(3, 3), state.site_xpos[site])
    return np.asarray(T[:3, :3] @ offset + T[:3, 3])


def read_points(path: Path, world: WorldView, size: tuple[int, int]) -> list[ClickedPoint]:
    """Reads points from a .csv or .toml file.

    A .csv file has the columns `point,x,y` and optionally `dx,dy,dz`. A .toml file has tables
    `[[points]]` with `point`, `pixel = [x, y]` and `offset = [dx, dy, dz]`.

    Raises:
        DeclarationError: the file is invalid. The exception lists all errors.
    """
    problems: list[Problem] = []
    if path.suffix.lower() == ".toml":
        rows = _toml_rows(path, problems)
    elif path.suffix.lower() == ".csv":
        rows = _csv_rows(path, problems)
    else:
        message = "expected a .csv or .toml file of points"
        raise Problem("", message, str(path)).error()
    points = []
    for row in rows:
        key, line = row["key"], row["line"]
        try:
            name = full_name(world, row["point"])
            pixel, offset = numbers(row["pixel"]).ravel(), numbers(row["offset"]).ravel()
            if pixel.size != 2 or offset.size != 3:
                raise ValueError("expected pixel = [x, y], and offset = [dx, dy, dz] in m")
            if (pixel < -0.5).any() or (pixel > np.array(size) - 0.5).any():
                at = ", ".join(f"{value:g}" for value in pixel)
                raise ValueError(
                    f"pixel {at} is outside the photo, which has {size[0]}x{size[1]} pixels"
                )
        except ValueError as error:
            wrong = problems_of(error, key)
            problems += [replace(each, file=str(path), line=line) for each in wrong]
            continue
        points.append(ClickedPoint(name, pixel, offset, f"{path}:{line}"))
    if problems:
        raise DeclarationError(problems)
    return points


def _toml_rows(path: Path, problems: list[Problem]) -> list[dict[str, Any]]:
    table, lines = read_toml(path), key_lines(path)
    known = ("point", "pixel", "offset")
    found = table.get("points")
    if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
        message = 'is required: tables [[points]] with point = "lwr/flange" and pixel = [x, y]'
        raise Problem("points", message, str(path)).error()
    rows = []
    for index, row in enumerate(found):
        key = f"points.{index}"
        wrong = [Problem(f"{key}.{name}", "unknown key", available=known)
                 for name in row if name not in known]  # fmt: skip
        wrong += [Problem(f"{key}.{name}", "is required") for name in known[:2] if name not in row]
        if not wrong and not isinstance(row["point"], str):
            wrong = [Problem(f"{key}.point", found=row["point"], expected="the name of a point")]
        problems += located(wrong, path, lines)
        if not wrong:
            rows.append({"offset": [0, 0, 0], **row, "key": key, "line": lines.get(key)})
    return rows


def _csv_rows(path: Path, problems: list[Problem]) -> list[dict[str, Any]]:
    try:
        with open_file(path) as file:
            text = io.TextIOWrapper(file, encoding="utf-8-sig", newline="")
            reader = csv.DictReader(text, skipinitialspace=True)
            header = [name.strip() for name in reader.fieldnames or []]
            reader.fieldnames = header
            lines = [(reader.line_num, row) for row in reader]
    except FileNotFoundError:
        raise Problem("", "no such file", str(path)).error() from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        message = f"cannot be read: {reason_of(error)}"
        raise Problem("", message, str(path)).error() from error
    if not set(_COLUMNS) <= set(header) <= {*_COLUMNS, *_OFFSETS}:
        message = f"found columns {', '.join(header)}; expected point,x,y and optionally dx,dy,dz"
        raise Problem("", message, str(path), 1).error()
    rows = []
    for line, row in lines:
        try:
            pixel = [float(row[name]) for name in ("x", "y")]
            offset = [float(row.get(name) or 0.0) for name in _OFFSETS]
        except (TypeError, ValueError):
            found = ",".join(str(value) for value in row.values() if value is not None)
            expected = "the name of a point and its pixel"
            problems.append(Problem(found=found, expected=expected, file=str(path), line=line))
            continue
        rows.append({"point": str(row["point"]).strip(), "pixel": pixel, "offset": offset,
                     "key": "", "line": line})  # fmt: skip
    return rows


def calibrate(
    names: Sequence[str], points: Array, pixels: Array, camera: PhotoCamera, *, find_focal: bool
) -> Calibration:
    """Computes the pose of a camera from points with known pixels.

    Args:
        points: world positions of the points, shape (k, 3), m.
        camera: camera with known lens parameters. Its pose is ignored.
        find_focal: whether the focal length, which is equal for x and y, is computed, too.

    Raises:
        UsageError: there are too few points, the points are collinear, coplanar points fit two
            poses of the camera, or no pose fits.
    """
    required = _MIN_WITH_FOCAL if find_focal else _MIN_POINTS
    if len(points) < required:
        what = "pose and focal length of the camera need" if find_focal else "the camera pose needs"
        more = ", or --camera-file with intrinsics and 4 points" if find_focal else ""
        raise UsageError(f"found {len(points)} points; {what} {required} or more{more}")
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < _FLATNESS * spread[0]:
        raise UsageError(
            "the points are on one line, about which the camera could rotate; add other points"
        )
    is_flat = bool(spread[2] < _FLATNESS * spread[0])
    if is_flat and find_focal:
        raise UsageError(
            "the points are in one plane, whose distance is unknown without the focal length; add "
            "a point outside the plane, or use --camera-file with the intrinsics of the camera"
        )
    used = np.ones(len(points), bool)
    solver = _Solver(camera, find_focal=find_focal)
    if len(points) > required + 1:
        used = solver.without_outliers(points, pixels, required)
    found = solver.solve(points[used], pixels[used])
    if is_flat:
        _check_ambiguity(found, points[used], pixels[used])
    if not _rms(found.project(points[used])[0] - pixels[used]) < _MAX_MEAN_ERROR * found.width:
        raise UsageError(_NO_CAMERA)
    projected, depth = found.project(points)
    for name, distance in zip(names, depth, strict=True):
        if distance <= 0:
            expected = "points in the photo, with their correct names"
            raise UsageError(Problem("", f"{name} would be behind the camera", expected=expected))
    errors = projected - pixels
    position_error, focal_error = solver.standard_errors(found, points[used], errors[used])
    return Calibration(found, errors, used, position_error, focal_error)


def _rms(errors: Array) -> float:
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def _check_ambiguity(found: PhotoCamera, points: Array, pixels: Array) -> None:
    cv2 = opencv()
    rays = found.undistort(pixels)[:, None]
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
    )
    fits = sorted(
        _rms(_placed(found, turn, shift).project(points)[0] - pixels)
        for turn, shift in zip(turns, shifts, strict=True)
    )
    best = max(_rms(found.project(points)[0] - pixels), 0.5)
    if len(fits) > 1 and fits[1] < _AMBIGUOUS * best:
        raise UsageError(
            f"the points are in one plane, and two cameras fit with errors of {fits[0]:.1f} and "
            f"{fits[1]:.1f} pixels; add a point outside the plane, for example the flange"
        )


def _placed(camera: PhotoCamera, turn: Array, shift: Array) -> PhotoCamera:
    rotation = opencv().Rodrigues(np.asarray(turn, float))[0]
    T_camera_world = frame(rotation, np.asarray(shift, float).ravel())
    return replace(camera, T_world_camera=inverse(T_camera_world))


class _Solver:
    def __init__(self, camera: PhotoCamera, *, find_focal: bool) -> None:
        self._camera = camera
        self._find_focal = find_focal

    def solve(self, points: Array, pixels: Array) -> PhotoCamera:
        if not self._find_focal:
            return self._pose(self._camera, points, pixels)
        low, high = np.log(np.array(_FOCAL) * max(self._camera.width, self._camera.height))
        grid = np.linspace(low, high, 25)
        best = int(np.argmin([self._misfit(value, points, pixels) for value in grid]))
        low, high = grid[max(best - 1, 0)], grid[min(best + 1, len(grid) - 1)]
        golden = (np.sqrt(5.0) - 1.0) / 2.0
        while high - low > 1e-6:
            a, b = high - golden * (high - low), low + golden * (high - low)
            if self._misfit(a, points, pixels) < self._misfit(b, points, pixels):
                high = b
            else:
                low = a
        return self._pose(self._of_focal((low + high) / 2), points, pixels)

    def _of_focal(self, log_focal: float) -> PhotoCamera:
        matrix = self._camera.matrix.copy()
        matrix[0, 0] = matrix[1, 1] = np.exp(log_focal)
        return replace(self._camera, matrix=matrix)

    def _misfit(self, log_focal: float, points: Array, pixels: Array) -> float:
        found = self._pose(self._of_focal(log_focal), points, pixels)
        return _rms(found.project(points)[0] - pixels)

    @staticmethod
    def _pose(camera: PhotoCamera, points: Array, pixels: Array) -> PhotoCamera:
        cv2 = opencv()
        # `plain` contains pixels without distortion, relative to the image center.
        K = camera.matrix
        plain = camera.undistort(pixels) * (K[0, 0], K[1, 1])
        diagonal = np.diag([K[0, 0], K[1, 1], 1.0])
        try:
            done, turn, shift = cv2.solvePnP(
                points, plain[:, None], diagonal, None, flags=cv2.SOLVEPNP_SQPNP
            )
            if done:
                turn, shift = cv2.solvePnPRefineLM(
                    points, plain[:, None], diagonal, None, turn, shift
                )
        except cv2.error:  # for example if pixels are identical
            done = False
        if not done or not np.isfinite([turn, shift]).all():
            raise UsageError(_NO_CAMERA)
        return _placed(camera, turn, shift)

    def without_outliers(self, points: Array, pixels: Array, required: int) -> Bools:
        # This is the least median of squares over subsets of points. Source: Rousseeuw and Leroy,
        # Robust Regression and Outlier Detection, 1987.
        count = len(points)
        subsets = list(itertools.combinations(range(count), required))
        if len(subsets) > _MAX_SUBSETS:
            rng = np.random.default_rng(0)
            subsets = [subsets[k] for k in rng.choice(len(subsets), _MAX_SUBSETS, replace=False)]
        if self._find_focal:  # each subset takes longer
            subsets = subsets[:: max(len(subsets) // 30, 1)]
        best, distances = np.inf, np.zeros(count)
        for subset in map(list, subsets):
            spread = np.linalg.svd(points[subset] - points[subset].mean(axis=0), compute_uv=False)
            if spread[1] < 0.02 * spread[0]:
                continue
            try:
                found = self.solve(points[subset], pixels[subset])
            except UsageError:
                continue
            projected, depth = found.project(points)
            errors = np.where(depth > 0, np.linalg.norm(projected - pixels, axis=1), np.inf)
            median = float(np.sort(errors)[(count + required) // 2])
            if median < best:
                best, distances = median, errors
        limit = max(2.5 * 1.4826 * (1 + 5 / max(count - required, 1)) * best, _CLICK_ERROR)
        used = distances <= limit if np.isfinite(best) else np.ones(count, bool)
        if used.sum() < required:
            return np.ones(count, bool)
        # A camera that is fitted to all inliers is more accurate than one fitted to a subset.
        found = self.solve(points[used], pixels[used])
        errors = np.linalg.norm(found.project(points)[0] - pixels, axis=1)
        return np.asarray(errors <= max(limit, 3.0 * _rms((errors[used])[:, None])))

    def standard_errors(
        self, found: PhotoCamera, points: Array, errors: Array
    ) -> tuple[Array, float]:
        def moved(step: Array) -> Array:
            turn = opencv().Rodrigues(step[:3])[0]
            T = found.T_world_camera @ frame(turn)
            T[:3, 3] += step[3:6]
            matrix = found.matrix.copy()
            matrix[[0, 1], [0, 1]] += step[6]
            return replace(found, T_world_camera=T, matrix=matrix).project(points)[0].ravel()

        count = 7 if self._find_focal else 6
        steps = np.eye(7)[:count] * np.array([1e-5] * 6 + [1e-2])
        J = np.stack([(moved(s) - moved(-s)) / (2 * s.sum()) for s in steps], axis=1)
        free = max(J.shape[0] - count, 1)
        variance = max(float((errors**2).sum()) / free, 0.25**2)  # clicks have errors of 1/4 pixel
        covariance = np.linalg.pinv(J.T @ J) * variance
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
        return deviation[3:6], float(deviation[6]) if self._find_focal else 0.0
