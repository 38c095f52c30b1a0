"""Adds the sites and `userdata` that decor reads to the state of an external model.

A compiled model cannot be extended, so `ModelWorld` creates a `ModelState` for every video frame.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Ints
from ..assemble.parts import DoublePart, DrawnDouble
from ..declared.double import OUT_OF_SIGHT, fade_in, path_fade

_PARALLEL = 1e-6  # minimum perpendicular component of a unit vector that is not parallel to an axis


@dataclass(frozen=True, eq=False)
class ModelState:
    """The state of an external model with the additional fields that decor reads.

    Attributes:
        site_xpos: positions of joints, frames and fixed points, in this order, shape (S, 3), m.
        doubles: states of the model in which the robot is in the pose of a double, by name of the
            double: one state per pose of a path, otherwise one. Doubles without a pose are missing.
    """

    data: mujoco.MjData
    userdata: Array
    site_xpos: Array
    site_xmat: Array
    doubles: dict[str, list[mujoco.MjData]]
    time: float
    qpos: Array
    qvel: Array
    xpos: Array
    xmat: Array


class Sites:
    """Computes the S site poses of a `ModelState`, in the order joints, frames, fixed points.

    Args:
        joints: for each robot, "" and its joint frames, which are read from the user's data. For
            each double, its name and joint frames, which are read from the state of the double.
        frames: where to read each frame, as returned by `list_model_frames`.
        points: positions of fixed points in the world, shape (P, 3), m.
    """

    def __init__(
        self,
        joints: Sequence[tuple[str, JointPoses]],
        frames: Sequence[tuple[str, int]],
        points: Array,
    ) -> None:
        self._joints, self._points, self._count = joints, points, len(frames)
        self._frames = {  # by double: indices in `frames`, and rows to read
            name: (
                [k for k, (of, _) in enumerate(frames) if of == name],
                [row for of, row in frames if of == name],
            )
            for name in dict.fromkeys(of for of, _ in frames)
        }

    def read(
        self, data: mujoco.MjData, doubles: dict[str, list[mujoco.MjData]]
    ) -> tuple[Array, Array]:
        """Returns the positions (S, 3) in m and rotation matrices (S, 9) of all sites."""
        positions, rotations = [np.empty((0, 3))], [np.empty((0, 3, 3))]

        def state_of(name: str) -> mujoco.MjData:
            # A double without a pose is not shown, so the user's data can replace its state.
            return doubles[name][0] if name in doubles else data

        for name, joints in self._joints:
            at, turned = joints.place(state_of(name))
            positions.append(at)
            rotations.append(turned)
        at_frames, of_frames = np.empty((self._count, 3)), np.empty((self._count, 3, 3))
        for name, (mine, rows) in self._frames.items():
            state = state_of(name)
            at_frames[mine] = np.concatenate([state.xpos, state.site_xpos])[rows]
            turned = np.concatenate([state.xmat, state.site_xmat])[rows]
            of_frames[mine] = turned.reshape(-1, 3, 3)
        upright = np.broadcast_to(np.eye(3), (len(self._points), 3, 3))
        site_xpos = np.concatenate([*positions, at_frames, self._points])
        site_xmat = np.concatenate([*rotations, of_frames, upright])
        # Infinite positions of a diverged simulation cannot be drawn.
        lost = ~(np.isfinite(site_xpos).all(axis=1) & np.isfinite(site_xmat).all(axis=(1, 2)))
        if lost.any():
            site_xpos[lost], site_xmat[lost] = OUT_OF_SIGHT, np.eye(3)
        return site_xpos, site_xmat.reshape(-1, 9)


class JointPoses:
    """Computes the frames of joints, with z along the joint axis, for arrows and billboards.

    As in a compiled scene, a frame rotates with its link, and is parallel to the link frame if the
    joint axis is the z axis of the link. Several hinges of the same body rotate in sequence.
    """

    def __init__(self, model: mujoco.MjModel, joints: Ints, offset: Array) -> None:
        self._joints, self._offset = joints, offset
        self._bodies = model.jnt_bodyid[joints].astype(np.intp)
        self._parents = model.body_parentid[self._bodies].astype(np.intp)
        self._hinge = model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_HINGE)
        self._anchor = np.array(model.jnt_pos[joints])  # positions in body frames, shape (n, 3), m
        self._qpos = model.jnt_qposadr[joints].astype(np.intp)
        self._reference = np.array(model.qpos0[self._qpos])
        in_parent = np.empty((len(joints), 9))  # rotations at the reference angles
        for matrix, joint, body in zip(in_parent, joints, self._bodies, strict=True):
            quat = np.empty(4)
            mujoco.mju_quatZ2Vec(quat, model.jnt_axis[joint])
            mujoco.mju_mulQuat(quat, model.body_quat[body], quat.copy())
            mujoco.mju_quat2Mat(matrix, quat)
        # y replaces x if x is parallel to the axis.
        self._x, self._y = np.moveaxis(in_parent.reshape(-1, 3, 3), 2, 0)[:2]

    def place(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Returns the positions (n, 3) in m and rotations (n, 3, 3) of the joint frames."""
        axis = data.xaxis[self._joints]
        parent = data.xmat[self._parents].reshape(-1, 3, 3)
        body = data.xmat[self._bodies].reshape(-1, 3, 3)
        x = self._across(axis, np.einsum("nij,nj->ni", parent, self._x))
        length = np.linalg.norm(x, axis=1, keepdims=True)
        if (length < _PARALLEL).any():
            y = self._across(axis, np.einsum("nij,nj->ni", parent, self._y))
            x = np.where(length < _PARALLEL, np.cross(y, axis), x)
            length = np.linalg.norm(x, axis=1, keepdims=True)
        x = x / np.maximum(length, _PARALLEL)
        angle = np.where(self._hinge, data.qpos[self._qpos] - self._reference, 0.0)[:, None]
        x = np.cos(angle) * x + np.sin(angle) * np.cross(axis, x)
        rotation = np.stack([x, np.cross(axis, x), axis], axis=2)
        # MuJoCo's anchor of a slide does not move, but its arrow moves with the link.
        along = data.xpos[self._bodies] + np.einsum("nij,nj->ni", body, self._anchor)
        at = np.where(self._hinge[:, None], data.xanchor[self._joints], along)
        return at + np.einsum("nij,nj->ni", rotation, self._offset), rotation

    @staticmethod
    def _across(axis: Array, vectors: Array) -> Array:
        return np.asarray(vectors - np.einsum("ni,ni->n", axis, vectors)[:, None] * axis)


