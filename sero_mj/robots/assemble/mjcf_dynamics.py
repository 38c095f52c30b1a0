"""Adds dynamics to the spec of a scene for simulation.

Links get masses and collision geoms, and joints get motor inertia and friction. Adjacent links do
not collide. Scenes for display have none of these.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from itertools import combinations, product
from typing import Any

import mujoco
import numpy as np

from ...base.frames import Array, Bools
from ..declared.dynamics import principal_moments
from ..declared.mounts import carrying_link
from ..declared.robot import SerialRobot
from .link_geometry import touching_geoms
from .mjcf_elements import MESH, hull_asset
from .mjcf_links import excluded_links
from .parts import RobotPart
from .robot_dynamics import LinkInertia, RobotDynamics

TIMESTEP = 1e-3  # control cycle of an LWR, s
HULL_GROUP = 4  # hidden geom group of collision geoms
ON = "on_"  # prefix of the names of bodies with fixed children
PAYLOAD = "payload"  # body at the flange, massless until a payload is set
# Distance in housing radii below which links are adjacent. Links of the same wrist or shoulder
# share a housing and always overlap.
_ONE_HOUSING = 4.0
# These values limit creep at rest to 1e-6 rad/s, compared to 1e-4 with MuJoCo's default.
_FRICTION = {"solref_friction": [0.004, 1.0], "solimp_friction": [0.999, 0.9999, 1e-3, 0.5, 2.0]}
# Friction of metal, plastic and wood on each other. MuJoCo's default is the friction of rubber.
_SLIDING = [0.3, 0.005, 1e-4]
_RUBBER = [1.0, 0.005, 1e-4]
# Contact stiffness increases over 5 mm, as with a rubber skin. MuJoCo's default is stiff
# immediately, so the force of a sliding probe would alternate between 0 and twice the mean.
_SOFT, _SUDDEN = [0.0, 0.95, 0.005, 0.5, 2.0], [0.9, 0.95, 1e-3, 0.5, 2.0]
_TIME_CONSTANT = [0.03, 1.0]
COUPLING = "-coupling"  # suffix that names the constraint of a coupled joint
# These values limit the deflection of gears and tendons that couple joints to 1e-4 rad.
_GEAR = {"solref": [0.004, 1.0], "solimp": [0.99, 0.9999, 1e-4, 0.5, 2.0]}
_ON_FLOOR = 1 << 30  # collision mask of geoms that collide only with the floor
_FAR = 1e6  # replacement for an infinite limit, rad or m
# Joint limits are soft, like rubber end stops.
_STOP = {"solref_limit": [0.02, 1.0], "solimp_limit": [0.98, 0.998, 1e-3, 0.5, 2.0]}


def set_up_dynamics(root: mujoco.MjSpec, *, has_free: bool = False) -> None:
    """Sets the time step, integrator and contact options of a spec for simulation.

    Args:
        has_free: whether the scene has free objects, which robots may grasp.
    """
    root.compiler.boundmass = root.compiler.boundinertia = 0.0
    root.option.timestep = TIMESTEP
    root.option.integrator = mujoco.mjtIntegrator.mjINT_EULER
    # With pyramidal cones, the friction of soft contacts would be a third too low.
    root.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    if has_free:
        # Friction is ten times stiffer than the contact. With MuJoCo's default, objects slip in a
        # soft grasp. A can of 0.2 kg between two fingers slips by 0.4 mm/s instead of 4 mm/s.
        root.option.impratio = 10.0
    floor = root.geom("floor")
    if floor is not None:
        # Links near a base that stands on the floor do not collide with it.
        floor.contype, floor.conaffinity = 0, 1 | _ON_FLOOR


def set_friction(geom: Any, coefficient: float) -> None:
    """Sets the sliding friction coefficient of all contacts of a geom."""
    geom.friction[0], geom.priority = coefficient, 1


def set_contact_defaults(model: mujoco.MjModel) -> None:
    """Replaces MuJoCo's default friction and contact stiffness of the geoms of a model."""
    has_default = (model.geom_friction == _RUBBER).all(axis=1) & (model.geom_priority == 0)
    model.geom_friction[has_default] = _SLIDING
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
    _add_touching(piece, robot, dynamics.hulls)
    # This body is fixed to the flange, because a moving body must have a mass.
    piece.body("flange").add_body(name=PAYLOAD)


def set_inertia(body: mujoco.MjsBody, dynamics: RobotDynamics | LinkInertia, i: int) -> None:
    """Sets mass, center of mass and inertia of a body to those of link i (0 for the base)."""
    body.explicitinertial = True
    _fill_inertia(body, dynamics, i)


