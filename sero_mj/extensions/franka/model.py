"""Writes robot models as URDF for FCI clients (`GetRobotModel`, server version 8 or later)."""

from __future__ import annotations

from xml.etree import ElementTree

import mujoco
import numpy as np

from ...base.frames import Array, frame, inverse, rotation_from_quat, rpy_from_rotation
from ...simulate.control.robot_model import RobotModel

# libfranka finds the last link by this name, and treats robots named `tmr...` as mobile.
_ROBOT, _LINK, _JOINT = "fr3", "link{}", "joint{}"
# Parameters of velocity limits near position limits, which libfranka requires: deceleration in
# rad/s2 and velocity offset in rad/s of each joint of an FR3 (source: libfranka, test/fr3.urdf).
_NEAR_LIMITS = ((6.0, 0.3), (2.585, 0.2), (3.5, 0.2), (4.0, 0.3), (17.0, 0.35), (5.5, 0.35),
                (17.0, 0.35))  # fmt: skip


def urdf_of(model: RobotModel) -> str:
    """Returns the kinematics and inertias of a robot as URDF with the names in libfranka.

    As in the model of a real robot, shapes and motor inertias are omitted.
    """
    skeleton = model.skeleton
    robot = ElementTree.Element("robot", name=_ROBOT)
    ElementTree.SubElement(robot, "link", name=_LINK.format(0))
    joints = skeleton.njnt
    back = inverse(model.base())
    bodies = skeleton.jnt_bodyid.tolist()
    for number, body in enumerate(bodies, 1):
        _add_link(robot, _LINK.format(number), skeleton, body)
        at = frame(rotation_from_quat(skeleton.body_quat[body]), skeleton.body_pos[body])
        if number == 1:  # the skeleton of a fixed robot includes the base pose
            at = back @ at
        low, high = model.position_limits[number - 1]
        joint = _add_joint(robot, _JOINT.format(number), "revolute", number - 1, at)
        axis = skeleton.jnt_axis[number - 1]
        ElementTree.SubElement(joint, "axis", xyz=_text(axis))
        max_velocity = model.velocity_limits[number - 1]
        limits = {"lower": low, "upper": high, "velocity": max_velocity, "effort": 1e3}
        ElementTree.SubElement(
            joint, "limit", {key: f"{np.nan_to_num(value):.17g}" for key, value in limits.items()}
        )
        slowing, offset = _NEAR_LIMITS[number - 1]
        near = {"deceleration_limit": f"{slowing}", "velocity_offset": f"{offset}"}
        ElementTree.SubElement(joint, "position_based_velocity_limits", near)
    ElementTree.SubElement(robot, "link", name=_LINK.format(joints + 1))
    at = frame(rotation_from_quat(skeleton.site_quat[0]), skeleton.site_pos[0])
    _add_joint(robot, _JOINT.format(joints + 1), "fixed", joints, at)
    return ElementTree.tostring(robot, encoding="unicode")


def _add_joint(
    robot: ElementTree.Element, name: str, kind: str, parent: int, at: Array
) -> ElementTree.Element:
    joint = ElementTree.SubElement(robot, "joint", name=name, type=kind)
    ElementTree.SubElement(joint, "parent", link=_LINK.format(parent))
    ElementTree.SubElement(joint, "child", link=_LINK.format(parent + 1))
    _add_origin(joint, at)
    return joint


def _add_link(robot: ElementTree.Element, name: str, skeleton: mujoco.MjModel, body: int) -> None:
    link = ElementTree.SubElement(robot, "link", name=name)
    inertial = ElementTree.SubElement(link, "inertial")
    _add_origin(inertial, frame(np.eye(3), skeleton.body_ipos[body]))
    ElementTree.SubElement(inertial, "mass", value=f"{skeleton.body_mass[body]:.17g}")
    turn = rotation_from_quat(skeleton.body_iquat[body])
    inertia = turn @ np.diag(skeleton.body_inertia[body]) @ turn.T
    entries = {
        f"i{a}{b}": f"{inertia['xyz'.index(a), 'xyz'.index(b)]:.17g}"
        for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")
    }
    ElementTree.SubElement(inertial, "inertia", entries)


def _add_origin(element: ElementTree.Element, at: Array) -> None:
    rpy = rpy_from_rotation(at[:3, :3])
    ElementTree.SubElement(element, "origin", xyz=_text(at[:3, 3]), rpy=_text(rpy))


def _text(numbers: Array) -> str:
    return " ".join(f"{round(number, 12) + 0.0:.12g}" for number in numbers.tolist())
