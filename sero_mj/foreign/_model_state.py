"""`ModelState`: the state that decor reads, for an external model.

Decor reads the poses of sites and the contents of `userdata`. An external model has no sites and
slots for decor, and neither can be added to a compiled model. So `ModelWorld` creates this object
for every frame: it has the fields of `MjData` that decor reads, with a site for every joint and
frame, and a `userdata` array of its own. The user's model and data are not changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.mjcf_double import OUT_OF_SIGHT
from ._joint_poses import JointPoses

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ModelState:
    """The state of an external model, as decor reads it.

    Attributes:
        data: the user's.
        userdata: values of all inputs.
        site_xpos: positions of the joints, then the frames, then fixed points, (S, 3), m.
        site_xmat: their rotations, (S, 9).
        doubles: states of the doubles that have a pose, by name; several for a path.
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
    """Sources of the site poses of a `ModelState`.

    Attributes:
        joints: joint frames of every robot and every double, with the name of the double in
            whose state they are read; "" for the user's data.
        frames: state in which each frame is read, (M,); 0 is the user's, k the k-th double's.
        rows: rows of `xpos` followed by those of `site_xpos`, (M,).
        points: fixed points in the world, (P, 3), m.
        names: names of the doubles in `frames`, from 1 on.
    """

    joints: list[tuple[str, JointPoses]]
    frames: Ints
    rows: Ints
    points: Array
    names: list[str]

    def read(
        self, data: mujoco.MjData, doubles: dict[str, list[mujoco.MjData]]
    ) -> tuple[Array, Array]:
        """Returns positions (S, 3), m, and rotations (S, 9)."""
        positions, rotations = [np.empty((0, 3))], [np.empty((0, 3, 3))]
        for name, joints in self.joints:
            at, turned = joints.place(doubles[name][0] if name in doubles else data)
            positions.append(at)
            rotations.append(turned)
        # A double without a pose is read in the user's data; nothing shows it.
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
        # A diverged simulation has positions that cannot be drawn.
        lost = ~(np.isfinite(site_xpos).all(axis=1) & np.isfinite(site_xmat).all(axis=(1, 2)))
        if lost.any():
            site_xpos[lost], site_xmat[lost] = OUT_OF_SIGHT, np.eye(3)
        return site_xpos, site_xmat.reshape(-1, 9)
