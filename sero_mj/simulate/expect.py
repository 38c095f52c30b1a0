"""`Expect`: pass criteria of a run, for CI."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from pydantic import Field, model_validator

from ..assemble.scene import Scene
from ..declaration import Declaration, Name
from ..errors import DeclarationError, Problem, did_you_mean
from ..frames import Array
from ..runs.measures import MEASURES, NEED_TARGET, OF_FREE
from ..runs.monitor import KINDS, Finding
from ..runs.run_log import RunLog
from .disturbances import Disturbance, Fault


class RunContext(Protocol):
    """What an expectation has to know of the scenario that was run."""

    scene: Scene
    disturbances: dict[str, Disturbance]
    faults: dict[str, Fault]

    @property
    def duration(self) -> float:
        """Of the run, s."""

    @property
    def has_surroundings(self) -> bool:
        """Whether there is something that robots can touch."""

    def has_target(self, robot: str) -> bool:
        """Whether a robot is to be somewhere."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of an expectation.

    Attributes:
        name: of what was expected.
        holds: whether it did.
        text: what was found, and what was expected.
        value: what was found; NaN where nothing was.
    """

    name: str
    holds: bool
    text: str
    value: float


class Expect(Declaration):
    """A number that must stay within bounds, or a fault that must be found (or must not).

    Attributes:
        measure: one of `MEASURES`: `position_error`, `flange_error`, `torque_share`, ...
        robot: whose; all robots when None.
        object: a free object, whose `height`, `displacement` or `tilt` it is.
        joints: names; all when empty.
        below: what its size must be below, at every joint.
        above: what its size must be above, at one joint at least.
        after: from this time on, s.
        before: until this time, s.
        of: `max`, `rms`, `mean`, `min` or `final`: what of it counts.
        finds: a kind of fault that the monitor must find, in one of the joints.
        within: s after the disturbance or fault `cause` (or after `after`) at the latest.
        cause: name of the disturbance or fault.
        finds_nothing: kinds that the monitor must not find between `after` and `before`; `any`.
    """

    measure: str | None = None
    robot: Name | None = None
    object: Name | None = None
    joints: list[str] = Field(default_factory=list)
    below: float | None = None
    above: float | None = None
    after: float = Field(0.0, ge=0)
    before: float | None = None
    of: Literal["max", "rms", "mean", "min", "final"] = "max"
    finds: str | None = None
    within: float | None = Field(None, gt=0)
    cause: str | None = None
    finds_nothing: list[str] | Literal["any"] | None = None

    @model_validator(mode="after")
    def _asks_one_thing(self) -> Expect:
        asked = [
            key for key in ("measure", "finds", "finds_nothing") if getattr(self, key) is not None
        ]
        if len(asked) != 1:
            found = " and ".join(asked) or "none of them"
            raise ValueError(f"found {found}; expected one of measure, finds, finds_nothing")
        if self.measure is None:
            for key in ("below", "above", "of"):
                if key in self.model_fields_set:
                    raise ValueError(f"{key}: is for a measure; found {asked[0]}")
        elif self.finds is None and (self.within is not None or self.cause is not None):
            raise ValueError("within and cause are for what `finds` a fault")
        if self.below is not None and self.above is not None and self.above >= self.below:
            raise ValueError(f"above: found {self.above:g}; expected less than {self.below:g}")
        if self.measure is not None and self.below is None and self.above is None:
            raise ValueError("below: is required; expected below or above, a number")
        for key, known in (("measure", list(MEASURES)), ("finds", [*KINDS, "any"])):
            value = getattr(self, key)
            if value is not None and value not in known:
                raise ValueError(f"{key}: no '{value}'{did_you_mean(value, known)}")
        self._check_free()
        for kind in self.finds_nothing if isinstance(self.finds_nothing, list) else []:
            if kind not in KINDS:
                raise ValueError(f"finds_nothing: no '{kind}'{did_you_mean(kind, list(KINDS))}")
        if self.before is not None and self.before <= self.after:
            raise ValueError(f"before: found {self.before:g}; expected more than {self.after:g} s")
        return self

    def _check_free(self) -> None:
        """Looks whether measures of what is free, and no others, say of what."""
        if self.measure in OF_FREE and (self.robot is None) == (self.object is None):
            found = "none of them" if self.robot is None else "robot and object"
            raise ValueError(
                f"measure: '{self.measure}' is of one thing that is free; found {found}; expected "
                "robot, with a free base, or object"
            )
        if self.measure not in OF_FREE and self.object is not None:
            raise ValueError(f"object: is for {', '.join(OF_FREE)}; found {self.measure}")

    def check(self, scenario: RunContext) -> None:
        """Checks that the scenario has the robots, joints and causes that are named.

        Raises:
            DeclarationError: no such robot, joint, disturbance or fault.
        """
        robots = scenario.scene.robots
        problems = []
        if self.robot is not None and self.robot not in robots:
            near = did_you_mean(self.robot, robots)
            problems.append(Problem("robot", f"no robot '{self.robot}'{near}"))
        problems += self._not_free(scenario.scene)
        names = [name for robot in self._robots(list(robots)) if robot in robots
                 for name in robots[robot].names]  # fmt: skip
        problems += [
            Problem("joints", f"no joint '{joint}'{did_you_mean(joint, names)}")
            for joint in self.joints
            if joint not in names
        ]
        causes = [*scenario.disturbances, *scenario.faults]
        if self.cause is not None and self.cause not in causes:
            near = did_you_mean(self.cause, causes)
            problems.append(Problem("cause", f"no disturbance or fault '{self.cause}'{near}"))
        if self.measure in NEED_TARGET:
            problems += [
                Problem("measure", f"robot '{robot}' has no target; expected [targets.{robot}]")
                for robot in self._robots(list(robots))
                if robot in robots and not scenario.has_target(robot)
            ]
        if self.measure == "contact_force" and not scenario.has_surroundings:
            message = "has nothing to touch; expected an object or another robot in the scene"
            problems.append(Problem("measure", message))
        if self.after >= scenario.duration:
            message = f"found {self.after:g} s; the run ends at {scenario.duration:g} s"
            problems.append(Problem("after", message))
        if problems:
            raise DeclarationError(problems)

    def _not_free(self, scene: Scene) -> list[Problem]:
        """Returns that what must be free for this measure is fixed, or is not there."""
        if self.object is not None:
            objects = {item.name: item for item in scene.objects}
            if self.object not in objects:
                near = did_you_mean(self.object, objects)
                return [Problem("object", f"no object '{self.object}'{near}")]
            if not objects[self.object].is_free:
                return [Problem("object", f"'{self.object}' is fixed; expected one with a mass")]
            return []
        robot = scene.robots.get(self.robot or "") if self.measure in OF_FREE else None
        if robot is None or robot.free_base:
            return []
        return [Problem("robot", f"the base of '{self.robot}' is fixed; expected free_base = true")]

    def _robots(self, all_of_them: Sequence[str]) -> list[str]:
        return list(all_of_them) if self.robot is None else [self.robot]

    def judge(
        self, name: str, log: RunLog, findings: Sequence[Finding], scenario: RunContext
    ) -> Outcome:
        """Says whether it held in a run.

        Args:
            name: of the expectation.
            log: of the run.
            findings: of the monitor.
            scenario: that was run.
        """
        if self.measure is not None:
            return self._judge_measure(name, log)
        start = self.after
        if self.cause is not None:
            cause = scenario.disturbances.get(self.cause) or scenario.faults[self.cause]
            start = max(start, cause.begin)
        end = np.inf if self.before is None else self.before
        mine = [
            finding
            for finding in findings
            if start <= finding.time <= end
            and finding.robot in self._robots(list(log.robots))
            and (not self.joints or finding.joint in self.joints)
        ]
        if self.finds is None:
            return self._judge_nothing(name, mine)
        found = [finding for finding in mine if self.finds in (finding.kind, "any")]
        what = "fault" if self.finds == "any" else self.finds.replace("_", " ")
        limit = "" if self.within is None else f", expected within {1e3 * self.within:g} ms"
        if not found:
            return Outcome(name, False, f"no {what} found{limit or ', expected one'}", np.nan)
        late = found[0].time - start
        holds = self.within is None or late <= self.within
        text = f"{what} at {found[0].joint} found after {1e3 * late:.0f} ms{limit}"
        return Outcome(name, holds, text, late)

    @property
    def unit(self) -> str:
        """Unit of the value that is found: of its measure, s until a finding, or none."""
        if self.measure is not None:
            return MEASURES[self.measure][0]
        return "" if self.finds_nothing is not None else "s"

    def _judge_nothing(self, name: str, findings: Sequence[Finding]) -> Outcome:
        wanted = KINDS if self.finds_nothing == "any" else self.finds_nothing or ()
        found = [finding for finding in findings if finding.kind in wanted]
        if not found:
            return Outcome(name, True, "nothing found, as expected", 0.0)
        return Outcome(name, False, f"expected to find nothing; found {found[0]}", len(found))

    def _judge_measure(self, name: str, log: RunLog) -> Outcome:
        assert self.measure is not None
        unit, compute = MEASURES[self.measure]
        rows = log.times >= self.after - 1e-9
        if self.before is not None:
            rows &= log.times <= self.before + 1e-9
        worst, place = -np.inf, ""
        reaches_end = log.times[-1] >= (self.after if self.before is None else self.before) - 1e-6
        whose = self._robots(list(log.robots)) if self.object is None else [self.object]
        for robot in whose:
            values = np.abs(compute(log, robot)[rows])
            names = log.robots[robot].names if values.shape[1] > 1 else [""]
            chosen = [k for k, joint in enumerate(names)
                      if not self.joints or joint in self.joints or not joint]  # fmt: skip
            if not len(values) or not chosen:  # the run ended before
                continue
            reduced = _REDUCE[self.of](values[:, chosen])
            k = int(np.argmax(reduced))
            if reduced[k] > worst:
                worst = float(reduced[k])
                place = "/".join(filter(None, (robot, names[chosen[k]])))
        holds = bool(place) and reaches_end
        holds &= self.below is None or worst < self.below
        holds &= self.above is None or worst > self.above
        given = (("below", self.below), ("above", self.above))
        bounds = [f"{word} {bound:g}" for word, bound in given if bound is not None]
        of = "" if self.of == "max" else f"{self.of} "
        what = f"{of}{self.measure.replace('_', ' ')}"
        if not place:
            text = f"{what}: the run ended at {log.times[-1]:g} s, before it counts"
            return Outcome(name, False, f"{text}; expected {' and '.join(bounds)}", np.nan)
        text = f"{what} {worst:.4g} {unit} at {place}"
        ended = "" if reaches_end else "; the run ended before"
        return Outcome(name, bool(holds), f"{text}, expected {' and '.join(bounds)}{ended}", worst)


_REDUCE: dict[str, Callable[[Array], Array]] = {
    "max": lambda values: values.max(axis=0),
    "min": lambda values: values.min(axis=0),
    "mean": lambda values: values.mean(axis=0),
    "rms": lambda values: np.sqrt(np.mean(values**2, axis=0)),
    "final": lambda values: values[-1],
}
