"""Indices of robots, doubles, joints, frames and smart arrows in a compiled scene."""

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

Sites = Callable[[Sequence[str]], Ints]  # ids of sites by name

_DOUBLE_ARROW_RGBA_SHARE = 0.55  # opacity of a double's arrows
# Lower bound of the largest torque, so that arrows do not scale with noise: a share of the gravity
# load of the joint if that is known, else Nm or N.
_FLOOR_OF_LOAD, _FLOOR = 0.1, 1.0
_DOUBLE_ARROW_SIZE = 0.85  # both arrows are visible where a double coincides with its robot


@dataclass(frozen=True, eq=False)
class RobotPart:
    """Indices of one robot in the compiled model.

    Attributes:
        qpos: index of every joint in `qpos`, (n,).
        dofs: index of every joint in `qvel`, (n,).
        mocap: index of its base in `mocap_pos` and `mocap_quat`; -1 for a mounted or free base.
        bodies: ids of the base and every link, (n + 1,).
        joints: rows of the robot in the `JointTable` of the world.
        free: index in `qpos` of position and quaternion of a free base, (7,), or of x, y and yaw of
            a planar base, (3,); else empty.
        sizes: sizes of the arrows with `fit_arrows`; None for declared sizes.
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
        """`arrow_width_scale` of each joint, (n,), reduced for joints close to each other."""
        scales = np.full(self.robot.n, self.robot.arrow_width_scale)
        return scales if self.sizes is None else scales * self.sizes.full_width

    @property
    def arrow_loads(self) -> Array:
        """Efforts at which arrows without limit reach their full width, (n,), Nm or N.

        Infinite if `arrow_width_scale` sets the width.
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
        """Returns T_world_base (4, 4) of a free or planar base, translation in m."""
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
        """Names of base and links in the file of the robot, or `link_names`."""
        own = self.robot.link_names
        return self.link_names if own is None else [f"{self.robot.name}/{link}" for link in own]

    @property
    def chain(self) -> Ints:
        """Indices of its joints that move the flange, in order from the base."""
        return self.robot.flange_joints

    @property
    def reach(self) -> float:
        """Sum of the link lengths of the longest branch, m; 1 if it is zero."""
        table = self.kinematics
        return float(table.path_lengths(table.step_lengths()).max()) or 1.0


@dataclass(frozen=True, eq=False)
class DoublePart:
    """Indices of one double in the compiled model.

    Attributes:
        mocap: index in `mocap_pos` of the base and every link, (rows, n + 1); a path has several
            rows.
        bodies: ids of base and links, (rows, n + 1).
        frames: index in `mocap_pos` of the frame of every link, (n,), which is also set for hidden
            links; empty for a path.
        path: joint angles of every row, (rows, n); None for a single double.
        joints: rows of the double in the `JointTable` of the world; empty for a path.
        below: the double of the carrier of its robot, if both belong to one group; this double is
            mounted on it while it has a pose.
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
        """Whether the model contains its bodies; otherwise decor draws it."""
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
    """Returns the index of the robot of every body, (nbody,), or -1.

    A robot includes objects fixed to it, but not robots mounted on it.
    """
    owner = np.full(model.nbody, -1, np.intp)
    for number, part in reversed(list(enumerate(robots.values()))):
        owner[[*part.bodies, part.flange_body]] = number
    owner[0] = -1
    for body in np.flatnonzero(owner < 0)[1:]:  # parents come before their children
        owner[body] = owner[model.body_parentid[body]]
    return owner


@dataclass(frozen=True, eq=False)
class DrawnDouble:
    """A double drawn from another state of the same model.

    Attributes:
        data: the other state, after forward kinematics.
        opacity: factor for every geom of the model, (ngeom,); 0 for hidden geoms.
    """

    double: str
    model: mujoco.MjModel
    data: mujoco.MjData
    opacity: Array
    rgba: Array


@dataclass(frozen=True, eq=False)
class JointTable:
    """Arrays over all N joints: those of the robots, then those of their doubles.

    Attributes:
        owner: index in the world's `owners`.
        limb: number of its limb, unique among all owners.
        of_robot: number of joints of robots; the others belong to doubles.
        centre_site: site at the center of its arrow and billboard, z along the joint axis; a
            row of `site_xpos` of the result of `World.state`.
        qpos: index in `qpos` of the joints of robots, (of_robot,).
        angle_slots: index in `userdata` of the joint angles of doubles, (N - of_robot,).
        slots: for each per-joint input, index in `userdata` of its value; -1 if the owner of the
            joint does not have the input.
        has: index in `userdata` of the flags of these inputs and of `joint_angles`; -1 as above.
        torque_limit: Nm or N, infinite for no limit. If `is_largest`, the largest torque so far.
        is_largest: whether `note_largest` updates `torque_limit`, (N,).
        torque_units: display units of torques, N; one prefix for all joints of an owner.
        scaled_with: index of the joint with the shared largest torque, (N,): for joints of doubles,
            that of their robot.
        arrow_quantity: index in `ARROW_QUANTITIES` of the quantity that its arrow initially
            shows.
        arrow_load: Nm or N at which the arrow of a joint without limit reaches its full width;
            infinite if `arrow_width_scale` sets the width.
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
        """Returns the angles of all joints, (N,), rad or m; zero for doubles without angles."""
        return np.concatenate([data.qpos[self.qpos], data.userdata[self.angle_slots]])

    def note_largest(self, torques: Array, max_factor: float) -> None:
        """Raises `torque_limit` of joints with `is_largest` to larger torques, (N,).

        Torques above `max_factor` times the limit so far are implausible and ignored.
        """
        limit, size = self.torque_limit, np.abs(torques)
        with np.errstate(invalid="ignore"):
            new = self.is_largest & (size > limit) & (size <= max_factor * limit)
        if new.any():
            np.maximum.at(limit, self.scaled_with[new], size[new])
            limit[self.is_largest] = limit[self.scaled_with[self.is_largest]]


@dataclass(frozen=True, eq=False)
class FrameTable:
    """Arrays over all M named frames.

    Attributes:
        names: e.g. `lwr/link3`, M.
        owner: index in the world's `owners` of the robot or double whose axes toggle applies; -1
            for a frame with its own toggle.
        shown: initial state of its own toggle.
        has: index in `userdata` of the flag that its pose is known; -1 if it is always known.
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
    """Arrays over all K smart arrows.

    Attributes:
        components_site: site of the frame of its components; -1 for the world.
        frames: rows in the `FrameTable` of the frame at which it acts and of the frame of its
            components, (K, 2); -1 for a point and for the world.
        slots: indices in `userdata` of its components, (K, 3).
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
