"""`WholeBody`: where the bases of mounted robots are, and what robots carry.

A controller knows its own robot. What is mounted on it is a load of which it knows mass, centre
and inertia at the angles that the carried joints have now, and its base is where the joints below
have it. Velocities of the others' joints are not taken into account: what they do to a robot
while they move are torques from outside to it, as they are to the controllers of real limbs.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.world import World
from ...robots.declared.mounts import carrying_link


@dataclass(frozen=True, eq=False)
class Mounting:
    """Where one robot's base is and what it carries, in data that change with the whole body.

    Attributes:
        data: of the whole body; `crb` has the composite inertias.
        base: body of the robot's base.
        root: body whose `subtree_com` the composite inertias are about.
        loads: for every robot that it carries, the link that carries it (0 is the base), and that
            robot's first body.
    """

    data: mujoco.MjData
    base: int
    root: int
    loads: list[tuple[int, int]]


class WholeBody:
    """The robots of a dynamic world together, at the angles that are measured of them.

    It knows the masses that the world has when this is made, without payloads picked up later.

    Args:
        world: compiled with `dynamic`.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._model = copy.copy(world.model)
        self._data = mujoco.MjData(self._model)
        parts = world.robots.values()
        self._qpos = np.concatenate([part.qpos for part in parts])
        # What stands free is where the plant has it: controllers would have an inertial unit.
        free = self._model.jnt_type == int(mujoco.mjtJoint.mjJNT_FREE)
        of_free = np.setdiff1d(np.arange(self._model.nq), self._model.jnt_qposadr[~free])
        self._free = np.union1d(of_free, np.concatenate([part.free for part in parts]))

    @staticmethod
    def is_needed(world: World) -> bool:
        """Whether a base of the world moves or carries something, so that a model must follow."""
        return any(part.mocap < 0 for part in world.robots.values())

    def update(self, joint_angles: Array, positions: Array) -> None:
        """Moves the whole body.

        Args:
            joint_angles: (N,), of all joints of the world's robots, as measured, rad or m.
            positions: (nq,), of the world, for bases that stand free.
        """
        own, model = self._data, self._model
        own.qpos[self._qpos] = joint_angles
        own.qpos[self._free] = positions[self._free]
        mujoco.mj_kinematics(model, own)
        mujoco.mj_comPos(model, own)
        mujoco.mj_makeM(model, own)  # which computes the composite inertias

    def mounting(self, name: str) -> Mounting:
        """Returns where a robot's base is and what it carries, now and after every `update`."""
        robots = self._world.scene.robots
        base = int(self._world.robots[name].bodies[0])
        loads = [
            (carrying_link(robots, other)[1], int(self._world.robots[other].bodies[0]))
            for other, robot in robots.items()
            if robot.mount is not None and carrying_link(robots, other)[0] == name
        ]
        return Mounting(self._data, base, int(self._model.body_rootid[base]), loads)
