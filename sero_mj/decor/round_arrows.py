"""Round arrows turn about their joint and show a value by direction and width.

An arrow turns at constant speed, by the right-hand rule about the joint's z for a positive torque;
a colour tells the sign as well. Those of doubles are see-through and a little smaller.

Width: with a limit, `arrow_radius` (times `arrow_width_scale` / 0.01) at the limit and with the
square root of the value below it, so that 2 % of the limit still has a seventh of the full width;
nothing below the dead band. Without a limit, `arrow_width_scale` m per unit. Beyond the limit the
ribbon is striped. Source: the paper's section 2.2; root, dead band and stripes are ours.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from .feature import Feature, Frame
from .pen import ARROW_SIZE_OF_LENGTH, GREY, MAX_GEOMS, Kind, Pen
from .ribbons import TURNING_SPEED, Ribbons, draw_ribbons

Array = NDArray[np.float64]

# Orange and blue: told apart by every common kind of colour blindness (Okabe and Ito 2008).
POSITIVE_RGBA = (0.93, 0.45, 0.02, 1.0)
NEGATIVE_RGBA = (0.02, 0.36, 0.78, 1.0)

DEFAULT_WIDTH_SCALE = 0.01  # the proto's arrow_width_scale
INVISIBLE_WIDTH = 0.03  # of the radius; narrower (0.1 % of a torque limit) is no arrow
WIDEST = 1.5  # of the radius

_STRAIGHT_LENGTH = 2.5  # of the radius: a prismatic joint's arrow
DARKER = 0.4  # how bright a straight arrow beyond its limit is
MAX_SEGMENTS, _FEWEST_SEGMENTS = 34, 10  # boxes of a ribbon
_GEOMS_FOR_THE_REST = 60  # legend, status, names, smart arrows


def arrow_widths(
    values: Array, limit: Array, radius: Array, width_scale: Array, dead_band: Array
) -> NDArray[np.float64]:
    """Width of the arrow for every joint.

    Args:
        values: what arrows show, (N,); the sign does not matter.
        limit: at which value an arrow is at full width, (N,); inf where there is none.
        radius: `arrow_radius` (N,), m.
        width_scale: `arrow_width_scale` (N,), m per unit of the value.
        dead_band: share of the limit below which an arrow has no width, (N,).

    Returns:
        (N,), m; continuous and monotone in the value, 0 up to the dead band and for NaN, at most
        `WIDEST` times the radius.
    """
    size = np.abs(values)
    size[~np.isfinite(size)] = 0.0
    limited = np.isfinite(limit)
    share = size / np.where(limited, limit, 1.0)
    band = np.maximum(dead_band, 1e-9)
    grown = np.minimum(np.maximum(share / band - 1.0, 0.0), 1.0)
    of_limit = radius * (width_scale / DEFAULT_WIDTH_SCALE) * np.sqrt(share) * grown
    return np.minimum(np.where(limited, of_limit, size * width_scale), WIDEST * radius)


class RoundArrows(Feature):
    """Draws the arrows of one world's joints."""

    order = 90  # what finds no room are boxes of arrows

    def draw(self, frame: Frame) -> None:
        """Draws an arrow for every joint that has a value and whose arrow is shown."""
        pen, data, shown = frame.pen, frame.data, frame.shown
        values, limit, stale = frame.arrow_values, frame.arrow_limit, frame.stale_joints
        joints = self.world.joints
        by_load = np.isinf(limit) & np.isfinite(joints.arrow_load)
        scale = np.where(by_load, joints.arrow_radius / joints.arrow_load, joints.arrow_width_scale)
        widths = arrow_widths(values, limit, joints.arrow_radius, scale, joints.arrow_dead_band)
        visible = shown.arrows & (widths > INVISIBLE_WIDTH * joints.arrow_radius)
        over = np.abs(values) > limit  # false for NaN
        rgba = np.where((values > 0)[:, None], POSITIVE_RGBA, NEGATIVE_RGBA)
        rgba[stale, :3] = GREY
        rgba[:, 3] = joints.arrow_alpha
        turning = (visible & joints.revolute).nonzero()[0]
        sliding = (visible & ~joints.revolute).nonzero()[0]
        if len(turning):
            sites = joints.centre_site[turning]
            sign = np.sign(values[turning])
            # The site turns with its link; without q the arrow would turn faster or slower than
            # all others whenever its joint moves.
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
            draw_ribbons(pen, Kind.ARROW, ribbons, _segments(frame))
        if len(sliding):
            self._draw_straight(pen, data, sliding, (values, widths, over, rgba))

    def _draw_straight(
        self,
        pen: Pen,
        data: mujoco.MjData,
        index: NDArray[np.intp],
        look: tuple[Array, Array, NDArray[np.bool_], Array],
    ) -> None:
        """A prismatic joint's force: a straight arrow along its axis, beside the link.

        It is one geom and cannot be striped; beyond the limit it is dark.
        """
        forces, widths, over, rgba = (of_all[index] for of_all in look)
        joints = self.world.joints
        rows = pen.take(len(index), int(mujoco.mjtGeom.mjGEOM_ARROW), Kind.ARROW, index)
        if not len(rows):
            return
        mat = data.site_xmat[joints.centre_site[index]].reshape(-1, 3, 3).copy()
        mat[:, :, 1:] *= np.sign(forces)[:, None, None]  # half a turn about x: stays a rotation
        radius = joints.arrow_radius[index][:, None]
        length = _STRAIGHT_LENGTH * radius
        centre = data.site_xpos[joints.centre_site[index]]
        rows["pos"] = centre + radius * mat[:, :, 0] - length / 2 * mat[:, :, 2]
        rows["mat"] = mat
        rows["size"][:, :2] = (widths / 4)[:, None]
        rows["size"][:, 2] = ARROW_SIZE_OF_LENGTH * length[:, 0]
        rgba[over, :3] *= DARKER
        rows["rgba"] = rgba


def _segments(frame: Frame) -> int:
    """How finely ribbons are drawn, so that everything that is shown finds room in every host.

    It depends on what is switched on and not on the values, which would make them flicker.
    """
    of_cards = sum(2 + len(lines) for cards in frame.cards for lines in cards.texts)
    others = 3 * int(np.count_nonzero(frame.shown.axes)) + of_cards
    room = MAX_GEOMS - _GEOMS_FOR_THE_REST - others
    budget = room // max(int(np.count_nonzero(frame.shown.arrows)), 1)
    return min(max(budget, _FEWEST_SEGMENTS), frame.max_segments)
