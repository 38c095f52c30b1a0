"""`WorldView`: the interface of a world for decor, windows, pages and picking."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import mujoco
import numpy as np

from ...base.errors import DeclarationError, UnknownName, problems_of
from ...base.frames import Array, Bools, frame, inverse
from ..declared.inputs import Input, inputs_of_group, share_out
from ..declared.scene import Scene
from .parts import ArrowTable, DoublePart, DrawnDouble, FrameTable, JointTable, Owner, RobotPart

SET_BY_SOURCE, SET_BY_PROGRAM = 1.0, 2.0  # flags of inputs, which are 0 for inputs without values


class WorldView(Protocol):
    """A compiled model and the indices of its robots, doubles, frames and arrows.

    A `World` is compiled from a scene, and a `ModelWorld` is derived from an external model. Decor
    reads a state. For a `World`, this is the `MjData` itself.

    Attributes:
        owners: robots and doubles with joints, by name, in the order of `joints`.
        slots: slices of `userdata` by name, for example `lwr.torques` or `sources.udp`.
        flags: indices in `userdata` of the flags of inputs. A flag is 0 if the input has no value,
            `SET_BY_SOURCE` (also for declared values), or `SET_BY_PROGRAM`.
        placed: indices in `mocap_pos` of the bodies that `frame` and `base_frame` inputs move, by
            name of the robot, frame, object or camera.
        has_sites: whether the model contains the sites of joints, frames and arrows.
        dynamic: whether velocities and contact forces of the data are meaningful.
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
        """Returns the state that decor reads: an `MjData`, or an object with the same fields.

        Decor reads `time`, `qpos`, `xpos`, `xmat`, `site_xpos`, `site_xmat` and `userdata`.
        """

    def drawn_doubles(self, state: Any, shown: Bools) -> list[DrawnDouble]:
        """Returns the doubles in the mask `shown` (D,) that are not compiled into the model."""

    def geoms_in_view(self) -> Bools:
        """Returns a mask of the geoms that a view of the whole scene includes, shape (ngeom,)."""

    def surroundings(self) -> mujoco.MjModel | None:
        """Returns a model with floor, sky and lights to be drawn with the scene, or None."""
        return None

    def weighed(self) -> mujoco.MjModel:
        """Returns the model with the masses of the simulation.

        Raises DeclarationError if the masses of a robot are invalid.
        """
        return self.model

    def set_input(self, data: mujoco.MjData, target: str, values: Any) -> None:
        """Sets an input, such as `lwr.torques`, to values of its shape in SI units.

        Raises UnknownName if the input does not exist, and ValueError if the values are invalid.
        """

    def set_declared(self, data: mujoco.MjData, declared: Any, keys: Iterable[str]) -> None:
        """Sets inputs to the values of the fields `keys` of `declared`, except for None."""
        for key in keys:
            if getattr(declared, key) is not None:
                self.set_input(data, f"{declared.name}.{key}", getattr(declared, key))

    def set_pose(self, data: mujoco.MjData, name: str, T_world: Array) -> None:
        """Sets the pose of a body in `placed`, shape (4, 4), m."""
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, T_world[:3, :3].ravel())
        data.mocap_pos[self.placed[name]] = T_world[:3, 3]
        data.mocap_quat[self.placed[name]] = quat

    def shares(self, target: str, values: Any) -> dict[str, Any]:
        """Distributes the values of an input of a group to inputs of its members.

        If `target` is not an input of a group, the result contains only `target`.

        Args:
            target: name of the input of a robot, double or group, such as `lwr.torques`.
            values: values of the input. For a group, these are the values of all joints or of the
                independent joints of its robots, in order. A toggle applies to all robots.

        Raises:
            UnknownName: no robot of the group has this input.
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
        """Returns the input with the name `target`. Raises UnknownName if it does not exist."""
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
        """Returns the pose of a robot's flange in its base frame at `data`, shape (4, 4), m."""
        if robot not in self.robots:
            raise UnknownName("robot", robot, self.robots)
        part = self.robots[robot]
        state = self.state(data)
        base, flange = (
            frame(state.xmat[body].reshape(3, 3), state.xpos[body])
            for body in (part.bodies[0], part.flange_body)
        )
        return np.asarray(inverse(base) @ flange)

    def frame(self, data: mujoco.MjData, name: str) -> Array:
        """Returns the pose of a named frame (`lwr/flange`) in the world, shape (4, 4), m."""
        state, site = self.state(data), self.frame_site(name)
        return frame(state.site_xmat[site].reshape(3, 3), state.site_xpos[site])

    def frame_site(self, name: str) -> int:
        """Returns the site of a frame, joint, or link of the original robot file.

        Raises UnknownName if there is no such frame.
        """
        own = self.scene.frame_name(name)
        if own not in self.frames.names:
            raise UnknownName("frame", name, self.frames.names)
        return int(self.frames.site[self.frames.names.index(own)])
