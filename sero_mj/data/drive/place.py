"""Computes the poses of received frames, mounted bases, followers and doubles from the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from ...base.frames import Array, Ints, frame, inverse, rotation_from_quat
from ...robots.assemble.mjcf import limb_bodies
from ...robots.assemble.parts import DoublePart, RobotPart
from ...robots.assemble.world_view import SET_BY_SOURCE, WorldView
from ...robots.declared.cartesian import WORLD
from ...robots.declared.double import OUT_OF_SIGHT, fade_in
from ...robots.declared.inputs import BLANKABLE, frame_of_numbers
from ...robots.declared.mounts import mount_pose
from .model_torques import output_now
from .route import FrameRoute, Origin, Route
from .wiring import Wiring, wire

# Latest values by source and event.
LatestValues = Mapping[str, Mapping[str, Array]]


class Placer:
    """A solver for the poses of all frames of a world; raises DeclarationError.

    Args:
        world: world whose scene declares the frames.
        wiring: result of `wire` for the scene of the world; None to call `wire`.
    """

    def __init__(self, world: WorldView, wiring: Wiring | None = None) -> None:
        wiring = (wiring or wire(world.scene)).check(world.scene)
        self._world = world
        self._late = Router(world, wiring.later)
        self._levels = wiring.levels
        placing = [route for route in wiring.frame_routes if route.to.key != "flange_check"]
        self._routes = {route.to.name: route for route in placing}
        self._checks = [route for route in wiring.frame_routes if route not in placing]
        self._limbs = _Limbs(world)
        later = {name for level in self._levels for name in level}
        self._at_once = [name for name in world.scene.frames if name not in later]

    def place(self, data: mujoco.MjData, packets: LatestValues | None = None) -> None:
        """Computes all frames from joint angles and received values, without a time step.

        First applies the routes that depend on several sources or on outputs of robots.
        """
        self._late.apply(data, packets or {})
        for name in self._at_once:
            self._place_received(data, name)
        pose_doubles(self._world, data)
        for level in self._levels:  # depends on frames of the previous levels
            mujoco.mj_kinematics(self._world.model, data)
            for name in level:
                if name in self._routes:
                    self._follow_route(data, self._routes[name])
                else:
                    self._place_received(data, name)
            pose_doubles(self._world, data)
        if self._limbs.are_any:
            self._limbs.place(data)
        follow(self._world.model, data)
        for route in self._checks:
            self._keep(data, route)

    def _origin(self, data: mujoco.MjData, route: FrameRoute) -> Array:
        if route.is_fwd_kin:
            return self._world.fwd_kin_base_to_flange(data, route.frame)
        return self._world.frame(data, route.frame)

    def _follow_route(self, data: mujoco.MjData, route: FrameRoute) -> None:
        T = self._origin(data, route)
        if route.to.kind == "frame":
            self._keep(data, route)
        self._world.set_pose(data, route.to.name, T)
        data.userdata[self._world.flags[route.to.target]] = SET_BY_SOURCE

    def _keep(self, data: mujoco.MjData, route: FrameRoute) -> None:
        target, T = route.to.target, self._origin(data, route)
        if route.to.key == "flange_check" and not route.is_fwd_kin:  # relative to the base
            base = self._world.frame(data, self._world.robots[route.to.name].base_name)
            T = inverse(base) @ T
        data.userdata[self._world.slots[target]] = T.ravel()
        data.userdata[self._world.flags[target]] = SET_BY_SOURCE

    def _place_received(self, data: mujoco.MjData, name: str) -> None:
        world = self._world
        T = data.userdata[world.slots[f"{name}.frame"]].reshape(4, 4)
        if data.userdata[world.flags[f"{name}.frame"]] <= 0 or not np.isfinite(T).all():
            data.mocap_pos[world.placed[name]] = OUT_OF_SIGHT
            data.userdata[world.flags[f"{name}.frame"]] = 0.0
            return
        relative_to = world.scene.frames[name].relative_to
        parent = np.eye(4) if relative_to == WORLD else world.frame(data, relative_to)
        world.set_pose(data, name, parent @ T)


def follow(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Computes frames, cameras and lights from `qpos` and `mocap`, without a time step."""
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)  # MuJoCo's visualization needs subtree centers of mass
    mujoco.mj_camlight(model, data)


