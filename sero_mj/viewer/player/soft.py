"""Tendons and flexes: parts of a model that move without a body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ..decor.geom_buffer import GEOM
from ..decor.scene_writer import struct_view
from .model import shown_flexes
from .packing import PackedArrays, rounded

_TENDON = int(mujoco.mjtObj.mjOBJ_TENDON)
_CAPSULE = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
_ALL = int(mujoco.mjtCatBit.mjCAT_ALL)
_MAX_PIECES = 4000  # maximum number of tendon pieces


@dataclass(frozen=True, eq=False)
class Soft:
    """Tendons and flexes in F frames. Tendons have S straight pieces, and flexes have V vertices.

    Attributes:
        vertices: positions of the flex vertices, shape (F, V, 3), m.
        ends: end points of the tendon pieces, shape (F, S, 2, 3), m.
        radius: radii of the pieces, shape (F, S), m; 0 for a piece that is not drawn.
        colors: RGBA colors of the pieces, shape (S, 4), equal in all frames.
    """

    vertices: Array
    ends: Array
    radius: Array
    colors: Array

    def head(self, parts: PackedArrays, step: float) -> dict[str, Any]:
        """Encodes tendons and flexes for the JSON head of a page. `step` is the resolution in m."""
        frames = len(self.radius)
        found: dict[str, Any] = {}
        if self.vertices.size:
            found["soft"] = parts.moving(self.vertices.reshape(frames, -1), step)
        if self.radius.size:
            found["tendons"] = {
                "ends": parts.moving(self.ends.reshape(frames, -1), step),
                "radius": parts.moving(self.radius, step),
                "rgba": rounded(self.colors, 3),
            }
        return found


class SoftFrame(NamedTuple):
    """Positions of flex vertices, shape (V, 3), m, and tendon pieces, dtype `GEOM`, at one time."""

    vertices: Array
    tendons: np.ndarray


class SoftParts:
    """Captures the tendons and flexes of a model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._vertices = _flex_vertices(model)
        self._has_tendons = bool((model.ntendon and (model.tendon_width > 0).any()) or model.nwrap)
        self._scene: mujoco.MjvScene | None = None
        self._camera, self._option = mujoco.MjvCamera(), mujoco.MjvOption()

    def take(self, data: mujoco.MjData) -> SoftFrame:
        return SoftFrame(data.flexvert_xpos[self._vertices].copy(), self._pieces(data))

    def _pieces(self, data: mujoco.MjData) -> np.ndarray:
        if not self._has_tendons:
            return np.zeros(0, GEOM)
        model = self._model
        if self._scene is None:
            self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite + _MAX_PIECES)
        scene = self._scene
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, _ALL, scene)
        rows = struct_view(scene)[: scene.ngeom]
        kept: np.ndarray = rows[(rows["objtype"] == _TENDON) & (rows["type"] == _CAPSULE)].copy()
        return kept


def soft_of(found: Sequence[SoftFrame]) -> Soft:
    """Joins captured frames. Each tendon piece has the same index in all frames."""
    frames = len(found)
    counts: dict[int, int] = {}
    for rows in (each.tendons for each in found):
        for tendon, count in zip(*np.unique(rows["objid"], return_counts=True), strict=True):
            counts[int(tendon)] = max(counts.get(int(tendon), 0), int(count))
    starts = dict(
        zip(sorted(counts), np.cumsum([0, *(counts[k] for k in sorted(counts))]), strict=False)
    )
    pieces = sum(counts.values())
    ends, radius = np.zeros((frames, pieces, 2, 3)), np.zeros((frames, pieces))
    colors = np.ones((pieces, 4))
    for k, rows in enumerate(each.tendons for each in found):
        if k:
            ends[k] = ends[k - 1]  # A piece that disappears stays at its position.
        for tendon, start in starts.items():
            own = rows[rows["objid"] == tendon]
            at = slice(start, start + len(own))
            half = own["mat"][:, :, 2] * own["size"][:, 2:3]
            ends[k, at] = own["pos"][:, None] + np.stack([-half, half], axis=1)
            radius[k, at], colors[at] = own["size"][:, 0], own["rgba"]
    return Soft(np.array([each.vertices for each in found]), ends, radius, colors)


def _flex_vertices(model: mujoco.MjModel) -> Ints:
    if not model.nflex:
        return np.zeros(0, np.intp)
    owner = np.repeat(np.arange(model.nflex), model.flex_vertnum)
    return np.flatnonzero(shown_flexes(model)[owner])


def bytes_of_frame(model: mujoco.MjModel) -> int:
    """Returns the maximum size in bytes of the tendons and flexes of one frame in a browser."""
    return 4 * (3 * int(model.nflexvert) + 7 * int(model.nwrap))
