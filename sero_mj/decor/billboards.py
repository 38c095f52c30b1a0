"""Billboards: the numbers of every joint on a panel that faces the camera (section 2.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..assemble.robot_parts import BillboardLine
from ..assemble.scene import Scene
from ..assemble.world import World
from .layout import columns
from .panels import Panels, draw_leaders, panel_sizes
from .pen import Kind, Pen
from .toggles import Toggles
from .view import View

Array = NDArray[np.float64]

LEADER_RGBA = (0.09, 0.11, 0.14, 0.9)
NO_DATA = b"no data"
NO_LIMIT = b"none"
# What lines are called where a billboard has several of them.
_LABELS = {
    "torques": "msr",
    "commanded_torques": "cmd",
    "torque_error": "err",
    "joint_accelerations": "acc",
    "joint_angles": "pos",
    "billboard_values": "val",
}
_PLAIN_BELOW = 1e6  # larger values are written with an exponent
# Unit and decimals of a value by itself, for revolute and for prismatic joints.
_UNITS = {
    "torques": (("Nm", 1), ("N", 1)),
    "commanded_torques": (("Nm", 1), ("N", 1)),
    "torque_error": (("Nm", 2), ("N", 2)),
    "joint_accelerations": (("rad/s2", 2), ("m/s2", 2)),
    "joint_angles": (("rad", 3), ("m", 4)),
    "billboard_values": (("", 2), ("", 2)),
    "torque_limit": (("Nm", 1), ("N", 1)),
    "torque_share": (("%", 1), ("%", 1)),
}
# What a click on an arrow brings up: the precise numbers (section 2.2), and what they are called.
_DETAILS = {
    "commanded_torques": "cmd",
    "torques": "msr",
    "torque_error": "err",
    "torque_limit": "limit",
    "torque_share": "share",
}


def lines_of(robot: SerialRobot, scene: Scene) -> list[BillboardLine]:
    """Returns what a robot's billboards say: as declared, else what is routed to it."""
    if robot.billboard_lines is not None:
        return robot.billboard_lines
    for key in ("billboard_values", "torques"):
        if f"{robot.name}.{key}" in scene.routes or getattr(robot, key) is not None:
            return [BillboardLine(value=key)]
    return [BillboardLine(value="joint_angles")]


@dataclass(frozen=True)
class _Line:
    """One line of one joint's billboard, ready to be filled."""

    head: str
    form: str
    scientific: str
    scale: float
    decimals: int
    key: str
    widest: str


