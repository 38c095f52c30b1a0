"""Cartesian impedance control of the flange, with a null space for redundant robots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from mujoco import mju_cholFactor, mju_cholSolve, mju_mat2Quat, mju_mulQuat
from numpy import add, dot, multiply, negative, subtract
from pydantic import BeforeValidator, Field

from ...base.declaration import numbers
from ...base.errors import Problem
from ...base.frames import Array
from ...robots.declared.robot import SerialRobot
from .controller import (
    DEFAULT_RATIO,
    SOFTEST,
    Controller,
    ControllerDeclaration,
    PerJoint,
    Ratio,
    Sensed,
    Slider,
    Target,
    range_text,
    within,
)  # fmt: skip
from .joint_control import damping_slider, design_damping, too_stiff, unstable_joint
from .robot_model import RobotModel
from .robot_models import RobotModels

# Minimum mobility J M^-1 J^T in any direction, as a share of its trace, in units of length in which
# translation and rotation have equal traces. Lower values are raised to the minimum (as for inverse
# kinematics: Nakamura and Hanafusa 1986, Inverse Kinematic Solutions With Singularity Robustness).
# Of 20,000 random poses of an LWR, a Puma 560 and a Panda, none with more than 1 % of the maximum
# manipulability has a pivot below 8e-6, so the null space is exact there.
_BLOCKED = 5e-6
_LIMP = 1e-4  # higher minimum to design the damping, which must also suit nearby poses
_MIN_STIFFNESS = 1.0  # minimum stiffness for which the null space is damped, Nm/rad
# Maxima of sliders, N/m and Nm/rad.
_SLIDER_TRANSLATION, _SLIDER_ROTATION, _SLIDER_NULLSPACE = 5000.0, 300.0, 200.0


def _stiffness(value: Any) -> Any:
    array = numbers(value)
    if array.shape == (6,):
        array = np.diag(array)
    if array.shape != (6, 6):
        shape = " x ".join(map(str, array.shape)) or "one number"
        raise ValueError(f"found {shape}; expected 6 numbers (N/m, Nm/rad), or 6 x 6 numbers")
    if np.abs(array - array.T).max() > 1e-9 * max(np.abs(array).max(), 1.0):
        raise ValueError("found a matrix that is not symmetric; expected a symmetric matrix")
    lowest = float(np.linalg.eigvalsh(array).min())
    if lowest < -1e-9 * max(np.abs(array).max(), 1.0):
        expected = "no negative eigenvalue"
        raise Problem("", "found an eigenvalue of", found=lowest, expected=expected).error()
    return array


class CartesianImpedance(ControllerDeclaration):
    """Pulls the flange to a target pose and the null space to a posture with springs and dampers.

    Attributes:
        stiffness: stiffness along (N/m) and about (Nm/rad) x, y and z, or a symmetric 6x6 matrix.
        damping: damping ratio of the flange.
        axes: axes of the stiffness: `world`, or `flange` for the axes of the target pose.
        nullspace_stiffness: stiffness toward the posture of the target, Nm/rad per joint.
        nullspace_damping: damping ratio of the null space per joint, designed for the null-space
            stiffness, or for 1 Nm/rad if it is lower.
        damping_every: time between two designs of the damping matrices, s.
    """

    needs_pose: ClassVar[bool] = True
    title: ClassVar[str] = "Cartesian impedance"
    short: ClassVar[str] = "cartesian"
    order: ClassVar[int] = 30

    kind: Literal["cartesian_impedance"] = "cartesian_impedance"
    stiffness: Annotated[Array, BeforeValidator(_stiffness)] = np.diag([2e3] * 3 + [1e2] * 3)
    damping: float = Field(0.7, ge=0, le=2)
    axes: Literal["world", "flange"] = "world"
    nullspace_stiffness: Annotated[PerJoint, within(0.0, 5000.0, "Nm/rad")] = np.array([10.0])
    nullspace_damping: Ratio = DEFAULT_RATIO
    damping_every: float = Field(0.1, gt=0, le=1)

    def softer(self) -> Self | None:
        return self.changed({"stiffness": self.stiffness / 2})

    def sliders(self, robot: SerialRobot, first: Self) -> list[Slider]:
        along, about = float(self.stiffness[0, 0]), float(self.stiffness[3, 3])

        def describe(fields: Mapping[str, Any]) -> str:
            matrix = np.asarray(fields["stiffness"])
            return f"{matrix[0, 0]:.4g} N/m and {matrix[3, 3]:.4g} Nm/rad"

        return [
            Slider("stiffness", along, _SLIDER_TRANSLATION, "%.0f N/m",
                   lambda value: {"stiffness": np.diag([value] * 3 + [about] * 3)}, describe),
            Slider("rotational", about, _SLIDER_ROTATION, "%.0f Nm/rad",
                   lambda value: {"stiffness": np.diag([along] * 3 + [value] * 3)}, describe),
            damping_slider(self.damping, lambda value: value),
            Slider("null space", float(self.nullspace_stiffness[0]), _SLIDER_NULLSPACE,
                   "%.0f Nm/rad", lambda value: {"nullspace_stiffness": np.array([value])},
                   range_text("nullspace_stiffness", "Nm/rad"),
                   "stiffness towards the posture, without moving the flange"),
        ]  # fmt: skip

    def make(
        self, model: RobotModel | RobotModels, timestep: float
    ) -> CartesianImpedanceController:
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


class CartesianImpedanceController(Controller):
    """Control law tau = J^T (f + D (dx_d - J dq) + wrench) + tau_null + g(q) + tau_target.

    f is the negative gradient of the energy V = 1/2 e^T K e (Hogan 1985, Impedance Control: An
    Approach to Manipulation). e contains the vector to the target and -2 times the vector part of
    the quaternion of R_target^T R. For small rotations the latter is the angle about an axis, and
    it is defined for all rotations (Caccavale, Natale, Siciliano, Villani 1999, Six-DOF Impedance
    Control Based on Angle/Axis Representations, IEEE Trans. Robotics and Automation 15). At 180
    degrees the torque is zero, as for any smooth potential on rotations.

    D is designed for K and the inertia at the flange, L = (J M^-1 J^T)^-1, and only dissipates
    energy. Without null space, the robot with a resting target is therefore passive (Ott 2008,
    Cartesian Impedance Control of Redundant and Flexible-Joint Robots).

    The null space has a spring and a damper behind the projection P = 1 - J^T L J M^-1, which
    removes torques that would accelerate the flange (Khatib 1987, A Unified Approach for Motion and
    Force Control of Robot Manipulators). Its damper P D P^T only dissipates energy. Its spring
    behind P has no potential: its energy is bounded, but it is not strictly passive (Dietrich, Ott,
    Albu-Schäffer 2015, An overview of null space projections for redundant, torque-controlled
    robots, IJRR 34).

    Only J M^-1 J^T is inverted, and its smallest pivots are bounded. At singularities, torques are
    therefore bounded, and the blocked direction has no stiffness and belongs to the null space.

    Args:
        stiffness: symmetric stiffness matrix K, shape (6, 6) or (m, 6, 6), N/m and Nm/rad.
        damping: damping ratio of the flange, scalar or shape (m, 1).
        timestep: time between two calls, s.
        in_flange: whether K is in the axes of the target instead of the world.
        nullspace_stiffness: stiffness in the null space, shape (n,) or (m, n), Nm/rad.
        nullspace_damping: damping ratio in the null space, shape (n,) or (m, n).
        damping_every: time between two designs of the damping, s.
    """

    def __init__(
        self,
        model: RobotModel | RobotModels,
        stiffness: Array,
        damping: float | Array,
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
        self._left = 0  # steps until the next design of the damping
        self._null_stiffness, self._null_ratio = nullspace_stiffness, nullspace_damping
        self._null_damping: Array = np.zeros((*model.rows, n))
        self._compliance: Array | None = None  # compliance of elastic joints, see `hold_links`
        self._share: Array = np.ones((*model.rows, 1))
        self._arrange(n, model.rows)
        self._null_gains[..., :n] = nullspace_stiffness[..., None] * np.eye(n)
        vectors = np.array([0, 1, 2, 4, 5, 6])  # the scalar of a pure quaternion is zero
        signed = self.stiffness * ([1.0] * 3 + [-2.0] * 3)
        self._spring[..., vectors[:, None], vectors] = signed

    @property
    def group(self) -> tuple[object, ...]:
        return type(self), tuple(self.model.joint_names), self._every, self._in_flange

    @classmethod
    def joined(cls, each: Sequence[Self], robots: int, model: RobotModels) -> Self:
        first = each[0]
        stiffness, null_stiffness, null_ratio = (
            np.array(values)
            for values in zip(
                *((one.stiffness, one._null_stiffness, one._null_ratio) for one in each),
                strict=True,
            )
        )
        return cls(
            model,
            stiffness,
            np.array([[one._ratio] for one in each]),
            first._timestep,
            in_flange=first._in_flange,
            nullspace_stiffness=null_stiffness,
            nullspace_damping=null_ratio,
            damping_every=first._every * first._timestep,
        )

    def _arrange(self, n: int, rows: tuple[int, ...]) -> None:
        # NumPy calls, new arrays and new views take longer than the computation. Therefore sums of
        # products are computed as products of block matrices, and all views are made once:
        #
        #     tau_0  = null_gains   [q_0 - q; P^T dq]                    with [K_0 -D_0]
        #     wrench = wrench_gains [dx_d - J dq; f; L J M^-1 tau_0]     with [D 1 -1]
        #     tau    = [wrench tau_0 g] torque_gains                     with [J; 1; 1]
        #
        # The last term of the wrench is per unit of length (see `_BLOCKED`), and so are the
        # Jacobian J and the mobility J M^-1 J^T in it. MuJoCo functions are called row by row.

        def zeros(*shape: int) -> Array:
            return np.zeros((*rows, *shape))

        # Products: matrix and vector, vector and matrix, two matrices.
        self._products = (np.matvec, np.vecmat, np.matmul) if rows else (dot, dot, dot)
        self._null_gains = zeros(n, 2 * n)
        self._null_terms = zeros(2 * n)
        self._posture_error = self._null_terms[..., :n]
        self._null_velocities = self._null_terms[..., n:]
        self._wrench_gains = zeros(6, 18)
        self._wrench_gains[...] = np.hstack([np.zeros((6, 6)), np.eye(6), -np.eye(6)])
        self.damping: Array = self._wrench_gains[..., :6]
        self._wrench_terms = zeros(18)
        self._twist_error = self._wrench_terms[..., :6]
        self._spring_wrench = self._wrench_terms[..., 6:12]
        taken = self._taken = self._wrench_terms[..., 12:]
        self._force, self._moment = self._spring_wrench[..., :3], self._spring_wrench[..., 3:]
        self._torque_gains = zeros(6 + 2 * n, n)
        self._torque_gains[..., 6:, :] = np.vstack([np.eye(n), np.eye(n)])
        self._jacobian: Array = self._torque_gains[..., :6, :]
        self._torque_terms = zeros(6 + 2 * n)
        self._wrench = self._torque_terms[..., :6]
        self._inner = self._torque_terms[..., 6 : 6 + n]
        self._gravity = self._torque_terms[..., 6 + n :]
        self._per_length = zeros(6, 1) + 1.0
        self._rest, self._bends = zeros(n), zeros(n)
        self._scaled_jacobian, self._jacobian_over_mass = zeros(6, n), zeros(6, n)
        self._mass_jacobian = self._jacobian_over_mass.mT
        self._mobility, self._solved = zeros(6, 6), zeros(6)
        # Maps the vector to the target and the quaternion to the flange to a force and a pure
        # quaternion.
        self._spring = zeros(7, 7)
        self._error, self._pull = zeros(7), zeros(7)
        self._way, quaternion = self._error[..., :3], self._error[..., 3:]
        self._pull_of_way, pull_of_turn = self._pull[..., :3], self._pull[..., 3:]
        torque = zeros(4)  # a quaternion
        self._torque_vector: Array = torque[..., 1:]
        self._back, self._turn = zeros(3, 3), zeros(3, 3)  # R_target_world, R_target_flange
        # For each row: the minimum pivot of its mobility, and views for MuJoCo functions.
        self._min_pivots: list[float] = []
        mobilities = self._mobility.reshape(-1, 6, 6)
        self._solved_rows = list(zip(mobilities, self._solved.reshape(-1, 6), strict=True))
        self._taken_rows = list(zip(mobilities, taken.reshape(-1, 6), strict=True))
        quaternions = quaternion.reshape(-1, 4)
        self._turn_rows = list(zip(quaternions, self._turn.reshape(-1, 9), strict=True))
        self._torque_rows = list(
            zip(torque.reshape(-1, 4), quaternions, pull_of_turn.reshape(-1, 4), strict=True)
        )

    def hold_links(self, joint_stiffness: Array) -> Array:
        # The soft spring of the null space remains in series with the joints, and so does a part of
        # the stiffness of the flange if it is close to that of the joints.
        self._compliance = 1.0 / joint_stiffness
        return self._rest

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        model, velocities = self.model, sensed.motor_velocities
        model.update(sensed.motor_angles, velocities)
        if self._left == 0:
            self._design(target.rotation)
            self._left = self._every
        self._left -= 1
        jacobian, J, J_over_M = self._jacobian, self._scaled_jacobian, self._jacobian_over_mass
        solved, inner, null_velocities = self._solved, self._inner, self._null_velocities
        twist_error, taken = self._twist_error, self._taken
        times, from_left, product = self._products
        model.write_task_space(self._per_length, jacobian, J, J_over_M, self._gravity)
        product(J, self._mass_jacobian, self._mobility)

        # tau_0 = K_0 (q_0 - q) - D_0 P^T dq, and P tau_0 = tau_0 - J^T L J M^-1 tau_0
        times(J, velocities, solved)
        for (mobility, row), lowest in zip(self._solved_rows, self._min_pivots, strict=True):
            mju_cholFactor(mobility, lowest)  # L = (J M^-1 J^T)^-1 is not computed
            mju_cholSolve(row, mobility, row)
        subtract(target.posture, sensed.motor_angles, self._posture_error)
        from_left(solved, J_over_M, null_velocities)
        subtract(velocities, null_velocities, null_velocities)
        times(self._null_gains, self._null_terms, inner)
        times(J_over_M, inner, taken)
        for mobility, row in self._taken_rows:
            mju_cholSolve(row, mobility, row)
        times(jacobian, velocities, twist_error)
        subtract(target.twist, twist_error, twist_error)
        self.spring_wrench(target)
        times(self._wrench_gains, self._wrench_terms, self._wrench)
        if target.has_torques:
            add(self._wrench, target.wrench, self._wrench)
            add(inner, target.torques, inner)
        from_left(self._torque_terms, self._torque_gains, out)
        if self._compliance is not None:
            from_left(self._spring_wrench, jacobian, self._bends)
            multiply(self._bends, self._share, self._rest)
            self._rest += self._gravity

    def spring_wrench(self, target: Target) -> Array:
        """Returns the spring wrench f in world axes at the model's last update, (6,), N and Nm.

        With the unit quaternion (w, v) from the target to the flange, w >= 0, the torque is
        (w + S(v)) f_r: the derivative of v with respect to rotations, and the vector part of the
        product of (w, v) and (0, f_r). The array is overwritten by the next call.
        """
        model, back, way = self.model, self._back, self._way
        force, moment = self._force, self._moment
        times, from_left, product = self._products
        back[...] = target.rotation.mT
        subtract(target.position, model.flange_position, way)
        if self._in_flange:
            way[...] = times(back, way)
            product(back, model.flange_rotation, self._turn)
        else:
            product(model.flange_rotation, back, self._turn)
        for quaternion, turn in self._turn_rows:
            mju_mat2Quat(quaternion, turn)
            if quaternion[0] < 0.0:
                negative(quaternion, quaternion)
        times(self._spring, self._error, self._pull)
        for torque, quaternion, pull in self._torque_rows:
            mju_mulQuat(torque, quaternion, pull)
        force[...] = self._pull_of_way
        moment[...] = self._torque_vector
        if self._in_flange:
            force[...] = from_left(force, back)
            moment[...] = from_left(moment, back)
        return self._spring_wrench

    def check(self, angles: Array) -> None:
        model = self.model
        model.update(angles, np.zeros(model.n))
        jacobian, mass, rotation = model.jacobian(), model.mass(), model.flange_rotation
        self._design(rotation)
        share = float(self._share.min())
        if share < 1.0:
            message = (
                f"is above {100 * SOFTEST:g} % of the stiffness of the elastic joints at the "
                f"flange; expected at most {99 * share:.2g} % of this stiffness"
            )
            raise Problem("stiffness", message).error()
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
        if not self._in_flange:
            return self.stiffness
        axes: Array = np.zeros(self.stiffness.shape)
        axes[..., :3, :3] = axes[..., 3:, 3:] = rotation
        return np.asarray(axes @ self.stiffness @ axes.mT)

    def _inertia(self, mobility: Array, lowest: float) -> Array:
        per_length = self._per_length * self._per_length.mT
        values, vectors = np.linalg.eigh(mobility * per_length)
        bounded = np.maximum(values, lowest * values.sum(axis=-1, keepdims=True))
        return np.asarray((vectors / bounded[..., None, :]) @ vectors.mT * per_length)

    def _design(self, rotation: Array) -> None:
        n, jacobian, mass = self.model.n, self.model.jacobian(), self.model.mass()
        mobility = jacobian @ np.linalg.solve(mass, jacobian.mT)
        of_axes = np.diagonal(mobility, axis1=-2, axis2=-1)
        of_moving, of_turning = of_axes[..., :3].sum(axis=-1), of_axes[..., 3:].sum(axis=-1)
        # Some robots only translate, or only rotate.
        does_both = (of_moving > 0) & (of_turning > 0)
        ratio = np.divide(of_turning, of_moving, out=np.ones(does_both.shape), where=does_both)
        self._per_length[..., :3, 0] = np.sqrt(ratio)[..., None]
        self._wrench_gains[..., 12:] = -self._per_length * np.eye(6)
        lowest = _BLOCKED * np.maximum(2.0 * of_turning, of_moving)
        self._min_pivots = np.atleast_1d(lowest).tolist()
        felt = self._inertia(mobility, _LIMP)
        self.damping[...] = design_damping(felt, self._in_world(rotation), self._ratio)
        stiffness = np.maximum(self._null_stiffness, _MIN_STIFFNESS)
        inertia = np.diagonal(mass, axis1=-2, axis2=-1)
        self._null_damping[...] = 2.0 * self._null_ratio * np.sqrt(inertia * stiffness)
        self._null_gains[..., n:] = -self._null_damping[..., None] * np.eye(n)
        if self._compliance is not None:
            root = jacobian * np.sqrt(self._compliance)
            largest = np.linalg.eigvalsh(root.mT @ self._in_world(rotation) @ root)[..., -1:]
            self._share[...] = SOFTEST / np.maximum(largest, SOFTEST)
