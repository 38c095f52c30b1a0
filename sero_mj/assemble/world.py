"""`World`: a compiled scene, with the ids and slots that the other layers read by array.

What decor shows and `MjData` has no field for (received torques, billboard values, the state of
sources) lives in named slots of `MjData.userdata`. It is part of MuJoCo's integration state, so
copies, history and recordings carry it. `mj_resetData` zeroes it: apply the latest packet again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..errors import DeclarationError, Problem, UnknownName
from .mesh_check import mesh_problems
from .mjcf import build_mjcf, xml_text
from .mjcf_double import DOUBLE_GROUP, OUT_OF_SIGHT, body_names
from .scene import Scene
from .tables import (
    DOUBLE_INPUTS,
    INPUTS,
    VALUE_INPUTS,
    DoublePart,
    RobotPart,
    frame_table,
    joint_table,
    userdata_slots,
)

Array = NDArray[np.float64]
Ints = NDArray[np.intp]


class World:
    """A compiled scene.

    Attributes:
        scene: what it was compiled from.
        model: the `MjModel`.
        robots: `RobotPart` by name.
        doubles: `DoublePart` by name.
        joints: arrays over all joints.
        frames: arrays over all frames.
        slots: name to slice of `userdata`, e.g. `lwr.torques`, `sources.udp`.

    Raises:
        DeclarationError: files or values that MuJoCo cannot compile, by robot and file.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.slots = userdata_slots(scene)
        root = build_mjcf(scene)
        root.size.nuserdata = max((slot.stop for slot in self.slots.values()), default=0)
        self._root = root
        self.model = _compile(root, scene)
        if scene.doubles:
            self._measure_without_doubles()
        self.robots = self._find_robots()
        self.doubles = self._find_doubles()
        self.joints = joint_table(self.model, self.robots, self.slots)
        self.frames = frame_table(self.model, self.robots, scene)

    def make_data(self) -> mujoco.MjData:
        """Returns a new `MjData` with every robot at its declared joint angles."""
        data = mujoco.MjData(self.model)
        self.reset(data)
        return data

    def reset(self, data: mujoco.MjData) -> None:
        """Puts every robot at its declared joint angles and shows what the scene declares."""
        mujoco.mj_resetData(self.model, data)
        for name, part in self.robots.items():
            data.qpos[part.qpos] = part.robot.home
            for key in VALUE_INPUTS:
                declared = getattr(part.robot, key)
                if declared is not None:
                    self.set_input(data, f"{name}.{key}", declared)
        for name, double in self.doubles.items():
            data.mocap_pos[double.mocap] = OUT_OF_SIGHT
            if double.double.joint_angles is not None:
                self.set_input(data, f"{name}.joint_angles", double.double.joint_angles)
        mujoco.mj_forward(self.model, data)

    def set_input(self, data: mujoco.MjData, target: str, values: Any) -> None:
        """Sets an input of a robot; call `drive.follow` afterwards to move the frames.

        Args:
            data: what to change.
            target: `robot.input`, e.g. `lwr.joint_angles`.
            values: (n,), SI units.

        Raises:
            UnknownName: no such robot or input.
            ValueError: not n finite numbers.
        """
        part, key = self.resolve_input(target)
        n = part.robot.n if isinstance(part, RobotPart) else part.robot.robot.n
        try:
            array = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (n,) or not np.isfinite(array).all():
            found = array.tolist() if array.size else values
            raise ValueError(f"{target}: found {found}; expected {n} finite numbers")
        if key == "joint_angles" and isinstance(part, RobotPart):
            data.qpos[part.qpos] = array
        else:
            data.userdata[self.slots[target]] = array
        name = target.partition(".")[0]
        data.userdata[self.slots[f"{name}.has"].start + INPUTS.index(key)] = 1.0

    def resolve_input(self, target: str) -> tuple[RobotPart | DoublePart, str]:
        """Returns the robot or double and the input that `robot.input` names.

        Raises:
            UnknownName: no such robot or input; lists those that exist.
        """
        robot, _, key = target.partition(".")
        inputs = DOUBLE_INPUTS if robot in self.doubles else INPUTS
        part = self.doubles[robot] if robot in self.doubles else self._part(robot)
        if key not in inputs:
            raise UnknownName(f"input of {robot}", key, inputs)
        return part, key

    def _part(self, robot: str) -> RobotPart:
        if robot not in self.robots:
            raise UnknownName("robot", robot, [*self.robots, *self.doubles])
        return self.robots[robot]

    def fwd_kin_base_to_flange(self, data: mujoco.MjData, robot: str) -> Array:
        """T_base_flange (4, 4) of the compiled model at `data`, translation in m."""
        part = self._part(robot)
        base, flange = part.bodies[0], part.flange_body
        T = np.eye(4)
        rotation = data.xmat[base].reshape(3, 3)
        T[:3, :3] = rotation.T @ data.xmat[flange].reshape(3, 3)
        T[:3, 3] = rotation.T @ (data.xpos[flange] - data.xpos[base])
        return T

    def export(self, path: Path) -> list[Path]:
        """Writes the MJCF and the files it needs beside it; key frame `home` has the pose.

        Args:
            path: the XML file; meshes go into a folder beside it, `NAME_assets`.

        Returns:
            the files written, the XML first.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        written = [path]
        if self.model.nq and self._root.find("key", "home") is None:
            self._root.keyframe.add("key", name="home", qpos=self.make_data().qpos)
        text = xml_text(self._root)
        folder = path.parent / f"{path.stem}_assets"
        for name, contents in self._root.get_assets().items():
            folder.mkdir(exist_ok=True)
            (folder / name).write_bytes(contents)
            written.append(folder / name)
            text = text.replace(f'file="{name}"', f'file="{folder.name}/{name}"')
        path.write_text(text + "\n", encoding="utf-8")
        return written

    def _id(self, kind: Any, name: str) -> int:
        return int(mujoco.mj_name2id(self.model, kind, name))

    def _find_robots(self) -> dict[str, RobotPart]:
        parts = {}
        start = 0
        obj = mujoco.mjtObj
        for name, robot in self.scene.robots.items():
            bodies = [f"{name}/"] + [f"{name}/link{i + 1}" for i in range(robot.n)]
            ids = np.array([self._id(obj.mjOBJ_BODY, body) for body in bodies])
            joints = [self._id(obj.mjOBJ_JOINT, f"{name}/{joint}") for joint in robot.names]
            parts[name] = RobotPart(
                robot=robot,
                dh=robot.dh,
                qpos=self.model.jnt_qposadr[joints].astype(np.intp),
                dofs=self.model.jnt_dofadr[joints].astype(np.intp),
                mocap=int(self.model.body_mocapid[ids[0]]),
                bodies=ids,
                flange_body=self._id(obj.mjOBJ_BODY, f"{name}/flange"),
                joints=slice(start, start + robot.n),
            )
            start += robot.n
        return parts

    def _measure_without_doubles(self) -> None:
        """Sets the model's extent, which near plane, far plane and shadows scale with.

        Mocap bodies at one place with the robot make MuJoCo 4.0.0 find twice the extent (seen).
        """
        model = self.model
        solid = model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE
        solid &= model.geom_group != DOUBLE_GROUP
        if not solid.any():
            return
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        radius = model.geom_rbound[solid][:, None]
        low = (data.geom_xpos[solid] - radius).min(axis=0)
        high = (data.geom_xpos[solid] + radius).max(axis=0)
        model.stat.center, model.stat.extent = (low + high) / 2, (high - low).max()

    def _find_doubles(self) -> dict[str, DoublePart]:
        parts = {}
        for name, double in self.scene.doubles.items():
            robot = self.robots[double.of]
            bodies = np.array(
                [
                    [self._id(mujoco.mjtObj.mjOBJ_BODY, body) for body in row]
                    for row in body_names(double, robot.robot)
                ]
            )
            mocap = self.model.body_mocapid[bodies].astype(np.intp)
            path = None if double.path is None else double.poses()
            parts[name] = DoublePart(double, robot, mocap, bodies, path)
        return parts


def _compile(root: Any, scene: Scene) -> mujoco.MjModel:
    try:
        return mujoco.MjModel.from_xml_string(xml_text(root), root.get_assets())
    except ValueError as error:
        problems = mesh_problems(scene)
        if not problems:
            problems = [Problem("", f"MuJoCo cannot compile the scene: {error}")]
        raise DeclarationError(scene.located(problems)) from error
