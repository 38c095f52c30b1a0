"""Routes to some joints of a robot, such as `udp.values0 for l_elbow, r_arm`.

Each of these routes becomes a `JointPart` per robot. `whole_route` merges all parts of an input,
such as `icub.joint_angles`, into one route.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...base.errors import Problem
from ...base.frames import Array
from ...robots.declared.inputs import Input
from ...robots.declared.scene import Scene
from ...robots.importers.joint_names import identifiers
from .route import Route
from .units import robot_of, units_of, wrong_unit
from .values import Value, joined

_MAX_LISTED = 8  # maximum number of joints in a message


class Place(NamedTuple):
    """A joint of an input, by its index."""

    to: Input
    joint: int


@dataclass(frozen=True, eq=False)
class JointPart:
    """The part of a route that sets k joints of an input.

    Attributes:
        value: values of the joints, shape (k,).
        text: expression that the route reads.
        numbers: for each of the k joints, the index of its number in the result of `text`.
    """

    to: Input
    joints: list[int]
    value: Value
    text: str
    numbers: list[int]


def places_by_name(
    scene: Scene, inputs: Sequence[Input], *, in_group: bool
) -> dict[str, list[Place]]:
    """Returns the joints of inputs by name: one joint, or all joints of a limb.

    In a group, the names are `ROBOT_JOINT` and `ROBOT_LIMB`, and `ROBOT` for all joints of a robot.
    """
    places: dict[str, list[Place]] = {}
    for item in inputs:
        robot = robot_of(scene, item)
        scope = f"{robot.name}_" if in_group else ""
        limbs = {scope + limb: joints for limb, joints in robot.limb_joints.items()}
        if in_group:
            limbs[robot.name] = list(range(robot.n))
        joints = {**identifiers(robot.names), **{name: i for i, name in enumerate(robot.names)}}
        limbs |= {scope + name: [i] for name, i in joints.items()}
        places |= {name: [Place(item, i) for i in joints] for name, joints in limbs.items()}
    return places


def named_joints(
    scene: Scene,
    owner: str,
    places: Mapping[str, list[Place]],
    names: Sequence[str] | None,
    problems: list[Problem],
) -> list[Place]:
    """Returns the named joints in order, and appends errors to `problems`."""
    if names is None:
        message = "expected 'for' and names of joints or limbs after each of several origins"
        problems.append(Problem("", message))
    for name in dict.fromkeys(names or []):
        if name not in places:
            problems.append(
                Problem("", f"{owner} has no joint or limb", found=name, available=places)
            )
    return [place for name in names or [] for place in places.get(name, [])]


def named_twice(scene: Scene, places: Sequence[Place]) -> list[Problem]:
    """Returns a problem for each joint that occurs more than once."""
    twice = [place for place, count in Counter(places).items() if count > 1]
    names = [robot_of(scene, to).names[joint] for to, joint in twice]
    return [Problem("", f"{name} occurs twice; expected each joint once") for name in names]


def joint_parts(
    scene: Scene, value: Value, text: str, places: Sequence[Place], target: str
) -> list[JointPart]:
    """Splits the values of an origin into one part per robot; raises DeclarationError.

    Args:
        places: joints in the order of the values; the values of coupled joints can be omitted.
    """
    named = set(places)
    free = [place for place in places if not _follows(place, named)]
    count, is_one = value.entries.size, value.is_constant and not value.shape
    if count == len(free) < len(places):
        places = free
    if value.is_frames or (count != len(places) and not is_one):
        names = [robot_of(scene, to).names[joint] for to, joint in places]
        listed = names if len(names) <= _MAX_LISTED else [names[0], "...", names[-1]]
        many = "1 value" if count == 1 else f"{count} values"
        fewer = f", or {len(free)} without the coupled ones" if len(free) < len(places) else ""
        takes = f"{len(places)}{fewer}: {', '.join(listed)}"
        raise Problem("", f"{text} has {many}, but {target} takes {takes}").error()
    parts = []
    for item in dict.fromkeys(place.to for place in places):
        mine = [k for k, place in enumerate(places) if place.to is item]
        numbers = [0] * len(mine) if is_one else mine
        joints = [places[k].joint for k in mine]
        ones = np.ones(len(mine))
        own = value.gather(np.array(numbers, np.intp), ones, 0.0 * ones)
        units = units_of(scene, item)
        if message := wrong_unit(own.units, [units[joint] for joint in joints], target):
            raise Problem("", f"{text} {message}").error()
        parts.append(JointPart(item, joints, own, text, numbers))
    return parts


def _follows(place: Place, places: Set[Place]) -> bool:
    coupled = place.to.coupled
    if coupled is None:
        return False
    leader = int(coupled.independent[coupled.source[place.joint]])
    return leader != place.joint and Place(place.to, leader) in places


def whole_route(scene: Scene, parts: Sequence[JointPart]) -> Route:
    """Merges the parts of an input into one route.

    Joints that are coupled to joints of the parts follow them. All other joints have their declared
    values.
    """
    item = parts[0].to
    rest = _declared_values(scene, item)
    joints = np.concatenate([part.joints for part in parts]).astype(np.intp)
    value = joined([part.value for part in parts]).spread(joints, rest)
    texts, numbers = [""] * item.count, np.zeros(item.count, np.intp)
    for part in parts:
        numbers[part.joints] = part.numbers
        for joint in part.joints:
            texts[joint] = part.text
    if item.coupled is not None:
        coupled = item.coupled
        leader = coupled.independent[coupled.source]
        follow = np.isin(leader, joints) & ~np.isin(np.arange(item.count), joints)
        take = np.where(follow, leader, np.arange(item.count))
        factors = np.where(follow, coupled.factors(item.key), 1.0)
        constants = np.where(follow, coupled.constants(item.key), 0.0)
        value = value.gather(take, factors, constants)
        numbers, texts = numbers[take], [texts[joint] for joint in take]
    text = "; ".join(dict.fromkeys(part.text for part in parts))
    compiled = value.compile(item.count)
    return Route(item, text, compiled, False, tuple(numbers.tolist()), tuple(texts), rest)


def _declared_values(scene: Scene, item: Input) -> Array:
    robot, double = robot_of(scene, item), scene.doubles.get(item.name)
    declared = getattr(robot if double is None else double, item.key, None)
    if declared is None:
        return robot.home if item.kind == "angles" else np.full(item.count, np.nan)
    if item.coupled is not None:
        return item.coupled.full(item.key, declared)
    return np.asarray(declared, np.float64)
