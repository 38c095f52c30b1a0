"""Round arrows, which rotate about their joint and show a value by direction, color and width.

An arrow rotates at constant speed. For a positive torque, it rotates about the z axis of the joint
by the right-hand rule. The color also shows the sign. Arrows of doubles are transparent and
slightly smaller.

If there is a limit, the width is proportional to the square root of the value. At the limit, the
width is `arrow_radius` times `arrow_width_scale` / 0.01. At 2 % of the limit, it is a seventh of
this. The width is zero in the dead band and reaches the square root curve at twice the dead band.
Without a limit, the width is `arrow_width_scale` m per unit. If `arrow_load` is known, the width
equals the radius at this load instead. Beyond the limit, the ribbon is striped.

Source: section 2.2 of the paper. Square root, dead band and stripes are additions to the paper.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from ...robots.assemble.parts import JointTable
from .axes import AXIS_RGB
from .feature import Feature, Frame
from .geom_buffer import ARROW_SIZE_OF_LENGTH, GREY, GeomBuffer, Kind
from .panels import Panels, labels_at
from .ribbons import Ribbons, draw_ribbons

TURNING_SPEED = 1.6  # rad/s

# Orange and blue are distinct for all common kinds of color blindness (Okabe and Ito 2008).
POSITIVE_RGBA = (0.93, 0.45, 0.02, 1.0)
NEGATIVE_RGBA = (0.02, 0.36, 0.78, 1.0)

DEFAULT_WIDTH_SCALE = 0.01  # the default of `arrow_width_scale`
# Minimum width of drawn arrows, radii. It is reached at 0.1 % of a torque limit.
INVISIBLE_WIDTH = 0.03
WIDEST = 1.5  # maximum width, radii

STRAIGHT_LENGTH = 2.5  # length of the straight arrow of a prismatic joint, in radii
_Z_LENGTH, _Z_WIDTH = 1.9, 0.02  # length of the z axis in radii, and its width in lengths
DARKER = 0.4  # brightness factor of a straight arrow beyond its limit
ARROW_GEOMS, _FEWEST_ARROW_GEOMS = 92, 10  # maximum and minimum number of geoms of an arrow
# Maximum number of geoms of a frame, and number of geoms reserved for legend, names and the like.
_MAX_GEOMS, _RESERVED_GEOMS = 2048, 60


def arrow_widths(
    values: Array, limit: Array, radius: Array, width_scale: Array, dead_band: Array
) -> NDArray[np.float64]:
    """Returns the widths of round arrows.

    Args:
        values: values that the arrows show, shape (N,). The sign is ignored.
        limit: values at which arrows have full width, shape (N,); inf if there is no limit.
        radius: `arrow_radius` of each joint, shape (N,), m.
        width_scale: `arrow_width_scale` of each joint, shape (N,), m per unit of the value. If
            there is a limit, its ratio to `DEFAULT_WIDTH_SCALE` scales the width instead.
        dead_band: fraction of the limit below which the width is zero, shape (N,).

    Returns:
        widths, shape (N,), m. They increase continuously with the value, up to `WIDEST` times the
        radius. They are 0 within the dead band and for NaN.
    """
    size = np.abs(values)
    size[~np.isfinite(size)] = 0.0
    limited = np.isfinite(limit)
    share = size / np.where(limited, limit, 1.0)
    band = np.maximum(dead_band, 1e-9)
    grown = np.minimum(np.maximum(share / band - 1.0, 0.0), 1.0)
    of_limit = radius * (width_scale / DEFAULT_WIDTH_SCALE) * np.sqrt(share) * grown
    return np.minimum(np.where(limited, of_limit, size * width_scale), WIDEST * radius)


def drawn_widths(joints: JointTable, values: Array, limit: Array) -> NDArray[np.float64]:
    """Returns the drawn widths of the arrows of all joints, shape (N,), m.

    The width of arrows that are not drawn is 0. `values` and `limit` are as in `arrow_widths`.
    """
    by_load = np.isinf(limit) & np.isfinite(joints.arrow_load)
    scale = np.where(by_load, joints.arrow_radius / joints.arrow_load, joints.arrow_width_scale)
    widths = arrow_widths(values, limit, joints.arrow_radius, scale, joints.arrow_dead_band)
    # Arrows of joints that are close together have a smaller full width and maximum width.
    narrow = joints.arrow_width_scale / DEFAULT_WIDTH_SCALE
    widest = WIDEST * joints.arrow_radius * np.where(by_load, np.minimum(narrow, 1.0), 1.0)
    widths = np.minimum(widths, widest)
    return np.where(widths > INVISIBLE_WIDTH * joints.arrow_radius, widths, 0.0)


class RoundArrows(Feature):
    """The visual feature that draws the round arrows of all joints of a world."""

    order = 90  # last, so that arrows are dropped first if the capacity is exceeded

    def lay_out(self, frame: Frame) -> None:
        clicked = (frame.shown.arrows & frame.toggles.details).nonzero()[0]
        if not len(clicked):
            return
        joints, view = self.world.joints, frame.view
        sites = joints.centre_site[clicked]
        z = frame.data.site_xmat[sites].reshape(-1, 3, 3)[:, :, 2]
        length = _Z_LENGTH * joints.arrow_radius[clicked][:, None]
        tips, depth = view.project(frame.data.site_xpos[sites] + 1.1 * length * z)
        tips = tips[view.sees(tips, depth)]
        if len(tips):
            lines = [[b"z"] for _ in tips]
            frame.panels.append(Panels(*labels_at(view, tips, lines), lines))

    def draw(self, frame: Frame) -> None:
        buffer, data, shown = frame.buffer, frame.data, frame.shown
        values, limit, stale = frame.arrow_values, frame.arrow_limit, frame.stale_joints
        joints = self.world.joints
        widths = drawn_widths(joints, values, limit)
        visible = shown.arrows & (widths > 0.0)
        over = np.abs(values) > limit  # False for NaN
        rgba = np.where((values > 0)[:, None], POSITIVE_RGBA, NEGATIVE_RGBA)
        rgba[stale, :3] = GREY
        rgba[:, 3] = joints.arrow_alpha
        turning = (visible & joints.revolute).nonzero()[0]
        sliding = (visible & ~joints.revolute).nonzero()[0]
        if len(turning):
            sites = joints.centre_site[turning]
            sign = np.sign(values[turning])
            # The site rotates with its link. Subtracting q keeps the arrow's speed constant while
            # its joint moves.
            phase = TURNING_SPEED * data.time - joints.angles(data)[turning] * sign
            ribbons = Ribbons(
                items=turning,
                centre=data.site_xpos[sites],
                axes=data.site_xmat[sites].reshape(-1, 3, 3),
                phase=phase,
                sign=sign,
                radius=joints.arrow_radius[turning],
                width=widths[turning],
                rgba=rgba[turning],
                striped=over[turning],
            )
            draw_ribbons(buffer, Kind.ARROW, ribbons, _budget(frame))
        clicked = (shown.arrows & frame.toggles.details).nonzero()[0]
        if len(clicked):
            self._draw_z(frame, clicked)
        if len(sliding):
            self._draw_straight(buffer, data, sliding, (values, widths, over, rgba))

    def _draw_z(self, frame: Frame, index: NDArray[np.intp]) -> None:
        joints, buffer = self.world.joints, frame.buffer
        sites = joints.centre_site[index]
        length = _Z_LENGTH * joints.arrow_radius[index][:, None]
        centre = frame.data.site_xpos[sites]
        rows = buffer.take(len(index), int(mujoco.mjtGeom.mjGEOM_ARROW))
        if len(rows):
            rows["pos"] = centre
            rows["mat"] = frame.data.site_xmat[sites].reshape(-1, 3, 3)
            rows["size"][:, :2] = _Z_WIDTH * length
            rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length[:, 0]
            rows["rgba"] = (*AXIS_RGB[2], 1.0)

    def _draw_straight(
        self,
        buffer: GeomBuffer,
        data: mujoco.MjData,
        index: NDArray[np.intp],
        look: tuple[Array, Array, NDArray[np.bool_], Array],
    ) -> None:
        # Straight arrows are beside the link. Beyond the limit they are dark, because a single
        # geom cannot be striped.
        forces, widths, over, rgba = (of_all[index] for of_all in look)
        joints = self.world.joints
        rows = buffer.take(len(index), int(mujoco.mjtGeom.mjGEOM_ARROW), Kind.ARROW, index)
        if not len(rows):
            return
        mat = data.site_xmat[joints.centre_site[index]].reshape(-1, 3, 3).copy()
        mat[:, :, 1:] *= np.sign(forces)[:, None, None]  # 1, or a rotation about x by 180 deg
        radius = joints.arrow_radius[index][:, None]
        length = STRAIGHT_LENGTH * radius
        centre = data.site_xpos[joints.centre_site[index]]
        rows["pos"] = centre + radius * mat[:, :, 0] - length / 2 * mat[:, :, 2]
        rows["mat"] = mat
        rows["size"][:, :2] = (widths / 4)[:, None]
        rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length[:, 0]
        rgba[over, :3] *= DARKER
        rows["rgba"] = rgba


def _budget(frame: Frame) -> int:
    texts = sum(2 + len(lines) for group in frame.billboards for lines in group.texts)
    room = _MAX_GEOMS - _RESERVED_GEOMS - 3 * int(np.count_nonzero(frame.shown.axes)) - texts
    budget = room // max(int(np.count_nonzero(frame.shown.arrows)), 1)
    return min(max(budget, _FEWEST_ARROW_GEOMS), frame.arrow_geoms)
