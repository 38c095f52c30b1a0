"""Measures environments against a bare `mj_step` loop, and sweeps in one process and in several.

    .venv/bin/python benchmarks/many.py

The bare loop steps the same model as often as the environment does for one action. Rows are of one
run, the fastest of several, so that a busy machine disturbs little.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from sero_mj.show.headless.backend import choose_backend

choose_backend()

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from sero_mj import make_environment
from sero_mj.paths import find_scenario
from sero_mj.study.sweep import Sweep, Vary
from sero_mj.study.workers import available_cpus

ENVIRONMENTS = (
    ("lwr/reach", {}),
    ("lwr/reach", {"action": "impedance"}),
    ("lwr/hold", {}),
    ("impedance_push", {}),
)
VARIANTS = 48


def best_of(call: Callable[[], int], times: int = 5) -> float:
    """Calls per second, in the fastest of several."""
    rates = []
    for _ in range(times):
        begin = time.perf_counter()
        rates.append(call() / (time.perf_counter() - begin))
    return max(rates)


def episode(environment: object) -> int:
    """One episode of small actions; returns its steps."""
    rng, spec = np.random.default_rng(0), environment.action_spec()
    actions = 0.02 * rng.uniform(spec.minimum, spec.maximum, (100, *spec.shape))
    environment.reset()
    for action in actions:
        environment.step(action)
    return len(actions)


def bare(environment: object, substeps: int) -> int:
    """The same number of `mj_step` alone."""
    environment.reset()
    model, data = environment.model, environment.data
    for _ in range(100):
        for _ in range(substeps):
            mujoco.mj_step(model, data)
    return 100


def main() -> None:
    table = Table("environment", "action", "steps/s", "bare loop", "times its time")
    for name, options in ENVIRONMENTS:
        environment = make_environment(name, **options)
        own = best_of(lambda: episode(environment))
        alone = best_of(lambda: bare(environment, 20))
        action = str(options.get("action", "torque"))
        table.add_row(name, action, f"{own:.0f}", f"{alone:.0f}", f"{alone / own:.1f}")
    sweep = Sweep(
        find_scenario("impedance_push"),
        (Vary.parse("controllers.lwr.stiffness=log:100:5000"),),
        VARIANTS,
    )
    rates = Table("processes", "variants/s", "times one")
    one = 0.0
    for jobs in dict.fromkeys((1, 2, available_cpus())):
        begin = time.perf_counter()
        count = sum(1 for _ in sweep.run(jobs))
        rate = count / (time.perf_counter() - begin)
        one = one or rate
        rates.add_row(str(jobs), f"{rate:.1f}", f"{rate / one:.1f}")
    console = Console()
    console.print(table)
    console.print(rates)


if __name__ == "__main__":
    main()
