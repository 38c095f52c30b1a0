"""Measures how often the verdicts of `sero-mj compare` are right, by their confidence.

    python benchmarks/verdicts [--robots lwr fr3 g3] [--seeds 3] [--kinds KIND ...] [--jobs 2]
                               [--out out/verdicts]

Each run has one fault. An independent simulation in plain MuJoCo writes it to a table (see
`plant`), which the product analyzes with the model, as `compare --against-model` does. Writes
results.json, reliability.png, reliability.svg and verdicts.md.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the product of this checkout

import report
from faults import CLEAN, KINDS, make_plant
from judge import UNEXPLAINED, is_right
from plant import ROBOTS, load_robot

from sero_mj.base.errors import SeroError
from sero_mj.cli.arguments import read_recorded_run, read_scene
from sero_mj.study.explanation import find_explainer

_MORE_CLEAN = 3  # additional seeds of runs without a fault
Task = tuple[str, str, int]  # robot, kind, seed


@cache
def scene_of(robot: str) -> Any:
    return read_scene(load_robot(robot).scene)


def measure(task: Task) -> dict[str, Any]:
    """Simulates and analyzes one run, and returns its judged verdicts."""
    logging.disable(logging.WARNING)
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS, metavar="ROBOT")
    parser.add_argument("--seeds", type=int, default=3, help="runs per kind (default: 3)")
    known = [CLEAN, *KINDS]
    parser.add_argument("--kinds", nargs="+", choices=known, default=known, metavar="KIND")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes (default: 2)")
    parser.add_argument("--out", type=Path, default=Path("out/verdicts"))
    options = parser.parse_args()
    tasks = [
        (robot, kind, seed)
        for robot in options.robots
        for kind in options.kinds
        for seed in range(options.seeds + _MORE_CLEAN * (kind == CLEAN))
    ]
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        for row in pool.map(measure, tasks):
            rows.append(row)
            print(f"\r{len(rows)} of {len(tasks)} runs", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "results.json").write_text(json.dumps(rows, indent=1) + "\n", "utf-8")
    for ending in ("png", "svg"):
        report.draw(rows, options.out / f"reliability.{ending}")
    text = report.whole(rows)
    (options.out / "verdicts.md").write_text(text, "utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
