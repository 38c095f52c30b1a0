"""Round arrows turn about their joint and show a value by direction and width.

An arrow is a ribbon of thin boxes with a head that tapers in width and thickness, so that it
reads as an arrow head both from the side and along the axis. It turns at constant speed, by the
right-hand rule about the joint's z for a positive torque; a colour tells the sign as well.

Width: with a limit, `arrow_radius` (times `arrow_width_scale` / 0.01) at the limit and with the
square root of the value below it, so that 2 % of the limit still has a seventh of the full width;
nothing below the dead band. Without a limit, `arrow_width_scale` m per unit. Beyond the limit the
ribbon is striped. Source: the paper's section 2.2; root, dead band and stripes are ours.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.world import World
from .pen import ARROW_SIZE_OF_LENGTH, MAX_GEOMS, Kind, Pen
from .toggles import Toggles

Array = NDArray[np.float64]

# Orange and blue: told apart by every common kind of colour blindness (Okabe and Ito 2008).
POSITIVE_RGBA = (0.93, 0.45, 0.02, 1.0)
NEGATIVE_RGBA = (0.02, 0.36, 0.78, 1.0)

STRIPE_RGBA = (0.08, 0.08, 0.09, 1.0)

TURNING_SPEED = 1.6  # rad/s
DEFAULT_WIDTH_SCALE = 0.01  # the proto's arrow_width_scale
INVISIBLE_WIDTH = 0.03  # of the radius; narrower (0.1 % of a torque limit) is no arrow
WIDEST = 1.5  # of the radius

_ARC = np.deg2rad(300.0)
_HEAD_ARC = np.deg2rad(52.0)
_THICKNESS = 0.05  # of the radius
_HEAD_THICKNESS = 0.30  # of the radius, where the head is thickest
_HEAD_WIDER = (1.5, 0.28)  # the head is this times the width, plus this of the radius, wide
_FULL_HEAD_WIDTH = 0.14  # of the radius: the width at 2 % of the limit, from where heads are full
_STRAIGHT_LENGTH = 2.5  # of the radius: a prismatic joint's arrow
_DARKER = 0.4  # how bright a straight arrow beyond its limit is
_MOST_SEGMENTS, _FEWEST_SEGMENTS = 34, 10
_GEOMS_FOR_ARROWS = 620  # the rest of `MAX_GEOMS` is for billboards and axes


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


class RoundArrows:
    """Draws the arrows of one world; holds the ribbon's shape, which never changes."""

    def __init__(self, world: World) -> None:
        self._world = world
        budget = min(_GEOMS_FOR_ARROWS, MAX_GEOMS) // max(len(world.joints.names), 1)
        self.segments = int(np.clip(budget, _FEWEST_SEGMENTS, _MOST_SEGMENTS))
        self._angle, self._half_angle, self._head, self._taper = _ribbon(self.segments)

    def draw(
        self, pen: Pen, data: mujoco.MjData, toggles: Toggles, values: Array, limit: Array
    ) -> None:
        """Draws an arrow for every joint that has a value and whose arrow is shown.

        Args:
            pen: where to.
            data: the world's state.
            toggles: what is shown.
            values: what the arrows show, (N,), NaN for no data.
            limit: at which value an arrow is at full width, (N,).
        """
        joints = self._world.joints
        widths = arrow_widths(
            values, limit, joints.arrow_radius, joints.arrow_width_scale, joints.arrow_dead_band
        )
        shown = toggles.arrows & (widths > INVISIBLE_WIDTH * joints.arrow_radius)
        over = np.abs(values) > limit  # false for NaN
        turning = (shown & joints.revolute).nonzero()[0]
        sliding = (shown & ~joints.revolute).nonzero()[0]
        if len(turning):
            self._draw_round(pen, data, turning, values[turning], widths[turning], over[turning])
        if len(sliding):
            self._draw_straight(pen, data, sliding, values[sliding], widths[sliding], over[sliding])

    def _draw_round(
        self,
        pen: Pen,
        data: mujoco.MjData,
        index: NDArray[np.intp],
        torques: Array,
        widths: Array,
        over: NDArray[np.bool_],
    ) -> None:
        joints = self._world.joints
        rows = pen.take(
            len(index) * self.segments,
            int(mujoco.mjtGeom.mjGEOM_BOX),
            Kind.ARROW,
            np.repeat(index, self.segments),
        )
        if not len(rows):
            return
        sign = np.sign(torques)[:, None]
        # The site turns with its link; without q the arrow would turn faster or slower than
        # all others whenever its joint moves.
        phase = TURNING_SPEED * data.time - data.qpos[joints.qpos[index]][:, None] * sign
        angle = sign * (phase + self._angle)
        cos, sin = np.cos(angle)[..., None], np.sin(angle)[..., None]
        axes = data.site_xmat[joints.centre_site[index]].reshape(-1, 1, 3, 3)
        x, y = axes[..., 0], axes[..., 1]
        outward = cos * x + sin * y
        radius = joints.arrow_radius[index]
        centre = data.site_xpos[joints.centre_site[index]]

        grid = rows.reshape(len(index), self.segments)
        grid["pos"] = centre[:, None] + radius[:, None, None] * outward
        grid["mat"][..., 0] = outward
        grid["mat"][..., 1] = cos * y - sin * x
        grid["mat"][..., 2] = axes[..., 2]
        # A head of constant size on a hair-thin arrow would make noise look like a torque.
        grown = np.minimum(widths / (_FULL_HEAD_WIDTH * radius), 1.0)
        head_width = _HEAD_WIDER[0] * widths + _HEAD_WIDER[1] * radius * grown
        width = np.where(self._head, head_width[:, None] * self._taper, widths[:, None])
        head_thickness = _HEAD_THICKNESS * grown[:, None] * self._taper
        thickness = np.where(self._head, head_thickness, _THICKNESS)
        thickness = radius[:, None] * np.maximum(thickness, _THICKNESS)
        grid["size"][..., 0] = thickness / 2
        # Neighbours meet at the ribbon's outer edge.
        grid["size"][..., 1] = (radius[:, None] + thickness / 2) * np.tan(self._half_angle)
        grid["size"][..., 2] = width / 2
        grid["rgba"] = _colours(torques)[:, None]
        # Beyond the limit the ribbon is striped like a warning tape, whatever its width.
        striped = grid[over, 1 : self.segments : 2]
        striped["rgba"] = STRIPE_RGBA
        grid[over, 1 : self.segments : 2] = striped

    def _draw_straight(
        self,
        pen: Pen,
        data: mujoco.MjData,
        index: NDArray[np.intp],
        forces: Array,
        widths: Array,
        over: NDArray[np.bool_],
    ) -> None:
        """A prismatic joint's force: a straight arrow along its axis, beside the link.

        It is one geom and cannot be striped; beyond the limit it is dark.
        """
        joints = self._world.joints
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
        rows["rgba"] = _colours(forces)
        dark = rows[over]
        dark["rgba"][:, :3] *= _DARKER
        rows[over] = dark


def _colours(torques: Array) -> Array:
    return np.where((torques > 0)[:, None], POSITIVE_RGBA, NEGATIVE_RGBA)


def _ribbon(segments: int) -> tuple[Array, Array, NDArray[np.bool_], Array]:
    """The ribbon's shape along its arc, from tail to tip.

    Returns:
        middle angle and half the angle of every segment (rad), which ones are of the head, and
        the head's taper from 1 to 0.
    """
    heads = max(4, round(0.35 * segments))
    tails = segments - heads
    edges = np.concatenate(
        [
            np.linspace(0.0, _ARC - _HEAD_ARC, tails + 1),
            np.linspace(_ARC - _HEAD_ARC, _ARC, heads + 1)[1:],
        ]
    )
    head = np.arange(segments) >= tails
    taper = np.ones(segments)
    taper[head] = 1.0 - (np.arange(heads) + 0.5) / heads
    return (edges[:-1] + edges[1:]) / 2, np.diff(edges) / 2, head, taper
