"""Index tables of the robots, doubles, joints, frames and smart arrows of a compiled scene."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools, Ints, frame, rotation_from_quat
from ..declared.cartesian import WORLD, NamedFrame
from ..declared.double import Double
from ..declared.robot import SerialRobot
from ..declared.robot_parts import ARROW_QUANTITIES, VALUE_INPUTS, BillboardLine
from ..declared.scene import Scene
from ..declared.torque_units import TorqueUnit, torque_units
from ..kinematics.joint_tree import JointTree
from .decor_sizes import Sizes

Sites = Callable[[Sequence[str]], Ints]  # function that returns the ids of sites by name

_DOUBLE_ARROW_RGBA_SHARE = 0.55  # opacity of a double's arrows
# Lower bound of the largest torque, so that arrows do not scale with noise. It is a fraction of the
# gravity load of the joint if that is known, or else a value in Nm or N.
_FLOOR_OF_LOAD, _FLOOR = 0.1, 1.0
_DOUBLE_ARROW_SIZE = 0.85  # size of a double's arrows, so that those of the robot remain visible


@dataclass(frozen=True, eq=False)
class RobotPart:
    """The indices of one robot in a compiled model.

    Attributes:
        qpos: indices of the joints in `qpos`, shape (n,).
        dofs: indices of the joints in `qvel`, shape (n,).
        mocap: index of the base in `mocap_pos` and `mocap_quat`; -1 for a mounted or free base.
        bodies: ids of the bodies of the base and the links, shape (n + 1,).
        joints: rows of the robot in the `JointTable` of the world.
        free: indices in `qpos` of the position and quaternion of a free base, shape (7,), or of x,
            y and yaw of a planar base, shape (3,). Empty for a fixed or mounted base.
        sizes: measured sizes of the arrows if `fit_arrows` is true; None for declared sizes.
    """

    robot: SerialRobot
    kinematics: JointTree
    qpos: Ints
    dofs: Ints
    mocap: int
    bodies: Ints
    flange_body: int
    joints: slice
    free: Ints
    sizes: Sizes | None = field(default=None, kw_only=True)

    @property
    def arrow_radii(self) -> Array:
        return self.robot.arrow_radii if self.sizes is None else self.sizes.arrow_radius

    @property
    def arrow_width_scales(self) -> Array:
        """Arrow width per torque, shape (n,), reduced for joints that are close to each other."""
        scales = np.full(self.robot.n, self.robot.arrow_width_scale)
        return scales if self.sizes is None else scales * self.sizes.full_width

    @property
    def arrow_loads(self) -> Array:
        """Torques at which arrows of joints without a limit have full width, shape (n,), Nm or N.

        Values are infinite if `arrow_width_scale` determines the width.
        """
        if self.sizes is None or "arrow_width_scale" in self.robot.model_fields_set:
            return np.full(self.robot.n, np.inf)
        return self.sizes.load / self.sizes.full_width

    @property
    def declared(self) -> SerialRobot:
        return self.robot

    @property
    def scope(self) -> str:
        return f"{self.robot.name}/"

    @property
    def billboard_lines(self) -> list[BillboardLine] | None:
        return self.robot.billboard_lines

    def base_pose(self, qpos: Array) -> Array:
        """Returns the pose T_world_base of a free or planar base, shape (4, 4), in m."""
        at = qpos[self.free]
        if self.robot.free_base != "planar":
            return frame(rotation_from_quat(at[3:]), at[:3])
        return self.robot.planar_base.pose(at)

    @property
    def base_name(self) -> str:
        return f"{self.robot.name}/base"

    @property
    def flange_name(self) -> str:
        return f"{self.robot.name}/flange"

    @property
    def link_names(self) -> list[str]:
        name = self.robot.name
        return [self.base_name] + [f"{name}/link{i + 1}" for i in range(self.robot.n)]

    @property
    def own_link_names(self) -> list[str]:
        """Names of the base and the links in the original robot file, or else `link_names`."""
        own = self.robot.link_names
        return self.link_names if own is None else [f"{self.robot.name}/{link}" for link in own]

    @property
    def chain(self) -> Ints:
        """Indices of the robot's joints that move the flange, starting at the base."""
        return self.robot.flange_joints

    @property
    def reach(self) -> float:
        """Sum of the link lengths of the longest branch in m, or 1 if this sum is zero."""
        table = self.kinematics
        return float(table.path_lengths(table.step_lengths()).max()) or 1.0


