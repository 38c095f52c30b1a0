"""Adds dynamics to a scene for simulation.

Links get masses, joints get motor inertia and friction, and links collide with the world and
with non-adjacent links. The display variant of the scene has none of this.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, product
from typing import Any

import mujoco
import numpy as np

from ..frames import Array, Bools
from .dynamics import principal_moments
from .mjcf_elements import MESH, hull_asset
from .mounts import carrying_link
from .robot import SerialRobot
from .robot_dynamics import RobotDynamics
from .shapes import housing_radii

TIMESTEP = 1e-3  # s, an LWR's cycle
HULL_GROUP = 4  # a group that is not shown: links are displayed by their meshes
ON = "on_"  # before a label: the body of the children that are fixed there
PAYLOAD = "payload"  # a body at the flange that weighs nothing until something is picked up
# Links closer than this count as neighbours, in housing radii: those of one wrist or shoulder
# share a housing and always overlap.
_ONE_HOUSING = 4.0
# Coulomb friction at rest creeps by at most 1e-6 rad/s (the default: 1e-4).
_FRICTION = {"solref_friction": [0.004, 1.0], "solimp_friction": [0.999, 0.9999, 1e-3, 0.5, 2.0]}
# Friction of metal, plastic and wood on each other; MuJoCo's default is that of rubber.
_SLIDING = [0.3, 0.005, 1e-4]
_RUBBER = [1.0, 0.005, 1e-4]
# Contact stiffness rises over 5 mm, as with a rubber skin. With MuJoCo's default, stiff at once,
# a sliding probe chatters: its force alternates between 0 and twice the mean every few steps.
_SOFT, _SUDDEN = [0.0, 0.95, 0.005, 0.5, 2.0], [0.9, 0.95, 1e-3, 0.5, 2.0]
_TIME_CONSTANT = [0.03, 1.0]
COUPLING = "-coupling"  # behind a joint's name: the constraint that couples it
# Gears and tendons that couple joints give way by 1e-4 rad at most.
_GEAR = {"solref": [0.004, 1.0], "solimp": [0.99, 0.9999, 1e-4, 0.5, 2.0]}
# Joint limits are soft, as rubber end stops are.
_STOP = {"solref_limit": [0.02, 1.0], "solimp_limit": [0.98, 0.998, 1e-3, 0.5, 2.0]}


def set_up_dynamics(root: mujoco.MjSpec, *, has_free: bool = False) -> None:
    """Sets time step, integrator, solver and contact options; adds no artificial stabilization.

    Args:
        root: of the scene.
        has_free: whether objects are free, which may be grasped.
    """
    root.compiler.boundmass = root.compiler.boundinertia = 0.0
    root.option.timestep = TIMESTEP
    root.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    root.option.cone = (
        mujoco.mjtCone.mjCONE_ELLIPTIC
    )  # pyramids give a third too little friction when all is soft
    if has_free:
        # Friction is ten times as stiff as the contact is soft. What is held in a soft grasp slides
        # through MuJoCo's soft friction: 4 mm/s of a can of 0.2 kg between two fingers, now 0.4.
        root.option.impratio = 10.0
    floor = root.geom("floor")
    if floor is not None:
        # Links mounted in the floor do not collide with it, see _collide.
        floor.contype, floor.conaffinity = 0, 1


def set_friction(geom: Any, coefficient: float) -> None:
    """Gives a geom a declared friction, which counts in all its contacts, whatever it touches."""
    geom.friction[0], geom.priority = coefficient, 1


def set_contact_defaults(model: mujoco.MjModel) -> None:
    """Sets friction and contact softness of geoms that have MuJoCo's defaults."""
    unsaid = (model.geom_friction == _RUBBER).all(axis=1) & (model.geom_priority == 0)
    model.geom_friction[unsaid] = _SLIDING
    sudden = (model.geom_solimp == _SUDDEN).all(axis=1)
    model.geom_solimp[sudden], model.geom_solref[sudden] = _SOFT, _TIME_CONSTANT


