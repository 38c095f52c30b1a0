"""`Toggles`: switches that show or hide features of each robot, joint, frame and arrow."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ...robots.assemble.parts import DoublePart
from ...robots.assemble.world_view import WorldView
from ...robots.declared.inputs import SCENE, Input
from ...robots.declared.robot_parts import ARROW_QUANTITIES

# Parts of the model whose names can be shown; `Toggles.part_names` is an index of this tuple.
PART_NAMES = ("none", "bodies", "joints", "geoms")


@dataclass(frozen=True, eq=False)
class ShownItems:
    """Masks of the items that are drawn in one frame, because they are on and have a pose."""

    joints: Bools
    arrows: Bools
    billboards: Bools
    axes: Bools
    frame_names: Bools
    vectors: Bools
    cards: Bools


@dataclass(frozen=True, eq=False)
class Handles:
    """The state of the handles with which a user drags a frame.

    Attributes:
        pose: pose of the handles, T_world_frame, shape (4, 4), m; None to show only the mark.
        lit: index of the handle under the pointer in `handles.HANDLE_NAMES`; -1 for none.
        mark: target and actual position of the frame, shape (2, 3), m; None if they coincide.
    """

    pose: Array | None = None
    lit: int = -1
    mark: Array | None = None


class Toggles:
    """The switches of all visual features of a world, which users and packets change.

    Initially, the switches have the values that the scene declares.

    Attributes:
        arrow_quantity: quantity that the arrow of each joint shows, as an index of
            `ARROW_QUANTITIES`, shape (N,).
        clicked: mask of joints whose billboards have priority if there is no room for all, shape
            (N,).
        contacts: whether contact points of geoms are shown, with forces if they are known.
        inertias: whether a box with the mass and inertia of each link is shown.
        joint_axes: whether the joint axes of the model are shown.
        centres_of_mass: whether the centers of mass of all independently moving parts are shown.
        part_names: kind of parts whose names are shown, as an index of `PART_NAMES`.
        transparent: whether moving parts are transparent.
        wireframe: whether surfaces are drawn as the edges of their triangles.
        hover: text beside the pointer, and position of the pointer in pixels; None for no text.
        selected: index of the joint that a user has selected; None for no joint.
        handles: handles to drag a frame; None for no handles.
        modelled: mask of joints whose torques are gravity torques of the model, shape (N,). `reset`
            does not change it, because it is not a switch.
    """

    def __init__(self, world: WorldView) -> None:
        self._world = world
        self.hover: tuple[str, tuple[float, float]] | None = None
        self.handles: Handles | None = None
        self.selected: int | None = None
        self.modelled = np.zeros(len(world.joints.names), bool)
        self._last = np.full(0, np.nan)
        doubles = list(world.doubles)
        owners = [
            doubles.index(name) if isinstance(part, DoublePart) else -1
            for name, part in world.owners.items()
        ]
        of_owner = np.array([*owners, -1], np.intp)  # the last entry is for frames of no robot
        self._double_of_joint = of_owner[world.joints.owner]
        self._double_of_frame = of_owner[world.frames.owner]
        switches = [item for item in world.inputs.values() if item.kind == "toggle"]
        self._switches = switches
        self._switch_slots = np.array([world.slots[s.target].start for s in switches], np.intp)
        self._switch_flags = np.array([world.flags[s.target] for s in switches], np.intp)
        self.reset()

    def reset(self) -> None:
        world, scene = self._world, self._world.scene
        declared = [part.declared for part in world.owners.values()]

        def per_joint(field: str) -> Bools:
            shown = np.array([getattr(owner, field) for owner in declared], bool)
            return shown[world.joints.owner] if declared else np.zeros(0, bool)

        self.arrows = per_joint("show_arrows")
        self.arrow_quantity = world.joints.arrow_quantity.copy()
        self.billboards = per_joint("show_billboards")
        self.clicked = np.zeros(len(self.arrows), bool)
        self.details = np.zeros(len(self.arrows), bool)
        with_owner = np.array([*(owner.show_axes for owner in declared), False], bool)
        owner = world.frames.owner
        self.axes = np.where(owner < 0, world.frames.shown, with_owner[owner])
        self.frame_names = np.full(len(self.axes), scene.toggles.frame_names)
        self.vectors = np.array([arrow.show for arrow in scene.arrows.values()], bool)
        self.cards = np.zeros(len(self.vectors), bool)
        self.doubles = np.array([part.double.visible for part in world.doubles.values()], bool)
        self.legend = scene.toggles.legend
        self.status = scene.toggles.status
        self.flange_checks = scene.toggles.flange_checks
        self.contacts = self.inertias = self.joint_axes = self.centres_of_mass = False
        self.transparent = self.wireframe = False
        self.part_names = 0
        self._last = np.full(len(self._switches), np.nan)  # received toggles are applied again

    def snapshot(self) -> dict[str, Any]:
        state = {key: value for key, value in vars(self).items() if not key.startswith("_")}
        return copy.deepcopy(state)

    def restore(self, snapshot: dict[str, Any]) -> None:
        vars(self).update(copy.deepcopy(snapshot))

    def apply_inputs(self, data: mujoco.MjData) -> None:
        """Sets the switches whose inputs have changed since the last call.

        Unchanged inputs have no effect, so that users can change the same switches. A value above
        0.5 switches a feature on. NaN is ignored.
        """
        userdata = data.userdata
        if not userdata[self._switch_flags].any():
            return
        values = np.where(userdata[self._switch_flags] > 0, userdata[self._switch_slots], np.nan)
        changed = (values != self._last) & np.isfinite(values)
        for i in changed.nonzero()[0]:
            self._switch(self._switches[i], float(values[i]))
            self._last[i] = values[i]

    def _switch(self, item: Input, value: float) -> None:
        world, on = self._world, value > 0.5
        if item.name == SCENE:
            if item.key == "frame_names":
                self.frame_names[:] = on
            else:
                setattr(self, item.key, on)
        elif item.key == "visible":
            self.doubles[list(world.doubles).index(item.name)] = on
        elif item.key == "show":
            self.vectors[world.arrows.names.index(item.name)] = on
        elif item.name not in world.owners:
            self.axes[world.frames.names.index(item.name)] = on
        elif item.key == "show_axes":
            self.axes[world.frames.owner == list(world.owners).index(item.name)] = on
        elif item.key == "arrow_quantity":
            if 0 <= round(value) < len(ARROW_QUANTITIES):
                self.arrow_quantity[world.owners[item.name].joints] = round(value)
        else:
            feature = {"show_arrows": self.arrows, "show_billboards": self.billboards}[item.key]
            feature[world.owners[item.name].joints] = on

    def shown(self, data: mujoco.MjData) -> ShownItems:
        """Returns the items to draw, without doubles and frames that have not received a pose."""
        has = data.userdata[self._world.frames.has] > 0
        frames = has | (self._world.frames.has < 0)
        joints = np.ones(len(self.arrows), bool)
        if len(self.doubles):
            visible = np.array([*self.doubles, True])
            frames &= visible[self._double_of_frame]
            came = data.userdata[self._world.joints.has["joint_angles"]] > 0
            joints = (came & visible[self._double_of_joint]) | (self._double_of_joint < 0)
        # An arrow has a pose only if the frames that it acts at and is expressed in have one.
        anywhere = np.append(frames, True)[self._world.arrows.frames].all(axis=1)
        vectors = self.vectors & anywhere
        return ShownItems(
            joints=joints,
            arrows=self.arrows & joints,
            billboards=(self.billboards | self.details) & joints,
            axes=self.axes & frames,
            frame_names=self.frame_names & self.axes & frames,
            vectors=vectors,
            cards=self.cards & vectors,
        )

    def hidden_geoms(self) -> Bools | None:
        if self.doubles.all():
            return None
        hidden = np.zeros(self._world.model.ngeom, bool)
        for part, on in zip(self._world.doubles.values(), self.doubles, strict=True):
            if not on:
                hidden |= np.isin(self._world.model.geom_bodyid, part.bodies)
        return hidden
