"""External forces on simulated robots: pushes at frames, payloads and contacts."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..base.declaration import numbers
from ..base.errors import Problem, UnknownName
from ..base.frames import Array, Bools, Ints
from ..robots.assemble.mjcf_dynamics import PAYLOAD
from ..robots.assemble.parts import robots_of_bodies
from ..robots.assemble.world import World
from ..robots.declared.dynamics import inertia_problem, principal_moments, tensors_from
from .physics import Physics


class Push:
    """A force and a torque at a point that moves with a frame. Both can be changed at any time.

    See `Plant.push` for arguments and errors.

    Attributes:
        at: point of application in the frame, shape (3,), m.
        body: index of the frame's body.
        site: index of the frame's site.
        axes: index of the site in whose axes force and torque are expressed; None for the world.
        wrench: force and torque, shape (2, 3), N and Nm; may be changed in place.
    """

    def __init__(
        self,
        world: World,
        frame: str,
        force: ArrayLike,
        torque: ArrayLike,
        expressed_in: str,
        at: ArrayLike,
    ) -> None:
        self.frame, self.expressed_in = frame, expressed_in
        self.wrench: Array = np.array([_three("force", force), _three("torque", torque)])
        self.at = _three("at", at)
        self.site = _site(world, frame)
        self.body = int(world.model.site_bodyid[self.site])
        self.axes = None if expressed_in == "world" else _site(world, expressed_in)

    @property
    def force(self) -> Array:
        return np.asarray(self.wrench[0])

    @property
    def torque(self) -> Array:
        return np.asarray(self.wrench[1])

    def write_into(self, wrench: Array) -> None:
        """Copies the force and torque into an array, shape (2, 3), which becomes `wrench`."""
        wrench[...] = self.wrench
        self.wrench = wrench

    def apply(self, model: mujoco.MjModel, data: mujoco.MjData, torques: Array) -> None:
        """Adds the generalized forces of the push to `torques`, shape (nv,), Nm or N."""
        force, torque = self.force, self.torque
        if self.axes is not None:
            axes = data.site_xmat[self.axes].reshape(3, 3)
            force, torque = axes @ force, axes @ torque
        mujoco.mj_applyFT(model, data, force, torque, self.point(data), self.body, torques)

    def point(self, data: mujoco.MjData) -> Array:
        """Returns the point of application in world coordinates, shape (3,), m."""
        point: Array = data.site_xpos[self.site]
        if self.at.any():
            point = point + data.site_xmat[self.site].reshape(3, 3) @ self.at
        return point


class PushRows:
    """The pushes in all worlds (rows) of a batch, whose torques are computed together.

    Copying the `MjData` of a row would take twice as long as its step. The operations of
    `mj_applyFT` are computed in the same order, so the torques are equal.
    """

    def __init__(self, physics: Physics, pushes: Sequence[tuple[int, Push]]) -> None:
        model = physics.model
        acting = [push for _, push in pushes]
        self._physics, self._wrenches = physics, np.zeros((len(pushes), 2, 3))
        for push, wrench in zip(acting, self._wrenches, strict=True):
            push.write_into(wrench)
        self._of: Ints = np.array([row for row, _ in pushes], np.intp)
        # If no row has two pushes, their torques need not be summed.
        self._is_single = len(np.unique(self._of)) == len(pushes)
        bodies = [push.body for push in acting]
        self._sites: Ints = np.array([push.site for push in acting], np.intp)
        self._roots: Ints = model.body_rootid[bodies].astype(np.intp)
        self._moved: Bools = np.array([_moving(model, body) for body in bodies])
        self._places = physics.bind("site_xpos")
        self._centers, self._motions = physics.bind("subtree_com"), physics.bind("cdof")
        ats = np.array([push.at for push in acting])
        is_off = bool(ats.any())
        self._off: Array | None = ats[..., None] if is_off else None
        turned = [k for k, push in enumerate(acting) if push.axes is not None]
        self._turned: Ints = np.array(turned, np.intp)
        self._axes: Ints = np.array([acting[k].axes for k in turned], np.intp)
        # The array is bound only if needed, because bound arrays are copied in every step.
        self._turns = physics.bind("site_xmat") if is_off or turned else None

    def write(self, torques: Array) -> None:
        """Writes the generalized forces to `torques`, which must be zeros, (m, nv), Nm or N."""
        of, sites = self._of, self._sites
        self._physics.forward()
        wrenches = self._wrenches
        points = self._places[of, sites]
        if self._turns is not None:
            turns = self._turns.reshape(len(self._turns), -1, 3, 3)
            if self._off is not None:
                points += (turns[of, sites] @ self._off)[..., 0]
            if len(self._turned):
                wrenches, axes = wrenches.copy(), turns[of[self._turned], self._axes]
                for k in range(2):  # force and torque separately, as in `Push.apply`
                    wrenches[self._turned, k] = (axes @ wrenches[self._turned, k, :, None])[..., 0]
        arms = points - self._centers[of, self._roots]
        # Each component has its own array (k, nv), because NumPy is slow with a short last axis.
        motions = self._motions[of].transpose(2, 0, 1).copy()
        x, y, z, *lines = motions
        (rx, ry, rz), (fx, fy, fz), (tx, ty, tz) = (
            each.T[..., None] for each in (arms, wrenches[:, 0], wrenches[:, 1])
        )
        # The columns of the point's Jacobian are v + w x r. `np.cross` takes twice as long.
        lines[0] += y * rz - z * ry
        lines[1] += z * rx - x * rz
        lines[2] += x * ry - y * rx
        found = lines[0] * fx + lines[1] * fy + lines[2] * fz
        found += x * tx + y * ty + z * tz
        found *= self._moved
        if self._is_single:
            torques[of] = found
        else:
            np.add.at(torques, of, found)


def _moving(model: mujoco.MjModel, body: int) -> Bools:
    """Returns a mask of the degrees of freedom that move a body, shape (nv,)."""
    found: Bools = np.zeros(model.nv, bool)
    while body:
        first = model.body_dofadr[body]
        found[first : first + model.body_dofnum[body]] = first >= 0
        body = int(model.body_parentid[body])
    return found


def _three(name: str, value: ArrayLike) -> Array:
    array = numbers(value)
    if array.shape != (3,):
        raise Problem(name, found=array.tolist(), expected="3 numbers").error()
    return array


def _site(world: World, frame: str) -> int:
    try:
        return world.frame_site(frame)
    except UnknownName:
        raise UnknownName("frame", frame, [*world.frames.names, "world"]) from None


_STEEL = 7800.0  # density of steel, kg/m3


def attach_payload(
    model: mujoco.MjModel,
    robot: str,
    mass: float,
    center_of_mass: ArrayLike,
    inertia: ArrayLike | None,
) -> None:
    """Sets the mass and inertia of a robot's payload body; see `Plant.attach_payload`."""
    key = f"payload of {robot}"
    if not 0 < mass < np.inf:
        raise Problem(key, found=mass, of="kg", expected="a positive mass").error()
    center = numbers(center_of_mass)
    if center.shape != (3,):
        raise Problem(key, found=center, expected="a center of mass of 3 numbers, m").error()
    if inertia is None:
        radius = (3 * mass / (4 * np.pi * _STEEL)) ** (1 / 3)
        tensor = 0.4 * mass * radius**2 * np.eye(3)
    else:
        tensor = tensors_from([inertia])[0]
    reason = inertia_problem(tensor)
    if reason is not None:
        raise Problem(key, reason).error()
    moments, axes = principal_moments(tensor)
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, axes.ravel())
    _set(model, robot, mass, center, moments, quat)


