"""What a robot has picked up: a body at its flange that weighs nothing until then."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..assemble.inertia import inertia_problem, principal_moments, tensors_from
from ..assemble.mjcf_dynamics import PAYLOAD
from ..declaration import numbers

Array = NDArray[np.float64]

_STEEL = 7800.0  # kg/m3


def attach_payload(
    model: mujoco.MjModel,
    robot: str,
    mass: float,
    center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
    inertia: ArrayLike | None = None,
) -> None:
    """Gives the payload body of a robot a mass, in the frame of its flange.

    Args:
        model: of a dynamic world.
        robot: its name.
        mass: kg.
        center_of_mass: (3,), m.
        inertia: about it, 6 numbers or (3, 3), kg m2; that of a ball of steel when None.

    Raises:
        ValueError: no rigid body has this mass and inertia.
    """
    if not 0 < mass < np.inf:
        raise ValueError(f"payload of {robot}: found {mass:g} kg; expected a positive mass")
    center = numbers(center_of_mass)
    if center.shape != (3,):
        raise ValueError(f"payload of {robot}: found {center.tolist()}; expected 3 numbers in m")
    if inertia is None:
        radius = (3 * mass / (4 * np.pi * _STEEL)) ** (1 / 3)
        tensor = 0.4 * mass * radius**2 * np.eye(3)
    else:
        tensor = tensors_from([inertia])[0]
    reason = inertia_problem(tensor)
    if reason is not None:
        raise ValueError(f"payload of {robot}: {reason}")
    moments, axes = principal_moments(tensor)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    _set(model, robot, mass, center, moments, quat)


def detach_payload(model: mujoco.MjModel, robot: str) -> None:
    """Takes the mass away again."""
    _set(model, robot, 0.0, np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]))


def _set(
    model: mujoco.MjModel, robot: str, mass: float, center: Array, moments: Array, quat: Array
) -> None:
    body = model.body(f"{robot}/{PAYLOAD}").id
    model.body_mass[body] = mass
    model.body_ipos[body], model.body_iquat[body] = center, quat
    model.body_inertia[body] = moments
    model.body_sameframe[body] = 0  # its centre of mass is no longer taken for its origin
    kept = model.stat.center.copy(), model.stat.extent, model.stat.meansize
    mujoco.mj_setConst(model, mujoco.MjData(model))
    model.stat.center, model.stat.extent, model.stat.meansize = kept  # else the camera jumps
