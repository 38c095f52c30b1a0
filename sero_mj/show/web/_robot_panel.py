"""The panel with toggles and size sliders of every robot and double."""

from __future__ import annotations

import numpy as np
from mujoco.studio.dear_imgui import dear_imgui as imgui
from numpy.typing import NDArray

from ...assemble.parts import Owner
from ...assemble.robot_parts import ARROW_QUANTITIES
from ...assemble.world_view import WorldView
from ...decor.quantities import QUANTITY_NAMES
from ...decor.toggles import Toggles

_OPEN = int(imgui.TreeNodeFlags.DefaultOpen)
_MOST_OPEN = 3  # number of robots whose toggles are initially expanded
_LARGEST = 3.0  # range of the sliders, factors of the declared size
_FLAG_NAMES = {
    "legend": "legend",
    "status": "faults of the sources",
    "flange_checks": "comparison of flange frames",
}
_SLIDER = 130.0  # pixels


class RobotPanel:
    """Builds the toggles and sliders of one world.

    Sliders scale the declared sizes; `Toggles.reset` does not reset them.

    Args:
        world: the compiled scene; its tables of sizes are changed in place.
        toggles: changed in place.
    """

    def __init__(self, world: WorldView, toggles: Toggles) -> None:
        self._world, self._toggles = world, toggles
        joints, frames = world.joints, world.frames
        # Name, array, rows of an owner, and declared values of the sizes that sliders scale.
        self._scaled: list[tuple[str, NDArray[np.float64], str, NDArray[np.float64]]] = [
            ("arrow radius", joints.arrow_radius, "joints", joints.arrow_radius.copy()),
            ("arrow width", joints.arrow_width_scale, "joints", joints.arrow_width_scale.copy()),
            ("axes size", frames.size, "frames", frames.size.copy()),
            ("axes opacity", frames.alpha, "frames", frames.alpha.copy()),
        ]

    def build(self) -> None:
        """Builds the part of the panel with robots, doubles and the scene."""
        world, toggles = self._world, self._toggles
        for index, (name, owner) in enumerate(world.owners.items()):
            imgui.PushID(name)
            if imgui.CollapsingHeader(
                name, _OPEN if index < _MOST_OPEN and name in world.robots else 0
            ):
                self._owner(index, owner)
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

    def _owner(self, index: int, owner: Owner) -> None:
        toggles, joints = self._toggles, owner.joints
        frames = (self._world.frames.owner == index).nonzero()[0]
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
        if imgui.TreeNode("joints"):
            self._joints(joints)
            imgui.TreePop()
        if imgui.TreeNode("sizes"):
            rows = {"joints": np.arange(joints.start, joints.stop), "frames": frames}
            for words, array, which, declared in self._scaled:
                if len(rows[which]):
                    self._scale(words, array, rows[which], declared)
            imgui.TreePop()

    def _joints(self, joints: slice) -> None:
        """Builds the toggles of arrow and billboard of every joint."""
        if not imgui.BeginTable("##joints", 3):
            return
        for joint in range(joints.start, joints.stop):
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
        for i, name in enumerate(doubles):
            changed, on = imgui.Checkbox(f"{name}##double", bool(self._toggles.doubles[i]))
            if changed:
                self._toggles.doubles[i] = on

    @staticmethod
    def _check(words: str, array: NDArray[np.bool_], rows: slice | NDArray[np.intp]) -> None:
        changed, on = imgui.Checkbox(words, bool(array[rows].any()))
        if changed:
            array[rows] = on

    @staticmethod
    def _scale(
        words: str,
        array: NDArray[np.float64],
        rows: NDArray[np.intp],
        declared: NDArray[np.float64],
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
