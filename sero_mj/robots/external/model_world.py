"""`ModelWorld`: the `WorldView` of an external model.

The robots, joints and frames of a `ModelWorld` are derived from the model instead of a scene. Input
values are stored in the `ModelWorld` instead of the user's data.
"""

from __future__ import annotations

import copy
import logging
from collections.abc import Mapping, Sequence
from typing import Any

import mujoco
import numpy as np

from ...base.errors import Problem, UnknownName, mismatch
from ...base.frames import Array, Bools, Ints
from ..assemble.mjcf import build_surroundings
from ..assemble.parts import DoublePart, DrawnDouble, make_tables
from ..assemble.solids import geom_boxes, is_shown
from ..assemble.world_view import WorldView
from ..declared.cartesian import NamedFrame, SmartArrow
from ..declared.double import Double
from ..declared.inputs import BLANKABLE, list_inputs, to_array, to_frame, userdata_slots
from ..declared.robot_parts import VALUE_INPUTS
from ..declared.scene import Scene, SceneToggles
from ..declared.surroundings import View
from ._model_robot import ModelPart, list_model_frames, model_part
from ._model_state import JointPoses, ModelDoubles, ModelState, Sites
from ._model_trees import find_trees

log = logging.getLogger(__name__)


_FROM_MODEL = {"torques": "qfrc_actuator", "joint_accelerations": "qacc"}  # data fields by input
_MUJOCO_VIEW = (90.0, -45.0)  # MuJoCo's default azimuth and elevation
# Maximum distance and size of objects that the view includes, relative to the size of the robots.
_MAX_GAP, _MAX_SIZE = 1.0, 2.0
_FLOORS = (int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD))
_EMPTY = np.empty(0, np.intp)


class ModelScene(Scene):
    """The scene declaration that describes an external model."""

    def __init__(self, frames: Mapping[str, NamedFrame], **fields: Any) -> None:
        self._frames = dict(frames)  # The constructor of the base class needs these frames.
        super().__init__(floor=False, **fields)

    def frame_name(self, name: str) -> str:
        return name

    def named_frames(self) -> dict[str, NamedFrame]:
        return self._frames


