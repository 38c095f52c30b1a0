"""Converts a serial chain of joint frames to a Denavit-Hartenberg table.

Any two lines have a common normal, so every serial chain has such a table. The axes of a chain are
the z axis of the base, the joint axes, and the z axis of the flange. The common normal of two
successive axes A and B has a direction x, a foot on each axis, a length a, and an angle alpha from
A to B about x. Free parameters are chosen as usual:

- The direction x may be reversed, which inverts the signs of a and alpha. The direction closer to
  the previous x is chosen, so that theta is from -90 to 90 degrees (a = -0.0825 for the Panda).
- If two axes are parallel, their normal contains the foot of the previous normal on A.
- If two axes coincide, the same holds, and x is the previous x.

Two successive normals enclose the angle theta about their common axis, and have the distance d
along it. Row i has alpha and a of the normal before joint i (Craig), or after it (standard).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from ...base.frames import Array, Bools, frame, inverse, rotation_angles
from .dh import DhTable
from .joint_tree import JointFrames

_PARALLEL = 1e-9  # maximum angle of parallel axes, rad; the final check detects larger effects
_ZERO = 1e-12  # maximum rounding error of zero, m and rad
_TOLERANCE = 1e-9  # maximum error in every pose of the final check, m and rad
_POSES = 200  # number of poses in the final check


@dataclass(frozen=True, eq=False)
class DhChain:
    """A Denavit-Hartenberg table and frames that together replace a chain of joint frames.

    Attributes:
        rows: alpha, a, theta and d of each joint, shape (n, 4), rad and m.
        base_frame: pose of frame 0 of the table in the base frame, shape (4, 4), m.
        flange_frame: pose of the flange in frame n of the table, shape (4, 4), m.
        link_frames: pose of each original link in frame i of the table, shape (n, 4, 4), m.
    """

    convention: Literal["craig", "standard"]
    rows: Array
    base_frame: Array
    flange_frame: Array
    link_frames: Array


@dataclass(frozen=True, eq=False)
class _Normal:
    x: Array
    foot_a: Array
    foot_b: Array
    alpha: float
    a: float


def dh_from_frames(
    joint_frames: Array,
    revolute: Bools,
    flange_frame: Array | None = None,
    convention: Literal["craig", "standard"] = "craig",
) -> DhChain | None:
    """Converts a serial chain of joint frames to a Denavit-Hartenberg table.

    Returns None if frames of table and chain differ by more than 1e-9 m or rad in any of 200 poses.
    This happens if two axes are almost parallel (about 1e-6 rad), because their normal is then far
    away.

    Args:
        joint_frames: poses T_{i-1,i} of the joints relative to the previous joint or the base, at
            joint values of zero, shape (n, 4, 4), m. The joint axes are the z axes.
        revolute: whether each joint is revolute instead of prismatic, shape (n,).
        flange_frame: pose of the flange in the frame of the last joint, shape (4, 4), m (default:
            identity).
    """
    flange = np.eye(4) if flange_frame is None else flange_frame
    zero = np.zeros(len(joint_frames))
    at_zero = JointFrames(joint_frames, revolute).frames(zero)
    make = _craig if convention == "craig" else _standard
    rows, T_base_0 = make(at_zero, at_zero[-1] @ flange)
    rows[np.abs(rows) < _ZERO] = 0.0
    # The frames come from the rounded table, so that they are exact at joint values of zero.
    table = DhTable.from_rows(rows, convention, revolute=revolute)
    links = inverse(table.frames(zero, T_base_0)[1:]) @ at_zero[1:]
    chain = DhChain(convention, rows, T_base_0, links[-1] @ flange, links)
    return chain if _agrees(chain, joint_frames, revolute, flange) else None


def _craig(at_zero: Array, flange: Array) -> tuple[Array, Array]:
    normals = _normals(at_zero)
    n = len(normals)
    rows = np.zeros((n, 4))
    for i, normal in enumerate(normals):
        rows[i, :2] = normal.alpha, normal.a
        if i + 1 < n:  # The last frame is arbitrary, and is placed on the last normal.
            rows[i, 2:] = _screw(normal, normals[i + 1], at_zero[i + 1][:3, 2])
    return rows, _frame_on(at_zero[0][:3, 2], normals[0].x, normals[0].foot_a)


def _standard(at_zero: Array, flange: Array) -> tuple[Array, Array]:
    normals = _normals(np.concatenate([at_zero[1:], flange[None]]))
    rows = np.zeros((len(normals), 4))
    z = at_zero[1][:3, 2]
    # Frame 0 is arbitrary on the first axis. It is the base frame if this is the base's z axis.
    is_base = np.abs(z[:2]).max() < _ZERO and np.abs(at_zero[1][:2, 3]).max() < _ZERO and z[2] > 0
    T_base_0 = np.eye(4) if is_base else _frame_on(z, normals[0].x, normals[0].foot_a)
    before = _Normal(T_base_0[:3, 0], T_base_0[:3, 3], T_base_0[:3, 3], 0.0, 0.0)
    for i, normal in enumerate(normals):
        theta, d = _screw(before, normal, at_zero[i + 1][:3, 2])
        rows[i] = normal.alpha, normal.a, theta, d
        before = normal
    return rows, T_base_0


def _normals(axes: Array) -> list[_Normal]:
    x, foot = axes[0][:3, 0], axes[0][:3, 3]
    normals = []
    for A, B in pairwise(axes):
        normals.append(_normal(A[:3, 2], foot, B[:3, 2], B[:3, 3], x))
        x, foot = normals[-1].x, normals[-1].foot_b
    return normals


def _normal(z_a: Array, on_a: Array, z_b: Array, on_b: Array, before: Array) -> _Normal:
    """Returns the common normal of axes A and B with directions z_a and z_b.

    `on_a` is the foot of the previous normal, `before` is its direction, and `on_b` is on B.
    """
    across = np.cross(z_a, z_b)
    between = on_b - on_a
    sine = float(np.linalg.norm(across))
    foot_a = on_a
    if sine < _PARALLEL:
        x = between - (between @ z_a) * z_a
        x = x if np.linalg.norm(x) > _ZERO else before
    else:
        x = across
        # This solves on_a + s z_a + a x = on_b + t z_b in the plane perpendicular to x.
        foot_a = on_a + float(np.cross(between, z_b) @ across) / sine**2 * z_a
    x = _at_right_angles(x, z_a)
    x = x * _nearer(x, before, z_a)
    a = float(between @ x)
    a = a if abs(a) > _ZERO else 0.0
    if sine < _PARALLEL:
        alpha = 0.0 if z_a @ z_b > 0 else np.pi
    else:
        alpha = float(np.arctan2(across @ x, z_a @ z_b))
    return _Normal(x, foot_a, foot_a + a * x, alpha, a)


def _at_right_angles(x: Array, z: Array) -> Array:
    x = x - (x @ z) * z
    return x / np.linalg.norm(x)


def _nearer(x: Array, before: Array, z: Array) -> float:
    cosine, sine = before @ x, np.cross(before, x) @ z
    return 1.0 if cosine > _ZERO or (abs(cosine) <= _ZERO and sine > 0) else -1.0


def _screw(before: _Normal, normal: _Normal, z: Array) -> tuple[float, float]:
    theta = np.arctan2(np.cross(before.x, normal.x) @ z, before.x @ normal.x)
    return float(theta), float((normal.foot_a - before.foot_b) @ z)


def _frame_on(z: Array, x: Array, origin: Array) -> Array:
    x = _at_right_angles(x, z)
    T = frame(np.column_stack([x, np.cross(z, x), z]), origin)
    T[np.abs(T) < _ZERO] = 0.0
    return T


def _agrees(chain: DhChain, joint_frames: Array, revolute: Bools, flange: Array) -> bool:
    # These values are distributed like random ones, and numpy.random takes 15 ms to import.
    q = np.sin(np.outer(np.arange(_POSES), np.sqrt(np.arange(len(joint_frames)) + 1.5)))
    q *= np.where(revolute, np.pi, 1.0)
    table = DhTable.from_rows(chain.rows, chain.convention, revolute=revolute)
    found = table.frames(q, chain.base_frame)
    expected = JointFrames(joint_frames, revolute).frames(q)[:, 1:]
    links = found[:, 1:] @ chain.link_frames
    flanges = found[:, -1:] @ chain.flange_frame
    found, expected = (
        np.concatenate([links, flanges], axis=1),
        np.concatenate([expected, expected[:, -1:] @ flange], axis=1),
    )
    if np.abs(found[..., :3, 3] - expected[..., :3, 3]).max() > _TOLERANCE:
        return False
    turned = expected[..., :3, :3].mT @ found[..., :3, :3]
    return bool(rotation_angles(turned).max() < _TOLERANCE)