def _fill_inertia(body: Any, dynamics: RobotDynamics | LinkInertia, i: int) -> None:
    moments, axes = principal_moments(dynamics.tensors[i])
    mujoco.mju_mat2Quat(body.iquat, axes.ravel())
    body.mass, body.ipos, body.inertia = dynamics.masses[i], dynamics.centers[i], moments


def weighed_model(
    model: mujoco.MjModel, robots: Mapping[str, RobotPart], dynamics: Mapping[str, RobotDynamics]
) -> mujoco.MjModel:
    """Returns a copy of a display model with the masses of the robots, and zero mass elsewhere.

    In the display model itself, MuJoCo computes masses from the volumes of all geoms.
    """
    weighed = copy.copy(model)
    weighed.body_mass[:], weighed.body_inertia[:] = 0.0, 0.0
    weighed.body_sameframe[:] = 0  # Centers of mass are no longer at the origins.
    for name, of in dynamics.items():
        for i, body in enumerate(robots[name].bodies.tolist()):
            _fill_inertia(weighed.body(body), of, i)
    weighed.body_subtreemass[:] = weighed.body_mass
    for body in range(weighed.nbody - 1, 0, -1):  # Children come after their parents.
        weighed.body_subtreemass[weighed.body_parentid[body]] += weighed.body_subtreemass[body]
    return weighed


def deflection_joint(name: str) -> str:
    """Returns the name of the spring joint between motor and link of an elastic joint."""
    return f"{name}-deflection"


def spring_damping(dynamics: RobotDynamics, timestep: float) -> Array:
    """Returns the damping of the springs of elastic joints in the model, shape (n,), Nm s/rad.

    This is the declared damping, or at least half the stiffness times the time step. MuJoCo
    evaluates springs at the start of a step and damping at its end, so a light link on a stiff
    spring would be unstable without damping (for example the wrist of an LWR at 1 kHz). With the
    minimum damping, the spring acts in the middle of the step, which is always stable.

    Source: the theta scheme of Hairer and Wanner, Solving Ordinary Differential Equations II,
        1996, IV.3, with theta = 1/2 for the spring and the velocity at the end of the step.
    """
    return np.maximum(dynamics.joint_damping, 0.5 * timestep * dynamics.joint_stiffness)


def is_limited(robot: SerialRobot, i: int) -> bool:
    """Whether joint i has a finite lower or upper position limit."""
    limits = robot.position_limits
    return limits is not None and bool(np.isfinite(limits[i]).any())


def position_range(robot: SerialRobot, i: int) -> Array:
    """Returns both position limits of joint i, rad or m. An infinite limit is replaced by 1e6."""
    assert robot.position_limits is not None
    return np.asarray(np.clip(robot.position_limits[i], -_FAR, _FAR))


def _add_deflection(
    piece: mujoco.MjSpec,
    body: Any,
    joint: Any,
    robot: SerialRobot,
    dynamics: RobotDynamics,
    i: int,
) -> None:
    # Motor and spring are two joints on the same axis, and their angles add up.
    name = deflection_joint(robot.names[i])
    deflection = body.add_joint(
        name=name, type=joint.type, axis=joint.axis, pos=joint.pos, limited=False
    )
    deflection.stiffness[0] = dynamics.joint_stiffness[i]
    deflection.damping[0] = spring_damping(dynamics, TIMESTEP)[i]
    if is_limited(robot, i):  # The limits are those of the link instead of the motor.
        joint.limited = False
        stop = piece.add_tendon(
            name=f"{robot.names[i]}-stop", limited=True, range=position_range(robot, i), **_STOP
        )
        stop.wrap_joint(joint.name, 1.0)
        stop.wrap_joint(name, 1.0)


def _add_touching(piece: mujoco.MjSpec, robot: SerialRobot, hulls: list[Array | None]) -> None:
    sunk = _links_near_base(robot)
    is_declared = robot.collisions is not None or robot.mjcf is not None
    declared = touching_geoms(piece, robot) if is_declared else None
    for i in range(robot.n + 1):
        body = piece.body(f"link{i}") if i else piece.worldbody
        touches = {"contype": 0 if sunk[i] else 1, "conaffinity": 1}
        if declared is not None:
            for geom in declared[i]:
                own = {**touches, **geom}
                # With this mask, the geom collides only with the floor.
                own["contype"] = 0 if sunk[i] else own["contype"] or _ON_FLOOR
                body.add_geom(group=HULL_GROUP, mass=0, **own)
            continue
        for geom in body.geoms:
            if geom.type != MESH:
                for key, value in touches.items():
                    setattr(geom, key, value)
        hull = hulls[i]
        if hull is not None:
            asset = hull_asset(piece, f"hull{i}", hull)
            body.add_geom(type=MESH, meshname=asset, group=HULL_GROUP, mass=0, **touches)


