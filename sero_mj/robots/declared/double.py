"""`Double`: a transparent copy of a robot at a target pose or along a path (section 2.3)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from ...base.declaration import Name, Rgba, Vector, of_shape
from ...base.frames import Array
from .robot_parts import ArrowQuantity, BillboardLines, Posed

# Green for commanded positions, as in the paper's section 4.2; a bluish one, since who cannot see
# red would take a pure one for the orange of arrows.
COMMANDED_RGBA = np.array([0.28, 0.84, 0.66, 0.36])
AXES_OPACITY = 0.5  # of its coordinate axes
DOUBLE_GROUP = 2  # of its geoms
OUT_OF_SIGHT = np.array([0.0, 0.0, -1000.0])
# A link closer to the robot's own than this is hidden, to avoid flicker (z-fighting), and has full
# opacity at this multiple of it, so that it fades in.
_HIDDEN_DISTANCE = 0.002  # m
_HIDDEN_ANGLE = np.deg2rad(0.5)
_SHOWN_FROM = 5.0
_CLEARANCE = 4.0  # in arrow radii, at which a path's doubles are fully shown
# Opacity factors of a path's first and last double: the path must not hide the robot.
_PATH_FADE = (0.12, 0.6)


class Double(Posed):
    """A transparent copy of a robot.

    Its inputs (`NAME.joint_angles`, `NAME.torques`, ...) are set by routes, as a robot's are. It
    has the base frame, limits and arrow sizes of its robot and does not collide. A link that
    coincides with the robot's is hidden; it fades in as it moves away.

    Attributes:
        name: in routes, e.g. `commanded` in `commanded.joint_angles`.
        of: the robot it doubles.
        rgba: its colour; the last number is its opacity.
        joint_angles: (n,), initial pose, used until something is received; None hides it until
            then.
        joint_angles_deg: the same in degrees; converted to joint_angles.
        path: (k, n), joint angles along a planned motion, shown as several doubles that fade
            towards the start. A path has no inputs.
        path_length: number of doubles that show the path.
        visible: whether it is shown.
        show_axes: whether coordinate axes are shown at every joint and the flange.
        show_arrows: whether round arrows are shown.
        arrow_quantity: quantity that the arrows show; None for that of its robot.
        show_billboards: whether billboards are shown.
        billboard_lines: lines of the billboards; None for its robot's, as far as it has values.
        torques: initial measured torques, (n,), Nm or N; None for no data.
        commanded_torques: initial commanded torques, (n,), Nm or N; None for no data.
        joint_accelerations: initial accelerations, (n,), rad/s2 or m/s2; None for no data.
        billboard_values: initial billboard values, (n,); None for no data.
    """

    name: Name
    of: Name
    rgba: Rgba = COMMANDED_RGBA
    path: Annotated[Array | None, of_shape(None, None)] = None
    path_length: int = Field(6, ge=2, le=20)
    visible: bool = True
    show_axes: bool = False
    show_arrows: bool = False
    arrow_quantity: ArrowQuantity | None = None
    show_billboards: bool = False
    billboard_lines: BillboardLines = None
    torques: Vector | None = None
    commanded_torques: Vector | None = None
    joint_accelerations: Vector | None = None
    billboard_values: Vector | None = None

    def poses(self) -> Array:
        """Returns joint angles evenly spaced along the path, (path_length, n), rad or m."""
        assert self.path is not None
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.linspace(0.0, along[-1], self.path_length)
        return np.stack([np.interp(at, along, column) for column in self.path.T], axis=1)


def path_fade(count: int) -> Array:
    """Returns the opacity factors of the doubles along a path, (count,); 1 for a single one."""
    return np.linspace(*_PATH_FADE, count) if count > 1 else np.ones(count)


def fade_in(positions: Array, rotations: Array, others: Array, other_rotations: Array) -> Array:
    """Returns the opacity factors of a double's links, (...,), by their poses and the robot's.

    It is 0 where a link coincides with its robot's, and rises to 1 as it moves away. Positions are
    (..., 3), m, rotations (..., 9).
    """
    distance = np.linalg.norm(positions - others, axis=-1)
    # The trace of R_double^T R_robot is 1 + 2 cos(angle between them).
    trace = np.einsum("...i,...i->...", rotations, other_rotations)
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    apart = np.maximum(distance / _HIDDEN_DISTANCE, angle / _HIDDEN_ANGLE)
    return np.asarray(np.clip((apart - 1.0) / (_SHOWN_FROM - 1.0), 0.0, 1.0))


def spread_out(positions: Array, radii: Array) -> Array:
    """Returns the opacity factors of the links of a path's doubles, (rows, n + 1).

    Starting from the last double, a link is shown if it is clear of the same link of the previously
    shown double: overlapping doubles would merge. Positions are those of the links' frames, from
    the base on, (rows, n + 1, 3), m, and radii those of the arrows, (n,), m.
    """
    rows, links = positions.shape[:2]
    factors = np.ones((rows, links))
    clear = _CLEARANCE * np.append(radii[:1], radii)
    kept = positions[-1].copy()
    kept_end = np.roll(kept, -1, axis=0)
    for k in reversed(range(rows - 1)):
        end = np.roll(positions[k], -1, axis=0)
        moved = np.linalg.norm(positions[k] - kept, axis=1)
        # A link turns about its first end; the last one extends to its own frame.
        moved[:-1] = np.maximum(moved, np.linalg.norm(end - kept_end, axis=1))[:-1]
        factors[k] = np.clip(2.0 * moved / clear - 1.0, 0.0, 1.0)
        is_shown = factors[k] > 0.5
        kept[is_shown], kept_end[is_shown] = positions[k][is_shown], end[is_shown]
    return factors
