"""The named frames of a scene: they can show axes, and routes can refer to them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .cartesian import ReceivedFrame
from .double import Double
from .objects import Object
from .robot import SerialRobot

WORLD = "world"
_DOUBLE_ALPHA = 0.5  # opacity of a double's axes


@dataclass(frozen=True)
class NamedFrame:
    """A named frame.

    Attributes:
        name: e.g. `lwr/link3`.
        site: its site in the model.
        shown_with: the robot or double whose `show_axes` applies; empty when it has its own
            toggle.
        moves_with: the robot, double or received frame that moves it; empty when it is fixed.
        size: length of the axes, m.
        alpha: 0 invisible to 1 opaque.
        shown: whether it is initially shown, for a frame with its own toggle.
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
    """Returns all frames of a scene by name, except `world`.

    Args:
        robots: by name.
        doubles: by name.
        frames: received frames by name.
        objects: of the scene; those of shape `axes` are frames.
    """
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
            alpha = _DOUBLE_ALPHA * (1.0 - robot.axes_transparency)
            look = (name, name, robot.axes_length, alpha)
            # A double has the base frame of its robot.
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
    """Returns the frames of objects of shape `axes`, which have their own toggle."""
    scope = f"{name}/" if name else ""
    return [
        NamedFrame(
            f"{scope}{item.name}", f"{scope}axes_{item.name}", "", name, float(item.size[0]), 1.0
        )
        for item in items
        if item.shape == "axes" and item.size is not None
    ]
