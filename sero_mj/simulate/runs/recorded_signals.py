"""Signals over time of recorded packets: events of a source, and inputs of routed robots."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import RecordingError
from ...base.frames import Array
from ...data.drive.model_torques import MODEL_TORQUES, ModelTorques
from ...data.drive.route import Affine, Origin
from ...data.drive.wiring import wire
from ...data.receive.intake import pad_packets
from ...data.receive.mailbox import Packets
from ...data.receive.source import SIGNALS, Source
from ...data.record.recording import PacketFile
from ...robots.assemble.friction_torques import VELOCITIES
from ...robots.declared.double import Double
from ...robots.declared.groups import Group
from ...robots.declared.robot import SerialRobot
from ...robots.declared.route_text import names_in, route_texts
from ...robots.declared.scene import Scene
from .run_log import event_of

# Inputs of a robot that are also signals of a run log.
_SIGNALS = ("joint_angles", "torques", "commanded_torques")
_TARGET = "target_angles"  # signal for the joint angles of a double
_CHUNK = 8192  # number of packets that are decoded together
# Maximum and minimum number of packets from which the typical period is estimated.
_TYPICAL, _MIN_TYPICAL = 64, 8
# Maximum time between packets of a burst, and maximum duration of a burst per packet, relative to
# the typical period; a longer burst follows a pause. With more than _MAX_BURSTS bursts per packet,
# the packets did not arrive in bursts.
_BURST, _MAX_BURSTS, _LONGEST = 0.25, 0.6, 2.0


@dataclass(frozen=True, eq=False)
class Series:
    """The values of a source's events over time.

    Attributes:
        times: increasing times, shape (T,), s.
        events: values by event name, shape (T, count).
    """

    times: Array
    events: dict[str, Array]

    def held_at(self, event: str, times: Array) -> Array:
        """Returns the latest values of an event at T times, (T, count), or NaN before the first."""
        at = np.searchsorted(self.times, times, side="right") - 1
        values = self.events[event][np.maximum(at, 0)].copy()
        values[at < 0] = np.nan
        return values


def read_events(recording: PacketFile, receiver: Source, name: str) -> Series:
    """Decodes a source's packets and skips malformed ones.

    If the packets contain increasing send times, these are used, shifted so that the first send
    time equals the first arrival time. Otherwise, arrival times are used, and bursts are spread
    evenly (see `spread_bunches`).

    Args:
        receiver: source that decodes the packets. Its declaration decides where NaN is allowed.

    Raises:
        RecordingError: the file cannot be read.
        UnknownName: there is no such source.
    """
    parts = list(_decoded(recording, receiver, name))
    if not parts:
        events = {event: np.empty((0, *shape)) for event, shape in receiver.events.items()}
        return Series(np.empty(0), {key: _flat(values) for key, values in events.items()})
    events = {
        event: _flat(np.concatenate([part.values[event] for part in parts]))
        for event in receiver.events
    }
    return series_of(receiver, events, np.concatenate([part.arrivals for part in parts]))


def series_of(receiver: Source, events: Mapping[str, Array], arrivals: Array) -> Series:
    """Returns the values of a source's valid packets over time; see `read_events`.

    Args:
        receiver: source. Its `time` is the name of the event with the send time, if any.
        events: values by event name, shape (T, count), with T >= 1.
        arrivals: arrival times, shape (T,), s.
    """
    times = spread_bunches(arrivals)
    if receiver.time:
        sent = events[receiver.time][:, 0] * receiver.time_scale
        if np.isfinite(sent).all() and (np.diff(sent) > 0).all():
            times = sent - sent[0] + arrivals[0]
    # If several packets have the same time, only the last one was shown.
    later = np.minimum.accumulate(times[::-1])[::-1]
    keep = np.append(times[:-1] < later[1:], True)
    return Series(times[keep], {event: values[keep] for event, values in events.items()})


def spread_bunches(arrivals: Array) -> Array:
    """Estimates the send times of packets that arrived in bursts, shape (T,), s.

    Buffers or a slow network deliver packets in bursts, and differences between their arrival times
    are meaningless. The last packet of a burst retains its arrival time. The others are spread
    evenly after the previous burst. Without bursts, the arrival times are returned.

    Args:
        arrivals: arrival times, shape (T,), s, not decreasing.
    """
    size = min(_TYPICAL, len(arrivals) - 1)
    if size < _MIN_TYPICAL:
        return arrivals
    period = float(np.median(arrivals[size:] - arrivals[:-size])) / size  # robust to pauses
    begins = np.append(True, np.diff(arrivals) >= _BURST * period)
    if begins.mean() > _MAX_BURSTS:
        return arrivals
    firsts = np.flatnonzero(begins)
    counts = np.diff(np.append(firsts, len(arrivals)))
    ends = arrivals[firsts + counts - 1]
    usual, spans = counts * period, np.diff(ends, prepend=-np.inf)
    spans = np.where(spans > _LONGEST * usual, usual, spans)  # after a pause, and the first burst
    behind = np.repeat(counts + firsts, counts) - 1 - np.arange(len(arrivals))
    return np.asarray(np.repeat(ends, counts) - np.repeat(spans / counts, counts) * behind)


def _decoded(recording: PacketFile, receiver: Source, name: str) -> Iterator[Packets]:
    intake, number = receiver.intake, 0
    packets = recording.packets(name)
    while batch := list(islice(packets, _CHUNK)):
        times, packed = zip(*batch, strict=True)
        rows, arrivals = intake.take(*pad_packets(packed, receiver.size), np.array(times))
        intake.count()
        number += len(rows)
        if len(rows):
            yield Packets(intake.decode(rows), arrivals, number)


def _flat(values: Array) -> Array:
    return values.reshape(len(values), int(np.prod(values.shape[1:])))


def follow_routes(
    path: Path,
    receivers: Mapping[str, Source],
    read: Callable[[str], Series],
    robots: Mapping[str, SerialRobot],
    routes: Mapping[str, Any],
    doubles: Mapping[str, Any],
    groups: Mapping[str, Any],
) -> tuple[dict[str, Array], Array]:
    """Computes the inputs of robots over time from a recording or a table.

    There is one row for each packet of the source that moves the first robot. For other sources,
    the latest packet is used.

    Args:
        routes: origins by input, as in a scene. Routes from sources that are not in `receivers` are
            ignored.
        doubles: tables of doubles by name. The first double of a robot (or of its group) whose
            angles are routed shows the robot's target.

    Returns:
        signals by event name, shape (T, n), and times since the first row in seconds, shape (T,).

    Raises:
        RecordingError: no recorded source moves a robot, or a route is invalid.
    """
    wanted = route_texts(routes)
    lists = {name: [each for each in table["robots"] if each in {*robots, *groups}]
             for name, table in groups.items()
             if isinstance(table, Mapping) and isinstance(table.get("robots"), list)}  # fmt: skip
    grouped = [Group(name=name, robots=names) for name, names in lists.items() if names]
    owners = {*robots, *(group.name for group in grouped)}
    of = {name: str(table["of"]) for name, table in doubles.items()
          if isinstance(table, Mapping) and table.get("of") in owners}  # fmt: skip
    own = {f"{name}.{key}" for name, robot in robots.items() for key in robot.inputs}
    wanted = _possible(wanted, {*owners, *of}, receivers, own)
    scene = Scene(
        robots=list(robots.values()),
        groups=grouped,
        doubles=[Double(name=name, of=robot) for name, robot in of.items()],
        sources=dict(receivers),
        routes=wanted,
    )
    wiring = wire(scene)
    if wiring.problems:
        reason = "; ".join(str(problem) for problem in wiring.problems[:3])
        raise RecordingError(path, f"its routes cannot be followed: {reason}")
    values = {route.to.target: route.value for route in wiring.routes}
    moved = [name for name in robots if f"{name}.joint_angles" in values]
    if not moved:
        routed = ", ".join(routes) or "none"
        expected = f"{next(iter(robots))}.joint_angles"
        reason = f"no recorded source moves a robot: found routes to {routed}; expected {expected}"
        raise RecordingError(path, reason)
    names = {origin.name for value in values.values() for origin in value.origins
             if origin.is_event}  # fmt: skip
    series = {name: read(name) for name in names}
    follower = _Follower(values, series, path, f"{moved[0]}.joint_angles", robots)
    inputs = {event_of(name, signal): f"{name}.{signal}"
              for name in moved for signal in (*_SIGNALS, *robots[name].inputs)}  # fmt: skip
    for double, robot in ((name, each.of) for name, each in scene.doubles.items()):
        if robot in moved and f"{double}.joint_angles" in values:
            inputs.setdefault(event_of(robot, _TARGET), f"{double}.joint_angles")
    found = {event: follower.compute(each) for event, each in inputs.items() if each in values}
    angles = [found[event_of(name, "joint_angles")] for name in moved]
    there = np.isfinite(np.hstack(angles)).all(axis=1)
    if not there.any():
        raise RecordingError(path, "has no time at which the poses of all robots are known")
    times = follower.times[there]
    return {event: values[there] for event, values in found.items()}, times - times[0]


def _possible(
    routes: Mapping[str, str], owners: Collection[str], sources: Collection[str],
    own: Collection[str],
) -> dict[str, str]:  # fmt: skip
    inputs = {target for target in routes if target.partition(".")[0] in owners
              and target.rpartition(".")[2] in (*_SIGNALS, VELOCITIES, "joint_accelerations",
                                               "billboard_values")}  # fmt: skip
    left = {target: routes[target] for target in routes if target in inputs or target in own}
    while True:
        known = {target: origin for target, origin in left.items()
                 if all(_is_there(name, left, sources) for name in names_in(origin))}  # fmt: skip
        if len(known) == len(left):
            return {target: left[target] for target in routes if target in left}
        left = known


def _is_there(name: str, routes: Collection[str], sources: Collection[str]) -> bool:
    """Returns whether a name in a route's origin can be evaluated.

    Known names are units, recorded events, inputs of other routes and torques of a robot's model.
    """
    owner, dot, key = name.partition(".")
    if key in MODEL_TORQUES and f"{owner}.joint_angles" in routes:
        return True
    return not dot or name in routes or (owner in sources and key not in SIGNALS)


class _Follower:
    """Evaluates routes at the packet times of the source of the route `first`."""

    def __init__(
        self,
        routes: Mapping[str, Affine],
        series: Mapping[str, Series],
        path: Path,
        first: str,
        robots: Mapping[str, SerialRobot],
    ) -> None:
        self._routes, self._series = routes, series
        self._model = ModelTorques(robots)
        self._done: dict[str, Array] = {}
        todo, leading = [first], []
        while todo:
            for origin in routes[todo.pop()].origins:
                if origin.is_event:
                    leading.append(series[origin.name].times)
                elif str(origin) in routes:
                    todo.append(str(origin))
        self.times: Array = max(leading, key=len, default=np.empty(0))
        if len(self.times) == 0:
            raise RecordingError(path, f"has no valid packet for {first}")

    def compute(self, target: str) -> Array:
        if target not in self._done:
            with np.errstate(over="ignore", invalid="ignore"):
                values = self._routes[target].evaluate(self._numbers)
            # Routes without events are constant.
            self._done[target] = np.broadcast_to(values, (len(self.times), values.shape[-1]))
        return self._done[target]

    def _numbers(self, origin: Origin) -> Array:
        if origin.is_event:
            return self._series[origin.name].held_at(origin.key, self.times)
        if str(origin) not in self._routes and origin.key in MODEL_TORQUES:
            torques = self._model.output(origin.name, origin.key, self._input)
            return np.broadcast_to(torques, (len(self.times), torques.shape[-1]))
        return self.compute(str(origin))

    def _input(self, target: str) -> Array | None:
        if target in self._routes:
            return self.compute(target)
        robot, _, key = target.partition(".")
        angles = f"{robot}.joint_angles"
        if key == VELOCITIES and angles in self._routes and len(self.times) > 1:
            return np.gradient(self.compute(angles), self.times, axis=0)
        return None