class ModelWorld(WorldView):
    """The world of an external model, on which an overlay draws arrows, axes and billboards.

    Args:
        data: data of the user, which is only read.
        robots: fields that override values of the model, by robot name.
        frames: names of bodies and sites whose axes are shown in addition to those of robots.
        surroundings: whether a floor, a sky and lights are added if the model has none.

    Attributes:
        options: constructor arguments except `model` and `data`.
        not_finite: number of input values that were not shown because they were NaN, infinite or
            implausibly large.

    Raises:
        DeclarationError: the model has no hinge or slide, or a field does not fit the model.
        UnknownName: a name in `robots` or `frames` does not exist in the model.
    """

    has_sites = False

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        *,
        robots: Mapping[str, Mapping[str, Any]] | None = None,
        doubles: Sequence[Double] = (),
        arrows: Sequence[SmartArrow] = (),
        frames: Sequence[str] = (),
        toggles: SceneToggles | None = None,
        surroundings: bool = True,
        name: str = "overlay",
    ) -> None:
        self._has_surroundings = surroundings
        self._surroundings: mujoco.MjModel | None = None
        self.model, self.data, self.not_finite, self.changes = model, data, 0, 0
        self.options: dict[str, Any] = {
            "robots": robots,
            "doubles": doubles,
            "arrows": arrows,
            "frames": frames,
            "toggles": toggles,
            "surroundings": surroundings,
            "name": name,
        }
        self.placed = {}
        overrides = dict(robots or {})
        trees = find_trees(model, overrides)
        if not trees:
            raise Problem("model", _no_joints(model)).error()
        for robot in overrides:
            if robot not in [tree.name for tree in trees]:
                raise UnknownName("robot", robot, [tree.name for tree in trees])
        rest = mujoco.MjData(model)
        mujoco.mj_fwdPosition(model, rest)
        found: dict[str, ModelPart] = {}
        start = 0
        for tree in trees:
            found[tree.name] = model_part(model, rest, tree, overrides.get(tree.name, {}), start)
            start += len(tree.joints)
        self._trees = trees
        self.robots = dict(found)
        wanted = {double.name: double for double in doubles if double.of in found}
        named, places = list_model_frames(model, found, wanted, frames)
        self.scene = ModelScene(
            named,
            robots=[part.robot for part in found.values()],
            doubles=list(doubles),
            arrows=list(arrows),
            view=_view(model),
            toggles=toggles,
            name=name,
        )
        self.doubles = self._double_parts(start)
        single = {key: part for key, part in self.doubles.items() if part.path is None}
        self.owners = {**self.robots, **single}
        self.inputs = {
            target: item
            for target, item in list_inputs(self.scene).items()
            if item.kind != "pose" and not (item.kind == "angles" and item.name in self.robots)
        }
        self.slots, self.flags, count = userdata_slots(self.scene)
        self._userdata = np.zeros(count)
        points = [arrow for arrow in self.scene.arrows.values() if arrow.site is not None]
        self._sites = Sites(
            joints=[
                ("" if key in self.robots else key, self._joint_poses(part))
                for key, part in self.owners.items()
            ],
            frames=list(places.values()),
            points=np.array([arrow.at for arrow in points]).reshape(-1, 3),
        )
        centres = [
            f"{part.scope}centre{i + 1}"
            for part in self.owners.values()
            for i in range(part.robot.n)
        ]
        rows = {
            key: row
            for row, key in enumerate([*centres, *named, *(str(arrow.site) for arrow in points)])
        }

        def sites(names: Sequence[str]) -> Ints:
            return np.array([rows[key] for key in names], np.intp)

        self.joints, self.frames, self.arrows = make_tables(
            self.scene, self.owners, self.slots, self.flags, sites
        )
        self._posed = ModelDoubles(model, self.doubles)
        self._declare()

    def _double_parts(self, start: int) -> dict[str, DoublePart]:
        parts = {}
        for name, double in self.scene.doubles.items():
            robot = self.robots[double.of]
            path = None if double.path is None else double.poses()
            stop = start + (robot.robot.n if path is None else 0)
            parts[name] = DoublePart(
                double=double,
                of=robot,
                mocap=_EMPTY.reshape(1, 0),
                bodies=_EMPTY.reshape(1, 0),
                frames=_EMPTY,
                path=path,
                joints=slice(start, stop),
            )
            start = stop
        return parts

    def _joint_poses(self, part: Any) -> JointPoses:
        of: Any = part.of if isinstance(part, DoublePart) else part
        return JointPoses(self.model, of.tree.joints, of.robot.offsets)

    def _declare(self) -> None:
        self._providable = [(name, key) for name in self.robots for key in _FROM_MODEL]
        self._live = set(self._providable)
        for double in self.doubles.values():
            if double.path is None:
                self.set_declared(self.data, double.double, ("joint_angles", *VALUE_INPUTS))
        for arrow in self.scene.arrows.values():
            self.set_declared(self.data, arrow, ("vector",))

    def make_data(self) -> mujoco.MjData:
        """Returns a copy of the user's data with updated kinematics."""
        data = copy.copy(self.data)
        mujoco.mj_fwdPosition(self.model, data)
        return data

    def reset(self, data: mujoco.MjData) -> None: ...

    def state(self, data: Any) -> ModelState:
        if isinstance(data, ModelState):
            return data
        for name, key in self._live:  # inputs that the user has not set
            slot = self.slots[f"{name}.{key}"]
            self._userdata[slot] = getattr(data, _FROM_MODEL[key])[self.robots[name].dofs]
            self._userdata[self.flags[f"{name}.{key}"]] = 1.0
        angles = {
            name: self._userdata[self.slots[f"{name}.joint_angles"]]
            for name, part in self.doubles.items()
            if part.path is None and self._userdata[self.flags[f"{name}.joint_angles"]] > 0
        }
        doubles = self._posed.pose(data, angles)
        positions, rotations = self._sites.read(data, doubles)
        return ModelState(
            data, self._userdata, positions, rotations, doubles,
            data.time, data.qpos, data.qvel, data.xpos, data.xmat,
        )  # fmt: skip

    def drawn_doubles(self, state: Any, shown: Bools) -> list[DrawnDouble]:
        return [
            drawn
            for name, on in zip(self.doubles, shown, strict=True)
            if on
            for drawn in self._posed.drawn(state, name)
        ]

    def geoms_in_view(self) -> Bools:
        """Returns a mask of the geoms of robots and nearby movable objects, shape (ngeom,)."""
        model = self.model
        bodies = np.concatenate([tree.bodies[tree.bodies > 0] for tree in self._trees])
        of_robots = np.isin(model.geom_bodyid, bodies)
        of_robots[np.concatenate([tree.trunk for tree in self._trees])] = True
        of_robots &= model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        if not of_robots.any():
            return of_robots
        low, high = geom_boxes(model, self.make_data())
        lowest, highest = low[of_robots].min(axis=0), high[of_robots].max(axis=0)
        size = float(np.linalg.norm(highest - lowest))
        gap = np.maximum(np.maximum(lowest - high, low - highest), 0.0)
        movable = model.body_dofnum[model.body_weldid[model.geom_bodyid]] > 0
        beside = np.linalg.norm(gap, axis=1) <= _MAX_GAP * size
        small = np.linalg.norm(high - low, axis=1) <= _MAX_SIZE * size
        return np.asarray(of_robots | (movable & beside & small & is_shown(model)))

    def surroundings(self) -> mujoco.MjModel | None:
        """Returns a model of the floor, sky and lights that the user's model lacks, or None.

        The floor is at height 0, or below the lowest robot at the time of the first call.
        """
        if self._surroundings is not None:
            return self._surroundings
        model = self.model
        has_floor = np.isin(model.geom_type, _FLOORS).any()
        has_sky = (model.tex_type == int(mujoco.mjtTexture.mjTEXTURE_SKYBOX)).any()
        if not self._has_surroundings or (has_floor and has_sky and model.nlight):
            return None
        visible = self.geoms_in_view()
        low, high = (corner[visible] for corner in geom_boxes(model, self.make_data()))
        if not visible.any():
            low = high = np.zeros((1, 3))
        lowest, highest = low.min(axis=0), high.max(axis=0)
        self._surroundings = build_surroundings(
            self.scene.view.look,
            floor=None if has_floor else min(float(lowest[2]), 0.0),
            sky=not has_sky,
            lights=not model.nlight,
            middle=(lowest + highest) / 2,
            size=float(np.linalg.norm(highest - lowest)) or float(model.stat.extent),
        ).compile()
        return self._surroundings

    def set_input(self, data: Any, target: str, values: Any) -> None:
        """Sets an input to values that override those of the model.

        NaN, infinite values and values beyond `Input.limits` mean no data. They are not shown, do
        not move a double, and are counted in `not_finite`.

        Args:
            target: name of the input, such as `arm.torques`.
            values: values in the shape of the input, (n,), (3,) or one number. Joint values can
                also be a vector of shape (nv,), such as `data.qfrc_actuator`, or a mapping from
                joint names to numbers.

        Raises:
            UnknownName: the robot, input or joint does not exist.
            ValueError: the number of values is wrong, or the input is the joint angles of a robot.
        """
        name, _, key = target.partition(".")
        if key == "joint_angles" and name in self.robots:
            raise ValueError(
                f"{target}: the joint angles of {name} come from your data. Set data.qpos instead"
            )
        item = self.resolve_input(target)
        if isinstance(values, Mapping) and item.kind in ("angles", "values"):
            values = self._by_name(name, values)
        array = to_array(item, values)
        if item.kind == "values" and array.shape == (self.model.nv,):
            array = array[self._dofs(name)]
        if array.shape != item.shape:
            found, reason = (array.shape, "found shape") if array.size else (values, "")
            many = item.meaning if item.count == 1 else f"{item.meaning}: shape {item.shape}"
            if item.kind == "values" and item.shape != (self.model.nv,):
                many += f", or one per degree of freedom of the model: shape ({self.model.nv},)"
            raise mismatch(found, many, reason, key=target)
        bad = ~np.isfinite(array) | (np.abs(array) > item.limits)
        if bad.any() and not isinstance(values, _ByName):
            if not self.not_finite:
                log.warning("%s: NaN, infinite and implausibly large values are not shown", target)
            self.not_finite += int(bad.sum())
            if item.kind not in BLANKABLE:
                return
        elif item.shape == (4, 4):
            array = to_frame(target, array)
        self._userdata[self.slots[target]] = np.where(bad, np.nan, array).ravel()
        self._userdata[self.flags[target]] = 1.0
        self._live.discard((name, key))
        self.changes += 1

    def input_state(self) -> Array:
        """Returns the values and flags of all inputs as an array for `set_input_state`."""
        live = [pair in self._live for pair in self._providable]
        return np.concatenate([self._userdata, live])

    def set_input_state(self, state: Array) -> None:
        count = len(self._userdata)
        self._userdata[:] = state[:count]
        live = state[count:] > 0
        self._live = {pair for pair, on in zip(self._providable, live, strict=True) if on}

    def _dofs(self, owner: str) -> Ints:
        part: Any = self.owners[owner]
        return np.asarray(part.of.dofs if isinstance(part, DoublePart) else part.dofs)

    def _by_name(self, owner: str, values: Mapping[str, Any]) -> Array:
        names = self.owners[owner].robot.names
        array = np.full(len(names), np.nan).view(_ByName)
        for joint, value in values.items():
            if joint not in names:
                raise UnknownName(f"joint of {owner}", joint, names)
            try:
                array[names.index(joint)] = value
            except (TypeError, ValueError):
                raise mismatch(value, "a number", f"joint {joint}: found", key=owner) from None
        return array

    def clear_input(self, target: str) -> None:
        """Clears an input. If the model provides values, these are shown again."""
        item = self.resolve_input(target)
        self._userdata[self.flags[target]] = 0.0
        if item.name in self.robots and item.key in _FROM_MODEL:
            self._live.add((item.name, item.key))
        self.changes += 1


class _ByName(np.ndarray):
    """Values by joint name. Missing joints have NaN, which is not counted in `not_finite`."""


def _no_joints(model: mujoco.MjModel) -> str:
    kinds = [mujoco.mjtJoint(int(kind)).name[6:].lower() for kind in np.unique(model.jnt_type)]
    found = f"joints of type {' and '.join(kinds)}" if kinds else "no joint"
    return f"found {found}; expected a hinge or slide joint"


def _view(model: mujoco.MjModel) -> View:
    own = float(model.vis.global_.azimuth), float(model.vis.global_.elevation)
    return View() if own == _MUJOCO_VIEW else View(azimuth_deg=own[0], elevation_deg=own[1])
