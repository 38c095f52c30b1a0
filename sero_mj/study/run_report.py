"""Writes reports of runs for CI, and creates marks for the timeline of a page."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Iterable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from ..base.errors import SeroError, UsageError
from ..data.record.replay import Replay
from ..robots.declared.scene import Scene
from ..simulate.expect import Outcome
from ..simulate.runs.monitor import Finding, Monitor
from ..simulate.runs.run_recording import read_run
from ..simulate.runs.run_source import RunSource
from ..simulate.scenario import Scenario
from ..simulate.simulated_scene import simulated_scene
from ..simulate.simulation import Simulation
from ..viewer.player.capture import Mark, capture
from ..viewer.player.page import write_page
from .figure import NO_MATPLOTLIB
from .junit import TestCase, write_junit
from .plot import plot_run, spans_of

log = logging.getLogger(__name__)

PAGE, FIGURE, JSON, JUNIT = "index.html", "torques.png", "report.json", "junit.xml"
_MAX_FINDINGS = 200  # maximum number of findings on a timeline


def write_report(
    simulation: Simulation,
    folder: Path,
    found: dict[str, Any],
    *,
    error: BaseException | None = None,
    fps: float = 30.0,
) -> None:
    """Creates a folder with a report of a run.

    In the JUnit XML file, each expectation is a test case. If the run failed with `error`, the only
    test case contains this error. If matplotlib is not installed, the figure is skipped with a
    warning. `found` is the content of `report.json`, without NaN.

    Raises:
        UsageError: a file cannot be written.
    """
    outcomes = [] if error is not None else simulation.outcomes()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / JSON).write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
        name = simulation.scenario.name
        cases = list(_cases(name, outcomes, error))
        write_junit(folder / JUNIT, name, cases, seconds=found.get("took", 0.0))
    except OSError as problem:
        raise UsageError(f"cannot write {problem.filename}: {problem.strerror}") from problem
    seconds = max(simulation.time, 1e-3)
    run = capture(simulated_scene(simulation), seconds=seconds, fps=fps, wait=0.0)
    run.marks = marks_of_run(simulation)
    write_page(run, folder / PAGE, simulation.scenario.name)
    if find_spec("matplotlib") is None:
        log.warning("no %s: %s", folder / FIGURE, NO_MATPLOTLIB)
        return
    plot_run(
        simulation.log,
        folder / FIGURE,
        findings=simulation.findings(),
        spans=spans_of(simulation.scenario),
    )


def _cases(
    name: str, outcomes: Iterable[Outcome], error: BaseException | None
) -> Iterator[TestCase]:
    for outcome in outcomes:
        failure = "" if outcome.holds else outcome.text
        yield TestCase(name, outcome.name, failure=failure, details=f"see {PAGE}")
    if error is not None:
        yield TestCase(name, "run", error=str(error))


def marks_of(scene: Scene, begin: float = 0.0) -> list[Mark]:
    """Returns timeline marks for a simulated scene or for recordings, relative to `begin` (s)."""
    marks: list[Mark] = []
    for source in scene.sources.values():
        if isinstance(source, RunSource) and isinstance(source.run, Simulation):
            marks += marks_of_run(source.run, begin)
        elif isinstance(source, dict) and source.get("kind") == "replay":
            marks += _of_recording(source, scene, begin)
    return marks


def marks_of_run(simulation: Simulation, begin: float = 0.0) -> list[Mark]:
    """Returns timeline marks for the disturbances, faults, findings and expectations of a run."""
    scenario = simulation.scenario
    marks = [
        _mark(span.begin, span.end, span.name, "fault" if span.is_fault else "push")
        for span in spans_of(scenario)
        if span.begin <= simulation.time
    ]
    marks += _of_findings(simulation.findings())
    if simulation.step >= simulation.steps:
        marks += [_of_outcome(each, scenario) for each in simulation.outcomes()]
    return _shifted(marks, begin)


def _of_outcome(outcome: Outcome, scenario: Scenario) -> Mark:
    expect = scenario.expect[outcome.name]
    end = scenario.duration if expect.before is None else expect.before
    text = f"{outcome.name}: {outcome.text}"
    begin = expect.after if not outcome.holds else end
    return _mark(begin, end, text, "held" if outcome.holds else "failed")


def _of_recording(source: dict[str, object], scene: Scene, begin: float) -> list[Mark]:
    replay = Replay(**{"name": "replay", **{k: v for k, v in source.items() if k != "kind"}})
    try:
        findings = Monitor().find(read_run(replay.file, scene=scene))
    except SeroError:  # the recording has no run of robots
        return []
    return _shifted(_of_findings(findings), begin + (replay.start or 0.0))


def _of_findings(findings: Iterable[Finding]) -> list[Mark]:
    found = []
    for finding in [*findings][:_MAX_FINDINGS]:
        text = str(finding).partition("  ")[2].replace("  ", " ")
        found.append(_mark(finding.time, finding.time, text, "finding"))
    return found


def _mark(begin: float, end: float | None, text: str, kind: object) -> Mark:
    last = end if end is not None and math.isfinite(end) else 1e9
    return Mark(float(begin), float(last), text, kind)  # type: ignore[arg-type]


def _shifted(marks: list[Mark], begin: float) -> list[Mark]:
    shifted = [Mark(m.begin - begin, m.end - begin, m.text, m.kind) for m in marks]
    return [mark for mark in shifted if mark.end >= 0.0]
