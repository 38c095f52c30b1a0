"""Where the axes of joints are, for models that have no sites there."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

_PARALLEL = 1e-6  # length of what is left of a unit vector when its part along an axis is taken off


@dataclass(frozen=True, eq=False)
class JointPoses:
    """Some joints of a model, ready to be placed.

    A frame stands at a joint's anchor, its z along the axis; like the sites of our own robots it
    turns with the link, and it is the link's own frame where the axis is the link's z. Hinges of
    one body turn one after the other.

    Attributes:
        joints: ids, (n,).
        bodies: what they move, (n,).
        parents: what these hang on, (n,).
        hinge: whether it turns, (n,).
        start: x of the frame in the parent's, at the joint's reference angle, (n, 3).
        second: y of it, for the case that x lies along the axis, (n, 3).
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
        """Prepares joints (n,); offsets (n, 3) in m are in the frames of the joints."""
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
        """Places the frames.

        Args:
            data: with frames up to date.

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
        # MuJoCo's anchor of a slide stays behind; its arrow goes along with the link.
        along = data.xpos[self.bodies] + np.einsum("nij,nj->ni", body, self.anchor)
        at = np.where(self.hinge[:, None], data.xanchor[self.joints], along)
        return at + np.einsum("nij,nj->ni", rotation, self.offset), rotation

    @staticmethod
    def _across(axis: Array, vectors: Array) -> Array:
        """What of vectors (n, 3) is square to axes (n, 3)."""
        return np.asarray(vectors - np.einsum("ni,ni->n", axis, vectors)[:, None] * axis)
