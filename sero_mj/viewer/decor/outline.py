"""`Outline`: where the robots are in the picture, for what is placed beside them."""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.world_view import WorldView
from ...robots.declared.double import OUT_OF_SIGHT


class Outline:
    """Points along the links of all robots and doubles, with radii, as an outline of them.

    Every geom counts as a capsule along its longest side, with a point at each end and in the
    middle.
    """

    def __init__(self, world: WorldView) -> None:
        model = world.model
        owner = np.full(model.ngeom, -1)
        for i, part in enumerate(world.owners.values()):
            owner[np.isin(model.geom_bodyid, part.bodies)] = i
        owner[(model.geom_group > 2) | (model.geom_rgba[:, 3] <= 0)] = -1
        self._geoms = (owner >= 0).nonzero()[0]
        centre, half = np.hsplit(model.geom_aabb[self._geoms], 2)
        longest = half.argmax(axis=1)
        self._radii = np.sort(half, axis=1)[:, 1]
        along = np.eye(3)[longest] * (half.max(axis=1) - self._radii)[:, None]
        self._offsets = np.stack([centre - along, centre, centre + along], axis=1)
        self._owners = owner[self._geoms]
        self._joints = world.joints

    def points(
        self,
        data: mujoco.MjData,
        hidden: Bools | None,
        sites: Array,
        arrows: Bools,
    ) -> tuple[Array, Array, Ints]:
        """Returns points (m, 3), m, radii (m,), m, and the index of their robot or double (m,).

        Args:
            hidden: geoms that are not shown, (ngeom,) bool; None for none.
            sites: positions of the world's sites, `site_xpos` of its state, m.
            arrows: which joints have an arrow, which belongs to the outline, (N,) bool.
        """
        rotation = data.geom_xmat[self._geoms].reshape(-1, 1, 3, 3)
        points = data.geom_xpos[self._geoms, None] + (rotation @ self._offsets[..., None])[..., 0]
        is_shown = points[:, 0, 2] > OUT_OF_SIGHT[2] / 2  # doubles without a pose are far away
        if hidden is not None:
            is_shown &= ~hidden[self._geoms]
        joints = self._joints
        of_links, of_arrows = points[is_shown].reshape(-1, 3), sites[joints.centre_site[arrows]]
        radii = np.repeat(self._radii[is_shown], 3), joints.arrow_radius[arrows]
        owners = np.repeat(self._owners[is_shown], 3), joints.owner[arrows]
        return np.concatenate([of_links, of_arrows]), np.concatenate(radii), np.concatenate(owners)
