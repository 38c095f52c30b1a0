"""Runs one variant of a sweep."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..base.errors import DeclarationError, SeroError, SimulationError
from ..base.reduction import rms
from ..simulate.control.compiler import Compiler
from ..simulate.runs.run_log import RunLog
from ..simulate.scenario import Scenario
from ..simulate.scenario_file import read_scenario
from ..simulate.simulation import Simulation

# Of every robot, all in Nm except the share: of its worst joint, over the whole run.
PER_ROBOT = ("peak_torque_error", "rms_torque_error", "peak_torque_share", "findings")
UNITS = {"peak_torque_error": "Nm", "rms_torque_error": "Nm", "peak_torque_share": "of the limit"}


def outcome_columns(scenario: Scenario) -> list[str]:
    """Columns of the results of a variant.

    `held`: whether all that is expected did and nothing stopped the run. `error`: what stopped it.
    `ended`: s of simulated time. For every expectation whether it held and the value found;
    for every robot `PER_ROBOT`.
    """
    columns = ["held", "error", "ended"]
    for name in scenario.expect:
        columns += [f"expect.{name}", f"expect.{name}.value"]
    for robot in scenario.scene.robots:
        columns += [f"{robot}.{key}" for key in PER_ROBOT]
    return columns


class VariantRunner:
    """Runs variants of one scenario sequentially, without keeping logs.

    Args:
        file: the scenario's.
        fixed: dotted keys set in all of them.
    """

    def __init__(self, file: Path, fixed: Mapping[str, Any]) -> None:
        self._file, self._fixed = file, dict(fixed)
        self._compiler = Compiler()

    def run(self, values: Mapping[str, Any]) -> dict[str, Any]:
        """Runs the variant with these values, and returns its results.

        Errors are not raised, but returned as the variant's `error`.
        """
        found: dict[str, Any] = {"held": False, "error": "", "ended": 0.0}
        try:
            scenario = read_scenario(self._file, {**self._fixed, **values})
            simulation = Simulation(scenario, compiler=self._compiler)
            try:
                simulation.advance(simulation.steps)
            except SimulationError as error:
                found["error"] = str(error)
            found["ended"] = simulation.time
            log, findings = simulation.log, simulation.findings()
            for name, expect in scenario.expect.items():
                outcome = expect.judge(name, log, findings, scenario)
                found[f"expect.{name}"] = outcome.holds
                found[f"expect.{name}.value"] = outcome.value
            for robot in scenario.scene.robots:
                own = sum(finding.robot == robot for finding in findings)
                found.update(_of_robot(log, robot, own))
            held = all(found[f"expect.{name}"] for name in scenario.expect)
            found["held"] = held and not found["error"]
        except DeclarationError as error:
            # File and line are the same in all of them.
            found["error"] = "; ".join(
                ": ".join(filter(None, (problem.key, problem.message)))
                for problem in error.problems
            )
        except SeroError as error:
            found["error"] = str(error)
        except Exception as error:  # a bug must not end ten thousand runs
            found["error"] = f"{type(error).__name__}: {error}"
        found["error"] = " ".join(found["error"].split())  # a row is one line
        return found


def _of_robot(log: RunLog, robot: str, findings: int) -> dict[str, Any]:
    rows = slice(
        1 if len(log.times) > 1 else 0, None
    )  # nothing was commanded before the first step
    error = log.torque_error(robot)[rows]
    share = np.abs(log.of(robot, "commanded_torques")[rows]) / log.torque_limits(robot)
    values = (
        float(np.abs(error).max()),
        max(rms(of_joint) for of_joint in error.T),
        float(share.max()),
        findings,
    )
    return {f"{robot}.{key}": value for key, value in zip(PER_ROBOT, values, strict=True)}
