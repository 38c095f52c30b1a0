"""Robots that are mounted on frames of other robots: their order, poses and errors.

A robot with `mount = "arm/flange"` is carried by the robot `arm`. Its `base_frame` is relative to
this frame. Mounted robots form trees, and the roots of the trees are placed in the world.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from graphlib import TopologicalSorter

import numpy as np
from numpy.typing import ArrayLike

from ...base.errors import Problem
from ...base.frames import Array
from .robot import SerialRobot
from .robot_parts import frame_labels


def carrier(robot: SerialRobot) -> str | None:
    """Returns the name of the robot on which `robot` is mounted, or None."""
    return None if robot.mount is None else robot.mount.partition("/")[0]


def mount_labels(robot: SerialRobot) -> list[str]:
    """Returns the labels of the frames on which other robots can be mounted, such as `flange`."""
    axes = [child.name for child in robot.children if child.shape == "axes"]
    return [*frame_labels(robot.n), *axes]


def mounted_by_joints(robots: Mapping[str, SerialRobot]) -> dict[str, SerialRobot]:
    """Converts mounts on joints or original links (`icub/l_elbow`) to mounts on frames.

    Returns copies of the affected robots, whose `mount` is a frame name such as `icub/link9`.
    """
    found = {}
    for name, robot in robots.items():
        below, _, label = (robot.mount or "").partition("/")
        if below in robots and (own := robots[below].frame_label(label)) != label:
            found[name] = robot.model_copy(update={"mount": f"{below}/{own}"})
    return found


def carriers(robots: Mapping[str, SerialRobot], name: str) -> list[str]:
    """Returns the names of the robots that carry a robot directly or indirectly, nearest first."""
    found: list[str] = []
    below = carrier(robots[name])
    while below is not None and below in robots and below not in (name, *found):
        found.append(below)
        below = carrier(robots[below])
    return found


def mount_circles(robots: Mapping[str, SerialRobot]) -> list[list[str]]:
    """Returns the cycles of robots that are mounted on each other, as lists of names."""
    ways = [[name, *carriers(robots, name)] for name in robots]
    return [way for way in ways if carrier(robots[way[-1]]) == way[0] == min(way)]


def mount_order(robots: Mapping[str, SerialRobot]) -> list[str]:
    """Returns the names of all robots, each after the robot on which it is mounted.

    Raises `graphlib.CycleError` if robots are mounted on each other in a cycle.
    """
    carriers = {name: carrier(robot) for name, robot in robots.items()}
    after = {name: {each} & set(robots) if each else set() for name, each in carriers.items()}
    return list(TopologicalSorter(after).static_order())


def carrying_link(robots: Mapping[str, SerialRobot], name: str) -> tuple[str, int]:
    """Returns the robot and the link index on which the robot `name` is mounted."""
    below, _, label = (robots[name].mount or "").partition("/")
    robot = robots[below]
    label = next((child.on for child in robot.children if child.name == label), label)
    link = frame_labels(robot.n).index(label)
    return below, robot.flange_link if link > robot.n else link


def mount_pose(robot: SerialRobot, label: str, frames: Array) -> Array:
    """Returns the pose of the frame with a label such as `flange`, on which robots are mounted.

    `frames` contains the poses of the base and the links, shape (..., n + 1, 4, 4), in m.
    """
    if label == "base":
        return frames[..., 0, :, :]
    if label.startswith("link") and label[4:].isdigit():
        return frames[..., int(label[4:]), :, :]
    if label == "flange":
        return np.asarray(frames[..., robot.flange_link, :, :] @ robot.T_n_flange)
    k = [child.name for child in robot.children].index(label)
    return np.asarray(mount_pose(robot, robot.children[k].on, frames) @ robot.child_frames[k])


def base_frames(
    robots: Mapping[str, SerialRobot],
    joint_angles: Mapping[str, ArrayLike] | None = None,
    placed: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Returns the base frames T_world_base of all robots by name, shape (..., 4, 4).

    Args:
        joint_angles: joint values by robot, shape (..., n), rad or m (default: declared values).
        placed: base frames T_world_base that replace declared ones, by robot, shape (..., 4, 4).
    """
    bases: dict[str, Array] = {}
    for name in mount_order(robots):
        robot, given = robots[name], joint_angles or {}
        below = carrier(robot)
        if robot.mount is None or below not in bases:
            bases[name] = (placed or {}).get(name, robot.base_frame)
            continue
        parent = robots[below]
        frames = parent.kinematics.frames(given.get(below, parent.home), bases[below])
        bases[name] = mount_pose(parent, robot.mount.partition("/")[2], frames) @ robot.base_frame
    return {name: bases[name] for name in robots}


def unmounted(robot: SerialRobot, T_world_base: Array) -> SerialRobot:
    """Returns a copy of the robot that is fixed in the world instead of mounted or free."""
    is_fixed = robot.mount is None and not robot.free_base
    if is_fixed and np.array_equal(T_world_base, robot.base_frame):
        return robot
    alone = {"mount": None, "free_base": False, "base_frame": T_world_base}
    return robot.model_copy(update=alone)


def mount_problems(robots: Mapping[str, SerialRobot], broken: Mapping[str, bool]) -> list[Problem]:
    """Returns problems with mounts on unknown frames, and with cycles of mounts.

    Mounts on robots that are `broken` are ignored, because the robots themselves are reported.
    """
    problems = []
    frames = [f"{name}/{label}" for name, robot in robots.items() for label in mount_labels(robot)]
    for name, robot in robots.items():
        below = carrier(robot)
        if robot.mount is None or robot.mount in frames or broken.get(below or "", False):
            continue
        others = [each for each in frames if each.partition("/")[0] != name]
        if below in robots:
            others = [each for each in others if each.partition("/")[0] == below]
        problem = Problem(f"robots.{name}.mount", "no frame", found=robot.mount, available=others)
        if below in robots and "/" not in robot.mount:
            expected = f"one of its frames: {', '.join(others)}"
            problem = replace(problem, expected=expected, available=None)
        problems.append(problem)
    for circle in mount_circles(robots):
        way = " on ".join([*circle, circle[0]])
        message = f"robots are mounted on each other in a cycle: {way}"
        problems.append(Problem(f"robots.{circle[0]}.mount", message))
    return problems
