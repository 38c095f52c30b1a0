"""What the page's windows hold: toggles and sizes of robots and doubles, and torque plots."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from mujoco.studio.implot import implot

from ...assemble.parts import Owner
from ...assemble.robot_parts import ARROW_QUANTITIES
from ...assemble.world_view import WorldView
from ...decor.quantities import QUANTITY_NAMES
from ...decor.toggles import Toggles
from ...frames import Array, Bools, Ints
from ...study.reduction import envelope
from ..torque_history import SPAN, TorqueHistory, joint_name, split_at_gaps

_OPEN = int(imgui.TreeNodeFlags.DefaultOpen)
_MOST_OPEN = 3  # number of robots whose toggles are initially expanded
_LARGEST = 3.0  # range of the sliders, factors of the declared size
_FLAG_NAMES = {
    "legend": "legend",
    "status": "faults of the sources",
    "flange_checks": "comparison of flange frames",
}
_SLIDER = 130.0  # pixels
# Limits of update rate and points: plots would be most of the data sent to the browser.
_INTERVAL = 1.0 / 15.0  # s
_POINTS = 320
# The colours of lines cannot be set in Studio's ImPlot; its defaults start with blue and orange.
_LIMIT_RGB = (0.80, 0.20, 0.10)
_NEAR = 0.6  # fraction of the limit from which on it is in the visible range
_LEGEND = int(implot.LegendFlags.Outside) | int(implot.LegendFlags.Horizontal)
_ROOM_FOR_TWO = 240.0  # pixels, minimum height with a plot of the error
_LEAST = 0.5  # Nm or N, minimum half range of a plot


def tree_of_owners(world: WorldView) -> tuple[dict[str, list[str]], list[str]]:
    """Returns the tree in which robots and doubles are listed.

    Each is listed once, in the first of its groups.

    Returns:
        groups with their members, and what is in no group: groups, robots, doubles.
    """
    scene = world.scene
    declared = {name: group.robots for name, group in scene.groups.items()} | scene.double_groups
    members: dict[str, list[str]] = {}
    taken: set[str] = set()
    for name, names in declared.items():
        known = [each for each in names if each in declared or each in world.owners]
        members[name] = [each for each in known if each not in taken]
        taken.update(members[name])
    members = {name: names for name, names in members.items() if names}
    return members, [name for name in (*members, *world.owners) if name not in taken]


class RobotPanel:
    """The panel with toggles and size sliders of every robot and double.

    Sliders scale the declared sizes; `Toggles.reset` does not reset them.

    Args:
        world: the compiled scene; its tables of sizes are changed in place.
        toggles: changed in place.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        self._world, self._toggles = world, toggles
        joints, frames = world.joints, world.frames
        self._members, self._tops = tree_of_owners(world)
        # Name, array, rows of an owner, and declared values of the sizes that sliders scale.
        self._scaled: list[tuple[str, Array, str, Array]] = [
            ("arrow radius", joints.arrow_radius, "joints", joints.arrow_radius.copy()),
            ("arrow width", joints.arrow_width_scale, "joints", joints.arrow_width_scale.copy()),
            ("axes size", frames.size, "frames", frames.size.copy()),
            ("axes opacity", frames.alpha, "frames", frames.alpha.copy()),
        ]

    def build(self) -> None:
        """Builds the part of the panel with robots, doubles and the scene."""
        world, toggles = self._world, self._toggles
        for index, name in enumerate(self._tops):
            imgui.PushID(name)
            is_open = index < _MOST_OPEN and name not in world.doubles
            if imgui.CollapsingHeader(name, _OPEN if is_open else 0):
                self._entry(name)
            imgui.PopID()
        self._doubles()
        if imgui.CollapsingHeader("Scene", _OPEN):
            for field, words in _FLAG_NAMES.items():
                changed, on = imgui.Checkbox(words, getattr(toggles, field))
                if changed:
                    setattr(toggles, field, on)
            if len(toggles.vectors):
                self._check("smart arrows", toggles.vectors, slice(None))
                self._check("their values", toggles.cards, slice(None))
            if imgui.Button("as declared"):
                self._reset()
            imgui.SetItemTooltip("resets toggles and sizes to those that the scene declares")

    def _entry(self, name: str) -> None:
        """Builds the toggles of a robot or double, or of a group with the tree of its members."""
        owners = self._owners_in(name)
        self._switches(owners)
        if name in self._world.owners and imgui.TreeNode("joints"):
            self._limbs(self._world.owners[name])
            imgui.TreePop()
        self._sizes(owners)
        for member in self._members.get(name, []):
            if imgui.TreeNode(member):
                self._entry(member)
                imgui.TreePop()

    def _owners_in(self, name: str) -> list[str]:
        """Returns the robots and doubles in a group, or the one of that name."""
        if name not in self._members:
            return [name]
        return [owner for each in self._members[name] for owner in self._owners_in(each)]

    def _rows(self, owners: Sequence[str]) -> tuple[Ints, Ints]:
        """Returns the rows of all joints and of all frames of robots and doubles."""
        indices = [list(self._world.owners).index(name) for name in owners]
        joints, frames = self._world.joints.owner, self._world.frames.owner
        return np.isin(joints, indices).nonzero()[0], np.isin(frames, indices).nonzero()[0]

    def _switches(self, owners: Sequence[str]) -> None:
        """Builds the toggles of robots and doubles together."""
        toggles = self._toggles
        joints, frames = self._rows(owners)
        shown = set(toggles.arrow_quantity[joints].tolist())
        names = [QUANTITY_NAMES[quantity] for quantity in ARROW_QUANTITIES]
        now = shown.pop() if len(shown) == 1 else -1
        imgui.SetNextItemWidth(_SLIDER)
        changed, chosen = imgui.Combo("arrows show", now, names)
        if changed:
            toggles.arrow_quantity[joints] = chosen
        self._check("arrows", toggles.arrows, joints)
        imgui.SameLine(_SLIDER)
        self._check("billboards", toggles.billboards, joints)
        self._check("precise", toggles.details, joints)
        imgui.SetItemTooltip("precise values of every arrow on its billboard")
        if len(frames):
            imgui.SameLine(_SLIDER)
            self._check("axes", toggles.axes, frames)
            self._check("names of axes", toggles.frame_names, frames)

    def _sizes(self, owners: Sequence[str]) -> None:
        """Builds the sliders of sizes of robots and doubles together."""
        if imgui.TreeNode("sizes"):
            rows = dict(zip(("joints", "frames"), self._rows(owners), strict=True))
            for words, array, which, declared in self._scaled:
                if len(rows[which]):
                    self._scale(words, array, rows[which], declared)
            imgui.TreePop()

    def _limbs(self, owner: Owner) -> None:
        """Builds the toggles of all joints, in a tree of the limbs of a robot that branches."""
        limbs = owner.robot.limb_joints
        rows = {limb: owner.joints.start + np.array(joints) for limb, joints in limbs.items()}
        if len(rows) == 1:
            self._joints(*rows.values())
            return
        for limb, joints in rows.items():
            if len(joints) == 1:
                self._joints(joints)
            elif imgui.TreeNode(limb):
                self._check(f"arrows##{limb}", self._toggles.arrows, joints)
                imgui.SameLine(_SLIDER)
                self._check(f"billboards##{limb}", self._toggles.billboards, joints)
                self._joints(joints)
                imgui.TreePop()

    def _joints(self, joints: Ints) -> None:
        """Builds the toggles of arrow and billboard of joints."""
        if not imgui.BeginTable(f"##joints{joints[0]}", 3):
            return
        for joint in joints.tolist():
            row = slice(joint, joint + 1)
            imgui.TableNextRow()
            imgui.TableNextColumn()
            imgui.TextUnformatted(self._world.joints.names[joint])
            imgui.TableNextColumn()
            self._check(f"arrow##{joint}", self._toggles.arrows, row)
            imgui.TableNextColumn()
            self._check(f"billboard##{joint}", self._toggles.billboards, row)
        imgui.EndTable()

    def _doubles(self) -> None:
        doubles = self._world.doubles
        if not doubles or not imgui.CollapsingHeader("Transparent doubles", _OPEN):
            return
        rows = {name: np.array([i]) for i, name in enumerate(doubles)}
        for group, names in self._world.scene.double_groups.items():
            rows[group] = np.concatenate([rows.pop(name) for name in names])
        for name, indices in rows.items():
            self._check(f"{name}##double", self._toggles.doubles, indices)

    @staticmethod
    def _check(words: str, array: Bools, rows: slice | Ints) -> None:
        changed, on = imgui.Checkbox(words, bool(array[rows].any()))
        if changed:
            array[rows] = on

    @staticmethod
    def _scale(
        words: str,
        array: Array,
        rows: Ints,
        declared: Array,
    ) -> None:
        given = declared[rows]
        largest = _LARGEST
        if words == "axes opacity":
            largest = 1.0 / max(float(given.max()), 1e-9)
        now = float(array[rows].max() / max(float(given.max()), 1e-12))
        imgui.SetNextItemWidth(_SLIDER)
        changed, times = imgui.SliderFloat(words, now, 0.0, largest, "x %.2f")
        if changed:
            array[rows] = given * times

    def _reset(self) -> None:
        self._toggles.reset()
        for _, array, _, declared in self._scaled:
            array[:] = declared


