"""Encodes a run as a JSON head and typed arrays, which `js/src/data.js` decodes."""

from __future__ import annotations

import json
import math
from itertools import groupby
from typing import Any

import numpy as np

from ...base.frames import Array
from ...robots.assemble.parts import DoublePart
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from ..decor import arrow_shapes, round_arrows
from ..decor.billboards import LineFormat, has_chosen_lines
from ..decor.geom_buffer import FIRST_SHAPE, GREY, Kind
from ..decor.legend import arrows_line
from ..decor.quantities import QUANTITY_NAMES, torque_and_unit
from .capture import CapturedRun, Mark, eye
from .frame import Labels
from .model import Look
from .packing import PackedArrays, differing, poses, rounded, types_of
from .surroundings import surroundings_head

VERSION = 1
METRE_STEP = 5e-5  # resolution of positions, m
_SHAPE_STEP = 1 / 4096  # resolution of the meshes of arrows and axes, of their radius or length
ROTATION_STEP = 1 / 16384  # resolution of the components of unit quaternions
_SWITCHABLE = ("torques", "torque_error")  # quantities that the user can choose for arrows


def encode(capture: CapturedRun, title: str) -> bytes:
    """Returns a run as uncompressed bytes in the format of the player."""
    parts = PackedArrays()
    frames = capture.frames
    opacity = np.round(capture.opacity * 255)
    look = Look(capture.world.model, parts, lambda body: _index(capture, body))
    head = {
        "version": VERSION,
        "title": title,
        "fps": capture.fps,
        "begin": capture.begin,
        "frames": frames,
        "steps": [METRE_STEP, ROTATION_STEP],
        "eye": eye(capture),
        "cameras": _cameras(capture),
        **({} if capture.path is None else {"follow": parts.moving(capture.path, METRE_STEP)}),
        "bodies": _bodies(capture),
        "positions": parts.moving(capture.positions.reshape(frames, -1), METRE_STEP),
        "rotations": parts.moving(capture.rotations.reshape(frames, -1), ROTATION_STEP),
        "opacity": parts.moving(opacity, 1),
        "grey": parts.moving(capture.grey, 1),
        "greyRgb": GREY,
        **_look(capture, look),
        "surroundings": surroundings_head(capture.world),
        **capture.soft.head(parts, METRE_STEP),
        "joints": _joints(capture),
        "values": {
            key: parts.put(each.T) for key, each in capture.values.items() if key != "torque_error"
        },
        "arrows": _arrows(capture, parts),
        "items": _items(capture, parts),
        **_labels(capture.labels, parts, METRE_STEP),
        "notes": _texts(capture.notes, parts),
        "legend": _legend(capture, parts),
        "cards": [
            {"item": item, "name": capture.world.arrows.names[item], **_texts(texts, parts)}
            for item, texts in capture.arrow_texts.items()
        ],
        "vectors": capture.world.arrows.names,
        "marks": [_mark(mark) for mark in capture.marks],
        "meanings": dict(capture.meanings),
        "switches": _switches(capture),
        "silent": capture.silent,
    }
    head["lengths"] = [len(each) for each in parts.arrays]
    text = json.dumps(head, separators=(",", ":"), allow_nan=False).encode()
    return b"".join([len(text).to_bytes(4, "little"), text, *parts.arrays])


def _mark(mark: Mark) -> dict[str, Any]:
    return vars(mark) | {"plot": None if mark.plot is None else vars(mark.plot)}


def _look(capture: CapturedRun, look: Look) -> dict[str, Any]:
    found = look.head()
    of_geoms = capture.world.model.geom_bodyid
    for number, copied in enumerate(capture.copies, len(capture.bodies)):
        for geom in capture.geoms[of_geoms[capture.geoms] == copied.body].tolist():
            found["geoms"].append(look.copied(geom, number, copied.rgba))
    return found


def _finite(number: float) -> float | None:
    return float(number) if math.isfinite(number) else None


def _index(capture: CapturedRun, body: int) -> int:
    return int(np.searchsorted(capture.bodies, body))


def _bodies(capture: CapturedRun) -> list[dict[str, Any]]:
    """Returns the name of each body, the indices of its joint and double, and whether it moves.

    An index is -1 if the body belongs to no joint or double.
    """
    world, found = capture.world, []
    doubles = list(world.doubles)
    of: dict[int, tuple[int, int]] = {}
    for name, part in world.owners.items():
        double = doubles.index(name) if isinstance(part, DoublePart) else -1
        for row in np.atleast_2d(part.bodies):
            for k, body in enumerate(row.tolist()):
                joint = part.joints.start + k - 1 if k and part.joints.stop else -1
                of[body] = (joint, double)
    for name, part in world.doubles.items():  # Paths have no joints, so they are not in owners.
        for body in np.ravel(part.bodies).tolist():
            of.setdefault(body, (-1, doubles.index(name)))
    model = world.model
    of_mocap = model.body_mocapid[model.body_rootid] >= 0
    moves = ((model.body_weldid > 0) | of_mocap).tolist()
    for body in capture.bodies.tolist():
        joint, double = of.get(body, (-1, -1))
        name = world.model.body(body).name
        found.append({"name": name, "joint": joint, "double": double, "moves": moves[body]})
    for copied in capture.copies:
        found.append({"name": copied.name, "joint": -1, "double": copied.double, "moves": True})
    return found


