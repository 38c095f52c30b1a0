"""Target motions: end points, limits, continuity, derivatives, and errors."""

from __future__ import annotations

import re
import tomllib
from typing import Any

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.simulate.control.plan import target_motion_from, target_motion_kinds
from sero_mj.simulate.control.target_motions import (
    Chirp,
    Constant,
    JointTargetMotion,
    Motion,
    Recorded,
    Sine,
    Step,
    quintic,
)
from sero_mj.simulate.control.way_points import (
    WayPoints,
    quintic_duration,
    trapezoid,
    trapezoid_blend,
    trapezoid_duration,
)

Array = NDArray[np.float64]
SPEEDS = np.array([1.0, 2.0, 0.5])
RATES = np.array([4.0, 3.0, 5.0])


def arm(**fields: Any) -> SerialRobot:
    table: dict[str, Any] = {
        "name": "arm",
        "dh_convention": "craig",
        "dh_params": [[0.0, 0.0, 0.0, 0.3]] * 3,
        "joint_types": ["revolute", "revolute", "prismatic"],
        "position_limits": [[-2.0, 2.0], [-1.5, 1.5], [-0.4, 0.6]],
        "velocity_limits": SPEEDS,
        "acceleration_limits": RATES,
        "joint_names": ["A", "B", "C"],
    }
    return SerialRobot(**{**table, **fields})


ARM = arm()
ZERO = np.zeros(3)
grids = st.integers(100, 3000).map(lambda n: np.linspace(-0.5, 12.0, n))
positive = st.floats(0.05, 20.0)


def by_differences(motion: Motion, tolerance: float, jumps: int = 0) -> None:
    """Asserts that velocities and accelerations are finite differences."""
    t = motion.times
    for values, slopes in (
        (motion.angles, motion.velocities),
        (motion.velocities, motion.accelerations),
    ):
        middle = (slopes[1:] + slopes[:-1]) / 2
        off = np.abs(np.diff(values, axis=0) / np.diff(t)[:, None] - middle).max(axis=1)
        assert np.sort(off)[: len(off) - jumps].max() < tolerance


@given(positive)
def test_quintic_starts_and_ends_at_rest_without_acceleration(duration: float) -> None:
    for t, way in ((-1.0, 0.0), (0.0, 0.0), (duration, 1.0), (duration + 1.0, 1.0)):
        np.testing.assert_allclose(quintic(np.array([t]), duration), [[way], [0], [0]], atol=1e-12)
    times = np.linspace(0, duration, 2001)
    way, speed, rate = quintic(times, duration)
    assert (np.diff(way) >= 0).all()
    assert speed.max() == pytest.approx(15 / 8 / duration, rel=1e-5)
    assert np.abs(rate).max() == pytest.approx(10 / 3**0.5 / duration**2, rel=1e-5)
    np.testing.assert_allclose(np.gradient(way, times)[2:-2], speed[2:-2], atol=1e-4 / duration)


@given(positive, positive)
def test_shortest_durations_reach_one_limit_and_respect_both(speed: float, rate: float) -> None:
    duration = quintic_duration(speed, rate)
    times = np.linspace(0, duration, 4001)
    _, ds, dds = quintic(times, duration)
    used = ds.max() / speed, np.abs(dds).max() / rate
    assert max(used) == pytest.approx(1.0, rel=1e-4)
    duration, blend = trapezoid_duration(speed, rate)
    times = np.linspace(0, duration, 4001)
    way, ds, dds = trapezoid(times, duration, blend)
    assert np.abs(dds).max() == pytest.approx(rate)
    assert ds.max() <= speed * (1 + 1e-9)
    assert way[-1] == pytest.approx(1.0)
    assert duration < quintic_duration(speed, rate)


@given(positive, st.floats(1.0, 50.0))
def test_trapezoid_takes_the_requested_duration(duration: float, more: float) -> None:
    rate = 4.0 / duration**2 * more
    blend = trapezoid_blend(duration, rate)
    assert 0 < blend <= duration / 2 * (1 + 1e-9)
    way, speed, dds = trapezoid(np.linspace(0, duration, 1001), duration, blend)
    assert np.abs(dds).max() == pytest.approx(rate, rel=1e-6)
    assert (way[0], way[-1], speed[0], speed[-1]) == (0.0, 1.0, 0.0, 0.0)
    assert way[500] == pytest.approx(0.5)
    with pytest.raises(ValueError, match="times its acceleration limit"):
        trapezoid_blend(duration, rate / more / 1.5)


