"""Round arrows, which rotate about their joint and show a value by direction, color and width.

An arrow rotates at constant speed. For a positive torque, it rotates about the z axis of the joint
by the right-hand rule. The color also shows the sign. Arrows of doubles are transparent and
slightly smaller.

If there is a limit, the width is proportional to the square root of the value. At the limit, the
width is `FULL_WIDTH` times `arrow_radius` times `arrow_width_scale` / 0.01. At 2 % of the limit, it
is a seventh of this. The width is zero in the dead band and reaches the square root curve at twice
the dead band. Without a limit, the width is `arrow_width_scale` m per unit. If `arrow_load` is
known, the arrow has its full width at this load instead. Beyond the limit, the arrow is striped.

Source: section 2.2 of the paper. Square root, dead band and stripes are additions to the paper.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...base.frames import Array
from ...robots.assemble.parts import JointTable
from .arrow_shapes import draw_round, draw_straight
from .axes import AXIS_RGB
from .feature import Feature, Frame
from .geom_buffer import GREY, Kind
from .panels import Panels, labels_at

TURNING_SPEED = 1.6  # rad/s

# Orange and blue are distinct for all common kinds of color blindness (Okabe and Ito 2008).
POSITIVE_RGBA = (0.93, 0.45, 0.02, 1.0)
NEGATIVE_RGBA = (0.02, 0.36, 0.78, 1.0)

DEFAULT_WIDTH_SCALE = 0.01  # the default of `arrow_width_scale`
FULL_WIDTH = 0.45  # width at the limit, radii
INVISIBLE_WIDTH = 0.03 * FULL_WIDTH  # minimum width of drawn arrows, radii; 0.1 % of a limit
WIDEST = 1.5 * FULL_WIDTH  # maximum width, radii

STRAIGHT_LENGTH = 2.5  # length of the straight arrow of a prismatic joint, in radii
_Z_LENGTH, _Z_WIDTH = 1.9, 0.04  # length of the z axis in radii, and its width in lengths


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
    full = FULL_WIDTH * radius * (width_scale / DEFAULT_WIDTH_SCALE)
    of_limit = full * np.sqrt(share) * grown
    return np.minimum(np.where(limited, of_limit, size * width_scale), WIDEST * radius)


def drawn_widths(joints: JointTable, values: Array, limit: Array) -> NDArray[np.float64]:
    """Returns the drawn widths of the arrows of all joints, shape (N,), m.

    The width of arrows that are not drawn is 0. `values` and `limit` are as in `arrow_widths`.
    """
    by_load = np.isinf(limit) & np.isfinite(joints.arrow_load)
    full = FULL_WIDTH * joints.arrow_radius
    scale = np.where(by_load, full / joints.arrow_load, joints.arrow_width_scale)
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
        data, shown = frame.data, frame.shown
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
            draw_round(
                frame.buffer, Kind.ARROW, turning,
                centre=data.site_xpos[sites],
                axes=data.site_xmat[sites].reshape(-1, 3, 3),
                phase=phase,
                sign=sign,
                radius=joints.arrow_radius[turning],
                width=widths[turning],
                rgba=rgba[turning],
                striped=over[turning],
            )  # fmt: skip
        clicked = (shown.arrows & frame.toggles.details).nonzero()[0]
        if len(clicked):
            self._draw_z(frame, clicked)
        if len(sliding):
            # Straight arrows are beside the link.
            axes = data.site_xmat[joints.centre_site[sliding]].reshape(-1, 3, 3).copy()
            # By 1, or by a rotation about x by 180 deg.
            axes[:, :, 1:] *= np.sign(values[sliding])[:, None, None]
            radius = joints.arrow_radius[sliding][:, None]
            length = STRAIGHT_LENGTH * radius
            centre = data.site_xpos[joints.centre_site[sliding]]
            draw_straight(
                frame.buffer, Kind.ARROW, sliding,
                start=centre + radius * axes[:, :, 0] - length / 2 * axes[:, :, 2],
                axes=axes,
                length=length[:, 0],
                width=widths[sliding],
                rgba=rgba[sliding],
                over=over[sliding],
            )  # fmt: skip

    def _draw_z(self, frame: Frame, index: NDArray[np.intp]) -> None:
        joints = self.world.joints
        sites = joints.centre_site[index]
        length = _Z_LENGTH * joints.arrow_radius[index]
        draw_straight(
            frame.buffer, Kind.NONE, index,
            start=frame.data.site_xpos[sites],
            axes=frame.data.site_xmat[sites].reshape(-1, 3, 3),
            length=length,
            width=_Z_WIDTH * length,
            rgba=np.tile((*AXIS_RGB[2], 1.0), (len(index), 1)),
        )  # fmt: skip
