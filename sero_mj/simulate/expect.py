"""`Expect`: pass criteria of a run, for CI."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
from pydantic import Field, model_validator

from ..base.declaration import Declaration, Name
from ..base.errors import DeclarationError, Problem
from ..base.frames import Array, Bools
from ..robots.declared.scene import Scene
from .disturbances import Disturbance, Fault
from .runs.measures import MEASURES, NEED_REAL_TIME, NEED_TARGET, OF_FREE, PER_JOINT, SIGNED
from .runs.monitor import KINDS, Finding
from .runs.run_log import RunLog


class RunContext(Protocol):
    """The parts of a scenario that an expectation depends on."""

    scene: Scene
    disturbances: dict[str, Disturbance]
    faults: dict[str, Fault]
    broken: set[str]  # disturbances and faults with an invalid declaration

    @property
    def duration(self) -> float: ...

    @property
    def has_surroundings(self) -> bool: ...

    def has_target(self, robot: str) -> bool: ...

    def is_in_real_time(self, robot: str) -> bool: ...


@dataclass(frozen=True)
class Outcome:
    """The outcome of an expectation.

    Attributes:
        name: name of the expectation.
        holds: whether the expectation passed.
        text: message with the found and expected values.
        value: found value, or NaN if there is none.
    """

    name: str
    holds: bool
    text: str
    value: float


class Expect(Declaration):
    """A value that must stay within bounds, or a fault that must (or must not) be detected.

    A measure has a value for every joint, or for every robot, at every time. `of` reduces the
    values over time to one value, and `holds_at` selects the joints and robots at which this value
    must be within the bounds.

    Attributes:
        measure: name of a measure: `position_error`, `flange_error`, `torque_share`,
            `real_time_factor` or another one of `MEASURES`.
        robot: robot name (default: all robots).
        object: name of a free object, for `height`, `displacement` or `tilt`.
        joints: joint names (default: all joints).
        signed: whether the bounds apply to signed values instead of absolute values.
        of: reduction over time: `max`, `rms`, `mean`, `min` or `final` (default: `max`; `final` for
            `real_time_factor`, which is simulated time divided by elapsed time).
        below: upper bound.
        above: lower bound.
        holds_at: joints at which the bounds must hold: `all` joints of all robots (default if only
            `below` is set), `any` (at least one joint), or `each_robot` (at least one joint of each
            robot). It is required for `above` if there are several joints.
        after: beginning of the evaluated time, s.
        before: end of the evaluated time, s.
        finds: kind of fault that the monitor must detect in one of the joints.
        within: maximum delay of the detection in seconds, measured from the disturbance or fault
            `cause`, or from `after`.
        cause: name of the disturbance or fault.
        finds_nothing: kinds of faults that the monitor must not detect between `after` and
            `before`; `any` for all.
    """

    measure: str | None = None
    robot: Name | None = None
    object: Name | None = None
    joints: list[str] = Field(default_factory=list)
    signed: bool = False
    of: Literal["max", "rms", "mean", "min", "final"] = "max"
    below: float | None = None
    above: float | None = None
    holds_at: Literal["all", "any", "each_robot"] | None = None
    after: float = Field(0.0, ge=0)
    before: float | None = None
    finds: str | None = None
    within: float | None = Field(None, gt=0)
    cause: str | None = None
    finds_nothing: list[str] | Literal["any"] | None = None

    @model_validator(mode="before")
    @classmethod
    def _counts_the_whole_run(cls, table: dict[str, Any]) -> dict[str, Any]:
        if table.get("measure") == "real_time_factor":
            return {"of": "final", **table}
        return table

    @model_validator(mode="after")
    def _asks_one_thing(self) -> Expect:
        keys = [
            key for key in ("measure", "finds", "finds_nothing") if getattr(self, key) is not None
        ]
        if len(keys) != 1:
            found = " and ".join(keys) or "none"
            raise ValueError(f"found {found}; expected one of `measure`, `finds`, `finds_nothing`")
        if self.measure is None:
            for key in ("below", "above", "of", "signed", "holds_at"):
                if key in self.model_fields_set:
                    raise ValueError(f"`{key}` requires `measure`; found `{keys[0]}`")
        elif self.finds is None and (self.within is not None or self.cause is not None):
            raise ValueError("`within` and `cause` require `finds`")
        if self.below is not None and self.above is not None and self.above >= self.below:
            raise Problem("above", found=self.above, expected=f"less than {self.below:g}").error()
        if self.measure is not None and self.below is None and self.above is None:
            raise Problem("below", "is required", expected="a bound below or above").error()
        for key, known in (("measure", list(MEASURES)), ("finds", [*KINDS, "any"])):
            value = getattr(self, key)
            if value is not None and value not in known:
                raise Problem(key, f"no {_NOUNS[key]}", found=value, available=known).error()
        self._check_sign()
        self._check_whose()
        for kind in self.finds_nothing if isinstance(self.finds_nothing, list) else []:
            if kind not in KINDS:
                raise Problem(
                    "finds_nothing", f"no {_NOUNS['finds']}", found=kind, available=list(KINDS)
                ).error()
        if self.before is not None and self.before <= self.after:
            raise Problem(
                "before", found=self.before, expected=f"more than {self.after:g} s"
            ).error()
        return self

    def _check_sign(self) -> None:
        if self.signed and self.measure not in SIGNED:
            known = ", ".join(SIGNED)
            raise ValueError(f"`signed` requires one of the measures {known}; found {self.measure}")
        if self.signed and self.of == "rms":
            raise Problem(
                "signed", '`of` is "rms", which has no sign', expected='`of = "mean"`'
            ).error()
        if self.measure is None or self.signed:
            return
        for key, value, wrong in (
            ("below", self.below, self.below is not None and self.below <= 0),
            ("above", self.above, self.above is not None and self.above < 0),
        ):
            if wrong:
                near = "; set signed = true" if self.measure in SIGNED else ""
                raise ValueError(f"{key}: found {value:g}, but absolute values are 0 or more{near}")

    def _check_whose(self) -> None:
        if self.joints and self.measure is not None and self.measure not in PER_JOINT:
            raise ValueError(f"{self.measure} has no value per joint; remove `joints`")
        if self.measure in OF_FREE and (self.robot is None) == (self.object is None):
            found = "neither" if self.robot is None else "both"
            raise Problem(
                "measure",
                f"'{self.measure}' requires `robot` (with a free base) or `object`; found {found}",
            ).error()
        if self.measure not in OF_FREE and self.object is not None:
            known = ", ".join(OF_FREE)
            raise ValueError(f"`object` requires one of the measures {known}; found {self.measure}")

    def check(self, scenario: RunContext) -> None:
        """Raises DeclarationError if a name is unknown or the measure is not available."""
        robots = scenario.scene.robots
        problems = []
        if self.robot is not None and self.robot not in robots:
            problems.append(Problem("robot", "no robot", found=self.robot, available=robots))
        problems += self._not_free(scenario.scene)
        names = [name for robot in self._robots(list(robots)) if robot in robots
                 for name in robots[robot].names]  # fmt: skip
        problems += [
            Problem("joints", "no joint", found=joint, available=names)
            for joint in self.joints
            if joint not in names
        ]
        causes = [*scenario.disturbances, *scenario.faults]
        if self.cause is not None and self.cause not in {*causes, *scenario.broken}:
            problems.append(
                Problem("cause", "no disturbance or fault", found=self.cause, available=causes)
            )
        for measures, fits, lacks, expected in (
            (NEED_TARGET, scenario.has_target, "has no target", "[targets.{}]"),
            (
                NEED_REAL_TIME,
                scenario.is_in_real_time,
                "is not controlled in real time",
                'controllers.{}.clock = "real_time"',
            ),
        ):
            problems += [
                Problem("measure", "robot", found=robot, of=lacks, expected=expected.format(robot))
                for robot in self._robots(list(robots))
                if self.measure in measures and robot in robots and not fits(robot)
            ]
        problems += self._ambiguous(scenario.scene)
        if self.measure == "contact_force" and not scenario.has_surroundings:
            message = "there are no contacts; add an object or another robot to the scene"
            problems.append(Problem("measure", message))
        if self.after >= scenario.duration:
            end = f"before the end of the run at {scenario.duration:g} s"
            message = f"found {self.after:g} s; expected a time {end}"
            problems.append(Problem("after", message))
        if problems:
            raise DeclarationError(problems)

    def _ambiguous(self, scene: Scene) -> list[Problem]:
        if self.above is None or self.holds_at is not None or self.object is not None:
            return []
        robots = [name for name in self._robots(list(scene.robots)) if name in scene.robots]
        places = [
            joint
            for name in robots
            for joint in (scene.robots[name].names if self.measure in PER_JOINT else [name])
            if self.measure not in PER_JOINT or not self.joints or joint in self.joints
        ]
        if len(places) < 2:
            return []
        what = "joints" if self.measure in PER_JOINT else "robots"
        each = ", 'each_robot' (one joint of each)" if len(robots) > 1 else ""
        message = f"is required with `above` for {len(places)} {what}"
        return [Problem("holds_at", message, expected=f"'all'{each} or 'any' (one of them)")]

    def _not_free(self, scene: Scene) -> list[Problem]:
        if self.object is not None:
            objects = {item.name: item for item in scene.objects}
            if self.object not in objects:
                return [Problem("object", "no object", found=self.object, available=objects)]
            if not objects[self.object].is_free:
                return [
                    Problem("object", f"'{self.object}' is fixed; expected an object with a mass")
                ]
            return []
        robot = scene.robots.get(self.robot or "") if self.measure in OF_FREE else None
        if robot is None or robot.free_base:
            return []
        return [
            Problem(
                "robot", "the base of", found=self.robot, of="is fixed", expected="free_base = true"
            )
        ]

    def _robots(self, all_of_them: Sequence[str]) -> list[str]:
        return list(all_of_them) if self.robot is None else [self.robot]

    def judge(
        self, name: str, log: RunLog, findings: Sequence[Finding], scenario: RunContext
    ) -> Outcome:
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
            return Outcome(name, False, f"no {what} detected{limit or ', expected one'}", np.nan)
        delay = found[0].time - start
        holds = self.within is None or delay <= self.within
        text = f"{what} at {found[0].joint} detected after {1e3 * delay:.0f} ms{limit}"
        return Outcome(name, holds, text, delay)

    @property
    def unit(self) -> str:
        """Unit of the found value, `s` for delays of a detection; empty if there is no value."""
        if self.measure is not None:
            return MEASURES[self.measure][0]
        return "" if self.finds_nothing is not None else "s"

    def _judge_nothing(self, name: str, findings: Sequence[Finding]) -> Outcome:
        wanted = KINDS if self.finds_nothing == "any" else self.finds_nothing or ()
        found = [finding for finding in findings if finding.kind in wanted]
        if not found:
            return Outcome(name, True, "no fault detected, as expected", 0.0)
        return Outcome(name, False, f"expected no fault; found {found[0]}", len(found))

    def _judge_measure(self, name: str, log: RunLog) -> Outcome:
        assert self.measure is not None
        end = np.inf if self.before is None else self.before
        rows = (log.times >= self.after - 1e-9) & (log.times <= end + 1e-9)
        reaches_end = log.times[-1] >= (self.after if self.before is None else self.before) - 1e-6
        bounds = " and ".join(
            f"{word} {bound:g}"
            for word, bound in (("below", self.below), ("above", self.above))
            if bound is not None
        )
        what = f"{'' if self.of == 'max' else f'{self.of} '}{self.measure.replace('_', ' ')}"
        if not rows.any():
            text = f"{what}: the run ended at {log.times[-1]:g} s, before the evaluated time"
            return Outcome(name, False, f"{text}; expected {bounds}", np.nan)
        # First find the deciding joint of every robot, and then the deciding robot.
        deciding = []
        for whose, names, values in self._values(log, rows):
            reduced = _REDUCE[self.of](values)
            k = self._deciding(reduced, any_of_them=self.holds_at in ("any", "each_robot"))
            unit = MEASURES[self.measure][0]
            unit = log.unit_at(unit, whose, names[k]) if names[k] else unit
            deciding.append((float(reduced[k]), "/".join(filter(None, (whose, names[k]))), unit))
        k = self._deciding(np.array([value for value, *_ in deciding]), self.holds_at == "any")
        value, place, unit = deciding[k]
        holds = reaches_end and bool(self._margins(np.array(value)) > 0)
        ended = "" if reaches_end else "; the run ended early"
        text = f"{what} {value:.4g} {unit} at {place}, expected {bounds}"
        return Outcome(name, holds, f"{text}{self._where}{ended}", value)

    def _values(self, log: RunLog, rows: Bools | slice) -> Iterator[tuple[str, list[str], Array]]:
        """Yields the name, joint names and values (T, joints) of each robot, or of the object."""
        assert self.measure is not None
        whose = self._robots(list(log.robots)) if self.object is None else [self.object]
        for each in whose:
            values = MEASURES[self.measure][1](log, each)[rows]
            values = values if self.signed else np.abs(values)
            names = [""]
            if self.measure in PER_JOINT:
                names = log.robots[each].names
                chosen = [k for k, name in enumerate(names)
                          if not self.joints or name in self.joints]  # fmt: skip
                names, values = [names[k] for k in chosen], values[:, chosen]
            if names:
                yield each, names, values

    def _margins(self, values: Array) -> Array:
        """Returns distances to the bounds, which are negative out of bounds, or NaN if unknown."""
        high = np.inf if self.below is None else self.below - values
        low = np.inf if self.above is None else values - self.above
        return np.minimum(high, low)

    def _deciding(self, values: Array, any_of_them: bool) -> int:
        margins = self._margins(values)
        margins = np.where(np.isnan(margins), -np.inf, margins)
        return int(np.argmax(margins) if any_of_them else np.argmin(margins))

    @property
    def _where(self) -> str:
        what = "joint" if self.measure in PER_JOINT else "robot"
        return {
            "any": f" at one {what} at least", "each_robot": f" at one {what} of each robot"
        }.get(self.holds_at or "", "")  # fmt: skip

    def share(self, log: RunLog) -> float:
        """Returns a score between 0 and 1 of how close the last row of a log is to the bounds.

        Only bounds that must hold at every time count: `above` is ignored for `max`, and `below`
        for `min`.

        Args:
            log: log whose first row is the reference for drift.

        Returns:
            1 within the bounds; otherwise `below / value` or `value / above`, at least 0.
        """
        robots = []
        for _, _, values in self._values(log, slice(-1, None)):
            beyond = np.ones(values.shape[1])
            if self.below is not None and self.of != "min":
                excess, size = np.maximum(values[0] - self.below, 0.0), abs(self.below)
                beyond = np.where(excess > 0, size / (size + excess), beyond)
            if self.above is not None and self.of != "max":
                lack, size = np.maximum(self.above - values[0], 0.0), max(abs(self.above), 1e-12)
                beyond = np.minimum(beyond, np.maximum(1.0 - lack / size, 0.0))
            robots.append(beyond.max() if self.holds_at in ("any", "each_robot") else beyond.min())
        return float(max(robots) if self.holds_at == "any" else min(robots))


_NOUNS = {"measure": "measure", "finds": "kind of finding"}
_REDUCE: dict[str, Callable[[Array], Array]] = {
    "max": lambda values: values.max(axis=0),
    "min": lambda values: values.min(axis=0),
    "mean": lambda values: values.mean(axis=0),
    "rms": lambda values: np.sqrt(np.mean(values**2, axis=0)),
    "final": lambda values: values[-1],
}
