"""Sensor errors, sensor faults, and their reproducibility from a seed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from conftest import raises_with
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import DeclarationError, Problem, UnknownName
from sero_mj.simulate.sensors import SensorErrors, Sensors

RAMP = np.arange(200.0)[:, None, None] * np.ones((3, 4)) + np.arange(4)


def run(sensors: Sensors, truth: np.ndarray = RAMP) -> np.ndarray:
    return np.array([sensors.measure(row).copy() for row in truth])


def test_perfect_sensors_measure_the_actual_values():
    np.testing.assert_array_equal(run(Sensors(4)), RAMP)


def test_gain_bias_and_resolution_apply_to_their_signal_and_joint():
    sensors = Sensors(
        4,
        angles=SensorErrors(bias=[0.1, 0, 0, 0.4]),
        torques=SensorErrors(gain=2.0, bias=0.3, resolution=[0.25, 0, 0, 0]),
    )
    read = run(sensors)
    np.testing.assert_allclose(read[:, 0], RAMP[:, 0] + [0.1, 0, 0, 0.4])
    np.testing.assert_array_equal(read[:, 1], RAMP[:, 1])
    np.testing.assert_allclose(read[:, 2, 1:], 2 * RAMP[:, 2, 1:] + 0.3)
    np.testing.assert_allclose(read[:, 2, 0], 2 * RAMP[:, 2, 0] + 0.25)


@given(resolution=st.floats(1e-4, 10), value=st.floats(-1e3, 1e3))
def test_quantized_values_are_on_the_grid_next_to_the_actual_ones(resolution, value):
    sensors = Sensors(1, angles=SensorErrors(resolution=resolution))
    read = sensors.measure(np.full((3, 1), value))[0, 0]
    assert abs(read - value) <= resolution / 2 * (1 + 1e-9)
    assert read / resolution == pytest.approx(round(read / resolution), abs=1e-6)


def test_noise_has_the_declared_deviation_and_no_memory():
    sensors = Sensors(4, torques=SensorErrors(noise=[0.5, 0.5, 0.1, 0.0]), seed=1)
    error = run(sensors, np.zeros((20_000, 3, 4)))
    assert not error[:, :2].any() and not error[:, 2, 3].any()
    # Of 20,000 values: four standard errors of deviation (1 / 200) and mean (1 / 141).
    np.testing.assert_allclose(error[:, 2, :3].std(axis=0), [0.5, 0.5, 0.1], rtol=0.02)
    assert (np.abs(error[:, 2, :3].mean(axis=0)) < 0.03 * np.array([0.5, 0.5, 0.1])).all()
    left, right = error[:-1, 2, 0], error[1:, 2, 0]
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.03
    assert abs(np.corrcoef(error[:, 2, 0], error[:, 2, 1])[0, 1]) < 0.03


def test_seed_repeats_the_noise_and_another_does_not():
    def noise(seed: int) -> np.ndarray:
        return run(Sensors(4, angles=SensorErrors(noise=1.0), seed=seed), np.zeros((600, 3, 4)))

    np.testing.assert_array_equal(noise(3), noise(3))
    assert (noise(3)[:, 0] != noise(4)[:, 0]).all()
    sensors = Sensors(4, angles=SensorErrors(noise=1.0), seed=3)
    first = run(sensors, np.zeros((300, 3, 4)))
    sensors.reset(np.zeros((3, 4)))
    np.testing.assert_array_equal(run(sensors, np.zeros((300, 3, 4))), first)


@pytest.mark.parametrize("steps", [0, 1, 5, 100])
def test_delayed_values_are_those_of_previous_steps(steps):
    sensors = Sensors(4, velocities=SensorErrors(delay=steps), torques=SensorErrors(delay=2))
    sensors.reset(RAMP[0])
    read = run(sensors)
    np.testing.assert_array_equal(read[:, 0], RAMP[:, 0])
    np.testing.assert_array_equal(read[steps:, 1], RAMP[: len(RAMP) - steps, 1])
    np.testing.assert_array_equal(read[:steps, 1], np.broadcast_to(RAMP[0, 1], (steps, 4)))
    np.testing.assert_array_equal(read[2:, 2], RAMP[:-2, 2])


def test_delay_can_begin_and_end_during_a_run():
    sensors = Sensors(4)
    sensors.reset(RAMP[0])
    run(sensors, RAMP[:50])
    sensors.delay("torques", 3)
    read = run(sensors, RAMP[50:80])
    # Earlier values were not stored; it begins with the last that was read.
    assert read[:, 2, 0].tolist() == [49, 49, 49, *range(50, 77)]
    sensors.delay("torques", 1)
    assert run(sensors, RAMP[80:85])[:, 2, 0].tolist() == [79, 80, 81, 82, 83]
    sensors.delay("torques", 0)
    np.testing.assert_array_equal(run(sensors, RAMP[85:90]), RAMP[85:90])


def test_faults_begin_during_a_run_and_are_repaired():
    sensors = Sensors(4, torques=SensorErrors(bias=0.5))
    run(sensors, RAMP[:10])
    sensors.kill("torques", 2)
    sensors.freeze("angles", 1)
    sensors.change("velocities", 0, gain=-1.0)
    sensors.change("torques", bias=2.0)
    read = run(sensors, RAMP[10:20])
    assert not read[:, 2, 2].any()
    np.testing.assert_array_equal(read[:, 0, 1], RAMP[9, 0, 1])
    np.testing.assert_array_equal(read[:, 1, 0], -RAMP[10:20, 1, 0])
    np.testing.assert_array_equal(read[:, 2, 0], RAMP[10:20, 2, 0] + 2.0)
    others = np.ones((3, 4), bool)
    others[[0, 1], [1, 0]] = others[2] = False
    np.testing.assert_array_equal(read[:, others], RAMP[10:20][:, others])
    sensors.repair()
    np.testing.assert_array_equal(run(sensors, RAMP[20:25])[:, 2], RAMP[20:25, 2] + 0.5)


def test_measuring_does_not_change_the_actual_values():
    truth = RAMP[5].copy()
    Sensors(4, angles=SensorErrors(gain=3.0, noise=1.0, delay=2)).measure(truth)
    np.testing.assert_array_equal(truth, RAMP[5])


@pytest.mark.parametrize(
    ("errors", "problem"),
    [
        ({"noise": -0.1}, Problem("noise", found=-0.1, expected="0 or more")),
        (
            {"noise": [[0.1]]},
            Problem(
                "noise",
                "found an array with",
                found=2,
                of="dimensions",
                expected="one number, or one per joint",
            ),
        ),
        ({"delay": -1}, Problem("delay", found=-1, expected="greater than or equal to 0")),
        (
            {"delay": 0.5},
            Problem("delay", found=0.5, expected="an integer without a decimal point"),
        ),
        ({"biass": 1.0}, Problem("biass", "unknown key", available=["bias"])),
        (
            {"gain": float("nan")},
            Problem("gain", found=math.nan, expected="finite numbers without NaN or inf"),
        ),
    ],
)
def test_invalid_sensor_errors_are_rejected(errors, problem):
    with pytest.raises(DeclarationError) as caught:
        SensorErrors(**errors)
    assert caught.value.problems == [problem]


def test_invalid_names_and_counts_are_rejected():
    with raises_with(key="torques.bias", found=3):
        Sensors(4, torques=SensorErrors(bias=[1, 2, 3]))
    with raises_with(UnknownName, kind="signal", name="torque", near="torques"):
        Sensors(4).kill("torque", 0)
    with raises_with(
        UnknownName,
        kind="sensor error",
        name="drift",
        available=["bias", "gain", "noise", "resolution"],
    ):
        Sensors(4).change("torques", 0, drift=1.0)
    with raises_with(key="torques", reason="found a delay of", found=-1, expected="0 or more"):
        Sensors(4).delay("torques", -1)
    with raises_with(key="torques.noise", found=-1.0):
        Sensors(4).change("torques", 0, noise=-1.0)


def test_noise_that_begins_later_is_present_at_once():
    sensors = Sensors(4)
    run(sensors, RAMP[:10])
    sensors.change("torques", 1, noise=0.5)
    error = run(sensors, RAMP[10:40]) - RAMP[10:40]
    assert error[:, 2, 1].all() and not error[:, :2].any() and not error[:, 2, [0, 2, 3]].any()


def test_delay_can_apply_to_some_joints_only():
    sensors = Sensors(3)
    values = [np.full((3, 3), float(k)) for k in range(10)]
    for k in range(5):
        sensors.measure(values[k])
    sensors.delay("angles", 2, [1])
    seen = [sensors.measure(value).copy() for value in values[5:]]
    assert [row[0].tolist() for row in seen[2:]] == [[7, 5, 7], [8, 6, 8], [9, 7, 9]]
    assert all((row[1:] == value[1:]).all() for row, value in zip(seen, values[5:], strict=True))
    sensors.delay("angles", 0, [1])
    assert sensors.measure(values[3])[0].tolist() == [3, 3, 3]


def test_velocities_are_differentiated_from_encoder_angles() -> None:
    bandwidth, step, speed = 200.0, 1e-3, 0.7
    filters = np.array([bandwidth, 0.0])
    sensors = Sensors(2, velocity_filter=filters, timestep=step)
    assert not sensors.is_perfect
    actual = np.zeros((3, 2))
    sensors.reset(actual)
    found = []
    for k in range(1, 101):
        actual[0], actual[1] = speed * step * k, speed
        found.append(sensors.measure(actual)[1].copy())
    times = step * np.arange(1, 101)
    smooth, own = np.array(found).T
    np.testing.assert_allclose(smooth, -speed * np.expm1(-bandwidth * times), atol=1e-12)
    assert (own == speed).all()


def test_coarse_encoder_makes_velocities_rough_and_a_low_pass_smooth() -> None:
    grid, step, speed = 1e-4, 1e-3, 0.033
    spreads = []
    for bandwidth in (1e5, 50.0):
        errors = SensorErrors(resolution=grid)
        filters = np.array([bandwidth])
        sensors = Sensors(1, angles=errors, velocity_filter=filters, timestep=step)
        actual = np.zeros((3, 1))
        sensors.reset(actual)
        found = []
        for k in range(1, 2001):
            actual[0], actual[1] = speed * step * k, speed
            found.append(sensors.measure(actual)[1, 0])
        rest = np.array(found[500:])
        assert rest.mean() == pytest.approx(speed, rel=0.01)
        spreads.append(np.ptp(rest))
    assert spreads[0] == pytest.approx(grid / step)  # one step of the encoder, or none
    assert spreads[1] < 0.1 * spreads[0]


def test_differentiated_velocities_have_their_own_faults() -> None:
    sensors = Sensors(1, velocity_filter=np.array([1e5]), timestep=1e-3)
    actual = np.zeros((3, 1))
    sensors.reset(actual)

    def read(k: int) -> float:
        actual[0] = 1e-3 * k
        return float(sensors.measure(actual)[1, 0])

    assert read(1) == pytest.approx(1.0)
    sensors.change("velocities", gain=2.0, bias=0.5)
    assert read(2) == pytest.approx(2.5)
    sensors.change("velocities", resolution=2.0)
    assert read(3) == pytest.approx(2.0)
    sensors.kill("velocities", 0)
    assert read(4) == 0.0
    sensors.repair()
    assert read(5) == pytest.approx(1.0)
    with raises_with(key="timestep", found=0.0, expected="more than 0"):
        Sensors(1, velocity_filter=np.array([1.0]))
