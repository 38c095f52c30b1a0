"""Trains an agent for `lwr/reach` by PPO in NumPy, and compares it with inverse kinematics.

    .venv/bin/python benchmarks/learn.py [MINUTES]

64 robots are stepped together. Inverse kinematics uses the Denavit-Hartenberg table of the robot.
The agent only observes joint angles and velocities, and the positions of flange and target in a
frame that rotates with the first joint. It learns from the logarithm of the reward, which does not
become flat far from the target. Both are evaluated by the mean return of the same 64 episodes,
which are not used for training. The training ends when the agent has twice reached 60 % of the
return of inverse kinematics, or after the given number of minutes.

Schulman et al. 2017, Proximal Policy Optimization Algorithms, arXiv:1707.06347, with advantages by
Schulman et al. 2016, High-Dimensional Continuous Control Using Generalized Advantage Estimation,
arXiv:1506.02438.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from itertools import pairwise

import gymnasium
import numpy as np
from rich.console import Console

import sero_mj

ROBOTS = 64
SHARE = 0.6  # required share of the return of inverse kinematics
OPTIONS = {"action": "impedance", "control_timestep": 0.05}
LEARNED_WITH = {"timestep": 0.002}  # the evaluation uses half of this time step
STEPS = 32  # steps of every robot between two updates
EPOCHS, BATCH = 8, 512
DISCOUNT, TRACE = 0.96, 0.95
CLIP = 0.2
HIDDEN = 64
RATE, UPDATES = 6e-4, 200  # initial learning rate, and updates until it is a tenth of this
JUDGED_AT = 12345  # seed of the episodes for evaluation

Seen = dict[str, np.ndarray]


def features(seen: Seen) -> np.ndarray:
    """Returns the inputs of the networks, shape (m, 32), with magnitudes of about 1."""
    angles = seen["joint_angles"]
    turned = np.exp(-1j * angles[:, 0])
    flange, target = (
        np.stack([flat.real, flat.imag, seen[f"{name}_position"][:, 2]], axis=1)
        for name in ("flange", "target")
        for flat in [(seen[f"{name}_position"][:, :2] @ np.array([1.0, 1.0j])) * turned]
    )
    off = target - flange
    distance = np.linalg.norm(off, axis=1, keepdims=True)
    return np.hstack([
        np.sin(angles), np.cos(angles[:, 1:6]), 0.5 * seen["joint_velocities"],
        2.0 * flange, 3.0 * off, off / (distance + 0.05), distance,
        3.0 * (seen["commanded_angles"] - angles),
    ])  # fmt: skip


class Network:
    """A network of two tanh layers and a linear layer, trained by Adam (Kingma and Ba 2015)."""

    def __init__(self, rng: np.random.Generator, inputs: int, outputs: int, last: float) -> None:
        sizes = [inputs, HIDDEN, HIDDEN, outputs]
        self.parameters = []
        for k, (a, b) in enumerate(pairwise(sizes)):
            scale = last if k == len(sizes) - 2 else np.sqrt(1.0 / a)
            self.parameters += [scale * rng.standard_normal((a, b)), np.zeros(b)]
        self.adam = Adam(self.parameters)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Returns the outputs, shape (m, outputs), for inputs of shape (m, inputs)."""
        self.layers = [x]
        *hidden, last = zip(self.parameters[::2], self.parameters[1::2], strict=True)
        for weights, bias in hidden:
            self.layers.append(np.tanh(self.layers[-1] @ weights + bias))
        return self.layers[-1] @ last[0] + last[1]

    def gradients(self, slope: np.ndarray) -> list[np.ndarray]:
        """Returns the gradients of the parameters from the gradient of the last outputs."""
        found: list[np.ndarray] = []
        for k in range(2, -1, -1):
            x = self.layers[k]
            found = [x.T @ slope, slope.sum(axis=0), *found]
            if k:
                slope = (slope @ self.parameters[2 * k].T) * (1.0 - x * x)
        return found


