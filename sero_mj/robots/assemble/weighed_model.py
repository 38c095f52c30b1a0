"""`weighed_model`: a model to look at, with the masses that its robots have in simulation."""

from __future__ import annotations

import copy
from collections.abc import Mapping

import mujoco

from ..declared.dynamics import principal_moments
from .parts import RobotPart
from .robot_dynamics import RobotDynamics


def weighed_model(
    model: mujoco.MjModel, robots: Mapping[str, RobotPart], dynamics: Mapping[str, RobotDynamics]
) -> mujoco.MjModel:
    """Returns a copy of a model whose links have masses, and all else has none.

    In a model to look at, MuJoCo takes them from the volume of what is drawn.

    Args:
        model: to look at, of a scene.
        robots: of the scene, by name.
        dynamics: of the robots, by name.
    """
    weighed = copy.copy(model)
    weighed.body_mass[:], weighed.body_inertia[:] = 0.0, 0.0
    weighed.body_sameframe[:] = 0  # centres of mass are not at origins any more
    for name, of in dynamics.items():
        for k, body in enumerate(robots[name].bodies.tolist()):
            moments, axes = principal_moments(of.tensors[k])
            weighed.body_mass[body], weighed.body_inertia[body] = of.masses[k], moments
            weighed.body_ipos[body] = of.centers[k]
            mujoco.mju_mat2Quat(weighed.body_iquat[body], axes.ravel())
    weighed.body_subtreemass[:] = weighed.body_mass
    for body in range(weighed.nbody - 1, 0, -1):  # children come after their parents
        weighed.body_subtreemass[weighed.body_parentid[body]] += weighed.body_subtreemass[body]
    return weighed
