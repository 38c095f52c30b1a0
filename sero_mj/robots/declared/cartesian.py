"""Named frames, received frames and smart arrows (sections 2.4 and 2.5 of the paper)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from ...base.declaration import Declaration, Frame, Name, Point, Rgba, of_shape
from ...base.frames import Array
from .double import AXES_OPACITY, Double
from .robot import SerialRobot
from .surroundings import Object

WORLD = "world"
VectorKind = Literal["force", "torque", "velocity", "angular_velocity"]
# Kinds that are shown as a round arrow about the vector.
ROUND_KINDS = ("torque", "angular_velocity")
UNITS = {"force": "N", "torque": "Nm", "velocity": "m/s", "angular_velocity": "rad/s"}
# Default scales, m per SI unit. 100 N, 20 Nm, 1 m/s and 2 rad/s are large for a light-weight robot.
_SCALES = {"force": 0.004, "torque": 0.005, "velocity": 0.5, "angular_velocity": 0.05}
# These colors differ from those of joint arrows (orange, blue) and axes (red, green, blue).
_RGBA = {
    "force": (0.76, 0.08, 0.50, 1.0),
    "torque": (0.50, 0.16, 0.72, 1.0),
    "velocity": (0.00, 0.50, 0.52, 1.0),
    "angular_velocity": (0.36, 0.42, 0.05, 1.0),
}

_point = of_shape(3).func


def _place(value: Any) -> Any:
    return value if isinstance(value, str) else _point(value)  # type: ignore[call-arg]


class SmartArrow(Declaration):
    """A Cartesian vector of a scene, shown as a straight or round arrow where it acts.

    A route to the input `NAME.vector` sets the vector.

    Attributes:
        name: name in routes, for example `contact` in `contact.vector`.
        kind: `force`, `torque`, `velocity` or `angular_velocity`.
        at: frame at which the vector acts (`lwr/flange`), or a point in world coordinates, m.
        expressed_in: frame in which the components are expressed, or `world` (default: the frame
            `at`, or the world if `at` is a point).
        vector: initial components, shape (3,); None for no data.
        scale: length of a straight arrow or width of a round arrow in m per unit of the vector.
        longest: maximum length or width of the arrow, m. If the vector is larger, a straight arrow
            is dark and a round arrow is striped.
        radius: radius of a round arrow, m.
        unit: unit shown after the numbers (default: the SI unit of the kind).
        decimals: number of decimals.
        rgba: red, green, blue and opacity, from 0 to 1 (default: depends on the kind).
        show: whether the arrow is shown.
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
        return self.kind in ROUND_KINDS

    @property
    def metres_per_unit(self) -> float:
        """Arrow length or width in m per unit of the vector. The default depends on the kind."""
        return _SCALES[self.kind] if self.scale is None else self.scale

    @property
    def limit(self) -> float:
        """Maximum arrow length or width in m, from `longest`.

        The default is 0.5 m for straight arrows, and the radius for round arrows.
        """
        if self.longest is not None:
            return self.longest
        return self.radius if self.is_round else 0.5

    @property
    def unit_text(self) -> str:
        """Displayed unit, by default the SI unit of the kind."""
        return UNITS[self.kind] if self.unit is None else self.unit

    @property
    def color(self) -> Array:
        return np.array(_RGBA[self.kind]) if self.rgba is None else self.rgba

    @property
    def site(self) -> str | None:
        return None if isinstance(self.at, str) else f"arrow-{self.name}"

    @property
    def components_in(self) -> str:
        """Name of the frame in which the components are expressed, or `world`."""
        if self.expressed_in is not None:
            return self.expressed_in
        return self.at if isinstance(self.at, str) else WORLD


class ReceivedFrame(Declaration):
    """A coordinate frame of a scene that is received from a source and shown as axes.

    Routes set its input `NAME.frame`, the 4x4 matrix T_relative_to_NAME, and can read it.

    Attributes:
        name: name in routes, for example `target` in `target.frame`.
        relative_to: reference frame, for example `lwr/base`, or `world`.
        frame: initial pose, used until data arrives. If None, the frame is hidden until then.
        show_axes: whether the axes are shown.
        axes_size: length of the axes, m.
        axes_transparency: transparency of the axes, from 0 (opaque) to 1 (invisible).
    """

    name: Name
    relative_to: str = WORLD
    frame: Frame | None = None
    show_axes: bool = True
    axes_size: float = Field(0.2, gt=0)
    axes_transparency: float = Field(0.0, ge=0, le=1)


@dataclass(frozen=True)
class NamedFrame:
    """A frame of a scene that arrows, routes and cameras can refer to by name.

    Attributes:
        shown_with: name of the robot or double whose `show_axes` applies, or empty if the frame has
            its own toggle.
        moves_with: name of the robot, double or received frame that moves the frame, or empty if
            the frame is fixed.
        shown: initial state of the frame's own toggle.
    """

    name: str
    site: str
    shown_with: str
    moves_with: str
    size: float
    alpha: float
    shown: bool = True


def list_frames(
    robots: Mapping[str, SerialRobot],
    doubles: Mapping[str, Double],
    frames: Mapping[str, ReceivedFrame],
    objects: Sequence[Object],
) -> dict[str, NamedFrame]:
    """Returns the frames of robots, doubles, received frames and `axes` objects, by name."""
    found: list[NamedFrame] = []
    for name, robot in robots.items():
        look = (name, name, robot.axes_length, 1.0 - robot.axes_transparency)
        sites = [("base", "base")]
        sites += [(f"link{i + 1}", f"frame{i + 1}") for i in range(robot.n)]
        sites += [("flange", "flange_frame")]
        found += [NamedFrame(f"{name}/{label}", f"{name}/{site}", *look) for label, site in sites]
        found += _axes_objects(robot.children, name)
    for name, double in doubles.items():
        if double.path is None and double.of in robots:
            robot = robots[double.of]
            alpha = AXES_OPACITY * (1.0 - robot.axes_transparency)
            look = (name, name, robot.axes_length, alpha)
            # A double has no base frame of its own, because it shares the base of its robot.
            labels = [f"link{i + 1}" for i in range(robot.n)] + ["flange"]
            sites = [(label, label.replace("link", "frame")) for label in labels]
            found += [
                NamedFrame(f"{name}/{label}", f"double-{name}-{site}", *look)
                for label, site in sites
            ]
    found += _axes_objects(objects, "")
    found += [
        NamedFrame(
            name, f"frame-{name}", "", name, frame.axes_size, 1.0 - frame.axes_transparency,
            frame.show_axes,
        )
        for name, frame in frames.items()
    ]  # fmt: skip
    return {frame.name: frame for frame in found}


def _axes_objects(items: Sequence[Object], name: str) -> list[NamedFrame]:
    scope = f"{name}/" if name else ""
    return [
        NamedFrame(
            f"{scope}{item.name}", f"{scope}axes_{item.name}", "", name, float(item.size[0]), 1.0
        )
        for item in items
        if item.shape == "axes" and item.size is not None
    ]