class Billboards:
    """Draws the billboards of one world; holds what their lines look like."""

    def __init__(self, world: World) -> None:
        self._world = world
        joints = world.joints
        self._lines: list[list[_Line]] = []
        parts = list(world.robots.values())
        names = joints.names
        if len(parts) > 1:  # a name alone would not say whose joint it is
            names = [
                f"{parts[k].robot.name} {name}"
                for k, name in zip(joints.robot, joints.names, strict=True)
            ]
        for i, name in enumerate(names):
            robot = parts[joints.robot[i]].robot
            declared = lines_of(robot, world.scene)
            prismatic = int(not joints.revolute[i])
            labels = [line.label or _LABELS[line.value] * (len(declared) > 1) for line in declared]
            self._lines.append(
                [
                    _line(name, k, line.value, label, prismatic, line)
                    for k, (line, label) in enumerate(zip(declared, labels, strict=True))
                ]
            )
        self._side = np.concatenate(
            [np.arange(part.robot.n) % 2 for part in parts] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        self._rank = _rank(world)
        self._details = [
            [
                _line(name, k, key, label, int(not joints.revolute[i]))
                for k, (key, label) in enumerate(_DETAILS.items())
            ]
            for i, name in enumerate(names)
        ]
        self._widths: dict[int, dict[int, int]] = {}

    def draw(
        self,
        pen: Pen,
        data: mujoco.MjData,
        toggles: Toggles,
        view: View,
        values: dict[str, Array],
    ) -> Panels | None:
        """Lays out the panel and draws the leader of every joint whose billboard is shown.

        Args:
            pen: where to.
            data: the world's state.
            toggles: what is shown.
            view: of the picture.
            values: what `joint_values` returned.

        Returns:
            the panels, for `draw_panels`, or None when there are none.
        """
        joints = self._world.joints
        shown = (toggles.billboards | toggles.details).nonzero()[0]
        if not len(shown):
            return None
        anchors, depth = view.project(data.site_xpos[joints.centre_site[shown]])
        inside = view.sees(anchors, depth)
        shown, anchors, depth = shown[inside], anchors[inside], depth[inside]
        if not len(shown):
            return None
        lines = [self._details[i] if toggles.details[i] else self._lines[i] for i in shown]
        if toggles.details.any():
            limit = joints.torque_limit
            share = 100 * np.abs(values["torques"]) / limit
            values = {**values, "torque_limit": limit, "torque_share": share}
        texts = _texts(values, shown, lines)
        sizes = self._sizes(view, shown, lines, texts)
        gap = view.font.height * 0.3
        # Clear of the round arrows of the joint that is nearest to the eye.
        radius = 2.0 * joints.arrow_radius[shown].max() / view.pixel_size(float(depth.min()))
        beside = min(max(radius, 3 * gap), view.width / 8)
        order = np.argsort(self._rank[shown], kind="stable")
        centres = np.empty((len(shown), 2))
        centres[order] = columns(
            anchors[order], sizes[order], self._side[shown[order]], gap, beside,
            view.width, view.height,
        )  # fmt: skip
        edge = np.sign(anchors[:, 0] - centres[:, 0]) * sizes[:, 0] / 2
        starts = np.stack([centres[:, 0] + edge, centres[:, 1]], axis=1)
        draw_leaders(pen, view, starts, anchors, LEADER_RGBA)
        return Panels(centres, sizes, texts, kind=Kind.BILLBOARD, items=shown)

    def _sizes(
        self,
        view: View,
        shown: NDArray[np.intp],
        lines: list[list[_Line]],
        texts: list[list[bytes]],
    ) -> Array:
        """Panel sizes that do not change with the digits, unless a number is unusually long."""
        font = view.font
        if font.height not in self._widths:
            self._widths[font.height] = {}
        known = self._widths[font.height]
        widths = np.empty(len(shown))
        for k, (of_joint, of_text) in enumerate(zip(lines, texts, strict=True)):
            key = id(of_joint)
            if key not in known:
                known[key] = max(font.width(line.widest) for line in of_joint)
            widths[k] = known[key]
            for text, line in zip(of_text, of_joint, strict=True):
                if len(text) > len(line.widest):
                    widths[k] = max(widths[k], font.width(text))
        return panel_sizes(widths, np.array([len(of_joint) for of_joint in lines]), view)


def _texts(
    values: dict[str, Array], shown: NDArray[np.intp], lines: list[list[_Line]]
) -> list[list[bytes]]:
    texts = []
    for i, of_joint in zip(shown, lines, strict=True):
        text = []
        for line in of_joint:
            value = float(values[line.key][i])
            if not math.isfinite(value):
                missing = NO_LIMIT if line.key == "torque_limit" else NO_DATA
                text.append(line.head.encode("ascii") + missing)
                continue
            # Adding zero turns -0.0, which rounding makes of a small negative, into 0.0.
            value = round(value * line.scale, line.decimals) + 0.0
            form = line.form if abs(value) < _PLAIN_BELOW else line.scientific
            text.append((line.head + form % value).encode("ascii"))
        texts.append(text)
    return texts


def _rank(world: World) -> NDArray[np.intp]:
    """Order of the joints from low to high where the scene declares them, (N,).

    It is fixed: sorting by the height of the moment would make panels swap places.
    """
    data = world.make_data()
    heights = data.site_xpos[world.joints.centre_site, 2]
    order = np.argsort(heights, kind="stable")
    rank = np.empty(len(order), np.intp)
    rank[order] = np.arange(len(order))
    return rank


def _line(
    joint: str, k: int, key: str, label: str, prismatic: int, declared: BillboardLine | None = None
) -> _Line:
    """Prepares a line: the joint's name stands on the first one, labels on all."""
    unit, decimals = _UNITS[key][prismatic]
    scale = 1.0
    if declared is not None:
        unit = unit if declared.unit is None else declared.unit
        decimals = decimals if declared.decimals is None else declared.decimals
        scale = declared.scale
    words = [joint if k == 0 else " " * len(joint), label]
    head = "  ".join(word for word in words if word) + " "
    tail = (f" {unit}" if unit else "").replace("%", "%%")
    form = f"%{decimals + 5 if decimals else 5}.{decimals}f" + tail
    return _Line(head, form, "%10.3e" + tail, scale, decimals, key, head + form % -888.8888)
