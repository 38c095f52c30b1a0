"""Runs variants of a sweep in batches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from ...base.errors import DeclarationError, SeroError
from ...base.reduction import rms
from ...simulate.control.compiler import Compiler
from ...simulate.control.controller import as_controller
from ...simulate.mujoco_timers import without_timers
from ...simulate.run_batch import batch_key
from ...simulate.runs.run_log import RunLog
from ...simulate.scenario import Scenario
from ...simulate.scenario_file import read_scenario
from ...simulate.simulation import Simulation

# Results per robot. Values are those of the worst joint over the whole run.
PER_ROBOT = ("peak_torque_error", "rms_torque_error", "peak_torque_share", "findings")
UNITS = {"peak_torque_error": "Nm", "rms_torque_error": "Nm", "peak_torque_share": "of the limit"}


def outcome_columns(scenario: Scenario) -> list[str]:
    """Returns the names of the result columns of a variant.

    The columns are `held` (whether all expectations passed without an error), `error` (the error
    that stopped the run), `ended` (simulated time, s), two columns for each expectation (whether it
    passed, and its value), and `PER_ROBOT` for each robot.
    """
    columns = ["held", "error", "ended"]
    for name in scenario.expect:
        columns += [f"expect.{name}", f"expect.{name}.value"]
    for robot in scenario.scene.robots:
        columns += [f"{robot}.{key}" for key in PER_ROBOT]
    return columns


def runs_alone(scenario: Scenario) -> bool:
    """Whether a scenario has external controllers, so that its variants must run one by one.

    In a batch, the programs of all variants would run at the same time.
    """
    controllers = (as_controller(scenario.controller_of(name)) for name in scenario.scene.robots)
    return not all(each.may_be_probed for each in controllers)


class VariantRunner:
    """A `Runner` of variants of a scenario. Variants with equal `batch_key` run together.

    Args:
        file: scenario file.
        fixed: values for all variants by dotted key.
    """

    def __init__(self, file: Path, fixed: Mapping[str, Any]) -> None:
        self._file, self._fixed = file, dict(fixed)
        self._compiler = Compiler()

    def run(self, variants: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Runs one variant per mapping of values; returns results, with `error` after a failure."""
        found = [{"held": False, "error": "", "ended": 0.0} for _ in variants]
        batches: dict[object, list[tuple[Scenario, dict[str, Any]]]] = {}
        for values, result in zip(variants, found, strict=True):
            with _error_in(result):
                scenario = read_scenario(self._file, {**self._fixed, **values})
                key = len(batches) if runs_alone(scenario) else batch_key(scenario)
                batches.setdefault(key, []).append((scenario, result))
        with without_timers():
            for batch in batches.values():
                self._run_batch(batch)
        return found

    def _run_batch(self, batch: list[tuple[Scenario, dict[str, Any]]]) -> None:
        runs: list[Simulation] = []
        try:
            made = Simulation.together([scenario for scenario, _ in batch], self._compiler)
            runs += [each for each in made if isinstance(each, Simulation)]
            if runs:
                runs[0].advance(runs[0].steps)
        except Exception as error:
            if len(batch) > 1:  # find the variant with the error
                for each in batch:
                    self._run_batch([each])
                return
            with _error_in(batch[0][1]):
                raise error
            return
        finally:
            for run in runs:
                run.close()  # also if the run has stopped early
        for (scenario, result), one in zip(batch, made, strict=True):
            with _error_in(result):
                if isinstance(one, DeclarationError):
                    raise one
                _judge(one, scenario, result)


@contextmanager
def _error_in(found: dict[str, Any]) -> Iterator[None]:
    try:
        yield
    except DeclarationError as error:
        # File and line are omitted, because they are the same in all variants.
        found["error"] = "; ".join(
            ": ".join(filter(None, (problem.key, problem.message))) for problem in error.problems
        )
    except SeroError as error:
        found["error"] = str(error)
    except Exception as error:  # a bug must not end the other runs
        found["error"] = f"{type(error).__name__}: {error}"
    found["error"] = " ".join(found["error"].split())  # a row is one line


def _judge(simulation: Simulation, scenario: Scenario, found: dict[str, Any]) -> None:
    found["error"] = str(simulation.error or "")
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


def _of_robot(log: RunLog, robot: str, findings: int) -> dict[str, Any]:
    # Nothing was commanded before the first step.
    rows = slice(1 if len(log.times) > 1 else 0, None)
    error = log.torque_error(robot)[rows]
    share = np.abs(log.of(robot, "commanded_torques")[rows]) / log.torque_limits(robot)
    values = (
        float(np.abs(error).max()),
        max(rms(of_joint) for of_joint in error.T),
        float(share.max()),
        findings,
    )
    return {f"{robot}.{key}": value for key, value in zip(PER_ROBOT, values, strict=True)}
