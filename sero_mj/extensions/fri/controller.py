"""Emulates the controller of an LWR on FRI 1.0, which performs an example motion."""

from __future__ import annotations

import select
import socket
import time
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from ...base.errors import UsageError, did_you_mean
from ...base.frames import Array
from ...data.receive.structure import Structure
from ...data.send.motion import InverseDynamics, SineMotion
from ...data.send.sender import SendReport, UdpSink, send
from ...robots.declared.robot import SerialRobot
from .receiver import ALL_DRIVES, COMMAND, CYCLES, QUALITIES, FriLayout

_MONITOR, _COMMAND = 1, 2
_QUALITY_NUMBERS = {name: number for number, name in QUALITIES.items()}
WINDOW = 100  # number of packets over which FRI averages
_MAX_UNANSWERED = 2  # packets after which an answer counts as missed, chosen by us
# Minimum answer rate of each quality. KUKA has not published the thresholds; these are ours.
_MIN_ANSWER_RATES = {3: 0.95, 2: 0.8, 1: 0.5, 0: 0.0}
_FRI_LEAD = 0.3  # s; large enough to see the commanded next to the measured position
_FORCE = 40.0  # N; as if someone leaned on the tool
_MOMENT = 4.0  # Nm
_ROOM_TEMPERATURE, _WARM_UP = 28.0, 14.0  # C
_JOINT_IMPEDANCE = 3


class FriSignals:
    """Computes consistent values of all FRI events for an example motion.

    The flange frame is computed from the DH table and all other values by MuJoCo, so that a flange
    check compares independent computations. Measured torques are the torques of the motion minus
    those of an external force. FRI expresses the wrench and the Jacobian in the task frame of the
    controller's stiffness, which is the flange frame here. The amplitude scales the motion: 0 is
    standstill, and 1 is the full motion.
    """

    def __init__(self, robot: SerialRobot, amplitude: float = 1.0) -> None:
        self._robot = robot
        self._motion = SineMotion(robot, amplitude)
        self._dynamics = InverseDynamics(robot)
        frames = self._dynamics.world.frames
        self._site = int(frames.site[frames.names.index(f"{robot.name}/flange")])

    def at(self, t: float) -> Mapping[str, Array]:
        model, data = self._dynamics.world.model, self._dynamics.data
        position, velocity, acceleration = self._motion.at(t)
        commanded = self._motion.at(t + _FRI_LEAD)[0]
        gravity = self._dynamics.torques(position, np.zeros(7), np.zeros(7))
        required = self._dynamics.torques(position, velocity, acceleration)
        jacobian = np.zeros((2, 3, 7))
        mujoco.mj_jacSite(model, data, jacobian[0], jacobian[1], self._site)
        to_flange = data.site_xmat[self._site].reshape(3, 3).T
        jacobian = (to_flange @ jacobian).reshape(6, 7)
        mass = np.zeros((7, 7))
        mujoco.mj_fullM(model, data, mass)
        force = _FORCE * np.array([np.cos(0.9 * t), np.sin(0.9 * t), 0.6 * np.sin(0.5 * t)])
        moment = _MOMENT * np.array([np.sin(0.6 * t), np.cos(0.7 * t), np.sin(0.8 * t)])
        external = jacobian.T @ np.concatenate([force, moment])
        return {
            "power": np.array([ALL_DRIVES]),
            "control": np.array([_JOINT_IMPEDANCE]),
            "temperatures": self._temperatures(t),
            "joint_angles": position,
            "flange_frame": self._robot.fwd_kin_base_to_flange(position),
            "commanded_angles": commanded,
            "commanded_frame": self._robot.fwd_kin_base_to_flange(commanded),
            "torques": required - external,
            "external_torques": external,
            "tcp_force": force,
            "tcp_moment": moment,
            "jacobian": jacobian.ravel(),
            "mass_matrix": mass.ravel(),
            "gravity_torques": gravity,
        }

    def _temperatures(self, t: float) -> Array:
        progress = 1.0 - 0.6 * float(np.exp(-t / 300.0))
        return np.asarray(_ROOM_TEMPERATURE + _WARM_UP * progress * np.linspace(1.0, 0.6, 7))