@dataclass(frozen=True, eq=False)
class DoublePart:
    """The indices of one double in a compiled model: one row of bodies, or several for a path.

    Attributes:
        mocap: indices in `mocap_pos` of the base and the links, shape (rows, n + 1).
        bodies: ids of the bodies of the base and the links, shape (rows, n + 1).
        frames: indices in `mocap_pos` of the link frames, shape (n,), which are also set for hidden
            links. Empty for a path.
        path: joint angles of the rows of a path, shape (rows, n), rad or m; None for a single pose.
        joints: rows of the double in the `JointTable` of the world. Empty for a path.
        below: name of the double on which this double is mounted, or None. Both belong to the
            double of a group. While the other one has no pose, the base is that of the robot.
    """

    double: Double
    of: RobotPart
    mocap: Ints
    bodies: Ints
    frames: Ints
    path: Array | None
    joints: slice
    below: str | None = None

    @property
    def is_compiled(self) -> bool:
        """Whether the double has bodies in the model. Otherwise, it is drawn as a `DrawnDouble`."""
        return self.bodies.size > 0

    @property
    def declared(self) -> Double:
        return self.double

    @property
    def robot(self) -> SerialRobot:
        return self.of.robot

    @property
    def kinematics(self) -> JointTree:
        return self.of.kinematics

    @property
    def arrow_radii(self) -> Array:
        return self.of.arrow_radii

    @property
    def arrow_width_scales(self) -> Array:
        return self.of.arrow_width_scales

    @property
    def arrow_loads(self) -> Array:
        return self.of.arrow_loads

    @property
    def scope(self) -> str:
        return f"double-{self.double.name}-"

    @property
    def flange_name(self) -> str:
        return f"{self.double.name}/{self.of.flange_name.partition('/')[2]}"

    @property
    def chain(self) -> Ints:
        return self.of.chain

    @property
    def reach(self) -> float:
        return self.of.reach

    @property
    def billboard_lines(self) -> list[BillboardLine] | None:
        return self.double.billboard_lines or self.robot.billboard_lines


Owner = RobotPart | DoublePart


def robots_of_bodies(model: mujoco.MjModel, robots: Mapping[str, RobotPart]) -> Ints:
    """Returns the index of the robot to which each body belongs, shape (nbody,), or -1.

    The bodies of objects that are fixed to a robot have the index of this robot. The bodies of a
    mounted robot have its own index, not that of its carrier.
    """
    owner = np.full(model.nbody, -1, np.intp)
    for number, part in reversed(list(enumerate(robots.values()))):
        owner[[*part.bodies, part.flange_body]] = number
    owner[0] = -1
    for body in np.flatnonzero(owner < 0)[1:]:  # Parents come before their children.
        owner[body] = owner[model.body_parentid[body]]
    return owner


@dataclass(frozen=True, eq=False)
class DrawnDouble:
    """A double that is drawn with the geoms of its robot, but in another state of the model.

    Attributes:
        double: name of the double.
        data: state of the model in the pose of the double, after forward kinematics.
        opacity: opacity factors of the geoms of the model, shape (ngeom,); 0 for hidden geoms.
    """

    double: str
    model: mujoco.MjModel
    data: mujoco.MjData
    opacity: Array
    rgba: Array


@dataclass(frozen=True, eq=False)
class JointTable:
    """Properties of all N joints of a world, first those of robots, then those of doubles.

    All arrays have the shape (N,), unless stated otherwise.

    Attributes:
        owner: index of the robot or double in `owners` of the world.
        limb: number of the limb, unique among all owners.
        of_robot: number of joints of robots. All other joints belong to doubles.
        centre_site: row in `site_xpos` of the center of the arrow and billboard, with z along the
            joint axis.
        qpos: indices in `qpos` of the joints of robots, shape (of_robot,).
        angle_slots: indices in `userdata` of the joint angles of doubles, shape (N - of_robot,).
        slots: for each per-joint input, such as `torques`: indices in `userdata` of the values of
            the joints; -1 for joints whose owner does not have the input.
        has: for each of these inputs and `joint_angles`: indices in `userdata` of the flags that
            values are available, or -1.
        torque_limit: torque limit, Nm or N, infinite for no limit. If `is_largest` is true, this is
            the largest torque so far.
        is_largest: whether `note_largest` updates `torque_limit`.
        torque_units: display units of torques, with the same prefix for all joints of an owner.
        scaled_with: row of the joint whose largest torque scales this arrow: the joint itself, or
            for a joint of a double, the same joint of the robot.
        arrow_quantity: index in `ARROW_QUANTITIES` of the initial quantity of the arrow.
        arrow_load: torque at which the arrow of a joint without a limit has full width, Nm or N,
            infinite if `arrow_width_scale` determines the width.
    """

    names: list[str]
    owner: Ints
    limb: Ints
    of_robot: int
    revolute: Bools
    centre_site: Ints
    qpos: Ints
    angle_slots: Ints
    slots: dict[str, Ints]
    has: dict[str, Ints]
    torque_limit: Array
    is_largest: Bools
    torque_units: list[TorqueUnit]
    scaled_with: Ints
    acceleration_limit: Array
    arrow_quantity: Ints
    arrow_dead_band: Array
    arrow_radius: Array
    arrow_width_scale: Array
    arrow_load: Array
    arrow_alpha: Array

    def angles(self, data: mujoco.MjData) -> Array:
        """Returns the angles of all joints, shape (N,), rad or m, or zero for missing angles."""
        return np.concatenate([data.qpos[self.qpos], data.userdata[self.angle_slots]])

    def note_largest(self, torques: Array, max_factor: float) -> None:
        """Updates `torque_limit` of joints with `is_largest` to larger torques, shape (N,).

        Torques above `max_factor` times the largest torque so far are implausible and ignored.
        """
        limit, size = self.torque_limit, np.abs(torques)
        with np.errstate(invalid="ignore"):
            new = self.is_largest & (size > limit) & (size <= max_factor * limit)
        if new.any():
            np.maximum.at(limit, self.scaled_with[new], size[new])
            limit[self.is_largest] = limit[self.scaled_with[self.is_largest]]


