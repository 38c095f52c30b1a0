"""`WorldView`: what decor, hosts and clicks know of a world, whoever has compiled its model."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import UnknownName
from ..frames import inverse
from .frame_table import ArrowTable, FrameTable
from .inputs import Input
from .joint_table import JointTable
from .parts import DoublePart, Ghost, Owner, RobotPart
from .scene import Scene

Array = NDArray[np.float64]


class WorldView(Protocol):
    """A model, and where in it robots, doubles, frames and arrows are.

    A `World` compiles a scene of ours; a `ModelWorld` finds the same in somebody else's model.
    Decor reads a *state*: for a `World` that is its `MjData`.

    Attributes:
        scene: what is declared.
        model: the `MjModel`.
        robots: `RobotPart` by name.
        doubles: `DoublePart` by name.
        owners: robots and doubles that have joints, by name, in the order of `joints`.
        joints: arrays over all joints.
        frames: arrays over all frames.
        arrows: arrays over all smart arrows.
        inputs: everything that can be set, by `name.key`.
        slots: name to slice of a state's `userdata`, e.g. `lwr.torques`, `sources.udp`.
        flags: name of an input to the index in `userdata` that says whether something came.
        placed: index in `mocap_pos` of what a `frame` or `base_frame` input places, by name.
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

    def make_data(self) -> mujoco.MjData:
        """Returns data of its own, with every robot where it is at first."""

    def reset(self, data: mujoco.MjData) -> None:
        """Puts everything back where it is at first, as far as the data is ours."""

    def state(self, data: mujoco.MjData) -> Any:
        """What decor reads of `data`: an object with these fields of an `MjData`.

        `time`, `qpos`, `xpos`, `xmat`, `site_xpos`, `site_xmat`, `userdata`.
        """

    def drawn_doubles(self, state: Any, shown: NDArray[np.bool_]) -> list[Ghost]:
        """Doubles that are not compiled into the model, and that decor has to draw.

        Args:
            state: what `state` returned.
            shown: which doubles are switched on, (D,).
        """

    def geoms_in_view(self) -> NDArray[np.bool_]:
        """Which geoms of the model a view of everything holds, (ngeom,)."""

    def set_input(self, data: mujoco.MjData, target: str, values: Any) -> None:
        """Sets an input; raises UnknownName or ValueError."""

    def set_declared(self, data: mujoco.MjData, declared: Any, keys: Iterable[str]) -> None:
        """Sets inputs to what a robot, double, arrow or frame is declared with."""
        for key in keys:
            if getattr(declared, key) is not None:
                self.set_input(data, f"{declared.name}.{key}", getattr(declared, key))

    def set_pose(self, data: mujoco.MjData, name: str, T_world: Array) -> None:
        """Places what is in `placed` (a base, a received frame, an object, a camera) at (4, 4)."""
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, T_world[:3, :3].ravel())
        data.mocap_pos[self.placed[name]] = T_world[:3, 3]
        data.mocap_quat[self.placed[name]] = quat

    def resolve_input(self, target: str) -> Input:
        """Returns the input that `name.key` names.

        Raises:
            UnknownName: no such name, or no such input of it; lists those that exist.
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
        names = dict.fromkeys(item.name for item in self.inputs.values())
        raise UnknownName("robot", name, list(names))

    def fwd_kin_base_to_flange(self, data: mujoco.MjData, robot: str) -> Array:
        """T_base_flange (4, 4) of the compiled model at `data`, translation in m.

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
        """T_world_name (4, 4) of a named frame (`lwr/flange`) at `data`, translation in m.

        Raises:
            UnknownName: no such frame.
        """
        if name not in self.frames.names:
            raise UnknownName("frame", name, self.frames.names)
        state = self.state(data)
        site = self.frames.site[self.frames.names.index(name)]
        return _frame(state.site_xmat[site], state.site_xpos[site])


def _frame(rotation: Array, position: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.reshape(3, 3), position
    return T
