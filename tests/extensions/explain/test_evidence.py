"""Evidence of explanations: rows, residuals, quantities, and the next experiment."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from explain_runs import BEGIN, swing

from sero_mj.base.errors import UsageError
from sero_mj.extensions.explain.explain import TorqueExplainer, explain, explain_run
from sero_mj.extensions.explain.next_motion import _NEXT
from sero_mj.extensions.explain.torque_residuals import (
    TorqueResiduals,
    pair_with_model,
    torque_residuals,
)
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.study import plot
from sero_mj.study.compare import as_json, compare, next_lines
from sero_mj.study.evidence import Evidence, count_left_out
from sero_mj.study.explanation import Explanation, Kind
from sero_mj.study.explanation_marks import marks_of_explanations
from sero_mj.study.plot import plot_pair
from sero_mj.study.verdict_report import write_markdown

FRICTION = json.dumps({"kind": "friction", "added_coulomb": 1.5, "joints": ["A2"]})


@pytest.fixture(scope="module")
def sound() -> TorqueResiduals:
    return torque_residuals(swing(), "lwr")


@pytest.fixture(scope="module")
def friction() -> Explanation:
    (found,) = explain_run(swing(FRICTION), "lwr")
    return found


def evidence_of(explanation: Explanation) -> Evidence:
    assert explanation.evidence is not None
    return explanation.evidence


def test_residuals_before_and_after_differ_by_the_friction(friction: Explanation) -> None:
    found = evidence_of(friction)
    assert (found.joint, found.side, found.torque_unit) == ("A2", "drive", "Nm")
    acts = found.times > BEGIN + 0.1
    known = np.isfinite(found.before)
    expected = 1.5 * np.sign(found.values)  # Coulomb friction over the velocity
    np.testing.assert_allclose(found.before[acts & known], expected[acts & known], atol=0.05)
    assert np.abs(found.after[acts & known]).max() < 0.05
    early = known & (found.times < BEGIN - 0.1)
    np.testing.assert_allclose(found.before[early], found.after[early], atol=1e-9)
    assert (found.quantity, found.unit) == ("velocity", "deg/s")
    velocities = np.gradient(np.degrees(swing(FRICTION).of("lwr", "joint_angles")[:, 1]), 1e-3)
    measured = np.interp(found.times, swing(FRICTION).times, velocities)
    assert np.abs(found.values - measured).max() < 1.0
    x, y = found.fit(BEGIN, None)
    np.testing.assert_allclose(y, 1.5 * np.sign(x), atol=0.05)


def test_left_out_rows_and_used_rows_are_all_rows(friction: Explanation) -> None:
    found = evidence_of(friction)
    assert set(found.left_out) == {"at rest", "reversing"}
    assert found.used + sum(found.left_out.values()) == len(found.times)
    slow = np.abs(found.values) < 1.0  # deg/s
    assert np.isnan(found.before[slow]).all()


def test_first_reason_counts() -> None:
    unknown = np.array([True, True, True, False])
    reasons = {
        "gap": np.array([True, False, False, True]),
        "slow": np.array([True, True, False, True]),
    }
    assert count_left_out(unknown, reasons) == {"gap": 1, "slow": 1, "other verdict": 1}


def test_quantity_explains_the_residual(sound: TorqueResiduals) -> None:
    commanded, angles = sound.torques.commanded[:, 1], sound.motion.links[0][:, 1]
    bend = angles - angles.mean()
    cases: list[tuple[str, Kind, Any, str, Any]] = [
        ("motor", "gain", -0.2 * commanded, "commanded torque", commanded),
        ("link", "spring", 20.0 * bend + 90.0 * bend**2, "angle", np.degrees(angles)),
    ]
    for side, kind, torque, quantity, values in cases:
        residual = getattr(sound, side).copy()
        residual[:, 1] += torque
        first, *_ = explain(replace(sound, **{side: residual}))
        found = evidence_of(first)
        assert (first.kind, found.quantity) == (kind, quantity)
        np.testing.assert_allclose(found.values, values)
        x, y = found.fit(-1.0, None)
        order = np.argsort(values)
        np.testing.assert_allclose(y, np.interp(x, values[order], torque[order]), atol=0.3)


def test_unexplained_torque_is_the_same_after(sound: TorqueResiduals) -> None:
    link, t = sound.link.copy(), sound.times
    link[:, 1] += 6.0 * np.sin(9.0 * t) * np.exp(-9.0 * (t - 1.4) ** 2)
    first, *_ = explain(replace(sound, link=link))
    found = evidence_of(first)
    assert (first.kind, first.joint) == ("unexplained", "A2")
    np.testing.assert_array_equal(found.before, found.after)
    assert np.nanmax(np.abs(found.before)) == pytest.approx(abs(first.size), rel=1e-6)


@pytest.mark.parametrize(
    "fault",
    [
        {"kind": "frozen_sensor"},
        {"kind": "sensor", "noise": 0.6},
        {"kind": "friction", "added_coulomb": 1000},
    ],
)
def test_faults_without_a_fit_have_evidence(fault: dict[str, Any]) -> None:
    first, *_ = explain_run(swing(json.dumps({**fault, "joints": ["A2"]})), "lwr")
    found = evidence_of(first)
    assert found.joint == "A2"
    acts = found.times > BEGIN + 0.15
    before, after = (np.nanmedian(np.abs(each[acts])) for each in (found.before, found.after))
    assert after < 0.3 * before


def test_every_kind_has_a_next_experiment() -> None:
    assert set(_NEXT) == set(Kind.__args__)  # type: ignore[attr-defined]


def test_next_experiment_names_joint_and_angle(friction: Explanation) -> None:
    assert friction.next.startswith("move A2 at constant velocity in both directions, at ")
    bias = json.dumps({"kind": "sensor", "bias": -4.0, "joints": ["A3"]})
    (found,) = explain_run(swing(bias), "lwr")
    # The gravity torque of A3 depends most on the angle of A2 or A3.
    assert found.next in {
        f"hold A3 at rest without contact in two poses: move {joint} by at least 40 deg"
        for joint in ("A2", "A3")
    }
    same = [replace(found, joint=joint) for joint in ("A3", "A4")]
    assert next_lines(same) == [f"next for A3 (bias), A4 (bias): {found.next}"]
    similar = replace(found, alternatives=("payload of the flange",))
    (line,) = next_lines([similar])
    assert line == f"next for A3 (bias, or payload of the flange): {found.next}"


def test_rows_are_reported_for_one_and_for_two_runs() -> None:
    log, explainer = swing(), TorqueExplainer()
    _, _, lines = explainer.with_model(log, "lwr")
    (line,) = [each for each in lines if each.startswith("rows used: ")]
    assert "100 % on the link side; " in line and "left out: at rest " in line
    cut = {**log.signals, "lwr_torques": log.of("lwr", "torques").copy()}
    cut["lwr_torques"][500:900] = np.nan
    _, lines = explainer.of_two(log, RunLog(log.robots, cut, log.times), ("lwr", "lwr"), 0.0)
    assert any("link side (left out: gap or missing value " in each for each in lines)


def test_json_has_rows_alternatives_and_next(friction: Explanation) -> None:
    log = swing(FRICTION)
    pair = pair_with_model(log, torque_residuals(log, "lwr"))
    (found,) = as_json(pair, compare(pair), [friction])["explanations"]
    json.dumps(found)
    assert found["alternatives"] == friction.alternatives
    assert found["next"] == friction.next
    evidence = found["evidence"]
    assert evidence["rows"] == evidence["used"] + sum(evidence["left_out"].values())
    assert evidence["rms_after"] < 0.1 * evidence["rms_before"]


def test_mark_has_the_plots_of_its_joint(friction: Explanation) -> None:
    log = swing(FRICTION)
    pair = pair_with_model(log, torque_residuals(log, "lwr"))
    (mark,) = marks_of_explanations(pair, [friction])
    shown, evidence = mark.plot, evidence_of(friction)
    assert shown is not None and (mark.text, shown.joint) == ("A2: friction +1.5 Nm", "lwr/A2")
    assert mark.begin + pair.times[0] == pytest.approx(BEGIN, abs=0.03)
    assert (shown.label, shown.quantity) == ("A2, drive side [Nm]", "over velocity [deg/s]")
    assert shown.times[0] == 0.0 and len(shown.times) == len(evidence.times)
    known = [each for each in shown.before if each is not None]
    np.testing.assert_allclose(known, evidence.before[np.isfinite(evidence.before)], rtol=1e-4)
    assert f"next: {friction.next}" in shown.notes and evidence.rows_text in shown.notes


def test_figure_shows_evidence_below_or_on_a_page(
    friction: Explanation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = swing(FRICTION)
    pair = pair_with_model(log, torque_residuals(log, "lwr"))
    plot_pair(pair, tmp_path / "one.svg", joints=["A2"], explanations=[friction])
    text = (tmp_path / "one.svg").read_text(encoding="utf-8")
    for expected in ("A2: friction +1.5 Nm, 99 %", "next: move A2 at constant", "velocity, deg/s",
                     "left out: "):  # fmt: skip
        assert expected in text
    monkeypatch.setattr(plot, "PER_PAGE", 1)
    with mpl.rc_context({"pdf.compression": 0}):
        plot_pair(pair, tmp_path / "two.pdf", joints=["A2"], explanations=[friction] * 2)
    assert (tmp_path / "two.pdf").read_bytes().count(b"/Type /Page ") == 3


def test_markdown_has_verdicts_rows_and_the_figure(friction: Explanation, tmp_path: Path) -> None:
    log = swing(FRICTION)
    pair = pair_with_model(log, torque_residuals(log, "lwr"))
    path = tmp_path / "report.md"
    write_markdown(pair, compare(pair), [friction], ["a note"], path, tmp_path / "figure.svg")
    text = path.read_text(encoding="utf-8")
    assert text.startswith("# swing minus its model: lwr\n\n- a note\n\n## A2: friction: +1.5 ")
    assert f"- next: {friction.next}\n" in text and "![evidence](figure.svg)" in text
    assert f"- used: {evidence_of(friction).rows_text}\n" in text
    row = next(each for each in text.splitlines() if each.startswith("| A2 | torques |"))
    assert row.count("|") == 6
    with pytest.raises(UsageError, match=r"cannot write .*missing"):
        write_markdown(pair, [], [], [], tmp_path / "missing" / "report.md")
