"""Environments for gymnasium: its checker, and equality with those of dm_env."""

from __future__ import annotations

import math
import os
import subprocess
import sys
from typing import Any

import gymnasium
import numpy as np
import pytest
from conftest import raises_with
from gymnasium.utils.env_checker import check_env
from window_tools import MISSING, screen

import sero_mj
from sero_mj.base.errors import DeclarationError, SimulationError, UnknownName
from sero_mj.extensions.learning.gymnasium_env import GymnasiumEnvironment
from sero_mj.extensions.learning.gymnasium_ids import TASKS
from sero_mj.extensions.learning.make import TASKS as ALL_TASKS
from sero_mj.extensions.learning.make import list_environments

SHORT = {"time_limit": 0.1}


def plain(name: str, **options: Any) -> GymnasiumEnvironment:
    """Returns the environment without gymnasium's wrappers."""
    environment = gymnasium.make(f"sero_mj/{name}-v0", **options).unwrapped
    assert isinstance(environment, GymnasiumEnvironment)
    return environment


def actions(environment: Any, steps: int, seed: int = 0) -> np.ndarray:
    """Returns random actions, (steps, n)."""
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, (steps, *environment.action_space.shape)).astype(np.float32)


def test_every_environment_and_user_robot_has_an_id() -> None:
    assert tuple(ALL_TASKS) == TASKS
    expected = {f"sero_mj/{name.replace('/', '-')}-v0" for name in list_environments()}
    expected |= {f"sero_mj/{name}-v0" for name in (*TASKS, "scenario")}
    assert {name for name in gymnasium.registry if name.startswith("sero_mj/")} == expected


@pytest.mark.parametrize("order", ["gymnasium, sero_mj", "sero_mj, gymnasium"])
def test_importing_registers_ids_in_either_order_and_imports_no_mujoco(order: str) -> None:
    code = f"""
import sys, {order}
assert gymnasium.__spec__.name == "gymnasium" and gymnasium.__version__
found = {{name for name in gymnasium.registry if name.startswith("sero_mj/")}}
assert "sero_mj/lwr-reach-v0" in found and "mujoco" not in sys.modules
assert not any("Registrar" in type(finder).__name__ for finder in sys.meta_path)
from sero_mj.extensions.learning.gymnasium_ids import register_environments
register_environments()  # warns of nothing: they are there
"""
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=60)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("lwr-reach", SHORT),
        ("lwr-reach", {**SHORT, "target": "pose", "action": "impedance"}),
        ("lwr-hold", SHORT),
        ("reach", {**SHORT, "robot": "scara", "action": "impedance"}),  # prismatic; without limits
        ("impedance_push", {"overrides": {"run.duration": 4.6}, "control_timestep": 0.2}),
    ],
)
def test_environments_pass_the_checker_of_gymnasium(name: str, options: dict[str, Any]) -> None:
    # Its warnings are errors here.
    check_env(plain(name, **options), skip_render_check=True)


def test_steps_equal_those_of_dm_env_with_actions_scaled_by_bounds() -> None:
    options: dict[str, Any] = {"action": "impedance", "time_limit": 0.12}
    one = plain("lwr-reach", **options)
    other = sero_mj.make_environment("lwr/reach", seed=11, **options)
    high = other.action_spec().maximum
    for episode in range(2):
        seen, info = one.reset(seed=11 if episode == 0 else None)
        step = other.reset()
        assert info == {"episode": episode}
        for k, action in enumerate(actions(one, 6, episode)):
            assert seen.keys() == step.observation.keys()
            for key, value in seen.items():
                np.testing.assert_array_equal(value, step.observation[key])
            assert seen in one.observation_space
            step = other.step(action.astype(np.float64) * high)
            seen, reward, terminated, truncated, info = one.step(action)
            assert reward == step.reward
            assert (terminated, truncated, info) == (False, k == 5, {})
        assert step.last()
        with pytest.raises(gymnasium.error.ResetNeeded):
            one.step(action)


def test_environments_without_a_seed_differ() -> None:
    first, second = (plain("lwr-reach", **SHORT).reset()[0] for _ in range(2))
    assert np.abs(first["target_position"] - second["target_position"]).max() > 1e-3
    third, fourth = (plain("lwr-reach", seed=4, **SHORT).reset()[0] for _ in range(2))
    np.testing.assert_array_equal(third["target_position"], fourth["target_position"])


