"""`World`: a compiled scene with index tables of its robots, doubles, frames and inputs.

Displayed values without a field in `MjData` are stored in named slots of `MjData.userdata`, which
is part of copies, history and recordings. `mj_resetData` sets these values to zero.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from ...base.errors import DeclarationError, Problem, collect, mismatch
from ...base.frames import Bools, Ints
from ..declared.double import DOUBLE_GROUP, OUT_OF_SIGHT
from ..declared.inputs import BLANKABLE, list_inputs, to_array, to_frame, userdata_slots
from ..declared.mounts import carrier
from ..declared.robot import SerialRobot
from ..declared.robot_parts import VALUE_INPUTS
from ..declared.scene import Scene
from ..importers.mjcf_file import write_mjcf
from .decor_sizes import MeasuredBodies, measure
from .mjcf import body_names, build_spec, frame_names, moved_body
from .mjcf_dynamics import set_contact_defaults, set_inertia, weighed_model
from .mjcf_elements import Hull, mesh_assets
from .parts import DoublePart, DrawnDouble, RobotPart, make_tables
from .robot_dynamics import RobotDynamics, about_masses, robot_dynamics
from .solids import lowest_height
from .world_view import SET_BY_PROGRAM, SET_BY_SOURCE, WorldView

log = logging.getLogger(__name__)

_IMPLAUSIBLE_REACH = 20.0  # longer than the reach of any robot arm, m
_ON_FLOOR = 1e-6  # maximum rounding error of the height, m


class World(WorldView):
    """A compiled scene for display or simulation.

    Args:
        dynamic: whether the model is for simulation instead of display only.
        dynamics: dynamics of the robots by name, for simulation (default: as declared).

    Attributes:
        free_objects: indices in `qpos` of the position and quaternion (scalar first) of each free
            object, shape (7,), by name. Empty if `dynamic` is false.
        dynamics: dynamics of the robots by name. Empty if `dynamic` is false.

    Raises:
        DeclarationError: MuJoCo cannot compile the scene.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        dynamic: bool = False,
        dynamics: Mapping[str, RobotDynamics] | None = None,
    ) -> None:
        self.scene = scene
        self.dynamic = dynamic
        problems = scene.problems()  # Entries may have been added since the last check.
        if problems:
            raise DeclarationError(scene.located(problems))
        _warn_of_lengths(scene)
        self.inputs = list_inputs(scene)
        self.slots, self.flags, count = userdata_slots(scene)
        known = dynamics_of(scene) if dynamic and dynamics is None else dynamics
        self.dynamics = dict(known or {})
        root = build_spec(scene, self.dynamics if dynamic else None)
        root.nuserdata = count
        self._spec = root
        self.model = _compile(root, scene)
        if dynamic:
            set_contact_defaults(self.model)
            # Instability is reported instead of resetting the simulation.
            self.model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        if scene.doubles:
            self._measure_without_doubles()
            # Doubles cast no shadows, because a shadow map takes as long as the image.
            self.model.geom_castshadow[self.model.geom_group == DOUBLE_GROUP] = 0
        self.robots = self._find_robots()
        self._measure_arrows()
        if scene.floor == "below":
            self._lower_floor()
        free = [item.name for item in scene.objects if dynamic and item.is_free]
        bodies = map(self._free, self._bodies([moved_body(name) for name in free]))
        self.free_objects = dict(zip(free, bodies, strict=True))
        self.doubles = self._find_doubles()
        single = {name: part for name, part in self.doubles.items() if part.path is None}
        self.owners = {**self.robots, **single}
        self.joints, self.frames, self.arrows = make_tables(
            scene, self.owners, self.slots, self.flags, self._sites
        )
        standing = {name: part for name, part in self.robots.items() if part.mocap >= 0}
        self.placed = {name: part.mocap for name, part in standing.items()}
        for name in [*scene.frames, *(item.name for item in scene.objects), *scene.cameras]:
            body = f"frame-{name}" if name in scene.frames else moved_body(name)
            (index,) = self._bodies([body])
            if index >= 0:
                self.placed[name] = int(self.model.body_mocapid[index])

    def make_data(self) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        self.reset(data)
        return data

    def physics_model(self) -> mujoco.MjModel:
        """Returns a model without visual geometry, which is faster to simulate.

        It has the same bodies, joints and sites as `model`, and moves in exactly the same way.
        """
        spec, model = self._spec.copy(), self.model
        touching = (model.geom_contype | model.geom_conaffinity) > 0
        for geom, touches in zip(spec.geoms, touching.tolist(), strict=True):
            if not touches:
                spec.delete(geom)
        bare = spec.compile()
        bare.opt.disableflags = model.opt.disableflags
        if len(set(bare.dof_treeid.tolist())) <= 1:  # Islands need at least two trees.
            bare.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_ISLAND)
        bare.opt.timestep, bare.opt.gravity = model.opt.timestep, model.opt.gravity
        # These values may have changed after compilation.
        for name in dir(model):
            kind = name.partition("_")[0]
            if kind not in ("dof", "jnt", "eq", "geom") and name not in _MASSES:
                continue
            values = getattr(model, name)
            if name not in _PLACES and isinstance(values, np.ndarray) and values.size:
                getattr(bare, name)[:] = values[touching] if kind == "geom" else values
        return bare

    def state(self, data: mujoco.MjData) -> Any:
        return data

    def drawn_doubles(self, state: Any, shown: Bools) -> list[DrawnDouble]:
        return []

    def geoms_in_view(self) -> Bools:
        return np.asarray(self.model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE)

    def reset(self, data: mujoco.MjData) -> None:
        """Sets declared values in a state of `model` or of a `physics_model`."""
        mujoco.mj_resetData(data.model, data)
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
        if self.owners:  # Declared values do not count as set by a program.
            flags = [*self.flags.values()]
            data.userdata[flags] = np.minimum(data.userdata[flags], SET_BY_SOURCE)
        mujoco.mj_forward(data.model, data)

    def set_input(self, data: mujoco.MjData, target: str, values: Any) -> None:
        """Sets an input of the scene. Call `data.drive.place` afterwards to move the frames.

        Args:
            target: name of the input, for example `lwr.joint_angles`. If it is an input of a group,
                the values are distributed to the robots of the group.
            values: array of shape (n,) or (3,), frame of shape (4, 4), or one number. In inputs
                that are only displayed, NaN and numbers beyond `Input.limits` mean no data.

        Raises:
            UnknownName: the robot, group or input does not exist.
            ValueError: the number of values is wrong, a frame is invalid, or an input that moves
                something contains NaN or a number beyond `Input.limits`.
        """
        if target not in self.inputs and target not in (shares := self.shares(target, values)):
            for each, share in shares.items():
                self.set_input(data, each, share)
            return
        item = self.resolve_input(target)
        array = to_array(item, values)
        finite = np.isfinite(array)
        is_finite = finite.all()
        if array.shape != item.shape or not (is_finite or item.kind in BLANKABLE):
            found = array.tolist() if array.size else values
            many = item.meaning if item.count == 1 else f"{item.count} finite numbers"
            raise Problem(target, f"found {found}", expected=many).error()
        beyond = finite & (np.abs(array) > item.limits)
        if beyond.any() and (item.kind not in BLANKABLE or item.shape == (4, 4)):
            found = array[beyond].flat[0]
            limit = item.limits[beyond].flat[0]
            raise mismatch(found, f"at most {limit:g} in magnitude", key=target)
        array = np.where(finite & ~beyond, array, np.nan)
        if item.shape == (4, 4):
            array = to_frame(target, array)
        userdata = data.userdata
        if item.kind == "pose":
            self.set_pose(data, item.name, array)
        elif item.kind == "angles" and item.name in self.robots:
            data.qpos[self.robots[item.name].qpos] = array
        else:
            userdata[self.slots[target]] = array.ravel()
        userdata[self.flags[target]] = SET_BY_PROGRAM

    def export(self, path: Path) -> list[Path]:
        """Writes the scene as MJCF, and its meshes to the folder `NAME_assets`.

        The keyframe `home` is the declared pose. Masses are those of the simulation, and a comment
        lists the masses of the robots. Returns the paths of all written files.
        """
        spec, about = self._weighed()
        if self.model.nq and spec.key("home") is None:
            spec.add_key(name="home", qpos=self.make_data().qpos)
        return write_mjcf(spec, path, about)

    def _weighed(self) -> tuple[mujoco.MjSpec, str]:
        known = self.dynamics or dynamics_of(self.scene)
        spec, lines = self._spec.copy(), []
        for name, of in known.items():
            bodies = [f"{name}/", *(f"{name}/link{i}" for i in range(1, len(of.masses)))]
            for i, body in enumerate(bodies):
                set_inertia(spec.body(body), of, i)
            lines.append(f"{name}: {about_masses(self.scene.robots[name], of)}")
        text = "\n    ".join(lines).replace("--", "- -")
        return spec, f"  <!-- Masses, as in simulation:\n    {text} -->\n" if lines else ""

    def weighed(self) -> mujoco.MjModel:
        """Returns `model` for a simulated world, or else a copy with the masses of the robots."""
        if self.dynamic:
            return self.model
        return weighed_model(self.model, self.robots, dynamics_of(self.scene))

    def _ids(self, kind: Any, names: Iterable[str]) -> Ints:
        return np.array([mujoco.mj_name2id(self.model, kind, name) for name in names], np.intp)

    def _sites(self, names: Iterable[str]) -> Ints:
        return self._ids(mujoco.mjtObj.mjOBJ_SITE, names)

    def _bodies(self, names: Iterable[str]) -> Ints:
        return self._ids(mujoco.mjtObj.mjOBJ_BODY, names)

    def _find_robots(self) -> dict[str, RobotPart]:
        parts = {}
        start = 0
        for name, robot in self.scene.robots.items():
            links = [f"{name}/link{i + 1}" for i in range(robot.n)]
            *bodies, flange = self._bodies([f"{name}/", *links, f"{name}/flange"])
            joints = self._ids(
                mujoco.mjtObj.mjOBJ_JOINT, [f"{name}/{joint}" for joint in robot.names]
            )
            parts[name] = RobotPart(
                robot=robot,
                kinematics=robot.kinematics,
                qpos=self.model.jnt_qposadr[joints].astype(np.intp),
                dofs=self.model.jnt_dofadr[joints].astype(np.intp),
                mocap=int(self.model.body_mocapid[bodies[0]]),
                bodies=np.array(bodies),
                flange_body=int(flange),
                joints=slice(start, start + robot.n),
                free=self._free(bodies[0]),
            )
            start += robot.n
        return parts

    def _lower_floor(self) -> None:
        data, visible = self._at_home(), np.flatnonzero(self.geoms_in_view())
        low = lowest_height(self.model, data, visible) if len(visible) else 0.0
        floor = self.model.geom("floor").id
        if low > -_ON_FLOOR:
            return
        self.model.geom_pos[floor, 2] = self._spec.geom("floor").pos[2] = low
        self.model.geom_sameframe[floor] = int(mujoco.mjtSameFrame.mjSAMEFRAME_NONE)

    def _at_home(self) -> mujoco.MjData:
        data = mujoco.MjData(self.model)
        for part in self.robots.values():
            data.qpos[part.qpos] = part.robot.home
        mujoco.mj_fwdPosition(self.model, data)
        return data

    def _measure_arrows(self) -> None:
        fitted = {n: part for n, part in self.robots.items() if part.robot.fit_arrows}
        data = self._at_home() if fitted else None
        for name, part in fitted.items():
            joints = self.model.dof_jntid[part.dofs].astype(np.intp)
            bodies = np.array(sorted({*part.bodies.tolist(), part.flange_body}), np.intp)
            names = [f"{part.scope}centre{i + 1}" for i in range(part.robot.n)]
            centres = np.array([self.model.site(each).id for each in names], np.intp)
            measured = MeasuredBodies(bodies, joints, np.zeros(0, np.intp), centres)
            self.robots[name] = replace(part, sizes=measure(self.model, data, measured))

    def _free(self, base: int) -> Ints:
        joint, count = self.model.body_jntadr[base], int(self.model.body_jntnum[base])
        if joint < 0:
            return np.zeros(0, np.intp)
        if self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE:
            count = 7
        return np.arange(count, dtype=np.intp) + int(self.model.jnt_qposadr[joint])

    def _measure_without_doubles(self) -> None:
        # If mocap bodies coincide with the robot, the extent in MuJoCo 4.0.0 is twice as large. The
        # extent scales near plane, far plane and shadows.
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
            bodies = np.stack([self._bodies(row) for row in body_names(double, robot.robot)])
            frames = self._bodies(frame_names(double, robot.robot))
            parts[name] = DoublePart(
                double=double,
                of=robot,
                mocap=self.model.body_mocapid[bodies].astype(np.intp),
                bodies=bodies,
                frames=self.model.body_mocapid[frames].astype(np.intp),
                path=None
                if double.path is None
                else robot.robot.coupled.full("joint_angles", double.poses()),
                joints=slice(start, start + len(frames)),
                below=self._double_below(name),
            )
            start += len(frames)
        return parts

    def _double_below(self, name: str) -> str | None:
        doubles = self.scene.doubles
        below = carrier(self.scene.robots[doubles[name].of])
        beside = next((g for g in self.scene.double_groups.values() if name in g), [])
        return next((other for other in beside if doubles[other].of == below), None)