@settings(deadline=None, max_examples=examples(40))
@given(
    st.lists(st.tuples(*[st.floats(-0.4, 0.6)] * 3), min_size=1, max_size=4),
    st.sampled_from(["quintic", "trapezoidal"]),
    st.floats(0.1, 1.0),
    st.floats(0.0, 0.5),
)
def test_way_points_at_speed_respect_all_limits_and_reach_all_points(
    points: list[tuple[float, ...]], law: str, speed: float, dwell: float
) -> None:
    declared = WayPoints(
        way_points=[list(p) for p in points], speed=speed, time_law=law, dwell=dwell
    )
    times = np.arange(0.0, 160.0, 0.02)
    motion = declared.sample(times, ARM, ZERO)
    assert (np.abs(motion.velocities) <= speed * SPEEDS * (1 + 1e-9)).all()
    assert (np.abs(motion.accelerations) <= RATES * (1 + 1e-9)).all()
    np.testing.assert_allclose(motion.angles[0], 0, atol=1e-12)
    np.testing.assert_allclose(motion.angles[-1], points[-1], atol=1e-12)
    assert not motion.velocities[-1].any()
    for point in points:
        assert np.abs(motion.angles - point).max(axis=1).min() < 0.02
    assert np.abs(np.diff(motion.angles, axis=0)).max() <= 0.02 * SPEEDS.max() + 1e-12


@pytest.mark.parametrize("law", ["quintic", "trapezoidal"])
def test_way_points_at_times_are_reached_on_time_on_straight_lines(law: str) -> None:
    points = np.array([[1.0, -0.5, 0.1], [1.0, 1.0, -0.3], [0.0, 0.0, 0.0]])
    declared = WayPoints(way_points=points, times=[2.0, 5.0, 9.0], time_law=law)
    motion = declared.sample(np.arange(0.0, 10.0, 1e-3), ARM, np.array([0.2, 0.0, 0.0]))
    for t, point in zip([2000, 5000, 9000], points, strict=True):
        np.testing.assert_allclose(motion.angles[t], point, atol=1e-9)
        np.testing.assert_allclose(motion.velocities[t], 0, atol=1e-9)
    # Joints share one path: B of the second line is a linear function of C.
    part = motion.angles[2000:5000]
    np.testing.assert_allclose((part[:, 1] + 0.5) / 1.5, (part[:, 2] - 0.1) / -0.4, atol=1e-9)
    by_differences(motion, 5e-3, jumps=0 if law == "quintic" else 13)


def test_first_time_of_zero_sets_the_start() -> None:
    declared = WayPoints(way_points=[[0.5, 0, 0], [1, 0, 0]], times=[0.0, 4.0])
    motion = declared.sample(np.array([0.0, 2.0, 4.0]), ARM, ZERO)
    np.testing.assert_allclose(motion.angles[:, 0], [0.5, 0.75, 1.0])
    single = WayPoints(way_points=[[0.5, 0, 0]], times=[0.0]).sample(np.arange(3.0), ARM, ZERO)
    np.testing.assert_array_equal(single.angles[:, 0], [0.5] * 3)


def test_degrees_are_converted_to_radians() -> None:
    declared = WayPoints(way_points_deg=[[90.0, 45.0, 0.0]], times=[4.0])
    assert declared.way_points is not None
    np.testing.assert_allclose(declared.way_points, [[np.pi / 2, np.pi / 4, 0]])
    with raises_with(reason="found both way_points and way_points_deg; expected one of them"):
        WayPoints(way_points_deg=[[1.0]], way_points=[[1.0]], times=[4.0])


@settings(deadline=None)
@given(st.floats(0.0, 0.3), st.floats(0.05, 0.2), st.floats(-3, 3), st.floats(0.5, 3.0))
def test_sines_and_chirps_start_at_rest_with_consistent_derivatives(
    amplitude: float, frequency: float, phase: float, ramp: float
) -> None:
    times = np.arange(0.0, 8.0, 1e-3)
    sine = Sine(amplitude=amplitude, frequency=[frequency, 0.1, 0.1], phase=phase, ramp=ramp)
    chirp = Chirp(amplitude=amplitude, end_frequency=frequency, duration=7.0, ramp=ramp)
    for law in (sine, chirp):
        motion = law.motion(times, ARM, ZERO)
        by_differences(motion, 5e-2)
        assert not motion.angles[0].any()
        assert not motion.velocities[0].any()
        assert np.abs(motion.angles).max() <= amplitude * (1 + 1e-12)
    assert not motion.velocities[-1].any()  # the chirp has ended
    assert np.abs(motion.angles[-1]).max() < 1e-12


