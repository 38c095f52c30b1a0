"""Draws robots and other items without fresh data in gray, with the age of the data as a label."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...data.receive.reception import QUIET_AFTER
from ...robots.assemble.parts import DoublePart, robots_of_bodies
from ...robots.assemble.world_view import SET_BY_PROGRAM, WorldView
from ...robots.declared.inputs import SOURCE_FIELDS
from .font import line_of
from .geom_buffer import GeomBuffer
from .image_view import ImageView
from .panels import Panels, labels_at

_AGE = SOURCE_FIELDS.index("age")
_FAULT_AGE = SOURCE_FIELDS.index("fault_age")
_IS_FAILING = SOURCE_FIELDS.index("is_failing")
_RGBA = (0.12, 0.12, 0.13, 0.88)
NO_DATA_YET = "no data yet"


@dataclass(frozen=True, eq=False)
class _Routed:
    """A robot, double, arrow or frame whose inputs have routes.

    Attributes:
        ages: indices in `userdata` of the data age of each source of an input, shape (k,).
        flags: indices in `userdata` of flags, one for each age, that state whether a program or a
            source has last set the input, shape (k,).
        stale_after: age from which data is stale, s.
        base: body at whose origin the label is shown; -1 for arrows and frames.
        geoms: mask of the geoms of the item, shape (ngeom,); None for arrows and frames.
    """

    name: str
    ages: NDArray[np.intp]
    flags: NDArray[np.intp]
    stale_after: float
    base: int
    geoms: NDArray[np.bool_] | None


_Labelled = tuple[int, list[str]]  # body with the label of a group, and members of the group


class Staleness:
    """The detection of items without fresh data in a world, and their gray color and labels."""

    def __init__(self, world: WorldView) -> None:
        scene = world.scene
        self._routed: list[_Routed] = []
        names = (*world.robots, *world.doubles, *scene.arrows, *scene.frames)
        for name in names:
            targets = [
                item.target
                for item in world.inputs.values()
                if item.name == name and item.kind != "toggle" and scene.routed(item.target)
            ]
            pairs = [
                (world.slots[f"sources.{source}"].start + _AGE, world.flags[target])
                for target in targets
                for source in sorted(scene.sources_of(target))
            ]
            if pairs:  # items without routes are never stale
                self._routed.append(_routed_item(world, name, *np.array(pairs, np.intp).T))
        self._groups = _groups_with_data(world, {item.name for item in self._routed})
        self._owner, self._owners = world.joints.owner, list(world.owners)
        self._soonest = min((item.stale_after for item in self._routed), default=np.inf)
        self._all = np.array(sorted({int(i) for item in self._routed for i in item.ages}), np.intp)

    def find(self, data: mujoco.MjData) -> dict[str, str]:
        """Returns a message for each item without fresh data, as a mapping from item names."""
        ages = data.userdata[self._all]
        if not len(ages) or (ages.min() >= 0 and ages.max() <= self._soonest):
            return {}
        stale = {}
        for item in self._routed:
            indices = _awaited(item, data)
            ages = data.userdata[indices]
            failing = data.userdata[indices + _IS_FAILING - _AGE].any()
            reason = ", reception failed" if failing else ""
            if (ages < 0).any():
                stale[item.name] = f"{NO_DATA_YET}{reason}"
            elif ages.max(initial=0.0) > item.stale_after:
                faults = data.userdata[indices + _FAULT_AGE - _AGE]
                valid = "valid " if ((faults >= 0) & (faults < ages)).any() else ""
                stale[item.name] = f"no {valid}data for {_duration(float(ages.max()))}{reason}"
        return stale

    def joints(self, stale: dict[str, str]) -> NDArray[np.bool_]:
        """Returns a mask of the joints of robots and doubles without fresh data, shape (N,)."""
        return stale_mask(self._owners, stale)[self._owner]

    def time_without_data(self, data: mujoco.MjData, stale: dict[str, str]) -> NDArray[np.float64]:
        """Returns the time since the last data of each stale joint in seconds, shape (N,).

        The time is 0 for joints with fresh data, and inf before the first data.
        """
        of_owner = dict.fromkeys(self._owners, 0.0)
        for item in self._routed:
            if item.name in stale and item.name in of_owner:
                ages = data.userdata[_awaited(item, data)]
                of_owner[item.name] = np.inf if (ages < 0).any() else float(ages.max())
        return np.array([*of_owner.values()], np.float64)[self._owner]

    def panels(
        self, buffer: GeomBuffer, data: mujoco.MjData, view: ImageView, stale: dict[str, str]
    ) -> list[Panels]:
        """Marks robots and doubles without fresh data as gray, and returns their labels."""
        buffer.grey = None
        texts: dict[int, list[bytes]] = {}  # maps the base of a robot and its doubles to lines
        labels = [(item.name, item.base) for item in self._routed if item.geoms is not None]
        messages = dict(stale)
        for group, (base, names) in self._groups.items():
            if names[0] in stale and len({stale.get(name) for name in names}) == 1:
                labels = [label for label in labels if label[0] not in names]
                labels.append((group, base))  # one label for all members
                messages[group] = stale[names[0]]
        for item in self._routed:
            if item.name in stale and item.geoms is not None:
                buffer.grey = item.geoms if buffer.grey is None else buffer.grey | item.geoms
        for name, base in labels:
            if name in messages:
                text = line_of(f"{name}: {messages[name]}")
                texts.setdefault(base, []).append(text)
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


def _awaited(item: _Routed, data: mujoco.MjData) -> NDArray[np.intp]:
    # Returns which data ages decide whether an item is stale. Inputs that a program sets need no
    # packets. If there are such inputs, the other ones count only if they have received data.
    is_programs = data.userdata[item.flags] == SET_BY_PROGRAM
    if not is_programs.any():
        return item.ages
    others = item.ages[~is_programs]
    return np.asarray(others[data.userdata[others] >= 0])


def stale_mask(names: list[str], stale: dict[str, str]) -> NDArray[np.bool_]:
    """Returns a mask of the named items without fresh data, shape (k,)."""
    if not stale:
        return np.zeros(len(names), bool)
    return np.array([name in stale for name in names], bool)


def _groups_with_data(world: WorldView, routed: Collection[str]) -> dict[str, _Labelled]:
    # Only groups that are in no other group have a label. If possible, the label is at a robot that
    # no other robot carries. The label of doubles is below that of their robots.
    found: dict[str, _Labelled] = {}
    for group, robots in world.scene.membership.members.items():
        names = [name for name in robots if name in world.robots]
        moved = [name for name in names if name in routed]
        if len(moved) > 1 and not world.scene.membership.around.get(group):
            at = next((name for name in names if world.robots[name].mocap >= 0), names[0])
            found[group] = int(world.robots[at].bodies[0]), moved
    for group, doubles in world.scene.double_groups.items():
        moved = [name for name in doubles if name in routed]
        if len(moved) > 1:
            part = world.doubles[moved[0]].of
            bases = [base for base, names in found.values() if part.robot.name in names]
            found[group] = (bases or [int(part.bodies[0])])[0], moved
    return found


def _routed_item(
    world: WorldView, name: str, ages: NDArray[np.intp], flags: NDArray[np.intp]
) -> _Routed:
    model = world.model
    if name in world.robots:
        part = world.robots[name]
        number = list(world.robots).index(name)
        own = robots_of_bodies(model, world.robots)[model.geom_bodyid] == number
        return _Routed(name, ages, flags, part.robot.stale_after, int(part.bodies[0]), own)
    if name in world.doubles:
        double: DoublePart = world.doubles[name]
        own = np.isin(model.geom_bodyid, double.bodies)
        return _Routed(name, ages, flags, double.robot.stale_after, int(double.of.bodies[0]), own)
    return _Routed(name, ages, flags, QUIET_AFTER, -1, None)


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.0f} h"
