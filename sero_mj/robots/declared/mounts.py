"""Robots mounted on frames of other robots: order, poses and errors.

A robot with `mount = "arm/flange"` is carried by the robot `arm`. Its `base_frame` is relative to
this frame. Mounted robots form trees whose roots are placed in the world.
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
    """Returns the name of the robot that carries a robot, or None."""
    return None if robot.mount is None else robot.mount.partition("/")[0]


def mount_labels(robot: SerialRobot) -> list[str]:
    """Returns the labels that may follow `NAME/` in a `mount`: base, links, flange and axes."""
    axes = [child.name for child in robot.children if child.shape == "axes"]
    return [*frame_labels(robot.n), *axes]


def mounted_by_joints(robots: Mapping[str, SerialRobot]) -> dict[str, SerialRobot]:
    """Returns the robots with a `mount` on a named joint or link, converted to `icub/link9`."""
    found = {}
    for name, robot in robots.items():
        below, _, label = (robot.mount or "").partition("/")
        if below in robots and (own := robots[below].frame_label(label)) != label:
            found[name] = robot.model_copy(update={"mount": f"{below}/{own}"})
    return found


def carriers(robots: Mapping[str, SerialRobot], name: str) -> list[str]:
    """Returns the names of the robots that carry a robot, nearest first."""
    found: list[str] = []
    below = carrier(robots[name])
    while below is not None and below in robots and below not in (name, *found):
        found.append(below)
        below = carrier(robots[below])
    return found


def mount_circles(robots: Mapping[str, SerialRobot]) -> list[list[str]]:
    """Returns the cycles of robots that carry each other, by their names."""
    ways = [[name, *carriers(robots, name)] for name in robots]
    return [way for way in ways if carrier(robots[way[-1]]) == way[0] == min(way)]


def mount_order(robots: Mapping[str, SerialRobot]) -> list[str]:
    """Returns the names of all robots, carriers first, and otherwise in the order of declaration.

    Raises CycleError if robots carry each other in a cycle.
    """
    carriers = {name: carrier(robot) for name, robot in robots.items()}
    after = {name: {each} & set(robots) if each else set() for name, each in carriers.items()}
    return list(TopologicalSorter(after).static_order())


def carrying_link(robots: Mapping[str, SerialRobot], name: str) -> tuple[str, int]:
    """Returns the name of the carrier of a mounted robot, and the index of the link."""
    below, _, label = (robots[name].mount or "").partition("/")
    robot = robots[below]
    label = next((child.on for child in robot.children if child.name == label), label)
    link = frame_labels(robot.n).index(label)
    return below, robot.flange_link if link > robot.n else link


def mount_pose(robot: SerialRobot, label: str, frames: Array) -> Array:
    """Returns T_base_mount (..., 4, 4) of a mount label, from the frames of the kinematics."""
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
    """Returns T_world_base (..., 4, 4) of all robots by name.

    Args:
        joint_angles: joint values (..., n) by robot, rad or m (default: the declared values).
        placed: T_world_base (..., 4, 4) of robots that are not at their declared frames.
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
    """Returns the same robot, placed in the world without a mount."""
    is_fixed = robot.mount is None and not robot.free_base
    if is_fixed and np.array_equal(T_world_base, robot.base_frame):
        return robot
    alone = {"mount": None, "free_base": False, "base_frame": T_world_base}
    return robot.model_copy(update=alone)


def mount_problems(robots: Mapping[str, SerialRobot], broken: Mapping[str, bool]) -> list[Problem]:
    """Returns mounts on unknown frames, and cycles of mounts.

    Mounts on invalid robots (`broken`) are not reported, because these are reported elsewhere.
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
            expected = f"a frame of it: {', '.join(others)}"
            problem = replace(problem, expected=expected, available=None)
        problems.append(problem)
    for circle in mount_circles(robots):
        way = " on ".join([*circle, circle[0]])
        message = f"robots are mounted on each other in a circle: {way}"
        problems.append(Problem(f"robots.{circle[0]}.mount", message))
    return problems