def add_dynamics(piece: mujoco.MjSpec, robot: SerialRobot, dynamics: RobotDynamics) -> None:
    """Adds masses, joint properties and collision geoms to a robot that is not yet attached."""
    for i in range(robot.n):
        body = piece.body(f"link{i + 1}")
        set_inertia(body, dynamics, i + 1)
        joint = piece.joint(robot.names[i])
        joint.armature = dynamics.motor_inertias[i]
        joint.damping[0] = dynamics.viscous_friction[i]
        joint.frictionloss = dynamics.coulomb_friction[i]
        for key, value in {**_FRICTION, **_STOP}.items():
            setattr(joint, key, value)
        if robot.elastic_joints:
            _add_deflection(piece, body, joint, robot, dynamics, i)
    coupled = robot.coupled
    for i, source in enumerate(coupled.independent[coupled.source].tolist()):
        if i != source:
            coupling = piece.add_equality(
                name=f"{robot.names[i]}{COUPLING}", type=mujoco.mjtEq.mjEQ_JOINT,
                name1=robot.names[i], name2=robot.names[source], **_GEAR,
            )  # fmt: skip
            coupling.data[:2] = coupled.offset[i], coupled.ratio[i]
    _add_hulls(piece, robot, dynamics.hulls)
    # Only a fixed body may be massless; this one is fixed to the last link.
    piece.body("flange").add_body(name=PAYLOAD)


def set_inertia(body: mujoco.MjsBody, dynamics: RobotDynamics, i: int) -> None:
    """Gives a body the mass, centre and tensor of link i; 0 is the base, which a robot carries."""
    moments, axes = principal_moments(dynamics.tensors[i])
    mujoco.mju_mat2Quat(body.iquat, axes.ravel())
    body.explicitinertial, body.mass = True, dynamics.masses[i]
    body.ipos, body.inertia = dynamics.centers[i], moments


def deflection_joint(name: str) -> str:
    """Returns the name of the second joint of an elastic joint, between motor and link."""
    return f"{name}-deflection"


def spring_damping(dynamics: RobotDynamics, timestep: float) -> Array:
    """Returns the damping of the elastic deflections in the model, (n,), Nm s/rad.

    MuJoCo takes springs at the start of a step and damping at its end, and so a light link on a
    stiff spring is unstable without damping (an LWR's wrist at 1 kHz). Damping of half the
    stiffness times the step makes it stable for all stiffnesses, links and steps: the spring
    counts in the middle of the step. So what is declared counts if it is more, and else this.

    Args:
        dynamics: of n joints.
        timestep: s.

    Source: the theta scheme of Hairer and Wanner, Solving Ordinary Differential Equations II,
        1996, IV.3, with theta = 1/2 for the spring and the velocity at the step's end.
    """
    return np.maximum(dynamics.joint_damping, 0.5 * timestep * dynamics.joint_stiffness)


def _add_deflection(
    piece: mujoco.MjSpec,
    body: Any,
    joint: Any,
    robot: SerialRobot,
    dynamics: RobotDynamics,
    i: int,
) -> None:
    """Adds a spring between motor and link: two joints on one axis, whose angles add up."""
    name = deflection_joint(robot.names[i])
    deflection = body.add_joint(
        name=name, type=joint.type, axis=joint.axis, pos=joint.pos, limited=False
    )
    deflection.stiffness[0] = dynamics.joint_stiffness[i]
    deflection.damping[0] = spring_damping(dynamics, TIMESTEP)[i]
    if robot.position_limits is not None:  # of the link, not of the motor
        joint.limited = False
        stop = piece.add_tendon(
            name=f"{robot.names[i]}-stop", limited=True, range=robot.position_limits[i], **_STOP
        )
        stop.wrap_joint(joint.name, 1.0)
        stop.wrap_joint(name, 1.0)