def decimate(times: Array, values: Array, points: int = _POINTS) -> tuple[Array, Array]:
    """Reduces the samples of a line to about `points`, keeping its extremes and gaps.

    Args:
        times: (k,), s, rising.
        values: (k,), NaN for no data.
        points: approximate number of samples to keep.

    Returns:
        times and values, with one NaN in every gap.
    """
    size = max(int(np.ceil(2 * np.isfinite(values).sum() / points)), 1)
    kept: list[tuple[Array, Array]] = []
    for piece in split_at_gaps(times, values):
        if kept:
            kept.append((times[piece[:1]], np.array([np.nan])))
        kept.append(envelope(times[piece], values[piece], -(-len(piece) // size)))
    if not kept:
        return times[:0], values[:0]
    return np.concatenate([x for x, _ in kept]), np.concatenate([y for _, y in kept])


class TorquePlots:
    """Plots commanded, measured and error torques of a joint of a world, with limits.

    Args:
        world: the compiled scene.
    """

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._names = [joint_name(world, i) for i in range(len(world.joints.names))]
        self._lines: dict[str, tuple[list[float], list[float]]] = {}
        self._when = float("-inf")
        self._joint = -1

    def build(self, history: TorqueHistory, joint: int) -> int:
        """Builds the plots of a joint and returns the joint that the user has selected.

        Args:
            history: the torques.
            joint: index in the world.
        """
        imgui.SetNextItemWidth(160.0)
        changed, chosen = imgui.Combo("##joint", joint, self._names)
        joint = chosen if changed else joint
        self._refresh(history, joint)
        joints = self._world.joints
        unit = "Nm" if joints.revolute[joint] else "N"
        limit = float(joints.torque_limit[joint])
        imgui.SameLine()
        imgui.TextUnformatted(f"limit {limit:g} {unit}" if np.isfinite(limit) else "no limit")
        room = imgui.GetContentRegionAvail()
        upper = room.y if room.y < _ROOM_FOR_TWO else 0.58 * room.y - 4.0
        self._plot(f"torque [{unit}]", ("measured", "commanded"), limit, upper)
        if upper < room.y:
            self._plot(f"error [{unit}]", ("commanded - measured",), np.inf, room.y - upper - 8.0)
        return joint

    def _refresh(self, history: TorqueHistory, joint: int) -> None:
        now = time.monotonic()
        if joint == self._joint and now - self._when < _INTERVAL:
            return
        self._joint, self._when = joint, now
        times, values = history.of(joint)
        lines = dict(zip(("measured", "commanded", "commanded - measured"), values, strict=True))
        self._lines = {}
        for name, values in lines.items():
            x, y = decimate(times, values)
            self._lines[name] = (x.tolist(), y.tolist())

    def _plot(self, title: str, names: tuple[str, ...], limit: float, height: float) -> None:
        if not implot.BeginPlot(f"##{title}", imgui.Vec2(-1.0, max(height, 50.0))):
            return
        implot.SetupAxes("s", title)
        implot.SetupLegend(int(implot.Location.North), _LEGEND)
        implot.SetupAxisLimits(int(implot.Axis.X1), -SPAN, 0.0, int(implot.Cond.Always))
        low, high = self._range(names, limit)
        implot.SetupAxisLimits(int(implot.Axis.Y1), low, high, int(implot.Cond.Always))
        for name in names:
            x, y = self._lines[name]
            implot.PlotLine(name, x, y)
        for number, bound in enumerate((limit, -limit)):
            if low <= bound <= high:
                flags = int(implot.DragToolFlags.NoInputs) | int(implot.DragToolFlags.NoFit)
                implot.DragLineY(number, bound, imgui.Vec4(*_LIMIT_RGB, 1.0), 1.5, flags)
                implot.TagY(bound, imgui.Vec4(*_LIMIT_RGB, 1.0), "limit")
        implot.EndPlot()

    def _range(self, names: tuple[str, ...], limit: float) -> tuple[float, float]:
        """Returns the range of the axis, rounded so that it rarely changes."""
        values = [v for name in names for v in self._lines[name][1] if math.isfinite(v)]
        low, high = (min(values), max(values)) if values else (0.0, 0.0)
        if np.isfinite(limit):
            high = limit if high > _NEAR * limit else high
            low = -limit if low < -_NEAR * limit else low
        middle, half = (low + high) / 2, max((high - low) / 2 * 1.15, _LEAST)
        step = 10.0 ** np.floor(np.log10(half)) / 2
        return (
            float(np.floor((middle - half) / step) * step),
            float(np.ceil((middle + half) / step) * step),
        )
