"""Measures how often the verdicts of `sero-mj compare` are right, by their confidence.

    python benchmarks/verdicts [--robots lwr fr3 g3] [--seeds 3] [--kinds KIND ...] [--jobs 2]
                               [--out out/verdicts] [--resume]

Each run has one fault. An independent simulation in plain MuJoCo writes it to a table (see
`plant`), which the product analyzes with the model, as `compare --against-model` does. Writes
results.jsonl (one line per run), reliability.png, reliability.svg and verdicts.md.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the product of this checkout

import report
from faults import CLEAN, KINDS
from measure import Task, measure
from plant import ROBOTS

_RUNS_PER_PROCESS = 60
_MORE_CLEAN = 3  # additional seeds of runs without a fault


def _measured(tasks: Sequence[Task], jobs: int) -> Iterator[dict[str, Any]]:
    # New processes now and then, because the product caches the tables that it has read. With
    # `max_tasks_per_child`, pools of Python 3.11 can stop forever.
    for batch in range(0, len(tasks), _RUNS_PER_PROCESS * jobs):
        with ProcessPoolExecutor(
            jobs, get_context("spawn"), logging.disable, (logging.WARNING,)
        ) as pool:
            yield from pool.map(measure, tasks[batch : batch + _RUNS_PER_PROCESS * jobs])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=ROBOTS, metavar="ROBOT")
    parser.add_argument("--seeds", type=int, default=3, help="runs per kind (default: 3)")
    known = [CLEAN, *KINDS]
    parser.add_argument("--kinds", nargs="+", choices=known, default=known, metavar="KIND")
    parser.add_argument("--jobs", type=int, default=2, help="number of processes (default: 2)")
    parser.add_argument("--out", type=Path, default=Path("out/verdicts"))
    parser.add_argument("--resume", action="store_true", help="continue an interrupted measurement")
    options = parser.parse_args()
    tasks = [
        (robot, kind, seed)
        for robot in options.robots
        for kind in options.kinds
        for seed in range(options.seeds + _MORE_CLEAN * (kind == CLEAN))
    ]
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out / "results.jsonl"
    if not (options.resume and results.exists()):
        results.write_text("", "utf-8")
    rows = [json.loads(line) for line in results.read_text("utf-8").splitlines()]
    done = {(row["robot"], row["fault"], row["seed"]) for row in rows}
    tasks = [task for task in tasks if task not in done]
    with results.open("a", encoding="utf-8") as file:
        for count, row in enumerate(_measured(tasks, options.jobs), 1):
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
            print(f"\r{count} of {len(tasks)} runs", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    for ending in ("png", "svg"):
        report.draw(rows, options.out / f"reliability.{ending}")
    text = report.whole(rows)
    (options.out / "verdicts.md").write_text(text, "utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
