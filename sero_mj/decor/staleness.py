"""What has no fresh data is never shown as live: it is grey, and a robot says since when."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.inputs import SOURCE_FIELDS
from ..assemble.parts import DoublePart
from ..assemble.world_view import WorldView
from ..receive.source import QUIET_AFTER
from .panels import Panels, labels_at
from .pen import Pen
from .picture_view import PictureView

_AGE = SOURCE_FIELDS.index("age")
_FAULT_AGE = SOURCE_FIELDS.index("fault_age")
_RGBA = (0.12, 0.12, 0.13, 0.88)
NO_DATA_YET = "no data yet"


@dataclass(frozen=True, eq=False)
class _Fed:
    """Something that is routed to.

    Attributes:
        name: of a robot, a double, a smart arrow or a received frame.
        ages: where in userdata the ages of its sources are.
        stale_after: s.
        base: body beside whose origin its age is written; -1 for arrows and frames.
        geoms: which geoms of the model are its own, (ngeom,).
    """

    name: str
    ages: NDArray[np.intp]
    stale_after: float
    base: int
    geoms: NDArray[np.bool_] | None


class Staleness:
    """Finds what has no fresh data, greys it and labels it."""

    def __init__(self, world: WorldView) -> None:
        scene = world.scene
        self._fed: list[_Fed] = []
        names = (*world.robots, *world.doubles, *scene.arrows, *scene.frames)
        for name in names:
            targets = [
                item.target
                for item in world.inputs.values()
                if item.name == name and item.kind != "toggle" and item.target in scene.routes
            ]
            sources = scene.sources_of(*targets) if targets else set()
            if not sources:  # what nothing is routed to stands as declared
                continue
            slots = [world.slots[f"sources.{source}"].start + _AGE for source in sorted(sources)]
            self._fed.append(_fed(world, name, np.array(slots, np.intp)))
        self._owner, self._owners = world.joints.owner, list(world.owners)
        self._soonest = min((fed.stale_after for fed in self._fed), default=np.inf)
        self._all = np.array(sorted({int(i) for fed in self._fed for i in fed.ages}), np.intp)

    def find(self, data: mujoco.MjData) -> dict[str, str]:
        """Names of what has no fresh data, and what to say about it."""
        ages = data.userdata[self._all]
        if not len(ages) or (ages.min() >= 0 and ages.max() <= self._soonest):
            return {}
        stale = {}
        for fed in self._fed:
            ages = data.userdata[fed.ages]
            if (ages < 0).any():
                stale[fed.name] = NO_DATA_YET
            elif ages.max() > fed.stale_after:
                faults = data.userdata[fed.ages + _FAULT_AGE - _AGE]
                good = "good " if ((faults >= 0) & (faults < ages)).any() else ""
                stale[fed.name] = f"no {good}data for {_duration(float(ages.max()))}"
        return stale

    def joints(self, stale: dict[str, str]) -> NDArray[np.bool_]:
        """Which joints of the world, (N,), are of robots and doubles without fresh data.

        Args:
            stale: what `find` returned.
        """
        return among(self._owners, stale)[self._owner]

    def silence(self, data: mujoco.MjData, stale: dict[str, str]) -> NDArray[np.float64]:
        """How long there has been no data for every joint of the world, (N,), s.

        Args:
            data: the world's state.
            stale: what `find` returned.

        Returns:
            0 for fresh joints, inf where there never was any.
        """
        of_owner = dict.fromkeys(self._owners, 0.0)
        for fed in self._fed:
            if fed.name in stale and fed.name in of_owner:
                ages = data.userdata[fed.ages]
                of_owner[fed.name] = np.inf if (ages < 0).any() else float(ages.max())
        return np.array([*of_owner.values()], np.float64)[self._owner]

    def panels(
        self, pen: Pen, data: mujoco.MjData, view: PictureView, stale: dict[str, str]
    ) -> list[Panels]:
        """Greys stale robots and doubles and returns their labels.

        Args:
            pen: gets the geoms to be grey.
            data: the world's state.
            view: of the picture.
            stale: what `find` returned.
        """
        pen.grey = None
        texts: dict[int, list[bytes]] = {}  # a robot's and its doubles' under each other
        for fed in self._fed:
            if fed.name in stale and fed.geoms is not None:
                pen.grey = fed.geoms if pen.grey is None else pen.grey | fed.geoms
                text = f"{fed.name}: {stale[fed.name]}".encode("ascii", "replace")[:99]
                texts.setdefault(fed.base, []).append(text)
        if not texts:
            return []
        anchors, depth = view.project(data.xpos[list(texts)])
        inside = depth > view.near
        if not inside.any():
            return []
        lines = [lines for lines, here in zip(texts.values(), inside, strict=True) if here]
        below = anchors[inside] - [0.0, 2.0 * view.font.height]
        centres, sizes = labels_at(view, below, lines)
        return [Panels(centres, sizes, lines, _RGBA, in_front=True)]


def among(names: list[str], stale: dict[str, str]) -> NDArray[np.bool_]:
    """Which names have no fresh data."""
    if not stale:
        return np.zeros(len(names), bool)
    return np.array([name in stale for name in names], bool)


def _fed(world: WorldView, name: str, ages: NDArray[np.intp]) -> _Fed:
    model = world.model
    if name in world.robots:
        part = world.robots[name]
        own = model.body_rootid[model.geom_bodyid] == part.bodies[0]
        return _Fed(name, ages, part.robot.stale_after, int(part.bodies[0]), own)
    if name in world.doubles:
        double: DoublePart = world.doubles[name]
        own = np.isin(model.geom_bodyid, double.bodies)
        return _Fed(name, ages, double.robot.stale_after, int(double.of.bodies[0]), own)
    return _Fed(name, ages, QUIET_AFTER, -1, None)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"
