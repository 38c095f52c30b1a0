"""`RobotPanel`: the panel with the switches and sizes of all robots and doubles."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...base.frames import Array, Bools, Ints
from ...robots.assemble.parts import Owner
from ...robots.assemble.world_view import WorldView
from ...robots.declared.robot_parts import ARROW_QUANTITIES
from ..decor.quantities import QUANTITY_NAMES, joint_name
from ..decor.toggles import Toggles
from ..session.widgets import Widgets

_SEARCHABLE = 8  # number of joints above which there is a search field
_MAX_FOUND = 60  # maximum number of joints in the result of a search
_MAX_OPEN = 3  # maximum number of sections that are initially open
_MAX_SCALE = 3.0  # maximum factor by which a slider scales a declared size
_FLAG_NAMES = {
    "legend": "legend",
    "status": "errors of the sources",
    "flange_checks": "comparison of flange frames",
}
# Lengths in units of the text height.
_SECOND = 8.6  # left edge of the second widget of a line
_SLIDER = 8.6  # width of sliders and lists


def tree_of_owners(world: WorldView) -> tuple[dict[str, list[str]], list[str]]:
    """Returns the groups of robots and doubles as a tree, in which each item is in one group.

    Returns:
        mapping from groups to the names of their members, and names of all items in no group.
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


def build_handle(ui: Widgets, key: str) -> bool:
    """Builds the button that opens the panel, and returns whether the button was pressed."""
    is_pressed = ui.button("panel")
    ui.tip(f"switches, sources and sizes ({key})")
    return is_pressed


