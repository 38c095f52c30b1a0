"""Environments that are stepped together, for Stable-Baselines3.

This module requires Stable-Baselines3 (`pip install stable-baselines3`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from ...base.errors import Problem
from ...base.frames import Array, Bools
from .gymnasium_env import Observation
from .gymnasium_vector import GymnasiumVector

_Some = None | int | Iterable[int]


class StableBaselinesVector(VecEnv):  # type: ignore[misc]
    """A Stable-Baselines3 vector of environments from `gymnasium.make_vec("sero_mj/...")`.

    When an episode ends, the next one begins in the same step, and the last observation is the
    `terminal_observation` in the info. `VecMonitor` reports the returns of episodes.
    """

    def __init__(self, vector: GymnasiumVector) -> None:
        self.vector = vector.unwrapped
        self._actions: Any = None
        super().__init__(
            vector.num_envs, vector.single_observation_space, vector.single_action_space
        )

    def reset(self) -> Observation:
        """Begins the next episodes, or the first episodes of seeds that `seed` has set."""
        seeds = None if None in self._seeds else list(self._seeds)
        observed, _ = self.vector.reset(seed=seeds)
        self._reset_seeds()
        self._reset_options()
        return observed

    def step_async(self, actions: Any) -> None:
        """Stores actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, Array, Bools, list[dict[str, Any]]]:
        """Simulates a control step.

        Returns observations, rewards, whether each episode has ended, and infos.
        """
        observed, rewards, terminated, truncated, info = self.vector.step(self._actions)
        over = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": bool(cut)} for cut in truncated]
        last = observed
        if over.any():
            observed = self.vector.begin_next()
        for k in np.flatnonzero(over).tolist():
            infos[k]["terminal_observation"] = {name: value[k] for name, value in last.items()}
            if terminated[k]:
                infos[k]["error"] = info["error"][k]
        return observed, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Ends the threads."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: _Some = None) -> list[Any]:
        """Returns the value of a shared attribute once for each environment."""
        return [getattr(self.vector, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: _Some = None) -> None:
        """Sets an attribute of all environments; raises ValueError if only some are selected."""
        if len(self._chosen(indices)) != self.num_envs:
            raise Problem(
                "indices", f"found {indices}", expected=f"None, because {attr_name} is shared"
            ).error()
        setattr(self.vector, attr_name, value)

    def env_method(
        self, method_name: str, *arguments: Any, indices: _Some = None, **options: Any
    ) -> list[Any]:
        """Raises AttributeError, because there is no object for a single environment."""
        raise AttributeError(
            f"{method_name}: environments that are stepped together have no separate methods. Use "
            "vectorization_mode='sync' instead."
        )

    def env_is_wrapped(self, wrapper_class: type, indices: _Some = None) -> list[bool]:
        """Returns False for each environment, because single environments have no wrappers."""
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: _Some) -> Sequence[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else list(indices)
