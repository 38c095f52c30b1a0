"""What moves without a body of its own: tendons, as MuJoCo draws them, and vertices of flexes."""

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
_MOST_PIECES = 4000  # of tendons; a scene has the geoms of the model as well


@dataclass(frozen=True, eq=False)
class Soft:
    """F frames of S pieces of tendons, and of the V vertices of all drawn flexes.

    Attributes:
        vertices: (F, V, 3), m.
        ends: of every straight piece of a tendon, (F, S, 2, 3), m.
        radius: of the pieces, (F, S), m; 0 for none.
        colours: of the pieces in all frames, (S, 4).
    """

    vertices: Array
    ends: Array
    radius: Array
    colours: Array

    def head(self, parts: PackedArrays, step: float) -> dict[str, Any]:
        """Returns what the head of a page has of it, with places in steps of so many meters."""
        frames = len(self.radius)
        found: dict[str, Any] = {}
        if self.vertices.size:
            found["soft"] = parts.moving(self.vertices.reshape(frames, -1), step)
        if self.radius.size:
            found["tendons"] = {
                "ends": parts.moving(self.ends.reshape(frames, -1), step),
                "radius": parts.moving(self.radius, step),
                "rgba": rounded(self.colours, 3),
            }
        return found


class SoftFrame(NamedTuple):
    """Vertices of flexes, (V, 3), m, and rows of `GEOM` of pieces of tendons, in one state."""

    vertices: Array
    tendons: np.ndarray


class SoftParts:
    """The tendons and flexes of a model."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._vertices = _flex_vertices(model)
        self._has_tendons = bool((model.ntendon and (model.tendon_width > 0).any()) or model.nwrap)
        self._scene: mujoco.MjvScene | None = None
        self._camera, self._option = mujoco.MjvCamera(), mujoco.MjvOption()

    def take(self, data: mujoco.MjData) -> SoftFrame:
        return SoftFrame(data.flexvert_xpos[self._vertices].copy(), self._pieces(data))

    def _pieces(self, data: mujoco.MjData) -> np.ndarray:
        """The straight pieces of all tendons, (k,) of `GEOM`; none takes no time."""
        if not self._has_tendons:
            return np.zeros(0, GEOM)
        model = self._model
        if self._scene is None:
            self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite + _MOST_PIECES)
        scene = self._scene
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, _ALL, scene)
        rows = struct_view(scene)[: scene.ngeom]
        kept: np.ndarray = rows[(rows["objtype"] == _TENDON) & (rows["type"] == _CAPSULE)].copy()
        return kept


def soft_of(found: Sequence[SoftFrame]) -> Soft:
    """Returns all frames as one; each piece of a tendon has a place of its own."""
    frames = len(found)
    most: dict[int, int] = {}
    for rows in (each.tendons for each in found):
        for tendon, count in zip(*np.unique(rows["objid"], return_counts=True), strict=True):
            most[int(tendon)] = max(most.get(int(tendon), 0), int(count))
    starts = dict(zip(sorted(most), np.cumsum([0, *(most[k] for k in sorted(most))]), strict=False))
    pieces = sum(most.values())
    ends, radius = np.zeros((frames, pieces, 2, 3)), np.zeros((frames, pieces))
    colours = np.ones((pieces, 4))
    for k, rows in enumerate(each.tendons for each in found):
        if k:
            ends[k] = ends[k - 1]  # a piece that goes stays where it was
        for tendon, start in starts.items():
            own = rows[rows["objid"] == tendon]
            at = slice(start, start + len(own))
            half = own["mat"][:, :, 2] * own["size"][:, 2:3]
            ends[k, at] = own["pos"][:, None] + np.stack([-half, half], axis=1)
            radius[k, at], colours[at] = own["size"][:, 0], own["rgba"]
    return Soft(np.array([each.vertices for each in found]), ends, radius, colours)


def _flex_vertices(model: mujoco.MjModel) -> Ints:
    if not model.nflex:
        return np.zeros(0, np.intp)
    owner = np.repeat(np.arange(model.nflex), model.flex_vertnum)
    return np.flatnonzero(shown_flexes(model)[owner])


def bytes_of_frame(model: mujoco.MjModel) -> int:
    """Returns how many bytes of a browser's memory its soft parts take in each frame, at most."""
    return 4 * (3 * int(model.nflexvert) + 7 * int(model.nwrap))
