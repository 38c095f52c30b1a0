"""`Selection`: a bright ring about the joint that is selected."""

from __future__ import annotations

import mujoco
import numpy as np

from ...base.frames import Array
from .feature import Feature, Frame
from .geom_buffer import Kind
from .handles import SEGMENTS, fill_ring

_RGBA = (0.16, 0.75, 0.95, 0.95)
_LARGER = 1.3  # than the joint's arrow
_HALF_WIDTH = 1.4  # pixels


class Selection(Feature):
    """Draws the ring about the joint that a user has selected."""

    order = 84

    def draw(self, frame: Frame) -> None:
        joint = frame.toggles.selected
        if joint is None or not frame.shown.joints[joint]:
            return
        joints, data = self.world.joints, frame.data
        site = joints.centre_site[joint]
        centre: Array = np.asarray(data.site_xpos[site])
        axes: Array = np.asarray(data.site_xmat[site]).reshape(3, 3)
        view = frame.view
        depth = max(float((centre - view.position) @ view.forward), view.near)
        rows = frame.buffer.take(SEGMENTS, int(mujoco.mjtGeom.mjGEOM_BOX), Kind.NONE)
        if len(rows):
            radius = _LARGER * float(joints.arrow_radius[joint])
            half = _HALF_WIDTH * float(view.pixel_size(depth))
            fill_ring(rows, centre, axes, radius, half, _RGBA)
            rows["emission"] = 0.9
