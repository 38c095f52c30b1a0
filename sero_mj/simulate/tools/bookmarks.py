"""`Bookmarks`: the user's marks and detected faults on the timeline."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from ...base.errors import SeroError
from ...base.frames import Array, Bools
from ...data.receive.reception import QUIET_AFTER
from ...data.record.file_source import FileSource
from ...robots.declared.inputs import SOURCE_FIELDS
from ...viewer.decor.quantities import joint_name, joint_values, torque_text
from ...viewer.session.clock import Tick, time_text
from ...viewer.session.keys import Key
from ...viewer.session.tool import Action, Shown, Tool
from ..runs.monitor import Monitor
from ..runs.run_recording import read_run
from ..runs.run_source import RunSource

_MAX_COUNT = 1000  # maximum number of faults
_MIN_INTERVAL = 0.5  # minimum time between two faults of the same kind at a joint, s
_SAME = 1e-3  # tolerance for equal times, s
_AGE = SOURCE_FIELDS.index("age")
# Counters of a source, and their names in messages.
_LOSSES = {"lost": "lost", "dropped": "dropped", "malformed": "not applied"}
_COLUMNS = [SOURCE_FIELDS.index(name) for name in _LOSSES]


class Bookmarks(Tool):
    """Marks set by the user, and faults that a monitor detects in simulations and recordings.

    Live sources are monitored continuously. Their faults are joints beyond torque or angle limits,
    torque errors above the monitor's threshold, silent sources, and packets that are lost or not
    applied.
    """

    order: ClassVar[int] = 60
    keys: ClassVar[Mapping[str, Key]] = {
        "m": Key("mark", "mark this time"),
        "e": Key("next_event", "next mark or fault (w: previous)", repeats=True),
        "w": Key("last_event", repeats=True),
    }

    def __init__(self, shown: Shown) -> None:
        super().__init__(shown)
        mirror = self._mirror = shown.mirror
        self._clock = shown.clock
        self._marks: list[float] = []
        self._watched: deque[Tick] = deque(maxlen=_MAX_COUNT)
        self._of_recordings: list[Tick] | None = None
        world = mirror.world
        joints = world.joints
        self._names = [joint_name(world, i) for i in range(len(joints.names))]
        self._share = Monitor().torque_error
        self._low, self._high = np.full((2, len(joints.names)), np.nan)
        for owner in world.owners.values():
            limits = owner.robot.position_limits
            if limits is not None:
                self._low[owner.joints], self._high[owner.joints] = limits.T
        self._was: Bools = np.zeros((3, len(joints.names)), bool)
        self._last: Array = np.full((3, len(joints.names)), -np.inf)  # times of detection, s
        self._silent: set[str] = set()
        # By source: values of the counters in `_LOSSES`, and times of their last change, s.
        self._counts: dict[str, tuple[Array, Array]] = {}

    def actions(self) -> Mapping[str, Action]:
        return {
            "mark": self.mark,
            "next_event": lambda: self.go(1),
            "last_event": lambda: self.go(-1),
        }

    def mark(self) -> str:
        """Marks the shown time, and returns a message."""
        self._marks.append(self._clock.time)
        return f"marked {time_text(self._clock.time)}: e and w go to the next and previous mark"

    @property
    def _of_user(self) -> list[Tick]:
        return [Tick(time, "mark", is_mark=True) for time in self._marks]

    def watch(self) -> None:
        """Detects faults in the current state, if it is live."""
        if not self._clock.is_live:
            return
        world, data = self._mirror.world, self._mirror.data
        for name in self._mirror.sources:
            slot = data.userdata[world.slots[f"sources.{name}"]]
            self._watch_counts(name, slot[_COLUMNS], data.time)
            last = slot[_AGE]
            if last > QUIET_AFTER and name not in self._silent:
                self._silent.add(name)
                self._found(f"{name} is silent", data.time - last)
            elif 0 <= last <= QUIET_AFTER:
                self._silent.discard(name)
        values, joints = joint_values(world, data), world.joints
        limit = np.where(joints.is_largest, np.inf, joints.torque_limit)
        torque, error, angle = (values[k] for k in ("torques", "torque_error", "joint_angles"))
        with np.errstate(invalid="ignore"):
            bad = np.array([np.abs(torque) > limit, np.abs(error) > self._share * limit,
                            (angle < self._low) | (angle > self._high)])  # fmt: skip
        new = bad & ~self._was & (data.time > self._last + _MIN_INTERVAL)
        self._was = bad
        self._last[bad] = data.time
        if not new.any():
            return
        kinds = ("torque {}, above its limit", "torque error {}", "angle {} beyond its limit")
        for kind, joint in np.argwhere(new):
            value = (torque, error, angle)[kind][joint]
            is_angle = kind == len(kinds) - 1
            number = f"{value:.3g}" if is_angle else torque_text(world, joint, value)
            text = kinds[kind].format(number)
            if is_angle:
                limit = (self._low if value < self._low[joint] else self._high)[joint]
                text += f" of {limit:.3g} {'rad' if world.joints.revolute[joint] else 'm'}"
            self._found(f"{self._names[joint]}: {text}", data.time)

    def _watch_counts(self, name: str, counts: Array, time: float) -> None:
        never = np.full(len(counts), -np.inf)
        before, seen = self._counts.get(name, (np.zeros_like(counts), never))
        grown = counts > before
        for what, more in zip(_LOSSES.values(), grown & (time > seen + _MIN_INTERVAL), strict=True):
            if more:
                self._found(f"{name}: packets {what}", time)
        self._counts[name] = counts, np.where(grown, time, seen)

    def _found(self, text: str, time: float) -> None:
        self._watched.append(Tick(float(time), text, is_mark=False))

    def all(self) -> list[Tick]:
        found = [*self._of_user, *self._watched]
        for source in self._mirror.sources.values():
            if isinstance(source, RunSource):
                found += map(_bookmark_of, source.run.findings())
        found += self._of_recordings or ()
        return sorted(tick for tick in found if tick.time >= self._clock.begin)

    def ticks(self) -> list[Tick]:
        """Returns all known bookmarks, without searching recordings."""
        found = [*self._of_user, *self._watched, *(self._of_recordings or ())]
        return [each for each in found if each.time >= self._clock.begin]

    def go(self, places: int) -> str:
        """Goes to the next (1) or previous (-1) bookmark, and returns a message."""
        clock = self._clock
        if self._of_recordings is None:
            self._of_recordings = self._search()
        there = [tick for tick in self.all() if (tick.time - clock.time) * places > _SAME]
        if not clock.can_go_back or not there:
            return f"no marks or faults {'after' if places > 0 else 'before'} this time"
        tick = there[0] if places > 0 else there[-1]
        clock.is_paused = True
        clock.seek(tick.time)
        return f"{time_text(tick.time)}: {tick.text}"

    def _search(self) -> list[Tick]:
        """Returns the faults in recordings that are being played."""
        found: list[Tick] = []
        for source in self._mirror.sources.values():
            if not isinstance(source, FileSource) or source.end is None:
                continue
            try:
                log = read_run(source.file, scene=self._mirror.world.scene)
            except SeroError:
                continue
            start, speed = source.start or 0.0, source.speed
            for finding in Monitor().find(log)[:_MAX_COUNT]:
                tick = _bookmark_of(finding)
                found.append(tick._replace(time=(tick.time - start) / speed))
        return found


def _bookmark_of(finding: Any) -> Tick:
    text = str(finding).partition("  ")[2].replace("  ", " ")
    return Tick(finding.time, text, is_mark=False)