def pose_doubles(world: WorldView, data: mujoco.MjData) -> None:
    """Writes the poses of all doubles to `mocap_pos` and `mocap_quat`; call `follow` afterwards."""
    if any(part.of.mocap < 0 for part in world.doubles.values()):
        mujoco.mj_kinematics(world.model, data)  # for bases that are mounted on other robots
    targets: dict[str, Array | None] = {}
    for name, part in world.doubles.items():
        frames = _targets(world, data, name, targets)
        if frames is None:
            data.mocap_pos[part.mocap] = data.mocap_pos[part.frames] = OUT_OF_SIGHT
            continue
        if part.path is None:
            _set_poses(data, part.frames, frames[0, 1:])
        robot = part.of
        actual = robot.kinematics.frames(data.qpos[robot.qpos], _base(data, robot))
        _place(data, part, frames, actual)


def _targets(
    world: WorldView, data: mujoco.MjData, name: str, known: dict[str, Array | None]
) -> Array | None:
    # Returns frames, shape (rows, n + 1, 4, 4), base first, or None if the double has no pose.
    if name in known:
        return known[name]
    part = world.doubles[name]
    q = part.path
    if q is None and data.userdata[world.flags[f"{name}.joint_angles"]] > 0:
        q = data.userdata[world.slots[f"{name}.joint_angles"]][None]
    if q is None:
        known[name] = None
        return None
    base = _base(data, part.of)
    if part.below is not None:
        below = _targets(world, data, part.below, known)
        if below is not None:
            label = (part.robot.mount or "").partition("/")[2]
            base = mount_pose(world.doubles[part.below].robot, label, below)
            base = base @ part.robot.base_frame
    known[name] = frames = part.kinematics.frames(q, base)
    return frames


def _base(data: mujoco.MjData, robot: RobotPart) -> Array:
    if robot.mocap >= 0:
        return frame(rotation_from_quat(data.mocap_quat[robot.mocap]), data.mocap_pos[robot.mocap])
    body = robot.bodies[0]
    return frame(data.xmat[body].reshape(3, 3), data.xpos[body])


def _place(data: mujoco.MjData, part: DoublePart, targets: Array, actual: Array) -> None:
    rotations = [T[..., :3, :3].reshape(*T.shape[:-2], 9) for T in (targets, actual)]
    opacity = fade_in(targets[..., :3, 3], rotations[0], actual[:, :3, 3], rotations[1])
    _set_poses(data, part.mocap.ravel(), targets.reshape(-1, 4, 4))
    data.mocap_pos[part.mocap[opacity == 0]] = OUT_OF_SIGHT


def _set_poses(data: mujoco.MjData, mocap: Ints, poses: Array) -> None:
    data.mocap_pos[mocap] = poses[:, :3, 3]
    quats = np.empty((len(mocap), 4))
    for quat, rotation in zip(quats, poses[:, :3, :3].reshape(-1, 9), strict=True):
        mujoco.mju_mat2Quat(quat, rotation)
    data.mocap_quat[mocap] = quats


class Router:
    """Applies routes to a world, in the order of `routes`; see `Wiring.later` for this order."""

    def __init__(self, world: WorldView, routes: Sequence[Route]) -> None:
        self._world = world
        # Minimum size of the arrays of each origin.
        self._sizes: dict[Origin, int] = {}
        for term in (term for route in routes for term in route.value.terms):
            needed = int(term.take.max()) + 1
            self._sizes[term.origin] = max(self._sizes.get(term.origin, 0), needed)
        self._routes = [(route.value, route.rest, _InputWriter(world, route)) for route in routes]

    def apply(self, data: mujoco.MjData, packets: LatestValues) -> None:
        """Writes the inputs whose origins have data. Call `Placer.place` afterwards.

        If the joints of a robot have several origins, joints with data are written, and the other
        joints get `Route.rest`.
        """
        if not self._routes:
            return
        with np.errstate(over="ignore", invalid="ignore"):
            for value, rest, writer in self._routes:
                there = [self._has(data, packets, origin) for origin in value.origins]
                if all(there):
                    writer.put(data, value.evaluate(lambda o: self._numbers(data, packets, o)))
                elif rest is not None and any(there):
                    came = value.evaluate(lambda o: self._numbers_if_there(data, packets, o))
                    writer.put(data, np.where(np.isnan(came), rest, came))

    def _has(self, data: mujoco.MjData, packets: LatestValues, origin: Origin) -> bool:
        if origin.is_event:
            return origin.key in packets.get(origin.name, ())
        if origin.key == "joint_angles" and origin.name in self._world.robots:
            return True  # a robot always has a pose
        if str(origin) not in self._world.flags:
            return True  # an output that the model of a robot computes
        return bool(data.userdata[self._world.flags[str(origin)]] > 0)

    def _numbers(self, data: mujoco.MjData, packets: LatestValues, origin: Origin) -> Array:
        if origin.is_event:
            return packets[origin.name][origin.key].ravel()
        if origin.key == "joint_angles" and origin.name in self._world.robots:
            return np.asarray(data.qpos[self._world.robots[origin.name].qpos])
        if str(origin) not in self._world.flags:
            return output_now(self._world, data, origin.name, origin.key)
        return np.asarray(data.userdata[self._world.slots[str(origin)]])

    def _numbers_if_there(
        self, data: mujoco.MjData, packets: LatestValues, origin: Origin
    ) -> Array:
        if self._has(data, packets, origin):
            return self._numbers(data, packets, origin)
        return np.full(self._sizes[origin], np.nan)


