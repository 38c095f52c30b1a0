"""`RobotDynamics`: masses, friction and elasticity of a robot, declared or estimated.

If no link inertias are declared, MuJoCo computes volumes, centers of mass and tensors from mesh
hulls or generated shapes. The density is the declared one, or `LINK_DENSITY`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from ...base import frames
from ...base.errors import Problem, raise_any
from ...base.frames import MIRROR, Array
from ..declared.dynamics import link_name, rotate_tensors
from ..declared.robot import SerialRobot
from .link_geometry import drawn_geoms, generated
from .mjcf_elements import MESH, hull_asset, shape_geom

GRAVITY = 9.81  # MuJoCo's default, m/s2
EARTH: Array = np.array([0.0, 0.0, -GRAVITY])  # m/s2

# Estimates are proportional to the rated torque of a joint, which is its torque limit, or _STRENGTH
# times the torque that holds the stretched arm (3.8 times for joint 2 of the LWR). Per Nm of torque
# limit, the LWR has 0.008 to 0.02 kg m2 motor inertia, 0.0013 to 0.005 Nm Coulomb friction and
# 0.005 to 0.009 Nm viscous friction at 1 rad/s.
_STRENGTH = 3.5
_MOTOR_INERTIA = 0.012
_COULOMB = 0.004
_VISCOUS = 0.008
_FIRST_MODE = 10.0  # eigenfrequency of the motor if the link is fixed, Hz
_DAMPING_RATIO = 0.03  # damping ratio of this mode
_LARGE = 1.1  # ratio of radius of gyration to geometry size above which an inertia is reported
_STEEL = 7800.0  # maximum density of a link, kg/m3
# Relative thickness below which a mesh is extended to both sides, and this extension (m).
_FLATNESS, _THICKNESS = 1e-5, 0.5e-3
_MIN_MASS = 1e-6  # minimum mass of a body, which MuJoCo requires, kg
# MuJoCo rejects massless links. They get this fraction of the mass of the robot and this radius of
# gyration in m, or the minimum values of MuJoCo in kg and kg m2.
_BARE_SHARE, _BARE_RADIUS, _LEAST = 1e-9, 0.01, 2e-15
# Few robots exceed these values. The largest arms on the market reach 4.7 m and weigh 4.7 t.
_LARGE_REACH, _LARGE_MASS = 4.0, 1500.0  # m, kg
# Suspicious ratio of the torque that holds the stretched arm to the torque limit (usual 0.2 to 1.3)
_LARGE_SHARE = 10.0
# Strokes are reported above `_LONGEST_STROKE`. Above `_LONG_STROKE`, they are also reported if they
# are more than `_STROKES` times the reach without strokes. Arms on rails have up to 6 times.
_LONG_STROKE, _LONGEST_STROKE, _STROKES = 1.0, 20.0, 10.0  # m, m, ratio


class LinkInertia(NamedTuple):
    """The masses, centers of mass and inertia tensors of a robot, as in `RobotDynamics`."""

    masses: Array
    centers: Array
    tensors: Array


@dataclass(frozen=True, eq=False)
class RobotDynamics:
    """The parameters of the equations of motion of a robot, in link frames.

    Attributes:
        masses: masses of the base and the links, shape (n + 1,), kg.
        centers: centers of mass, shape (n + 1, 3), m.
        tensors: inertia tensors about the centers of mass, shape (n + 1, 3, 3), kg m2.
        motor_inertias: motor inertias reflected to the joints, shape (n,), kg m2.
        viscous_friction: viscous friction on the motor side, shape (n,), Nm s/rad.
        coulomb_friction: Coulomb friction on the motor side, shape (n,), Nm.
        joint_stiffness: joint stiffness, shape (n,), Nm/rad.
        joint_damping: damping in parallel with the stiffness, shape (n,), Nm s/rad.
        estimated: keys of `[dynamics]` whose values are estimates.
        hulls: vertices of the convex hulls of the links, shape (k, 3), m; None for links without
            meshes.
    """

    masses: Array
    centers: Array
    tensors: Array
    motor_inertias: Array
    viscous_friction: Array
    coulomb_friction: Array
    joint_stiffness: Array
    joint_damping: Array
    estimated: tuple[str, ...]
    hulls: list[Array | None]


def robot_dynamics(robot: SerialRobot) -> RobotDynamics:
    """Returns the declared dynamic parameters of a robot, and estimates of undeclared parameters.

    Raises:
        DeclarationError: a mesh file cannot be read, or an elastic joint has no motor inertia.
        ValueError: MuJoCo cannot compile a mesh.
    """
    if robot.mirrored:
        return _mirrored(robot_dynamics(robot.model_copy(update={"mirrored": False})))
    declared = robot.dynamics
    hulls = _link_hulls(robot)
    estimated = []
    links = declared_inertia(robot)
    if links is None:
        links = _estimated_links(robot, hulls)
        estimated.append("masses")
    limits = robot.torque_bounds
    if not np.isfinite(limits).all():
        held = _STRENGTH * holding_efforts(robot, links)
        limits = np.where(np.isfinite(limits), limits, held)

    def declared_or(key: str, estimate: Array) -> Array:
        value: Array | None = getattr(declared, key)
        if value is None:
            estimated.append(key)
        return estimate if value is None else value

    motor = declared_or("motor_inertias", _MOTOR_INERTIA * limits)
    viscous = declared_or("viscous_friction", _VISCOUS * limits)
    coulomb = declared_or("coulomb_friction", _COULOMB * limits)
    if robot.elastic_joints and (motor <= 0).any():
        message = (
            f"joint {int(np.argmax(motor <= 0)) + 1}: found 0; expected a positive motor inertia, "
            "because elastic_joints is true"
        )
        raise Problem("dynamics.motor_inertias", message).error()
    stiffness = declared_or("joint_stiffness", motor * (2 * np.pi * _FIRST_MODE) ** 2)
    damping = declared_or("joint_damping", 2 * _DAMPING_RATIO * np.sqrt(stiffness * motor))
    return RobotDynamics(
        *links, motor, viscous, coulomb, stiffness, damping, tuple(estimated), hulls
    )


def about_masses(robot: SerialRobot, dynamics: RobotDynamics) -> str:
    """Returns a text with the total mass, whether it is estimated, and links without a mass."""
    text = f"{dynamics.masses.sum():.4g} kg"
    declared = robot.dynamics.masses
    if declared is None or "masses" in dynamics.estimated:
        density = min(robot.dynamics.density, _STEEL)
        shapes = f"estimated from the link shapes at {density:g} kg/m3"
        return f"{text}, {shapes} (no mass is declared)"
    none = [link_name(k) for k in np.flatnonzero(declared == 0).tolist()]
    return f"{text}, as declared" + (f" (without mass: {', '.join(none)})" if none else "")


def about_large_inertias(robot: SerialRobot, dynamics: RobotDynamics) -> list[str]:
    """Returns a message for each link whose inertia is too large for its geometry.

    The moment of inertia about an axis through the center of mass is at most m r^2, where r is the
    distance of the farthest point. Larger values are common, because URDF templates contain the
    inertia of a box with sides of 1 m.
    """
    largest = np.linalg.eigvalsh(dynamics.tensors)[:, -1]
    lines = []
    for k, hull in enumerate(dynamics.hulls):
        if hull is None or dynamics.masses[k] <= 0:
            continue
        radius = float(np.sqrt(largest[k] / dynamics.masses[k]))
        reach = float(np.linalg.norm(hull - dynamics.centers[k], axis=1).max())
        if radius > _LARGE * reach:
            name = robot.link_names[k] if robot.link_names is not None else link_name(k)
            lines.append(
                f"{name}: its inertia has a radius of gyration of {radius:.2g} m, but its geometry "
                f"reaches only {reach:.2g} m from its center of mass"
            )
    return lines


def about_units(robot: SerialRobot, dynamics: RobotDynamics) -> list[str]:
    """Returns questions such as "are lengths in mm?" for suspicious lengths, masses and limits."""
    notes = []
    names, types = robot.names, robot.types
    limits = robot.plausible_limits
    strokes = np.ptp(np.where(np.isfinite(limits), limits, 0.0), axis=1)
    plain = robot.model_copy(update={"position_limits": None}).reach
    for k in range(robot.n):
        stroke = float(strokes[k])
        is_long = stroke > max(_STROKES * plain, _LONG_STROKE) or stroke > _LONGEST_STROKE
        if types[k] == "prismatic" and is_long:
            notes.append(f"joint {names[k]} has a range of {stroke:.4g} m: are its limits in mm?")
    reach = plain if notes else robot.reach
    if reach > _LARGE_REACH:
        notes.append(f"few robots reach {reach:.4g} m: are lengths in mm?")
    mass = float(dynamics.masses.sum())
    if mass > _LARGE_MASS:
        is_estimate = "masses" in dynamics.estimated
        cause = "lengths in mm" if is_estimate else "masses in g"
        notes.append(f"few robots weigh {mass:,.0f} kg: are {cause}?")
    links = LinkInertia(dynamics.masses, dynamics.centers, dynamics.tensors)
    shares = holding_efforts(robot, links) / robot.torque_bounds
    worst = int(np.argmax(shares))
    if shares[worst] > _LARGE_SHARE:
        notes.append(
            f"joint {names[worst]} needs up to {shares[worst]:,.0f} times its torque limit to hold "
            "the robot against gravity: are masses in g, lengths in mm, or is the limit in another "
            "unit?"
        )
    return notes


def _mirrored(dynamics: RobotDynamics) -> RobotDynamics:
    S = MIRROR[:3, :3]
    return replace(
        dynamics,
        centers=dynamics.centers @ S,
        tensors=S @ dynamics.tensors @ S,
        hulls=[None if hull is None else hull @ S for hull in dynamics.hulls],
    )


def declared_inertia(robot: SerialRobot) -> LinkInertia | None:
    """Returns the declared inertias of a robot, or None if no masses are declared."""
    if robot.mirrored:
        links = declared_inertia(robot.model_copy(update={"mirrored": False}))
        S = MIRROR[:3, :3]
        return links and LinkInertia(links.masses, links.centers @ S, S @ links.tensors @ S)
    declared = robot.dynamics
    if declared.masses is None or declared.centers_of_mass is None or declared.inertias is None:
        return None
    scale = np.full(robot.n + 1, declared.mass_scale)
    scale[0] = 1.0
    centers = declared.centers_of_mass.copy()
    if declared.frame_origins is not None:
        centers += declared.frame_origins
    tensors = scale[:, None, None] * declared.inertias
    if declared.frames == "zero_pose":
        to_link = np.swapaxes(robot.kinematics.frames(np.zeros(robot.n))[:, :3, :3], -1, -2)
        centers = (to_link @ centers[..., None])[..., 0]
        tensors = rotate_tensors(tensors, to_link)
    masses = scale * declared.masses
    bare = masses == 0
    masses[bare] = max(_BARE_SHARE * float(masses.sum()), _LEAST)
    tensors[bare] = max(float(masses[bare].sum()) * _BARE_RADIUS**2, _LEAST) * np.eye(3)
    return LinkInertia(masses, centers, tensors)


def holding_efforts(robot: SerialRobot, links: LinkInertia) -> Array:
    """Returns torques (n,) that hold the arm if it is stretched horizontally from each joint."""
    table = robot.kinematics
    along = table.path_lengths(table.distances())
    gyration = np.sqrt(np.trace(links.tensors, axis1=1, axis2=2) / links.masses)
    size = np.linalg.norm(links.centers, axis=1) + gyration
    levers = np.where(table.revolute, along[:, None] - along[1:] + size[:, None], 1.0)
    return np.asarray(GRAVITY * (links.masses[:, None] * levers * table.moves).sum(axis=0))


def _link_hulls(robot: SerialRobot) -> list[Array | None]:
    hulls: list[Array | None] = [None] * (robot.n + 1)
    if not robot.filenames:
        return hulls
    root = mujoco.MjSpec()
    owners: list[int] = []
    problems: list[Problem] = []
    places: list[Array] = []
    # Without hulls, MuJoCo would store vertices in other frames, and rounding would change runs.
    for i, geoms in enumerate(drawn_geoms(root, robot, problems, hull="unless flat")):
        for geom in (geom for geom in geoms if geom["type"] == MESH):
            root.worldbody.add_geom(type=MESH, meshname=geom["meshname"], contype=0, conaffinity=0)
            owners.append(i)
            places.append(frames.frame(frames.rotation_from_quat(geom["quat"]), geom["pos"]))
    raise_any(problems)
    if not owners:
        return hulls
    model = root.compile()
    for i in set(owners):
        clouds = [
            _corners(model, int(model.geom_dataid[k])) @ places[k][:3, :3].T + places[k][:3, 3]
            for k, owner in enumerate(owners)
            if owner == i
        ]
        hulls[i] = _hull(np.concatenate(clouds))
    return hulls


def _estimated_links(robot: SerialRobot, hulls: list[Array | None]) -> LinkInertia:
    density = min(robot.dynamics.density, _STEEL)
    root = mujoco.MjSpec()
    root.compiler.boundmass, root.compiler.boundinertia = _MIN_MASS, 1e-12
    # The stroke determines the length of a rod, but the mass must not depend on the stroke.
    robot = robot.model_copy(update={"position_limits": None})
    drawn = drawn_geoms(mujoco.MjSpec(), robot, [])
    others = generated(robot)  # shapes for links without geometry
    for i, hull in enumerate(hulls):
        body = root.worldbody.add_body(name=f"link{i}")
        shapes = [geom for geom in drawn[i] if geom["type"] != MESH]
        if hull is None and not shapes:
            shapes = [shape_geom(shape) for shape in others[i]]
        for geom in shapes:
            body.add_geom(density=density, **geom)
        if hull is not None:
            asset = hull_asset(root, f"hull{i}", hull)
            body.add_geom(type=MESH, meshname=asset, density=density)
    model = root.compile()
    tensors = np.empty((robot.n + 1, 3, 3))
    for i in range(robot.n + 1):
        axes = frames.rotation_from_quat(model.body_iquat[i + 1])
        tensors[i] = axes @ np.diag(model.body_inertia[i + 1]) @ axes.T
    return LinkInertia(model.body_mass[1:].copy(), model.body_ipos[1:].copy(), tensors)


def _corners(model: mujoco.MjModel, mesh: int) -> Array:
    # MuJoCo stores vertices in a frame at the center of the mesh instead of the frame of the file.
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    axes = frames.rotation_from_quat(model.mesh_quat[mesh])
    corners = model.mesh_vert[start : start + count].astype(np.float64)
    return np.asarray(corners @ axes.T + model.mesh_pos[mesh])


def _hull(cloud: Array) -> Array:
    middle = cloud.mean(axis=0)
    extents, axes = np.linalg.eigh((cloud - middle).T @ (cloud - middle) / len(cloud))
    thin = extents < _FLATNESS**2 * max(extents[2], 1e-12)
    if thin.any():
        away = _THICKNESS * axes.T[thin].sum(axis=0)
        cloud = np.concatenate([cloud - away, cloud + away])
    return _cached_hull(np.ascontiguousarray(cloud).tobytes())


@lru_cache(maxsize=128)  # In sweeps, hulls take half of the time to compile a world.
def _cached_hull(cloud: bytes) -> Array:
    root = mujoco.MjSpec()
    points = np.frombuffer(cloud).reshape(-1, 3)
    root.worldbody.add_geom(type=MESH, meshname=hull_asset(root, "hull", points))
    model = root.compile()
    # mesh_graph starts with the numbers of corners and faces, and an address and vertex per corner.
    graph = model.mesh_graph[model.mesh_graphadr[0] :]
    count = int(graph[0])
    hull = np.asarray(_corners(model, 0)[graph[2 + count : 2 + 2 * count]])
    hull.flags.writeable = False
    return hull
