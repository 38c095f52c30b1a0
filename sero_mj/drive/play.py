"""Packets as a robot would send them: every receiving feature can be tried without one."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..assemble.frames import frame, rotation_about
from ..assemble.inputs import Input
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..errors import DeclarationError, UsageError, did_you_mean
from ..receive.receiver import Receiver
from ..receive.structure import Structure
from .motion import InverseDynamics, SineMotion
from .route import wire

Array = NDArray[np.float64]
LEAD = 0.5  # s by which the commanded position, for a double, runs ahead of the measured one
_SWITCHED_AFTER = 4.0  # s
_MAGNITUDES = {"force": 50.0, "torque": 10.0, "velocity": 0.5, "angular_velocity": 1.5}


class MotionPackets:
    """Packets of a scene's source, with the signals that its routes lead to the robots.

    Args:
        scene: robots and routes.
        source: whose packets to make; the scene's only one when None.
        structure: instead of the source's.
        amplitude: of the motion, 0 to 1.

    Attributes:
        structure: of the packets.
        source: the receiver they are meant for.

    Raises:
        DeclarationError: the scene's sources or routes are wrong.
        UsageError: the scene has no such source, or nothing is routed from it.
    """

    def __init__(
        self,
        scene: Scene,
        source: str | None = None,
        structure: str | None = None,
        amplitude: float = 1.0,
    ) -> None:
        wiring = wire(scene)
        if wiring.problems:
            raise DeclarationError(scene.located(wiring.problems))
        receivers = {
            name: found for name, found in wiring.sources.items() if isinstance(found, Receiver)
        }
        if source is None and len(receivers) == 1:
            source = next(iter(receivers))
        if source not in receivers:
            if source is not None or not receivers:
                near = did_you_mean(source or "", receivers)
                named = f" '{source}'" if source else ""
                raise UsageError(f"the scene has no source{named}{near}")
            names = ", ".join(receivers)
            raise UsageError(f"the scene has several sources; choose with --source: {names}")
        self.source: Receiver = receivers[source]
        self.structure = (
            self.source.layout
            if structure is None
            else Structure(
                structure,
                is_double=self.source.is_double,
                column_major=self.source.column_major,
            )
        )
        self._inputs = {
            route.event: route.to
            for route in wiring.routes
            if route.source == source and route.event in self.structure.events
        }
        if not self._inputs:
            raise UsageError(f"no route leads from '{source}': there is nothing to send")
        for event, item in self._inputs.items():
            found = math.prod(self.structure.events[event])
            if found != item.count:
                raise UsageError(
                    f"structure '{self.structure.text}': {event} has {found} values; "
                    f"{item.target} takes {item.meaning}"
                )
        self._scene = scene
        played = {self._robot_of(item) for item in self._inputs.values()} - {None}
        self._robots = {name: _Player(scene.robots[name], amplitude) for name in played if name}

    def _robot_of(self, item: Input) -> str | None:
        """The robot whose motion decides what an input gets."""
        if item.kind in ("angles", "values") or item.key == "flange_check":
            double = self._scene.doubles.get(item.name)
            return item.name if double is None else double.of
        return None

    def at(self, t: float) -> bytes:
        """Returns the packet of time t (s)."""
        now = {name: player.signals(t) for name, player in self._robots.items()}
        values = {event: self._value(item, now, t) for event, item in self._inputs.items()}
        shapes = self.structure.events
        return self.structure.encode(
            {event: np.reshape(value, shapes[event]) for event, value in values.items()}
        )

    def _value(self, item: Input, now: Mapping[str, Mapping[str, Array]], t: float) -> Array:
        """What an input gets at time t."""
        scene, robot = self._scene, self._robot_of(item)
        if robot is not None:
            # A double gets the command that its robot will follow.
            is_target = item.key == "joint_angles" and item.name in scene.doubles
            key = "commanded_angles" if is_target else item.key
            signals = now[robot]
            return signals[key] if key in signals else signals["further"]
        if item.kind == "vector":
            size = _MAGNITUDES[scene.arrows[item.name].kind]
            return size * np.array([np.cos(0.9 * t), np.sin(0.9 * t), 0.6 * np.sin(0.5 * t)])
        if item.kind == "toggle":
            phase = int(t / _SWITCHED_AFTER)
            return np.array([float(phase % (3 if item.key == "arrow_quantity" else 2))])
        return self._frame(item, t)

    def _frame(self, item: Input, t: float) -> Array:
        """Where a base, an object or a camera is declared; a received frame goes in a circle."""
        scene = self._scene
        if item.name in scene.robots:
            return scene.robots[item.name].base_frame
        if item.name in scene.cameras:
            return scene.cameras[item.name].frame
        placed = {thing.name: thing.frame for thing in scene.objects}
        if item.name in placed:
            return placed[item.name]
        declared = scene.frames[item.name].frame
        start = frame(position=np.array([0.5, 0.0, 0.5])) if declared is None else declared
        return np.asarray(frame(rotation_about(2, 0.4 * t)) @ start)


class _Player:
    """What one robot's sensors say during a motion."""

    def __init__(self, robot: SerialRobot, amplitude: float) -> None:
        self._robot = robot
        self._motion = SineMotion(robot, amplitude)
        self._dynamics = InverseDynamics(robot)

    def signals(self, t: float) -> Mapping[str, Array]:
        position, velocity, acceleration = self._motion.at(t)
        torques = self._dynamics.torques(position, velocity, acceleration)
        return {
            "joint_angles": position,
            "commanded_angles": self._motion.at(t + LEAD)[0],
            "torques": torques,
            "commanded_torques": torques,  # a perfect controller: the error is zero
            "joint_accelerations": acceleration,
            "billboard_values": velocity,
            "flange_check": self._robot.fwd_kin_base_to_flange(position),
            # Of the robot's own inputs nothing is known; temperatures in degrees, say.
            "further": 30.0 + 5.0 * np.sin(0.2 * t + np.arange(self._robot.n)),
        }
