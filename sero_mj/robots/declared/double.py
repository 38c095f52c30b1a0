"""`Double`: a transparent double of a robot at a target pose or along a path (section 2.3)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from ...base.declaration import Name, Rgba, Vector, of_shape
from ...base.frames import Array
from .robot_parts import ArrowQuantity, BillboardLines, Posed

# Green for commanded positions, as in section 4.2 of the paper. A bluish green differs from the
# orange of arrows for people with red-green color blindness.
COMMANDED_RGBA = np.array([0.28, 0.84, 0.66, 0.36])
AXES_OPACITY = 0.5  # opacity of the coordinate axes of doubles
DOUBLE_GROUP = 2  # geom group of doubles
OUT_OF_SIGHT = np.array([0.0, 0.0, -1000.0])
# A link that is closer to the same link of the robot is hidden, to avoid flicker (z-fighting). It
# fades in with the distance, and has full opacity at `_SHOWN_FROM` times this distance.
_HIDDEN_DISTANCE = 0.002  # m
_HIDDEN_ANGLE = np.deg2rad(0.5)
_SHOWN_FROM = 5.0
_CLEARANCE = 4.0  # distance in arrow radii at which links of a path have full opacity
# Opacity factors of a path's first and last double: the path must not hide the robot.
_PATH_FADE = (0.12, 0.6)


class Double(Posed):
    """A transparent double of a robot, for example at the commanded joint angles.

    Routes set its inputs (`NAME.joint_angles`, `NAME.torques`, ...), like those of a robot. It has
    the base frame, limits and arrow sizes of its robot, and does not collide. A link of the double
    is hidden where it coincides with the robot, and fades in as it moves away.

    Attributes:
        name: name in routes, for example `commanded` in `commanded.joint_angles`.
        of: name of the robot.
        rgba: color as red, green, blue and opacity, from 0 to 1.
        joint_angles: initial joint angles, shape (n,), rad or m, used until data arrives. If None,
            the double is hidden until then.
        joint_angles_deg: initial joint angles in degrees, shape (n,).
        path: joint angles along a planned motion, shape (k, n), rad or m, shown by several doubles
            that fade towards the start. A double with a path has no inputs.
        path_length: number of doubles that show the path.
        visible: whether the double is shown.
        show_axes: whether coordinate axes are shown at every joint and the flange.
        show_arrows: whether round arrows are shown.
        arrow_quantity: quantity that the arrows show (default: that of the robot).
        show_billboards: whether billboards are shown.
        billboard_lines: lines of the billboards (default: those of the robot that have values).
        torques: initial measured torques, shape (n,), Nm or N; None for no data.
        commanded_torques: initial commanded torques, shape (n,), Nm or N; None for no data.
        joint_accelerations: initial accelerations, shape (n,), rad/s2 or m/s2; None for no data.
        billboard_values: initial billboard values, shape (n,); None for no data.
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
        """Returns evenly spaced joint angles on the path, shape (path_length, n), rad or m."""
        assert self.path is not None
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.linspace(0.0, along[-1], self.path_length)
        return np.stack([np.interp(at, along, column) for column in self.path.T], axis=1)


def path_fade(count: int) -> Array:
    """Returns opacity factors of `count` doubles along a path, increasing towards its end."""
    return np.linspace(*_PATH_FADE, count) if count > 1 else np.ones(count)


def fade_in(positions: Array, rotations: Array, others: Array, other_rotations: Array) -> Array:
    """Returns an opacity factor for each link of a double.

    A factor is 0 where the link coincides with the robot, and increases to 1 as it moves away.

    Args:
        positions: positions of the double's links, shape (..., 3), m.
        rotations: rotation matrices of the double's links, shape (..., 9).
        others: positions of the robot's links, shape (..., 3), m.
        other_rotations: rotation matrices of the robot's links, shape (..., 9).
    """
    distance = np.linalg.norm(positions - others, axis=-1)
    # The trace of R_double^T R_robot is 1 + 2 cos(angle between them).
    trace = np.einsum("...i,...i->...", rotations, other_rotations)
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    apart = np.maximum(distance / _HIDDEN_DISTANCE, angle / _HIDDEN_ANGLE)
    return np.asarray(np.clip((apart - 1.0) / (_SHOWN_FROM - 1.0), 0.0, 1.0))


def spread_out(positions: Array, radii: Array) -> Array:
    """Returns opacity factors that hide overlapping links along a path, shape (rows, n + 1).

    Overlapping doubles would merge visually. Starting from the last double, a link is shown only if
    it is far enough from the same link of the next visible double.

    Args:
        positions: positions of the base and the links of each double, shape (rows, n + 1, 3), m.
        radii: arrow radii of the joints, shape (n,), m.
    """
    rows, links = positions.shape[:2]
    factors = np.ones((rows, links))
    clear = _CLEARANCE * np.append(radii[:1], radii)
    shown = positions[-1].copy()
    shown_end = np.roll(shown, -1, axis=0)
    for k in reversed(range(rows - 1)):
        end = np.roll(positions[k], -1, axis=0)
        moved = np.linalg.norm(positions[k] - shown, axis=1)
        # A link rotates about its first end. The last link extends to its own frame.
        moved[:-1] = np.maximum(moved, np.linalg.norm(end - shown_end, axis=1))[:-1]
        factors[k] = np.clip(2.0 * moved / clear - 1.0, 0.0, 1.0)
        is_shown = factors[k] > 0.5
        shown[is_shown], shown_end[is_shown] = positions[k][is_shown], end[is_shown]
    return factors
