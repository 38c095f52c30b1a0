"""`FriController`: sends what the controller of an LWR sends, as it sends it."""

from __future__ import annotations

import select
import socket
import time
from dataclasses import dataclass, field

import numpy as np

from ..assemble.robot import SerialRobot
from ..errors import UsageError, did_you_mean
from ..receive.fri_layout import COMMAND, CYCLES, QUALITIES, FriLayout
from ..receive.structure import Structure
from .fri_answers import AnswerStatistics
from .fri_signals import FriSignals
from .sender import SendReport, UdpSink, wait_until

_MONITOR, _COMMAND = 1, 2
_QUALITY_NUMBERS = {name: number for number, name in QUALITIES.items()}
_MOST_BYTES = 65_536


@dataclass
class Faults:
    """A network that loses, doubles and swaps packets, the same ones for one seed.

    Attributes:
        loss: share of the packets that are withheld, 0 to 1.
        duplicates: share that is sent twice.
        swaps: share that is sent after the one that follows.
        seed: of the random numbers.
        withheld: how many were withheld so far.
        doubled: how many were sent twice.
        swapped: how many were sent after the one that follows.
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
        """Returns what comes out when a packet goes in."""
        chance = self._random.random(3)  # always three, so that one share does not change another
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
        """Returns the packet that waits for the one that follows, if one does."""
        held, self._held = self._held, None
        return [] if held is None else [held]


class FriController:
    """The controller's side of FRI 1.0: measurements out, answers in.

    Counters wrap at 16 bits; statistics are over the last 100 packets; the quality follows the
    answer rate, and with an unacceptable one the interface falls back from command to monitor.
    Commands are counted and do nothing: the robot goes on with its motion.

    Args:
        robot: seven joints.
        cycle: s between packets, 0.001 to 0.1.
        quality: name of a quality to tell whatever the answers are; None to follow them.
        commands: whether its program has asked for the command state.
        counter: send counter of the first packet.
        amplitude: of the motion, 0 to 1.
        faults: of the network that `run` sends through; None for a good one.

    Attributes:
        cycle: s between packets.
        faults: of the network.
        sent: packets made so far.
        answers: good answers so far.
        wrong_answers: what came and is no command packet.
        command_flags: all flags that were set in answers; 0 when nothing was commanded.

    Raises:
        UsageError: another cycle or quality, or a robot of other than seven joints.
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
        faults: Faults | None = None,
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
        self.faults = Faults() if faults is None else faults
        self.sent = self.answers = self.wrong_answers = self.command_flags = 0
        self._quality = None if quality is None else _QUALITY_NUMBERS[quality]
        self._commands = commands
        self._first = counter
        self._signals = FriSignals(robot, amplitude)
        self._layout, self._command = FriLayout(), Structure(COMMAND)
        self.restart()

    def restart(self) -> None:
        """Begins anew, as after the interface was closed and opened: counters and statistics."""
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
        """Takes what a client sent at a time (s); returns whether it is a command packet."""
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
        """Sends until the duration (s) is over or the user interrupts, and takes answers."""
        total = None if duration is None else max(round(duration / self.cycle), 1)
        late: list[float] = []
        count = refused = 0
        to.socket.setblocking(False)
        start = time.perf_counter()
        try:
            while total is None or count < total:
                due = start + count * self.cycle
                self._listen(to.socket, due - self.cycle / 2)
                packets = self.faults.pass_on(self.measure(count * self.cycle, due))
                self._listen(to.socket, due)  # what came while the packet was made
                late.append(wait_until(due))
                count += 1
                packets += self.faults.flush() if count == total else []
                for packet in packets:
                    try:
                        to.put(packet)
                    except OSError:  # the network is away: a controller goes on
                        refused += 1
                del late[:-100_000]
            self._listen(to.socket, time.perf_counter() + self.cycle)
        except KeyboardInterrupt:
            pass
        seconds = time.perf_counter() - start
        p50, p99 = np.percentile(late, [50, 99]) if late else (0.0, 0.0)
        return SendReport(count, seconds, refused, float(p50), float(p99))

    def _listen(self, sock: socket.socket, until: float) -> None:
        """Takes answers until a time of `time.perf_counter`, s."""
        while True:
            left = until - time.perf_counter()
            if not select.select([sock], [], [], max(left, 0.0))[0]:
                return
            try:
                packet = sock.recv(_MOST_BYTES)
            except OSError:
                continue
            self.take_answer(packet, time.perf_counter())
