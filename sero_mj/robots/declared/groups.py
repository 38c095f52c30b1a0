"""`Group`: robots with common routes and switches.

A group is an ordered list of robots and other groups. A route to an input of the group distributes
the values to its robots in this order. A route to a switch of the group sets it for all robots.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

from pydantic import Field, PrivateAttr

from ...base.declaration import Name, Vector
from ...base.errors import Problem
from .robot_parts import VALUE_INPUTS, ArrowQuantity, BillboardLines, Posed

_MAX_MEMBERS = 400
_MAX_REPORTED = 5  # unknown members reported per group, as searching similar names takes time


class Group(Posed):
    """An ordered group of robots with common inputs, and with defaults for fields of the robots.

    A field that is declared for a robot, in its model or table, overrides the default of its group.
    Defaults of inner groups override those of outer groups. None means that there is no default.
    Per-joint arrays contain the joints (or the independent joints) of all robots in order.

    Attributes:
        name: name in routes, for example `justin` in `justin.joint_angles`.
        description: description in one line.
        robots: names of robots and groups, in the order of the values in packets.
        joint_angles: initial joint angles, rad or m. They override those of robots and inner
            groups.
        joint_angles_deg: initial joint angles in degrees.
        torques: initial measured torques, Nm or N; None for no data.
        commanded_torques: initial commanded torques, Nm or N; None for no data.
        joint_accelerations: initial accelerations, rad/s2 or m/s2; None for no data.
        billboard_values: initial values of billboards; None for no data.
        enable_touch_sensor: whether a click on a robot toggles its features.
        stale_after: time without a packet after which robots are shown gray, in seconds.
        show_axes: whether coordinate axes are shown.
        axes_size: length of the axes, m.
        axes_transparency: transparency of the axes, from 0 (opaque) to 1 (invisible).
        show_arrows: whether round arrows are shown.
        arrow_quantity: quantity that the arrows show.
        arrow_dead_band: fraction of the limit below which no arrow is shown.
        arrow_radius: radius of the arrows, m.
        arrow_width_scale: arrow width per torque, m per Nm.
        show_billboards: whether billboards are shown.
        billboard_scale: text height as a fraction of 0.7 times the image height.
        billboard_lines: quantities that the lines of the billboards show.
        elastic_joints: whether simulated joints are elastic.
    """

    name: Name
    description: str = ""
    robots: list[Name] = Field(min_length=1, max_length=_MAX_MEMBERS)
    torques: Vector | None = None
    commanded_torques: Vector | None = None
    joint_accelerations: Vector | None = None
    billboard_values: Vector | None = None
    enable_touch_sensor: bool | None = None
    stale_after: float | None = Field(None, gt=0)
    show_axes: bool | None = None
    axes_size: float | None = Field(None, gt=0)
    axes_transparency: float | None = Field(None, ge=0, le=1)
    show_arrows: bool | None = None
    arrow_quantity: ArrowQuantity | None = None
    arrow_dead_band: float | None = Field(None, ge=0, lt=1)
    arrow_radius: float | None = Field(None, gt=0)
    arrow_width_scale: float | None = Field(None, gt=0)
    show_billboards: bool | None = None
    billboard_scale: float | None = Field(None, gt=0, le=0.5)
    billboard_lines: BillboardLines = None
    elastic_joints: bool | None = None

    # Files and keys of the tables that declare a group with a model, for messages about problems.
    _declared: tuple[tuple[Path, str], ...] = PrivateAttr(())

    @property
    def defaults(self) -> dict[str, object]:
        """Default values of robot fields, by field name."""
        fields = [key for key in type(self).model_fields if key not in _OWN]
        return {key: getattr(self, key) for key in fields if getattr(self, key) is not None}

    def without_defaults(self) -> Group:
        """Returns a copy of the group without initial values and defaults."""
        group = Group(name=self.name, robots=self.robots)
        group._declared = self._declared
        return group


SHARED = ("joint_angles", *VALUE_INPUTS)  # fields whose values are distributed to the robots
_OWN = ("name", "description", "robots", "joint_angles_deg", *SHARED)  # fields that set no default


@dataclass(frozen=True)
class Membership:
    """The resolved members of all groups of a scene.

    Attributes:
        members: robot names by group, including the robots of inner groups.
        around: names of the groups that contain a robot or group, by its name, inner groups first.
        circles: cycles of groups that contain each other, each as a list of names.
        twice: name of a robot that a group contains twice, by group.
    """

    members: dict[str, list[str]]
    around: dict[str, list[str]]
    circles: list[list[str]]
    twice: dict[str, str]


def membership(groups: Mapping[str, Sequence[str]]) -> Membership:
    """Resolves nested groups to robots. `groups` contains the declared members of each group."""
    found = Membership({}, {}, [], {})

    def visit(name: str, way: list[str]) -> list[str]:
        if name in way:
            found.circles.append(way[way.index(name) :])
            return []
        if name in found.members or name not in groups:
            return found.members.get(name, [name])
        every = [each for inner in groups[name] for each in visit(inner, [*way, name])]
        found.members[name] = once = list(dict.fromkeys(every))
        if len(once) < len(every):
            found.twice[name] = Counter(every).most_common(1)[0][0]
        return once

    for group in groups:
        visit(group, [])
    outer: dict[str, dict[str, None]] = {name: {} for name in groups}  # sets in order
    for group, names in groups.items():
        for name in names:
            outer.setdefault(name, {})[group] = None
    for name in outer:
        around: dict[str, None] = {}
        todo = [name]
        while todo:
            new = [group for group in outer[todo.pop(0)] if group not in around]
            todo += new
            around |= dict.fromkeys(new)
        found.around[name] = [*around]
    return found


def group_problems(
    groups: Mapping[str, Group], found: Membership, declared: Collection[str]
) -> list[Problem]:
    """Returns problems with unknown or repeated members, cycles, and contradictory defaults.

    `declared` contains the names of all robots and groups, including invalid ones.
    """
    problems = []
    for name, group in groups.items():
        unknown = [each for each in dict.fromkeys(group.robots) if each not in declared]
        for each in unknown[:_MAX_REPORTED]:
            problems.append(
                Problem(
                    f"groups.{name}.robots",
                    "no robot or group",
                    found=each,
                    available={known for known in declared if known != name},
                )
            )
    for circle in found.circles:
        way = " in ".join([*circle, circle[0]][::-1])
        message = f"groups contain each other: {way}"
        problems.append(Problem(f"groups.{circle[0]}.robots", message))
    for name, each in found.twice.items():
        message = f"the group contains '{each}' twice, so its share of the values is ambiguous"
        problems.append(Problem(f"groups.{name}.robots", message))
    for name, around in found.around.items():
        if name not in groups:
            problems += _contradictions(groups, found, name, around)
    return problems


def _contradictions(
    groups: Mapping[str, Group], found: Membership, robot: str, around: list[str]
) -> list[Problem]:
    problems = []
    for one, other in combinations(around, 2):
        first, second = groups[one].defaults, groups[other].defaults
        if other in found.around[one] or one in found.around[other]:
            continue
        for key in sorted(first.keys() & second.keys()):
            if first[key] != second[key]:
                message = f"'{robot}' is also in the group {one}, which has a different {key}"
                problems.append(Problem(f"groups.{other}.{key}", message))
    return problems
