"""Where a compiled scene's joints and frames are, as arrays that decor and routes index with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import mujoco
import numpy as np
from numpy.typing import NDArray

from .dh import DhTable
from .double import Double
from .robot import SerialRobot
from .robot_parts import ArrowQuantity
from .scene import Scene

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

# Per-joint inputs that are kept in userdata, and the flags that say whether data came.
VALUE_INPUTS = ("torques", "commanded_torques", "joint_accelerations", "billboard_values")
INPUTS = ("joint_angles", *VALUE_INPUTS)
DOUBLE_INPUTS = ("joint_angles",)
ARROW_QUANTITIES: tuple[str, ...] = get_args(ArrowQuantity)
# What a source's slot holds.
SOURCE_FIELDS = (
    "received",
    "malformed",
    "dropped",
    "age",  # s since the last good packet, -1 when there was none
    "wrong_size",  # of the malformed
    "last_size",  # bytes of the last packet of a wrong size
    "size",  # bytes of a right one
    "fault_age",  # s since the last malformed packet, -1 when there was none
)


@dataclass(frozen=True, eq=False)
class RobotPart:
    """Where one robot is in the model.

    Attributes:
        robot: its declaration.
        dh: its table, built once.
        qpos: index of every joint in `qpos`, (n,).
        dofs: index of every joint in `qvel`, (n,).
        mocap: its base's index in `mocap_pos` and `mocap_quat`.
        bodies: ids of the base and every link, (n + 1,).
        flange_body: id of the flange.
        joints: its rows in the world's `JointTable`.
    """

    robot: SerialRobot
    dh: DhTable
    qpos: Ints
    dofs: Ints
    mocap: int
    bodies: Ints
    flange_body: int
    joints: slice


@dataclass(frozen=True, eq=False)
class DoublePart:
    """Where one double is in the model.

    Attributes:
        double: its declaration.
        robot: the robot it doubles.
        mocap: index in `mocap_pos` of the base and every link, (rows, n + 1); a path has rows.
        bodies: their ids, (rows, n + 1).
        path: joint angles of every row, (rows, n); None for a single double.
    """

    double: Double
    robot: RobotPart
    mocap: Ints
    bodies: Ints
    path: Array | None


@dataclass(frozen=True, eq=False)
class JointTable:
    """All joints of all robots, as arrays over N joints.

    Attributes:
        names: joint names, N.
        robot: index of the joint's robot.
        revolute: whether it turns.
        centre_site: site whose z is the joint's axis, where its arrow and billboard stand.
        qpos: index in `qpos`.
        slots: for each of `VALUE_INPUTS`, index in `userdata` of its value.
        has: for each of `INPUTS`, index in `userdata` of the flag that data came.
        torque_limit: Nm or N, inf where there is none.
        acceleration_limit: rad/s2 or m/s2, inf where there is none.
        arrow_quantity: index in `ARROW_QUANTITIES` of what its arrow shows at first.
        arrow_dead_band: share of the limit.
        arrow_radius: m.
        arrow_width_scale: m per Nm.
    """

    names: list[str]
    robot: Ints
    revolute: NDArray[np.bool_]
    centre_site: Ints
    qpos: Ints
    slots: dict[str, Ints]
    has: dict[str, Ints]
    torque_limit: Array
    acceleration_limit: Array
    arrow_quantity: Ints
    arrow_dead_band: Array
    arrow_radius: Array
    arrow_width_scale: Array


@dataclass(frozen=True, eq=False)
class FrameTable:
    """All frames that can show coordinate axes.

    Attributes:
        names: e.g. `lwr/link3`, M.
        robot: index of the frame's robot, -1 for a frame that is always shown.
        site: its site.
        size: length of the axes, m.
        alpha: 0 invisible to 1 opaque.
    """

    names: list[str]
    robot: Ints
    site: Ints
    size: Array
    alpha: Array


def userdata_slots(scene: Scene) -> dict[str, slice]:
    """Gives every robot and source its slots in userdata, e.g. `lwr.torques`, `sources.udp`."""
    lengths: dict[str, int] = {}
    for name, robot in scene.robots.items():
        lengths |= {f"{name}.{key}": robot.n for key in VALUE_INPUTS}
        lengths[f"{name}.has"] = len(INPUTS)
    for name, double in scene.doubles.items():
        n = scene.robots[double.of].n
        lengths |= {f"{name}.joint_angles": n, f"{name}.has": 1}
    lengths |= {f"sources.{name}": len(SOURCE_FIELDS) for name in scene.sources}
    slots = {}
    start = 0
    for key, length in lengths.items():
        slots[key] = slice(start, start + length)
        start += length
    return slots


def joint_table(
    model: mujoco.MjModel, parts: Mapping[str, RobotPart], slots: Mapping[str, slice]
) -> JointTable:
    """Lists all joints of a compiled scene."""
    robots = [part.robot for part in parts.values()]
    counts = [robot.n for robot in robots]

    def gather(values: Sequence[Any], kind: Any = np.float64) -> Any:
        """One entry per joint, from one value or one array per robot."""
        spread = [np.broadcast_to(v, n) for v, n in zip(values, counts, strict=True)]
        return np.concatenate(spread or [np.empty(0)]).astype(kind)

    def slots_of(key: str) -> list[slice]:
        return [slots[f"{name}.{key}"] for name in parts]

    centres = [f"{robot.name}/centre{i + 1}" for robot in robots for i in range(robot.n)]

    def limits_of(field: str) -> Any:
        limits = [getattr(robot, field) for robot in robots]
        return gather([np.inf if limit is None else limit for limit in limits])

    return JointTable(
        names=[name for robot in robots for name in robot.names],
        robot=gather(range(len(robots)), np.intp),
        revolute=gather([robot.dh.revolute for robot in robots], bool),
        centre_site=_site_ids(model, centres),
        qpos=gather([part.qpos for part in parts.values()], np.intp),
        slots={
            key: gather([np.arange(s.start, s.stop) for s in slots_of(key)], np.intp)
            for key in VALUE_INPUTS
        },
        has={
            key: gather([s.start + i for s in slots_of("has")], np.intp)
            for i, key in enumerate(INPUTS)
        },
        torque_limit=limits_of("torque_limits"),
        acceleration_limit=limits_of("acceleration_limits"),
        arrow_quantity=gather([ARROW_QUANTITIES.index(r.arrow_quantity) for r in robots], np.intp),
        arrow_dead_band=gather([robot.arrow_dead_band for robot in robots]),
        arrow_radius=gather([robot.arrow_radii for robot in robots]),
        arrow_width_scale=gather([robot.arrow_width_scale for robot in robots]),
    )


def frame_table(model: mujoco.MjModel, parts: Mapping[str, RobotPart], scene: Scene) -> FrameTable:
    """Lists all frames of a compiled scene that can show axes."""
    rows: list[tuple[str, int, str, float, float]] = []
    for index, (name, part) in enumerate(parts.items()):
        robot = part.robot
        look = (robot.axes_length, 1.0 - robot.axes_transparency)
        rows.append((f"{name}/base", index, f"{name}/base", *look))
        rows += [
            (f"{name}/link{i + 1}", index, f"{name}/frame{i + 1}", *look) for i in range(robot.n)
        ]
        rows.append((f"{name}/flange", index, f"{name}/flange_frame", *look))
        rows += _named_axes(robot, f"{name}/")
    rows += _named_axes(scene, "")
    return FrameTable(
        names=[row[0] for row in rows],
        robot=np.array([row[1] for row in rows], np.intp),
        site=_site_ids(model, [row[2] for row in rows]),
        size=np.array([row[3] for row in rows], np.float64),
        alpha=np.array([row[4] for row in rows], np.float64),
    )


def _named_axes(owner: SerialRobot | Scene, scope: str) -> list[tuple[str, int, str, float, float]]:
    """Axes that are objects of their own and belong to no robot's `show_axes`."""
    items = owner.children if isinstance(owner, SerialRobot) else owner.objects
    return [
        (f"{scope}{item.name}", -1, f"{scope}axes_{item.name}", float(item.size[0]), 1.0)
        for item in items
        if item.shape == "axes" and item.size is not None
    ]


def _site_ids(model: mujoco.MjModel, names: Sequence[str]) -> Ints:
    kind = mujoco.mjtObj.mjOBJ_SITE
    return np.array([mujoco.mj_name2id(model, kind, name) for name in names], np.intp)
