"""Cartesian impedance: the flange is a spring and a damper in six directions."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from mujoco import (
    mj_factorM,
    mj_jacSite,
    mj_makeM,
    mj_rne,
    mj_solveM,
    mju_cholFactor,
    mju_cholSolve,
    mju_mat2Quat,
    mju_mulQuat,
)
from numpy import add, dot, multiply, negative, subtract
from pydantic import BeforeValidator, Field

from ..declaration import numbers
from ..errors import DeclarationError, Problem
from ..frames import Array, Matrix, Vector
from .controller import (
    DEFAULT_RATIO,
    SOFTEST,
    ControllerDeclaration,
    PerJoint,
    Ratio,
    Sensed,
    Target,
    within,
)  # fmt: skip
from .joint_control import design_damping, too_stiff, unstable_joint
from .robot_model import ModelArrays, RobotModel

# Least mobility J M^-1 J^T in any direction, as a share of its trace, with lengths in units in
# which moving and turning have equal traces. What is below is raised to it (as for inverse
# kinematics: Nakamura and Hanafusa 1986, Inverse Kinematic Solutions With Singularity Robustness).
# For the null space: of 20,000 random poses of an LWR, a Puma 560 and a Panda none with more than
# 1 % of the best manipulability has a pivot of less than 8e-6, so that there nothing leaks.
_BLOCKED = 5e-6
_LIMP = 1e-4  # for the damping, which is designed for poses some way around as well
# Nm/rad; where the null space has less stiffness than that, it is damped as if it had that.
_MIN_STIFFNESS = 1.0


def _stiffness(value: Any) -> Any:
    array = numbers(value)
    if array.shape == (6,):
        array = np.diag(array)
    if array.shape != (6, 6):
        shape = " x ".join(map(str, array.shape)) or "one number"
        raise ValueError(f"found {shape}; expected 6 numbers (x, y, z in N/m; Nm/rad) or 6 x 6")
    if np.abs(array - array.T).max() > 1e-9 * max(np.abs(array).max(), 1.0):
        raise ValueError("found a matrix that is not symmetric; expected a symmetric one")
    least = float(np.linalg.eigvalsh(array).min())
    if least < -1e-9 * max(np.abs(array).max(), 1.0):
        raise ValueError(f"found an eigenvalue of {least:g}; expected none below zero")
    return array


class CartesianImpedance(ControllerDeclaration):
    """Springs and dampers pull the flange to a target pose, and the null space to a posture.

    Attributes:
        stiffness: six numbers, N/m along and Nm/rad about x, y and z, or a symmetric 6x6 matrix.
        damping: ratio; one number.
        axes: whose x, y and z: the `world`'s, or the target `flange`'s.
        nullspace_stiffness: Nm/rad per joint, towards the target's posture.
        nullspace_damping: ratio per joint; without stiffness as for 1 Nm/rad.
        damping_every: s between two designs of the damping matrices.
    """

    needs_pose: ClassVar[bool] = True

    kind: Literal["cartesian_impedance"] = "cartesian_impedance"
    stiffness: Annotated[Array, BeforeValidator(_stiffness)] = np.diag([2e3] * 3 + [1e2] * 3)
    damping: float = Field(0.7, ge=0, le=2)
    axes: Literal["world", "flange"] = "world"
    nullspace_stiffness: Annotated[PerJoint, within(0.0, 5000.0, "Nm/rad")] = np.array([10.0])
    nullspace_damping: Ratio = DEFAULT_RATIO
    damping_every: float = Field(0.1, gt=0, le=1)

    def make(self, model: RobotModel, timestep: float) -> CartesianImpedanceController:
        """The controller, without torque limits."""
        return CartesianImpedanceController(
            model,
            self.stiffness,
            self.damping,
            timestep,
            in_flange=self.axes == "flange",
            nullspace_stiffness=self.per_joint("nullspace_stiffness", model.n),
            nullspace_damping=self.per_joint("nullspace_damping", model.n),
            damping_every=self.damping_every,
        )


class CartesianImpedanceController:
    """tau = J^T (f + D (dx_d - J dq) + wrench) + tau_null + g(q) + tau_target.

    f is minus the slope of the energy V = 1/2 e^T K e (Hogan 1985, Impedance Control: An Approach
    to Manipulation). e holds the way to the target and -2 times the vector part of the quaternion
    of R_target^T R: the angle about an axis when it is small, and defined for all rotations
    (Caccavale, Natale, Siciliano, Villani 1999, Six-DOF Impedance Control Based on Angle/Axis
    Representations, IEEE Trans. Robotics and Automation 15). At half a turn the torque fades to
    zero, as of any smooth potential on rotations.

    D is designed for K and the inertia that the flange feels, L = (J M^-1 J^T)^-1, and moves no
    energy but out. So without null space the robot with a resting target is passive (Ott 2008,
    Cartesian Impedance Control of Redundant and Flexible-Joint Robots).

    The null space is a spring and a damper behind P = 1 - J^T L J M^-1, which lets through no
    torque that would accelerate the flange (Khatib 1987, A Unified Approach for Motion and Force
    Control of Robot Manipulators). Its damper P D P^T only takes energy. Its spring behind P is
    not a potential: bounded, but not passive in the strict sense (Dietrich, Ott, Albu-Schäffer
    2015, An overview of null space projections for redundant, torque-controlled robots, IJRR 34).

    At singularities nothing is inverted but J M^-1 J^T, with its smallest pivots bounded: torques
    stay bounded, the blocked direction goes limp, and becomes part of the null space.

    Args:
        model: for itself.
        stiffness: K, (6, 6), symmetric, N/m and Nm/rad.
        damping: ratio.
        timestep: s between two calls.
        in_flange: whether K is in the axes of the target, else of the world.
        nullspace_stiffness: (n,), Nm/rad.
        nullspace_damping: ratio, (n,).
        damping_every: s.
    """

    def __init__(
        self,
        model: RobotModel,
        stiffness: Array,
        damping: float,
        timestep: float,
        *,
        in_flange: bool,
        nullspace_stiffness: Array,
        nullspace_damping: Array,
        damping_every: float = 0.04,
    ) -> None:
        n = model.n
        self.model = model
        self.stiffness: Array = np.ascontiguousarray(stiffness)
        self._ratio, self._in_flange = damping, in_flange
        self._timestep = timestep
        self._every = max(round(damping_every / timestep), 1)
        self._left = 0  # steps until the damping is designed anew
        self._null_stiffness, self._null_ratio = nullspace_stiffness, nullspace_damping
        self._null_damping: Array = np.zeros(n)
        self.work = work = _workspace(n, in_flange)
        work.null_gains[:, :n] = np.diag(nullspace_stiffness)
        self.damping: Array = work.wrench_gains[:, :6]
        vectors = [0, 1, 2, 4, 5, 6]  # of a pure quaternion the scalar is zero
        work.spring[np.ix_(vectors, vectors)] = self.stiffness * ([1.0] * 3 + [-2.0] * 3)
        self._compliance: Array | None = None  # of elastic joints, see `hold_links`
        self._rest, self._bends = np.zeros((2, n))
        self._share = 1.0

    def hold_links(self, joint_stiffness: Array) -> Array:
        """See `LinkHolder`; the null space's soft spring stays in series with the joints.

        So does a share of the flange's, where they are nearly as stiff as the joints behind it.
        """
        self._compliance = 1.0 / joint_stiffness
        return self._rest

    def prepare(self, sensed: Sensed, target: Target) -> int:
        """See `LawController`."""
        if self._left == 0:
            self.model.update(sensed.motor_angles, sensed.motor_velocities)
            self._design(target.rotation)
            self._left = self._every
        return self._left

    def pass_steps(self, steps: int) -> None:
        """See `LawController`."""
        self._left -= steps

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,)."""
        work = self.work
        self.model.update(sensed.motor_angles, sensed.motor_velocities)
        if self._left == 0:
            self.prepare(sensed, target)
        self._left -= 1
        cartesian_torques(self.model.arrays, work, sensed, target, out)
        if self._compliance is not None:
            multiply(work.spring_wrench.dot(work.jacobian, self._bends), self._share, self._rest)
            self._rest += work.gravity

    def spring_wrench(self, target: Target) -> Array:
        """f, (6,), N and Nm in world axes, where the model was last updated to.

        Args:
            target: its pose.

        Returns:
            the same array every time.
        """
        write_spring_wrench(self.model.arrays, self.work, target)
        return self.work.spring_wrench

    def check(self, angles: Array) -> None:
        """Refuses gains for which the time step is too long; see `LimitedController.check`."""
        model = self.model
        model.update(angles, np.zeros(model.n))
        jacobian, mass, rotation = model.jacobian(), model.mass(), model.flange_rotation
        self._design(rotation)
        if self._share < 1.0:
            message = (
                f"is more than {100 * SOFTEST:g} % of what the elastic joints have at the flange; "
                f"expected at most {99 * self._share:.2g} % of it"
            )
            raise DeclarationError([Problem("stiffness", message)])
        back = np.linalg.solve(mass, jacobian.T)
        felt = self._inertia(jacobian @ back, _BLOCKED)
        through = np.eye(model.n) - jacobian.T @ felt @ back.T
        stiffness = (
            jacobian.T @ self._in_world(rotation) @ jacobian + through * self._null_stiffness
        )
        damping = jacobian.T @ self.damping @ jacobian + through * self._null_damping @ through.T
        joint = unstable_joint(mass, stiffness, damping, self._timestep)
        if joint is not None:
            raise too_stiff(model.joint_names[joint], "", self._timestep)

    def _in_world(self, rotation: Array) -> Array:
        """K in the world's axes, (6, 6)."""
        if not self._in_flange:
            return self.stiffness
        axes = np.kron(np.eye(2), rotation)
        return np.asarray(axes @ self.stiffness @ axes.T)

    def _inertia(self, mobility: Array, least: float) -> Array:
        """L, (6, 6): what the flange feels, its mobility being raised to a least one.

        Args:
            mobility: J M^-1 J^T, (6, 6).
            least: as a share of the trace.
        """
        per_length = self.work.per_length * self.work.per_length.T
        values, vectors = np.linalg.eigh(mobility * per_length)
        bounded = np.maximum(values, least * values.sum())
        return np.asarray((vectors / bounded) @ vectors.T * per_length)

    def _design(self, rotation: Array) -> None:
        jacobian, work = self.model.jacobian(), self.work
        mobility = jacobian @ np.linalg.solve(self.model.mass(), jacobian.T)
        of_moving, of_turning = np.diagonal(mobility).reshape(2, 3).sum(axis=1).tolist()
        if of_moving > 0 and of_turning > 0:  # a robot may do one of them only
            work.per_length[:3] = np.sqrt(of_turning / of_moving)
        work.wrench_gains[:, 12:] = np.diag(-work.per_length[:, 0])
        work.least_pivot[0] = _BLOCKED * max(2.0 * of_turning, of_moving)
        felt = self._inertia(mobility, _LIMP)
        self.damping[:] = design_damping(felt, self._in_world(rotation), self._ratio)
        stiffness = np.maximum(self._null_stiffness, _MIN_STIFFNESS)
        inertia = np.diagonal(self.model.mass())
        self._null_damping[:] = 2.0 * self._null_ratio * np.sqrt(inertia * stiffness)
        n = self.model.n
        np.fill_diagonal(work.null_gains[:, n:], -self._null_damping)
        if self._compliance is not None:
            root = jacobian * np.sqrt(self._compliance)
            most = float(np.linalg.eigvalsh(root.T @ self._in_world(rotation) @ root)[-1])
            self._share = min(1.0, SOFTEST / max(most, SOFTEST))


