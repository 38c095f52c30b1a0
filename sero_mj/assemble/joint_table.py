"""Arrays over all joints of a compiled scene, for decor and routes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from .parts import DoublePart, Owner, RobotPart
from .robot_parts import ARROW_QUANTITIES, VALUE_INPUTS

Array = NDArray[np.float64]
Ints = NDArray[np.intp]

_DOUBLE_ARROW_RGBA_SHARE = 0.55  # opacity of a double's arrows
_DOUBLE_ARROW_SIZE = 0.85  # both arrows are visible where a double coincides with its robot


@dataclass(frozen=True, eq=False)
class JointTable:
    """Arrays over all N joints: those of the robots, then those of their doubles.

    Attributes:
        names: joint names, N.
        owner: index in the world's `owners`.
        of_robot: number of joints of robots; the rest belong to doubles.
        revolute: True for a revolute, False for a prismatic joint.
        centre_site: site at the centre of its arrow and billboard, z along the joint's axis; a
            row of `site_xpos` in what `World.state` returns.
        qpos: index in `qpos` of the robots' joints, (of_robot,).
        angle_slots: index in `userdata` of the doubles' joint angles, (N - of_robot,).
        slots: for each per-joint input, index in `userdata` of its value; -1 where the joint's
            owner does not have it.
        has: likewise for the flag that data was received; includes `joint_angles`.
        torque_limit: Nm or N, inf for none.
        acceleration_limit: rad/s2 or m/s2, inf for none.
        arrow_quantity: index in `ARROW_QUANTITIES` of the quantity that its arrow initially
            shows.
        arrow_dead_band: fraction of the limit.
        arrow_radius: m.
        arrow_width_scale: m per Nm.
        arrow_load: Nm or N at which the arrow of a joint without limit is as wide as its radius;
            inf where `arrow_width_scale` sets the width.
        arrow_alpha: opacity of its arrow.
    """

    names: list[str]
    owner: Ints
    of_robot: int
    revolute: NDArray[np.bool_]
    centre_site: Ints
    qpos: Ints
    angle_slots: Ints
    slots: dict[str, Ints]
    has: dict[str, Ints]
    torque_limit: Array
    acceleration_limit: Array
    arrow_quantity: Ints
    arrow_dead_band: Array
    arrow_radius: Array
    arrow_width_scale: Array
    arrow_load: Array
    arrow_alpha: Array

    def angles(self, data: mujoco.MjData) -> Array:
        """Returns the angles of all joints (N,), rad or m; zero for a double without any."""
        return np.concatenate([data.qpos[self.qpos], data.userdata[self.angle_slots]])


def joint_table(
    owners: Mapping[str, Owner],
    slots: Mapping[str, slice],
    flags: Mapping[str, int],
    sites: Callable[[Sequence[str]], Ints],
) -> JointTable:
    """Builds the table of all joints of a compiled scene.

    Args:
        owners: robots, then doubles, by name.
        slots: slice of every input in `userdata`.
        flags: index in `userdata` of the flag that an input was set, by its name.
        sites: returns the ids of sites (k,) by their names.
    """
    parts = list(owners.values())
    robots = [part.robot for part in parts]
    counts = [robot.n for robot in robots]

    def gather(values: Iterable[Any], kind: Any = np.float64) -> Any:
        """Returns one entry per joint, from one value or one array per owner."""
        spread = [np.broadcast_to(v, n) for v, n in zip(values, counts, strict=True)]
        return np.concatenate(spread or [np.empty(0)]).astype(kind)

    def limits_of(field: str) -> Any:
        limits = [getattr(robot, field) for robot in robots]
        return gather([np.inf if limit is None else limit for limit in limits])

    def slots_of(key: str) -> list[Any]:
        found = [slots.get(f"{name}.{key}") for name in owners]
        return [-1 if s is None else np.arange(s.start, s.stop) for s in found]

    is_double = [isinstance(part, DoublePart) for part in parts]
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
        of_robot=sum(len(q) for q in qpos),
        revolute=gather([part.dh.revolute for part in parts], bool),
        centre_site=sites([f"{p.scope}centre{i + 1}" for p in parts for i in range(p.robot.n)]),
        qpos=np.concatenate([*qpos, []]).astype(np.intp),
        angle_slots=np.concatenate([*doubled, []]).astype(np.intp),
        slots={key: gather(slots_of(key), np.intp) for key in keys},
        has={
            key: gather([flags.get(f"{name}.{key}", -1) for name in owners], np.intp)
            for key in ("joint_angles", *keys)
        },
        torque_limit=limits_of("torque_limits"),
        acceleration_limit=limits_of("acceleration_limits"),
        arrow_quantity=gather([ARROW_QUANTITIES.index(p.arrow_quantity) for p in parts], np.intp),
        arrow_dead_band=gather([robot.arrow_dead_band for robot in robots]),
        arrow_radius=gather(
            [
                part.robot.arrow_radii * (_DOUBLE_ARROW_SIZE if double else 1.0)
                for part, double in zip(parts, is_double, strict=True)
            ]
        ),
        arrow_width_scale=gather([robot.arrow_width_scale for robot in robots]),
        arrow_load=gather([robot.arrow_loads for robot in robots]),
        arrow_alpha=gather(np.where(is_double, _DOUBLE_ARROW_RGBA_SHARE, 1.0)),
    )


def site_ids(model: mujoco.MjModel, names: Sequence[str]) -> Ints:
    """Returns the ids of sites by their names."""
    kind = mujoco.mjtObj.mjOBJ_SITE
    return np.array([mujoco.mj_name2id(model, kind, name) for name in names], np.intp)
