"""Text at positions in the world: names of frames and parts, and labels of geoms."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world_view import WorldView
from ..decor.feature import Frame
from ..decor.joint_titles import frame_titles
from ..decor.part_names import named_parts
from .packing import PackedArrays

_LABEL = int(mujoco.mjtGeom.mjGEOM_LABEL)
_Key = tuple[str, int]


def labels_of(world: WorldView, frame: Frame) -> dict[_Key, tuple[str, Array]]:
    """Returns text and position (3,), m, of all labels of a frame."""
    frames, buffer = world.frames, frame.buffer
    found: dict[_Key, tuple[str, Array]] = {}
    titles = frame_titles(tuple(frames.names))
    for i in frame.shown.frame_names.nonzero()[0].tolist():
        found["name", i] = titles[i], np.array(frame.data.site_xpos[frames.site[i]])
    parts, places = named_parts(world, frame.data, frame.toggles.part_names)
    found |= {("part", k): (parts[k], places[k]) for k in range(len(parts))}
    rows = buffer.rows[: buffer.count]
    has_text = rows["label"] != b""
    has_text[buffer.text] = False  # texts of panels, which the player lays out itself
    for k, row in enumerate(rows[has_text]):
        found["geom", k] = row["label"].decode("latin-1"), np.array(row["pos"], float)
    return found


def labels_head(
    frames: list[dict[_Key, tuple[str, Array]]], parts: PackedArrays, step: float
) -> dict[str, Any]:
    """Returns the labels for the head of a page.

    Args:
        step: resolution of positions, m.
    """
    keys = list(dict.fromkeys(key for each in frames for key in each))
    if not keys:
        return {}
    places = np.zeros((len(frames), len(keys), 3))
    numbers = np.zeros((len(frames), len(keys)), int)
    texts = {"": 0}
    for k, each in enumerate(frames):
        for i, key in enumerate(keys):
            if key in each:
                text, places[k, i] = each[key]
                numbers[k, i] = texts.setdefault(text, len(texts))
            elif k:
                places[k, i] = places[k - 1, i]
    return {
        "labels": {
            "texts": list(texts),
            "at": parts.moving(numbers, 1),
            "positions": parts.moving(places.reshape(len(frames), -1), step),
        }
    }
