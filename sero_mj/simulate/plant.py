"""`Plant`: the simulated robots, which take motor torques and give what their sensors read."""

from __future__ import annotations

from math import hypot
from typing import Any, NoReturn, TypeVar

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from ..base.declaration import numbers
from ..base.errors import SimulationError, UnknownName
from ..base.frames import Array
from ..robots.assemble.parts import RobotPart
from ..robots.assemble.world import World
from .external_loads import Push, attach_payload, detach_payload
from .plant_rows import PlantRows
from .rows import OneRow
from .sensors import Sensors

P = TypeVar("P", bound=Push)

MAX_TORQUE = 1e9  # Nm, norm of all motor torques; a comparison with it refuses NaN as well


class Plant(PlantRows):
    """All robots of a dynamic world, joint after joint in the order of `world.robots`.

    After construction and, if `joints.looks_ahead`, after every step `data` holds the kinematics,
    the mass matrix and the bias torques (`qfrc_bias`) of the state that it is in, so a controller
    need not compute them.

    Args:
        world: compiled with `dynamic=True`.
        sensors: what the robots have; perfect ones when None.
        timestep: s; the model's when None.

    Attributes:
        model: its `MjModel`; payloads and frictions change it.
        data: its `MjData`.
        motor_torques: (n,), what acted in the last step.

    Raises:
        ValueError: the world is not dynamic, or the timestep not positive.
    """

    def __init__(
        self, world: World, sensors: Sensors | None = None, timestep: float | None = None
    ) -> None:
        if not world.dynamic:
            raise ValueError("found a world to look at; expected World(scene, dynamic=True)")
        self.model = world.model
        if timestep is not None:
            if not 0 < timestep < 1:
                raise ValueError(f"timestep: found {timestep:g} s; expected more than 0, below 1")
            self.model.opt.timestep = timestep
        self.data = world.make_data()
        super().__init__(world, OneRow(self.model, self.data), sensors)
        self._pushes: list[Push] = []
        self._pushed = False  # whether any acts, or did in the last step
        self._motor = self.data.qfrc_applied
        self._motor_dofs = self.joints.motor_dofs
        self._outer = np.zeros(self.model.nv)  # torques of pushes in the last step
        self._settle()

    @property
    def time(self) -> float:
        """Since the start, s."""
        return float(self.data.time)

    @property
    def motor_torques(self) -> Array:
        """What acted on the motors in the last step, (n,), Nm."""
        return np.asarray((self._motor - self._outer)[self._motor_dofs])

    def reset(self, joint_angles: Any | None = None) -> None:
        """Puts the robots where they are declared to be, at rest, and ends pushes.

        Payloads, frictions and faults of sensors stay; the noise begins anew.

        Args:
            joint_angles: (n,), of all robots, rad; the declared ones when None.

        Raises:
            ValueError: not n finite numbers.
        """
        self.world.reset(self.data)
        self._pushes.clear()
        self._motor[:] = self._outer[:] = 0.0
        if joint_angles is not None:
            angles = numbers(joint_angles)
            if angles.shape != (self.n,):
                raise ValueError(f"joint_angles: found {angles.size} numbers; expected {self.n}")
            for part in self.world.robots.values():
                self.data.qpos[part.qpos] = angles[part.joints]
        self._settle()

    def _settle(self) -> None:
        """Computes all that follows from a state at rest, in which the joints hold the links."""
        mujoco.mj_forward(self.model, self.data)
        self.rows.is_ahead = True
        if self.joints.elastic:
            self.joints.load_springs()
            mujoco.mj_forward(self.model, self.data)
        self.joints.read_at_rest(self._readings)
        self._is_measured = False
        self.sensors.reset(self._actual)

    def step(self, motor_torques: Array) -> Array:
        """Simulates one timestep.

        Args:
            motor_torques: (n,), before gear friction and as seen at the joint, Nm; none is cut
                off here.

        Returns:
            `measured`, (3, n): the same array every time.

        Raises:
            SimulationError: a torque is no number, or the motion has become unstable; names the
                joint and the time. `measured` and `actual` are those before.
        """
        applied = self.joints.motor_torques
        applied[...] = motor_torques
        if not hypot(*applied.tolist()) < MAX_TORQUE:
            self._stop_for_torque()
        return self.step_given()

    def _gather_pushes(self) -> Array | None:
        if not self._pushed:
            return None
        self._motor[:] = self._outer[:] = 0.0
        if self._pushes:
            self.rows.look_ahead()
        for push in self._pushes:
            push.apply(self.model, self.data, self._outer)
        self._pushed = bool(self._pushes)
        return self._outer

    def push(
        self,
        frame: str,
        force: ArrayLike = (0.0, 0.0, 0.0),
        torque: ArrayLike = (0.0, 0.0, 0.0),
        expressed_in: str = "world",
        at: ArrayLike = (0.0, 0.0, 0.0),
    ) -> Push:
        """Applies a force and a torque at a frame until `release`.

        Args:
            frame: at whose origin they act, e.g. `lwr/flange`.
            force: (3,), N.
            torque: (3,), Nm.
            expressed_in: name of the frame in whose axes both are given.
            at: (3,), where in the frame they act, m.

        Returns:
            the push; change its `force` and `torque` at any time.

        Raises:
            UnknownName: no such frame.
            ValueError: not three finite numbers.
        """
        return self.add_push(Push(self.world, frame, force, torque, expressed_in, at))

    def add_push(self, push: P) -> P:
        """Lets a push act until `release`, see `push`."""
        self._pushes.append(push)
        self._pushed = True
        return push

    def release(self, push: Push) -> None:
        """Ends a push; nothing happens if it has ended."""
        if push in self._pushes:
            self._pushes.remove(push)

    def external_torques(self) -> Array:
        """What acted on the links from outside in the last step, (n,), Nm, true.

        Of pushes, contacts and stops; a payload is a part of its robot.
        """
        return self.joints.external(self._outer)

    def set_friction(
        self, robot: str, viscous: ArrayLike | None = None, coulomb: ArrayLike | None = None
    ) -> None:
        """Changes a robot's friction from now on.

        Args:
            robot: its name.
            viscous: one number or (n,), Nm s/rad; as it is when None.
            coulomb: likewise, Nm.

        Raises:
            UnknownName: no such robot.
            ValueError: a friction below zero, or neither one nor n.
        """
        dofs = self._part(robot).dofs
        for name, value, target in (
            ("viscous", viscous, self.model.dof_damping),
            ("coulomb", coulomb, self.model.dof_frictionloss),
        ):
            if value is not None:
                friction = np.atleast_1d(numbers(value))
                if friction.shape not in ((1,), dofs.shape):
                    raise ValueError(
                        f"{name}: found {friction.size} numbers; expected 1 or {len(dofs)}"
                    )
                if (friction < 0).any():
                    raise ValueError(f"{name}: found {friction.tolist()}; expected 0 or more")
                target[dofs] = friction
        self.refresh()

    def attach_payload(
        self,
        robot: str,
        mass: float,
        center_of_mass: ArrayLike = (0.0, 0.0, 0.0),
        inertia: ArrayLike | None = None,
    ) -> None:
        """Fixes a payload to a robot's flange, in place of the one that it may have.

        Args:
            robot: its name.
            mass: kg.
            center_of_mass: (3,), in the flange's frame, m.
            inertia: about it, in the flange's axes, kg m2: 6 numbers (Ixx, Iyy, Izz, Ixy, Ixz,
                Iyz) or (3, 3); that of a ball of steel when None.

        Raises:
            UnknownName: no such robot.
            ValueError: no rigid body has this mass and inertia.
        """
        self._part(robot)
        attach_payload(self.model, robot, mass, center_of_mass, inertia)
        self.refresh()

    def detach_payload(self, robot: str) -> None:
        """Takes a robot's payload away.

        Raises:
            UnknownName: no such robot.
        """
        self._part(robot)
        detach_payload(self.model, robot)
        self.refresh()

    def flange(self, robot: str) -> Array:
        """T_world_flange now, (4, 4), m: the true one, in an array of its own."""
        self.rows.look_ahead()
        frame, body = np.eye(4), self._part(robot).flange_body
        frame[:3, :3] = self.data.xmat[body].reshape(3, 3)
        frame[:3, 3] = self.data.xpos[body]
        return frame

    def refresh(self) -> None:
        """Recomputes what depends on `model` and `data` after they were changed; no time passes."""
        self.joints.refresh()
        mujoco.mj_step1(self.model, self.data)
        self.rows.is_ahead = True

    def _part(self, robot: str) -> RobotPart:
        if robot not in self.world.robots:
            raise UnknownName("robot", robot, self.world.robots)
        return self.world.robots[robot]

    def _joint_name(self, row: int) -> str:
        names = [
            f"{name}/{j}" for name, part in self.world.robots.items() for j in part.robot.names
        ]
        return names[row]

    def _stop_for_torque(self) -> NoReturn:
        torques = self.joints.motor_torques.copy()
        self.joints.motor_torques[:] = 0.0
        row = int(np.argmax(~(np.abs(torques) < MAX_TORQUE / np.sqrt(self.n))))
        reason = f"found a motor torque of {torques[row]:g} Nm; expected a finite one, below 1e9"
        raise SimulationError(self.time, self._joint_name(row), reason)

    def _stop_for_motion(self) -> NoReturn:
        acceleration = self.data.qacc[self._motor_dofs]
        broken = ~(np.abs(acceleration) < mujoco.mjMAXVAL)
        parts = self.world.robots.values()
        revolute = np.concatenate([part.kinematics.revolute for part in parts])
        row = int(np.argmax(broken) if broken.any() else np.argmax(np.abs(acceleration)))
        unit = "rad/s2" if revolute[row] else "m/s2"
        reason = (
            f"found an acceleration of {acceleration[row]:g} {unit}; the motion is unstable: "
            f"expected lower gains, or a timestep below {self.timestep:g} s"
        )
        raise SimulationError(self.time, self._joint_name(row), reason)
