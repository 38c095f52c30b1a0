"""`StableBaselinesVector`: environments that are stepped together, for Stable-Baselines3.

Import it from here, with Stable-Baselines3 installed (`pip install stable-baselines3`); nothing
else needs that.
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
    """Environments of `gymnasium.make_vec` as Stable-Baselines3 takes them.

    Where an episode is over, the next one begins in the same step; what was seen last is the
    `terminal_observation` of its information. Returns of episodes are told by SB3's `VecMonitor`.

    Args:
        vector: what `gymnasium.make_vec("sero_mj/...", num_envs=...)` has made.
    """

    def __init__(self, vector: GymnasiumVector) -> None:
        self.vector = vector.unwrapped
        self._actions: Any = None
        super().__init__(
            vector.num_envs, vector.single_observation_space, vector.single_action_space
        )

    def reset(self) -> Observation:
        """Begins the next episode of all, or the first ones of what `seed` was told."""
        seeds = None if None in self._seeds else list(self._seeds)
        seen, _ = self.vector.reset(seed=seeds)
        self._reset_seeds()
        self._reset_options()
        return seen

    def step_async(self, actions: Any) -> None:
        """Keeps actions, (num_envs, n), for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Observation, Array, Bools, list[dict[str, Any]]]:
        """Simulates a control step of all; see `GymnasiumVector.step`.

        Returns:
            observations, rewards (num_envs,), where an episode is over, and information on each.
        """
        seen, rewards, terminated, truncated, told = self.vector.step(self._actions)
        over = terminated | truncated
        infos: list[dict[str, Any]] = [{"TimeLimit.truncated": bool(cut)} for cut in truncated]
        last = seen
        if over.any():
            seen = self.vector.begin_next()
        for k in np.flatnonzero(over).tolist():
            infos[k]["terminal_observation"] = {name: value[k] for name, value in last.items()}
            if terminated[k]:
                infos[k]["error"] = told["error"][k]
        return seen, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Ends the threads."""
        self.vector.close()

    def get_attr(self, attr_name: str, indices: _Some = None) -> list[Any]:
        """What all have in common, once for each."""
        return [getattr(self.vector, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: _Some = None) -> None:
        """Sets it for all; raises ValueError where it is to be for some only."""
        if len(self._chosen(indices)) != self.num_envs:
            raise Problem(
                "indices", f"found {indices}", expected=f"None: all have one {attr_name}"
            ).error()
        setattr(self.vector, attr_name, value)

    def env_method(
        self, method_name: str, *arguments: Any, indices: _Some = None, **options: Any
    ) -> list[Any]:
        """Raises AttributeError: there are no objects of which each is one environment."""
        raise AttributeError(
            f"{method_name}: environments that are stepped together have no methods of their own; "
            "expected a vector of single ones (vectorization_mode='sync')"
        )

    def env_is_wrapped(self, wrapper_class: type, indices: _Some = None) -> list[bool]:
        """False for each: nothing is around a single one."""
        return [False] * len(self._chosen(indices))

    def _chosen(self, indices: _Some) -> Sequence[int]:
        if indices is None:
            return range(self.num_envs)
        return [indices] if isinstance(indices, int) else list(indices)
