"""`Explanation` describes the cause of a torque difference; an `Explainer` finds explanations.

A package adds an explainer by an entry point in the group `sero_mj.explainers`. The first explainer
is used. If there is no explainer, `compare` reports differences without explanations.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..base.plugins import EXPLAINERS, load_first
from .evidence import Evidence

if TYPE_CHECKING:
    from ..simulate.runs.run_log import RunLog
    from .align import Pair

Kind = Literal[
    "sign",
    "gain",
    "bias",
    "delay",
    "friction",
    "noise",
    "payload",
    "masses",
    "encoder",
    "stuck",
    "tilt",
    "link mass",
    "link center",
    "encoder scale",
    "elasticity",
    "backlash",
    "spring",
    "force",
    "motor inertia",
    "friction drift",
    "load friction",
    "saturation",
    "clock",
    "gravity compensation",
    "swap",
    "order",
    "scale",
    "unexplained",
]
Part = Literal[
    "torque sensor",
    "drive",
    "joint",
    "flange",
    "link",
    "links",
    "base",
    "commands",
    "encoder",
    "sensor or drive",
    "angles",
    "measured torques",
    "commanded torques",
    "torques",
    "signals",
]
_SIGNED: tuple[Kind, ...] = (
    "bias",
    "friction",
    "payload",
    "masses",
    "encoder",
    "link mass",
    "encoder scale",
    "motor inertia",
    "friction drift",
    "load friction",
)
# Places of faults that do not concern a single joint.
PLACES = FLANGE, LINKS, BASE, COMMANDS, ALL_JOINTS = (
    "flange", "links", "base", "commands", "all joints",
)  # fmt: skip
# Recorded signals; `torques` are measured and commanded ones, `signals` are all of them.
LOGGED: tuple[Part, ...] = (
    "angles", "measured torques", "commanded torques", "torques", "signals",
)  # fmt: skip
# Factors of units that logs and routes confuse, with their names.
_UNITS = ((180.0 / np.pi, "degrees instead of radians"), (1e3, "milli instead of SI units"))
MAX_CONFIDENCE = 0.99
# Faults that can be attributed to one of two runs. For other faults, exchanging the runs only
# changes the sign of the size.
OF_ONE_RUN: tuple[Kind, ...] = ("sign", "delay", "noise", "stuck")


@dataclass(frozen=True)
class Explanation:
    """The explanation of a torque difference.

    Attributes:
        joint: name of the joint, or one of `PLACES`.
        kind: kind of the fault.
        part: faulty part of the robot, for example `torque sensor`, or one of `LOGGED`.
        size: size of the fault: gain (-1 for a wrong sign), bias (Nm or N), delay (s), Coulomb
            friction (Nm) or its change during the run, friction as a share of the link torque (%),
            standard deviation of noise (Nm), payload (kg), difference of the link masses (%), mass
            (kg) or shift of the center (m) of one link, encoder offset (deg or m) or scale (%),
            stuck torque (Nm), tilt of the base (deg), stiffness (Nm/rad), backlash (deg or m),
            largest torque of a spring (Nm), force (N), motor inertia (kg m2), torque limit (Nm),
            drift of a clock (s/s), missing gravity compensation (%), unexplained peak (Nm), factor
            of a logged signal, or number of columns by which the order is shifted.
        unit: unit of the size; empty for a gain.
        error: standard error of the size; NaN if unknown.
        confidence: probability from 0 to 1.
        begin: start time of the fault, s.
        end: end time of the fault, s; None for the end of the run.
        from_start: whether the fault exists from the start.
        values: further values: `viscous` friction; `x`, `y`, `z` of a payload's center of mass (m),
            of the shift of a link's center (m), of a force (N), or of the direction of gravity;
            `offset` of a clock (s).
        joints: joints at which the fault is visible.
        is_difference: whether the size is a difference between the gains of two runs.
        is_second: whether the second of two runs has the fault.
        alternatives: other causes that the motion does not distinguish from this one.
        next: experiment that confirms the cause or distinguishes it from others, as text.
        evidence: residuals before and after the explanation; None if it has no residuals.
    """

    joint: str
    kind: Kind
    part: Part
    size: float
    unit: str
    error: float
    confidence: float
    begin: float
    end: float | None = None
    from_start: bool = False
    values: Mapping[str, float] = field(default_factory=dict)
    joints: tuple[str, ...] = ()
    is_difference: bool = False
    is_second: bool = False
    alternatives: tuple[str, ...] = ()
    next: str = ""
    evidence: Evidence | None = field(default=None, compare=False, repr=False)

    def __str__(self) -> str:
        return f"{self.text}, {self.when}"

    @property
    def or_else(self) -> str:
        """The alternatives as text, or the most similar causes of unexplained torques."""
        how = "most similar to" if self.kind == "unexplained" else "or"
        return f"{how} {', or '.join(self.alternatives)}" if self.alternatives else ""

    @property
    def text(self) -> str:
        """The kind, size and location of the fault, as text."""
        size, error, unit, part = self.size, self.error, self.unit, self.part
        rate = f"{unit} s/{'rad' if unit == 'Nm' else 'm'}"
        vector = ", ".join(
            f"{round(self.values[axis], 3) + 0.0:.3f}" for axis in "xyz" if axis in self.values
        )
        about = f"{size:.3g}{_about(error)} {unit}"
        change = f"{size:+.3g}{_about(error)} {unit}"
        stuck = (
            f"no motion, although the drive exceeds the measured torque by {abs(size):.3g} {unit}"
        )
        if part == "torque sensor":
            stuck = f"constant {size:.4g} {unit} of the {part}"
        unknown = "on the drive side" if part == "drive" else "possibly contact or external force"
        texts = {
            "sign": f"wrong sign of the {part} (gain {size:.2f})",
            "gain": f"{size:+.3f}{_about(error)} of the {part}, A minus B"
            if self.is_difference
            else f"{size:.3f}{_about(error)} of the {part}",
            "bias": f"{size:+.3g}{_about(error)} {unit} of the {part}",
            "delay": f"{1e3 * size:.1f}{_about(1e3 * error)} ms of the {part}",
            "friction": f"{size:+.3g}{_about(error)} {unit}, "
            f"{self.values.get('viscous', 0.0):+.2g} {rate}",
            "noise": f"{size:.2g} {unit} of the {part}",
            "payload": f"{size:+.3g}{_about(error)} kg at ({vector}) m in the flange frame",
            "encoder": f"offset {size:+.3g}{_about(error)} {unit}",
            "encoder scale": f"{change} of the motion",
            "masses": f"{size:+.1f}{_about(error)} % relative to the declared masses",
            "stuck": stuck,
            "tilt": f"base tilted by {about}, gravity along ({vector})",
            "link mass": f"{change} of the {self._moved}",
            "link center": f"center of mass of the {self._moved} shifted by ({vector}) m",
            "elasticity": f"stiffness of {about} between encoder and link",
            "backlash": f"{about} between encoder and link",
            "spring": f"torque of up to {abs(size):.3g} {unit} that depends on the angle",
            "force": f"constant {about} at the {self._moved}, ({vector}) N in the world frame",
            "motor inertia": change,
            "friction drift": f"{change} from start to end, "
            f"{self.values.get('viscous', 0.0):+.2g} {rate}",
            "load friction": f"{change} of the link torque",
            "saturation": f"drive limited to {about}",
            "clock": f"commands late by {1e3 * self.values.get('offset', 0.0):.1f} ms, plus "
            f"{1e3 * size:.2g}{_about(1e3 * error)} ms per second",
            "gravity compensation": f"drives lack {about} of the gravity torques",
            "unexplained": f"up to {abs(size):.3g} {unit}, {unknown}",
        }
        is_of_log = part in LOGGED and self.kind != "delay"
        text = self._of_log if is_of_log else texts[self.kind]
        return f"{self.kind}: {text}{', in B' if self.is_second else ''}"

    @property
    def _of_log(self) -> str:
        # What is wrong with the recorded columns.
        count = len(self.joints)
        names = ", ".join(self.joints[:-1]) + " and " * (count > 1) + self.joints[-1]
        place = "in the log of all joints" if self.joint == ALL_JOINTS else f"in the log of {names}"
        if self.kind == "sign":
            return f"wrong sign of the {self.part} {place}"
        if self.kind == "swap":
            return f"the {self.part} of {names} are exchanged in the log"
        if self.kind == "order":
            column = self.joints[round(self.size)]
            return f"the {self.part} of {self.joints[0]} are in the column of {column}, and so on"
        named = [name for factor, name in _UNITS if abs(self.size / factor - 1.0) < 0.01]
        unit = f" ({named[0]})" if named else ""
        return f"{self.part} {self.size:.4g} times too large {place}{unit}"

    @property
    def _moved(self) -> str:
        return FLANGE if self.part == FLANGE else f"link moved by {self.joint}"

    @property
    def short(self) -> str:
        """The kind and size of the fault, as text for figures."""
        of_second = " in B" if self.is_second else ""
        if self.kind == "unexplained":
            return f"unexplained ({self.part} side){of_second}"
        if self.kind in ("sign", "stuck", "swap", "order"):
            return f"{self.kind} ({self.part}){of_second}"
        factor, unit = (1e3, "ms") if self.kind == "delay" else (1.0, self.unit)
        is_signed = self.kind in _SIGNED or self.is_difference
        sign = "+" if is_signed else ""
        return f"{self.kind} {factor * self.size:{sign}.3g} {unit}".strip() + of_second

    @property
    def when(self) -> str:
        """The start and end time of the fault, as text."""
        begin = "from the start" if self.from_start else f"from {self.begin:.2f} s"
        return begin if self.end is None else f"{begin} to {self.end:.2f} s"


def _about(error: float) -> str:
    return f" ± {error:.1g}" if np.isfinite(error) and error > 0 else ""


@dataclass(frozen=True)
class Parameter:
    """A parameter of a robot that was estimated from a recording.

    Attributes:
        joint: name of the joint, or `payload`.
        name: name of the parameter, such as `coulomb_friction`.
        unit: SI unit.
        value: estimate; None if the recording does not determine it.
        error: standard error of the estimate; None if unknown.
        reason: reason why there is no estimate.
        min_change: smallest change that matters.
    """

    joint: str
    name: str
    unit: str
    value: float | None
    error: float | None = None
    reason: str | None = None
    min_change: float = 0.0

    @property
    def key(self) -> str:
        """The name with the joint, such as `A4.coulomb_friction`."""
        return f"{self.joint}.{self.name}"

    @property
    def label(self) -> str:
        """The name as text, such as `Coulomb friction`."""
        return self.name.replace("_", " ").replace("coulomb", "Coulomb")


class Explainer(ABC):
    """An object, created without arguments, that finds the causes of torque differences."""

    @abstractmethod
    def of_two(
        self, a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
    ) -> tuple[list[Explanation], list[str]]:
        """Explains the torques of run `a` minus the torques of run `b`.

        `robots` contains the names of the robot in `a` and `b`. `offset` (s) is added to the times
        of `b`. Returns the explanations, and lines about the method.

        Raises:
            UsageError: the runs cannot be analyzed.
        """

    @abstractmethod
    def of_one(self, run: RunLog, robot: str) -> tuple[list[Explanation], list[str]]:
        """Explains the commanded minus the measured torques of a robot.

        Returns the explanations, and lines about the method.
        """

    @abstractmethod
    def with_model(self, run: RunLog, robot: str) -> tuple[Pair, list[Explanation], list[str]]:
        """Compares a run with the robot's model in the same motion.

        Returns the pair, the explanations of its torque difference, and lines about the method.

        Raises:
            UsageError: the robot has no model, or the run has no torques.
        """

    def parameters(self, run: RunLog, robot: str) -> list[Parameter]:
        """Estimates parameters of each joint, such as friction. The order is always the same.

        Raises:
            UsageError: the run is too short, or contains too little motion.
        """
        return []


def by_place(found: Sequence[Explanation], joints: Sequence[str]) -> list[Explanation]:
    """Returns explanations in the order of the joints, followed by those at `PLACES`."""
    order = [*joints, *PLACES]
    return sorted(found, key=lambda each: order.index(each.joint))


def find_explainer() -> Explainer | None:
    """Returns the installed explainer, or None if there is no explainer."""
    found: Explainer | None = load_first(EXPLAINERS, Explainer)
    return found


def differing(pair: Pair, found: Sequence[Explanation]) -> list[Explanation]:
    """Returns the explanations that concern a joint whose torques differ between the runs."""
    differs = (pair.difference("torques") != 0).any(axis=0)
    joints = {joint for joint, is_one in zip(pair.robot.names, differs, strict=True) if is_one}
    return [each for each in found if joints & {*each.joints}]
