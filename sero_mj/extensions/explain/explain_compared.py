"""`TorqueExplainer`: explains the differences that `compare` finds by models of faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...simulate.runs.run_log import RunLog
from ...study.align import Pair
from ...study.explainer import Explainer
from ...study.explanation import Explanation
from .explain import explain_run, explain_runs
from .torque_residuals import TorqueResiduals, pair_with_model, torque_residuals


class TorqueExplainer(Explainer):
    """Explains torque differences by the residuals of the robot's model."""

    def of_two(
        self, a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
    ) -> list[Explanation]:
        return explain_runs(a, b, robots, offset)

    def of_one(self, run: RunLog, robot: str) -> tuple[list[Explanation], list[str]]:
        found = torque_residuals(run, robot)
        return explain_run(run, robot, found), _about_model(found)

    def with_model(self, run: RunLog, robot: str) -> tuple[Pair, list[Explanation], list[str]]:
        found = torque_residuals(run, robot)
        explanations = explain_run(run, robot, replace(found, no_model=""))
        pair = pair_with_model(run, found)
        return pair, explanations, [_first_difference(pair, explanations), *_about_model(found)]


def _about_model(found: TorqueResiduals) -> list[str]:
    lines = ["model: inverse dynamics of the measured motion; all signals low-pass filtered at "
             f"{0.16 / found.width:.0f} Hz"]  # fmt: skip
    if found.torque_control:
        lines.append("Commands come from a joint torque loop that already compensates friction.")
    if not found.has_model:
        lines.append(f"no link model: {found.no_model}")
    return lines


def _first_difference(pair: Pair, explanations: Sequence[Explanation]) -> str:
    if not explanations:
        return f"{pair.robot.name} agrees with its model"
    first = min(explanations, key=lambda each: (not each.from_start, each.begin))
    kind = f"{first.kind} at {first.joint}, {first.when}"
    return f"first difference between {pair.robot.name} and its model: {kind}"