class CartesianWork(NamedTuple):
    """What a step of a Cartesian impedance is computed with.

    numpy takes longer to call, and to make arrays and views, than to compute. So sums of products
    are products of matrices side by side, and all views are made once:

        tau_0  = null_gains   [q_0 - q; P^T dq]                    with [K_0 -D_0]
        wrench = wrench_gains [dx_d - J dq; f; L J M^-1 tau_0]     with [D 1 -1]
        tau    = [wrench tau_0 g] torque_gains                     with [J; 1; 1]

    The last term of the wrench is per unit of length, see `_BLOCKED`, as are `scaled_jacobian`,
    `jacobian_over_mass` (J M^-1) and `mobility` (J M^-1 J^T). The way to the target and the
    quaternion to the flange (`error`) give, by `spring`, a force and a pure quaternion (`pull`).
    """

    in_flange: bool
    least_pivot: Vector  # (1,), of the mobility
    per_length: Matrix  # (6, 1)
    null_gains: Matrix  # (n, 2n)
    null_terms: Vector
    posture_error: Vector
    null_velocities: Vector
    wrench_gains: Matrix  # (6, 18)
    wrench_terms: Vector
    twist_error: Vector
    spring_wrench: Vector
    force: Vector
    moment: Vector
    taken: Vector
    torque_gains: Matrix  # (6 + 2n, n)
    jacobian: Matrix
    linear: Matrix
    angular: Matrix
    torque_terms: Vector
    wrench: Vector
    inner: Vector
    gravity: Vector
    scaled_jacobian: Matrix
    jacobian_over_mass: Matrix
    mobility: Matrix
    solved: Vector
    spring: Matrix  # (7, 7)
    error: Vector
    way: Vector
    quaternion: Vector
    pull: Vector
    pull_of_way: Vector
    pull_of_turn: Vector
    torque: Vector  # a quaternion
    torque_vector: Vector
    back: Matrix  # R_target_world
    turn: Matrix
    turn_numbers: Vector