def _links_near_base(robot: SerialRobot) -> Bools:
    # These links may overlap the floor or table on which the robot is mounted.
    if robot.free_base is True or robot.mount is not None:
        return np.zeros(robot.n + 1, bool)
    table = robot.kinematics
    near = 2.5 * robot.housing_radii[0]
    along = table.path_lengths(table.step_lengths())
    near_joints = np.concatenate([[0], table.depths]) < 2
    return np.asarray((along < near) | near_joints)


def exclude_neighbours(root: mujoco.MjSpec, robot: SerialRobot) -> None:
    """Excludes collisions between adjacent links of a robot that is already attached to `root`."""
    bodies = [_bodies_of(root, robot, i) for i in range(robot.n + 1)]
    for i, k in [] if robot.mjcf is None else excluded_links(robot):
        root.add_exclude(bodyname1=bodies[i][0], bodyname2=bodies[k][0])
    table = robot.kinematics
    near = _ONE_HOUSING * robot.housing_radii[0]
    steps, moves = table.step_lengths(), table.moves
    for i, k in combinations(range(robot.n + 1), 2):
        between = np.flatnonzero(moves[i] != moves[k])  # joints between links i and k
        # Sum of the offsets between the end of link i and the start of link k.
        offsets = steps[between].sum()
        if moves[k][moves[i]].all():  # Link k is distal on the same branch.
            last = len(between) - table.turns_in_carrier
            offsets = steps[between[1:last]].sum()
        if len(between) <= 2 or offsets < near:
            for one, other in product(bodies[i], bodies[k]):
                root.add_exclude(bodyname1=one, bodyname2=other)


def exclude_mounted(
    root: mujoco.MjSpec, robots: Mapping[str, SerialRobot], together: Sequence[Sequence[str]]
) -> None:
    """Excludes collisions between adjacent links of robots that are mounted on each other.

    As within a robot, links with at most two joints between them are adjacent. This applies to a
    robot and its carrier, and to two robots on the same link, such as fingers on a palm.

    Args:
        together: for each group model, the names of its unmounted robots, which are close together
            and treated as if they were mounted on the same link.
    """
    # For each carrying link: the carrier and the robots on it. Each of these robots has pairs of a
    # nearby link and the number of joints between this link and the carrying link.
    ways: dict[tuple[str, int], list[tuple[str, list[tuple[int, int]]]]] = {}
    for name, robot in robots.items():
        if robot.mount is None:
            continue
        below, link = carrying_link(robots, name)
        here = ways.setdefault((below, link), [(below, _links_beside(robots[below], link))])
        here.append((name, _links_beside(robot, 0)))
    for k, names in enumerate(together):
        ways["", k] = [(name, _links_beside(robots[name], 0)) for name in names]
    pairs = {
        (first, second)
        for here in ways.values()
        for (one, links), (other, others) in combinations(here, 2)
        if one != other
        for (link, i), (another, k) in product(links, others)
        if i + k <= 2
        for first in _bodies_of(root, robots[one], link)
        for second in _bodies_of(root, robots[other], another)
    }
    for first, second in sorted(pairs):
        root.add_exclude(bodyname1=first, bodyname2=second)


def _links_beside(robot: SerialRobot, link: int) -> list[tuple[int, int]]:
    between = (robot.kinematics.moves != robot.kinematics.moves[link]).sum(axis=1)
    return [(k, int(between[k])) for k in np.flatnonzero(between <= 2).tolist()]


def _bodies_of(root: mujoco.MjSpec, robot: SerialRobot, link: int) -> list[str]:
    scope = f"{robot.name}/"
    names = [f"{scope}link{link}" if link else scope]
    fixed = [root.body(f"{scope}{ON}{f'link{link}' if link else 'base'}")]
    if link == robot.flange_link:
        fixed.append(root.body(f"{scope}flange"))
    for body in (each for each in fixed if each is not None):
        tools = [body.name, *(inner.name for inner in body.find_all("body"))]
        names += [name for name in tools if name.startswith(scope)]
    return names
