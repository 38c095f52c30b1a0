"""The bytes of a run: a JSON head and typed arrays, as `js/src/data.js` reads them.

Numbers that move are differences in time, of which the sign is the lowest bit, one channel after
the other, and bytes of one significance stand together: so deflate finds what repeats.
"""

from __future__ import annotations

import hashlib
import json
import math
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ...robots.assemble.parts import DoublePart
from ..decor import round_arrows
from ..decor.billboards import Line
from ..decor.geom_buffer import GREY
from ..decor.ribbons import ribbon_shape
from .capture import Capture, eye, geom_colours

VERSION = 1
METRE_STEP = 5e-5  # m
ROTATION_STEP = 1 / 16384  # of a component of a unit quaternion
_MESH = int(mujoco.mjtGeom.mjGEOM_MESH)
_MESH_STEPS = 65535  # of the longest side of a mesh
_NORMAL_STEPS = 127


class _Parts:
    """Arrays behind the head, known by their number."""

    def __init__(self) -> None:
        self.arrays: list[bytes] = []

    def put(self, array: np.ndarray) -> list[Any]:
        """Adds an array; returns its number, the type of its numbers, and how many there are."""
        array = np.ascontiguousarray(array)
        planes = array.reshape(-1).view(np.uint8).reshape(-1, array.itemsize).T
        self.arrays.append(planes.tobytes())
        return [len(self.arrays) - 1, array.dtype.str[1:], array.size]

    def moving(self, numbers: np.ndarray, step: float) -> list[Any]:
        """Adds channels (F, C) in steps, as differences in time."""
        whole = np.round(numbers / step).astype(np.int64)
        differences = np.diff(whole, axis=0, prepend=0).T
        return self.put(_unsigned(_folded(differences)))


def encode(capture: Capture, title: str) -> bytes:
    """Returns the bytes of a run, not compressed.

    Args:
        capture: the run.
        title: what it is, for people.
    """
    parts, model = _Parts(), capture.world.model
    frames = capture.frames
    opacity = np.round(capture.opacity * 255)
    meshes: list[dict[str, Any]] = []
    geoms = _geoms(capture, parts, meshes)
    head = {
        "version": VERSION,
        "title": title,
        "look": capture.world.scene.view.look,
        "fps": capture.fps,
        "begin": capture.begin,
        "frames": frames,
        "steps": [METRE_STEP, ROTATION_STEP],
        "eye": eye(capture),
        "cameras": _cameras(capture),
        "bodies": _bodies(capture),
        "positions": parts.moving(capture.positions.reshape(frames, -1), METRE_STEP),
        "rotations": parts.moving(capture.rotations.reshape(frames, -1), ROTATION_STEP),
        "opacity": parts.moving(opacity, 1),
        "grey": parts.moving(capture.grey, 1),
        "greyRgb": GREY,
        "meshes": meshes,
        "geoms": geoms,
        "floor": _floor(model),
        "joints": _joints(capture),
        "values": {
            key: parts.put(each.T) for key, each in capture.values.items() if key != "torque_error"
        },
        "arrows": _arrows(capture, parts),
        "items": _items(capture, parts),
        "notes": _texts(capture.notes, parts),
        "cards": [
            {"item": item, "name": capture.world.arrows.names[item], **_texts(texts, parts)}
            for item, texts in capture.cards.items()
        ],
        "vectors": capture.world.arrows.names,
        "marks": [vars(mark) for mark in capture.marks],
        "switches": _switches(capture),
        "silent": capture.silent,
    }
    head["lengths"] = [len(each) for each in parts.arrays]
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    return b"".join([len(text).to_bytes(4, "little"), text, *parts.arrays])


def _folded(differences: Ints) -> Ints:
    """Small numbers of either sign as small numbers."""
    return np.asarray((differences << 1) ^ (differences >> 63))


def _unsigned(numbers: Ints) -> np.ndarray:
    for kind in (np.uint8, np.uint16):
        if numbers.max(initial=0) <= np.iinfo(kind).max:
            return numbers.astype(kind)
    return numbers.astype(np.uint32)


def _rounded(numbers: Any, digits: int = 6) -> list[Any]:
    found: list[Any] = np.round(np.asarray(numbers, float), digits).tolist()
    return found


def _finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None


def _index(capture: Capture, body: int) -> int:
    return int(np.searchsorted(capture.bodies, body))


def _bodies(capture: Capture) -> list[dict[str, Any]]:
    """Name of every body, the joint that moves it and the double that it is part of; else -1."""
    world, found = capture.world, []
    doubles = list(world.doubles)
    of: dict[int, tuple[int, int]] = {}
    for name, part in world.owners.items():
        double = doubles.index(name) if isinstance(part, DoublePart) else -1
        for row in np.atleast_2d(part.bodies):
            for k, body in enumerate(row.tolist()):
                joint = part.joints.start + k - 1 if k and part.joints.stop else -1
                of[body] = (joint, double)
    for name, part in world.doubles.items():  # paths have no joints and are no owners
        for body in np.ravel(part.bodies).tolist():
            of.setdefault(body, (-1, doubles.index(name)))
    for body in capture.bodies.tolist():
        joint, double = of.get(body, (-1, -1))
        name = world.model.body(body).name
        found.append({"name": name, "joint": joint, "double": double})
    return found


