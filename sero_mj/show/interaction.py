"""What is at a pixel, and what a click on it does: the same in every host.

Robots and objects are found by `mj_ray`, decor by its own boxes; the nearest to the eye wins.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.tables import ARROW_QUANTITIES
from ..assemble.world import World
from ..decor.pen import ARROW_SIZE_OF_LENGTH, Kind, Pen
from ..decor.toggles import Toggles
from ..decor.view import View

Array = NDArray[np.float64]

_ARROW_HEAD = 1.75  # the head of an arrow geom over its shaft, in MuJoCo's renderers
_KINDS = {Kind.ARROW: "arrow", Kind.BILLBOARD: "billboard", Kind.AXES: "axes", Kind.NAME: "name"}


@dataclass(frozen=True)
class Picked:
    """What is at a pixel.

    Attributes:
        kind: what sort of thing it is.
        name: e.g. `lwr/A4` for a joint's arrow or billboard, `lwr/link3`, `table`.
        robot: the robot it belongs to; empty for an object.
        index: joint of the world for links, arrows and billboards, frame for axes and names;
            -1 for an object or a double.
        distance: from the eye, m.
    """

    kind: Literal["link", "double", "object", "arrow", "billboard", "axes", "name"]
    name: str
    robot: str
    index: int
    distance: float


def pick(
    world: World,
    data: mujoco.MjData,
    pen: Pen,
    view: View,
    pixel: tuple[float, float],
    tolerance: float = 0.0,
) -> Picked | None:
    """Returns what is seen at a pixel, or None for the sky and the floor.

    Args:
        world: the compiled scene.
        data: its state, frames up to date.
        pen: the decor of the frame that the user sees.
        view: of that frame.
        pixel: x to the right and y up from the lower left corner of the picture.
        tolerance: decor is this many pixels larger on every side; for fingers about 12.
    """
    origin = view.position
    direction = view.at(np.array(pixel, float), 1.0) - origin
    direction = direction / np.linalg.norm(direction)
    decor = _pick_decor(world, pen, view, origin, direction, tolerance)
    solid = _pick_solid(world, data, origin, direction)
    if decor is None or solid is None:
        return decor or solid
    return decor if decor.distance <= solid.distance else solid


def _pick_decor(
    world: World, pen: Pen, view: View, origin: Array, direction: Array, tolerance: float
) -> Picked | None:
    rows = pen.rows[: pen.count]
    box, arrow = int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_ARROW)
    of_something = pen.kinds[: pen.count] != Kind.NONE
    index = (of_something & ((rows["type"] == box) | (rows["type"] == arrow))).nonzero()[0]
    if not len(index):
        return None
    rows = rows[index]
    centre, half = rows["pos"].astype(float), rows["size"].astype(float)
    mat = rows["mat"].astype(float)
    straight = rows["type"] == arrow  # from its position along z; a box about it is near enough
    half[straight, :2] *= _ARROW_HEAD
    half[straight, 2] /= 2 * ARROW_SIZE_OF_LENGTH
    centre[straight] += mat[straight, :, 2] * half[straight, 2:]
    depth = np.maximum((centre - origin) @ view.forward, view.near)
    half += (tolerance * view.pixel_size(1.0) * depth)[:, None]
    distance = _ray_boxes(origin, direction, centre, mat, half)
    nearest = int(np.argmin(distance))
    if not np.isfinite(distance[nearest]):
        return None
    kind = Kind(int(pen.kinds[index[nearest]]))
    item = int(pen.items[index[nearest]])
    far = float(distance[nearest])
    if kind in (Kind.AXES, Kind.NAME):
        name = world.frames.names[item]
        robot = name.partition("/")[0] if "/" in name else ""
    else:
        robot = list(world.robots)[world.joints.robot[item]]
        name = f"{robot}/{world.joints.names[item]}"
    return Picked(_KINDS[kind], name, robot, item, far)  # type: ignore[arg-type]


def _ray_boxes(origin: Array, direction: Array, centre: Array, mat: Array, half: Array) -> Array:
    """Distance along a ray to boxes (k,), inf where it misses (the slab method)."""
    start = np.einsum("kij,ki->kj", mat, origin - centre)
    along = np.einsum("kij,i->kj", mat, direction)
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    one, other = (-half - start) / along, (half - start) / along
    enter = np.minimum(one, other).max(axis=1)
    leave = np.maximum(one, other).min(axis=1)
    hit = (enter <= leave) & (leave > 0)
    return np.where(hit, np.maximum(enter, 0.0), np.inf)


def _pick_solid(
    world: World, data: mujoco.MjData, origin: Array, direction: Array
) -> Picked | None:
    geom = np.full(1, -1, np.int32)
    model = world.model
    distance = mujoco.mj_ray(model, data, origin, direction, None, 1, -1, geom, None)
    if geom[0] < 0 or model.geom_type[geom[0]] == mujoco.mjtGeom.mjGEOM_PLANE:
        return None
    body = int(model.geom_bodyid[geom[0]])
    for name, double in world.doubles.items():
        if (double.bodies == body).any():
            link = int((double.bodies == body).nonzero()[1][0])
            label = f"{name}/link{link}" if link else f"{name}/base"
            return Picked("double", label, double.robot.robot.name, -1, distance)
    while body:  # children of a link belong to it
        for name, part in world.robots.items():
            found = (part.bodies == body).nonzero()[0]
            if body == part.flange_body:
                return Picked("link", f"{name}/flange", name, part.joints.stop - 1, distance)
            if len(found):
                link = int(found[0])
                label = f"{name}/link{link}" if link else f"{name}/base"
                joint = part.joints.start + max(link - 1, 0)
                return Picked("link", label, name, joint, distance)
        body = int(model.body_parentid[body])
    return Picked("object", model.geom(int(geom[0])).name, "", -1, distance)


def click(
    world: World, toggles: Toggles, picked: Picked | None, *, all_joints: bool = False
) -> None:
    """Does what a click on something does.

    A link toggles its joint's billboard, or with `all_joints` (Shift) those of the whole robot;
    a billboard goes; an arrow brings up its precise numbers; axes show their name.

    Args:
        world: the compiled scene.
        toggles: changed in place.
        picked: what was clicked on; None does nothing.
        all_joints: whether a modifier was held.
    """
    if picked is None or picked.kind in ("object", "double"):
        return
    if picked.kind in ("axes", "name"):
        toggles.frame_names[picked.index] ^= True
    elif picked.kind == "billboard":
        toggles.billboards[picked.index] = toggles.details[picked.index] = False
    elif picked.kind == "arrow":
        toggles.details[picked.index] ^= True
    elif world.robots[picked.robot].robot.enable_touch_sensor:
        joints = world.robots[picked.robot].joints
        if all_joints:
            toggles.billboards[joints] = not toggles.billboards[joints].any()
        else:
            toggles.billboards[picked.index] ^= True


def _next_quantity(toggles: Toggles) -> None:
    toggles.arrow_quantity[:] = (toggles.arrow_quantity + 1) % len(ARROW_QUANTITIES)


def _flip(name: str) -> Callable[[Toggles], None]:
    def flip(toggles: Toggles) -> None:
        shown = getattr(toggles, name)
        shown[:] = not shown.any()

    return flip


def _flip_legend(toggles: Toggles) -> None:
    toggles.legend = not toggles.legend


# Key, what it does, and how: every host reads this one table.
KEYS: dict[str, tuple[str, Callable[[Toggles], None]]] = {
    "a": ("arrows on or off", _flip("arrows")),
    "b": ("billboards on or off", _flip("billboards")),
    "x": ("axes on or off", _flip("axes")),
    "n": ("names of all axes on or off", _flip("frame_names")),
    "q": ("arrows show the next quantity", _next_quantity),
    "l": ("legend on or off", _flip_legend),
}
