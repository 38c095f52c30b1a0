"""Environments for Stable-Baselines3, with the interface of its vectors of environments.

If it is not installed (it requires torch), a stand-in for `VecEnv` of 2.9 is used.
"""

from __future__ import annotations

import importlib
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import raises_with

import sero_mj  # noqa: F401  registers the environments

IS_INSTALLED = find_spec("stable_baselines3") is not None
OPTIONS: dict[str, Any] = {"time_limit": 0.1, "action": "impedance"}
NAME, ADAPTER = "sero_mj/lwr-reach-v0", "sero_mj.extensions.learning.stable_baselines"


class StandIn(ABC):
    """`stable_baselines3.common.vec_env.VecEnv`."""

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None:
        self.num_envs = num_envs
        self.observation_space, self.action_space = observation_space, action_space
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(num_envs)]
        self._reset_seeds()
        self._reset_options()
        (self.render_mode,) = {*self.get_attr("render_mode")}

    def _reset_seeds(self) -> None:
        self._seeds: list[int | None] = [None] * self.num_envs

    def _reset_options(self) -> None:
        self._options: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]

    def seed(self, seed: int) -> None:
        self._seeds = [seed + k for k in range(self.num_envs)]

    def step(self, actions: Any) -> Any:
        self.step_async(actions)
        return self.step_wait()

    @abstractmethod
    def reset(self) -> Any: ...
    @abstractmethod
    def step_async(self, actions: Any) -> None: ...
    @abstractmethod
    def step_wait(self) -> Any: ...
    @abstractmethod
    def close(self) -> None: ...
    @abstractmethod
    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]: ...
    @abstractmethod
    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None: ...
    @abstractmethod
    def env_method(self, method_name: str, *args: Any, indices: Any = None) -> list[Any]: ...
    @abstractmethod
    def env_is_wrapped(self, wrapper_class: type, indices: Any = None) -> list[bool]: ...


@pytest.fixture
def vector(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Returns three environments behind the adapter."""
    if find_spec("stable_baselines3") is None:
        names = (
            "stable_baselines3",
            "stable_baselines3.common",
            "stable_baselines3.common.vec_env",
        )
        for name in names:
            monkeypatch.setitem(sys.modules, name, ModuleType(name))
        monkeypatch.setattr(sys.modules[names[-1]], "VecEnv", StandIn, raising=False)
        monkeypatch.delitem(sys.modules, ADAPTER, raising=False)
    adapter = importlib.import_module(ADAPTER)
    made = adapter.StableBaselinesVector(gymnasium.make_vec(NAME, num_envs=3, **OPTIONS))
    yield made
    made.close()
    if not IS_INSTALLED:
        sys.modules.pop(ADAPTER, None)


def test_next_episode_begins_in_the_step_in_which_one_ends(vector: Any) -> None:
    alone = [gymnasium.make(NAME, **OPTIONS) for _ in range(3)]
    vector.seed(5)
    seen = vector.reset()
    expected = [each.reset(seed=5 + k)[0] for k, each in enumerate(alone)]
    rng, ends = np.random.default_rng(0), 0
    for _ in range(12):
        for k, one in enumerate(expected):
            for name, values in one.items():
                np.testing.assert_allclose(seen[name][k], values, rtol=1e-12, atol=1e-12)
        actions = rng.uniform(-1.0, 1.0, (3, 7)).astype(np.float32)
        seen, rewards, over, infos = vector.step(actions)
        assert rewards.dtype == np.float32 and over.dtype == bool
        for k, environment in enumerate(alone):
            expected[k], reward, terminated, truncated, _ = environment.step(actions[k])
            assert rewards[k] == pytest.approx(reward, rel=1e-6)
            assert over[k] == (terminated or truncated)
            assert infos[k]["TimeLimit.truncated"] == truncated
            assert "episode" not in infos[k]  # SB3 takes this as information of its monitors
            assert ("terminal_observation" in infos[k]) == over[k]
            if over[k]:
                ends += 1
                for name, values in expected[k].items():
                    last = infos[k]["terminal_observation"][name]
                    np.testing.assert_allclose(last, values, rtol=1e-12, atol=1e-12)
                expected[k] = environment.reset()[0]
    assert ends == 6


def test_unstable_episode_is_over_but_not_by_its_time_limit(vector: Any) -> None:
    vector.seed(1)
    vector.reset()
    vector.vector.many.lanes[0].plant.physics.bind("qvel")[0] = 1e12
    seen, _, over, infos = vector.step(np.zeros((3, 7), np.float32))
    assert over.tolist() == [True, False, False]
    assert not infos[0]["TimeLimit.truncated"]
    assert infos[0]["error"] == "the motion has become unstable"
    assert all(np.isfinite(values).all() for values in seen.values())


def test_methods_of_single_environments_apply_to_all(vector: Any) -> None:
    assert vector.get_attr("render_mode") == [None] * 3
    assert vector.get_attr("num_envs", [0, 2]) == [3, 3]
    assert vector.env_is_wrapped(gymnasium.Wrapper, 1) == [False]
    with pytest.raises(AttributeError, match="stepped together have no separate methods"):
        vector.env_method("render")
    with raises_with(
        key="indices", reason="found 1", expected="None, because render_mode is shared"
    ):
        vector.set_attr("render_mode", "rgb_array", 1)
