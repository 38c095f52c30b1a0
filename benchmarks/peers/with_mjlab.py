"""mjlab's environment of an arm that lifts a cube, by MuJoCo Warp on the processor."""

from __future__ import annotations

import time

import mjlab.tasks  # noqa: F401  # registers them
import mujoco
import torch
from common import main, tell
from mjlab.envs import ManagerBasedRlEnv
from mjlab.tasks.registry import load_env_cfg

NAME, TASK = "mjlab", "Mjlab-Lift-Cube-Yam"


def measure(robots: int, steps: int) -> None:
    settings = load_env_cfg(TASK)
    settings.scene.num_envs = robots
    environment = ManagerBasedRlEnv(settings, device="cpu")
    environment.reset(seed=1)
    shape = robots, environment.action_manager.total_action_dim
    environment.step(torch.zeros(shape))  # compiles what a step needs
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        for _ in range(steps):
            environment.step(0.05 * (2 * torch.rand(shape) - 1))
        times.append((time.perf_counter() - begin) / steps / robots)
    model = environment.sim.mj_model
    data, substeps, bare = mujoco.MjData(model), settings.decimation, []
    for _ in range(3):
        mujoco.mj_resetData(model, data)
        begin = time.perf_counter()
        for _ in range(100 * substeps):
            mujoco.mj_step(model, data)
        bare.append((time.perf_counter() - begin) / 100)
    tell(NAME, min(times) / min(bare))


if __name__ == "__main__":
    main({"environment": lambda: measure(1, 20), "environments": lambda: measure(64, 20)})