class FriController:
    """The controller side of FRI 1.0, which sends measurements and receives answers.

    Counters wrap at 16 bits. Statistics cover the last 100 packets. The quality follows the answer
    rate; if it is unacceptable, the interface falls back from command to monitor state. Commands
    are counted but have no effect: the robot continues its motion.

    Args:
        cycle: time between packets in seconds, from 0.001 to 0.1.
        quality: name of a quality to report regardless of the answers.
        amplitude: scale of the motion, from 0 to 1.
        faults: simulated network faults in `run` (default: none).

    Attributes:
        command_flags: union of all flags that were set in answers.

    Raises:
        UsageError: FRI does not support the robot, the cycle or the quality.
    """

    def __init__(
        self,
        robot: SerialRobot,
        *,
        cycle: float = 0.01,
        quality: str | None = None,
        commands: bool = False,
        counter: int = 0,
        amplitude: float = 1.0,
        faults: NetworkFaults | None = None,
        layout: FriLayout | None = None,
    ) -> None:
        if robot.n != 7:
            raise UsageError(f"FRI requires 7 joints, but '{robot.name}' has {robot.n}")
        low, high = CYCLES
        if not low - 1e-9 <= cycle <= high + 1e-9:
            expected = f"expected {low * 1e3:g} to {high * 1e3:g}"
            raise UsageError(f"FRI cycle: found {cycle * 1e3:g} ms; {expected}")
        if quality is not None and quality not in _QUALITY_NUMBERS:
            raise UsageError(f"no quality '{quality}'{did_you_mean(quality, _QUALITY_NUMBERS)}")
        self.cycle = cycle
        self.faults = NetworkFaults() if faults is None else faults
        self.sent = self.answers = self.wrong_answers = self.command_flags = 0
        self._quality = None if quality is None else _QUALITY_NUMBERS[quality]
        self._commands = commands
        self._first = counter
        self._signals = FriSignals(robot, amplitude)
        self._layout = FriLayout() if layout is None else layout
        self._command = Structure(COMMAND)
        self.restart()

    def restart(self) -> None:
        """Resets counters and statistics, as when the interface is reopened."""
        self._counter = self._first
        self._reflected = 0
        self._statistics = AnswerStatistics()

    def measure(self, t: float, sent_at: float | None = None) -> bytes:
        """Returns the next measurement packet, for a time `t` in seconds since the start.

        `sent_at` is the time in s at which the packet is sent, on the clock that `take_answer`
        uses (default: `t`).
        """
        counter = self._counter & 0xFFFF
        quality = self._statistics.quality if self._quality is None else self._quality
        commands = self._commands and _QUALITY_NUMBERS["unacceptable"] < quality <= 3
        packet = self._layout.encode(
            {
                **self._signals.at(t),
                "send_counter": [counter],
                "reflected_counter": [self._reflected],
                "timestamp": [t],
                "state": [_COMMAND if commands else _MONITOR],
                "quality": [quality],
                "measurement_cycle": [self.cycle],
                "command_cycle": [self.cycle],
                **{name: [value] for name, value in self._statistics.values().items()},
            }
        )
        self._counter += 1
        self.sent += 1
        self._statistics.send(counter, t if sent_at is None else sent_at)
        return packet

    def take_answer(self, packet: bytes, received_at: float) -> bool:
        """Processes an answer and returns whether it is a valid command packet."""
        row = np.frombuffer(packet, np.uint8)[None]
        if len(packet) != self._command.size or self._command.find_wrong_constants(row)[0]:
            self.wrong_answers += 1
            return False
        values = self._command.decode(packet)
        self.answers += 1
        self.command_flags |= int(values["command_flags"][0])
        self._reflected = int(values["send_counter"][0])
        self._statistics.answer(int(values["reflected_counter"][0]), received_at)
        return True

    def run(self, to: UdpSink, duration: float | None = None) -> SendReport:
        """Sends for a duration in seconds (default: until interrupted) and processes answers.

        `packets` of the returned report includes packets lost by the simulated network.
        """
        to.socket.setblocking(False)
        before = self.sent
        report = send(
            self._packets(to.socket, duration),
            to,
            idle=lambda left: self._listen(to.socket, time.perf_counter() + left),
        )
        return replace(report, packets=self.sent - before)

    def _packets(
        self, sock: socket.socket, duration: float | None
    ) -> Iterator[tuple[float, bytes]]:
        start = time.perf_counter()
        total = None if duration is None else max(round(duration / self.cycle), 1)
        count = 0
        while total is None or count < total:
            due = count * self.cycle
            while self._listen(sock, start + due - self.cycle / 2):
                pass
            packets = self.faults.transmit(self.measure(due, start + due))
            count += 1
            packets += self.faults.flush() if count == total else []
            for packet in packets:
                yield due, packet
        while self._listen(sock, start + count * self.cycle):
            pass

    def _listen(self, sock: socket.socket, until: float) -> bool:
        left = until - time.perf_counter()
        if not select.select([sock], [], [], max(left, 0.0))[0]:
            return False
        try:
            packet = sock.recv(65_536)
        except OSError:  # for example, an earlier packet had no receiver
            return True
        self.take_answer(packet, time.perf_counter())
        return True


