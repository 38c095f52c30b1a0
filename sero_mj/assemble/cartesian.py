"""What is received in Cartesian space: frames, and vectors that smart arrows show (2.4, 2.5)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from ..declaration import Array, Declaration, Frame, Name, Point, Rgba, of_shape

VectorKind = Literal["force", "torque", "velocity", "angular_velocity"]
# What turns about its direction, and is shown by a round arrow.
ROUND_KINDS = ("torque", "angular_velocity")
UNITS = {"force": "N", "torque": "Nm", "velocity": "m/s", "angular_velocity": "rad/s"}
# Metres per unit: 100 N, 20 Nm, 1 m/s and 2 rad/s are large for a light-weight robot.
_SCALES = {"force": 0.004, "torque": 0.005, "velocity": 0.5, "angular_velocity": 0.05}
# Neither the colours of joint arrows (orange, blue) nor those of axes (red, green, blue).
_RGBA = {
    "force": (0.76, 0.08, 0.50, 1.0),
    "torque": (0.50, 0.16, 0.72, 1.0),
    "velocity": (0.00, 0.50, 0.52, 1.0),
    "angular_velocity": (0.36, 0.42, 0.05, 1.0),
}

_point = of_shape(3).func


def _place(value: Any) -> Any:
    """A frame's name, or a point of the world."""
    return value if isinstance(value, str) else _point(value)  # type: ignore[call-arg]


class SmartArrow(Declaration):
    """A Cartesian vector, drawn where it acts: straight, or round about its direction.

    Its input `NAME.vector` is routed to like a robot's.

    Attributes:
        name: in routes, e.g. `contact` in `contact.vector`.
        kind: `force`, `torque`, `velocity` or `angular_velocity`.
        at: the frame it acts at (`lwr/flange`), or a point of the world, m.
        expressed_in: the frame its components are in, or `world`; None for the frame it acts
            at, and the world for a point.
        vector: its components until something is received; None for no data.
        scale: m per unit of its magnitude: length of a straight arrow, width of a round one.
        longest: length or width that larger magnitudes do not exceed, m; they are striped or
            dark.
        radius: of a round arrow, m.
        unit: shown behind its numbers; None for the kind's SI unit.
        decimals: of its numbers.
        rgba: colour; None for the kind's.
        show: whether it is shown.
    """

    name: Name
    kind: VectorKind = "force"
    at: Annotated[Any, BeforeValidator(_place)]
    expressed_in: str | None = None
    vector: Point | None = None
    scale: float | None = Field(None, gt=0)
    longest: float | None = Field(None, gt=0)
    radius: float = Field(0.12, gt=0)
    unit: str | None = None
    decimals: int = Field(2, ge=0, le=9)
    rgba: Rgba | None = None
    show: bool = True

    @property
    def is_round(self) -> bool:
        """Whether it turns about its direction."""
        return self.kind in ROUND_KINDS

    @property
    def metres_per_unit(self) -> float:
        """`scale`, or what suits the kind."""
        return _SCALES[self.kind] if self.scale is None else self.scale

    @property
    def limit(self) -> float:
        """`longest` in m: half a metre, for a round arrow its radius."""
        if self.longest is not None:
            return self.longest
        return self.radius if self.is_round else 0.5

    @property
    def unit_text(self) -> str:
        """`unit`, or the kind's."""
        return UNITS[self.kind] if self.unit is None else self.unit

    @property
    def color(self) -> Array:
        """`rgba`, or the kind's, (4,)."""
        return np.array(_RGBA[self.kind]) if self.rgba is None else self.rgba

    @property
    def site(self) -> str | None:
        """Site of the point it stands at; None where it stands at a frame."""
        return None if isinstance(self.at, str) else f"arrow-{self.name}"

    @property
    def components_in(self) -> str:
        """Name of the frame its components are in, or `world`."""
        if self.expressed_in is not None:
            return self.expressed_in
        return self.at if isinstance(self.at, str) else "world"


class ReceivedFrame(Declaration):
    """A frame that is received, shown as axes. Other things can be routed from it.

    Its input `NAME.frame` takes T_relative_to_NAME.

    Attributes:
        name: in routes, e.g. `target` in `target.frame`.
        relative_to: the frame it is given in, e.g. `lwr/base`, or `world`.
        frame: where it is until something is received; out of sight when None.
        show_axes: whether its axes are shown.
        axes_size: length of its axes, m.
        axes_transparency: 0 opaque, 1 invisible.
    """

    name: Name
    relative_to: str = "world"
    frame: Frame | None = None
    show_axes: bool = True
    axes_size: float = Field(0.2, gt=0)
    axes_transparency: float = Field(0.0, ge=0, le=1)
