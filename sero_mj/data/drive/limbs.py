"""Limbs of people: two links between a fixed point and a moving frame."""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array
from ...robots.assemble.mjcf import limb_bodies
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT


class Limbs:
    """The objects of shape `limb` of a world."""

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._limbs = [
            (item, [int(world.model.body(name).mocapid[0]) for name in limb_bodies(item.name)])
            for item in world.scene.objects
            if item.shape == "limb" and world.has_sites  # external models have no sites
        ]
        self.are_any = bool(self._limbs)

    def place(self, data: mujoco.MjData) -> None:
        """Places both links of each limb; hides the limb if its frame is hidden."""
        mujoco.mj_kinematics(self._world.model, data)
        for item, bodies in self._limbs:
            assert item.size is not None and item.reaches is not None  # checked by Object
            end = self._world.frame(data, item.reaches)[:3] @ [*item.end, 1.0]
            begin, towards = item.frame[:3, 3], item.frame[:3, 0]
            joint = middle_joint(begin, end, (item.size[0], item.size[1]), towards)
            is_hidden = end[2] < OUT_OF_SIGHT[2] / 2
            for body, start, along in (
                (bodies[0], begin, joint - begin),
                (bodies[1], joint, end - joint),
            ):
                data.mocap_pos[body] = OUT_OF_SIGHT if is_hidden else start
                mujoco.mju_quatZ2Vec(data.mocap_quat[body], along)


def middle_joint(begin: Array, end: Array, lengths: tuple[float, float], towards: Array) -> Array:
    """Returns the position of the joint between two links of a limb, (3,), m.

    Args:
        begin: begin of the first link, (3,), m.
        end: end of the second link, (3,), m. If it is out of reach, the links are stretched or
            folded.
        lengths: lengths of the links, m.
        towards: direction to which the joint bends, (3,).
    """
    first, second = lengths
    along = end - begin
    distance = float(np.linalg.norm(along))
    along = along / distance if distance > 0 else np.array([0.0, 0.0, 1.0])
    side = towards - (towards @ along) * along
    if np.linalg.norm(side) < 1e-9:  # any direction, if it is parallel to the limb
        side = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    reached = float(np.clip(distance, max(abs(first - second), 1e-9), first + second))
    share = (reached**2 + first**2 - second**2) / (2 * reached)
    height = np.sqrt(max(first**2 - share**2, 0.0))
    return np.asarray(begin + share * along + height * side / np.linalg.norm(side))
