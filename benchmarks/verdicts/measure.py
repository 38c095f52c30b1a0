"""`measure`: simulates one run with a fault, and judges the verdicts of the product about it."""

from __future__ import annotations

import time
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from faults import make_plant
from judge import UNEXPLAINED, is_right
from plant import load_robot

from sero_mj.base.errors import SeroError
from sero_mj.cli.arguments import read_recorded_run, read_scene
from sero_mj.study.explanation import find_explainer

Task = tuple[str, str, int]  # robot, kind, seed


@cache
def scene_of(robot: str) -> Any:
    return read_scene(load_robot(robot).scene)


def measure(task: Task) -> dict[str, Any]:
    """Simulates and analyzes one run, and returns its judged verdicts."""
    robot, kind, seed = task
    plant, own = make_plant(kind, seed, load_robot(robot))
    truth = own if plant.robot.is_declared else own.of_undeclared(plant.robot.joints)
    row: dict[str, Any] = {"robot": robot, "fault": kind, "seed": seed, "error": "", "verdicts": []}
    with TemporaryDirectory() as folder:
        file = Path(folder) / "run.csv"
        plant.run().write(file)
        start = time.perf_counter()
        try:
            run = read_recorded_run(file, None, scene_of(robot))
            explainer = find_explainer()
            assert explainer is not None
            _, verdicts, _ = explainer.with_model(run, robot)
        except SeroError as error:
            return {**row, "error": str(error).replace(folder, "")}
    row["seconds"] = round(time.perf_counter() - start, 2)
    for each in verdicts:
        row["verdicts"].append({
            "joint": each.joint, "kind": each.kind, "part": each.part, "text": each.text,
            "when": each.when, "confidence": round(each.confidence, 4),
            "right": is_right(each, truth),
            "fits": each.kind != UNEXPLAINED and is_right(each, own),
        })  # fmt: skip
    return row
