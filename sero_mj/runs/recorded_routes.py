"""Signals of robots from recorded packets, by a scene's routes."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..assemble.double import Double
from ..assemble.robot import SerialRobot
from ..assemble.scene import Scene, names_in, origin_text
from ..drive.route import Origin
from ..drive.wiring import Wiring, wire
from ..errors import RecordingError
from ..receive.source import SIGNALS, Source
from ..record.recording import Recording
from .recorded_events import read_events, receiver_of
from .run_log import event_of

Array = NDArray[np.float64]

# Inputs of a robot that are signals of a run.
_SIGNALS = ("joint_angles", "torques", "commanded_torques")
_TARGET = "target_angles"  # of a double


def follow_routes(
    recording: Recording,
    sources: Collection[str],
    robots: Mapping[str, SerialRobot],
    routes: Mapping[str, Any],
    doubles: Mapping[str, Any],
) -> tuple[dict[str, Array], Array]:
    """Computes the inputs of robots over a recording.

    The rows are the packets of the source that moves the first robot; of other sources the
    newest packet counts, as in a picture.

    Args:
        recording: where from.
        sources: which of its sources.
        robots: by name.
        routes: input to origin, as a scene has them; those from elsewhere are left out.
        doubles: double to its table; the first double that is moved is its robot's target.

    Returns:
        signals by event, (T, n), and their times (T,), s since the first row.

    Raises:
        RecordingError: no robot is moved by what was recorded, or a route is wrong.
    """
    of = {name: str(table["of"]) for name, table in doubles.items()
          if isinstance(table, Mapping) and table.get("of") in robots}  # fmt: skip
    wanted = {name: origin_text(origin) for name, origin in routes.items()}
    wanted = _possible(wanted, set(robots) | set(of), sources)
    receivers = {name: receiver_of(recording, name) for name in sources}
    scene = Scene(
        robots=list(robots.values()),
        doubles=[Double(name=name, of=robot) for name, robot in of.items()],
        sources=receivers,
        routes=wanted,
    )
    wiring = wire(scene)
    if wiring.problems:
        reason = "; ".join(str(problem) for problem in wiring.problems[:3])
        raise RecordingError(recording.path, f"its routes cannot be followed: {reason}")
    values = {route.to.target: route.value for route in wiring.routes}
    moved = [name for name in robots if f"{name}.joint_angles" in values]
    if not moved:
        led = ", ".join(routes) or "none"
        reason = f"no source in it moves a robot: found routes to {led}; expected {{}}.joint_angles"
        raise RecordingError(recording.path, reason.format(next(iter(robots))))
    follower = _Follower(recording, receivers, wiring, moved[0])
    return follower.signals(robots, of)


def _possible(
    routes: Mapping[str, str], owners: Collection[str], sources: Collection[str]
) -> dict[str, str]:
    """Routes to values of joints from what was recorded, or from each other."""
    inputs = {target for target in routes if target.partition(".")[0] in owners
              and target.partition(".")[2] in (*_SIGNALS, "joint_accelerations",
                                               "billboard_values")}  # fmt: skip
    left = {target: routes[target] for target in inputs}
    while True:
        bad = [target for target, origin in left.items()
               if not all(_is_there(name, left, sources) for name in names_in(origin))]  # fmt: skip
        if not bad:
            return {target: left[target] for target in routes if target in left}
        for target in bad:
            del left[target]


def _is_there(name: str, routes: Collection[str], sources: Collection[str]) -> bool:
    """Whether a name in an origin is a unit, a recorded event or another route's input."""
    owner, dot, key = name.partition(".")
    return not dot or name in routes or (owner in sources and key not in SIGNALS)


class _Follower:
    """Computes routes over time, each once."""

    def __init__(
        self,
        recording: Recording,
        receivers: Mapping[str, Source],
        wiring: Wiring,
        first: str,
    ) -> None:
        self._routes = {route.to.target: route.value for route in wiring.routes}
        names = {origin.name for value in self._routes.values() for origin in value.origins
                 if origin.is_event}  # fmt: skip
        self._series = {name: read_events(recording, receivers[name], name) for name in names}
        self._path = recording.path
        self._done: dict[str, Array] = {}
        self._times = self._rows_of(f"{first}.joint_angles")

    def _rows_of(self, target: str) -> Array:
        todo, times = [target], []
        while todo:
            for origin in self._routes[todo.pop()].origins:
                if origin.is_event:
                    times.append(self._series[origin.name].times)
                elif str(origin) in self._routes:
                    todo.append(str(origin))
        longest = max(times, key=len, default=np.empty(0))
        if len(longest) == 0:
            raise RecordingError(self._path, f"has no good packet that leads to {target}")
        return longest

    def signals(
        self, robots: Mapping[str, SerialRobot], doubles: Mapping[str, str]
    ) -> tuple[dict[str, Array], Array]:
        found: dict[str, Array] = {}
        for name in robots:
            if f"{name}.joint_angles" not in self._routes:
                continue
            for signal in _SIGNALS:
                if f"{name}.{signal}" in self._routes:
                    found[event_of(name, signal)] = self._compute(f"{name}.{signal}")
            for double, robot in doubles.items():
                event = event_of(name, _TARGET)
                target = f"{double}.joint_angles"
                if robot == name and target in self._routes and event not in found:
                    found[event] = self._compute(target)
        angles = [values for event, values in found.items() if event.endswith("_angles")
                  and not event.endswith(_TARGET)]  # fmt: skip
        there = np.isfinite(np.hstack(angles)).all(axis=1)
        if not there.any():
            raise RecordingError(self._path, "never tells where all of its robots are at once")
        times = self._times[there]
        return {event: values[there] for event, values in found.items()}, times - times[0]

    def _compute(self, target: str) -> Array:
        if target not in self._done:
            with np.errstate(over="ignore", invalid="ignore"):
                values = self._routes[target].evaluate(self._numbers)
            # What takes nothing received is the same at all times.
            self._done[target] = np.broadcast_to(values, (len(self._times), values.shape[-1]))
        return self._done[target]

    def _numbers(self, origin: Origin) -> Array:
        if origin.is_event:
            return self._series[origin.name].held_at(origin.key, self._times)
        return self._compute(str(origin))
