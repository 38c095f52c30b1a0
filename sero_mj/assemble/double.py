"""`Double`: a transparent robot at a target pose, or a row of them along a path (section 2.3)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from ..declaration import Array, Declaration, Name, Rgba, Vector, of_shape
from .robot_parts import ArrowQuantity, BillboardLine, as_billboard_lines

# Green for commanded positions, as in the paper's section 4.2.
COMMANDED_RGBA = np.array([0.20, 0.72, 0.36, 0.36])
# A link nearer to the robot's than this is hidden: it would only flicker in its surface.
HIDDEN_DISTANCE = 0.002  # m
HIDDEN_ANGLE = np.deg2rad(0.5)
# Opacity of a path's first and last double: the row must not hide the robot.
PATH_FADE = (0.12, 0.6)


class Double(Declaration):
    """A transparent double of a robot.

    Its inputs (`NAME.joint_angles`, `NAME.torques`, ...) are routed to like a robot's. It stands
    on the base of its robot, takes no part in collisions, and a link of it that coincides with
    the robot's is hidden. Limits, radii and sizes are its robot's.

    Attributes:
        name: in routes, e.g. `commanded` in `commanded.joint_angles`.
        of: the robot it doubles.
        rgba: its colour; the last number is its opacity.
        joint_angles: (n,), where it stands until something is received; out of sight when None.
        path: (k, n), joint angles along a planned motion: a row of doubles from its first to its
            last row, fading towards the start. A path is not routed to.
        path_length: how many doubles show the path.
        visible: whether it is shown.
        show_axes: whether coordinate axes are shown at every joint and the flange.
        show_arrows: whether round arrows are shown.
        arrow_quantity: what they show; None for what its robot's show.
        show_billboards: whether billboards are shown.
        billboard_lines: what they say; None for what its robot's say, as far as it has values.
        torques: measured, (n,), until something is received; None for no data.
        commanded_torques: (n,), likewise.
        joint_accelerations: (n,), likewise.
        billboard_values: (n,), likewise.
    """

    name: Name
    of: Name
    rgba: Rgba = COMMANDED_RGBA
    joint_angles: Vector | None = None
    path: Annotated[Array | None, of_shape(None, None)] = None
    path_length: int = Field(6, ge=2, le=20)
    visible: bool = True
    show_axes: bool = False
    show_arrows: bool = False
    arrow_quantity: ArrowQuantity | None = None
    show_billboards: bool = False
    billboard_lines: Annotated[list[BillboardLine] | None, BeforeValidator(as_billboard_lines)] = (
        None
    )
    torques: Vector | None = None
    commanded_torques: Vector | None = None
    joint_accelerations: Vector | None = None
    billboard_values: Vector | None = None

    def poses(self) -> Array:
        """Joint angles of every double along the path, (path_length, n), evenly in joint space."""
        assert self.path is not None
        steps = np.linalg.norm(np.diff(self.path, axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)])
        at = np.linspace(0.0, along[-1], self.path_length)
        return np.stack([np.interp(at, along, column) for column in self.path.T], axis=1)