def test_unstable_motion_is_terminated_with_a_reason() -> None:
    environment = plain("lwr-reach")
    environment.reset(seed=1)
    zero = np.zeros(7, np.float32)
    before = environment.step(zero)[0]
    environment.environment.data.qvel[:] = 1e12
    seen, reward, terminated, truncated, info = environment.step(zero)
    assert (reward, terminated, truncated) == (0.0, True, False)
    assert "unstable" in info["error"]
    np.testing.assert_array_equal(seen["joint_angles"], before["joint_angles"])


def test_observations_are_clipped_to_finite_bounds() -> None:
    environment = plain("lwr-reach", time_limit=1.0)
    environment.reset(seed=3)
    most = 10.0 * environment.environment.robot.velocity_limits
    np.testing.assert_allclose(environment.observation_space["joint_velocities"].high, most)
    environment.environment.data.qvel[:] = [0, 0, 0, 0, 0, 0, 2 * most[6]]
    for action in actions(environment, 10):
        seen = environment.step(action)[0]
        assert seen in environment.observation_space
    with raises_with(
        SimulationError,
        joint="lwr/A1",
        reason="found an action of nan; expected -176 to 176 Nm",
        found=math.nan,
        expected="-176 to 176 Nm",
    ):
        environment.step(np.full(7, np.nan, np.float32))


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("reach", {}, 'robot is required; expected a name, folder or file such as robot="pand'),
        ("reach", {"robot": "pnda"}, "no robot model 'pnda'; did you mean 'panda'?"),
        ("reach", {"robot": {"show_axes": True}}, "robot is required"),
        ("scenario", {}, 'scenario is required; expected a name or a file such as scenario="my'),
        ("scenario", {"scenario": "no.toml"}, "no.toml: no such file"),
        ("lwr-reach", {"tim_limit": 2}, "tim_limit: unknown option; did you mean 'time_limit'?"),
        ("lwr-reach", {"render_mode": "rgb"}, "render_mode: found 'rgb'; available: human, rgb_ar"),
        ("scara-reach", {}, 'expected one per joint, Nm, or action="impedance"'),
    ],
)  # fmt: skip
def test_invalid_arguments_are_rejected(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises((DeclarationError, UnknownName)) as caught:
        sero_mj.extensions.learning.gymnasium_env.make_gymnasium_environment(
            **{**gymnasium.spec(f"sero_mj/{name}-v0").kwargs, **options}
        )
    assert message in str(caught.value)


def test_robot_fields_can_be_passed_with_the_model_name() -> None:
    robot = {"model": "lwr", "torque_limits": [1.0] * 7}
    environment = plain("reach", robot=robot, **SHORT)
    np.testing.assert_array_equal(environment.environment.action_spec().maximum, np.ones(7))
    assert robot["model"] == "lwr"


@pytest.mark.thorough
@pytest.mark.gl
def test_windows_and_images_pass_the_checker_of_gymnasium() -> None:
    if MISSING:
        pytest.skip(f"{' and '.join(MISSING)} cannot be found")
    code = """
import gymnasium, sero_mj, numpy as np
from gymnasium.utils.env_checker import check_env
options = {"time_limit": 0.1, "width": 64, "height": 48}
env = gymnasium.make("sero_mj/lwr-reach-v0", render_mode="rgb_array", **options).unwrapped
check_env(env)
env.reset(seed=1)
before = env.render()
for _ in range(4):
    env.step(np.ones(7, np.float32))
assert before.shape == (48, 64, 3) and np.abs(env.render().astype(int) - before).max() > 50
env.close()
env.close()
"""
    with screen() as display:
        here = {**os.environ, "DISPLAY": display, "MUJOCO_GL": "glfw"}
        subprocess.run(
            [sys.executable, "-W", "error", "-c", code], env=here, check=True, timeout=100
        )


def test_stable_baselines_can_train() -> None:
    pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed")
    from stable_baselines3 import PPO
    from stable_baselines3.common import env_checker

    environment = gymnasium.make("sero_mj/lwr-reach-v0", action="impedance", **SHORT)
    env_checker.check_env(environment.unwrapped)
    agent = PPO("MultiInputPolicy", environment, n_steps=16, batch_size=8, n_epochs=1, seed=1)
    agent.learn(32)
    action, _ = agent.predict(environment.reset(seed=1)[0])
    assert environment.action_space.contains(action)
