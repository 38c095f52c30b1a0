"""Expectations on a run: their joints and robots, their signs, and what is rejected."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from runs import sine_run

from sero_mj.base.errors import DeclarationError
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.expect import Expect, Outcome
from sero_mj.simulate.runs.measures import MEASURES, PER_JOINT
from sero_mj.simulate.runs.monitor import Monitor
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation

LEFT = SerialRobot.from_model("lwr", name="left")
RIGHT = SerialRobot.from_model(
    "lwr", name="right", joint_angles=[0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]
)


def judged(values: dict[str, list[list[float]]], **fields: Any) -> Outcome:
    """Judges rows of joint velocities; joints without a value do not move."""
    log = log_of(values)
    expect = Expect(**{"measure": "velocity", **fields})
    return expect.judge("it", log, [], None)  # type: ignore[arg-type]


def log_of(values: dict[str, list[list[float]]]) -> RunLog:
    robots = {"left": LEFT, "right": RIGHT}
    signals = {}
    for name, rows in values.items():
        padded = np.zeros((len(rows), 7))
        padded[:, : len(rows[0])] = rows
        signals[f"{name}_joint_velocities"] = padded
    times = 0.1 * np.arange(len(next(iter(values.values()))))
    return RunLog({name: robots[name] for name in values}, signals, times)


# 7 joints each; joints without a value do not move.
ONE_EACH = {"left": [[0.0], [0.5]], "right": [[0.0, 0.0], [0.0, -0.7]]}
ONE_ONLY = {"left": [[0.0], [0.0]], "right": [[0.0], [0.6]]}
EVERY = {"left": [[0.5] * 7, [0.6] * 7], "right": [[0.5] * 7, [-0.7] * 7]}


@pytest.mark.parametrize(
    ("values", "all_of_them", "any_of_them", "each_robot"),
    [(ONE_EACH, False, True, True), (ONE_ONLY, False, True, False), (EVERY, True, True, True)],
)
def test_above_holds_at_all_joints_at_any_or_at_one_of_each_robot(
    values: dict[str, list[list[float]]], all_of_them: bool, any_of_them: bool, each_robot: bool
) -> None:
    found = [judged(values, above=0.4, holds_at=at).holds for at in ("all", "any", "each_robot")]
    assert found == [all_of_them, any_of_them, each_robot]


def test_below_holds_at_all_joints_by_default() -> None:
    assert not judged(ONE_ONLY, below=0.4).holds
    assert not judged(ONE_ONLY, below=0.4, holds_at="all").holds
    assert judged(ONE_ONLY, below=0.4, holds_at="any").holds
    assert not judged(EVERY, below=0.4, holds_at="any").holds


def test_both_bounds_hold_at_the_same_joint() -> None:
    fast_and_slow = {"left": [[0.0, 2.0], [0.1, 2.0]]}
    assert not judged(fast_and_slow, above=0.5, below=1.5, holds_at="any").holds
    assert judged({"left": [[1.0, 2.0]]}, above=0.5, below=1.5, holds_at="any").holds
    assert not judged({"left": [[1.0, 2.0]]}, above=0.5, below=1.5, holds_at="all").holds


def test_outcome_names_the_deciding_value_and_joint() -> None:
    assert judged(ONE_EACH, below=0.4).text == "velocity 0.7 rad/s at right/A2, expected below 0.4"
    assert judged(ONE_EACH, above=0.6, holds_at="each_robot").text == (
        "velocity 0.5 rad/s at left/A1, expected above 0.6 at one joint of each robot"
    )
    found = judged(ONE_ONLY, above=0.7, holds_at="any")
    assert (found.value, found.holds) == (0.6, False)
    assert found.text.endswith("at right/A1, expected above 0.7 at one joint at least")


def test_prismatic_joints_have_newtons_and_meters() -> None:
    log = sine_run(amplitude=30.0)
    angles = log.of("arm", "joint_angles")
    log.signals["arm_joint_velocities"] = np.gradient(angles, log.times, axis=0)
    for measure, value in (("torque_error", "30 N"), ("velocity", "0.1 m/s")):
        expect = Expect(measure=measure, joints=["slide"], below=1.0)
        said = expect.judge("it", log, [], None)  # type: ignore[arg-type]
        assert f"{value} at arm/slide" in said.text
    found = {finding.joint: str(finding) for finding in Monitor().find(log)}
    assert found["turn"].endswith("Nm, above 1.5 Nm") and found["slide"].endswith("N, above 15 N")


@pytest.mark.parametrize(
    ("of", "value"), [("max", 0.2), ("min", -0.8), ("mean", -0.2), ("final", -0.8)]
)
def test_signed_values_keep_their_sign(of: str, value: float) -> None:
    values = {"left": [[0.2], [0.0], [-0.8]]}
    found = judged(values, joints=["A1"], signed=True, of=of, below=value + 0.01,
                   above=value - 0.01)  # fmt: skip
    assert found.holds and found.value == pytest.approx(value)
    assert judged(values, joints=["A1"], of=of, above=0.01).value >= 0.0 or of == "min"


def test_unknown_value_does_not_hold() -> None:
    for at in ("all", "any"):
        assert not judged({"left": [[np.nan] * 7]}, below=1.0, holds_at=at).holds
    assert judged({"left": [[np.nan, 0.1]]}, below=1.0, holds_at="any").holds


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"below": -0.1}, "below: found -0.1"),
        ({"below": 0.0}, "below: found 0"),
        ({"above": -1.0}, "above: found -1"),
        ({"measure": "flange_error", "below": -1.0}, "below: found -1"),
        ({"measure": "flange_error", "below": 1.0, "signed": True}, "`signed` requires "),
        ({"below": 1.0, "signed": True, "of": "rms"}, 'signed: `of` is "rms"'),
        ({"measure": "flange_error", "below": 1.0, "joints": ["A1"]}, "remove `joints`"),
        ({"measure": None, "finds": "any", "signed": True}, "`signed` requires "),
        ({"measure": None, "finds_nothing": "any", "holds_at": "all"}, "`holds_at` requires "),
        ({"above": 1.0, "holds_at": "some"}, "holds_at: found 'some'"),
    ],
)
def test_contradicting_fields_are_reported(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        Expect(**{"measure": "velocity", **fields})
    assert message in str(caught.value)


def scenario(**expect: Any) -> Scenario:
    return Scenario(
        Scene(robots=[LEFT, RIGHT]), expect={"it": expect}, duration=0.01,
        controllers={name: {"kind": "joint_position"} for name in ("left", "right")},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("expect", "message"),
    [
        ({"measure": "drift"}, "14 joints"),
        ({"measure": "drift", "robot": "left", "joints": ["A1", "A2"]}, "2 joints"),
        ({"measure": "flange_error"}, "2 robots"),
    ],
)
def test_above_requires_holds_at_for_several_joints(expect: dict[str, Any], message: str) -> None:
    with pytest.raises(DeclarationError) as caught:
        scenario(**expect, above=0.1)
    assert message in str(caught.value)
    scenario(**expect, below=0.1)
    scenario(**expect, above=0.1, holds_at="any")


def test_above_needs_no_holds_at_for_one_joint() -> None:
    scenario(measure="drift", robot="left", joints=["A1"], above=0.1)
    scenario(measure="flange_error", robot="left", above=0.1)


def test_every_measure_has_the_declared_number_of_columns() -> None:
    simulation = Simulation(scenario(measure="drift", below=1.0))
    simulation.advance(3)
    for name in MEASURES.keys() - {"height", "displacement", "tilt"}:
        found = MEASURES[name][1](simulation.log, "right")
        assert found.shape == (4, 7 if name in PER_JOINT else 1), name


def test_flange_travel_equals_the_numpy_result() -> None:
    simulation = Simulation(scenario(measure="flange_travel", below=1.0))
    at = [0.3, -0.2, 0.1, 0.5, 0.0, 0.4, 0.2]
    simulation.rows[3, simulation.layout.columns["right_actual_angles"]] = at
    simulation.step = 3
    found = MEASURES["flange_travel"][1](simulation.log, "right")[3, 0]
    ends = [RIGHT.fwd_kin_base_to_flange(np.array(q))[:3, 3] for q in (RIGHT.home, at)]
    assert found == pytest.approx(np.linalg.norm(ends[1] - ends[0]), abs=1e-12)
    for k, axis in enumerate("xyz"):
        place = MEASURES[f"flange_{axis}"][1](simulation.log, "right")[3, 0]
        assert place == pytest.approx(ends[1][k], abs=1e-12)


@pytest.mark.parametrize(
    ("fields", "share"),
    [
        ({"below": 1.0}, 0.5),  # of the fastest joint, 2 rad/s
        ({"below": 4.0}, 1.0),
        ({"of": "min", "above": 1.0, "holds_at": "any"}, 1.0),
        ({"of": "min", "above": 4.0, "holds_at": "any"}, 0.5),
        ({"of": "min", "above": 1.0, "holds_at": "all"}, 0.0),  # the others do not move
        ({"of": "min", "above": 1.0, "holds_at": "each_robot"}, 0.5),
        ({"above": 4.0, "holds_at": "any"}, 1.0),  # at any time, not only now
        ({"signed": True, "joints": ["A1"], "robot": "left", "below": -1.0}, 0.25),
    ],
)
def test_reward_share_is_evaluated_at_the_same_joints(fields: dict[str, Any], share: float) -> None:
    log = log_of({"left": [[0.0], [2.0]], "right": [[0.0], [0.5]]})
    assert Expect(**{"measure": "velocity", **fields}).share(log) == pytest.approx(share)
