"""Measures the speed of environments and sweeps, for single runs and for runs stepped together.

    .venv/bin/python benchmarks/many.py [environments] [sweeps]

A single environment is compared with a bare `mj_step` loop that performs the same number of steps
per action. Many environments that are stepped together are compared with a single one for a whole
episode, including the reset. Variants of a sweep run one by one in the same process, and in batches
in new processes, as in `sero-mj sweep`. Rates are the maximum of several measurements, so that
other load has little effect. For one process, the rate per CPU second and MuJoCo's share of the CPU
time are also shown.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from sero_mj.viewer.image.backend import choose_backend

choose_backend()

import gymnasium
import mujoco
import numpy as np
from mujoco.batch import Batch
from rich.console import Console
from rich.table import Table

from sero_mj import make_environment
from sero_mj.base.paths import find_scenario
from sero_mj.extensions.sweeps.samples import Samples, Vary
from sero_mj.extensions.sweeps.sweep import Sweep
from sero_mj.extensions.sweeps.variant import VariantRunner
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.engine import Processes, available_cpus

ENVIRONMENTS = (
    ("lwr/reach", {}),
    ("lwr/reach", {"action": "impedance"}),
    ("lwr/hold", {}),
    ("impedance_push", {}),
)
SWEEPS = {
    "impedance_push": "controllers.lwr.stiffness=log:100:5000",
    "payload": "disturbances.load.mass=1:5",
    "hand_guiding": "controllers.lwr.damping=0:5",
}
VARIANTS, ALONE = 64, 4
TOGETHER = (
    ("sero_mj/lwr-reach-v0", {}),
    ("sero_mj/lwr-reach-v0", {"action": "impedance"}),
    ("sero_mj/lwr-hold-v0", {}),
    ("sero_mj/lwr-hold-v0", {"action": "impedance"}),
)
ROBOTS = 64
EPISODE = 250  # steps of an episode


def best_of(
    call: Callable[[], int], times: int = 5, clock: Callable[[], float] = time.perf_counter
) -> float:
    """Returns the maximum rate of several calls; `call` returns the number of completed items."""
    rates = []
    for _ in range(times):
        begin = clock()
        rates.append(call() / (clock() - begin))
    return max(rates)


def episode(environment: object) -> int:
    """Runs 100 steps of an episode with small actions; returns the number of steps."""
    rng, spec = np.random.default_rng(0), environment.action_spec()
    actions = 0.02 * rng.uniform(spec.minimum, spec.maximum, (100, *spec.shape))
    environment.reset()
    for action in actions:
        environment.step(action)
    return len(actions)


def bare(environment: object, substeps: int) -> int:
    """Calls `mj_step` as often as 100 steps of the environment do; returns 100."""
    environment.reset()
    model, data = environment.model, environment.data
    for _ in range(100):
        for _ in range(substeps):
            mujoco.mj_step(model, data)
    return 100


def whole_episode(environment: gymnasium.Env | gymnasium.vector.VectorEnv) -> int:
    """Runs a whole episode with small actions; returns the sum of the steps of all robots."""
    rng, shape = np.random.default_rng(0), environment.action_space.shape
    actions = 0.05 * rng.uniform(-1.0, 1.0, (EPISODE, *shape))
    environment.reset(seed=1)
    for action in actions:
        environment.step(action)
    return EPISODE * (shape[0] if len(shape) > 1 else 1)


def stepping(name: str, rows: int) -> float:
    """Returns the CPU time of MuJoCo's steps for one run in a batch with this number of rows."""
    simulation = Simulation(read_scenario(find_scenario(name)))
    model, run = simulation.plant.model, simulation.scenario.run
    batch = Batch(model, rows, 1, persistent=True)
    steps, velocities, applied = 500, batch.bind("qvel"), batch.bind("qfrc_applied")
    batch.bind("qpos")[:] = simulation.plant.qpos
    holding = simulation.plant.data.qfrc_bias.copy()  # torques that hold the robot at rest

    def step() -> int:
        for _ in range(steps):
            np.subtract(holding, 10.0 * velocities, out=applied)
            batch.step()
        return steps * rows

    return run.steps * run.substeps / best_of(step, 3, time.process_time)


def sweeps() -> Table:
    """Returns a table with variants per second, one by one and together."""
    table = Table(
        "scenario", "processes", "together", "variants/s", "ratio", "variants per CPU s", "ratio",
        "share of MuJoCo",
    )  # fmt: skip
    for name, key in SWEEPS.items():
        sweep = Sweep(find_scenario(name), Samples((Vary.parse(key),), VARIANTS))
        runner = VariantRunner(sweep.file, {})

        def one_by_one(sweep: Sweep = sweep, runner: VariantRunner = runner) -> int:
            return sum(len(runner.run([values])) for values in sweep.variants[:ALONE])

        def together(jobs: int, sweep: Sweep = sweep) -> int:
            return sum(1 for _ in sweep.run(Processes(jobs)))

        one_by_one()  # compiles the model
        alone = best_of(one_by_one, 3)
        of_cpu = best_of(one_by_one, 3, time.process_time)
        table.add_row(name, "1", "no", f"{alone:.2f}", "1.0", f"{of_cpu:.2f}", "1.0")
        for jobs in dict.fromkeys((1, 2, available_cpus())):
            row = [f"{(rate := best_of(lambda: together(jobs), 2)):.2f}", f"{rate / alone:.1f}"]
            if jobs == 1:
                rate = best_of(lambda: together(1), 2, time.process_time)
                share = 100 * rate * stepping(name, VARIANTS)
                row += [f"{rate:.2f}", f"{rate / of_cpu:.1f}", f"{share:.0f} %"]
            table.add_row(name, str(jobs), "yes", *row)
    return table


def environments() -> list[Table]:
    """Returns tables with steps per second of environments."""
    table = Table("environment", "action", "steps/s", "bare loop, steps/s", "ratio of times")
    for name, options in ENVIRONMENTS:
        environment = make_environment(name, **options)
        own = best_of(lambda: episode(environment))
        alone = best_of(lambda: bare(environment, 20))
        action = str(options.get("action", "torque"))
        table.add_row(name, action, f"{own:.0f}", f"{alone:.0f}", f"{alone / own:.1f}")
    robots = Table("environment", "action", "one, steps/s", f"{ROBOTS}, steps/s", "ratio")
    for name, options in TOGETHER:
        alone = gymnasium.make(name, **options).unwrapped
        together = gymnasium.make_vec(name, num_envs=ROBOTS, **options)
        own = best_of(lambda: whole_episode(alone))
        all_ = best_of(lambda: whole_episode(together), 3)
        together.close()
        action = str(options.get("action", "torque"))
        robots.add_row(name, action, f"{own:.0f}", f"{all_:.0f}", f"{all_ / own:.1f}")
    return [table, robots]


def main() -> None:
    parts = sys.argv[1:] or ["environments", "sweeps"]
    console = Console()
    if "environments" in parts:
        console.print(*environments(), sep="\n")
    if "sweeps" in parts:
        console.print(sweeps())


if __name__ == "__main__":
    main()