class Adam:
    """The Adam optimizer, which changes parameters in place."""

    def __init__(self, parameters: list[np.ndarray]) -> None:
        self.parameters, self.k = parameters, 0
        self.first = [np.zeros_like(each) for each in parameters]
        self.second = [np.zeros_like(each) for each in parameters]

    def step(self, gradients: list[np.ndarray], rate: float) -> None:
        """Performs one step with gradients, which are clipped to a norm of 0.5."""
        self.k += 1
        norm = np.sqrt(sum(float((each**2).sum()) for each in gradients))
        scale = min(1.0, 0.5 / (norm + 1e-9))
        for k, gradient in enumerate(gradients):
            self.first[k] += 0.1 * (scale * gradient - self.first[k])
            self.second[k] += 0.001 * ((scale * gradient) ** 2 - self.second[k])
            mean = self.first[k] / (1 - 0.9**self.k)
            size = np.sqrt(self.second[k] / (1 - 0.999**self.k)) + 1e-8
            self.parameters[k] -= rate * mean / size


class Agent:
    """A Gaussian policy and a value function with separate networks."""

    def __init__(self, inputs: int, actions: int, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.policy = Network(self.rng, inputs, actions, 0.01)
        self.value = Network(self.rng, inputs, 1, 1.0 / HIDDEN**0.5)
        self.log_deviation = np.full(actions, -0.7)
        self.deviation_adam = Adam([self.log_deviation])

    def act(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Returns actions and the logarithms of their probabilities, except for a constant."""
        noise = self.rng.standard_normal((len(x), len(self.log_deviation)))
        actions = self.policy(x) + np.exp(self.log_deviation) * noise
        return actions, -0.5 * (noise**2).sum(axis=1) - self.log_deviation.sum()

    def learn(self, rows: dict[str, np.ndarray], rate: float) -> None:
        """Trains the networks on all rows for several epochs, in batches."""
        gain = rows["advantages"]
        gain = (gain - gain.mean()) / (gain.std() + 1e-8)
        for _ in range(EPOCHS):
            order = self.rng.permutation(len(gain))
            for k in range(0, len(order), BATCH):
                part = order[k : k + BATCH]
                x, m = rows["x"][part], len(part)
                deviation = np.exp(self.log_deviation)
                off = (rows["actions"][part] - self.policy(x)) / deviation
                now = -0.5 * (off**2).sum(axis=1) - self.log_deviation.sum()
                ratio = np.exp(now - rows["logs"][part])
                g = gain[part]
                free = np.where(g > 0, ratio < 1 + CLIP, ratio > 1 - CLIP)
                slope = (-(g * ratio * free) / m)[:, None]  # of the loss by the log probability
                self.policy.adam.step(self.policy.gradients(slope * off / deviation), rate)
                self.deviation_adam.step([(slope * (off**2 - 1.0)).sum(axis=0) - 1e-3], rate)
                missing = self.value(x)[:, 0] - rows["returns"][part]
                self.value.adam.step(self.value.gradients(missing[:, None] / m), rate)


def returns_of(act: Callable[[Seen], np.ndarray]) -> float:
    """Returns the mean return of one episode of each robot."""
    environments = gymnasium.make_vec("sero_mj/lwr-reach-v0", num_envs=ROBOTS, **OPTIONS)
    seen, _ = environments.reset(seed=JUDGED_AT)
    total, is_over = np.zeros(ROBOTS), np.zeros(ROBOTS, bool)
    while not is_over.all():
        seen, rewards, terminated, truncated, _ = environments.step(act(seen))
        total += np.where(is_over, 0.0, rewards)
        is_over |= terminated | truncated
    environments.close()
    return float(total.mean())


def inverse_kinematics() -> Callable[[Seen], np.ndarray]:
    """Returns a policy that moves straight to the target at maximum speed, away from limits."""
    robot = sero_mj.SerialRobot.from_model("lwr")
    step = OPTIONS["control_timestep"] * robot.velocity_limits
    middle = robot.position_limits.mean(axis=1)

    def act(seen: Seen) -> np.ndarray:
        angles = seen["commanded_angles"]
        flange = (robot.base_frame @ robot.fwd_kin_base_to_flange(angles))[:, :3, 3]
        J = robot.dh.jacobian(angles, robot.base_frame, robot.T_n_flange)[:, :3]
        inverse = J.mT @ np.linalg.inv(J @ J.mT + 1e-3 * np.eye(3))
        aside = 0.1 * (middle - angles)
        aside -= (inverse @ (J @ aside[..., None]))[..., 0]
        move = (inverse @ (seen["target_position"] - flange)[..., None])[..., 0] + aside
        share = move / step
        return share / np.maximum(np.abs(share).max(axis=1, keepdims=True), 1.0)

    return act


def main() -> None:
    console = Console()
    minutes = float(sys.argv[1]) if len(sys.argv) > 1 else 15.0
    best = returns_of(inverse_kinematics())
    still = returns_of(lambda seen: np.zeros((ROBOTS, 7)))
    console.print(f"return of inverse kinematics {best:.1f}, without motion {still:.1f}")
    environments = gymnasium.make_vec(
        "sero_mj/lwr-reach-v0", num_envs=ROBOTS, **OPTIONS, **LEARNED_WITH
    )
    seen, _ = environments.reset(seed=1)
    x = features(seen)
    agent = Agent(x.shape[1], 7, seed=1)
    begin, steps, updates, held = time.perf_counter(), 0, 0, 0
    is_begun = np.zeros(ROBOTS, bool)  # rows in which an episode begins, without an action
    while held < 2 and time.perf_counter() - begin < 60 * minutes:
        kept: dict[str, list[np.ndarray]] = {
            key: [] for key in ("x", "actions", "logs", "rewards", "values", "begun", "end")
        }
        for _ in range(STEPS):
            actions, logs = agent.act(x)
            values = agent.value(x)[:, 0]
            seen, rewards, terminated, truncated, _ = environments.step(np.clip(actions, -1, 1))
            earned = 0.2 * np.log(np.maximum(rewards, 1e-3))
            new = (x, actions, logs, earned, values, is_begun, terminated)
            for key, value in zip(kept, new, strict=True):
                kept[key].append(value)
            is_begun, x = terminated | truncated, features(seen)
        rows = {key: np.array(value) for key, value in kept.items()}
        # The value of the last state of an episode replaces the rewards after the episode.
        values = np.vstack([rows["values"], agent.value(x)[:, 0]])
        goes_on = ~rows["begun"]
        advantages, last = np.zeros_like(rows["rewards"]), np.zeros(ROBOTS)
        for k in range(STEPS - 1, -1, -1):
            following = np.where(rows["end"][k], 0.0, values[k + 1])
            missing = rows["rewards"][k] + DISCOUNT * following - values[k]
            last = np.where(goes_on[k], missing + DISCOUNT * TRACE * last, 0.0)
            advantages[k] = last
        rows["advantages"], rows["returns"] = advantages, advantages + rows["values"]
        learned = {key: rows[key][goes_on] for key in ("x", "actions", "logs", "returns")}
        learned["advantages"] = advantages[goes_on]
        agent.learn(learned, RATE * max(1.0 - updates / UPDATES, 0.1))
        steps += int(goes_on.sum())
        updates += 1
        if updates % 25 == 0:
            passed = time.perf_counter() - begin
            found = returns_of(lambda seen: np.clip(agent.policy(features(seen)), -1, 1))
            held = held + 1 if found >= SHARE * best else 0
            console.print(
                f"{passed / 60:5.1f} min  {steps / 1e3:6.0f} thousand steps  return {found:5.1f}, "
                f"{found / best:.2f} of inverse kinematics"
            )
    environments.close()
    sys.exit(0 if held else f"expected {SHARE:.0%} of the return of inverse kinematics")


if __name__ == "__main__":
    main()
