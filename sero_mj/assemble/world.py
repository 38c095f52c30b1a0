"""`World`: a compiled scene, with the ids and slots that the other layers read by array.

What decor shows and `MjData` has no field for (received torques, billboard values, the state of
sources) lives in named slots of `MjData.userdata`. It is part of MuJoCo's integration state, so
copies, history and recordings carry it. `mj_resetData` zeroes it: apply the latest packet again.
"""

from __future__ import annotations

import ctypes
import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from ..declaration import numbers
from ..errors import DeclarationError, Problem
from ..frames import frame_from
from .frame_table import arrow_table, frame_table
from .inputs import BLANKABLE, list_inputs, userdata_slots
from .joint_table import joint_table, site_ids
from .mesh_check import mesh_problems
from .mjcf import build_spec, moved_body
from .mjcf_double import DOUBLE_GROUP, OUT_OF_SIGHT, body_names, frame_names
from .mjcf_dynamics import smooth
from .parts import DoublePart, Ghost, RobotPart
from .robot_dynamics import RobotDynamics, robot_dynamics
from .robot_parts import VALUE_INPUTS
from .scene import Scene
from .world_view import WorldView

log = logging.getLogger(__name__)

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
_IMPLAUSIBLE_REACH = 20.0  # m; no robot arm is so long, and a picture of one shows a floor


class World(WorldView):
    """A compiled scene.

    Args:
        scene: what to compile.
        dynamic: whether it is to be simulated: links have masses and collide, joints have
            friction and may be elastic (see `assemble.mjcf_dynamics`).

    Attributes:
        dynamic: whether it is to be simulated.
        dynamics: what every robot's equations of motion are made of, by name; where `dynamic`.

    The others are those of `WorldView`.

    Raises:
        DeclarationError: files or values that MuJoCo cannot compile, by robot and file.
    """

    def __init__(self, scene: Scene, *, dynamic: bool = False) -> None:
        self.scene = scene
        self.dynamic = dynamic
        problems = scene.problems()  # also of what was added since the scene was made
        if problems:
            raise DeclarationError(scene.located(problems))
        _warn_of_lengths(scene)
        self.inputs = list_inputs(scene)
        self.slots, self.flags = userdata_slots(scene)
        self.dynamics = _dynamics(scene) if dynamic else {}
        root = build_spec(scene, self.dynamics if dynamic else None)
        root.nuserdata = len(self.flags) + sum(
            slot.stop - slot.start for slot in self.slots.values()
        )
        self._spec = root
        self.model = _compile(root, scene)
        if dynamic:
            smooth(self.model)
            # Report instability instead of resetting.
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if scene.doubles:
            self._measure_without_doubles()
            # What is not there throws no shadow, and the shadow map costs as much as the picture.
            self.model.geom_castshadow[self.model.geom_group == DOUBLE_GROUP] = 0
        self.robots = self._find_robots()
        self.doubles = self._find_doubles()
        single = {name: part for name, part in self.doubles.items() if part.path is None}
        self.owners = {**self.robots, **single}
        sites = partial(site_ids, self.model)
        self.joints = joint_table(self.owners, self.slots, self.flags, sites)
        self.frames = frame_table(scene, list(self.owners), self.flags, sites)
        self.arrows = arrow_table(scene, self.slots, self.flags, sites)
        self.placed = {name: part.mocap for name, part in self.robots.items()}
        for name in [*scene.frames, *(item.name for item in scene.objects), *scene.cameras]:
            body = f"frame-{name}" if name in scene.frames else moved_body(name)
            index = self._id(mujoco.mjtObj.mjOBJ_BODY, body)
            if index >= 0:
                self.placed[name] = int(self.model.body_mocapid[index])

    def make_data(self) -> mujoco.MjData:
        """Returns a new `MjData` with every robot at its declared joint angles."""
        data = mujoco.MjData(self.model)
        self.reset(data)
        return data

    def state(self, data: mujoco.MjData) -> Any:
        """What decor reads of `data`: `data` itself, which has a site for all that it needs."""
        return data

    def drawn_doubles(self, state: Any, shown: NDArray[np.bool_]) -> list[Ghost]:
        """None: they are compiled in."""
        return []

    def geoms_in_view(self) -> NDArray[np.bool_]:
        """All but the floor, (ngeom,)."""
        return np.asarray(self.model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)

    def reset(self, data: mujoco.MjData) -> None:
        """Puts every robot at its declared joint angles and shows what the scene declares."""
        mujoco.mj_resetData(self.model, data)
        for part in self.robots.values():
            data.qpos[part.qpos] = part.robot.home
            self.set_declared(data, part.robot, VALUE_INPUTS)
        for double in self.doubles.values():
            data.mocap_pos[double.mocap] = data.mocap_pos[double.frames] = OUT_OF_SIGHT
            if double.path is None:
                self.set_declared(data, double.double, ("joint_angles", *VALUE_INPUTS))
        for arrow in self.scene.arrows.values():
            self.set_declared(data, arrow, ("vector",))
        for name, frame in self.scene.frames.items():
            data.mocap_pos[self.placed[name]] = OUT_OF_SIGHT
            self.set_declared(data, frame, ("frame",))
        mujoco.mj_forward(self.model, data)

    def set_input(self, data: mujoco.MjData, target: str, values: Any) -> None:
        """Sets an input; call `drive.place` afterwards to move the frames.

        Args:
            data: what to change.
            target: `name.input`, e.g. `lwr.joint_angles`; see `inputs`.
            values: (n,), (3,), a frame (4, 4), or one number, SI units; NaN is no data.

        Raises:
            UnknownName: no such name or input.
            ValueError: not as many numbers as it takes, NaN where it would move, or no frame.
        """
        item = self.resolve_input(target)
        try:
            array = np.atleast_1d(np.asarray(values, dtype=np.float64))
        except (TypeError, ValueError):
            array = np.empty(0)
        is_fit = np.isfinite(array).all() or item.kind in BLANKABLE
        if array.shape != item.shape or not is_fit:
            found = array.tolist() if array.size else values
            many = "1 finite number" if item.count == 1 else f"{item.count} finite numbers"
            raise ValueError(f"{target}: found {found}; expected {many}")
        if item.shape == (4, 4):
            try:
                array = frame_from(array, numbers)
            except ValueError as error:
                raise ValueError(f"{target}: {error}") from None
        if item.kind == "pose":
            self.set_pose(data, item.name, array)
        elif item.kind == "angles" and item.name in self.robots:
            data.qpos[self.robots[item.name].qpos] = array
        else:
            data.userdata[self.slots[target]] = np.where(np.isfinite(array), array, np.nan).ravel()
        data.userdata[self.flags[target]] = 1.0

    def export(self, path: Path) -> list[Path]:
        """Writes the MJCF and the files it needs beside it; key frame `home` has the pose.

        Args:
            path: the XML file; meshes go into a folder beside it, `NAME_assets`.

        Returns:
            the files written, the XML first.
        """
        path.parent.mkdir(parents=True, exist_ok=True)
        written, folder = [path], path.parent / f"{path.stem}_assets"
        if self.model.nq and self._spec.key("home") is None:
            self._spec.add_key(name="home", qpos=self.make_data().qpos)
        with _all_digits():
            text = self._spec.to_xml()
        for name, contents in self._spec.assets.items():
            file = folder / name.rpartition("/")[2]
            if f'file="{name}"' not in text:
                continue  # nothing in the scene needs it
            folder.mkdir(exist_ok=True)
            file.write_bytes(contents)
            written.append(file)
            text = text.replace(f'file="{name}"', f'file="{folder.name}/{file.name}"')
        path.write_text(text, encoding="utf-8")
        return list(dict.fromkeys(written))

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
        start = sum(part.robot.n for part in self.robots.values())
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
            frames = [
                int(self.model.body_mocapid[self._id(mujoco.mjtObj.mjOBJ_BODY, frame)])
                for frame in frame_names(double, robot.robot)
            ]
            stop = start + len(frames)
            parts[name] = DoublePart(
                double, robot, mocap, bodies, np.array(frames, np.intp), path, slice(start, stop)
            )
            start = stop
        return parts