def _add_hulls(piece: mujoco.MjSpec, robot: SerialRobot, hulls: list[Array | None]) -> None:
    """Adds collision geoms to links: the hulls of their meshes, or the generated shapes."""
    sunk = _links_near_base(robot)
    for i in range(robot.n + 1):
        body = piece.body(f"link{i}") if i else piece.worldbody
        touches = {"contype": 0 if sunk[i] else 1, "conaffinity": 1}
        hull = hulls[i]
        if hull is not None:
            asset = hull_asset(piece, f"hull{i}", hull)
            body.add_geom(type=MESH, meshname=asset, group=HULL_GROUP, mass=0, **touches)
        elif not robot.filenames:
            for geom in body.geoms:
                for key, value in touches.items():
                    setattr(geom, key, value)


def _links_near_base(robot: SerialRobot) -> Bools:
    """Returns which links are so close to a base in the world that they may overlap its mount.

    (n + 1,). What moves with its base rests on the floor with all links.
    """
    if robot.free_base or robot.mount is not None:
        return np.zeros(robot.n + 1, bool)
    near = 2.5 * housing_radii(robot.dh, robot.T_n_flange)[0]
    along = np.concatenate([[0.0], np.cumsum(np.abs(robot.dh.a) + np.abs(robot.dh.d))])
    return np.asarray((along < near) | (np.arange(robot.n + 1) < 2))


def exclude_neighbours(root: mujoco.MjSpec, robot: SerialRobot) -> None:
    """Excludes collisions between links of one housing, in a scene with the robot attached."""
    bodies = [_bodies_of(root, robot, i) for i in range(robot.n + 1)]
    near = _ONE_HOUSING * housing_radii(robot.dh, robot.T_n_flange)[0]
    steps = np.abs(robot.dh.a) + np.abs(robot.dh.d)
    ends_before = robot.dh_convention == "standard"
    for i, k in combinations(range(robot.n + 1), 2):
        # The offsets between joint i + 1, where link i ends, and joint k, where link k begins.
        if k - i <= 2 or steps[i + 1 : k - ends_before].sum() < near:
            for one, other in product(bodies[i], bodies[k]):
                root.add_exclude(bodyname1=one, bodyname2=other)


def exclude_mounted(root: mujoco.MjSpec, robots: Mapping[str, SerialRobot]) -> None:
    """Excludes collisions between links that mounts make neighbours.

    As within one robot these are links with up to two joints between them, here over a mount: of
    the robot that carries and of the carried one, or of two that the same link carries.
    """
    ways: dict[tuple[str, int], list[tuple[str, list[int]]]] = {}  # from the carrying link on
    for name, robot in robots.items():
        if robot.mount is None:
            continue
        below, link = carrying_link(robots, name)
        n = robots[below].n
        back, on = [*range(link, max(link - 3, -1), -1)], [*range(link, min(link + 3, n + 1))]
        here = ways.setdefault((below, link), [(below, back), (below, on)])
        here.append((name, [*range(min(robot.n, 2) + 1)]))
    pairs = {
        (first, second)
        for here in ways.values()
        for (one, links), (other, others) in combinations(here, 2)
        if one != other
        for (i, link), (k, another) in product(enumerate(links), enumerate(others))
        if i + k <= 2
        for first in _bodies_of(root, robots[one], link)
        for second in _bodies_of(root, robots[other], another)
    }
    for first, second in sorted(pairs):
        root.add_exclude(bodyname1=first, bodyname2=second)


def _bodies_of(root: mujoco.MjSpec, robot: SerialRobot, link: int) -> list[str]:
    """Returns the names of the bodies of a link and of what is fixed to it, its own first."""
    scope = f"{robot.name}/"
    names = [f"{scope}link{link}" if link else scope]
    fixed = [root.body(f"{scope}{ON}{f'link{link}' if link else 'base'}")]
    if link == robot.n:
        fixed.append(root.body(f"{scope}flange"))
    for body in (each for each in fixed if each is not None):
        tools = [body.name, *(inner.name for inner in body.find_all("body"))]
        names += [name for name in tools if name.startswith(scope)]
    return names
