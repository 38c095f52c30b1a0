"""Poses the transparent doubles from their target angles, by `dh`."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.double import HIDDEN_ANGLE, HIDDEN_DISTANCE
from ..assemble.mjcf_double import OUT_OF_SIGHT
from ..assemble.parts import DoublePart
from ..assemble.world import World
from ..frames import frame, rotation_from_quat

Array = NDArray[np.float64]


def pose_doubles(world: World, data: mujoco.MjData) -> None:
    """Writes the poses of all doubles into `mocap_pos` and `mocap_quat`; `follow` moves them."""
    for name, part in world.doubles.items():
        robot = part.of
        base = frame(rotation_from_quat(data.mocap_quat[robot.mocap]), data.mocap_pos[robot.mocap])
        dh = robot.dh
        if part.path is not None:
            targets = dh.frames(part.path, base)
        elif data.userdata[world.flags[f"{name}.joint_angles"]] > 0:
            targets = dh.frames(data.userdata[world.slots[f"{name}.joint_angles"]], base)[None]
            _set_poses(data, part.frames, targets[0, 1:])
        else:
            data.mocap_pos[part.mocap] = data.mocap_pos[part.frames] = OUT_OF_SIGHT
            continue
        _place(data, part, targets, dh.frames(data.qpos[robot.qpos], base))


def _place(data: mujoco.MjData, part: DoublePart, targets: Array, actual: Array) -> None:
    apart = np.linalg.norm(targets[..., :3, 3] - actual[:, :3, 3], axis=-1) > HIDDEN_DISTANCE
    # The trace of R_target^T R_actual is 1 + 2 cos(angle between them).
    trace = np.einsum("rkij,kij->rk", targets[..., :3, :3], actual[:, :3, :3])
    apart |= trace < 1.0 + 2.0 * np.cos(HIDDEN_ANGLE)
    _set_poses(data, part.mocap.ravel(), targets.reshape(-1, 4, 4))
    data.mocap_pos[part.mocap[~apart]] = OUT_OF_SIGHT


def _set_poses(data: mujoco.MjData, mocap: NDArray[np.intp], poses: Array) -> None:
    data.mocap_pos[mocap] = poses[:, :3, 3]
    quats = np.empty((len(mocap), 4))
    for quat, rotation in zip(quats, poses[:, :3, :3].reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quat, rotation)
    data.mocap_quat[mocap] = quats