def _warn_of_lengths(scene: Scene) -> None:
    """Says which robots are so large that their lengths are in mm, or meant to be."""
    for name, robot in scene.robots.items():
        if robot.reach > _IMPLAUSIBLE_REACH:
            log.warning(
                "robot '%s' reaches %.4g m; lengths are in m, and length_unit = \"mm\" is for a DH "
                "table in mm",
                name,
                robot.reach,
            )


def _dynamics(scene: Scene) -> dict[str, RobotDynamics]:
    found, problems = {}, []
    for name, robot in scene.robots.items():
        try:
            found[name] = robot_dynamics(robot)
        except DeclarationError as error:
            problems += [problem.inside(f"robots.{name}") for problem in error.problems]
        except ValueError as error:  # by MuJoCo, from the hull of a mesh
            raise _not_compiled(scene, error) from error
    if problems:
        raise DeclarationError(scene.located(problems))
    return found


def _compile(spec: mujoco.MjSpec, scene: Scene) -> mujoco.MjModel:
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise _not_compiled(scene, error) from error


@contextmanager
def _all_digits() -> Iterator[None]:
    """Has MuJoCo write numbers as they are; on its own it writes six digits of them.

    MuJoCo 4.0.0 has no public call for it. Where a later one lacks this, six digits it is.
    """
    folder = Path(mujoco.__file__).parent
    files = (file for name in _LIBRARY_NAMES for file in folder.glob(name))
    library = ctypes.CDLL(str(next(files)))
    set_digits = getattr(library, "_mjPRIVATE__set_xml_precision", lambda digits: None)
    set_digits(17)
    try:
        yield
    finally:
        set_digits(6)


_LIBRARY_NAMES = ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll")  # Linux, macOS, Windows


def _not_compiled(scene: Scene, error: ValueError) -> DeclarationError:
    problems = mesh_problems(scene)
    if not problems:
        problems = [Problem("", f"MuJoCo cannot compile the scene: {error}")]
    return DeclarationError(scene.located(problems))