def _warn_of_lengths(scene: Scene) -> None:
    for name, robot in scene.robots.items():
        if robot.reach > _IMPLAUSIBLE_REACH:
            log.warning(
                "robot '%s' reaches %.4g m. Are lengths in mm? Set length_unit = \"mm\" for a DH "
                "table in mm",
                name,
                robot.reach,
            )


def dynamics_of(scene: Scene) -> dict[str, RobotDynamics]:
    """Returns the dynamics of all robots of a scene. Raises DeclarationError with all errors."""
    found: dict[str, RobotDynamics] = {}
    problems: list[Problem] = []
    for name, robot in scene.robots.items():
        try:
            with collect(problems, f"robots.{name}"):
                found[name] = robot_dynamics(robot)
        except ValueError as error:  # MuJoCo cannot compute the hull of a mesh.
            raise _not_compiled(scene, error) from error
    if problems:
        raise DeclarationError(scene.located(problems))
    return found


def world_without_meshes(robots: Iterable[SerialRobot]) -> World:
    """Returns a world for simulation without meshes, but with the masses computed from them.

    Such a world compiles much faster. Raises DeclarationError if MuJoCo cannot compile it.
    """
    scene = Scene(robots=list(robots), floor=False)
    bare = [
        robot.model_copy(update={"filenames": [], "collisions": []})
        for robot in scene.robots.values()
    ]
    known = dynamics_of(scene)
    return World(Scene(robots=bare, floor=False), dynamic=True, dynamics=known)


