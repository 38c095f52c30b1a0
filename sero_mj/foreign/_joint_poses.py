"""Poses of joint axes, for external models that have no sites at their joints."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

_PARALLEL = 1e-6  # minimum length of a unit vector's component perpendicular to an axis


@dataclass(frozen=True, eq=False)
class JointPoses:
    """Frames of some joints of a model.

    A frame is at a joint's anchor with z along the axis. Like the sites of a compiled scene it
    turns with the link, and it is parallel to the link's frame where the axis is the link's z.
    Several hinges of one body rotate in sequence.

    Attributes:
        joints: ids, (n,).
        bodies: ids of the bodies they move, (n,).
        parents: ids of their parents, (n,).
        hinge: True for hinges, False for slides, (n,).
        start: x of the frame in the parent's, at the joint's reference angle, (n, 3).
        second: y of it, used where x is along the axis, (n, 3).
        anchor: position of the joint in its body, (n, 3), m.
        qpos: index of its angle, (n,).
        reference: that angle, (n,).
        offset: from the anchor in the joint's frame, (n, 3), m.
    """

    joints: Ints
    bodies: Ints
    parents: Ints
    hinge: NDArray[np.bool_]
    start: Array
    second: Array
    anchor: Array
    qpos: Ints
    reference: Array
    offset: Array

    @classmethod
    def of(cls, model: mujoco.MjModel, joints: Ints, offset: Array) -> JointPoses:
        """Prepares the frames of joints.

        Args:
            model: compiled.
            joints: their ids, (n,).
            offset: of the frames' origins from the anchors, in the joints' frames, (n, 3), m.
        """
        bodies = model.jnt_bodyid[joints].astype(np.intp)
        frames = np.empty((len(joints), 3, 3))
        for i, joint in enumerate(joints):
            in_body, of_body = np.empty(4), np.empty(9)
            mujoco.mju_quatZ2Vec(in_body, model.jnt_axis[joint])
            quat = np.empty(4)
            mujoco.mju_mulQuat(quat, model.body_quat[bodies[i]], in_body)
            mujoco.mju_quat2Mat(of_body, quat)
            frames[i] = of_body.reshape(3, 3)
        qpos = model.jnt_qposadr[joints].astype(np.intp)
        return cls(
            joints=joints,
            bodies=bodies,
            parents=model.body_parentid[bodies].astype(np.intp),
            hinge=model.jnt_type[joints] == int(mujoco.mjtJoint.mjJNT_HINGE),
            start=frames[:, :, 0],
            second=frames[:, :, 1],
            anchor=np.array(model.jnt_pos[joints]),
            qpos=qpos,
            reference=np.array(model.qpos0[qpos]),
            offset=offset,
        )

    def place(self, data: mujoco.MjData) -> tuple[Array, Array]:
        """Computes the frames at the current joint angles.

        Args:
            data: kinematics up to date.

        Returns:
            positions (n, 3), m, and rotations (n, 3, 3).
        """
        axis = data.xaxis[self.joints]
        parent = data.xmat[self.parents].reshape(-1, 3, 3)
        body = data.xmat[self.bodies].reshape(-1, 3, 3)
        x = self._across(axis, np.einsum("nij,nj->ni", parent, self.start))
        length = np.linalg.norm(x, axis=1, keepdims=True)
        if (length < _PARALLEL).any():
            y = self._across(axis, np.einsum("nij,nj->ni", parent, self.second))
            x = np.where(length < _PARALLEL, np.cross(y, axis), x)
            length = np.linalg.norm(x, axis=1, keepdims=True)
        x = x / np.maximum(length, _PARALLEL)
        angle = np.where(self.hinge, data.qpos[self.qpos] - self.reference, 0.0)[:, None]
        x = np.cos(angle) * x + np.sin(angle) * np.cross(axis, x)
        rotation = np.stack([x, np.cross(axis, x), axis], axis=2)
        # MuJoCo's anchor of a slide does not move; its arrow moves with the link.
        along = data.xpos[self.bodies] + np.einsum("nij,nj->ni", body, self.anchor)
        at = np.where(self.hinge[:, None], data.xanchor[self.joints], along)
        return at + np.einsum("nij,nj->ni", rotation, self.offset), rotation

    @staticmethod
    def _across(axis: Array, vectors: Array) -> Array:
        """Returns the components of vectors (n, 3) perpendicular to axes (n, 3)."""
        return np.asarray(vectors - np.einsum("ni,ni->n", axis, vectors)[:, None] * axis)
