"""Estimates the time of a recording at which a video of the robot starts.

Pixels of the video change if the outline of the robot passes over them between two frames. The area
that the outline sweeps is computed from the recording with the known camera, at the frame rate of
the video, on a coarse grid of cells. The changes of the video are computed on the same grid. Swept
area and changes are correlated over time for each cell and for all offsets, so that similar motions
at different places are distinguished.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.errors import Problem, UsageError
from ...base.frames import Array
from ...data.drive.mirror import Mirror
from ...robots.assemble.world import World
from ...robots.declared.scene import Scene
from .footage import Video, at_rate
from .over import refuse_live
from .photo_camera import PhotoCamera, opencv

_WIDTH = 192  # width of images of outlines, pixels
_CELL = 6  # side of a cell, pixels
_POINTS = 80  # number of points that approximate a mesh
_NOISE, _FULL_CHANGE = 4.0, 40.0  # gray levels of noise, and of a full change
_MIN_OVERLAP = 1.5  # minimum overlap of video and recording, s
_PEAK_DISTANCE = 0.4  # minimum distance of separate peaks, s
_MIN_CORRELATION = 0.15
_KEY = "--offset auto"  # option that error messages name
_PEAK_RATIO = 1.25  # minimum ratio of the best peak to any other peak
_MAX_DURATION = 3600.0  # maximum duration of a recording, s
_HIDDEN_GROUP = 3  # first hidden group of geoms
_CHUNK = 64  # number of cells per Fourier transform

Cells = NDArray[np.float32]


@dataclass(frozen=True)
class FoundOffset:
    """The estimated offset of a video in a recording.

    Attributes:
        offset: time of the recording at the first frame of the video, s.
        correlation: correlation of the motion in video and recording at this offset, up to 1.
        other: highest correlation at any other offset.
    """

    offset: float
    correlation: float
    other: float

    def __str__(self) -> str:
        return (
            f"offset {self.offset:.3f} s: correlation of video and recording "
            f"{self.correlation:.2f}, at other offsets at most {self.other:.2f}"
        )


def find_offset(scene: Scene, path: Path, camera: PhotoCamera) -> FoundOffset:
    """Estimates the time of the recording or scenario of a scene at which a video starts.

    Raises:
        UsageError: the video or the recording has no motion, they do not match, or they match at
            several offsets.
        SeroError: the scene, its sources or the video is invalid.
    """
    mirror = Mirror(scene)
    refuse_live(mirror, path)
    with Video(path) as video, mirror:
        fps = min(video.fps, 60.0)
        end = max((source.end or 0.0 for source in mirror.sources.values()), default=0.0)
        if not end:
            raise UsageError("--offset auto needs a recording or a scenario that ends")
        if end > _MAX_DURATION:
            raise UsageError(
                f"--offset auto is limited to {_MAX_DURATION / 60:.0f} minutes, but the recording "
                f"lasts {end / 60:.0f} minutes; use --offset S"
            )
        small = _small(camera)
        swept = _swept(mirror, small, fps, end)
        changed = _changed(video, small, fps)
    return match(swept, changed, fps)


def _small(camera: PhotoCamera) -> PhotoCamera:
    height = max(round(_WIDTH * camera.height / camera.width / _CELL), 1) * _CELL
    return camera.resized(_WIDTH, height)


def _swept(mirror: Mirror, camera: PhotoCamera, fps: float, end: float) -> Cells:
    cv2 = opencv()
    outlines = _Outlines(mirror.world)
    found: list[NDArray[np.float32]] = []
    last: NDArray[np.uint8] | None = None
    for k in range(int(end * fps) + 1):
        mirror.advance(k / fps)
        now = outlines.draw(mirror.data, camera)
        if last is not None:
            found.append(_cells(cv2.absdiff(now, last)))
        last = now
    if not found:
        raise UsageError("--offset auto: the recording is too short to contain motion")
    return np.stack(found)


def _changed(video: Video, camera: PhotoCamera, fps: float) -> Cells:
    cv2 = opencv()
    found: list[NDArray[np.float32]] = []
    last: NDArray[np.float32] | None = None
    for _, pixels in at_rate(video, fps, None):
        grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
        size = (camera.width, camera.height)
        now = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        if last is not None:
            change = np.clip(np.abs(now - last) - _NOISE, 0.0, _FULL_CHANGE)
            found.append(_cells(change * (255.0 / _FULL_CHANGE)))
        last = now
    if not found:
        raise UsageError(f"{video.path}: found only one frame, but --offset auto needs motion")
    return np.stack(found)


def _cells(change: NDArray[np.generic]) -> NDArray[np.float32]:
    rows, columns = change.shape[0] // _CELL, change.shape[1] // _CELL
    blocks = np.asarray(change, np.float32).reshape(rows, _CELL, columns, _CELL)
    return np.asarray(blocks.mean(axis=(1, 3)).ravel() / 255.0, np.float32)


class _Outlines:  # images of robots, whose geoms are drawn as filled convex hulls
    def __init__(self, world: World) -> None:
        model = world.model
        bodies = np.concatenate([part.bodies for part in world.robots.values()])
        shown = np.isin(model.geom_bodyid, bodies) & (model.geom_rgba[:, 3] > 0)
        shown &= model.geom_group < _HIDDEN_GROUP
        self._geoms = np.flatnonzero(shown)
        self._points = [_points_of(model, int(geom)) for geom in self._geoms]

    def draw(self, data: mujoco.MjData, camera: PhotoCamera) -> NDArray[np.uint8]:
        cv2 = opencv()
        image = np.zeros((camera.height, camera.width), np.uint8)
        world = [
            points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
            for geom, points in zip(self._geoms, self._points, strict=True)
        ]
        pixels, depth = camera.project(np.concatenate(world))
        pixels = np.clip(pixels, -1e4, 1e4)
        begin = 0
        for points in world:
            part = slice(begin, begin + len(points))
            begin += len(points)
            if (depth[part] > 0).all() and np.isfinite(pixels[part]).all():
                hull = cv2.convexHull(np.rint(pixels[part] * 16).astype(np.int32))
                cv2.fillConvexPoly(image, hull, 255, lineType=cv2.LINE_AA, shift=4)
        return image


def _points_of(model: mujoco.MjModel, geom: int) -> Array:
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        vertices = model.mesh_vert[first : first + count].astype(float)
        # The farthest vertices in directions that are distributed over a sphere are used.
        k = np.arange(_POINTS) + 0.5
        z, turn = 1.0 - 2.0 * k / _POINTS, np.pi * (1.0 + 5.0**0.5) * k
        around = np.stack([np.cos(turn), np.sin(turn), np.zeros(_POINTS)], axis=1)
        directions = around * np.sqrt(1.0 - z * z)[:, None]
        directions[:, 2] = z
        return np.asarray(vertices[np.unique((vertices @ directions.T).argmax(axis=0))])
    centre, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
    return np.asarray(centre + list(itertools.product((-1, 1), repeat=3)) * half)


def match(swept: Cells, changed: Cells, fps: float) -> FoundOffset:
    """Returns the offset that maximizes the correlation of changed and swept cells.

    Args:
        swept: swept fraction of each cell between successive frames of the recording, shape (T,
            cells).
        changed: change of each cell between successive frames of the video, shape (T', cells).
        fps: frames per second of both.

    Raises:
        UsageError: no offset clearly has the highest correlation.
    """
    for what, cells in (("recording", swept), ("video", changed)):
        if float(np.abs(cells - cells.mean(axis=0)).sum(axis=1).max(initial=0.0)) < 0.02:
            reason = f"the camera sees no motion of the robot in the {what}; use --offset S"
            raise UsageError(Problem(_KEY, reason))
    lags, scores = correlate(swept, changed, max(round(_MIN_OVERLAP * fps), 2))
    if not len(lags):
        expected = f"{_MIN_OVERLAP:g} s or more"
        raise UsageError(Problem(_KEY, "recording and video are too short", expected=expected))
    best = int(np.argmax(scores))
    apart = np.abs(lags - lags[best]) > max(_PEAK_DISTANCE * fps, 2)
    other = float(scores[apart].max(initial=0.0))
    score = float(scores[best])
    offset = (lags[best] + _peak(scores, best)) / fps
    if score < _MIN_CORRELATION:
        problem = Problem(
            _KEY,
            "video and recording do not match: found",
            found=round(score, 2),
            of="correlation of their motion",
            expected=f"{_MIN_CORRELATION:g} or more; check camera and recording, or use --offset S",
        )
        raise UsageError(problem)
    if score < _PEAK_RATIO * other:
        second = float(lags[apart][int(np.argmax(scores[apart]))] / fps)
        problem = Problem(
            _KEY,
            f"several offsets match (correlation {score:.2f} and {other:.2f}): found",
            found=[round(float(offset), 2), round(second, 2)],
            of="s",
            expected="one of these as --offset S",
        )
        raise UsageError(problem)
    return FoundOffset(float(offset), score, other)


def correlate(swept: Cells, changed: Cells, min_overlap: int) -> tuple[NDArray[np.intp], Array]:
    """Returns the correlation of swept and changed cells at each offset with sufficient overlap.

    Args:
        swept: swept fraction of each cell for each frame of the recording, shape (T, cells).
        changed: change of each cell for each frame of the video, shape (T', cells).
        min_overlap: minimum overlap in frames. The overlap must also be at least half of the
            shorter of `swept` and `changed`.

    Returns:
        offsets and correlations. An offset is the row of `swept` that corresponds to the first row
        of `changed`.
    """
    long, short = len(swept), len(changed)
    size = 1 << int(np.ceil(np.log2(long + short)))
    spectrum = np.zeros(size // 2 + 1, complex)
    energy_a, energy_b = np.zeros(long), np.zeros(short)
    for begin in range(0, swept.shape[1], _CHUNK):
        part = slice(begin, begin + _CHUNK)
        a = swept[:, part] - swept[:, part].mean(axis=0)
        b = changed[:, part] - changed[:, part].mean(axis=0)
        energy_a += (a * a).sum(axis=1)
        energy_b += (b * b).sum(axis=1)
        spectrum += (np.fft.rfft(a, size, axis=0) * np.fft.rfft(b, size, axis=0).conj()).sum(axis=1)
    products = np.fft.irfft(spectrum, size)
    lags = np.arange(-short + 1, long)
    first, last = np.maximum(lags, 0), np.minimum(lags + short, long)
    sums_a, sums_b = (np.concatenate([[0.0], np.cumsum(e)]) for e in (energy_a, energy_b))
    both = (sums_a[last] - sums_a[first]) * (sums_b[last - lags] - sums_b[first - lags])
    # Correlations of overlaps with little motion are not significant.
    enough = both > 0.01 * energy_a.sum() * energy_b.sum() * min(short / long, 1.0)
    enough &= last - first >= max(min_overlap, min(long, short) // 2)
    scores = np.where(enough, products[lags] / np.sqrt(np.where(enough, both, 1.0)), -1.0)
    return lags[enough], scores[enough]


def _peak(scores: Array, best: int) -> float:
    if not 0 < best < len(scores) - 1:
        return 0.0
    left, middle, right = scores[best - 1 : best + 2]
    bend = left - 2.0 * middle + right
    return float(np.clip(0.5 * (left - right) / bend, -0.5, 0.5)) if bend < 0 else 0.0
