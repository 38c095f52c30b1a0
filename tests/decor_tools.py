"""Functions that the decor tests share: a world with all inputs set, and a view without OpenGL."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.arrow_shapes import BANDS, HEAD, RATIOS, SHAFT, shapes
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import FIRST_SHAPE, GeomBuffer, Kind
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.status import Status
from sero_mj.viewer.decor.toggles import Toggles

GEOM = mujoco.mjtGeom


def world_of(**fields: Any) -> World:
    """Returns a world with one LWR, in which `fields` are overridden."""
    return World(Scene(robots=[SerialRobot.from_model("lwr", **fields)], floor=False))


def view_at(
    azimuth: float = 0.7, distance: float = 2.5, width: int = 1280, height: int = 800
) -> ImageView:
    """Returns a horizontal view of the middle of a standing LWR."""
    forward = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    return ImageView(
        position=np.array([0.0, 0.0, 0.6]) - distance * forward,
        right=np.cross(forward, up),
        up=up,
        forward=forward,
        tan_half_fovy=float(np.tan(np.deg2rad(22.5))),
        near=0.02,
        width=width,
        height=height,
    )


def toggles_of(world: World) -> Toggles:
    """Returns the toggles that the world declares, without the legend."""
    toggles = Toggles(world)
    toggles.legend = False
    return toggles


def drawn(world: World, view: ImageView | None = None, **shown: bool) -> Any:
    """Returns the rows that decor draws for a world as declared, with features set by name."""
    data = world.make_data()
    toggles = toggles_of(world)
    for name, value in shown.items():
        getattr(toggles, name)[:] = value
    buffer = Decor(world).draw(data, toggles, view or view_at())
    return buffer.rows[: buffer.count]


def of_kind(rows: Any, kind: Any) -> Any:
    """Returns the rows of one geom type."""
    return rows[rows["type"] == int(kind)]


def labels(rows: Any) -> list[str]:
    """Returns all text in drawing order."""
    return [row["label"].decode() for row in of_kind(rows, GEOM.mjGEOM_LABEL)]


def look(position: Any, at: Any, width: int = 1280, height: int = 800) -> ImageView:
    """Returns a view from one point to another; not for straight up or down."""
    position = np.array(position, float)
    forward = np.array(at, float) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    tan = float(np.tan(np.deg2rad(22.5)))
    return ImageView(position, right, up, forward, tan, 0.02, width, height)


def turned(axis: Any, angle: float) -> Any:
    """Returns a rotation matrix about an axis by Rodrigues' formula."""
    x, y, z = np.array(axis, float) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def rigid(rotation: Any, position: Any) -> Any:
    """Returns the frame with a rotation and a position."""
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation, position
    return T


def belonging(buffer: GeomBuffer, kind: Kind, item: int | None = None) -> Any:
    """Returns the rows of all items of one kind, or of one item."""
    these = buffer.kinds[: buffer.count] == kind
    if item is not None:
        these &= buffer.items[: buffer.count] == item
    return buffer.rows[: buffer.count][these]


def shape_index(rows: Any) -> Any:
    """Returns the indices of the meshes of arrows and axes."""
    assert (rows["type"] == int(GEOM.mjGEOM_MESH)).all()
    return rows["dataid"] - FIRST_SHAPE


def rounds(rows: Any) -> Any:
    """Returns the rows of round arrows, without their dark bands."""
    return rows[(rows["dataid"] >= FIRST_SHAPE) & (rows["dataid"] < FIRST_SHAPE + BANDS)]


def bands(rows: Any) -> Any:
    return rows[(rows["dataid"] >= FIRST_SHAPE + BANDS) & (rows["dataid"] < FIRST_SHAPE + SHAFT)]


def heads(rows: Any) -> Any:
    """Returns the rows of the heads of straight arrows."""
    return rows[rows["dataid"] == FIRST_SHAPE + HEAD]


def width_of(row: Any) -> float:
    """Returns the maximum width of the tube of a round arrow, m."""
    return float(row["size"][2] * RATIOS[int(shape_index(row))])


def length_of(pair: Any) -> float:
    """Returns the length of a straight arrow, a shaft and a head, m."""
    return float(np.linalg.norm(tip_of(pair) - pair["pos"][0]))


def tip_of(pair: Any) -> Any:
    _, head = pair
    assert shape_index(pair).tolist() == [SHAFT, HEAD]
    return (head["pos"] + head["mat"][:, 2] * head["size"][2]).astype(float)


def vertices_of(row: Any) -> Any:
    """Returns the vertices of an arrow or axis in the world, shape (v, 3), m."""
    vertices, _ = shapes()[int(shape_index(row))]
    return row["pos"] + (vertices * row["size"]) @ row["mat"].astype(float).T


def rectangle(view: ImageView, row: Any) -> tuple[Any, Any]:
    """Returns the lower left and upper right pixel of a panel."""
    half = row["mat"][:, :2] @ row["size"][:2]
    corners, _ = view.project(np.array([row["pos"] - half, row["pos"] + half], float))
    return corners[0], corners[1]


def texts_in(view: ImageView, rows: Any, panel: Any) -> list[str]:
    """Returns the texts on one panel from top to bottom."""
    low, high = rectangle(view, panel)
    found = []
    for row in of_kind(rows, GEOM.mjGEOM_LABEL):
        start, _ = view.project(row["pos"].astype(float))
        if (start >= low - 0.5).all() and (start <= high + 0.5).all():
            found.append((-start[1], row["label"].decode()))
    return [text for _, text in sorted(found)]


def corner_lines(mirror: Mirror) -> list[str]:
    """Returns the text lines of the panel in the upper left corner."""
    panels = Status(mirror.world).panels(mirror.data, Toggles(mirror.world), view_at())
    return [] if panels is None else [text.decode() for text in panels.texts[0]]
