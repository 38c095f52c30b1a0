"""Finds the item at a pixel of windows, pages and images.

Robots, doubles and objects are found by `mj_ray`, and visual features by the intersection of a ray
with their geoms. The item closest to the camera is returned.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, cast

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ...robots.assemble.parts import RobotPart, robots_of_bodies
from ...robots.assemble.world_view import WorldView
from ..decor.arrow_shapes import Shape, shapes
from ..decor.geom_buffer import FIRST_SHAPE, GeomBuffer, Kind
from ..decor.handles import HANDLE_NAMES
from ..decor.image_view import ImageView

PickedKind = Literal[
    "link",
    "double",
    "object",
    "arrow",
    "billboard",
    "axes",
    "name",
    "vector",
    "card",
    "check",
    "handle",
    "limb",
]

Pixel = tuple[float, float]  # x to the right and y up from the lower left corner of an image

TOUCH_TOLERANCE = 12.0  # tolerance for touch screens, pixels
_TYPES = mujoco.mjtGeom
# Arrays are compared with numbers a hundred times faster than with members of an enum.
_BOX, _TRIANGLE, _MESH = map(int, (_TYPES.mjGEOM_BOX, _TYPES.mjGEOM_TRIANGLE, _TYPES.mjGEOM_MESH))
_MAX_HIDDEN = 200  # maximum number of hidden geoms that a ray passes
_STEP = 1e-6  # distance from the surface of a hidden geom to the next start of the ray, m


@dataclass(frozen=True)
class Picked:
    """An item that was found at a pixel.

    Attributes:
        name: name of the item, such as `lwr/A4` (arrow or billboard of a joint), `lwr/link3` or
            `table`.
        owner: name of the robot or double that the item belongs to; empty for other items.
        index: index of the joint for links, doubles, arrows and billboards, of the frame for axes
            and names, of the smart arrow for vectors and their billboards, or of the robot for
            checks; -1 for objects and paths.
        distance: distance from the camera, m.
        own_name: name of a link in the file of its robot. For other items, it equals `name`.
    """

    kind: PickedKind
    name: str
    owner: str
    index: int
    distance: float
    own_name: str = ""

    def __post_init__(self) -> None:
        if not self.own_name:
            object.__setattr__(self, "own_name", self.name)


def pick(
    world: WorldView,
    data: mujoco.MjData,
    buffer: GeomBuffer,
    view: ImageView,
    pixel: Pixel,
    tolerance: float = 0.0,
) -> Picked | None:
    """Returns the item at a pixel, or None for the sky and the floor.

    Args:
        buffer: buffer with the visual features of the displayed frame.
        pixel: pixel counted from the lower left corner of the image, x to the right and y up.
        tolerance: maximum distance from visual features if none is hit exactly, pixels. Use
            `TOUCH_TOLERANCE` for touch screens.
    """
    origin = view.position
    direction = _through(view, pixel)
    decor = _pick_decor(world, buffer, view, origin, direction, 0.0)
    solid = _pick_solid(world, data, buffer, origin, direction)
    if decor is None and tolerance:
        decor = _pick_decor(world, buffer, view, origin, direction, tolerance)
    if decor is None or solid is None:
        return decor or solid
    return decor if decor.distance <= solid.distance else solid


def _through(view: ImageView, pixel: Pixel) -> Array:
    direction = view.at(np.array(pixel, float), 1.0) - view.position
    return np.asarray(direction / np.linalg.norm(direction))


def point_at(
    world: WorldView, data: mujoco.MjData, buffer: GeomBuffer, view: ImageView, pixel: Pixel
) -> Array | None:
    """Returns the world point (3,), m, that a pixel shows, or None for the sky."""
    direction = _through(view, pixel)
    picked = pick(world, data, buffer, view, pixel)
    if picked is not None:
        return np.asarray(view.position + picked.distance * direction)
    geom = np.full(1, -1, np.int32)
    distance = mujoco.mj_ray(world.model, data, view.position, direction, None, 1, -1, geom, None)
    return None if geom[0] < 0 else np.asarray(view.position + distance * direction)


def link_at(
    world: WorldView, data: mujoco.MjData, buffer: GeomBuffer, view: ImageView, pixel: Pixel
) -> tuple[str, Array] | None:
    """Returns the frame of the robot link at a pixel, and the world point (3,), m, of the pixel.

    Visual features and doubles are ignored. Returns None if there is no link or if anything else is
    in front of it.
    """
    direction = _through(view, pixel)
    model = world.model
    hidden = np.zeros(model.ngeom, bool) if buffer.hidden is None else buffer.hidden.copy()
    for double in world.doubles.values():
        hidden |= np.isin(model.geom_bodyid, double.bodies)
    hit, distance = _ray(model, data, hidden, view.position, direction)
    body = int(model.geom_bodyid[hit]) if hit >= 0 else 0
    number = int(robots_of_bodies(model, world.robots)[body])
    found = _link_of(world, list(world.robots.values())[number], body) if number >= 0 else None
    return None if found is None else (found[0], view.position + distance * direction)


def handle_at(
    buffer: GeomBuffer, view: ImageView, pixel: Pixel, tolerance: float = 0.0
) -> int | None:
    """Returns the index in `HANDLE_NAMES` of the handle at a pixel, or None."""
    handles = buffer.kinds[: buffer.count] == Kind.HANDLE
    if not handles.any():
        return None
    direction = _through(view, pixel)
    for margin in (0.0, tolerance):
        found = _nearest_decor(handles, buffer, view, view.position, direction, margin)
        if found is not None:
            return int(buffer.items[found[0]])
    return None


def _pick_decor(
    world: WorldView,
    buffer: GeomBuffer,
    view: ImageView,
    origin: Array,
    direction: Array,
    tolerance: float,
) -> Picked | None:
    of_something = buffer.kinds[: buffer.count] != Kind.NONE
    found = _nearest_decor(of_something, buffer, view, origin, direction, tolerance)
    if found is None:
        return None
    nearest, distance = found
    kind = Kind(int(buffer.kinds[nearest]))
    return picked_of(world, kind, int(buffer.items[nearest]), distance)


def picked_of(world: WorldView, kind: Kind, item: int, distance: float = 0.0) -> Picked:
    """Returns the item with a kind, an index, and a distance from the camera in m.

    Raises:
        ValueError: there is no such item.
    """
    counts = {
        Kind.AXES: len(world.frames.names),
        Kind.NAME: len(world.frames.names),
        Kind.VECTOR: len(world.arrows.names),
        Kind.CARD: len(world.arrows.names),
        Kind.HANDLE: len(HANDLE_NAMES),
        Kind.CHECK: len(world.robots),
        Kind.PART: 0,
    }
    if kind == Kind.NONE or not 0 <= item < counts.get(kind, len(world.joints.names)):
        raise ValueError(f"found {kind.name} {item}; expected an item of a visual feature")
    name, owner = _name_of(world, kind, item)
    what = cast("PickedKind", kind.name.lower())
    return Picked(what, name, owner, item, distance)


def _nearest_decor(
    among: Bools,
    buffer: GeomBuffer,
    view: ImageView,
    origin: Array,
    direction: Array,
    tolerance: float,
) -> tuple[int, float] | None:
    rows = buffer.rows[: buffer.count]
    types = rows["type"]
    is_shape = (types == _MESH) & (rows["dataid"] >= FIRST_SHAPE)
    index = (among & ((types == _BOX) | (types == _TRIANGLE) | is_shape)).nonzero()[0]
    if not len(index):
        return None
    rows = rows[index]
    centre, half = rows["pos"].astype(float), rows["size"].astype(float)
    mat = rows["mat"].astype(float)
    depth = np.maximum((centre - origin) @ view.forward, view.near)
    margin = tolerance * view.pixel_size(1.0) * depth
    distance = ray_boxes(origin, direction, centre, mat, half + margin[:, None])
    flat = rows["type"] == _TRIANGLE
    edges = mat[flat, :, :2] * half[flat, None, :2]
    distance[flat] = ray_triangles(origin, direction, centre[flat], edges, margin[flat])
    for i in is_shape[index].nonzero()[0]:
        shape = shapes()[int(rows["dataid"][i]) - FIRST_SHAPE]
        distance[i] = ray_mesh(origin, direction, rows[i], shape, float(margin[i]))
    nearest = int(np.argmin(distance))
    if not np.isfinite(distance[nearest]):
        return None
    return int(index[nearest]), float(distance[nearest])


def _name_of(world: WorldView, kind: Kind, item: int) -> tuple[str, str]:
    if kind in (Kind.AXES, Kind.NAME):
        name = world.frames.names[item]
        return name, name.partition("/")[0] if "/" in name else ""
    if kind in (Kind.VECTOR, Kind.CARD):
        return world.arrows.names[item], ""
    if kind == Kind.HANDLE:
        return HANDLE_NAMES[item], ""
    if kind == Kind.CHECK:
        robot = list(world.robots)[item]
        return f"{robot}/flange", robot
    owner = list(world.owners)[world.joints.owner[item]]
    return f"{owner}/{world.joints.names[item]}", owner


def ray_boxes(origin: Array, direction: Array, centre: Array, mat: Array, half: Array) -> Array:
    """Returns the distances along a ray to k boxes, shape (k,), m, with inf for boxes not hit.

    Source: slab method (Kay and Kajiya, Ray Tracing Complex Scenes, 1986).
    """
    start = np.einsum("kij,ki->kj", mat, origin - centre)
    along = np.einsum("kij,i->kj", mat, direction)
    along = np.where(np.abs(along) < 1e-12, 1e-12, along)
    one, other = (-half - start) / along, (half - start) / along
    enter = np.minimum(one, other).max(axis=1)
    leave = np.maximum(one, other).min(axis=1)
    hit = (enter <= leave) & (leave > 0)
    return np.where(hit, np.maximum(enter, 0.0), np.inf)


def ray_triangles(
    origin: Array, direction: Array, corner: Array, edges: Array, margin: Array
) -> Array:
    """Returns the distances along a ray to k triangles, shape (k,), m, with inf for those not hit.

    Triangles are hit from both sides, and by rays within a distance of `margin`, shape (k,), m.

    Source: Moeller and Trumbore, "Fast, minimum storage ray-triangle intersection", Journal of
    Graphics Tools 2(1), 1997.
    """
    u, v, start = edges[..., 0], edges[..., 1], origin - corner
    across, turned = np.cross(direction, v), np.cross(start, u)
    with np.errstate(divide="ignore", invalid="ignore"):  # no hit if the ray is in the plane
        scale = 1.0 / np.einsum("ki,ki->k", u, across)
        along_u = scale * np.einsum("ki,ki->k", start, across)
        along_v = scale * (turned @ direction)
        distance = scale * np.einsum("ki,ki->k", v, turned)
        hit = (along_u >= 0.0) & (along_v >= 0.0) & (along_u + along_v <= 1.0) & (distance > 0.0)
    distance = np.where(hit, distance, np.inf)
    if not margin.any():
        return distance
    # On each side, find the point that is closest to the ray in the plane perpendicular to the ray.
    begin = np.stack([-start, -start, u - start])
    side = np.stack([u, v, v - u])
    depth, deeper = begin @ direction, side @ direction
    flat, flat_side = begin - depth[..., None] * direction, side - deeper[..., None] * direction
    length = np.maximum(np.einsum("ski,ski->sk", flat_side, flat_side), 1e-18)
    share = np.clip(-np.einsum("ski,ski->sk", flat, flat_side) / length, 0.0, 1.0)
    beside = np.linalg.norm(flat + share[..., None] * flat_side, axis=-1)
    depth += share * deeper
    near = np.where((beside <= margin) & (depth > 0), depth, np.inf)
    return np.asarray(np.minimum(distance, near.min(axis=0)))


def ray_mesh(origin: Array, direction: Array, row: Any, shape: Shape, margin: float = 0.0) -> float:
    """Returns the distance along a ray to a geom with a mesh of `arrow_shapes` in m, or inf."""
    mat, scale = row["mat"].astype(float), row["size"].astype(float)
    low, high = shape.vertices.min(axis=0) * scale, shape.vertices.max(axis=0) * scale
    middle = row["pos"] + mat @ (low + high) / 2
    around = (middle[None], mat[None], (high - low)[None] / 2 + margin)
    if not np.isfinite(ray_boxes(origin, direction, *around)[0]):
        return np.inf
    first, second, third = (row["pos"] + (shape.vertices * scale) @ mat.T)[shape.faces.T]
    edges = np.stack([second - first, third - first], axis=-1)
    margins = np.full(len(first), margin)
    return float(ray_triangles(origin, direction, first, edges, margins).min())


def _pick_solid(
    world: WorldView, data: mujoco.MjData, buffer: GeomBuffer, origin: Array, direction: Array
) -> Picked | None:
    model = world.model
    hit, distance = _ray(model, data, buffer.hidden, origin, direction)
    drawn = _pick_drawn_double(world, buffer, origin, direction)
    if drawn is not None and (hit < 0 or drawn.distance < distance):
        return drawn
    if hit < 0 or model.geom_type[hit] == mujoco.mjtGeom.mjGEOM_PLANE:
        return None
    return picked_geom(world, hit, distance)


def picked_geom(world: WorldView, geom: int, distance: float = 0.0) -> Picked:
    """Returns the robot link, double link or object that a geom of the model belongs to."""
    model = world.model
    body = int(model.geom_bodyid[geom])
    for name, double in world.doubles.items():
        if (double.bodies == body).any():
            link = int((double.bodies == body).nonzero()[1][0])
            label = f"{name}/link{link}" if link else f"{name}/base"
            own = double.of.robot.link_names
            shown = label if own is None else f"{name}/{own[link]}"
            joint = -1 if name not in world.owners else double.joints.start + max(link - 1, 0)
            return Picked("double", label, name, joint, distance, shown)
    number = int(robots_of_bodies(model, world.robots)[body])
    if number >= 0:
        name, part = list(world.robots.items())[number]
        of_robot = _link_of(world, part, body)
        if of_robot is not None:
            label, joint = of_robot
            shown = dict(zip(part.link_names, part.own_link_names, strict=True)).get(label, label)
            return Picked("link", label, name, part.joints.start + joint, distance, shown)
    return Picked("object", model.geom(geom).name, "", -1, distance)


def _link_of(world: WorldView, part: RobotPart, body: int) -> tuple[str, int] | None:
    while body:  # bodies that are attached to a link belong to this link
        found = (part.bodies == body).nonzero()[0]
        if len(found):
            link = int(found[0])
            return part.link_names[link], max(link - 1, 0)
        if body == part.flange_body:
            return part.flange_name, int(part.chain[-1])
        body = int(world.model.body_parentid[body])
    return None


def _pick_drawn_double(
    world: WorldView, buffer: GeomBuffer, origin: Array, direction: Array
) -> Picked | None:
    nearest = None
    for drawn in buffer.drawn_doubles:
        hit, distance = _ray(drawn.model, drawn.data, drawn.opacity == 0, origin, direction)
        if hit < 0 or (nearest is not None and nearest.distance <= distance):
            continue
        nearest = picked_drawn(world, drawn.double, hit, distance) or nearest
    return nearest


def picked_drawn(world: WorldView, name: str, geom: int, distance: float = 0.0) -> Picked | None:
    """Returns the picked link of a double that is drawn with the geoms of its robot.

    The model does not contain such a double. `geom` is the id of the robot's geom that was hit.
    Returns None if the geom belongs to no link of the robot.
    """
    double = world.doubles[name]
    link = _link_of(world, double.of, int(world.model.geom_bodyid[geom]))
    if link is None:
        return None
    label = f"{name}/{link[0].partition('/')[2]}"
    joint = -1 if double.path is not None else double.joints.start + link[1]
    return Picked("double", label, name, joint, distance)


def _ray(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    hidden: Bools | None,
    origin: Array,
    direction: Array,
) -> tuple[int, float]:
    geom = np.full(1, -1, np.int32)
    travelled = 0.0
    for _ in range(_MAX_HIDDEN):
        start = origin + travelled * direction
        distance = mujoco.mj_ray(model, data, start, direction, None, 1, -1, geom, None)
        hit = int(geom[0])
        if hit < 0:
            return -1, 0.0
        travelled += distance
        if hidden is None or not hidden[hit]:
            return hit, travelled
        travelled += _STEP
    return -1, 0.0
