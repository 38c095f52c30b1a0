"""Marks on the timeline of a run's page: disturbances, faults, findings and expectations."""

from __future__ import annotations

import math
from collections.abc import Iterable

from ..base.errors import SeroError
from ..data.record.replay import Replay
from ..robots.declared.scene import Scene
from ..simulate.expect import Outcome
from ..simulate.runs.monitor import Finding, Monitor
from ..simulate.runs.run_recording import read_run
from ..simulate.runs.run_source import RunSource
from ..simulate.scenario import Scenario
from ..simulate.simulation import Simulation
from ..viewer.player.capture import Mark
from .plot import spans_of

_MAX_FINDINGS = 200


def marks_of(scene: Scene, begin: float = 0.0) -> list[Mark]:
    """Returns the marks of a simulated scene or of recordings; `begin` (s) becomes time 0."""
    marks: list[Mark] = []
    for source in scene.sources.values():
        if isinstance(source, RunSource) and isinstance(source.run, Simulation):
            marks += marks_of_run(source.run, begin)
        elif isinstance(source, dict) and source.get("kind") == "replay":
            marks += _of_recording(source, scene, begin)
    return marks


def marks_of_run(simulation: Simulation, begin: float = 0.0) -> list[Mark]:
    """Returns the disturbances, faults, findings and expectations of a run as marks."""
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