def _cameras(capture: Capture) -> list[dict[str, Any]]:
    model = capture.world.model
    return [
        {
            "name": model.camera(i).name,
            "body": _index(capture, int(model.cam_bodyid[i])),
            "pos": _rounded(model.cam_pos[i]),
            "quat": _rounded(model.cam_quat[i]),
            "fovy": round(float(model.cam_fovy[i]), 3),
        }
        for i in range(model.ncam)
    ]


def _floor(model: mujoco.MjModel) -> float | None:
    """The height of the floor, m; None for no floor."""
    planes = (model.geom_type == int(mujoco.mjtGeom.mjGEOM_PLANE)).nonzero()[0]
    return float(model.geom_pos[planes[0], 2]) if len(planes) else None


def _geoms(capture: Capture, parts: _Parts, meshes: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Shape, place, body and colour of every geom; meshes that are equal are there once."""
    model, colours, found = capture.world.model, geom_colours(capture.world.model), []
    known: dict[Any, int] = {}
    for i in capture.geoms.tolist():
        geom = {
            "body": _index(capture, int(model.geom_bodyid[i])),
            "type": int(model.geom_type[i]),
            "pos": _rounded(model.geom_pos[i]),
            "quat": _rounded(model.geom_quat[i]),
            "size": _rounded(model.geom_size[i]),
            "rgba": np.round(colours[i] * 255).astype(int).tolist(),
        }
        if geom["type"] == _MESH:
            geom["mesh"] = _mesh(model, int(model.geom_dataid[i]), parts, meshes, known)
        found.append(geom)
    return found


def mesh_corners(model: mujoco.MjModel, mesh: int) -> tuple[Array, Array, Ints]:
    """Returns vertices (n, 3), m, normals (n, 3), and the triangles' corners (3 m,) of a mesh."""
    vertex, normal = model.mesh_vertadr[mesh], model.mesh_normaladr[mesh]
    face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    corners = model.mesh_face[face : face + faces].ravel()
    facing = model.mesh_facenormal[face : face + faces].ravel()
    pairs, first, index = np.unique(
        np.stack([corners, facing], axis=1), axis=0, return_index=True, return_inverse=True
    )
    # In the order of first use, indices become small differences.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    pairs = pairs[order]
    points = model.mesh_vert[vertex : vertex + model.mesh_vertnum[mesh]][pairs[:, 0]]
    normals = model.mesh_normal[normal : normal + model.mesh_normalnum[mesh]][pairs[:, 1]]
    return points.astype(float), normals.astype(float), rank[index.ravel()]


def _mesh(
    model: mujoco.MjModel,
    mesh: int,
    parts: _Parts,
    meshes: list[dict[str, Any]],
    known: dict[Any, int],
) -> int:
    if mesh in known:
        return known[mesh]
    points, normals, index = mesh_corners(model, mesh)
    key = hashlib.sha256(points.tobytes() + normals.tobytes() + index.tobytes()).digest()
    if key not in known:
        low = points.min(axis=0)
        step = max(float(np.ptp(points, axis=0).max()) / _MESH_STEPS, 1e-9)
        places = np.round((points - low) / step).astype(np.int64)
        known[key] = len(meshes)
        meshes.append(
            {
                "low": low.tolist(),
                "step": step,
                "vertices": parts.put(_differences(places.T).astype(np.uint16)),
                "normals": parts.put(_octahedral(normals)),
                "triangles": parts.put(_unsigned(_folded(np.diff(index, prepend=0)))),
            }
        )
    known[mesh] = known[key]
    return known[key]


def _differences(places: Array) -> Array:
    return np.asarray(np.diff(places, axis=1, prepend=0) % (_MESH_STEPS + 1))


def _octahedral(normals: Array) -> np.ndarray:
    """Unit vectors (n, 3) on the square to which an octahedron unfolds, (2, n)."""
    normals = normals / np.maximum(np.abs(normals).sum(axis=1, keepdims=True), 1e-12)
    over = (1 - np.abs(normals[:, 1::-1])) * np.where(normals[:, :2] >= 0, 1, -1)
    square = np.where(normals[:, 2:] < 0, over, normals[:, :2])
    return np.round(square.T * _NORMAL_STEPS).astype(np.int8)


def _joints(capture: Capture) -> list[dict[str, Any]]:
    world, joints = capture.world, capture.world.joints
    model, doubles = world.model, list(world.doubles)
    owners = list(world.owners)
    has_load = np.isinf(capture.limit) & np.isfinite(joints.arrow_load)
    scale = np.where(has_load, joints.arrow_radius / joints.arrow_load, joints.arrow_width_scale)
    narrow = joints.arrow_width_scale / round_arrows.DEFAULT_WIDTH_SCALE
    widest = round_arrows.WIDEST * np.where(has_load, np.minimum(narrow, 1.0), 1.0)
    found = []
    for i, name in enumerate(capture.joint_names):
        site, owner = joints.centre_site[i], owners[joints.owner[i]]
        found.append(
            {
                "name": name,
                "unit": "Nm" if joints.revolute[i] else "N",
                "angleUnit": "rad" if joints.revolute[i] else "m",
                "double": doubles.index(owner) if owner in doubles else -1,
                "body": _index(capture, int(model.site_bodyid[site])),
                "pos": _rounded(model.site_pos[site]),
                "quat": _rounded(model.site_quat[site]),
                "torqueLimit": _finite(joints.torque_limit[i]),
                "lines": _lines(capture.lines[i]),
                "details": _lines(capture.details[i]),
                "card": bool(capture.toggles.billboards[i]),
                "arrow": {
                    "on": bool(capture.toggles.arrows[i]),
                    "round": bool(joints.revolute[i]),
                    "radius": round(float(joints.arrow_radius[i]), 6),
                    "opacity": round(float(joints.arrow_alpha[i]), 3),
                    "scale": float(scale[i]),
                    "band": float(joints.arrow_dead_band[i]),
                    "limit": _finite(capture.limit[i]),
                    "widest": float(widest[i]),
                },
            }
        )
    return found


def _lines(lines: list[Line]) -> list[dict[str, Any]]:
    """What a card says: label, value, and how it is written."""
    title = lines[0].head.split("  ")[0] if lines else ""
    return [
        {
            "title": title,
            "label": line.head.removeprefix(title).strip(),
            "key": line.key,
            "scale": line.scale,
            "decimals": line.decimals,
            "unit": line.form.partition("f")[2].strip().replace("%%", "%"),
        }
        for line in lines
    ]


def _arrows(capture: Capture, parts: _Parts) -> dict[str, Any]:
    """Shape and colours of round arrows, and their values where these are not the torques."""
    shape = ribbon_shape(round_arrows.ARROW_GEOMS)
    names = ("middle", "half_angle", "rings", "own", "flare", "triangles")
    torques = capture.values.get("torques")
    is_torque = torques is not None and np.array_equal(capture.arrows, torques, equal_nan=True)
    return {
        "shape": {name: _rounded(getattr(shape, name)) for name in names}
        | {"dark": np.asarray(shape.dark).astype(int).tolist()},
        "values": None if is_torque else parts.put(capture.arrows.T),
        "stale": parts.moving(capture.stale, 1),
        "speed": round_arrows.TURNING_SPEED,
        "invisible": round_arrows.INVISIBLE_WIDTH,
        "positive": round_arrows.POSITIVE_RGBA[:3],
        "negative": round_arrows.NEGATIVE_RGBA[:3],
    }


def _items(capture: Capture, parts: _Parts) -> dict[str, Any]:
    """Decor as it stands in an `MjvScene`: type, pose, size, colour, of every frame."""
    items = capture.items
    if not items:
        return {"of": []}
    rows = np.stack([item.rows for item in items], axis=1)
    count = len(rows), -1
    quaternions = np.zeros((*rows.shape, 4))
    quaternions[..., 0] = 1.0
    visible = np.stack([item.visible for item in items], axis=1)
    for k, i in np.argwhere(visible):
        mujoco.mju_mat2Quat(quaternions[k, i], rows["mat"][k, i].astype(float).ravel())
    colours = np.round(np.clip(rows["rgba"], 0, 1) * 255)
    return {
        "of": [[int(each.kind), each.item, _type(each)] for each in items],
        "visible": parts.moving(visible, 1),
        "positions": parts.moving(rows["pos"].reshape(count), METRE_STEP),
        "rotations": parts.moving(quaternions.reshape(count), ROTATION_STEP),
        "sizes": parts.moving(rows["size"].reshape(count), METRE_STEP),
        "colours": parts.moving(colours.reshape(count), 1),
    }


def _type(item: Any) -> int:
    return int(item.rows["type"][item.visible.argmax()])


def _texts(texts: list[str], parts: _Parts) -> dict[str, Any]:
    """Texts once each, and which one every frame has."""
    unique = list(dict.fromkeys(texts))
    number = {text: k for k, text in enumerate(unique)}
    at = np.array([[number[text]] for text in texts])
    return {"texts": unique, "at": parts.moving(at, 1)}


def _switches(capture: Capture) -> dict[str, bool]:
    """What is on at first."""
    toggles = capture.toggles
    return {
        "arrows": bool(toggles.arrows.any()),
        "numbers": bool(toggles.billboards.any()),
        "doubles": bool(toggles.doubles.all()),
        "legend": bool(toggles.legend),
    }