def detach_payload(model: mujoco.MjModel, robot: str) -> None:
    """Sets the mass and inertia of a robot's payload body to zero."""
    _set(model, robot, 0.0, np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]))


def _set(
    model: mujoco.MjModel, robot: str, mass: float, center: Array, moments: Array, quat: Array
) -> None:
    body = model.body(f"{robot}/{PAYLOAD}").id
    model.body_mass[body] = mass
    model.body_ipos[body], model.body_iquat[body] = center, quat
    model.body_inertia[body] = moments
    model.body_sameframe[body] = 0  # the center of mass is no longer at the body's origin
    kept = model.stat.center.copy(), model.stat.extent, model.stat.meansize
    mujoco.mj_setConst(model, mujoco.MjData(model))
    # The camera must not move.
    model.stat.center, model.stat.extent, model.stat.meansize = kept


class Contacts:
    """Sums the contact forces on each robot, except those among its own links.

    Args:
        world: world that was compiled with `dynamic=True`.

    Attributes:
        forces: force on each robot at the last `update`, in world axes, shape (robots, 3), N.
    """

    def __init__(self, world: World, model: mujoco.MjModel) -> None:
        self.forces: Array = np.zeros((len(world.robots), 3))
        # Index of the robot that each geom belongs to, or -1.
        self._owner = robots_of_bodies(model, world.robots)[model.geom_bodyid]
        self._force: Array = np.zeros(6)

    def update(self, model: mujoco.MjModel, data: mujoco.MjData) -> Array:
        """Updates and returns `forces` for the last step."""
        forces = self.forces
        forces[:] = 0.0
        contact = data.contact
        for index, (first, second) in enumerate(self._owner[contact.geom].tolist()):
            if first == second or contact.exclude[index]:
                continue
            mujoco.mj_contactForce(model, data, index, self._force)
            # The rows of the contact frame are the normal (first to second geom) and two tangents.
            force = self._force[:3] @ contact.frame[index].reshape(3, 3)
            if second >= 0:
                forces[second] += force
            if first >= 0:
                forces[first] -= force
        return forces