def test_sine_after_its_ramp_is_the_declared_sine() -> None:
    sine = Sine(amplitude_deg=[10.0, 5.0, 1.0], frequency=0.25, ramp=1.0)
    motion = sine.sample(np.array([2.0, 3.0, 5.0]), ARM, ZERO)
    np.testing.assert_allclose(motion.angles[:, 0], np.deg2rad([0, -10, 10]), atol=1e-12)


def test_steps_and_constants_have_the_declared_values() -> None:
    times = np.array([0.0, 0.999, 1.0, 1.5, 2.0])
    step = Step(amplitude=[0.1, 0.0, 0.0], time=1.0, duration=1.0).sample(times, ARM, ZERO + 0.1)
    np.testing.assert_allclose(step.angles[:, 0], [0.1, 0.1, 0.2, 0.2, 0.1])
    assert not step.velocities.any()
    still = Constant().sample(times, ARM, np.array([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(still.angles, np.tile([0.1, 0.2, 0.3], (5, 1)))
    there = Constant(angles_deg=30.0).motion(times, ARM, ZERO)
    np.testing.assert_allclose(there.angles, np.pi / 6)


def test_recorded_motion_passes_its_rows_smoothly() -> None:
    knots = np.linspace(1.0, 5.0, 60)
    rows = 0.3 * np.sin(knots[:, None] * [1.0, 1.5, 0.5])
    law = Recorded(times=knots, angles=rows)
    np.testing.assert_allclose(law.sample(knots, ARM, ZERO).angles, rows, atol=1e-12)
    fine = np.arange(0.0, 6.0, 1e-3)
    motion = law.sample(fine, ARM, ZERO)
    by_differences(motion, 5e-2, jumps=130)
    inside = (fine > 1.2) & (fine < 4.8)
    expected = 0.3 * np.sin(fine[inside, None] * [1.0, 1.5, 0.5])
    np.testing.assert_allclose(motion.angles[inside], expected, atol=2e-4)
    np.testing.assert_array_equal(motion.angles[0], rows[0])
    np.testing.assert_allclose(motion.angles[-1], rows[-1])
    assert not motion.velocities[fine > 5.0].any()


def refusal(law: Any, robot: SerialRobot = ARM, start: Array = ZERO) -> str:
    with pytest.raises(DeclarationError) as error:
        target_motion_from(law).sample(np.arange(0.0, 10.0, 1e-3), robot, start)
    return str(error.value)


def test_targets_beyond_limits_name_joint_and_time() -> None:
    law = {"kind": "way_points", "way_points": [[2.5, 0, 0.7]], "times": [5.0]}
    first, second = refusal(law).splitlines()
    assert re.match(
        r"the target of joint A is 143\.239 deg at t = 5\.\d+ s; expected -114\.6 to 114\.6 deg$",
        first,
    )
    assert re.match(
        r"the target of joint C is 0\.7 m at t = 5\.\d+ s; expected -0.4 to 0.6 m$", second
    )
    law = {"kind": "way_points", "way_points": [[1.5, 0, 0]], "times": [1.0]}
    assert re.match(
        r"the target velocity of joint A is 161\.\d+ deg/s at t = 0\.5\d* s; "
        r"expected up to 57\.3 deg/s$",
        refusal(law),
    )
    swing = {"kind": "sine", "amplitude": [0, 0, 0.3], "frequency": 1.0}
    assert refusal(swing).endswith("is 1.88496 m/s at t = 1.000 s; expected up to 0.5 m/s")


@pytest.mark.parametrize(
    ("law", "problem"),
    [
        (
            {"kind": "way_points"},
            Problem(reason="found neither; expected exactly one of `times` and `speed`"),
        ),
        (
            {"kind": "way_points", "speed": 0.5},
            Problem("way_points", "is required; expected way_points or way_points_deg"),
        ),
        (
            {"kind": "way_points", "way_points": [[1, 2]], "speed": 0.5},
            Problem("way_points", "found rows of 2 angles; expected 3, one per joint"),
        ),
        (
            {"kind": "way_points", "way_points": [[1, 1, 0]], "times": [1, 2]},
            Problem("times", found=2, of="entries", expected="1, one per way point"),
        ),
        (
            {"kind": "way_points", "way_points": [[1, 1, 0]] * 2, "times": [2, 2]},
            Problem("times", found=[2.0, 2.0], expected="ascending times"),
        ),
        (
            {"kind": "way_points", "way_points": [[1, 1, 0]], "times": [-1]},
            Problem("times", found=[-1.0], expected="times of at least 0 s"),
        ),
        (
            {
                "kind": "way_points",
                "way_points": [[1, 1, 0]],
                "times": [1.0],
                "time_law": "trapezoidal",
            },
            Problem(
                "times",
                "joint B is too slow to arrive at t = 1.000 s: it would need 1.33 times "
                "its acceleration limit; allow more time",
            ),
        ),
        (
            {"kind": "sine", "frequency": 1},
            Problem("amplitude", "is required; expected amplitude or amplitude_deg"),
        ),
        ({"kind": "sine", "amplitude": 1}, Problem("frequency", "is required")),
        (
            {"kind": "sine", "amplitude": 1, "frequency": -1},
            Problem("frequency", found=-1.0, expected="0 to 1000 Hz"),
        ),
        (
            {"kind": "step", "amplitude": [1, 2]},
            Problem(
                "amplitude", found=2, of="entries", expected="3 (one per joint) or 1 (for all)"
            ),
        ),
        (
            {"kind": "wave"},
            Problem(
                "kind",
                "no kind",
                found="wave",
                available=[
                    "cartesian_constant",
                    "cartesian_way_points",
                    "chirp",
                    "constant",
                    "recorded",
                    "sine",
                    "step",
                    "way_points",
                ],
            ),
        ),
        (
            {"kind": "recorded", "times": [0, 0]},
            Problem("times", "entry 2 is 0 s; expected more than 0 s"),
        ),
        (
            {"kind": "recorded", "times": [0, 1], "angles": [[0, 0, 0]]},
            Problem("angles", found=1, of="rows", expected="2, one per time"),
        ),
        (
            {"kind": "chirp", "amplitude": 0.1, "end_frequency": 1, "duration": 1},
            Problem("ramp", found=1.0, of="s", expected="at most half the duration"),
        ),
        ({"kind": "constant", "angle": 1}, Problem("angle", "unknown key", available=["angles"])),
    ],
)
def test_invalid_target_motions_are_rejected(law: Any, problem: Problem) -> None:
    with pytest.raises(DeclarationError) as caught:
        target_motion_from(law).sample(np.arange(0.0, 10.0, 1e-3), ARM, ZERO)
    assert caught.value.problems == [problem]


def test_robot_without_limits_requires_times_or_accelerations() -> None:
    law = {"kind": "way_points", "way_points": [[1, 1, 0]], "speed": 0.5}
    bare = arm(velocity_limits=None)
    assert (
        refusal(law, bare)
        == "speed: robot 'arm' has no velocity_limits; expected times instead of speed"
    )
    bare = arm(acceleration_limits=None)
    message = (
        "speed: robot 'arm' has no acceleration_limits; expected accelerations in addition to speed"
    )
    assert refusal(law, bare) == message
    target_motion_from({**law, "accelerations": 2.0}).sample(np.arange(3.0), bare, ZERO)


def test_every_kind_of_target_motion_is_made_from_a_table() -> None:
    tables = tomllib.loads("""
    rest = { kind = "constant" }
    go = { kind = "way_points", way_points_deg = [[10, 20, 0], [0, 0, 0]], speed = 0.3 }
    swing = { kind = "sine", amplitude_deg = 5, frequency = 0.2 }
    sweep = { kind = "chirp", amplitude_deg = 1, end_frequency = 2, duration = 8 }
    jump = { kind = "step", amplitude_deg = [5, 0, 0], time = 1 }
    again = { kind = "recorded", times = [0, 1, 2], angles_deg = [[0, 0, 0], [1, 1, 0], [0, 0, 0]] }
    """)
    assert {table["kind"] for table in tables.values()} == {
        kind for kind, law in target_motion_kinds().items() if issubclass(law, JointTargetMotion)
    }
    for table in tables.values():
        law = target_motion_from(table)
        motion = law.sample(np.arange(0, 10, 1e-2), ARM, ZERO)
        assert motion.angles.shape == motion.accelerations.shape == (1000, 3)
        assert np.isfinite(motion.accelerations).all()
