"""All named frames and all smart arrows of a compiled scene, as arrays."""

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
    """All named frames, as arrays over M frames.

    Attributes:
        names: e.g. `lwr/link3`, M.
        owner: index in the world's `owners` of the robot or double with which it is shown, -1
            for a frame that has a switch of its own.
        site: its site.
        size: length of the axes, m.
        alpha: 0 invisible to 1 opaque.
        shown: whether it is shown at first, where it has a switch of its own.
        has: index in `userdata` of the flag that says that it is anywhere; -1 for always.
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
    """Lists all named frames of a compiled scene."""
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
    """All smart arrows, as arrays over K arrows.

    Attributes:
        names: K.
        site: where it stands.
        components_site: site of the frame its components are in; -1 for the world.
        frames: rows in the `FrameTable` of the frame it stands at and of the one its components
            are in, (K, 2); -1 for a point and for the world.
        slots: index in `userdata` of its components, (K, 3).
        has: index in `userdata` of the flag that data came.
        is_round: whether it turns about its direction.
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
    """Lists all smart arrows of a compiled scene."""
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
