"""`PartNames`: shows the names of bodies, joints or geoms of the model."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT
from .feature import Feature, Frame
from .geom_buffer import Kind
from .panels import Panels, labels_below
from .toggles import PART_NAMES

_GROUPS = 3  # number of visible groups of geoms
_LOWER = 3  # maximum number of steps of one label height that a label moves down
_TOUCHING = 0.01  # maximum overlap of labels, pixels


class PartNames(Feature):
    """The visual feature that shows the names of the parts that `Toggles.part_names` selects."""

    order = 61

    def lay_out(self, frame: Frame) -> None:
        names, places = named_parts(self.world, frame.data, frame.toggles.part_names)
        found = labels_below(places, names, frame.view)
        if found is not None:
            frame.panels.append(replace(_apart(found[0]), kind=Kind.PART))


def _apart(labels: Panels) -> Panels:
    # Labels that would have to move down by more than a few lines are omitted, because they would
    # seem to belong to another part. `js/src/labels.js` does the same.
    centres, placed = labels.centres.copy(), list[int]()
    for k, (size, centre) in enumerate(zip(labels.sizes, labels.centres, strict=True)):
        apart = (labels.sizes[placed] + size) / 2
        for step in range(_LOWER + 1):
            centres[k] = centre - [0.0, step * size[1]]
            if not (np.abs(centres[k] - centres[placed]) < apart - _TOUCHING).all(axis=1).any():
                placed.append(k)
                break
    return replace(labels, centres=centres).only(np.isin(np.arange(len(centres)), placed))


def named_parts(world: WorldView, data: Any, chosen: int) -> tuple[list[str], Array]:
    """Returns the names of parts of the model, and their positions, shape (k, 3), m.

    Fixed parts are included. Doubles, received frames, cameras and unnamed parts are omitted.

    Args:
        chosen: kind of the parts, as an index of `PART_NAMES`.
    """
    model, what = world.model, PART_NAMES[chosen]
    if what == "none":
        return [], np.zeros((0, 3))
    ids, bodies, at = _parts(model, what)
    shown = _is_part(world)[bodies] & (data.xpos[bodies][:, 2] > OUT_OF_SIGHT[2] / 2)
    kind = {"bodies": "body", "joints": "joint", "geoms": "geom"}[what]
    names = [getattr(model, kind)(i).name.removesuffix("/") for i in ids.tolist()]
    shown &= np.array([bool(name) for name in names], bool)
    index = shown.nonzero()[0]
    turned = np.einsum("kij,kj->ki", data.xmat[bodies[index]].reshape(-1, 3, 3), at[index])
    return [names[k] for k in index.tolist()], data.xpos[bodies[index]] + turned


def _parts(model: mujoco.MjModel, what: str) -> tuple[Ints, Ints, Array]:
    if what == "bodies":
        ids = np.arange(1, model.nbody)
        return ids, ids, np.zeros((len(ids), 3))
    if what == "joints":
        ids = np.arange(model.njnt)
        return ids, model.jnt_bodyid.astype(np.intp), model.jnt_pos
    ids = (model.geom_group < _GROUPS).nonzero()[0]
    return ids, model.geom_bodyid[ids].astype(np.intp), model.geom_pos[ids]


def _is_part(world: WorldView) -> Bools:
    mocap, placed = world.model.body_mocapid, world.placed
    moved = [placed[name] for name in (*world.scene.frames, *world.scene.cameras) if name in placed]
    for each in world.doubles.values():
        moved += [*each.mocap.ravel(), *each.frames.ravel()]
    return np.asarray((mocap < 0) | ~np.isin(mocap, moved))