class ModelDoubles:
    """Computes the poses of the doubles in an external model."""

    def __init__(self, model: mujoco.MjModel, doubles: Mapping[str, DoublePart]) -> None:
        self._model = model
        self._doubles = doubles
        self._scratch = {
            name: [mujoco.MjData(model) for _ in range(1 if part.path is None else len(part.path))]
            for name, part in doubles.items()
        }

    def pose(
        self, data: mujoco.MjData, angles: Mapping[str, Array]
    ) -> dict[str, list[mujoco.MjData]]:
        """Returns `ModelState.doubles` for the user's `data`.

        `angles` contains the received joint angles, shape (n,), by name of the double. The joint
        angles of paths are declared.
        """
        poses = {}
        for name, part in self._doubles.items():
            if part.path is None and name not in angles:
                continue
            rows = [angles[name]] if part.path is None else part.path
            poses[name] = self._scratch[name]
            for scratch, row in zip(poses[name], rows, strict=True):
                scratch.qpos[:] = data.qpos
                scratch.mocap_pos[:], scratch.mocap_quat[:] = data.mocap_pos, data.mocap_quat
                scratch.qpos[part.of.qpos] = row
                mujoco.mj_kinematics(self._model, scratch)
        return poses

    def drawn(self, state: Any, name: str) -> list[DrawnDouble]:
        """Returns a double to be drawn, without links that coincide with those of its robot."""
        part = self._doubles[name]
        poses = state.doubles.get(name, [])
        mine = np.isin(self._model.body_rootid, self._model.body_rootid[part.of.bodies[1:]])
        return [
            DrawnDouble(
                name,
                self._model,
                pose,
                (mine * fade_in(pose.xpos, pose.xmat, state.data.xpos, state.data.xmat))[
                    self._model.geom_bodyid
                ],
                part.double.rgba * [1, 1, 1, share],
            )
            for pose, share in zip(poses, path_fade(len(poses)), strict=True)
        ]
