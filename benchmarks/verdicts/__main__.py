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
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the product of this checkout

import report
from faults import CLEAN, KINDS
from measure import measure
from plant import ROBOTS

_MORE_CLEAN = 3  # additional seeds of runs without a fault


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
    quiet = {"initializer": logging.disable, "initargs": (logging.WARNING,)}
    with ProcessPoolExecutor(options.jobs, **quiet) as pool:
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
