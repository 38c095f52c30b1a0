"""`PlotSignals`: the signals that can be plotted over time, and their histories.

A signal is a value of a displayed joint, a number in the packets of a source, a column in the log
of a recording or run, or a value that a program plots.
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from ...base.frames import Array
from ...data.drive.mirror import LiveWorld
from ...data.receive.mailbox import Packets
from ...data.receive.source import Source
from ...robots.assemble.world_view import WorldView
from ..decor.quantities import joint_values
from ..decor.staleness import Staleness
from .binned_history import SPAN, BinnedHistory
from .clock import HISTORY_SPAN
from .torque_history import ROWS, TorqueHistory

PROGRAM = "program"  # name of the group of signals that a program plots
_SPAN = SPAN + HISTORY_SPAN  # duration of the histories, s
_MAX_DELAY = 0.1  # maximum delay of the displayed time by slow frames, s
_MIN_JUMP = 1.0  # minimum jump back in time that clears the history of a program's signal, s


class PlotSignal(NamedTuple):
    """The identity of a signal that can be plotted.

    Attributes:
        group: name of a robot, double or source, or `PROGRAM`.
        name: name of the signal in the group, such as `A2.torques` or `values0[3]`.
    """

    group: str
    name: str


class PlotSignals:
    """The signals of a window or page, and their histories.

    Args:
        mirror: mirror whose signals can be plotted.
        torques: torque history of the mirror's joints.
    """

    def __init__(self, mirror: LiveWorld, torques: TorqueHistory) -> None:
        self._mirror, self._torques = mirror, torques
        self._joints = dict(_joint_signals(mirror.world))
        self._numbers = dict(_numbers(mirror.sources))
        self._staleness = Staleness(mirror.world)
        self._program: dict[PlotSignal, BinnedHistory] = {}
        self._followed: dict[PlotSignal, BinnedHistory] = {}
        self._is_listening = False
        self._offset = 0.0  # displayed time minus `time.monotonic()`, s

    @property
    def groups(self) -> dict[str, list[str]]:
        found: dict[str, list[str]] = {}
        for signal in (*self._program, *self._joints, *self._numbers):
            found.setdefault(signal.group, []).append(signal.name)
        return found

    def may_have(self, signal: PlotSignal) -> bool:
        """Returns whether a signal exists or a program may still add it."""
        return signal.group == PROGRAM or signal in self._joints or signal in self._numbers

    def follow(self, wanted: Collection[PlotSignal]) -> bool:
        """Sets the signals whose histories are stored.

        Histories of torques and of a program's signals are always stored.

        Returns:
            whether a history was added. To fill it, call `watch` for earlier times, see
            `Clock.replay_past`.
        """
        known = {*wanted} & {*self._joints, *self._numbers}
        new = {each for each in known - {*self._followed} if not self._has_torque(each)}
        for signal in {*self._followed} - known:
            del self._followed[signal]
        self._followed |= {signal: BinnedHistory((), _SPAN) for signal in new}
        if not self._is_listening and new & {*self._numbers}:
            self._is_listening = True
            self._mirror.listen(self._on_packets, to_all=True)
        return bool(new)

    def _has_torque(self, signal: PlotSignal) -> bool:
        return signal in self._joints and self._joints[signal][1] in ROWS

    def watch(self) -> None:
        world, data = self._mirror.world, self._mirror.data
        offset = data.time - time.monotonic()
        if offset > self._offset or offset < self._offset - _MAX_DELAY:
            self._offset = offset
        joints = [signal for signal in self._followed if signal in self._joints]
        if not joints:
            return
        values, stale = joint_values(world, data), self._staleness.find(data)
        for signal in joints:
            joint, key = self._joints[signal]
            value = np.nan if signal.group in stale else float(values[key][joint])
            self._add(signal, np.array([data.time]), np.array([value]))

    def _on_packets(self, source: str, packets: Packets) -> None:
        now = self._mirror.sources[source].now()
        times = self._mirror.data.time - now + packets.arrivals
        for signal in self._followed:
            if signal.group == source and signal in self._numbers:
                event, index = self._numbers[signal]
                values = packets.values[event].reshape(len(packets), -1)[:, index]
                self._add(signal, times, values)

    def _add(self, signal: PlotSignal, times: Array, values: Array) -> None:
        history = self._followed[signal]
        if self._mirror.data.time < history.newest - 1e-9:
            history.restart()
        history.add(times, np.where(np.isfinite(values), values, np.nan))

    def add_program(self, samples: Mapping[str, Array]) -> list[PlotSignal]:
        """Adds samples of a program's signals.

        Args:
            samples: mapping from signal names to samples, shape (n, 2). A row has the time of
                `time.monotonic` in seconds and the value.

        Returns:
            signals that did not exist before.
        """
        new = []
        for name, rows in samples.items():
            signal = PlotSignal(PROGRAM, name)
            if signal not in self._program:
                self._program[signal] = BinnedHistory((), _SPAN)
                new.append(signal)
            history, times = self._program[signal], rows[:, 0] + self._offset
            if times[0] < history.newest - _MIN_JUMP:
                history.restart()
            history.add(times, np.where(np.isfinite(rows[:, 1]), rows[:, 1], np.nan))
        return new

    def of(self, signal: PlotSignal, until: float, points: int) -> tuple[Array, Array]:
        """Returns the samples of a signal for a plot that ends at `until`, with the oldest first.

        Returns:
            times in seconds relative to `until` and values, both of shape (k,); NaN for no data.
        """
        if self._has_torque(signal):
            joint, key = self._joints[signal]
            times, values = self._torques.one(joint, key, points)
        else:
            history = self._program.get(signal) or self._followed.get(signal)
            if history is None:
                return np.zeros(0), np.zeros(0)
            times, (values,) = history.until(until, points)
        return times - until, values


def _joint_signals(world: WorldView) -> Iterator[tuple[PlotSignal, tuple[int, str]]]:
    slots = world.joints.slots
    for name, owner in world.owners.items():
        for joint in range(owner.joints.start, owner.joints.stop):
            label = world.joints.names[joint].removeprefix(f"{name}/")
            has = [key for key in slots if slots[key][joint] >= 0]
            for key in dict.fromkeys(["joint_angles", *has, "torque_error"]):
                yield PlotSignal(name, f"{label}.{key}"), (joint, key)


def _numbers(sources: Mapping[str, Source]) -> Iterator[tuple[PlotSignal, tuple[str, int]]]:
    for name, source in sources.items():
        for event, shape in source.events.items():
            for index, place in enumerate(np.ndindex(*shape)):
                where = "".join(f"[{i}]" for i in place) if np.prod(shape) > 1 else ""
                yield PlotSignal(name, f"{event}{where}"), (event, index)