def _cameras(capture: CapturedRun) -> list[dict[str, Any]]:
    model = capture.world.model
    return [
        {
            "name": model.camera(i).name,
            "body": _index(capture, int(model.cam_bodyid[i])),
            "pos": rounded(model.cam_pos[i]),
            "quat": rounded(model.cam_quat[i]),
            "fovy": round(float(model.cam_fovy[i]), 3),
        }
        for i in range(model.ncam)
    ]


def _joints(capture: CapturedRun) -> list[dict[str, Any]]:
    world, joints = capture.world, capture.world.joints
    doubles, owners = list(world.doubles), list(world.owners)
    looks = arrow_looks(world, capture.limit)
    found = []
    for i, name in enumerate(capture.joint_names):
        owner = owners[joints.owner[i]]
        what, (factor, unit) = torque_and_unit(world, i)
        found.append(
            {
                "name": name,
                "torqueLabel": f"{what} [{unit}]",
                "torqueFactor": factor,
                "angleUnit": "rad" if joints.revolute[i] else "m",
                "double": doubles.index(owner) if owner in doubles else -1,
                **_place(capture, int(joints.centre_site[i])),
                "torqueLimit": _finite(joints.torque_limit[i]),
                "lines": _lines(capture.lines[i]),
                "details": _lines(capture.details[i]),
                "card": bool(capture.toggles.billboards[i]),
                "follows": not has_chosen_lines(world.owners[owner]),
                "arrow": {
                    "on": bool(capture.toggles.arrows[i]),
                    "round": bool(joints.revolute[i]),
                    **looks[i],
                },
            }
        )
    return found


def _place(capture: CapturedRun, site: int) -> dict[str, Any]:
    if not capture.world.has_sites:
        return {"body": 0, "pos": [0, 0, 0], "quat": [1, 0, 0, 0]}
    model = capture.world.model
    return {
        "body": _index(capture, int(model.site_bodyid[site])),
        "pos": rounded(model.site_pos[site]),
        "quat": rounded(model.site_quat[site]),
    }


def arrow_looks(world: WorldView, limit: Array) -> list[dict[str, Any]]:
    """Returns the radius, the opacity and the width parameters of each joint's arrow."""
    joints = world.joints
    has_load = np.isinf(limit) & np.isfinite(joints.arrow_load)
    full = round_arrows.FULL_WIDTH * joints.arrow_radius
    scale = np.where(has_load, full / joints.arrow_load, joints.arrow_width_scale)
    narrow = joints.arrow_width_scale / round_arrows.DEFAULT_WIDTH_SCALE
    widest = round_arrows.WIDEST * np.where(has_load, np.minimum(narrow, 1.0), 1.0)
    return [
        {
            "radius": round(float(joints.arrow_radius[i]), 6),
            "opacity": round(float(joints.arrow_alpha[i]), 3),
            "scale": float(scale[i]),
            "band": float(joints.arrow_dead_band[i]),
            "limit": _finite(limit[i]),
            "widest": float(widest[i]),
        }
        for i in range(len(joints.names))
    ]


def _lines(lines: list[LineFormat]) -> list[dict[str, Any]]:
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


def _arrows(capture: CapturedRun, parts: PackedArrays) -> dict[str, Any]:
    torques = capture.values.get("torques")
    is_torque = torques is not None and np.array_equal(capture.arrows, torques, equal_nan=True)
    return {
        "shapes": _shapes(parts),
        "ratios": arrow_shapes.RATIOS.tolist(),
        "stripe": arrow_shapes.STRIPE_RGB,
        "values": None if is_torque else parts.put(capture.arrows.T),
        "quantities": _quantities(capture),
        "stale": parts.moving(capture.stale, 1),
        "speed": round_arrows.TURNING_SPEED,
        "full": round_arrows.FULL_WIDTH,
        "invisible": round_arrows.INVISIBLE_WIDTH,
        "straight": {
            "length": round_arrows.STRAIGHT_LENGTH,
            "headWidth": arrow_shapes.STRAIGHT_HEAD_WIDTH,
            "headLength": arrow_shapes.STRAIGHT_HEAD_LENGTH,
            "longestHead": arrow_shapes.LONGEST_HEAD,
            "barbs": arrow_shapes.HEAD_BARBS,
            "darker": arrow_shapes.DARKER,
            "shaft": FIRST_SHAPE + arrow_shapes.SHAFT,
            "head": FIRST_SHAPE + arrow_shapes.HEAD,
        },
        "positive": round_arrows.POSITIVE_RGBA[:3],
        "negative": round_arrows.NEGATIVE_RGBA[:3],
    }


