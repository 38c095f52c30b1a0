"""Arrays over all named frames and all smart arrows of a compiled scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .named_frames import WORLD, NamedFrame
from .scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
Sites = Callable[[Sequence[str]], Ints]  # ids of sites by name


@dataclass(frozen=True, eq=False)
class FrameTable:
    """Arrays over all M named frames.

    Attributes:
        names: e.g. `lwr/link3`, M.
        owner: index in the world's `owners` of the robot or double whose axes toggle applies; -1
            for a frame with its own toggle.
        site: id of its site.
        size: length of the axes, m.
        alpha: 0 invisible to 1 opaque.
        shown: whether it is initially shown, for frames with their own toggle.
        has: index in `userdata` of the flag that its pose is known; -1 for always.
    """

    names: list[str]
    owner: Ints
    site: Ints
    size: Array
    alpha: Array
    shown: NDArray[np.bool_]
    has: Ints


def frame_table(
    scene: Scene, owners: Sequence[str], flags: dict[str, int], sites: Sites
) -> FrameTable:
    """Builds the table of all named frames of a compiled scene.

    Args:
        scene: the declaration.
        owners: names of the robots and doubles with joints, in the world's order.
        flags: index in `userdata` of the flag that an input was set, by its name.
        sites: returns the ids of sites (k,) by their names.
    """
    rows = scene.named_frames().values()

    def flag(row: NamedFrame) -> int:
        if row.moves_with in scene.doubles:
            return flags[f"{row.moves_with}.joint_angles"]
        return flags[f"{row.moves_with}.frame"] if row.moves_with in scene.frames else -1

    return FrameTable(
        names=[row.name for row in rows],
        owner=np.array(
            [owners.index(row.shown_with) if row.shown_with else -1 for row in rows], np.intp
        ),
        site=sites([row.site for row in rows]),
        size=np.array([row.size for row in rows], np.float64),
        alpha=np.array([row.alpha for row in rows], np.float64),
        shown=np.array([row.shown for row in rows], bool),
        has=np.array([flag(row) for row in rows], np.intp),
    )


@dataclass(frozen=True, eq=False)
class ArrowTable:
    """Arrays over all K smart arrows.

    Attributes:
        names: K.
        site: id of the site it acts at.
        components_site: site of the frame its components are in; -1 for the world.
        frames: rows in the `FrameTable` of the frame it acts at and of the frame of its
            components, (K, 2); -1 for a point and for the world.
        slots: indices in `userdata` of its components, (K, 3).
        has: index in `userdata` of the flag that data was received.
        is_round: whether it is drawn as a round arrow about its direction.
        scale: m per unit.
        longest: m.
        radius: of a round one, m.
        rgba: (K, 4).
    """

    names: list[str]
    site: Ints
    components_site: Ints
    frames: Ints
    slots: Ints
    has: Ints
    is_round: NDArray[np.bool_]
    scale: Array
    longest: Array
    radius: Array
    rgba: Array


def arrow_table(
    scene: Scene, slots: dict[str, slice], flags: dict[str, int], sites: Sites
) -> ArrowTable:
    """Builds the table of all smart arrows of a compiled scene.

    Args:
        scene: the declaration.
        slots: slice of every input in `userdata`.
        flags: index in `userdata` of the flag that an input was set, by its name.
        sites: returns the ids of sites (k,) by their names.
    """
    arrows = scene.arrows.values()
    frames = scene.named_frames()

    def components(name: str) -> int:
        return -1 if name == WORLD else int(sites([frames[name].site])[0])

    rows = {name: i for i, name in enumerate(frames)} | {WORLD: -1}
    used = [(rows.get(a.at, -1) if a.site is None else -1, rows[a.components_in]) for a in arrows]
    starts = np.array([slots[f"{name}.vector"].start for name in scene.arrows], np.intp)
    return ArrowTable(
        names=list(scene.arrows),
        site=sites([arrow.site or frames[arrow.at].site for arrow in arrows]),
        components_site=np.array([components(arrow.components_in) for arrow in arrows], np.intp),
        frames=np.array(used, np.intp).reshape(-1, 2),
        slots=starts[:, None] + np.arange(3),
        has=np.array([flags[f"{name}.vector"] for name in scene.arrows], np.intp),
        is_round=np.array([arrow.is_round for arrow in arrows], bool),
        scale=np.array([arrow.metres_per_unit for arrow in arrows], np.float64),
        longest=np.array([arrow.limit for arrow in arrows], np.float64),
        radius=np.array([arrow.radius for arrow in arrows], np.float64),
        rgba=np.array([arrow.color for arrow in arrows], np.float64).reshape(-1, 4),
    )