def _workspace(n: int, in_flange: bool) -> CartesianWork:
    """That of a robot with n joints, without gains."""
    null_terms, wrench_terms, torque_terms = np.zeros(2 * n), np.zeros(18), np.zeros(6 + 2 * n)
    torque_gains: Array = np.vstack([np.zeros((6, n)), np.eye(n), np.eye(n)])
    turn: Array = np.zeros((3, 3))
    error, pull, torque = np.zeros(7), np.zeros(7), np.zeros(4)
    return CartesianWork(
        in_flange=in_flange,
        least_pivot=np.array([_BLOCKED]),
        per_length=np.ones((6, 1)),
        null_gains=np.zeros((n, 2 * n)),
        null_terms=null_terms,
        posture_error=null_terms[:n],
        null_velocities=null_terms[n:],
        wrench_gains=np.hstack([np.zeros((6, 6)), np.eye(6), -np.eye(6)]),
        wrench_terms=wrench_terms,
        twist_error=wrench_terms[:6],
        spring_wrench=wrench_terms[6:12],
        force=wrench_terms[6:9],
        moment=wrench_terms[9:12],
        taken=wrench_terms[12:],
        torque_gains=torque_gains,
        jacobian=torque_gains[:6],
        linear=torque_gains[:3],
        angular=torque_gains[3:6],
        torque_terms=torque_terms,
        wrench=torque_terms[:6],
        inner=torque_terms[6 : 6 + n],
        gravity=torque_terms[6 + n :],
        scaled_jacobian=np.zeros((6, n)),
        jacobian_over_mass=np.zeros((6, n)),
        mobility=np.zeros((6, 6)),
        solved=np.zeros(6),
        spring=np.zeros((7, 7)),
        error=error,
        way=error[:3],
        quaternion=error[3:],
        pull=pull,
        pull_of_way=pull[:3],
        pull_of_turn=pull[3:],
        torque=torque,
        torque_vector=torque[1:],
        back=np.zeros((3, 3)),
        turn=turn,
        turn_numbers=turn.reshape(9),
    )


