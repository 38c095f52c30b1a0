"""`ModelState`: the state that decor reads, for an external model.

Decor reads the poses of sites and the contents of `userdata`. An external model has no sites and
slots for decor, and neither can be added to a compiled model. So `ModelWorld` creates this object
for every frame: it has the fields of `MjData` that decor reads, with a site for every joint and
frame, and a `userdata` array of its own. The user's model and data are not changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from ..assemble.double import HIDDEN_ANGLE, HIDDEN_DISTANCE, OUT_OF_SIGHT, PATH_FADE
from ..assemble.parts import DoublePart, DrawnDouble
from ..frames import Array, Bools, Ints


@dataclass(frozen=True, eq=False)
class ModelState:
    """The state of an external model, as decor reads it.

    Attributes:
        data: the user's.
        userdata: values of all inputs.
        site_xpos: positions of the joints, then the frames, then fixed points, (S, 3), m.
        site_xmat: their rotations, (S, 9).
        doubles: states of the doubles that have a pose, by name; several for a path.
    """

    data: mujoco.MjData
    userdata: Array
    site_xpos: Array
    site_xmat: Array
    doubles: dict[str, list[mujoco.MjData]]

    @property
    def time(self) -> float:
        """Of the user's data, s."""
        return float(self.data.time)

    @property
    def qpos(self) -> Array:
        """Of the user's data."""
        return np.asarray(self.data.qpos)

    @property
    def xpos(self) -> Array:
        """Positions of the bodies, m."""
        return np.asarray(self.data.xpos)

    @property
    def xmat(self) -> Array:
        """Rotations of the bodies."""
        return np.asarray(self.data.xmat)


@dataclass(frozen=True, eq=False)
class Sites:
    """Sources of the site poses of a `ModelState`.

    Attributes:
        joints: joint frames of every robot and every double, with the name of the double in
            whose state they are read; "" for the user's data.
        frames: state in which each frame is read, (M,); 0 is the user's, k the k-th double's.
        rows: rows of `xpos` followed by those of `site_xpos`, (M,).
        points: fixed points in the world, (P, 3), m.
        names: names of the doubles in `frames`, from 1 on.
    """

    joints: list[tuple[str, JointPoses]]
    frames: Ints
    rows: Ints
    points: Array
    names: list[str]

    def read(
        self, data: mujoco.MjData, doubles: dict[str, list[mujoco.MjData]]
    ) -> tuple[Array, Array]:
        """Returns positions (S, 3), m, and rotations (S, 9)."""
        positions, rotations = [np.empty((0, 3))], [np.empty((0, 3, 3))]
        for name, joints in self.joints:
            at, turned = joints.place(doubles[name][0] if name in doubles else data)
            positions.append(at)
            rotations.append(turned)
        # A double without a pose is read in the user's data; nothing shows it.
        states = [data, *(doubles[name][0] if name in doubles else data for name in self.names)]
        used = np.unique(self.frames)
        at_frames, of_frames = np.empty((len(self.rows), 3)), np.empty((len(self.rows), 3, 3))
        for k in used:
            state, mine = states[k], self.frames == k
            everywhere = np.concatenate([state.xpos, state.site_xpos])
            turned = np.concatenate([state.xmat, state.site_xmat]).reshape(-1, 3, 3)
            at_frames[mine], of_frames[mine] = (
                everywhere[self.rows[mine]],
                turned[self.rows[mine]],
            )
        upright = np.broadcast_to(np.eye(3), (len(self.points), 3, 3))
        site_xpos = np.concatenate([*positions, at_frames, self.points])
        site_xmat = np.concatenate([*rotations, of_frames, upright])
        # A diverged simulation has positions that cannot be drawn.
        lost = ~(np.isfinite(site_xpos).all(axis=1) & np.isfinite(site_xmat).all(axis=(1, 2)))
        if lost.any():
            site_xpos[lost], site_xmat[lost] = OUT_OF_SIGHT, np.eye(3)
        return site_xpos, site_xmat.reshape(-1, 9)


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
    hinge: Bools
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


class ModelDoubles:
    """Computes the poses of the doubles of a model.

    Args:
        model: compiled.
        doubles: by name.
    """

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
        """Computes the state of every double that has joint angles; all else is as in `data`.

        Args:
            data: the user's, kinematics up to date.
            angles: (n,) of every double that has any, except paths, rad or m.
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
        """Returns what to draw of one double: its links that do not coincide with the robot's.

        Args:
            state: the `ModelState`.
            name: of the double.
        """
        part = self._doubles[name]
        poses = state.doubles.get(name, [])
        fade = np.linspace(*PATH_FADE, len(poses)) if len(poses) > 1 else np.ones(1)
        return [
            DrawnDouble(
                name,
                self._model,
                pose,
                self._apart(part, state.data, pose),
                part.double.rgba * [1, 1, 1, share],
            )
            for pose, share in zip(poses, fade, strict=False)
        ]

    def _apart(self, part: DoublePart, data: mujoco.MjData, pose: mujoco.MjData) -> Bools:
        """Returns the geoms of links that do not coincide with the robot's, (ngeom,) bool."""
        model = self._model
        apart = np.linalg.norm(pose.xpos - data.xpos, axis=1) > HIDDEN_DISTANCE
        # The trace of R_target^T R_actual is 1 + 2 cos(angle between them).
        trace = np.einsum("ki,ki->k", pose.xmat, data.xmat)
        apart |= trace < 1.0 + 2.0 * np.cos(HIDDEN_ANGLE)
        mine = model.body_rootid == part.of.bodies[0]
        return np.asarray((mine & apart)[model.geom_bodyid])
