"""Named frames of an external model: its bodies and sites."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.double import Double
from ..assemble.named_frames import NamedFrame
from ..errors import UnknownName
from ._found_robot import FoundPart, FoundRobot
from .model_trees import Tree, without_scope

Ints = NDArray[np.intp]

_DOUBLE_ALPHA = 0.5  # opacity of a double's axes
BASE = "base"


@dataclass(frozen=True)
class FrameSource:
    """Where the pose of a frame is read from.

    Attributes:
        of: the double in whose state it is read; empty for the model's own state.
        row: row of `xpos` for a body; number of bodies plus row of `site_xpos` for a site.
    """

    of: str
    row: int


def list_found_frames(
    model: mujoco.MjModel,
    robots: Mapping[str, FoundPart],
    doubles: Mapping[str, Double],
    wanted: Sequence[str],
) -> tuple[dict[str, NamedFrame], dict[str, FrameSource]]:
    """Lists the named frames of a model.

    Args:
        model: compiled.
        robots: robots whose bodies have frames, named `robot/body`, shown with the robot.
        doubles: likewise for their moving bodies.
        wanted: names of other bodies and sites; these are initially shown.

    Returns:
        the frames by name, and the source of each of them.

    Raises:
        UnknownName: a wanted name is neither a body nor a site.
    """
    frames: dict[str, NamedFrame] = {}
    places: dict[str, FrameSource] = {}

    def add(frame: NamedFrame, place: FrameSource) -> None:
        frames[frame.name], places[frame.name] = frame, place

    for name, part in robots.items():
        alpha = 1.0 - part.robot.axes_transparency
        for body, label in body_labels(model, part.tree).items():
            frame = f"{name}/{label}"
            size = _axes_length(model, part, body)
            add(NamedFrame(frame, frame, name, name, size, alpha), FrameSource("", body))
    for name, double in doubles.items():
        part = robots[double.of]
        alpha = _DOUBLE_ALPHA * (1.0 - part.robot.axes_transparency)
        if double.path is None:
            for body, label in list(body_labels(model, part.tree).items())[1:]:
                frame = f"{name}/{label}"
                size = _axes_length(model, part, body)
                add(NamedFrame(frame, frame, name, name, size, alpha), FrameSource(name, body))
    size = max([part.robot.axes_length for part in robots.values()], default=0.2)
    for name in wanted:
        add(NamedFrame(name, name, "", "", size, 1.0), FrameSource("", _find(model, name)))
    return frames, places


def body_labels(model: mujoco.MjModel, tree: Tree) -> dict[int, str]:
    """Returns the labels of the frames of a robot's bodies; the first is its base."""
    labels: dict[int, str] = {int(tree.bodies[0]): BASE}
    bodies = [int(body) for body in tree.bodies[1:]]
    names = [model.body(body).name or f"body{body}" for body in bodies]
    for body, name in zip(bodies, without_scope(names), strict=True):
        label = name.strip("/") or f"body{body}"
        labels[body] = f"{label}_{body}" if label in labels.values() else label
    return labels


def _axes_length(model: mujoco.MjModel, part: FoundPart, body: int) -> float:
    """Returns the length of a body's axes, m: that of its joint, for a base of the first joint."""
    robot = part.robot
    moved = model.jnt_bodyid[part.tree.joints]
    while body and body not in moved:
        body = int(model.body_parentid[body])
    joint = int(np.flatnonzero(moved == body)[-1]) if body else 0
    return float(robot.axes_lengths[joint] if isinstance(robot, FoundRobot) else robot.axes_length)


def _find(model: mujoco.MjModel, name: str) -> int:
    """Returns the row of a site or body, as in `FrameSource`."""
    kinds = mujoco.mjtObj
    site = mujoco.mj_name2id(model, kinds.mjOBJ_SITE, name)
    body = mujoco.mj_name2id(model, kinds.mjOBJ_BODY, name)
    if site >= 0:
        return int(model.nbody + site)
    if body >= 0:
        return int(body)
    names = [model.body(i).name for i in range(model.nbody)]
    names += [model.site(i).name for i in range(model.nsite)]
    raise UnknownName("body or site", name, [known for known in names if known])
