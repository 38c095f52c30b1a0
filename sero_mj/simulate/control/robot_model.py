"""`RobotModel`: the kinematics and dynamics that a controller knows of its robot.

It contains the masses that the controller assumes, but no payload and no contact. Other robots
appear only as the carrier and the load of the robot (see `follow`). Differences from the simulated
world have the same effects as on a real robot.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Sequence
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
)

from ...base.frames import Array, frame, rotation_from_quat
from ...robots.assemble.world import World, world_without_meshes
from ...robots.declared.robot import SerialRobot
from .whole_body import Carrier, Mounting


class RobotModel:
    """Kinematics and dynamics of one robot at the angles and velocities of the last `update`.

    Each method computes its result when it is called, and returns a buffer that its next call
    overwrites.

    The Coriolis matrix C is that of the Christoffel symbols (Siciliano et al. 2009, Robotics, 7.2),
    so that dM/dt = C + C^T.

    Args:
        model: MuJoCo model with the masses of the robot, which are copied. Its other robots and
            contacts, and later payloads, are ignored. Other joints of the robot, such as those of a
            gripper or of elastic gears, are rigid.
        joints: ids of the hinge and slide joints of the robot, from base to flange.
        site: id of the site at the flange. Exactly one of `site` and `body` must be given.
        body: id of the body whose frame is the flange frame.
        name: name of the robot in error messages.

    Attributes:
        rows: leading shape of all arrays, which is () for one robot (see `RobotModels`).
        n: number of joints.
        joint_names: names of the joints without the prefix of the robot.
        position_limits: lower and upper limits, shape (n, 2), rad or m; infinite if unknown.
        velocity_limits: velocity limits, shape (n,), rad/s or m/s; infinite if unknown.
        motor_inertia: motor inertias at the joints, shape (n,), on the diagonal of M, kg m2 or kg.
        flange_position: position of the flange in the world, shape (3,), m; `update` changes it.
        flange_rotation: rotation matrix R_world_flange, shape (3, 3); `update` changes it.

    Raises:
        ValueError: the joints are not joints of one robot in ascending order, or not exactly one of
            `site` and `body` is given.
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
            found = "undefined" if site is None else "defined by a site and by a body"
            raise ValueError(f"the flange is {found}; expected a site or a body")
        ids = [int(joint) for joint in joints]
        n = len(ids)
        types = {int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)}
        trees = set(model.body_rootid[model.jnt_bodyid[ids]].tolist())
        kinds = set(model.jnt_type[ids].tolist())
        if ids != sorted(set(ids)) or len(trees) != 1 or not kinds <= types:
            raise ValueError(
                f"found joints {ids}; expected the joints of one robot, from base to flange"
            )
        self.n, self.name = n, name
        names = [model.joint(joint).name for joint in ids]
        self.joint_names = [each.partition("/")[2] or each for each in names]
        self.position_limits: Array = np.tile([-np.inf, np.inf], (n, 1))
        self.velocity_limits: Array = np.full(n, np.inf)
        self._base: Array | None = None  # T_world_base, if it is known and does not move
        self._model = skeleton(model, ids, site, body)
        self._compiled = self._model  # shared by copies
        self._take_views()

    def __copy__(self) -> RobotModel:
        """Returns an independent model without compiling it again."""
        made = object.__new__(type(self))
        made.__dict__.update(self.__dict__, _model=copy.copy(self._model))
        made._take_views()
        return made

    @classmethod
    def side_by_side(cls, models: Sequence[RobotModel], m: int = 1) -> RobotModel:
        """Returns a model of m copies of these robots in one world, joint after joint.

        Its gravity, Coriolis torques, inverse dynamics and momentum are bitwise identical to those
        of the single robots. All robots need the same gravity. The model has no flange.
        """
        made = object.__new__(cls)
        made.__dict__.update(models[0].__dict__, n=m * sum(model.n for model in models), _base=None)
        made._model = copy.copy(_repeated(m, *(model._compiled for model in models)))
        made._model.opt.gravity[:] = models[0]._model.opt.gravity
        made._take_views()
        return made

    def _take_views(self) -> None:
        self._data = data = mujoco.MjData(self._model)
        mj_fwdKinematics(self._model, data)
        n = self.n
        self._qpos: Array = data.qpos
        self._gravity, self._coriolis, self._velocities = np.zeros((3, n))
        self._mass: Array = np.zeros((n, n))
        self._jacobian: Array = np.zeros((6, n))
        self.motor_inertia: Array = self._model.dof_armature.copy()
        if self._model.nsite:
            self.flange_position: Array = data.site_xpos[0]
            self.flange_rotation: Array = data.site_xmat[0].reshape(3, 3)
        self._moving: tuple[mujoco.MjModel, mujoco.MjData] | None = None  # see `_move`
        self._has_mass = False
        self._mounting: Mounting | None = None
        self._carriers: list[Carrier] = []

    @property
    def skeleton(self) -> mujoco.MjModel:
        """The MuJoCo model behind all results: links and joints without shapes and friction."""
        return self._model

    def follow(self, *mountings: tuple[Mounting, Array, int]) -> None:
        """Includes moving bases and carried robots in the model.

        Each later `update` reads the poses of the bases, and the inertias of the carried robots.

        Args:
            mountings: for each robot in the model, its mounting, its pose T_world_base when the
                model was made, and its number of joints.
        """
        self._mounting = mountings[0][0]
        whole = {id(mounting.data): mounting.data for mounting, _, _ in mountings}
        joint, model = 0, self._model
        found: dict[int, list[tuple[Mounting, Array, int, int]]] = {key: [] for key in whole}
        for mounting, T_world_base, n in mountings:
            found[id(mounting.data)].append((mounting, T_world_base, joint, n))
            joint += n
        self._carriers = [Carrier(model, self._data, whole[key], found[key]) for key in whole]

    @classmethod
    def of(cls, robot: SerialRobot, world: World | None = None) -> RobotModel:
        """Returns the model of a robot whose base is fixed in the world (see `mounts.unmounted`).

        Args:
            world: dynamic world with this robot alone, if it has already been compiled.

        Raises:
            DeclarationError: MuJoCo cannot compile the robot.
        """
        if world is None:
            world = world_without_meshes([robot])
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
        """Moves the model to joint angles and velocities, shape (n,) each.

        The array of velocities is not copied and must not change until the next update.
        """
        self._qpos[...] = angles
        self._velocities = velocities
        self._has_mass = False
        for carrier in self._carriers:
            carrier.move_bases()
        mj_fwdKinematics(self._model, self._data)
        for carrier in self._carriers:
            carrier.add_loads()

    def _move(self, velocities: Array) -> tuple[mujoco.MjModel, mujoco.MjData]:
        # mj_rne reads velocities from cvel and cdof_dot. They remain zero in `_data`, so mj_rne
        # computes gravity alone there, and velocities alone in this model, which has no gravity.
        if self._moving is None:  # not made in `_take_views`, as this takes as long as 500 steps
            weightless = copy.copy(self._model)
            weightless.opt.gravity[:] = 0.0
            self._moving = weightless, mujoco.MjData(weightless)
        weightless, moving = self._moving
        moving.cinert[...], moving.cdof[...] = self._data.cinert, self._data.cdof
        moving.qvel[...] = velocities
        mj_comVel(weightless, moving)
        return self._moving

    def gravity(self, out: Array | None = None) -> Array:
        """Returns the torques g(q), (n,), that hold the robot still, in `out` if it is given."""
        result = self._gravity if out is None else out
        mj_rne(self._model, self._data, 0, result)
        return result

    def coriolis(self) -> Array:
        """Returns the Coriolis and centrifugal torques C(q, dq) dq, shape (n,)."""
        mj_rne(*self._move(self._velocities), 0, self._coriolis)
        return self._coriolis

    def write_inverse_dynamics(
        self, velocities: Array, accelerations: Array, torques: Array, less: Array
    ) -> None:
        """Writes two arrays whose difference is M_link(q) a + C(q, dq) v + g(q).

        These tracking torques are `torques - less`. v and a are `velocities` and `accelerations`.
        All arrays have shape (n,).
        """
        # C(q, dq) v is linear in dq and in v, and symmetric. So with c(x) = C(q, x) x it is
        # c((dq + v) / 2) - c((dq - v) / 2): two recursive Newton-Euler passes.
        half = (self._velocities + velocities) * 0.5
        weightless, moving = self._move(half)
        moving.qacc[...] = accelerations
        mj_rne(self._model, moving, 1, torques)
        np.subtract(half, velocities, moving.qvel)
        mj_comVel(weightless, moving)
        mj_rne(weightless, moving, 0, less)

    def write_momentum(self, momentum: Array, slope: Array) -> None:
        """Writes the links' momentum, and its derivative without joint torques, for an observer.

        Args:
            momentum: output array for M_link(q) dq without the motors, shape (n,).
            slope: output array for C(q, dq)^T dq - g(q), shape (n,).
        """
        # mj_rne sums axis . (inertia x acceleration) over all bodies beyond a joint. With
        # velocities instead of accelerations, the sum is the momentum.
        # C^T dq is the slope of the kinetic energy along the angles at constant dq. A rotation of
        # joint k moves all bodies beyond it, with momentum h_k, while the velocity v before it
        # stays the same. So the slope is (v x s_k) . h_k with the axis s_k: the same sum with
        # v x s_k, which MuJoCo has as cdof_dot, instead of the axes (spatial vectors as in
        # Featherstone 2008, Rigid Body Dynamics Algorithms).
        weightless, moving = self._move(self._velocities)
        slopes_of_axes = moving.cdof_dot.copy()
        moving.cvel[...], moving.cdof_dot[...] = 0.0, moving.cdof
        mj_rne(weightless, moving, 0, momentum)
        moving.cdof[...] = slopes_of_axes
        mj_rne(weightless, moving, 0, slope)
        slope -= self.gravity()

    def sparse_mass(self) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """Returns the skeleton and its data, which contain M(q) in MuJoCo's sparse format."""
        if not self._has_mass:
            mj_makeM(self._model, self._data)
            self._has_mass = True
        return self._model, self._data

    def mass(self) -> Array:
        """Returns the mass matrix M(q) with motor inertias, shape (n, n), kg m2 (kg)."""
        mj_fullM(*self.sparse_mass(), self._mass)
        return self._mass

    def jacobian(self) -> Array:
        """Returns the flange's Jacobian J(q) in world axes, shape (6, n), translation first."""
        mj_jacSite(self._model, self._data, self._jacobian[:3], self._jacobian[3:], 0)
        return self._jacobian

    def write_task_space(
        self, scale: Array, jacobian: Array, scaled: Array, over_mass: Array, gravity: Array
    ) -> None:
        """Writes the terms that are needed to control the flange.

        Args:
            scale: factor s of each axis, shape (6, 1).
            jacobian: output array for J(q), shape (6, n).
            scaled: output array for s J, shape (6, n).
            over_mass: output array for s J M^-1, shape (6, n).
            gravity: output array for g(q), shape (n,).
        """
        model, data = self.sparse_mass()
        mj_jacSite(model, data, jacobian[:3], jacobian[3:], 0)
        np.multiply(jacobian, scale, scaled)
        mj_factorM(model, data)
        mj_solveM(model, data, over_mass, scaled)
        self.gravity(gravity)

    def flange(self) -> Array:
        """Returns the flange pose T_world_flange in a new array, shape (4, 4), m."""
        return frame(self.flange_rotation, self.flange_position)

    def base(self) -> Array:
        """Returns the base pose T_world_base in a new array, shape (4, 4), m.

        If the model was not made from a declaration, the base is the body before the first joint.
        """
        if self._mounting is not None:
            data, base = self._mounting.data, self._mounting.base
            return frame(rotation_from_quat(data.xquat[base]), data.xpos[base])
        if self._base is not None:  # the compiler fuses the base with the world
            return self._base.copy()
        body = int(self._model.body_parentid[self._model.jnt_bodyid[0]])
        return frame(self._data.xmat[body].reshape(3, 3), self._data.xpos[body])


