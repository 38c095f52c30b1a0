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
from .pen import Pen
from .toggles import Toggles
from .view import View

Array = NDArray[np.float64]

LEADER_RGBA = (0.09, 0.11, 0.14, 0.9)
NO_DATA = b"no data"
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
        for i, name in enumerate(joints.names):
            robot = parts[joints.robot[i]].robot
            declared = lines_of(robot, world.scene)
            prismatic = int(not joints.revolute[i])
            labels = [line.label or _LABELS[line.value] * (len(declared) > 1) for line in declared]
            self._lines.append(
                [
                    _line(name, k, line, label, prismatic)
                    for k, (line, label) in enumerate(zip(declared, labels, strict=True))
                ]
            )
        self._side = np.concatenate(
            [np.arange(part.robot.n) % 2 for part in parts] or [np.zeros(0, np.intp)]
        ).astype(np.intp)
        self._rank = _rank(world)
        self._counts = np.array([len(lines) for lines in self._lines], np.intp)
        self._widths: dict[int, Array] = {}

    def draw(
        self,
        pen: Pen,
        data: mujoco.MjData,
        toggles: Toggles,
        view: View,
        values: dict[str, Array],
    ) -> Panels:
        """Lays out the panel and draws the leader of every joint whose billboard is shown.

        Args:
            pen: where to.
            data: the world's state.
            toggles: what is shown.
            view: of the picture.
            values: what `joint_values` returned.

        Returns:
            the panels, for `draw_panels`.
        """
        nothing = Panels(np.empty((0, 2)), np.empty((0, 2)), [])
        joints = self._world.joints
        shown = toggles.billboards.nonzero()[0]
        if not len(shown):
            return nothing
        anchors, depth = view.project(data.site_xpos[joints.centre_site[shown]])
        inside = (depth > view.near) & (anchors >= 0).all(1)
        inside &= (anchors < [view.width, view.height]).all(1)
        shown, anchors, depth = shown[inside], anchors[inside], depth[inside]
        if not len(shown):
            return nothing
        texts = self._texts(values, shown)
        sizes = self._sizes(view, shown, texts)
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
        return Panels(centres, sizes, texts)

    def _texts(self, values: dict[str, Array], shown: NDArray[np.intp]) -> list[list[bytes]]:
        texts = []
        for i in shown:
            lines = []
            for line in self._lines[i]:
                value = float(values[line.key][i])
                if not math.isfinite(value):
                    lines.append(line.head.encode("ascii") + NO_DATA)
                    continue
                # Adding zero turns -0.0, which rounding makes of a small negative, into 0.0.
                value = round(value * line.scale, line.decimals) + 0.0
                form = line.form if abs(value) < _PLAIN_BELOW else line.scientific
                lines.append((line.head + form % value).encode("ascii"))
            texts.append(lines)
        return texts

    def _sizes(self, view: View, shown: NDArray[np.intp], texts: list[list[bytes]]) -> Array:
        """Panel sizes that do not change with the digits, unless a number is unusually long."""
        font = view.font
        if font.height not in self._widths:
            self._widths[font.height] = np.array(
                [max(font.width(line.widest) for line in lines) for lines in self._lines]
            )
        widths = self._widths[font.height][shown]
        for k, (i, lines) in enumerate(zip(shown, texts, strict=True)):
            for text, line in zip(lines, self._lines[i], strict=True):
                if len(text) > len(line.widest):
                    widths[k] = max(widths[k], font.width(text))
        return panel_sizes(widths, self._counts[shown], view)


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


def _line(joint: str, k: int, line: BillboardLine, label: str, prismatic: int) -> _Line:
    """Prepares a line: the joint's name stands on the first one, labels on all."""
    unit, decimals = _UNITS[line.value][prismatic]
    unit = unit if line.unit is None else line.unit
    decimals = decimals if line.decimals is None else line.decimals
    words = [joint if k == 0 else " " * len(joint), label]
    head = "  ".join(word for word in words if word) + " "
    tail = f" {unit}" if unit else ""
    form = f"%{decimals + 5 if decimals else 5}.{decimals}f" + tail.replace("%", "%%")
    scientific = "%10.3e" + tail.replace("%", "%%")
    return _Line(head, form, scientific, line.scale, decimals, line.value, head + form % -888.8888)
