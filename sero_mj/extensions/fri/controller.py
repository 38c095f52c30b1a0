"""`FriController`: emulates the FRI communication of an LWR's controller.

`AnswerStatistics` are the controller's statistics of a client's answers, `NetworkFaults` simulates
a network that loses packets.
"""

from __future__ import annotations

import select
import socket
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from ...base.errors import UsageError, did_you_mean
from ...data.receive.structure import Structure
from ...data.send.sender import SendReport, UdpSink, send
from ...robots.declared.robot import SerialRobot
from .receiver import COMMAND, CYCLES, QUALITIES, FriLayout
from .signals import FriSignals

_MONITOR, _COMMAND = 1, 2
_QUALITY_NUMBERS = {name: number for number, name in QUALITIES.items()}
_MAX_BYTES = 65_536

WINDOW = 100  # packets that FRI averages over
_MAX_UNANSWERED = 2  # packets sent until a missing answer counts as missed; our choice
# The minimum answer rate of each quality. FRI grades the link in four steps without specifying
# thresholds; these are ours.
_REACHED_FROM = {3: 0.95, 2: 0.8, 1: 0.5, 0: 0.0}


class FriController:
    """The controller's side of FRI 1.0: measurements out, answers in; raises UsageError.

    Counters wrap at 16 bits; statistics are over the last 100 packets; the quality follows the
    answer rate, and with an unacceptable one the interface falls back from command to monitor.
    Commands are counted but have no effect: the robot continues its motion.

    Args:
        cycle: s between packets, 0.001 to 0.1.
        quality: name of a quality to report regardless of the answers; None to follow them.
        amplitude: of the motion, 0 to 1.
        faults: of the network that `run` sends through; None for a good one.
        layout: of the packets, with a sign of torques; FRI's own when None.

    Attributes:
        cycle: s between packets.
        command_flags: all flags set in answers; 0 when nothing was commanded.
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
            raise UsageError(f"FRI is for 7 joints; '{robot.name}' has {robot.n}")
        least, most = CYCLES
        if not least - 1e-9 <= cycle <= most + 1e-9:
            expected = f"expected {least * 1e3:g} to {most * 1e3:g}"
            raise UsageError(f"FRI's cycle: found {cycle * 1e3:g} ms; {expected}")
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
        """Returns the next measurement packet.

        Args:
            t: time since it was started, s.
            sent_at: when the packet goes out, s, by the clock by which answers come; t if None.
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

    def take_answer(self, packet: bytes, came_at: float) -> bool:
        """Processes an answer received at a time (s); returns whether it is a command packet."""
        row = np.frombuffer(packet, np.uint8)[None]
        if len(packet) != self._command.size or self._command.find_wrong_constants(row)[0]:
            self.wrong_answers += 1
            return False
        values = self._command.decode(packet)
        self.answers += 1
        self.command_flags |= int(values["command_flags"][0])
        self._reflected = int(values["send_counter"][0])
        self._statistics.answer(int(values["reflected_counter"][0]), came_at)
        return True

    def run(self, to: UdpSink, duration: float | None = None) -> SendReport:
        """Sends until the duration (s) is over or the user interrupts, and processes answers.

        Args:
            to: the destination; answers arrive at its socket.
            duration: s; None for no limit.

        Returns:
            statistics; `packets` includes those lost by the network.
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
            packets = self.faults.pass_on(self.measure(due, start + due))
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
            packet = sock.recv(_MAX_BYTES)
        except OSError:  # an earlier packet had no receiver, for example
            return True
        self.take_answer(packet, time.perf_counter())
        return True


@dataclass
class _Sent:
    counter: int
    time: float
    latency: float | None = None


class AnswerStatistics:
    """Tracks which packets were answered."""

    def __init__(self) -> None:
        self.miss_counter = 0
        self._sent: deque[_Sent] = deque()

    def send(self, counter: int, time: float) -> None:
        """Registers a packet sent at a time (s)."""
        self._sent.append(_Sent(counter, time))
        if len(self._sent) > _MAX_UNANSWERED and self._sent[-1 - _MAX_UNANSWERED].latency is None:
            self.miss_counter += 1
        if len(self._sent) > WINDOW + _MAX_UNANSWERED:
            self._sent.popleft()

    def answer(self, reflected: int, time: float) -> None:
        """Registers an answer received at a time (s); a late one counts as missed."""
        waiting = list(self._sent)[-_MAX_UNANSWERED:]
        for packet in waiting:
            if packet.counter == reflected and packet.latency is None:
                packet.latency = max(time - packet.time, 0.0)

    def _latencies(self) -> list[float]:
        judged = list(self._sent)[:-_MAX_UNANSWERED]
        return [packet.latency for packet in judged if packet.latency is not None]

    def values(self) -> dict[str, float]:
        """FRI's statistics; packets before the first count as not answered."""
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
        """0 unacceptable to 3 perfect, by the answer rate."""
        rate = len(self._latencies()) / WINDOW
        return next(quality for quality, least in _REACHED_FROM.items() if rate >= least)


@dataclass
class NetworkFaults:
    """A network that loses, duplicates and reorders packets; reproducible by its seed.

    Attributes:
        loss: share of the packets that are withheld, 0 to 1.
    """

    loss: float = 0.0
    duplicates: float = 0.0
    swaps: float = 0.0
    seed: int = 0
    withheld: int = 0
    doubled: int = 0
    swapped: int = 0
    _random: np.random.Generator = field(init=False, repr=False)
    _held: bytes | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        self._random = np.random.default_rng(self.seed)

    def pass_on(self, packet: bytes) -> list[bytes]:
        """Returns the packets that leave the network when one enters."""
        chance = self._random.random(3)  # always three, so that the shares are independent
        after = self.flush()
        if chance[0] < self.loss:
            self.withheld += 1
            return after
        if not after and chance[1] < self.swaps:
            self._held = packet
            return []
        self.swapped += len(after)
        if chance[2] < self.duplicates:
            self.doubled += 1
            return [packet, packet, *after]
        return [packet, *after]

    def flush(self) -> list[bytes]:
        """Returns the packet held back for swapping, if any."""
        held, self._held = self._held, None
        return [] if held is None else [held]
