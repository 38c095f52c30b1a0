"""`TorqueExplainer`: explains what `compare` finds by models of faults."""

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
    """Explains by the residuals of the robot's model, and by what two runs have in common."""

    def of_two(
        self, a: RunLog, b: RunLog, robots: tuple[str, str], offset: float
    ) -> list[Explanation]:
        """See `explain_runs`."""
        return explain_runs(a, b, robots, offset)

    def of_one(self, run: RunLog, robot: str) -> tuple[list[Explanation], list[str]]:
        """See `explain_run`."""
        found = torque_residuals(run, robot)
        return explain_run(run, robot, found), _about_model(found)

    def with_model(self, run: RunLog, robot: str) -> tuple[Pair, list[Explanation], list[str]]:
        """See `pair_with_model`."""
        found = torque_residuals(run, robot)
        explanations = explain_run(run, robot, replace(found, no_model=""))
        pair = pair_with_model(run, found)
        return pair, explanations, [*_parted(pair, explanations), *_about_model(found)]


def _about_model(found: TorqueResiduals) -> list[str]:
    lines = ["model: inverse dynamics on the measured motion, both through a low pass of "
             f"{0.16 / found.width:.0f} Hz"]  # fmt: skip
    if found.torque_control:
        lines.append("commands are those of joint torque control: friction is made up for")
    if not found.has_model:
        lines.append(f"of the links nothing is known: {found.no_model}")
    return lines


def _parted(pair: Pair, explanations: Sequence[Explanation]) -> list[str]:
    """Returns lines about when and where robot and model first differ."""
    if not explanations:
        return [f"{pair.robot.name} and its model agree"]
    first = min(explanations, key=lambda each: (not each.from_start, each.begin))
    return [f"{pair.robot.name} and its model part at {first.joint}, {first.when}: {first.kind}"]
