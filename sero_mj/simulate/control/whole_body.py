"""`WholeBody`: poses of the bases of mounted robots, and inertias of carried robots.

A controller knows its own robot, the pose of its base, and the mass, center and inertia of mounted
robots at the measured angles. Joint velocities of other robots are ignored. Their effects are
external torques, as for the controllers of real limbs.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from mujoco import mju_mat2Quat, mju_mulQuat

from ...base.frames import Array, inverse
from ...robots.assemble.world import World
from ...robots.declared.mounts import carrying_link


@dataclass(frozen=True, eq=False)
class Mounting:
    """Indices of a robot's base and of the robots that it carries in the data of a `WholeBody`.

    Attributes:
        data: data of the whole body, with the composite inertias `crb`.
        base: index of the body of the robot's base.
        root: index of the body whose `subtree_com` is the reference point of these inertias.
        loads: carrying link (0 is the base) and first body of each carried robot.
    """

    data: mujoco.MjData
    base: int
    root: int
    loads: list[tuple[int, int]]


class WholeBody:
    """All robots of a dynamic world at their measured angles, but without later payloads."""

    def __init__(self, world: World) -> None:
        self._world = world
        self._model = copy.copy(world.model)
        self._data = mujoco.MjData(self._model)
        parts = world.robots.values()
        self._qpos = np.concatenate([part.qpos for part in parts])
        # Controllers know the true poses of free bases, as if from an inertial measurement unit.
        free = self._model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
        of_free = np.setdiff1d(np.arange(self._model.nq), self._model.jnt_qposadr[~free])
        self._free = np.union1d(of_free, np.concatenate([part.free for part in parts]))

    @staticmethod
    def is_needed(world: World) -> bool:
        """Returns whether a base is mounted or free, so that robot models must follow it."""
        return any(part.mocap < 0 for part in world.robots.values())

    def update(self, joint_angles: Array, positions: Array) -> None:
        """Moves all robots to measured angles and to the poses of free bases.

        Args:
            joint_angles: measured angles of all joints of the world's robots, (N,), rad or m.
            positions: generalized positions `qpos` with the poses of free bases, shape (nq,).
        """
        own, model = self._data, self._model
        own.qpos[self._qpos] = joint_angles
        own.qpos[self._free] = positions[self._free]
        mujoco.mj_kinematics(model, own)
        mujoco.mj_comPos(model, own)
        mujoco.mj_makeM(model, own)  # computes the composite inertias

    def mounting(self, name: str) -> Mounting:
        """Returns the mounting of a robot. Its data change in every `update`."""
        robots = self._world.scene.robots
        base = int(self._world.robots[name].bodies[0])
        loads = [
            (carrying_link(robots, other)[1], int(self._world.robots[other].bodies[0]))
            for other, robot in robots.items()
            if robot.mount is not None and carrying_link(robots, other)[0] == name
        ]
        return Mounting(self._data, base, int(self._model.body_rootid[base]), loads)


class Carrier:
    """Moves the bases in a robot model, and adds the inertias of the robots that are carried.

    Poses and inertias are those in the data of a `WholeBody`. For each robot, `robots` contains its
    mounting, its pose T_world_base when the model was made, the id of its first joint in the model,
    and its number of joints.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        own: mujoco.MjData,
        whole: mujoco.MjData,
        robots: Sequence[tuple[Mounting, Array, int, int]],
    ) -> None:
        self._model, self._own, self._whole = model, own, whole
        self._bases, self._trees = np.zeros((2, 0), np.intp)
        self._positions: Array = np.zeros((0, 3, 1))
        self._turns: Array = np.zeros((0, 4, 4))  # q -> q * quat of the tree in the base
        bodies, carried, own_roots, roots = [], [], [], []
        for mounting, T_world_base, joint, n in robots:
            inverse_base, turn = inverse(T_world_base), np.empty(4)
            mju_mat2Quat(turn, inverse_base[:3, :3].ravel())
            tops = {int(model.body_rootid[model.jnt_bodyid[k]]) for k in range(joint, joint + n)}
            for body in sorted(tops):
                quat: Array = np.empty(4)
                mju_mulQuat(quat, turn, model.body_quat[body])
                position = inverse_base[:3, :3] @ model.body_pos[body] + inverse_base[:3, 3]
                self._bases = np.append(self._bases, mounting.base)
                self._trees = np.append(self._trees, body)
                self._positions = np.append(self._positions, position.reshape(1, 3, 1), axis=0)
                w, x, y, z = quat
                product = [[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]]
                self._turns = np.append(self._turns, [product], axis=0)
            for link, body in mounting.loads:
                if link > 0:  # loads on the base do not act on the joints
                    bodies.append(int(model.jnt_bodyid[joint + link - 1]))
                    carried.append(body)
                    own_roots.append(int(model.body_rootid[bodies[-1]]))
                    roots.append(mounting.root)
        self._bodies, self._carried, self._own_roots, self._roots = np.array(
            [bodies, carried, own_roots, roots], np.intp
        )

    def move_bases(self) -> None:
        whole, bases = self._whole, self._bases
        rotations = whole.xmat[bases].reshape(-1, 3, 3)
        self._model.body_pos[self._trees] = (
            whole.xpos[bases] + (rotations @ self._positions)[..., 0]
        )
        self._model.body_quat[self._trees] = (self._turns @ whole.xquat[bases][..., None])[..., 0]

    def add_loads(self) -> None:
        """Adds the inertias of the loads to those of the links that carry them.

        All inertias are about a point, in world axes. By the parallel-axis theorem, a shift of the
        point by d adds S - tr(S) E to the tensor, with a = h - m d / 2 and S = a d^T + d a^T, and
        -m d to the first moment h.
        """
        if not len(self._bodies):
            return
        loads, data = self._whole.crb[self._carried], self._own
        shifts = data.subtree_com[self._own_roots] - self._whole.subtree_com[self._roots]
        masses = loads[:, 9:]
        arms = loads[:, 6:9] - 0.5 * masses * shifts
        products = arms[:, :, None] * shifts[:, None, :]
        traces = 2.0 * np.einsum("kii->k", products)[:, None]
        loads[:, 0:3] += 2.0 * np.einsum("kii->ki", products) - traces
        loads[:, 3:6] += products[:, [0, 0, 1], [1, 2, 2]] + products[:, [1, 2, 2], [0, 0, 1]]
        loads[:, 6:9] -= masses * shifts
        np.add.at(data.cinert, self._bodies, loads)