def skeleton(
    model: mujoco.MjModel, joints: Sequence[int], site: int | None, body: int | None
) -> mujoco.MjModel:
    """Returns a model of one robot without shapes, whose only site is the flange.

    The base is at the same pose as in the model. Joints that are not in `joints` are fixed at
    their initial values, and bodies that cannot move relative to each other are fused. If `site`
    is None, the frame of `body` is the flange frame.
    """
    spec = _bare_spec()
    spec.option.gravity = model.opt.gravity
    spec.compiler.fusestatic = True
    root = model.body_rootid[model.jnt_bodyid[joints[0]]]
    bodies = np.flatnonzero(model.body_rootid == root).tolist()
    copies = _copy_bodies(spec, model, bodies, joints)
    if site is not None:
        at = copies[int(model.site_bodyid[site])]
        at.add_site(name="flange", pos=model.site_pos[site], quat=model.site_quat[site])
    else:
        copies[int(body or 0)].add_site(name="flange")
    return spec.compile()


@lru_cache(maxsize=16)
def _repeated(m: int, *models: mujoco.MjModel) -> mujoco.MjModel:
    spec = _bare_spec()
    for model in models * m:
        _copy_bodies(spec, model, range(1, model.nbody), range(model.njnt))
    return spec.compile()


def _bare_spec() -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.balanceinertia = False
    return spec


def _copy_bodies(
    spec: mujoco.MjSpec, model: mujoco.MjModel, bodies: Collection[int], joints: Collection[int]
) -> dict[int, mujoco.MjsBody]:
    copies = {0: spec.worldbody}
    for old in bodies:
        copies[old] = new = copies[int(model.body_parentid[old])].add_body(
            pos=model.body_pos[old], quat=model.body_quat[old]
        )
        if model.body_mass[old] > 0.0:
            new.explicitinertial = True
            new.mass, new.inertia = model.body_mass[old], model.body_inertia[old]
            new.ipos, new.iquat = model.body_ipos[old], model.body_iquat[old]
        first = int(model.body_jntadr[old])
        for joint in range(first, first + int(model.body_jntnum[old])):
            if joint in joints:
                new.add_joint(
                    type=mujoco.mjtJoint(int(model.jnt_type[joint])),
                    pos=model.jnt_pos[joint],
                    axis=model.jnt_axis[joint],
                    ref=model.qpos0[model.jnt_qposadr[joint]],
                    armature=model.dof_armature[model.jnt_dofadr[joint]],
                )
    return copies