def cartesian_torques(
    robot: ModelArrays, work: CartesianWork, sensed: Sensed, target: Target, out: Array
) -> None:
    """The law of `CartesianImpedanceController`, see `LawController`."""
    jacobian, J, J_over_M = work.jacobian, work.scaled_jacobian, work.jacobian_over_mass
    mobility, solved, inner = work.mobility, work.solved, work.inner
    velocities = sensed.motor_velocities
    mj_jacSite(robot.model, robot.data, work.linear, work.angular, 0)
    multiply(jacobian, work.per_length, J)
    mj_makeM(robot.model, robot.data)
    mj_factorM(robot.model, robot.data)
    mj_solveM(robot.model, robot.data, J_over_M, J)
    dot(J, J_over_M.T, mobility)
    # L = (J M^-1 J^T)^-1 is only ever solved with
    mju_cholFactor(mobility, work.least_pivot[0])

    # tau_0 = K_0 (q_0 - q) - D_0 P^T dq, and P tau_0 = tau_0 - J^T L J M^-1 tau_0
    mju_cholSolve(solved, mobility, J.dot(velocities))
    subtract(target.posture, sensed.motor_angles, work.posture_error)
    subtract(velocities, solved.dot(J_over_M), work.null_velocities)
    dot(work.null_gains, work.null_terms, inner)
    mju_cholSolve(work.taken, mobility, J_over_M.dot(inner))
    subtract(target.twist, jacobian.dot(velocities), work.twist_error)
    write_spring_wrench(robot, work, target)
    dot(work.wrench_gains, work.wrench_terms, work.wrench)
    if target.has_torques:
        add(work.wrench, target.wrench, work.wrench)
        add(inner, target.torques, inner)
    mj_rne(robot.model, robot.data, 0, work.gravity)
    dot(work.torque_terms, work.torque_gains, out)


def write_spring_wrench(robot: ModelArrays, work: CartesianWork, target: Target) -> None:
    """Writes f into `work.spring_wrench`, N and Nm in world axes.

    With the unit quaternion (w, v) from the target to the flange, w >= 0, the torque is
    (w + S(v)) f_r: the slope of v along rotations, and the vector of (w, v) times (0, f_r).
    """
    back, way, quaternion = work.back, work.way, work.quaternion
    force, moment = work.force, work.moment
    back[...] = target.rotation.T
    subtract(target.position, robot.flange_position, way)
    if work.in_flange:
        way[...] = back.dot(way)
        dot(back, robot.flange_rotation, work.turn)
    else:
        dot(robot.flange_rotation, back, work.turn)
    mju_mat2Quat(quaternion, work.turn_numbers)
    if quaternion[0] < 0.0:
        negative(quaternion, quaternion)
    dot(work.spring, work.error, work.pull)
    mju_mulQuat(work.torque, quaternion, work.pull_of_turn)
    force[...] = work.pull_of_way
    moment[...] = work.torque_vector
    if work.in_flange:
        force[...] = force.dot(back)
        moment[...] = moment.dot(back)
