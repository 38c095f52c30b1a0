"""A robot whose source has gone quiet is never shown as live: it is grey and says since when."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.tables import SOURCE_FIELDS, RobotPart
from ..assemble.world import World
from .panels import Panels, labels_at
from .pen import Pen
from .view import View

_AGE = SOURCE_FIELDS.index("age")
_FAULT_AGE = SOURCE_FIELDS.index("fault_age")
_RGBA = (0.12, 0.12, 0.13, 0.88)


@dataclass(frozen=True, eq=False)
class _Fed:
    """A robot and where in userdata the ages of its sources are."""

    part: RobotPart
    ages: NDArray[np.intp]
    geoms: NDArray[np.bool_]


class Staleness:
    """Finds robots without fresh data, greys them and labels them."""

    def __init__(self, world: World) -> None:
        model = world.model
        root = model.body_rootid[model.geom_bodyid]
        self._robots: list[_Fed] = []
        for name, part in world.robots.items():
            sources = {
                event.partition(".")[0]
                for target, event in world.scene.routes.items()
                if target.partition(".")[0] == name
            }
            ages = [world.slots[f"sources.{source}"].start + _AGE for source in sorted(sources)]
            if ages:  # a robot that nothing is routed to stands as declared
                self._robots.append(_Fed(part, np.array(ages, np.intp), root == part.bodies[0]))

    def panels(self, pen: Pen, data: mujoco.MjData, view: View) -> Panels | None:
        """Greys stale robots and returns their labels, or None when all are fresh.

        Args:
            pen: gets the geoms to be grey.
            data: the world's state.
            view: of the picture.
        """
        pen.grey = None
        texts, anchors = [], []
        for fed in self._robots:
            ages = data.userdata[fed.ages]
            name = fed.part.robot.name
            if (ages < 0).any():
                text = f"{name}: no data yet"
            elif ages.max() > fed.part.robot.stale_after:
                faults = data.userdata[fed.ages + _FAULT_AGE - _AGE]
                good = "good " if ((faults >= 0) & (faults < ages)).any() else ""
                text = f"{name}: no {good}data for {_duration(float(ages.max()))}"
            else:
                continue
            pen.grey = fed.geoms if pen.grey is None else pen.grey | fed.geoms
            texts.append(text.encode("ascii", "replace")[:99])
            anchors.append(data.xpos[fed.part.bodies[0]])
        if not texts:
            return None
        centres, depth = view.project(np.array(anchors))
        inside = depth > view.near
        if not inside.any():
            return None
        texts = [text for text, here in zip(texts, inside, strict=True) if here]
        below = centres[inside] - [0.0, 2.0 * view.font.height]
        centres, sizes = labels_at(view, below, texts)
        return Panels(centres, sizes, [[text] for text in texts], _RGBA)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"