@dataclass(frozen=True, eq=False)
class FrameTable:
    """Properties of all named frames of a world, with one entry per frame.

    Attributes:
        names: names of the frames, for example `lwr/link3`.
        owner: index in `owners` of the robot or double whose axes toggle applies; -1 for a frame
            with its own toggle.
        shown: initial state of the frame's own toggle.
        has: index in `userdata` of the flag that the pose is known; -1 if it is always known.
    """

    names: list[str]
    owner: Ints
    site: Ints
    size: Array
    alpha: Array
    shown: Bools
    has: Ints


@dataclass(frozen=True, eq=False)
class ArrowTable:
    """Properties of all K smart arrows of a world, with one entry per arrow.

    Attributes:
        components_site: site of the frame in which the components are expressed; -1 for the world.
        frames: rows in the `FrameTable` of the frame at which the vector acts and of the frame of
            its components, shape (K, 2); -1 for a point and for the world.
        slots: indices in `userdata` of the components, shape (K, 3).
        has: index in `userdata` of the flag that data was received.
    """

    names: list[str]
    site: Ints
    components_site: Ints
    frames: Ints
    slots: Ints
    has: Ints
    is_round: Bools
    scale: Array
    longest: Array
    radius: Array
    rgba: Array


def make_tables(
    scene: Scene,
    owners: Mapping[str, Owner],
    slots: Mapping[str, slice],
    flags: Mapping[str, int],
    sites: Sites,
) -> tuple[JointTable, FrameTable, ArrowTable]:
    """Returns the tables of joints, named frames and smart arrows of a compiled scene."""
    return (
        _joint_table(owners, slots, flags, sites),
        _frame_table(scene, list(owners), flags, sites),
        _arrow_table(scene, slots, flags, sites),
    )


