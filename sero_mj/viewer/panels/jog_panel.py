"""`JogPanel`: joint sliders and pose fields for robots that the user moves."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from ...base.frames import Array, frame, inverse, rotation_from_rpy, rpy_from_rotation
from ...robots.assemble.world_view import WorldView
from ..decor.joint_titles import short_joint_names
from ..session.joint_goal import JointGoal, as_command, as_python, as_toml
from ..session.widgets import Widgets

UNITS = ("deg", "rad")
_MAX_SECTIONS, _MAX_OPEN = 3, 2  # maximum number of sections, and of initially open sections
# Widths of columns and of a character, in text heights.
_MIN_NAME, _MAX_NAME, _NUMBER, _CHARACTER = 3.2, 8.0, 4.6, 0.56
_POSE = (("x", 0), ("y", 1), ("z", 2), ("roll", 0), ("pitch", 1), ("yaw", 2))


def build_each(
    ui: Widgets, verb: str, names: Collection[str], build: Callable[[str], None]
) -> None:
    """Builds a section for each robot, or one section with a tree if there are many robots.

    Args:
        verb: first word of the section titles.
        build: function that builds the contents for a robot name.
    """
    are_many = len(names) > _MAX_SECTIONS
    if are_many and not ui.header(f"{verb} {len(names)} robots"):
        return
    for index, name in enumerate(names):
        ui.scope(f"{verb} {name}")
        if not are_many and ui.header(f"{verb} {name}", is_open=index < _MAX_OPEN):
            build(name)
        elif are_many and ui.tree(name):
            build(name)
            ui.end_tree()
        ui.end_scope()


class JointSliders:
    """Sliders and number fields for joint angles, in a tree if the robot branches.

    Below the sliders are a button for the declared pose and a drop-down list of units.

    Attributes:
        unit: index in `UNITS` of the unit of joint angles, which is the same for all robots.
    """

    def __init__(self) -> None:
        self.unit = 0

    def build(self, ui: Widgets, goal: JointGoal) -> None:
        limbs = goal.robot.limb_joints
        for limb, joints in limbs.items():
            if len(limbs) == 1:
                self._joints(ui, goal, joints)
            elif ui.tree(f"{limb}##sliders"):
                self._joints(ui, goal, joints)
                ui.end_tree()
        if ui.button("home"):
            goal.set_all(goal.robot.home)
        ui.tip("go to the declared pose")
        ui.same_line()
        ui.width(4.2)
        _, self.unit = ui.choose("##unit", self.unit, UNITS)

    def _joints(self, ui: Widgets, goal: JointGoal, joints: Sequence[int]) -> None:
        robot, angles = goal.robot, goal.angles
        free = set(robot.coupled.independent.tolist())
        names = short_joint_names(robot.names, robot.name)  # without their common prefix
        longest = max(len(names[joint]) for joint in joints)
        name_width = min(max(_CHARACTER * longest, _MIN_NAME), _MAX_NAME)
        if not ui.table(f"##angles{joints[0]}", (name_width, 0, _NUMBER)):
            return
        for joint in joints:
            name, is_angle = robot.names[joint], robot.types[joint] == "revolute"
            factor, unit, decimals = 1.0, "m", 4
            if is_angle:
                factor, unit, decimals = ((180 / np.pi, "deg", 1), (1.0, "rad", 3))[self.unit]
            low, high = goal.range_of(joint)
            ui.row()
            ui.cell()
            ui.label(names[joint])
            ui.cell()
            ui.disable(is_off=joint not in free)
            ui.width(0.0)
            value = factor * float(angles[joint])
            # The slider shows no number, because the field beside the slider shows it.
            moved, wanted = ui.slide(f"##{name}", value, factor * low, factor * high, "")
            ui.tip(f"{name}: {factor * low:.4g} to {factor * high:.4g} {unit}")
            ui.cell()
            ui.width(0.0)
            typed, number = ui.number(f"##{name} typed", value, f"%.{decimals}f")
            ui.enable()
            if moved or typed:
                goal.set_joint(joint, (round(wanted, decimals) if moved else number) / factor)
        ui.end_table()


def build_flange(ui: Widgets, label: str, goal: JointGoal, base: Array) -> None:
    """Builds a tree with number fields for the flange pose of a robot relative to its base.

    Args:
        base: T_world_base, shape (4, 4), m.
    """
    if not ui.tree(label):
        return
    T = inverse(base) @ goal.flange(base)
    xyz, rpy = T[:3, 3].copy(), np.rad2deg(rpy_from_rotation(T[:3, :3]))
    is_new = False
    if ui.table("##flange", (0, 0, 0)):
        for number, (name, index) in enumerate(_POSE):
            values, unit = (xyz, "m") if number < 3 else (rpy, "deg")
            if number % 3 == 0:
                ui.row()
            ui.cell()
            ui.width(0.0)
            shown = f"{name} %.3f" if number < 3 else f"{name} %.1f"
            typed, value = ui.number(f"##{name}", float(values[index]), shown)
            ui.tip(
                f"{name} of the flange relative to the base, {unit}; type a number and press Enter"
            )
            if typed:
                values[index], is_new = value, True
        ui.end_table()
    if is_new:
        goal.hold_posture()
        pose = base @ frame(rotation_from_rpy(np.deg2rad(rpy)), xyz)
        goal.move_flange(base, pose, at_once=True)
    ui.end_tree()


class JogPanel:
    """The panel for robots that the user moves."""

    def __init__(
        self, world: WorldView, goals: Mapping[str, JointGoal], base: Callable[[str], Array]
    ) -> None:
        self._world, self._goals, self._base = world, goals, base
        self._sliders = JointSliders()
        self._copied = ""

    def build(self, ui: Widgets, note: str) -> None:
        goals = self._goals
        build_each(ui, "Move", goals, lambda name: self._robot(ui, name, goals[name], note))

    def _robot(self, ui: Widgets, name: str, goal: JointGoal, note: str) -> None:
        ui.disable(is_off=goal.is_led)
        self._sliders.build(ui, goal)
        if goal.trouble:
            ui.text(goal.trouble, "bad")
        if note:
            ui.text(note, "quiet")
        build_flange(ui, "flange", goal, self._base(name))
        ui.enable()
        if goal.is_led:
            ui.text("a program controls this pose", "quiet")
        if ui.tree("copy the pose"):
            self._copy(ui, name, goal)
            ui.end_tree()

    def _copy(self, ui: Widgets, name: str, goal: JointGoal) -> None:
        texts: dict[str, Callable[[], str]] = {
            "TOML": lambda: as_toml(name, goal.angles),
            "Python": lambda: as_python(name, goal.angles),
            "command": lambda: as_command(self._world.scene, name, goal.angles),
        }
        for label, text in texts.items():
            if ui.button(label):
                self._copied = text()
                ui.copy(self._copied)
            ui.same_line()
        ui.label("")
        if self._copied:
            ui.lines("##copied", self._copied, self._copied.count("\n") + 2)
