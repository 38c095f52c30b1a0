"""`RobotModel`: the kinematics and dynamics that a controller knows of its robot.

It is a model of that robot: no payload, no contact, and the masses that the controller believes
in. Other robots are in it only as what carries it and as its load, see `follow`. What differs from
that in the simulated world shows as it would on the real robot.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import lru_cache

import mujoco
import numpy as np
from mujoco import (
    mj_comVel,
    mj_factorM,
    mj_fullM,
    mj_fwdKinematics,
    mj_jacSite,
    mj_makeM,
    mj_rne,
    mj_solveM,
    mju_mat2Quat,
    mju_mulQuat,
)

from ...base.frames import Array, frame, inverse, rotation_from_quat
from ...robots.assemble.world import World, dynamics_of
from ...robots.declared.robot import SerialRobot
from ...robots.declared.scene import Scene
from .whole_body import Mounting


class RobotModel:
    """Kinematics and dynamics of one robot at the angles and velocities it was last given.

    `update` once, then ask: nothing is computed that is not asked for. What comes back is a
    buffer that the next call of the same method writes again; copy it to keep it.

    Joint torques are in Nm, forces of prismatic joints in N. The Coriolis matrix C is that of the
    Christoffel symbols (Siciliano et al. 2009, Robotics, 7.2), so that dM/dt = C + C^T.

    Args:
        model: where the robot's masses are taken from, at once; other robots, payloads fixed later
            and contacts are not. Other joints of the robot (a gripper's, elastic ones) are rigid.
        joints: ids of the robot's hinge and slide joints, base to flange.
        site: id of the site at the flange. One of site and body is needed.
        body: id of the body whose frame is the flange's.
        name: the robot's name, for messages.

    Attributes:
        rows: (), the leading axes of what is asked and answered; see `RobotModels`.
        n: number of joints.
        name: the robot's name.
        joint_names: of every joint, without the robot's name before it.
        position_limits: (n, 2), lower and upper, rad or m; infinite where none are known.
        velocity_limits: (n,), rad/s or m/s, likewise.
        motor_inertia: (n,), kg m2 or kg, as reflected to the joint; on the diagonal of M.
        flange_position: (3,), m, in the world; always that of the last `update`.
        flange_rotation: (3, 3), R_world_flange, likewise.

    Raises:
        ValueError: the joints are not those of one robot in their order, or there is no flange.
    """

    rows: tuple[int, ...] = ()

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Sequence[int],
        *,
        site: int | None = None,
        body: int | None = None,
        name: str = "robot",
    ) -> None:
        if (site is None) == (body is None):
            raise ValueError("expected a site or a body for the flange, and not both")
        ids = [int(joint) for joint in joints]
        n = len(ids)
        sliding_or_turning = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
        trees = set(model.body_rootid[model.jnt_bodyid[ids]].tolist())
        kinds = set(model.jnt_type[ids].tolist())
        if ids != sorted(set(ids)) or len(trees) != 1 or not kinds <= sliding_or_turning:
            raise ValueError(f"found joints {ids}; expected those of one robot, base to flange")
        self.n, self.name = n, name
        self.joint_names = [_own_name(model.joint(joint).name) for joint in ids]
        self.position_limits: Array = np.tile([-np.inf, np.inf], (n, 1))
        self.velocity_limits: Array = np.full(n, np.inf)
        self._model = skeleton(model, ids, site, body)
        self._compiled = self._model  # shared by copies
        self._take_views()

    def __copy__(self) -> RobotModel:
        """A model of its own, at home and in the world; far quicker than to compile it again."""
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__, _model=copy.copy(self._model))
        made._take_views()
        made._base = self._base
        return made

    @classmethod
    def side_by_side(cls, models: Sequence[RobotModel], m: int = 1) -> RobotModel:
        """A model of m times these robots in one world, whose joints follow each other.

        What depends on one robot alone is the same in it to the bit: gravity, Coriolis torques,
        inverse dynamics, momentum. It has no flange.

        Args:
            models: of robots under the same gravity.
        """
        made = object.__new__(cls)
        made.__dict__.update(models[0].__dict__, n=m * sum(model.n for model in models))
        made._model = copy.copy(_repeated(m, *(model._compiled for model in models)))
        made._model.opt.gravity[:] = models[0]._model.opt.gravity
        made._take_views()
        return made

    def _take_views(self) -> None:
        self._data = data = mujoco.MjData(self._model)
        mj_fwdKinematics(self._model, data)
        n = self.n
        self._qpos: Array = data.qpos
        self._gravity, self._coriolis, self._transposed, self._momentum = np.zeros((4, n))
        self._velocities: Array = np.zeros(n)
        self._mass: Array = np.zeros((n, n))
        self.motor_inertia: Array = self._model.dof_armature.copy()
        self._jacobian: Array = np.zeros((6, n))
        self._linear, self._angular = self._jacobian[:3], self._jacobian[3:]
        if self._model.nsite:
            self.flange_position: Array = data.site_xpos[0]
            self.flange_rotation: Array = data.site_xmat[0].reshape(3, 3)
        self._cinert, self._cdof = data.cinert, data.cdof
        self._can_move = False
        self._is_moving = self._is_swapped = self._has_mass = self._is_factored = False
        self._base: Array | None = None  # T_world_base, where it is known and does not move
        self._mounting: Mounting | None = None
        self._carriers: list[_Carrier] = []

    def _make_moving(self) -> None:
        """Makes the data of robots that move; not before, as it takes as long as 500 steps.

        mj_rne reads velocities from cvel and cdof_dot. They stay zero in `_data`, so there it gives
        gravity alone; in the others gravity is zero.
        """
        self._weightless = copy.copy(self._model)
        self._weightless.opt.gravity[:] = 0.0
        self._moving = moving = mujoco.MjData(self._weightless)
        self._swapped = swapped = mujoco.MjData(self._weightless)
        self._qvel: Array = moving.qvel
        self._qacc: Array = moving.qacc
        self._moving_cinert, self._moving_cdof = moving.cinert, moving.cdof
        self._moving_cdof_dot = moving.cdof_dot
        self._swapped_cinert, self._swapped_cdof = swapped.cinert, swapped.cdof
        self._swapped_cdof_dot, self._swapped_qvel = swapped.cdof_dot, swapped.qvel
        self._can_move = True

    @property
    def skeleton(self) -> mujoco.MjModel:
        """The model that all is computed with: links and joints without shapes and friction."""
        return self._model

    def follow(self, *mountings: tuple[Mounting, Array, int]) -> None:
        """Lets every `update` take over where bases are, and what robots carry, as loads.

        Args:
            mountings: of every robot in the model: its mounting, T_world_base when the model was
                made, and its number of joints.
        """
        self._mounting = mountings[0][0]
        whole = {id(mounting.data): mounting.data for mounting, _, _ in mountings}
        joint, model = 0, self._model
        found: dict[int, list[tuple[Mounting, Array, int, int]]] = {key: [] for key in whole}
        for mounting, T_world_base, n in mountings:
            found[id(mounting.data)].append((mounting, T_world_base, joint, n))
            joint += n
        self._carriers = [_Carrier(model, self._data, whole[key], found[key]) for key in whole]

    @classmethod
    def of(cls, robot: SerialRobot, world: World | None = None) -> RobotModel:
        """The model of a declared robot, with its own masses and nothing else in the world.

        Args:
            robot: its declaration, standing in the world (`mounts.unmounted`).
            world: a dynamic one with this robot alone, where it has been compiled already.

        Raises:
            DeclarationError: MuJoCo cannot compile the robot.
        """
        if world is None:
            world = world_without_meshes(robot)
        part = world.robots[robot.name]
        joints = [int(world.model.dof_jntid[dof]) for dof in part.dofs]
        made = cls(world.model, joints, body=part.flange_body, name=robot.name)
        made._base = robot.base_frame
        if robot.position_limits is not None:
            made.position_limits = robot.position_limits
        if robot.velocity_limits is not None:
            made.velocity_limits = robot.velocity_limits
        return made

    def update(self, angles: Array, velocities: Array) -> None:
        """Moves the model.

        Args:
            angles: (n,), rad or m.
            velocities: (n,), per second; kept, not copied, until the next update.
        """
        self._qpos[...] = angles
        self._velocities = velocities
        self._is_moving = self._is_swapped = self._has_mass = self._is_factored = False
        for carrier in self._carriers:
            carrier.move_bases()
        mj_fwdKinematics(self._model, self._data)
        for carrier in self._carriers:
            carrier.add_loads()

    def gravity(self, out: Array | None = None) -> Array:
        """g(q), (n,): the torques that hold the robot still.

        Args:
            out: (n,), to be written instead of the buffer.
        """
        result = self._gravity if out is None else out
        mj_rne(self._model, self._data, 0, result)
        return result

    def coriolis(self) -> Array:
        """C(q, dq) dq, (n,)."""
        self._move()
        mj_rne(self._weightless, self._moving, 0, self._coriolis)
        return self._coriolis

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """Writes M_link(q) a + C(q, dq) v + g(q), what tracking takes, as a difference of two.

        Args:
            velocities: v, (n,), per second.
            accelerations: a, (n,), per second squared.
            torques: (n,), to be written.
            less: (n,), likewise; to be taken from them.
        """
        # C(q, dq) v is linear in both and the same when they change places, so with c(x) =
        # C(q, x) x it is c((dq + v) / 2) - c((dq - v) / 2): two passes of Newton and Euler.
        if not self._can_move:
            self._make_moving()
        qvel = self._qvel
        self._moving_cinert[...], self._moving_cdof[...] = self._cinert, self._cdof
        self._qacc[...] = accelerations
        np.add(self._velocities, velocities, qvel)
        np.multiply(qvel, 0.5, qvel)
        mj_comVel(self._model, self._moving)
        mj_rne(self._model, self._moving, 1, torques)
        np.subtract(qvel, velocities, qvel)
        mj_comVel(self._model, self._moving)
        mj_rne(self._weightless, self._moving, 0, less)
        self._is_moving = False  # it moves, but at another velocity

    def transposed_coriolis(self) -> Array:
        """C(q, dq)^T dq, (n,): the slope of the kinetic energy along the angles, dq held.

        Turning joint k turns all beyond it, momentum h_k, while the velocity v of what is before
        it stays: the slope is (v x s_k) . h_k with the axis s_k. MuJoCo has v x s_k as
        `cdof_dot`. Its recursive Newton-Euler sums axis . (inertia x acceleration) over all beyond
        a joint; given velocities for accelerations and v x s for the axes, it sums just this, to
        the last digit (spatial vectors as in Featherstone 2008, Rigid Body Dynamics Algorithms).
        """
        self._swap()
        self._swapped_cdof[...] = self._moving_cdof_dot
        mj_rne(self._weightless, self._swapped, 0, self._transposed)
        return self._transposed

    def link_momentum(self) -> Array:
        """M_link(q) dq, (n,): the generalised momentum of the links, without the motors'."""
        self._swap()
        self._swapped_cdof[...] = self._cdof
        mj_rne(self._weightless, self._swapped, 0, self._momentum)
        return self._momentum

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """Writes what a momentum observer takes.

        Args:
            momentum: M_link(q) dq, (n,), to be written.
            slope: C(q, dq)^T dq - g(q), (n,), likewise: how it changes without any torques.
        """
        momentum[...] = self.link_momentum()
        np.subtract(self.transposed_coriolis(), self.gravity(), slope)

    def made_mass(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """The skeleton and its data, which have M(q) as MuJoCo stores it."""
        if not (self._has_mass or self._is_factored):
            mj_makeM(self._model, self._data)
        return self._model, self._data

    def mass(self) -> Array:
        """M(q), (n, n), kg m2 (kg), with the motors' inertia on its diagonal."""
        if not self._has_mass:
            if not self._is_factored:
                mj_makeM(self._model, self._data)
            mj_fullM(self._model, self._data, self._mass)
            self._has_mass = True
        return self._mass

    def over_mass(self, rows: Array, out: Array) -> Array:
        """Rows A as A M^-1, for a sixth of what an inverse of M takes.

        Args:
            rows: A, (k, n).
            out: (k, n), to be written.
        """
        if not self._is_factored:
            if not self._has_mass:
                mj_makeM(self._model, self._data)
            mj_factorM(self._model, self._data)
            self._is_factored = True
        mj_solveM(self._model, self._data, out, rows)
        return out

    def jacobian(self) -> Array:
        """J(q), (6, n): dq to the flange's velocity in world axes, m/s, then rad/s."""
        self.write_jacobian(self._linear, self._angular)
        return self._jacobian

    def write_jacobian(self, linear: Array, angular: Array) -> None:
        """Writes both halves of J(q), (3, n) each, to where they are wanted."""
        mj_jacSite(self._model, self._data, linear, angular, 0)

    def write_task_space(
        self, scale: Array, jacobian: Array, scaled: Array, over_mass: Array, gravity: Array
    ) -> None:
        """Writes what control of the flange takes.

        Args:
            scale: s, (6, 1), a factor for every axis.
            jacobian: J(q), (6, n), to be written, as all that follows.
            scaled: s J, (6, n).
            over_mass: s J M^-1, (6, n).
            gravity: g(q), (n,).
        """
        self.write_jacobian(jacobian[:3], jacobian[3:])
        np.multiply(jacobian, scale, scaled)
        self.over_mass(scaled, over_mass)
        self.gravity(gravity)

    def flange(self) -> Array:
        """T_world_flange, (4, 4), m; a new array."""
        return frame(self.flange_rotation, self.flange_position)

    def base(self) -> Array:
        """T_world_base, (4, 4), m; a new array.

        Of a model that was not made of a declaration: that of the body before the first joint.
        """
        if self._mounting is not None:
            data, base = self._mounting.data, self._mounting.base
            return frame(rotation_from_quat(data.xquat[base]), data.xpos[base])
        if self._base is not None:  # the skeleton's base is one with the world
            return self._base.copy()
        body = int(self._model.body_parentid[self._model.jnt_bodyid[0]])
        return frame(self._data.xmat[body].reshape(3, 3), self._data.xpos[body])

    def _move(self) -> None:
        if not self._is_moving:
            if not self._can_move:
                self._make_moving()
            self._moving_cinert[...], self._moving_cdof[...] = self._cinert, self._cdof
            self._qvel[...] = self._velocities
            mj_comVel(self._weightless, self._moving)
            self._is_moving = True

    def _swap(self) -> None:
        self._move()
        if not self._is_swapped:
            self._swapped_cinert[...], self._swapped_cdof_dot[...] = self._cinert, self._cdof
            self._swapped_qvel[...] = self._velocities
            self._is_swapped = True


class _Carrier:
    """Moves the bases of a model's robots, and adds their loads, as one whole body has them."""

    def __init__(
        self,
        model: mujoco.MjModel,
        own: mujoco.MjData,
        whole: mujoco.MjData,
        robots: Sequence[tuple[Mounting, Array, int, int]],
    ) -> None:
        self._model, self._own, self._whole = model, own, whole
        self._bases, self._trees = np.zeros((2, 0), np.intp)
        self._positions: Array = np.zeros((0, 3, 1))
        self._turns: Array = np.zeros((0, 4, 4))  # q -> q * quat of the tree in the base
        bodies, carried, own_roots, roots = [], [], [], []
        for mounting, T_world_base, joint, n in robots:
            inverse_base, turn = inverse(T_world_base), np.empty(4)
            mju_mat2Quat(turn, inverse_base[:3, :3].ravel())
            tops = {int(model.body_rootid[model.jnt_bodyid[k]]) for k in range(joint, joint + n)}
            for body in sorted(tops):  # trees that the base carries
                quat: Array = np.empty(4)
                mju_mulQuat(quat, turn, model.body_quat[body])
                position = inverse_base[:3, :3] @ model.body_pos[body] + inverse_base[:3, 3]
                self._bases = np.append(self._bases, mounting.base)
                self._trees = np.append(self._trees, body)
                self._positions = np.append(self._positions, position.reshape(1, 3, 1), axis=0)
                w, x, y, z = quat
                product = [[w, -x, -y, -z], [x, w, z, -y], [y, -z, w, x], [z, y, -x, w]]
                self._turns = np.append(self._turns, [product], axis=0)
            for link, body in mounting.loads:
                if link > 0:  # the base's load is held by what the base stands on
                    bodies.append(int(model.jnt_bodyid[joint + link - 1]))
                    carried.append(body)
                    own_roots.append(int(model.body_rootid[bodies[-1]]))
                    roots.append(mounting.root)
        self._bodies, self._carried, self._own_roots, self._roots = np.array(
            [bodies, carried, own_roots, roots], np.intp
        )

    def move_bases(self) -> None:
        whole, bases = self._whole, self._bases
        rotations = whole.xmat[bases].reshape(-1, 3, 3)
        self._model.body_pos[self._trees] = (
            whole.xpos[bases] + (rotations @ self._positions)[..., 0]
        )
        self._model.body_quat[self._trees] = (self._turns @ whole.xquat[bases][..., None])[..., 0]

    def add_loads(self) -> None:
        """Adds the inertias of the loads to those of the links that carry them.

        Both are about a point, in the world's axes. By the parallel-axis theorem, a shift by d of
        the point adds S - tr(S) E to the tensor, with a = h - m d / 2 and S = a d^T + d a^T, and
        -m d to the first moment h.
        """
        if not len(self._bodies):
            return
        loads, data = self._whole.crb[self._carried], self._own
        shifts = data.subtree_com[self._own_roots] - self._whole.subtree_com[self._roots]
        masses = loads[:, 9:]
        arms = loads[:, 6:9] - 0.5 * masses * shifts
        products = arms[:, :, None] * shifts[:, None, :]
        traces = 2.0 * np.einsum("kii->k", products)[:, None]
        loads[:, 0:3] += 2.0 * np.einsum("kii->ki", products) - traces
        loads[:, 3:6] += products[:, [0, 0, 1], [1, 2, 2]] + products[:, [1, 2, 2], [0, 0, 1]]
        loads[:, 6:9] -= masses * shifts
        np.add.at(data.cinert, self._bodies, loads)


def world_without_meshes(robot: SerialRobot) -> World:
    """A dynamic world with a robot alone, of the masses that its meshes give it.

    To compile these meshes as well takes many times as long, and a controller sees none of them.

    Raises:
        DeclarationError: MuJoCo cannot compile the robot.
    """
    known = dynamics_of(Scene(robots=[robot], floor=False))
    bare = robot.model_copy(update={"filenames": [], "collisions": []})
    return World(Scene(robots=[bare], floor=False), dynamic=True, dynamics=known)


def skeleton(
    model: mujoco.MjModel, joints: Sequence[int], site: int | None, body: int | None
) -> mujoco.MjModel:
    """Returns a model of one robot without shapes; its only site is the flange.

    Its base stays where it is in the model. Of its joints only those named are left; the others
    (of a gripper, of elastic gears) are fixed where they are at first. Bodies that do not move
    against each other are one.

    Args:
        joints: ids of its hinge and slide joints, base to flange.
        site: id of the site at the flange, or None.
        body: id of the body whose frame is the flange's, where there is no site.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = model.opt.gravity
    spec.compiler.fusestatic = True
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    copies = {0: spec.worldbody}
    root = model.body_rootid[model.jnt_bodyid[joints[0]]]
    for old in range(1, model.nbody):
        if model.body_rootid[old] != root:
            continue
        new = copies[int(model.body_parentid[old])].add_body(
            pos=model.body_pos[old], quat=model.body_quat[old]
        )
        copies[old] = new
        if model.body_mass[old] > 0.0:
            new.explicitinertial = True
            new.mass, new.inertia = model.body_mass[old], model.body_inertia[old]
            new.ipos, new.iquat = model.body_ipos[old], model.body_iquat[old]
        first = int(model.body_jntadr[old])
        for joint in range(first, first + int(model.body_jntnum[old])):
            if joint in joints:
                _add_joint(new, model, joint)
    if site is not None:
        at = copies[int(model.site_bodyid[site])]
        at.add_site(name="flange", pos=model.site_pos[site], quat=model.site_quat[site])
    else:
        copies[int(body or 0)].add_site(name="flange")
    return spec.compile()


@lru_cache(maxsize=16)
def _repeated(m: int, *models: mujoco.MjModel) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    for model in models * m:
        copies = {0: spec.worldbody}
        for old in range(1, model.nbody):
            parent = copies[int(model.body_parentid[old])]
            copies[old] = new = parent.add_body(
                pos=model.body_pos[old],
                quat=model.body_quat[old],
                explicitinertial=True,
                mass=model.body_mass[old],
                inertia=model.body_inertia[old],
                ipos=model.body_ipos[old],
                iquat=model.body_iquat[old],
            )
            first = int(model.body_jntadr[old])
            for joint in range(first, first + int(model.body_jntnum[old])):
                _add_joint(new, model, joint)
    return spec.compile()


def _add_joint(body: mujoco.MjsBody, model: mujoco.MjModel, joint: int) -> None:
    body.add_joint(
        type=mujoco.mjtJoint(int(model.jnt_type[joint])),
        pos=model.jnt_pos[joint],
        axis=model.jnt_axis[joint],
        ref=model.qpos0[model.jnt_qposadr[joint]],
        armature=model.dof_armature[model.jnt_dofadr[joint]],
    )


def _own_name(name: str) -> str:
    return name.partition("/")[2] or name
