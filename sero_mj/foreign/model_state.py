"""`ModelState`: what decor reads, for a model that has neither our sites nor our userdata.

Decor reads an `MjData`: where sites are, and what lies in userdata. Somebody else's model has
neither, a compiled model cannot be given any, and its data is not ours to write into. So an
overlay's world makes this object for every frame: it has the few fields that decor reads, with a
site for every joint and frame, and an array of our own for userdata. Decor, picking and clicks
are the same for both; nothing of a scene is copied, and nothing of the user's is changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.mjcf_double import OUT_OF_SIGHT
from .joint_poses import JointPoses

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ModelState:
    """One moment of somebody else's model, as decor reads it.

    Attributes:
        data: the user's.
        userdata: values of all inputs.
        site_xpos: where the joints, then the frames, then points of the world are, (S, 3), m.
        site_xmat: their rotations, (S, 9).
        doubles: the poses of doubles that have one, by name; several for a path.
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
    """Where the sites of a `ModelState` are read.

    Attributes:
        joints: of every robot, then of every double, with whose pose they are read; "" for the
            user's own.
        frames: whose pose each frame is read in, (M,); 0 is the user's, k the k-th double's.
        rows: of `xpos` and, behind that, of `site_xpos`, (M,).
        points: of the world, (P, 3), m.
        names: of the poses after the user's own.
    """

    joints: list[tuple[str, JointPoses]]
    frames: Ints
    rows: Ints
    points: Array
    names: list[str]

    def read(
        self, data: mujoco.MjData, doubles: dict[str, list[mujoco.MjData]]
    ) -> tuple[Array, Array]:
        """Positions (S, 3), m, and rotations (S, 9); out of sight where there is no pose."""
        positions, rotations = [np.empty((0, 3))], [np.empty((0, 3, 3))]
        for name, joints in self.joints:
            at, turned = joints.place(doubles[name][0] if name in doubles else data)
            positions.append(at)
            rotations.append(turned)
        # What has no pose yet is read in the user's own, and shown by nothing.
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
        # What has flown off to infinity is not drawn there.
        lost = ~(np.isfinite(site_xpos).all(axis=1) & np.isfinite(site_xmat).all(axis=(1, 2)))
        if lost.any():
            site_xpos[lost], site_xmat[lost] = OUT_OF_SIGHT, np.eye(3)
        return site_xpos, site_xmat.reshape(-1, 9)