class _InputWriter:
    def __init__(self, world: WorldView, route: Route) -> None:
        item = route.to
        self._world = world
        self._negated, self._condition = route.negated, route.condition
        self._blankable = item.kind in BLANKABLE
        self._flag = world.flags[item.target]
        self._pose = item.name if item.kind == "pose" else None
        self._as_numbers = item.is_pose and item.shape != (4, 4)
        self._robot = world.scene.robots.get(item.name)
        self._slot = world.slots.get(item.target)
        robot = world.robots.get(item.name) if item.kind == "angles" else None
        self._qpos = None if robot is None else robot.qpos

    def put(self, data: mujoco.MjData, values: Array) -> None:
        if self._condition is not None:
            values = self._condition(values)
        if self._negated:
            values = (values <= 0.5).astype(np.float64)
        if self._as_numbers:
            values = frame_of_numbers(values, self._robot).ravel()
        finite = np.isfinite(values)
        if not finite.all():
            if not self._blankable:
                return
            values = np.where(finite, values, np.nan)
        if self._pose is not None:
            self._world.set_pose(data, self._pose, values.reshape(4, 4))
        elif self._qpos is not None:
            data.qpos[self._qpos] = values
        else:
            data.userdata[self._slot] = values
        data.userdata[self._flag] = SET_BY_SOURCE


class _Limbs:
    def __init__(self, world: WorldView) -> None:
        self._world = world
        self._limbs = [
            (item, [int(world.model.body(name).mocapid[0]) for name in limb_bodies(item.name)])
            for item in world.scene.objects
            if item.shape == "limb" and world.has_sites  # external models have no sites
        ]
        self.are_any = bool(self._limbs)

    def place(self, data: mujoco.MjData) -> None:
        # A limb is hidden if its frame is hidden.
        mujoco.mj_kinematics(self._world.model, data)
        for item, bodies in self._limbs:
            assert item.size is not None and item.reaches is not None  # checked by Object
            end = self._world.frame(data, item.reaches)[:3] @ [*item.end, 1.0]
            begin, towards = item.frame[:3, 3], item.frame[:3, 0]
            joint = middle_joint(begin, end, (item.size[0], item.size[1]), towards)
            is_hidden = end[2] < OUT_OF_SIGHT[2] / 2
            for body, start, along in (
                (bodies[0], begin, joint - begin),
                (bodies[1], joint, end - joint),
            ):
                data.mocap_pos[body] = OUT_OF_SIGHT if is_hidden else start
                mujoco.mju_quatZ2Vec(data.mocap_quat[body], along)


def middle_joint(begin: Array, end: Array, lengths: tuple[float, float], towards: Array) -> Array:
    """Returns the position of the joint between two links of a limb, shape (3,), m.

    Args:
        begin: start point of the first link, shape (3,), m.
        end: end point of the second link, shape (3,), m. If it is out of reach, the links are
            stretched or folded.
        lengths: lengths of the two links, m.
        towards: direction in which the joint bends, shape (3,).
    """
    first, second = lengths
    along = end - begin
    distance = float(np.linalg.norm(along))
    along = along / distance if distance > 0 else np.array([0.0, 0.0, 1.0])
    side = towards - (towards @ along) * along
    if np.linalg.norm(side) < 1e-9:  # any direction, if it is parallel to the limb
        side = np.cross(along, np.eye(3)[np.abs(along).argmin()])
    reached = float(np.clip(distance, max(abs(first - second), 1e-9), first + second))
    share = (reached**2 + first**2 - second**2) / (2 * reached)
    height = np.sqrt(max(first**2 - share**2, 0.0))
    return np.asarray(begin + share * along + height * side / np.linalg.norm(side))
