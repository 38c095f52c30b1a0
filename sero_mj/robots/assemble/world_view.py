"""`WorldView`: the interface of a world to decor, hosts and picking."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import mujoco
import numpy as np

from ...base.errors import DeclarationError, UnknownName, problems_of
from ...base.frames import Array, Bools, inverse
from ..declared.inputs import Input, inputs_of_group, share_out
from ..declared.scene import Scene
from .parts import ArrowTable, DoublePart, DrawnDouble, FrameTable, JointTable, Owner, RobotPart

SET_BY_SOURCE, SET_BY_PROGRAM = 1.0, 2.0  # flags of inputs: who has set them last; 0 for nobody


class WorldView(Protocol):
    """A compiled model and the indices of its robots, doubles, frames and arrows.

    A `World` is compiled from a scene; a `ModelWorld` is derived from an external model.
    Decor reads a *state*, which for a `World` is its `MjData`.

    Attributes:
        owners: robots and doubles that have joints, by name, in the order of `joints`.
        slots: slice of a state's `userdata` by name, e.g. `lwr.torques`, `sources.udp`.
        flags: index in `userdata` of the flag who has set an input last, by its name.
        placed: index in `mocap_pos` of the bodies that `frame` and `base_frame` inputs move, by
            name.
        has_sites: whether sites in the tables of joints, frames and arrows are sites of the model.
        dynamic: whether its data have velocities and forces, of which those of contacts follow.
    """

    scene: Scene
    model: mujoco.MjModel
    robots: dict[str, RobotPart]
    doubles: dict[str, DoublePart]
    owners: dict[str, Owner]
    joints: JointTable
    frames: FrameTable
    arrows: ArrowTable
    inputs: dict[str, Input]
    slots: dict[str, slice]
    flags: dict[str, int]
    placed: Mapping[str, int]
    has_sites: bool = True
    dynamic: bool = True

    def make_data(self) -> mujoco.MjData: ...

    def reset(self, data: mujoco.MjData) -> None: ...

    def state(self, data: mujoco.MjData) -> Any:
        """Returns the state that decor reads: an object with these fields of an `MjData`.

        `time`, `qpos`, `xpos`, `xmat`, `site_xpos`, `site_xmat`, `userdata`.
        """

    def drawn_doubles(self, state: Any, shown: Bools) -> list[DrawnDouble]:
        """Returns the doubles that decor draws because they are not compiled into the model.

        Args:
            shown: which doubles are switched on, (D,).
        """

    def geoms_in_view(self) -> Bools:
        """Returns the geoms that a view of the whole scene includes, (ngeom,) bool."""

    def surroundings(self) -> mujoco.MjModel | None:
        """Returns a model of the floor, sky and lights that hosts add; None for none."""
        return None

    def weighed(self) -> mujoco.MjModel:
        """Returns the model with the masses of simulation: itself where it has them.

        Raises DeclarationError with errors of the robots' masses.
        """
        return self.model

    def set_input(self, data: mujoco.MjData, target: str, values: Any) -> None:
        """Sets an input, `name.input` of `inputs`, to values of its shape, SI units.

        Raises UnknownName for an unknown input, and ValueError for values that do not fit.
        """

    def set_declared(self, data: mujoco.MjData, declared: Any, keys: Iterable[str]) -> None:
        """Sets inputs to the declared values of a robot, double, arrow or frame.

        Args:
            keys: its fields, which are inputs of the same names; those that are None are skipped.
        """
        for key in keys:
            if getattr(declared, key) is not None:
                self.set_input(data, f"{declared.name}.{key}", getattr(declared, key))

    def set_pose(self, data: mujoco.MjData, name: str, T_world: Array) -> None:
        """Sets the pose (4, 4), m, in the world of one of `placed`."""
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, T_world[:3, :3].ravel())
        data.mocap_pos[self.placed[name]] = T_world[:3, 3]
        data.mocap_quat[self.placed[name]] = quat

    def shares(self, target: str, values: Any) -> dict[str, Any]:
        """Returns values by input: a single one, or those of the robots of a group.

        Args:
            target: `name.input`, where the name may be that of a group, or of a double of one.
            values: of one input unchanged; of a group those of all joints, or of the independent
                ones, in the order of its robots. A switch applies to all.

        Raises:
            UnknownName: no robot of a group has such an input.
            ValueError: the number of values does not match the group.
        """
        name, _, key = target.partition(".")
        members = None if target in self.inputs else self.scene.members(name)
        if members is None:
            return {target: values}
        try:
            items = inputs_of_group(self.inputs, name, key, members)
        except ValueError as error:
            raise DeclarationError(problems_of(error, target)) from None
        parts = share_out(items, target, values)
        return {item.target: part for item, part in zip(items, parts, strict=True)}

    def resolve_input(self, target: str) -> Input:
        """Returns the input that `name.key` names.

        Raises:
            UnknownName: no such name or input; lists the existing ones.
        """
        if target in self.inputs:
            item = self.inputs[target]
            if item.kind != "pose" or item.name in self.placed:
                return item
            raise UnknownName("moving object or camera (nothing is routed to)", item.name, [])
        name, _, key = target.partition(".")
        keys = [item.key for item in self.inputs.values() if item.name == name]
        if keys:
            raise UnknownName(f"input of {name}", key, keys)
        names = [item.name for item in self.inputs.values()]
        raise UnknownName("robot", name, [*names, *self.scene.groups, *self.scene.double_groups])

    def fwd_kin_base_to_flange(self, data: mujoco.MjData, robot: str) -> Array:
        """Returns T_base_flange (4, 4) of the compiled model at `data`, translation in m.

        Raises:
            UnknownName: no such robot.
        """
        if robot not in self.robots:
            raise UnknownName("robot", robot, self.robots)
        part = self.robots[robot]
        state = self.state(data)
        base, flange = (
            _frame(state.xmat[body], state.xpos[body])
            for body in (part.bodies[0], part.flange_body)
        )
        return np.asarray(inverse(base) @ flange)

    def frame(self, data: mujoco.MjData, name: str) -> Array:
        """Returns T_world_name (4, 4) of a named frame (`lwr/flange`) at `data`, translation in m.

        Raises:
            UnknownName: no such frame.
        """
        state, site = self.state(data), self.frame_site(name)
        return _frame(state.site_xmat[site], state.site_xpos[site])

    def frame_site(self, name: str) -> int:
        """Returns the site of a frame named by our name, a joint, or a link's original name.

        Raises:
            UnknownName: no such frame.
        """
        own = self.scene.frame_name(name)
        if own not in self.frames.names:
            raise UnknownName("frame", name, self.frames.names)
        return int(self.frames.site[self.frames.names.index(own)])


def _frame(rotation: Array, position: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.reshape(3, 3), position
    return T
