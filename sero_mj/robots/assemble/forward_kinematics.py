"""`ForwardKinematics`: fast forward kinematics of a robot for single poses."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import Problem
from ...base.frames import Array
from ..declared.robot import SerialRobot
from .mjcf import add_links
from .mjcf_elements import pose

_EYE = np.eye(4)


class ForwardKinematics:
    """A function that computes the forward kinematics of a robot with MuJoCo.

    It needs a sixth of the time of `SerialRobot.fwd_kin_base_to_flange` for a single pose. Later
    changes of the robot have no effect. Each thread needs its own object.
    """

    def __init__(self, robot: SerialRobot) -> None:
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.compiler.boundmass, spec.compiler.boundinertia = 1e-9, 1e-12
        base = spec.worldbody.add_body(name="base")
        carrying = [base, *add_links(base, robot)][robot.flange_link]
        carrying.add_site(name="flange", **pose(robot.T_n_flange))
        self.n = robot.n
        self._of_many = robot.model_copy().fwd_kin_base_to_flange
        self._coupled = robot.coupled if robot.couplings else None
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        self._qpos = self._data.qpos
        flange = self._data.site("flange")
        self._position, self._rotation = flange.xpos, flange.xmat.reshape(3, 3)

    def __call__(self, joint_angles: ArrayLike) -> Array:
        """Returns the pose of the flange in the base frame, shape (..., 4, 4), in m.

        Args:
            joint_angles: values of all joints, shape (..., n), or of the independent joints, shape
                (..., k), rad or m. Other shapes raise DeclarationError.
        """
        q = np.asarray(joint_angles, np.float64)
        if self._coupled is not None and q.shape[-1:] == (self._coupled.k,):
            q = self._coupled.full("joint_angles", q)
        if q.shape[-1:] != (self.n,):
            expected = f"a last axis of length {self.n}"
            raise Problem("joint_angles", f"found shape {q.shape}", expected=expected).error()
        if q.ndim > 1:
            return self._of_many(q)
        self._qpos[:] = q
        mujoco.mj_kinematics(self._model, self._data)
        T = _EYE.copy()
        T[:3, :3], T[:3, 3] = self._rotation, self._position
        return T
