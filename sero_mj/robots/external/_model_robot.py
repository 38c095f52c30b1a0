"""Declares the robots of an external model, and lists its named frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import mujoco
import numpy as np
from pydantic import AfterValidator, BeforeValidator, PrivateAttr

from ...base.declaration import numbers
from ...base.errors import Problem, UnknownName, collect, mismatch, raise_any
from ...base.frames import Array, Ints
from ..assemble.decor_sizes import MeasuredBodies, Sizes, measure
from ..assemble.parts import RobotPart
from ..assemble.robot_dynamics import GRAVITY
from ..declared.cartesian import NamedFrame
from ..declared.double import AXES_OPACITY, Double
from ..declared.robot import SerialRobot
from ..importers.mjcf_model import frames_at_zero, link_poses, torque_limits
from ._model_trees import Tree, without_scope

# Fields of a robot that users can set. The model determines all other fields.
FIELDS = (
    "torque_limits",
    "acceleration_limits",
    "show_arrows",
    "arrow_quantity",
    "arrow_radius",
    "arrow_width_scale",
    "arrow_dead_band",
    "offsets_to_center_of_joints",
    "show_axes",
    "axes_size",
    "axes_transparency",
    "show_billboards",
    "billboard_scale",
    "billboard_lines",
    "inputs",
    "enable_touch_sensor",
)
_BASE = "base"  # label of the base frame
_FULL_WIDTH_G = 5.0  # multiple of g at which acceleration arrows reach full width


def _positive(value: Any) -> Any:
    if value is None:
        return None
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or array.ndim > 1:
        raise mismatch(value, "one number, or one per joint")
    finite = numbers(np.where(np.isposinf(array), 0.0, array))
    array = np.where(np.isposinf(array), np.inf, finite)
    if (array <= 0).any():
        raise mismatch(array.tolist(), "positive numbers")
    return array


PerJoint = Annotated[Array, BeforeValidator(_positive)]


class ModelRobot(SerialRobot):
    """A robot of an external model, with joint frames instead of a DH table."""

    joint_frames: Array | None = None
    joint_names: Annotated[list[str], AfterValidator(list)] = []
    torque_limits: PerJoint | None = None
    _carriers: Ints | None = PrivateAttr(None)

    @property
    def carriers(self) -> Ints | None:
        return self._carriers


@dataclass(frozen=True, eq=False)
class ModelPart(RobotPart):
    """The indices of a robot in an external model.

    Attributes:
        size: reach of the robot, m.
        tool: frame at the end of the chain, without the name of the robot, for example `hand`.
        labels: frames of the base and the n links, without the name of the robot.
    """

    robot: ModelRobot
    tree: Tree
    size: float
    tool: str
    labels: list[str]

    @property
    def flange_name(self) -> str:
        return f"{self.robot.name}/{self.tool}"

    @property
    def link_names(self) -> list[str]:
        return [f"{self.robot.name}/{label}" for label in self.labels]

    @property
    def own_link_names(self) -> list[str]:
        return self.link_names

    @property
    def chain(self) -> Ints:
        return self.tree.chain

    @property
    def reach(self) -> float:
        return self.size


def model_part(
    model: mujoco.MjModel,
    rest: mujoco.MjData,
    tree: Tree,
    overrides: Mapping[str, Any],
    start: int,
) -> ModelPart:
    """Creates the declaration and indices of a robot that was found in an external model.

    Sizes are measured in the state `rest`, and `overrides` contains fields that override them.
    `start` is the row of the first joint in the `JointTable`.
    """
    sizes = measure(model, rest, MeasuredBodies(tree.bodies, tree.joints, tree.trunk))
    problems: list[Problem] = []
    with collect(problems, f"robots.{tree.name}"):
        robot, sizes = _model_robot(model, tree, sizes, overrides)
    raise_any(problems)
    labels = body_labels(model, tree)
    bodies = np.concatenate([tree.bodies[:1], model.jnt_bodyid[tree.joints]]).astype(np.intp)
    along = rest.xanchor[tree.joints[tree.chain]]
    reach = float(np.linalg.norm(np.diff(along, axis=0), axis=1).sum()) if len(along) else 0.0
    return ModelPart(
        robot=robot,
        kinematics=robot.kinematics,
        qpos=model.jnt_qposadr[tree.joints].astype(np.intp),
        dofs=model.jnt_dofadr[tree.joints].astype(np.intp),
        mocap=-1,
        free=np.zeros(0, np.intp),
        bodies=bodies,
        flange_body=tree.last,
        joints=slice(start, start + robot.n),
        sizes=sizes,
        tree=tree,
        size=reach or sizes.link,
        tool=labels[tree.last],
        labels=[labels[int(body)] for body in bodies],
    )


def _model_robot(
    model: mujoco.MjModel, tree: Tree, sizes: Sizes, overrides: Mapping[str, Any]
) -> tuple[ModelRobot, Sizes]:
    problems = [
        Problem(key, "unknown key", available=FIELDS) for key in overrides if key not in FIELDS
    ]
    raise_any(problems)
    n = len(tree.joints)
    revolute = model.jnt_type[tree.joints] == int(mujoco.mjtJoint.mjJNT_HINGE)
    own = dict(overrides)
    with collect(problems, "arrow_radius"):
        sizes = replace(
            sizes, arrow_radius=_for_all(own.pop("arrow_radius", sizes.arrow_radius), n)
        )
    fields: dict[str, Any] = {
        "show_arrows": True,
        "billboard_lines": ["joint_angles", "torques"],
        "torque_limits": torque_limits(model, tree.joints),
        "acceleration_limits": _FULL_WIDTH_G * GRAVITY / np.where(revolute, sizes.link, 1.0),
        "axes_size": float(np.median(sizes.axes)),
        **own,
    }
    if np.ndim(fields["torque_limits"]) == 0 and fields["torque_limits"] is not None:
        fields["torque_limits"] = [fields["torque_limits"]] * n
    with collect(problems, ""):
        robot = ModelRobot(
            name=tree.name,
            joint_frames=_joint_frames(model, tree),
            joint_types=["revolute" if turns else "prismatic" for turns in revolute],
            joint_names=tree.joint_names,
            torques=np.zeros(n),  # lets billboards show torques, which the model provides
            **fields,
        )
    raise_any(problems)
    robot._carriers = tree.carriers(model)
    if "arrow_width_scale" in overrides:
        sizes = replace(sizes, full_width=np.ones(n))
    if "axes_size" in overrides:
        sizes = replace(sizes, axes=np.full(n, robot.axes_size))
    return robot, sizes


def _for_all(value: Any, n: int) -> Array:
    array = _positive(value)
    if array.ndim and len(array) != n:
        raise mismatch(len(array), f"{n}, one per joint", of="entries")
    return np.broadcast_to(array, n).astype(np.float64)


def _joint_frames(model: mujoco.MjModel, tree: Tree) -> Array:
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    poses = link_poses(model, data, tree.joints, int(tree.bodies[0]))
    return frames_at_zero(model, tree.joints, tree.carriers(model), poses)


def list_model_frames(
    model: mujoco.MjModel,
    robots: Mapping[str, ModelPart],
    doubles: Mapping[str, Double],
    wanted: Sequence[str],
) -> tuple[dict[str, NamedFrame], dict[str, tuple[str, int]]]:
    """Returns the named frames of an external model, and the locations of their poses, by name.

    Frames of robots and doubles are named `robot/body`. `wanted` contains names of additional
    bodies and sites. A location is `(double, k)` for row k in the state of a double, or `("", k)`
    for row k in the user's data, where the rows of `xpos` are followed by those of `site_xpos`.
    """
    frames: dict[str, NamedFrame] = {}
    places: dict[str, tuple[str, int]] = {}
    shown = [(name, "", part, 1.0) for name, part in robots.items()]
    shown += [
        (name, name, robots[double.of], AXES_OPACITY)
        for name, double in doubles.items()
        if double.path is None
    ]
    for name, state, part, opacity in shown:
        alpha = opacity * (1.0 - part.robot.axes_transparency)
        for body, label in body_labels(model, part.tree).items():
            if state and label == _BASE:
                continue  # A double shares the base frame of its robot.
            frame = f"{name}/{label}"
            size = _axes_length(model, part, body)
            frames[frame] = NamedFrame(frame, frame, name, name, size, alpha)
            places[frame] = (state, body)
    size = max([part.robot.axes_length for part in robots.values()], default=0.2)
    for name in wanted:
        frames[name] = NamedFrame(name, name, "", "", size, 1.0)
        places[name] = ("", _find(model, name))
    return frames, places


def body_labels(model: mujoco.MjModel, tree: Tree) -> dict[int, str]:
    """Returns the frame labels of a robot's bodies by body id, base first."""
    labels: dict[int, str] = {int(tree.bodies[0]): _BASE}
    bodies = [int(body) for body in tree.bodies[1:]]
    names = [model.body(body).name or f"body{body}" for body in bodies]
    for body, name in zip(bodies, without_scope(names), strict=True):
        label = name.strip("/") or f"body{body}"
        labels[body] = f"{label}_{body}" if label in labels.values() else label
    return labels


def _axes_length(model: mujoco.MjModel, part: ModelPart, body: int) -> float:
    moved = model.jnt_bodyid[part.tree.joints]
    while body and body not in moved:
        body = int(model.body_parentid[body])
    joint = int(np.flatnonzero(moved == body)[-1]) if body else 0
    assert part.sizes is not None
    return float(part.sizes.axes[joint])


def _find(model: mujoco.MjModel, name: str) -> int:
    kinds = mujoco.mjtObj
    site = mujoco.mj_name2id(model, kinds.mjOBJ_SITE, name)
    body = mujoco.mj_name2id(model, kinds.mjOBJ_BODY, name)
    if site >= 0:
        return int(model.nbody + site)
    if body >= 0:
        return int(body)
    names = [model.body(i).name for i in range(model.nbody)]
    names += [model.site(i).name for i in range(model.nsite)]
    raise UnknownName("body or site", name, [known for known in names if known])
