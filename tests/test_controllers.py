"""Controllers by name, from tables as in files, and user-defined ones."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from numpy.typing import NDArray
from simulated import START, lwr_model, lwr_robot

from sero_mj.base.errors import DeclarationError, Problem, SimulationError
from sero_mj.simulate.control.controller import Sensed, Target
from sero_mj.simulate.control.joint_control import JointImpedance, Torque
from sero_mj.simulate.control.make_controller import (
    controller_from,
    controller_kinds,
    make_controller,
)

Array = NDArray[np.float64]
MODEL = lwr_model()
LIMITS = lwr_robot().torque_limits
TABLES = """
[soft]
kind = "joint_impedance"
stiffness = [2000, 2000, 1000, 1000, 500, 200, 200]
damping = 0.7
torque_rate_limits = 1000
[stiff]
kind = "joint_position"
[hand]
kind = "gravity_compensation"
damping = 0.5
[contact]
kind = "cartesian_impedance"
stiffness = [2000, 2000, 500, 200, 200, 200]
[feed]
kind = "torque"
"""


def at_start() -> tuple[Sensed, Target]:
    sensed, target = Sensed(7), Target(7)
    sensed.angles[:] = target.angles[:] = target.posture[:] = START
    MODEL.update(START, np.zeros(7))
    target.pose[:] = MODEL.flange()
    return sensed, target


def test_every_kind_is_made_from_a_table_and_holds_the_robot_at_its_target() -> None:
    tables = tomllib.loads(TABLES)
    # These have their own tests.
    external = {"library", "udp", "shm", "fmu", "fri", "rtde", "franka", "ros2"}
    assert {table["kind"] for table in tables.values()} == set(controller_kinds()) - external
    sensed, target = at_start()
    for table in tables.values():
        declared = controller_from(table)
        assert type(declared) is controller_kinds()[table["kind"]]
        assert declared.kind == table["kind"]  # type: ignore[attr-defined]
        assert controller_from(declared) is declared
        control = make_controller(declared, MODEL, 1e-3, LIMITS)
        out = np.zeros(7)
        control.torques(sensed, target, out)
        np.testing.assert_allclose(out, MODEL.gravity(), atol=1e-9)
        assert not control.saturated.any()


def test_joint_space_controllers_allocate_no_arrays() -> None:
    import tracemalloc

    sensed, target = at_start()
    for table in tomllib.loads(TABLES).values():
        if table["kind"] in ("cartesian_impedance", "torque"):
            continue
        control, out = make_controller(controller_from(table), MODEL, 1e-3, LIMITS), np.zeros(7)
        for _ in range(3):
            control.torques(sensed, target, out)
        tracemalloc.start()
        before = tracemalloc.get_traced_memory()[1]
        for _ in range(20):
            control.torques(sensed, target, out)
        grown = tracemalloc.get_traced_memory()[1] - before
        tracemalloc.stop()
        assert grown < 2000, table["kind"]


KINDS = [
    "cartesian_impedance", "gravity_compensation", "joint_impedance", "joint_position", "torque",
    "library", "udp", "shm", "fri", "rtde", "fmu", "franka", "ros2",
]  # fmt: skip


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        pytest.param(
            {},
            Problem(
                "kind",
                "is required",
                expected="'gravity_compensation', 'joint_impedance', 'cartesian_impedance', "
                "'joint_position', 'torque', 'library', 'udp', 'shm', 'fri', 'rtde', 'fmu', "
                "'franka' or 'ros2'",
            ),
            marks=pytest.mark.extensions,
        ),
        (
            {"kind": "joint_impedence"},
            Problem("kind", "no kind", found="joint_impedence", available=["joint_impedance"]),
        ),
        pytest.param(
            {"kind": 3},
            Problem("kind", "no kind", found=3, available=KINDS),
            marks=pytest.mark.extensions,
        ),
        (3, Problem(found=3, expected="a table with `kind`")),
        (
            {"kind": "torque", "stiffness": 1},
            Problem("stiffness", "unknown key", available=Torque.model_fields),
        ),
    ],
)
def test_invalid_controller_table_is_rejected(table: Any, problem: Problem) -> None:
    with pytest.raises(DeclarationError) as caught:
        controller_from(table)
    assert caught.value.problems == [problem]


def test_declared_torque_limits_lower_those_of_the_robot() -> None:
    sensed, target = at_start()
    target.angles += 1.0
    control = make_controller(
        JointImpedance(stiffness=2000.0, torque_limits=30.0), MODEL, 1e-3, LIMITS
    )
    out = np.zeros(7)
    control.torques(sensed, target, out)
    assert np.abs(out).max() == 30.0
    assert control.saturated.any()
    with pytest.raises(DeclarationError) as error:
        make_controller(JointImpedance(stiffness=1.0, torque_limits=100.0), MODEL, 1e-3, LIMITS)
    expected = "up to 38, the limit of the robot"
    assert error.value.problems == [
        Problem("torque_limits", f"joint {name} has", found=100.0, expected=expected)
        for name in ("A5", "A6")
    ]
    zero = JointImpedance(stiffness=1.0, torque_limits=[1, 1, 0, 1, 1, 1, 1])
    with raises_with(
        key="torque_limits", reason="joint E1 has", found=0, expected="a positive number of Nm"
    ):
        make_controller(zero, MODEL, 1e-3, LIMITS)


def test_sensed_can_use_an_existing_array() -> None:
    values = np.zeros((3, 2))
    sensed = Sensed(2, values)
    values[:] = [[1, 2], [3, 4], [5, 6]]
    assert sensed.state.tolist() == [1, 2, 3, 4]
    assert (sensed.angles.tolist(), sensed.velocities.tolist()) == ([1, 2], [3, 4])
    assert sensed.torques.tolist() == [5, 6]
    message = r"^found \(3, 2\) float64 with gaps; expected \(3, 2\) float64 without gaps$"
    with pytest.raises(ValueError, match=message):
        Sensed(2, np.zeros((3, 4))[:, ::2])
    with pytest.raises(ValueError, match=r"^found \(2, 2\)"):
        Sensed(2, np.zeros((2, 2)))


def test_gains_are_checked_against_the_limits_except_for_user_controllers() -> None:
    stiff = make_controller(controller_from({"kind": "joint_position"}), MODEL, 0.02, LIMITS)
    with raises_with(
        key="stiffness",
        reason="joint A5 is unstable at 10000 Nm/rad with a time step of",
        found=20.0,
        of="ms",
        expected="up to 667 and 6.7 % of the other stiffnesses, or a shorter time step",
    ):
        stiff.check(START)
    make_controller(Wave(), MODEL, 0.02, LIMITS).check(START)


@pytest.mark.parametrize("kind", ["joint_impedance", "cartesian_impedance", "joint_position"])
def test_sensor_value_that_is_not_a_number_is_reported_with_its_joint(kind: str) -> None:
    table = {"kind": kind, "stiffness": 9.0} if kind == "joint_impedance" else {"kind": kind}
    for when, (row, what) in enumerate([(0, "angle"), (1, "velocity")]):
        control = make_controller(controller_from(table), MODEL, 1e-3, LIMITS)
        sensed, target = at_start()
        if when:  # after the damping was designed
            control.torques(sensed, target, np.zeros(7))
        sensed.values[row, 4] = np.nan
        reason = f"the controller received a {what} of nan; expected a finite number"
        told = {"reason": reason, "found": math.nan, "of": "", "expected": "a finite number"}
        with raises_with(SimulationError, time=0.0, joint="lwr/A4", **told):
            control.torques(sensed, target, np.zeros(7))


class Wave:
    """A user-defined controller."""

    def torques(self, sensed: Sensed, target: Target, out: Array) -> None:
        out[:] = 5.0 * np.sin(sensed.time)
        if sensed.time > 2.0:
            out[3] = np.nan


def test_user_controller_is_limited_and_monitored() -> None:
    control = make_controller(Wave(), MODEL, 1e-3, LIMITS)
    sensed, target = at_start()
    sensed.time = 1.0
    out = np.zeros(7)
    control.torques(sensed, target, out)
    assert out[0] == 5.0 * np.sin(1.0)
    sensed.time = 2.5
    with raises_with(
        SimulationError,
        time=2.5,
        joint="lwr/A3",
        reason="the controller requested nan Nm; expected a finite number",
        found=math.nan,
        of="Nm",
        expected="a finite number",
    ):
        control.torques(sensed, target, out)
    with pytest.raises(DeclarationError, match=r"with a method torques\(sensed, target, out\)"):
        make_controller(object(), MODEL, 1e-3, LIMITS)  # type: ignore[arg-type]