def _shapes(parts: PackedArrays) -> dict[str, Any]:
    """Returns the meshes of arrows and axes, in groups of meshes that share their faces."""
    groups = [
        (np.stack([each.vertices.ravel() for each in group]), np.frombuffer(faces, np.intp))
        for faces, shapes in groupby(arrow_shapes.shapes(), lambda each: each.faces.tobytes())
        if (group := list(shapes))
    ]
    return {
        "first": FIRST_SHAPE,
        "step": _SHAPE_STEP,
        "groups": [
            {
                "count": len(vertices),
                "vertices": parts.moving(vertices, _SHAPE_STEP),
                "faces": parts.put(differing(faces)),
            }
            for vertices, faces in groups
        ],
    }


def _quantities(capture: CapturedRun) -> list[dict[str, str]]:
    """Returns the quantities that the user can choose for arrows, with the current one first.

    If both are recorded, arrows can show the torque or the torque error. The list is empty if
    there is no choice, as for arrows that show the error between two runs.
    """
    joints, toggles = capture.world.joints, capture.toggles
    lines = [line for owner in capture.world.owners.values()
             for line in owner.declared.billboard_lines or ()]  # fmt: skip
    if any(line.value == "torque_error" and line.label for line in lines):
        return []
    shown = {ARROW_QUANTITIES[code] for code in toggles.arrow_quantity.tolist()}
    has_both = {"torques", "commanded_torques"} <= capture.values.keys()
    if not (has_both and len(shown) == 1 and shown <= {*_SWITCHABLE}):
        return []
    own = shown.pop()
    has_sliding = not joints.revolute[toggles.arrows].all()
    return [
        {"key": key, "name": QUANTITY_NAMES[key], "line": arrows_line(key, has_sliding)}
        for key in sorted(_SWITCHABLE, key=lambda key: key != own)
    ]


def _items(capture: CapturedRun, parts: PackedArrays) -> dict[str, Any]:
    items = capture.items
    if not items:
        return {"of": []}
    rows = np.stack([item.rows for item in items], axis=1)
    count = len(rows), -1
    quaternions = np.zeros((*rows.shape, 4))
    quaternions[..., 0] = 1.0
    visible = np.stack([item.visible for item in items], axis=1)
    sizes = np.zeros((*rows.shape, 3))
    quaternions[visible], sizes[visible] = poses(rows[visible])
    colours = np.round(np.clip(rows["rgba"], 0, 1) * 255)
    return {
        "of": [[int(each.kind), each.item, _type(each)] for each in items],
        "visible": parts.moving(visible, 1),
        "positions": parts.moving(rows["pos"].reshape(count), METRE_STEP),
        "rotations": parts.moving(quaternions.reshape(count), ROTATION_STEP),
        "sizes": parts.moving(sizes.reshape(count), METRE_STEP),
        "colours": parts.moving(colours.reshape(count), 1),
    }


def _type(item: Any) -> int:
    return int(types_of(item.rows)[item.visible.argmax()])


def _legend(capture: CapturedRun, parts: PackedArrays) -> dict[str, Any]:
    """Returns the legend of each frame, with None for the line that names the arrows' quantity.

    The player writes this line, because its user can choose the quantity.
    """
    own = {quantity["line"] for quantity in _quantities(capture)[:1]}
    found = _texts(capture.legend, parts)
    texts = [text.split("\n") if text else [] for text in found["texts"]]
    return found | {"texts": [[None if line in own else line for line in each] for each in texts]}


def _texts(texts: list[str], parts: PackedArrays) -> dict[str, Any]:
    """Returns the distinct texts, and the index of the text of each frame."""
    unique = list(dict.fromkeys(texts))
    number = {text: k for k, text in enumerate(unique)}
    at = np.array([[number[text]] for text in texts])
    return {"texts": unique, "at": parts.moving(at, 1)}


def _switches(capture: CapturedRun) -> dict[str, bool]:
    toggles = capture.toggles
    return {
        "arrows": bool(toggles.arrows.any())
        or any(item.kind in (Kind.ARROW, Kind.VECTOR) for item in capture.items),
        "numbers": bool(toggles.billboards.any()),
        "doubles": bool(toggles.doubles.all()),
        "legend": bool(toggles.legend),
    }


def _labels(frames: list[Labels], parts: PackedArrays, step: float) -> dict[str, Any]:
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
