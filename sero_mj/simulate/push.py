"""Forces and torques from outside on a frame of a robot."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..assemble.world import World
from ..declaration import numbers
from ..errors import UnknownName

Array = NDArray[np.float64]


class Push:
    """A force and a torque at a frame, which go with it; change them while time passes.

    Args:
        world: whose frame it is.
        frame: name of the frame at whose origin they act, e.g. `lwr/flange`.
        force: (3,), N.
        torque: (3,), Nm.
        expressed_in: name of the frame in whose axes both are given.
        at: (3,), where in the frame they act, m.

    Attributes:
        force: (3,), N.
        torque: (3,), Nm.

    Raises:
        UnknownName: no such frame.
        ValueError: not three finite numbers.
    """

    def __init__(
        self,
        world: World,
        frame: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        expressed_in: str = "world",
        at: ArrayLike = (0.0, 0.0, 0.0),
    ) -> None:
        self.frame, self.expressed_in = frame, expressed_in
        self.force, self.torque, self._at = (
            _three(name, value)
            for name, value in (("force", force), ("torque", torque), ("at", at))
        )
        self._site = _site(world, frame)
        self._body = int(world.model.site_bodyid[self._site])
        self._axes = None if expressed_in == "world" else _site(world, expressed_in)

    def apply(self, model: mujoco.MjModel, data: mujoco.MjData, torques: Array) -> None:
        """Adds what it does at the joints to torques (nv,); `data` has its kinematics."""
        force, torque = self.force, self.torque
        if self._axes is not None:
            axes = data.site_xmat[self._axes].reshape(3, 3)
            force, torque = axes @ force, axes @ torque
        point = data.site_xpos[self._site]
        if self._at.any():
            point = point + data.site_xmat[self._site].reshape(3, 3) @ self._at
        mujoco.mj_applyFT(model, data, force, torque, point, self._body, torques)


def _three(name: str, value: ArrayLike) -> Array:
    array = numbers(value)
    if array.shape != (3,):
        raise ValueError(f"{name}: found {array.tolist()}; expected 3 numbers")
    return array


def _site(world: World, frame: str) -> int:
    if frame not in world.frames.names:
        raise UnknownName("frame", frame, [*world.frames.names, "world"])
    return int(world.frames.site[world.frames.names.index(frame)])
