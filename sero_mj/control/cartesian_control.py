"""Cartesian impedance: the flange is a spring and a damper in six directions."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
from mujoco import mju_cholFactor, mju_cholSolve, mju_mat2Quat, mju_mulQuat
from numpy import add, negative, subtract
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from ..declaration import numbers
from .damping import design_damping, too_stiff, unstable_joint
from .gains import DEFAULT_RATIO, ControllerDeclaration, PerJoint, Ratio, within
from .robot_model import RobotModel
from .state import Sensed, Target

Array = NDArray[np.float64]

# Below this smallest eigenvalue of J M^-1 J^T, 1/kg or 1/(kg m2), the flange counts as all but
# blocked in a direction, and its mobility is raised by up to as much (as for inverse kinematics:
# Nakamura and Hanafusa 1986, Inverse Kinematic Solutions With Singularity Robustness).
_BLOCKED = 0.01
_TINY = 1e-15  # what the pivots of its inverse are at least
# Nm/rad; where the null space has less stiffness than that, it is damped as if it had that.
_LEAST_STIFFNESS = 1.0


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
    """The flange is drawn to the target's pose; what is left of the joints, to its posture.

    Attributes:
        stiffness: six numbers, N/m along and Nm/rad about x, y and z, or a symmetric 6x6 matrix.
        damping: ratio; one number.
        axes: whose x, y and z: the `world`'s, or the target `flange`'s.
        nullspace_stiffness: Nm/rad per joint, towards the target's posture.
        nullspace_damping: ratio per joint; without stiffness as for 1 Nm/rad.
        damping_every: s between two designs of the damping matrices.
    """

    kind: Literal["cartesian_impedance"] = "cartesian_impedance"
    stiffness: Annotated[Array, BeforeValidator(_stiffness)] = np.diag([2e3] * 3 + [1e2] * 3)
    damping: float = Field(0.7, ge=0, le=2)
    axes: Literal["world", "flange"] = "world"
    nullspace_stiffness: Annotated[PerJoint, within(0.0, 5000.0, "Nm/rad")] = np.array([10.0])
    nullspace_damping: Ratio = DEFAULT_RATIO
    damping_every: float = Field(0.1, gt=0, le=1)

    def make(self, model: RobotModel, timestep: float) -> CartesianImpedanceController:
        """The controller at work."""
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

    At singularities nothing is inverted but L, with its smallest eigenvalues bounded: torques
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
        self._every = max(round(damping_every / timestep), 1)
        self._left = 0
        self._timestep = timestep
        self._regularise: Array = np.zeros((6, 6))
        self._is_near = False  # to a singularity
        self._spring = nullspace_stiffness
        self._spring_ratio = nullspace_damping
        self._damper: Array = np.zeros(n)
        self._between: Array = np.zeros((3, 3))
        self._between_flat = self._between.reshape(9)
        # Way and quaternion to a force and a pure quaternion, whose scalar is zero: K in between.
        self._error: Array = np.zeros(7)
        self._way, self._quaternion = self._error[:3], self._error[3:]
        self._spring_of: Array = np.zeros((7, 7))
        vectors = [0, 1, 2, 4, 5, 6]
        self._spring_of[np.ix_(vectors, vectors)] = self.stiffness * ([1.0] * 3 + [-2.0] * 3)
        self._pull: Array = np.zeros(7)
        self._torque, self._force = np.zeros(4), np.zeros(6)
        self._is_bilinear = not (in_flange or self.stiffness[:3, 3:].any())
        self._make_sums()
        self._look_at(np.eye(4))

    def _make_sums(self) -> None:
        """Makes a product of every sum: numpy takes longer to call than to compute."""
        n, one = self.model.n, np.eye(self.model.n)
        # [D -D K_p -K_p K_r 1 -1] [dx_d; J dq; x_d; x; R R_d^T; f; L J M^-1 tau_0]
        self._wrench_of: Array = np.zeros((6, 39))
        self.damping: Array = self._wrench_of[:, :6]
        if self._is_bilinear:
            self._wrench_of[:3, 12:15] = self.stiffness[:3, :3]
            self._wrench_of[:3, 15:18] = -self.stiffness[:3, :3]
            self._wrench_of[3:, 18:27] = _turning_stiffness(self.stiffness[3:, 3:])
        self._wrench_of[:, 27:33], self._wrench_of[:, 33:] = np.eye(6), -np.eye(6)
        wrenches: Array = np.zeros(39)
        wanted, twist, to, here, turn, drawn, taken = np.split(wrenches, [6, 12, 15, 18, 27, 33])
        # [K_0 -K_0 -D_0 D_0] [q_0; q; dq; M^-1 J^T L J dq]
        spring = np.diag(self._spring)
        self._inner_of: Array = np.hstack([spring, -spring, 0 * one, 0 * one])
        states: Array = np.zeros(4 * n)
        posture, state, seen = np.split(states, [n, 3 * n])
        # [wrench tau_0 g] [J; 1; 1]
        self._torque_of: Array = np.vstack([np.zeros((6, n)), one, one])
        jacobian: Array = self._torque_of[:6]
        torques: Array = np.zeros(6 + 2 * n)
        wrench, inner, gravity = np.split(torques, [6, 6 + n])
        back, mobility = np.zeros((6, n)), np.zeros((6, 6))
        turned = np.zeros((3, 3))
        # What every step needs, in one place: looking things up takes time as well.
        self._hot = (
            jacobian, jacobian[:3], jacobian[3:], back, back.T, mobility, np.zeros(6),
            wrenches, wanted, twist, to, here, turn.reshape(3, 3), turned, turned.T, drawn, taken,
            states, posture, state, seen, torques, wrench, inner, gravity,
        )  # fmt: skip

    def _look_at(self, pose: Array) -> None:
        """Takes views of a target's pose, which is the same array at every step."""
        self._pose = pose
        self._position, self._rotation = pose[:3, 3], pose[:3, :3]
        self._rotation_back = self._rotation.T

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        """Writes the torques of this step, (n,)."""
        (
            jacobian, linear, angular, back, back_transposed, mobility, solved,
            wrenches, wanted, twist, to, here, turn, turned, turned_back, drawn, taken,
            states, posture, state, seen, parts, wrench, inner, gravity,
        ) = self._hot  # fmt: skip
        model = self.model
        velocities = sensed.motor_velocities
        model.update(sensed.motor_angles, velocities)
        model.write_jacobian(linear, angular)
        model.over_mass(jacobian, back)  # J M^-1
        jacobian.dot(back_transposed, mobility)
        if self._left == 0:
            self._design(mobility, target.pose)
            self._left = self._every
        self._left -= 1
        if self._is_near:
            add(mobility, self._regularise, mobility)
        mju_cholFactor(mobility, _TINY)  # in its place: it is only ever solved with

        wanted[...] = target.twist
        jacobian.dot(velocities, twist)
        if self._is_bilinear:
            if target.pose is not self._pose:
                self._look_at(target.pose)
            to[...], here[...], turned[...] = self._position, model.flange_position, self._rotation
            model.flange_rotation.dot(turned_back, turn)
        else:
            drawn[...] = self._draw(target.pose)

        # P tau_0 + J^T wrench = tau_0 + J^T (wrench - L J M^-1 tau_0), and P^T dq in tau_0
        mju_cholSolve(solved, mobility, twist)
        solved.dot(back, seen)
        posture[...], state[...] = target.posture, sensed.motor_state
        self._inner_of.dot(states, inner)
        back.dot(inner, solved)
        mju_cholSolve(taken, mobility, solved)
        self._wrench_of.dot(wrenches, wrench)
        if target.has_torques:
            add(wrench, target.wrench, wrench)
        model.gravity(gravity)
        parts.dot(self._torque_of, out)
        if target.has_torques:
            add(out, target.torques, out)

    def _draw(self, pose: Array) -> Array:
        """Returns f from where the model was last updated to, for any K.

        With the unit quaternion (w, v) from the target to the flange, w >= 0, the torque is
        (w + S(v)) f_r: the slope of v along rotations, and the vector of (w, v) times (0, f_r).
        """
        if pose is not self._pose:
            self._look_at(pose)
        model, quaternion, way, force = self.model, self._quaternion, self._way, self._force
        subtract(self._position, model.flange_position, way)
        if self._in_flange:
            self._rotation_back.dot(model.flange_rotation, self._between)
            way[:] = self._rotation_back.dot(way)
        else:  # v in the world's axes, in one
            model.flange_rotation.dot(self._rotation_back, self._between)
        mju_mat2Quat(quaternion, self._between_flat)
        if quaternion.item(0) < 0.0:
            negative(quaternion, quaternion)
        self._spring_of.dot(self._error, self._pull)
        mju_mulQuat(self._torque, quaternion, self._pull[3:])
        force[:3], force[3:] = self._pull[:3], self._torque[1:]
        if self._in_flange:
            force[:] = force.reshape(2, 3).dot(self._rotation_back).ravel()
        return force

    def spring_wrench(self, pose: Array) -> Array:
        """f, (6,), N and Nm in world axes, where the model was last updated to.

        Args:
            pose: T_world_flange (4, 4) of the target.
        """
        return self._draw(pose).copy()

    def energy(self, pose: Array) -> float:
        """V, J: what the spring holds where the model was last updated to."""
        self._draw(pose)
        error = np.hstack([self._way, -2.0 * self._quaternion[1:]])
        return float(0.5 * error @ self.stiffness @ error)

    def check(self, angles: Array) -> None:
        """Refuses gains for which the time step is too long.

        Args:
            angles: (n,), rad or m, where the robot starts, at rest at its target.

        Raises:
            DeclarationError: names the joint that would shake most.
        """
        model = self.model
        model.update(angles, np.zeros(model.n))
        jacobian, mass, pose = model.jacobian(), model.mass(), model.flange()
        back = np.linalg.solve(mass, jacobian.T)
        self._design(jacobian @ back, pose)
        felt = np.linalg.inv(jacobian @ back + self._regularise)
        through = np.eye(model.n) - jacobian.T @ felt @ back.T
        stiffness = jacobian.T @ self._in_world(pose) @ jacobian + through * self._spring
        damping = jacobian.T @ self.damping @ jacobian + through * self._damper @ through.T
        joint = unstable_joint(mass, stiffness, damping, self._timestep)
        if joint is not None:
            raise too_stiff(model.joint_names[joint], "", self._timestep)

    def _in_world(self, pose: Array) -> Array:
        """K in the world's axes, (6, 6)."""
        if not self._in_flange:
            return self.stiffness
        axes = np.kron(np.eye(2), pose[:3, :3])
        return np.asarray(axes @ self.stiffness @ axes.T)

    def _design(self, mobility: Array, pose: Array) -> None:
        least = float(np.linalg.eigvalsh(mobility)[0])
        near = max(1.0 - least / _BLOCKED, 0.0)
        self._regularise[:] = np.eye(6) * (_BLOCKED * near**2)
        self._is_near = near > 0.0
        felt = np.linalg.inv(mobility + self._regularise)
        symmetric = 0.5 * (felt + felt.T)
        self.damping[:] = design_damping(symmetric, self._in_world(pose), self._ratio)
        self._wrench_of[:, 6:12] = -self.damping
        inertia = np.diagonal(self.model.mass())
        spring = np.maximum(self._spring, _LEAST_STIFFNESS)
        self._damper[:] = 2.0 * self._spring_ratio * np.sqrt(inertia * spring)
        n = len(inertia)
        np.fill_diagonal(self._inner_of[:, 2 * n : 3 * n], -self._damper)
        np.fill_diagonal(self._inner_of[:, 3 * n :], self._damper)


def _turning_stiffness(stiffness: Array) -> Array:
    """What turns R R_target^T, (9,), into the torque of a spring about three axes, (3, 9).

    With the unit quaternion (w, v) of R R_target^T the torque is -2 (w K v + v x K v). Products of
    the quaternion's parts are sums of the matrix's entries: 4 w v those of its antisymmetric half,
    and v v^T those of its symmetric one but for a multiple of 1, which K, symmetric, does not turn.

    Args:
        stiffness: K, (3, 3), Nm/rad.
    """
    cross = np.cross(np.eye(3)[:, None], np.eye(3))  # e_i x e_j, (3, 3, 3)
    antisymmetric = 0.5 * np.einsum("im,pqm->ipq", stiffness, cross)
    symmetric = np.einsum("pki,kq->ipq", cross, stiffness)
    matrices = antisymmetric - 0.5 * (symmetric + symmetric.transpose(0, 2, 1))
    return np.asarray(matrices.reshape(3, 9))
