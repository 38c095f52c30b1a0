"""Measures environments: one against a bare `mj_step` loop, many against one; and sweeps likewise.

    .venv/bin/python benchmarks/many.py

The bare loop steps the same model as often as the environment does for one action. Many are
stepped together, and one by itself, for a whole episode with its beginning. Variants of a sweep are
run one by one, and as many together as `sero-mj sweep` does. Rows are of one run, the fastest of
several, so that a busy machine disturbs little.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from sero_mj.viewer.headless.backend import choose_backend

choose_backend()

import gymnasium
import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from sero_mj import make_environment
from sero_mj.base.paths import find_scenario
from sero_mj.study.sweep import Sweep, Vary
from sero_mj.study.variant import VariantRunner
from sero_mj.study.workers import Processes, available_cpus

ENVIRONMENTS = (
    ("lwr/reach", {}),
    ("lwr/reach", {"action": "impedance"}),
    ("lwr/hold", {}),
    ("impedance_push", {}),
)
VARIANTS = 48
TOGETHER = (
    ("sero_mj/lwr-reach-v0", {}),
    ("sero_mj/lwr-reach-v0", {"action": "impedance"}),
    ("sero_mj/lwr-hold-v0", {}),
    ("sero_mj/lwr-hold-v0", {"action": "impedance"}),
)
ROBOTS = 64
EPISODE = 250  # steps


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


def whole_episode(environment: gymnasium.Env | gymnasium.vector.VectorEnv) -> int:
    """An episode of small actions with its beginning; returns the steps of all robots together."""
    rng, shape = np.random.default_rng(0), environment.action_space.shape
    actions = 0.05 * rng.uniform(-1.0, 1.0, (EPISODE, *shape))
    environment.reset(seed=1)
    for action in actions:
        environment.step(action)
    return EPISODE * (shape[0] if len(shape) > 1 else 1)


def main() -> None:
    table = Table("environment", "action", "steps/s", "bare loop", "times its time")
    for name, options in ENVIRONMENTS:
        environment = make_environment(name, **options)
        own = best_of(lambda: episode(environment))
        alone = best_of(lambda: bare(environment, 20))
        action = str(options.get("action", "torque"))
        table.add_row(name, action, f"{own:.0f}", f"{alone:.0f}", f"{alone / own:.1f}")
    robots = Table("environment", "action", "one, steps/s", f"{ROBOTS}, steps/s", "times one")
    for name, options in TOGETHER:
        alone = gymnasium.make(name, **options).unwrapped
        together = gymnasium.make_vec(name, num_envs=ROBOTS, **options)
        own = best_of(lambda: whole_episode(alone))
        all_ = best_of(lambda: whole_episode(together), 3)
        together.close()
        action = str(options.get("action", "torque"))
        robots.add_row(name, action, f"{own:.0f}", f"{all_:.0f}", f"{all_ / own:.1f}")
    sweep = Sweep(
        find_scenario("impedance_push"),
        (Vary.parse("controllers.lwr.stiffness=log:100:5000"),),
        VARIANTS,
    )
    rates = Table("processes", "together", "variants/s", "times one")
    runner = VariantRunner(sweep.file, {})

    def one_by_one() -> int:
        return sum(len(runner.run([values])) for values in sweep.variants)

    ways = {("1", "no"): one_by_one}
    for jobs in dict.fromkeys((1, 2, available_cpus())):
        ways[str(jobs), "yes"] = lambda jobs=jobs: sum(1 for _ in sweep.run(Processes(jobs)))
    found = {way: best_of(call, 1) for way, call in ways.items()}
    for way, rate in found.items():
        rates.add_row(*way, f"{rate:.1f}", f"{rate / found['1', 'no']:.1f}")
    console = Console()
    console.print(table)
    console.print(robots)
    console.print(rates)


if __name__ == "__main__":
    main()