# Fields of `MjModel` that contain masses of bodies, and indices of other elements.
_MASSES = (
    "body_mass", "body_subtreemass", "body_inertia", "body_ipos", "body_iquat", "body_sameframe",
    "body_invweight0",
)  # fmt: skip
_PLACES = ("geom_bodyid", "geom_dataid", "geom_matid", "geom_plugin")


def _compile(spec: mujoco.MjSpec, scene: Scene) -> mujoco.MjModel:
    try:
        return spec.compile()
    except (ValueError, mujoco.FatalError) as error:
        raise _not_compiled(scene, error) from error


def _not_compiled(scene: Scene, error: ValueError) -> DeclarationError:
    problems = _mesh_problems(scene)
    if not problems:
        problems = [Problem("", f"MuJoCo cannot compile the scene: {error}")]
    return DeclarationError(scene.located(problems))


def _mesh_problems(scene: Scene) -> list[Problem]:
    found = [_mesh_problem(key, file) for key, file in scene.meshes()]
    return [problem for problem in found if problem is not None]


def _mesh_problem(key: str, path: Path) -> Problem | None:
    solid = "filenames" not in key  # Visual geometry may be flat.
    hull: Hull = "always" if solid else "unless flat"
    root = mujoco.MjSpec()
    try:
        for mesh, _ in mesh_assets(root, "mesh", path, 1.0, hull=hull):
            kind = mujoco.mjtGeom.mjGEOM_MESH
            root.worldbody.add_geom(type=kind, meshname=mesh, contype=solid, conaffinity=solid)
        root.compile()
    except (ValueError, OSError) as error:
        reason = str(error).splitlines()[0].removeprefix("Error: ")
        return Problem(key, f"MuJoCo cannot read the mesh {path}: {reason}")
    return None