class RobotPanel:
    """The panel with switches and size sliders of all robots and doubles.

    Sliders scale the declared sizes.

    Args:
        world: compiled scene, whose sizes the panel changes in place.

    Attributes:
        on_select: function that is called with the index of the joint that the user clicks.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        self._world, self._toggles = world, toggles
        self._wanted = ""  # text of the search field
        self.on_select: Callable[[int], None] = lambda joint: None
        joints, frames = world.joints, world.frames
        self._members, self._tops = tree_of_owners(world)
        # For each slider: label, array that it scales, kind of the array's rows, declared values.
        self._scaled: list[tuple[str, Array, str, Array]] = [
            ("arrow radius", joints.arrow_radius, "joints", joints.arrow_radius.copy()),
            ("arrow width", joints.arrow_width_scale, "joints", joints.arrow_width_scale.copy()),
            ("axes size", frames.size, "frames", frames.size.copy()),
            ("axes opacity", frames.alpha, "frames", frames.alpha.copy()),
        ]

    def build(self, ui: Widgets) -> None:
        world, toggles = self._world, self._toggles
        if len(world.joints.names) > _SEARCHABLE or len(world.owners) > 1:
            ui.width(0)
            self._wanted = ui.search("##search", self._wanted, "search joints and robots")
        if self._wanted:
            self._found(ui)
            return
        for index, name in enumerate(self._tops):
            ui.scope(name)
            is_open = index < _MAX_OPEN and name not in world.doubles
            if ui.header(name, is_open=is_open):
                self._entry(ui, name)
            ui.end_scope()
        self._doubles(ui)
        if ui.header("Scene", is_open=True):
            for field, words in _FLAG_NAMES.items():
                changed, on = ui.check(words, getattr(toggles, field))
                if changed:
                    setattr(toggles, field, on)
            if len(toggles.vectors):
                self._check(ui, "smart arrows", toggles.vectors, slice(None))
                self._check(ui, "arrow values", toggles.cards, slice(None))
            if ui.button("reset"):
                self._reset()
            ui.tip("reset switches and sizes to the values in the scene")

    def _found(self, ui: Widgets) -> None:
        wanted = self._wanted.lower()
        names = [joint_name(self._world, i) for i in range(len(self._world.joints.names))]
        joints = [i for i, name in enumerate(names) if wanted in name.lower()]
        ui.text(f"{len(joints)} of {len(names)} joints")
        for joint in joints[:_MAX_FOUND]:
            if ui.select(f"{names[joint]}##found{joint}", is_lit=self._toggles.selected == joint):
                self.on_select(joint)

    def _entry(self, ui: Widgets, name: str) -> None:
        owners = self._owners_in(name)
        self._switches(ui, owners)
        if name in self._world.owners and ui.tree("joints"):
            self._limbs(ui, self._world.owners[name])
            ui.end_tree()
        self._sizes(ui, owners)
        for member in self._members.get(name, []):
            if ui.tree(member):
                self._entry(ui, member)
                ui.end_tree()

    def _owners_in(self, name: str) -> list[str]:
        if name not in self._members:
            return [name]
        return [owner for each in self._members[name] for owner in self._owners_in(each)]

    def _rows(self, owners: Sequence[str]) -> tuple[Ints, Ints]:
        indices = [list(self._world.owners).index(name) for name in owners]
        joints, frames = self._world.joints.owner, self._world.frames.owner
        return np.isin(joints, indices).nonzero()[0], np.isin(frames, indices).nonzero()[0]

    def _switches(self, ui: Widgets, owners: Sequence[str]) -> None:
        toggles = self._toggles
        joints, frames = self._rows(owners)
        shown = set(toggles.arrow_quantity[joints].tolist())
        names = [QUANTITY_NAMES[quantity] for quantity in ARROW_QUANTITIES]
        now = shown.pop() if len(shown) == 1 else -1
        ui.width(_SLIDER)
        changed, chosen = ui.choose("quantity of arrows", now, names)
        if changed:
            toggles.arrow_quantity[joints] = chosen
        self._check(ui, "arrows", toggles.arrows, joints)
        ui.same_line(_SECOND)
        self._check(ui, "billboards", toggles.billboards, joints)
        self._check(ui, "exact values", toggles.details, joints)
        ui.tip("show the exact value of each arrow on its billboard")
        if len(frames):
            ui.same_line(_SECOND)
            self._check(ui, "axes", toggles.axes, frames)
            self._check(ui, "names of axes", toggles.frame_names, frames)

    def _sizes(self, ui: Widgets, owners: Sequence[str]) -> None:
        if ui.tree("sizes"):
            rows = dict(zip(("joints", "frames"), self._rows(owners), strict=True))
            for words, array, which, declared in self._scaled:
                if len(rows[which]):
                    self._scale(ui, words, array, rows[which], declared)
            ui.end_tree()

    def _limbs(self, ui: Widgets, owner: Owner) -> None:
        limbs = owner.robot.limb_joints
        rows = {limb: owner.joints.start + np.array(joints) for limb, joints in limbs.items()}
        if len(rows) == 1:
            self._joints(ui, *rows.values())
            return
        for limb, joints in rows.items():
            if len(joints) == 1:
                self._joints(ui, joints)
            elif ui.tree(limb):
                self._check(ui, f"arrows##{limb}", self._toggles.arrows, joints)
                ui.same_line(_SECOND)
                self._check(ui, f"billboards##{limb}", self._toggles.billboards, joints)
                self._joints(ui, joints)
                ui.end_tree()

    def _joints(self, ui: Widgets, joints: Ints) -> None:
        if not ui.table(f"##joints{joints[0]}", (0, 0, 0)):
            return
        for joint in joints.tolist():
            row = slice(joint, joint + 1)
            ui.row()
            ui.cell()
            name = self._world.joints.names[joint]
            if ui.select(f"{name}##{joint}", is_lit=self._toggles.selected == joint):
                self.on_select(joint)
            ui.cell()
            self._check(ui, f"arrow##{joint}", self._toggles.arrows, row)
            ui.cell()
            self._check(ui, f"billboard##{joint}", self._toggles.billboards, row)
        ui.end_table()

    def _doubles(self, ui: Widgets) -> None:
        doubles = self._world.doubles
        if not doubles or not ui.header("Transparent doubles", is_open=True):
            return
        rows = {name: np.array([i]) for i, name in enumerate(doubles)}
        for group, names in self._world.scene.double_groups.items():
            rows[group] = np.concatenate([rows.pop(name) for name in names])
        for name, indices in rows.items():
            self._check(ui, f"{name}##double", self._toggles.doubles, indices)

    @staticmethod
    def _check(ui: Widgets, words: str, array: Bools, rows: slice | Ints) -> None:
        changed, on = ui.check(words, bool(array[rows].any()))
        if changed:
            array[rows] = on

    @staticmethod
    def _scale(ui: Widgets, words: str, array: Array, rows: Ints, declared: Array) -> None:
        sizes = declared[rows]
        largest = _MAX_SCALE
        if words == "axes opacity":
            largest = 1.0 / max(float(sizes.max()), 1e-9)
        now = float(array[rows].max() / max(float(sizes.max()), 1e-12))
        ui.width(_SLIDER)
        changed, times = ui.slide(words, now, 0.0, largest, "x %.2f")
        if changed:
            array[rows] = sizes * times

    def _reset(self) -> None:
        self._toggles.reset()
        for _, array, _, declared in self._scaled:
            array[:] = declared
