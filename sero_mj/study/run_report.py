"""`write_report`: writes a report of a run for CI: page, figure, `report.json` and JUnit XML."""

from __future__ import annotations

import json
import logging
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

from ..base.errors import UsageError
from ..simulate.expect import Outcome
from ..simulate.simulated_scene import simulated_scene
from ..simulate.simulation import Simulation
from ..viewer.player.capture import capture
from ..viewer.player.page import write_page
from .figure import NO_MATPLOTLIB
from .plot import plot_run, spans_of
from .run_marks import marks_of_run

log = logging.getLogger(__name__)

PAGE, FIGURE, JSON, JUNIT = "index.html", "torques.png", "report.json", "junit.xml"


def write_report(
    simulation: Simulation,
    folder: Path,
    found: dict[str, Any],
    *,
    error: BaseException | None = None,
    fps: float = 30.0,
) -> None:
    """Writes a report of a run into a folder, which is created.

    In JUnit XML, each expectation is a test case. If the run failed with `error`, the only case has
    this error. The figure is skipped with a warning if matplotlib is not installed. `found` is the
    content of `report.json`, without NaN.

    Raises:
        UsageError: a file cannot be written.
    """
    outcomes = [] if error is not None else simulation.outcomes()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / JSON).write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
        tree = _junit(simulation, outcomes, found, error)
        tree.write(folder / JUNIT, encoding="utf-8", xml_declaration=True)
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


def _junit(
    simulation: Simulation,
    outcomes: list[Outcome],
    found: dict[str, Any],
    error: BaseException | None,
) -> xml.ElementTree[xml.Element]:
    name = simulation.scenario.name
    failures = sum(not outcome.holds for outcome in outcomes)
    cases = len(outcomes) + (error is not None)
    counts = {"tests": cases, "failures": failures, "errors": int(error is not None)}
    suite = xml.Element(
        "testsuite",
        {"name": name, "time": f"{found.get('took', 0.0):.3f}"}
        | {key: str(count) for key, count in counts.items()},
    )
    for outcome in outcomes:
        case = xml.SubElement(suite, "testcase", classname=name, name=outcome.name)
        if not outcome.holds:
            text = _printable(outcome.text)
            xml.SubElement(case, "failure", message=text).text = f"{text}; see {PAGE}"
    if error is not None:
        case = xml.SubElement(suite, "testcase", classname=name, name="run")
        xml.SubElement(case, "error", message=_printable(str(error)))
    suites = xml.Element("testsuites", {key: str(count) for key, count in counts.items()})
    suites.append(suite)
    return xml.ElementTree(suites)


def _printable(text: str) -> str:
    # XML cannot contain control characters.
    return "".join(each if each.isprintable() or each == "\n" else "?" for each in text)
