"""The momentum observer against known forces, friction, noise, and its time constant."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from numpy.typing import NDArray
from simulated import START, Loop, lwr_model

from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.joint_control import JointImpedance
from sero_mj.simulate.control.observer import MomentumObserver

Array = NDArray[np.float64]
STEP = 1e-3


class Watched:
    """An LWR that follows a sine, with motor friction and an external force, fully logged."""

    def __init__(self, force: Array, begin: float, seconds: float, friction: float = 0.0) -> None:
        self.loop = Loop(STEP)
        data, model, robot = self.loop.data, self.loop.model, self.loop.robot
        model.dof_damping[:] = friction
        control, target = JointImpedance(stiffness=1500.0).make(robot, STEP), Target(7)
        target.angles[:] = START
        rows: list[Array] = []
        previous, jacobian = np.zeros(7), np.zeros((3, 7))

        def act(sensed: Sensed, out: Array) -> None:
            t = sensed.time
            target.angles[:] = START + 0.4 * np.sin(2.0 * t) * np.linspace(1, -1, 7)
            target.velocities[:] = 0.8 * np.cos(2.0 * t) * np.linspace(1, -1, 7)
            control.torques(sensed, target, out)
            data.xfrc_applied[self.loop.flange, :3] = force if t >= begin - 1e-9 else 0.0
            # External torques of this step, by MuJoCo: on the motors and on the links.
            mujoco.mj_forward(model, data)
            mujoco.mj_jacBodyCom(model, data, jacobian, None, self.loop.flange)
            outer = jacobian.T @ force * (t >= begin - 1e-9)
            rows.append(np.hstack([data.qpos, data.qvel, previous, outer]))
            data.qfrc_applied[:] = out
            mujoco.mj_forward(model, data)
            motor = out.copy()
            link = out - data.qvel * friction - robot.motor_inertia * data.qacc
            previous[:] = link
            self.motor.append(motor)

        self.motor: list[Array] = []
        self.loop.run(seconds, act)
        log = np.array(rows)
        self.angles, self.velocities, self.link, self.outer = np.split(log, 4, axis=1)
        self.motor_torques = np.vstack([np.zeros(7), self.motor[:-1]])


def external_torques(
    gain: float | Array, run: Watched, torques: Array, *, motor_side: bool = False
) -> Array:
    """Returns the estimates at each row of a log, (T, n)."""
    observer = MomentumObserver(lwr_model(), gain, STEP, motor_side=motor_side)
    sensed, found = Sensed(7), []
    for row in zip(run.angles, run.velocities, torques, strict=True):
        sensed.values[:] = row
        found.append(observer.update(sensed).copy())
    return np.array(found)


def test_observer_estimates_a_force_at_the_flange_of_a_moving_robot() -> None:
    force = np.array([20.0, -10.0, 30.0])
    run = Watched(force, begin=1.0, seconds=2.0)
    gain = 50.0
    found = external_torques(gain, run, run.link)
    assert np.abs(found[100:1000]).max() < 0.02  # no force acts, although the robot moves
    # A low pass of the true torques, computed as the exact response to a held input.
    expected = np.zeros((len(found), 7))
    keep = np.exp(-gain * STEP)
    for k in range(1, len(found)):
        expected[k] = keep * expected[k - 1] + (1 - keep) * run.outer[k - 1]
    assert np.abs(run.outer).max() > 10
    assert np.abs(found - expected)[100:].max() < 0.02 * np.abs(run.outer).max()


def test_motor_side_observer_includes_friction_and_link_side_does_not() -> None:
    run = Watched(np.zeros(3), begin=9.0, seconds=1.5, friction=5.0)
    link = external_torques(100.0, run, run.link)
    assert np.abs(link[200:]).max() < 0.03
    motor = external_torques(100.0, run, run.motor_torques, motor_side=True)
    assert np.abs(motor[200:] + 5.0 * run.velocities[200:]).max() < 0.3
    assert np.abs(motor[200:]).max() > 2.0


@pytest.mark.slow
@pytest.mark.parametrize("gain", [5.0, 25.0, 100.0])
def test_estimate_converges_with_the_time_constant_one_over_gain(gain: float) -> None:
    model, sensed = lwr_model(), Sensed(7)
    observer = MomentumObserver(model, gain, 1e-4)
    sensed.angles[:] = START
    model.update(START, np.zeros(7))
    outer = np.arange(1.0, 8.0)
    sensed.torques[:] = model.gravity() - outer  # held at rest against the torque
    steps = round(1.0 / gain / 1e-4)
    for _ in range(steps + 1):
        observer.update(sensed)
    np.testing.assert_allclose(observer.external, (1 - np.exp(-1)) * outer, rtol=0.01)
    for _ in range(14 * steps):
        observer.update(sensed)
    np.testing.assert_allclose(observer.external, outer, rtol=1e-5)


def test_observer_gains_apply_per_joint() -> None:
    run = Watched(np.array([0.0, 0.0, 10.0]), begin=0.1, seconds=0.3)
    gains = np.linspace(10, 200, 7)
    whole = external_torques(gains, run, run.link)
    for joint in (0, 6):
        single = external_torques(gains[joint], run, run.link)
        np.testing.assert_array_equal(whole[:, joint], single[:, joint])


def test_invalid_observer_gains_are_rejected() -> None:
    model = lwr_model()
    reason, expected = "joint A2 has an observer gain of", "a positive gain, 1/s"
    with raises_with(reason=reason, found=0.0, expected=expected):
        MomentumObserver(model, np.array([1, 0, 1, 1, 1, 1, 1.0]), STEP)