def _joint_table(
    owners: Mapping[str, Owner],
    slots: Mapping[str, slice],
    flags: Mapping[str, int],
    sites: Sites,
) -> JointTable:
    parts = list(owners.values())
    robots = [part.robot for part in parts]
    counts = [robot.n for robot in robots]

    def gather(values: Iterable[Any], kind: Any = np.float64) -> Any:
        spread = [np.broadcast_to(v, n) for v, n in zip(values, counts, strict=True)]
        return np.concatenate(spread or [np.empty(0)]).astype(kind)

    def limits_of(field: str) -> Any:
        limits = [getattr(robot, field) for robot in robots]
        return gather([np.inf if limit is None else limit for limit in limits])

    def slots_of(key: str) -> list[Any]:
        found = [slots.get(f"{name}.{key}") for name in owners]
        return [-1 if s is None else np.arange(s.start, s.stop) for s in found]

    torque_limit = limits_of("torque_limits")
    arrow_load = gather([part.arrow_loads for part in parts])
    is_largest = gather([robot.scale_by_largest for robot in robots], bool)
    is_largest &= np.isinf(torque_limit)
    expected = np.where(np.isfinite(torque_limit), torque_limit, arrow_load)
    units = [
        unit
        for part in parts
        for unit in torque_units(expected[part.joints], part.kinematics.revolute)
    ]
    floor = np.where(np.isfinite(arrow_load), _FLOOR_OF_LOAD * arrow_load, _FLOOR)
    torque_limit[is_largest] = floor[is_largest]
    limbs, before = [], 0
    for robot in robots:
        found = np.empty(robot.n, np.intp)
        for number, joints in enumerate(robot.limb_joints.values()):
            found[joints] = before + number
        limbs.append(found)
        before += len(robot.limb_joints)
    is_double = [isinstance(part, DoublePart) for part in parts]
    quantities = [part.declared.arrow_quantity or part.robot.arrow_quantity for part in parts]
    keys = list(dict.fromkeys([*VALUE_INPUTS, *(key for robot in robots for key in robot.inputs)]))
    doubled = [
        np.arange(slots[f"{name}.joint_angles"].start, slots[f"{name}.joint_angles"].stop)
        for name, part in owners.items()
        if isinstance(part, DoublePart)
    ]
    qpos = [part.qpos for part in parts if isinstance(part, RobotPart)]
    return JointTable(
        names=[name for robot in robots for name in robot.names],
        owner=gather(range(len(parts)), np.intp),
        limb=gather(limbs, np.intp),
        of_robot=sum(len(q) for q in qpos),
        revolute=gather([part.kinematics.revolute for part in parts], bool),
        centre_site=sites([f"{p.scope}centre{i + 1}" for p in parts for i in range(p.robot.n)]),
        qpos=np.concatenate([*qpos, []]).astype(np.intp),
        angle_slots=np.concatenate([*doubled, []]).astype(np.intp),
        slots={key: gather(slots_of(key), np.intp) for key in keys},
        has={
            key: gather([flags.get(f"{name}.{key}", -1) for name in owners], np.intp)
            for key in ("joint_angles", *keys)
        },
        torque_limit=torque_limit,
        is_largest=is_largest,
        torque_units=units,
        scaled_with=gather(
            [
                (part.of if isinstance(part, DoublePart) else part).joints.start
                + np.arange(part.robot.n)
                for part in parts
            ],
            np.intp,
        ),
        acceleration_limit=limits_of("acceleration_limits"),
        arrow_quantity=gather([ARROW_QUANTITIES.index(q) for q in quantities], np.intp),
        arrow_dead_band=gather([robot.arrow_dead_band for robot in robots]),
        arrow_radius=gather(
            [
                part.arrow_radii * (_DOUBLE_ARROW_SIZE if double else 1.0)
                for part, double in zip(parts, is_double, strict=True)
            ]
        ),
        arrow_width_scale=gather([part.arrow_width_scales for part in parts]),
        arrow_load=arrow_load,
        arrow_alpha=gather(np.where(is_double, _DOUBLE_ARROW_RGBA_SHARE, 1.0)),
    )


def _frame_table(
    scene: Scene, owners: Sequence[str], flags: Mapping[str, int], sites: Sites
) -> FrameTable:
    rows = scene.named_frames().values()

    def flag(row: NamedFrame) -> int:
        if row.moves_with in scene.doubles:
            return flags[f"{row.moves_with}.joint_angles"]
        return flags[f"{row.moves_with}.frame"] if row.moves_with in scene.frames else -1

    return FrameTable(
        names=[row.name for row in rows],
        owner=np.array(
            [owners.index(row.shown_with) if row.shown_with else -1 for row in rows], np.intp
        ),
        site=sites([row.site for row in rows]),
        size=np.array([row.size for row in rows], np.float64),
        alpha=np.array([row.alpha for row in rows], np.float64),
        shown=np.array([row.shown for row in rows], bool),
        has=np.array([flag(row) for row in rows], np.intp),
    )


def _arrow_table(
    scene: Scene, slots: Mapping[str, slice], flags: Mapping[str, int], sites: Sites
) -> ArrowTable:
    arrows = scene.arrows.values()
    frames = scene.named_frames()

    def components(name: str) -> int:
        return -1 if name == WORLD else int(sites([frames[name].site])[0])

    rows = {name: i for i, name in enumerate(frames)} | {WORLD: -1}
    used = [(rows.get(a.at, -1) if a.site is None else -1, rows[a.components_in]) for a in arrows]
    starts = np.array([slots[f"{name}.vector"].start for name in scene.arrows], np.intp)
    return ArrowTable(
        names=list(scene.arrows),
        site=sites([arrow.site or frames[arrow.at].site for arrow in arrows]),
        components_site=np.array([components(arrow.components_in) for arrow in arrows], np.intp),
        frames=np.array(used, np.intp).reshape(-1, 2),
        slots=starts[:, None] + np.arange(3),
        has=np.array([flags[f"{name}.vector"] for name in scene.arrows], np.intp),
        is_round=np.array([arrow.is_round for arrow in arrows], bool),
        scale=np.array([arrow.metres_per_unit for arrow in arrows], np.float64),
        longest=np.array([arrow.limit for arrow in arrows], np.float64),
        radius=np.array([arrow.radius for arrow in arrows], np.float64),
        rgba=np.array([arrow.color for arrow in arrows], np.float64).reshape(-1, 4),
    )
