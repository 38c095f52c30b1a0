"""Gymnasium's own environment of an arm with seven joints, `Pusher-v5`."""

from __future__ import annotations

import time

import gymnasium
import mujoco
import numpy as np
from common import main, tell

NAME, ROBOTS, STEPS = "gymnasium", 64, 100


def rate_of(environment: gymnasium.Env | gymnasium.vector.VectorEnv) -> float:
    """Seconds of a step of one robot, in the fastest of three episodes."""
    shape = environment.action_space.shape
    actions = 0.05 * np.random.default_rng(0).uniform(-1.0, 1.0, (STEPS, *shape))
    robots = shape[0] if len(shape) > 1 else 1
    times = []
    for _ in range(3):
        environment.reset(seed=1)
        begin = time.perf_counter()
        for action in actions:
            environment.step(action)
        times.append((time.perf_counter() - begin) / STEPS / robots)
    return min(times)


def bare_of(model: mujoco.MjModel, data: mujoco.MjData, substeps: int) -> float:
    """Seconds of as many `mj_step` alone as a step has."""
    times = []
    for _ in range(3):
        mujoco.mj_resetData(model, data)
        begin = time.perf_counter()
        for _ in range(STEPS * substeps):
            mujoco.mj_step(model, data)
        times.append((time.perf_counter() - begin) / STEPS)
    return min(times)


def one() -> None:
    environment = gymnasium.make("Pusher-v5").unwrapped
    seconds = rate_of(environment)
    bare = bare_of(environment.model, environment.data, environment.frame_skip)
    tell(NAME, seconds / bare)


def many() -> None:
    environment = gymnasium.make("Pusher-v5").unwrapped
    bare = bare_of(environment.model, environment.data, environment.frame_skip)
    together = gymnasium.make_vec("Pusher-v5", num_envs=ROBOTS, vectorization_mode="sync")
    tell(NAME, rate_of(together) / bare)


if __name__ == "__main__":
    main({"environment": one, "environments": many})
