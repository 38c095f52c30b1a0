"""Sends UDP packets as a robot would: every receiving feature can be tried without one."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene
from ..errors import DeclarationError, SourceError, UsageError, did_you_mean
from ..receive.structure import Structure
from ..receive.udp import UdpReceiver
from .motion import InverseDynamics, SineMotion
from .route import wire

Array = NDArray[np.float64]
LEAD = 0.5  # s by which the commanded position, for a double, runs ahead of the measured one
_SPIN = 2e-4  # s; sleeping is not exact to less than this, so the rest is waited for actively


@dataclass
class SendReport:
    """What a sender achieved.

    Attributes:
        packets: how many were sent.
        seconds: how long it took.
        refused: how many the system refused to send; the others went on.
        jitter_p50: median of how late packets left, s.
        jitter_p99: 99th percentile of the same.
    """

    packets: int
    seconds: float
    refused: int
    jitter_p50: float
    jitter_p99: float

    @property
    def rate(self) -> float:
        """Packets per second."""
        return self.packets / self.seconds if self.seconds > 0 else 0.0


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
            name: found for name, found in wiring.sources.items() if isinstance(found, UdpReceiver)
        }
        if source is None and len(receivers) == 1:
            source = next(iter(receivers))
        if source not in receivers:
            if source is not None or not receivers:
                near = did_you_mean(source or "", receivers)
                named = f" '{source}'" if source else ""
                raise UsageError(f"the scene has no UDP source{named}{near}")
            names = ", ".join(receivers)
            raise UsageError(f"the scene has several UDP sources; choose with --source: {names}")
        self.source: UdpReceiver = receivers[source]
        self.structure = (
            self.source.layout
            if structure is None
            else Structure(structure, is_double=self.source.is_double)
        )
        # A double gets the command that its robot will follow.
        self._signals = {
            route.event: (scene.doubles[route.robot].of, "commanded_angles")
            if route.robot in scene.doubles
            else (route.robot, route.key)
            for route in wiring.routes
            if route.source == source and route.event in self.structure.events
        }
        if not self._signals:
            raise UsageError(f"no route leads from '{source}': there is nothing to send")
        robots = {robot for robot, _ in self._signals.values()}
        for event, (robot, _) in self._signals.items():
            if self.structure.events[event] != scene.robots[robot].n:
                raise UsageError(
                    f"structure '{self.structure.text}': {event} has "
                    f"{self.structure.events[event]} values; "
                    f"{robot} has {scene.robots[robot].n} joints"
                )
        self._robots = {name: _Player(scene.robots[name], amplitude) for name in robots}

    def at(self, t: float) -> bytes:
        """Returns the packet of time t (s)."""
        now = {name: player.signals(t) for name, player in self._robots.items()}
        values = {event: now[robot][key] for event, (robot, key) in self._signals.items()}
        return self.structure.encode(values)


class _Player:
    """What one robot's sensors say during a motion."""

    def __init__(self, robot: SerialRobot, amplitude: float) -> None:
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
        }


def send(
    packet_at: Callable[[float], bytes],
    host: str,
    port: int,
    *,
    rate: float,
    duration: float | None = None,
    on_progress: Callable[[int], None] | None = None,
) -> SendReport:
    """Sends packets at an exact rate until the duration is over or the user interrupts.

    Args:
        packet_at: makes the packet of a time (s).
        host: where to.
        port: where to.
        rate: packets per second.
        duration: s; None sends until interrupted.
        on_progress: called about ten times a second with the packets sent so far.

    Raises:
        SourceError: the address cannot be resolved.
    """
    try:
        family, kind, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise SourceError(f"{host}:{port}", f"not an address: {reason}") from error
    total = None if duration is None else max(round(duration * rate), 1)
    every = max(round(rate / 10), 1)
    late: list[float] = []
    refused = sent = 0
    with socket.socket(family, kind) as sock:
        start = time.perf_counter()
        try:
            while total is None or sent < total:
                packet = packet_at(sent / rate)
                late.append(_wait_until(start + sent / rate))
                try:
                    sock.sendto(packet, address)
                except OSError:  # nobody listens yet, or the network is away: a robot goes on
                    refused += 1
                sent += 1
                if len(late) > 100_000:
                    del late[:50_000]
                if on_progress is not None and sent % every == 0:
                    on_progress(sent)
        except KeyboardInterrupt:
            pass
        seconds = time.perf_counter() - start
    p50, p99 = np.percentile(late, [50, 99]) if late else (0.0, 0.0)
    return SendReport(sent, seconds, refused, float(p50), float(p99))


def _wait_until(when: float) -> float:
    """Waits, and returns by how much (s) it was late."""
    left = when - time.perf_counter()
    if left > _SPIN:
        time.sleep(left - _SPIN)
    while (late := time.perf_counter() - when) < 0:
        pass
    return late
