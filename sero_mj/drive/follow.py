"""Moves every frame to where the joint angles say, without dynamics."""

from __future__ import annotations

import mujoco


def follow(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Computes frames, cameras and lights from `qpos` and `mocap`; time does not pass."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)  # MuJoCo's own visualisation needs subtree centres
    mujoco.mj_camlight(model, data)