@dataclass
class _Sent:
    counter: int
    time: float
    latency: float | None = None


class AnswerStatistics:
    """Statistics of a client's answers, as FRI reports them."""

    def __init__(self) -> None:
        self.miss_counter = 0
        self._sent: deque[_Sent] = deque()

    def send(self, counter: int, time: float) -> None:
        self._sent.append(_Sent(counter, time))
        if len(self._sent) > _MAX_UNANSWERED and self._sent[-1 - _MAX_UNANSWERED].latency is None:
            self.miss_counter += 1
        if len(self._sent) > WINDOW + _MAX_UNANSWERED:
            self._sent.popleft()

    def answer(self, reflected: int, time: float) -> None:
        """Registers an answer received at a time in seconds. A late answer counts as missed."""
        waiting = list(self._sent)[-_MAX_UNANSWERED:]
        for packet in waiting:
            if packet.counter == reflected and packet.latency is None:
                packet.latency = max(time - packet.time, 0.0)

    def _latencies(self) -> list[float]:
        judged = list(self._sent)[:-_MAX_UNANSWERED]
        return [packet.latency for packet in judged if packet.latency is not None]

    def values(self) -> dict[str, float]:
        """Returns FRI's statistics. Packets before the first packet count as unanswered."""
        latencies = self._latencies()
        rate = len(latencies) / WINDOW
        return {
            "answer_rate": rate,
            "latency": float(np.mean(latencies)) if latencies else 0.0,
            "jitter": float(np.std(latencies)) if latencies else 0.0,
            "miss_rate": 1.0 - rate,
            "miss_counter": self.miss_counter,
        }

    @property
    def quality(self) -> int:
        """Connection quality from the answer rate, from 0 (unacceptable) to 3 (perfect)."""
        rate = len(self._latencies()) / WINDOW
        return next(quality for quality, low in _MIN_ANSWER_RATES.items() if rate >= low)


@dataclass
class NetworkFaults:
    """Simulates a network that loses, duplicates and swaps packets with given probabilities."""

    loss: float = 0.0
    duplicates: float = 0.0
    swaps: float = 0.0
    seed: int = 0
    lost: int = 0
    duplicated: int = 0
    swapped: int = 0
    _random: np.random.Generator = field(init=False, repr=False)
    _delayed: bytes | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def transmit(self, packet: bytes) -> list[bytes]:
        """Returns the packets that leave the network when a packet enters."""
        chance = self._random.random(3)  # always three numbers, so that faults are independent
        after = self.flush()
        if chance[0] < self.loss:
            self.lost += 1
            return after
        if not after and chance[1] < self.swaps:
            self._delayed = packet
            return []
        self.swapped += len(after)
        if chance[2] < self.duplicates:
            self.duplicated += 1
            return [packet, packet, *after]
        return [packet, *after]

    def flush(self) -> list[bytes]:
        """Returns the packet that was delayed for swapping, if any."""
        delayed, self._delayed = self._delayed, None
        return [] if delayed is None else [delayed]
