"""Many environments of a robot with a task, stepped together, for Gymnasium."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from ...base.errors import DeclarationError, Problem
from ...base.frames import Array, Bools
from ...study.engine import available_cpus
from .gymnasium_env import (
    Observation,
    action_space,
    name_and_options,
    observation_bounds,
    observation_space,
)
from .make import make_environment
from .many import ManyEnvironments


class GymnasiumVector(VectorEnv[Any, Any, Any]):
    """A Gymnasium vector of environments that are stepped together.

    Each environment behaves like a `GymnasiumEnvironment`. If an episode has ended, the next step
    ignores the action and begins another episode (`AutoresetMode.NEXT_STEP`).

    Args:
        many: environments to step.
        is_seeded: whether the first `reset` uses the seeds of `many`.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "autoreset_mode": AutoresetMode.NEXT_STEP,
        "render_modes": [],
    }
    render_mode = None

    def __init__(self, many: ManyEnvironments, *, is_seeded: bool = False) -> None:
        self.many, self.num_envs = many, many.m
        one = many.environment
        self._bounds = observation_bounds(one)
        self._scale: Array = one.action_spec().maximum
        self.single_observation_space = observation_space(self._bounds)
        self.single_action_space = action_space(one)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._is_seeded = is_seeded

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins the next episode of all environments, or the first episode of new seeds.

        `seed` is the seed of the first environment, which is incremented for the others, or a
        sequence of all seeds. Without a seed, the first seeds are random.
        """
        is_first = bool(self.many.episodes[0] < 0) and not self._is_seeded
        seeds: Any = None
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
            seeds = int(seed) + np.arange(self.num_envs)
        elif seed is not None:
            seeds = np.array(seed)
        elif is_first:
            seeds = np.random.SeedSequence().generate_state(self.num_envs)
        if seeds is not None and seeds.shape != (self.num_envs,):
            raise Problem(
                "seed", found=seeds.size, expected=f"one seed, or {self.num_envs} seeds"
            ).error()
        observed = self.many.reset(seeds)
        return self._within(observed), self._episodes(np.ones(self.num_envs, bool))

    def step(self, actions: Any) -> tuple[Observation, Array, Bools, Bools, dict[str, Any]]:
        """Simulates a control step with actions from -1 to 1, shape (num_envs, n).

        Raises:
            ValueError: the actions have a wrong shape.
            SimulationError: an action is NaN or infinite; nothing is simulated.
            gymnasium.error.ResetNeeded: no episode has begun.
        """
        many = self.many
        if many.episodes[0] < 0:
            raise gymnasium.error.ResetNeeded("there is no episode; call reset() before step()")
        wanted = np.asarray(actions, np.float64)
        if wanted.shape == self.action_space.shape:  # `step` reports a wrong shape
            wanted = wanted * self._scale
        begun = many.is_over.copy()
        observed, rewards, terminated, truncated = many.step(wanted)
        infos = self._episodes(begun) if begun.any() else {}
        if terminated.any():
            infos["error"] = np.full(self.num_envs, None)
            infos["error"][terminated] = "the motion has become unstable"
            infos["_error"] = terminated.copy()
        return self._within(observed), rewards, terminated, truncated, infos

    def begin_next(self) -> Observation:
        """Begins the next episode of each environment whose episode has ended.

        Returns the observations of all environments.
        """
        return self._within(self.many.begin_next())

    def _episodes(self, which: Bools) -> dict[str, Any]:
        return {"episode": np.where(which, self.many.episodes, 0), "_episode": which.copy()}

    def _within(self, observed: Observation) -> Observation:
        return {name: np.clip(observed[name], *bounds) for name, bounds in self._bounds.items()}

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the threads."""
        self.many.close()


def make_gymnasium_vector(
    num_envs: int,
    name: str | None = None,
    *,
    threads: int | None = None,
    render_mode: str | None = None,
    **options: Any,
) -> GymnasiumVector:
    """Creates a `GymnasiumVector`. Called by `gymnasium.make_vec` for robots with a task.

    `threads` is the number of threads (default: one per core). `render_mode` must be None. `name`
    and `options` are those of `make_gymnasium_environment`.

    Raises:
        DeclarationError: an option is wrong, or these environments can only be stepped one by one.
    """
    problems = [
        Problem(key, found=value, expected="1 or more")
        for key, value in (("num_envs", num_envs), ("threads", threads))
        if value is not None and value < 1
    ]
    if render_mode is not None:
        problems.append(
            Problem("render_mode", found=render_mode, expected="None, or vectorization_mode='sync'")
        )
    if problems:
        raise DeclarationError(problems)
    name, options = name_and_options(name, options)
    environment = make_environment(name, **options)
    many = ManyEnvironments(environment, num_envs, threads or available_cpus())
    return GymnasiumVector(many, is_seeded="seed" in options)
