from __future__ import annotations

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from rich.console import Console
from rich.table import Table
from runs import simulated, sine_run, two_joints

from sero_mj.cli.arguments import print_table
from sero_mj.simulate.runs.monitor import Finding
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.study.summary import as_json, as_table, summarise


def printed(rows: list, title: str = "") -> str:
    console = Console(file=io.StringIO(), width=100)
    console.print(as_table(rows, title))
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_sine_has_the_peak_and_rms_of_a_sine() -> None:
    turn, slide = summarise(sine_run(amplitude=3.0))
    assert turn.peak_torque_error is not None
    assert abs(turn.peak_torque_error) == pytest.approx(3.0, rel=1e-6)
    assert turn.peak_torque_error_at is not None
    assert turn.peak_torque_error_at % 0.25 == pytest.approx(0.125, abs=1e-3)
    assert turn.rms_torque_error == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-3)
    assert turn.peak_torque == pytest.approx(4.0)  # 4 Nm cos(t), of 10 Nm
    assert turn.peak_share == pytest.approx(0.4)
    assert slide.peak_torque == pytest.approx(20.0, rel=1e-6)
    assert slide.peak_share == pytest.approx(0.2, rel=1e-6)
    assert (turn.torque_unit, slide.torque_unit) == ("Nm", "N")
    assert (turn.angle_unit, slide.angle_unit) == ("rad", "m")


def test_summary_of_a_simulation_equals_numpy() -> None:
    log = simulated().log
    rows = summarise(log)
    error = log.of("lwr", "commanded_torques") - log.of("lwr", "torques")
    position = log.of("lwr", "target_angles") - log.of("lwr", "actual_angles")
    for k, row in enumerate(rows):
        assert row.joint == log.robots["lwr"].names[k]
        assert abs(row.peak_torque_error or 0.0) == np.abs(error[:, k]).max()
        assert row.rms_torque_error == pytest.approx(np.linalg.norm(error[:, k]) / np.sqrt(501))
        assert abs(row.peak_position_error or 0.0) == np.abs(position[:, k]).max()
        assert row.saturated_share == log.of("lwr", "saturated")[:, k].mean()
    assert all(row.findings == 0 for row in rows)


def test_small_torques_are_in_the_unit_of_their_robot() -> None:
    log = sine_run(amplitude=3.0)
    small = {
        name: 1e-6 * values if "torques" in name else values for name, values in log.signals.items()
    }
    arm = log.robots["arm"].model_copy(update={"torque_limits": np.array([1e-5, 0.2])})
    rows = summarise(replace(log, robots={"arm": arm}, signals=small))
    text = printed(rows)
    assert "uNm" in text and "0 " not in text.split("turn")[1].split()[0]
    assert rows[0].torque_unit == "Nm"


def test_findings_are_counted_at_their_joints() -> None:
    findings = [
        Finding(2.0, "arm", "slide", "saturated", 1.0, 0.5),
        Finding(1.0, "arm", "slide", "torque_error", 9.0, 5.0),
        Finding(0.5, "leg", "slide", "torque_error", 9.0, 5.0),
    ]
    turn, slide = summarise(sine_run(), findings)
    assert (turn.findings, turn.first_finding) == (0, None)
    assert (slide.findings, slide.first_finding, slide.first_finding_at) == (2, "torque_error", 1.0)
    assert "2, 1.000 s" in printed([turn, slide])


def test_missing_values_are_none_and_have_no_column() -> None:
    log = sine_run(robot=two_joints(torque_limits=None))
    only = RunLog(log.robots, {"arm_joint_angles": log.signals["arm_joint_angles"]}, log.times)
    rows = summarise(only)
    assert rows[0].peak_torque_error is rows[0].peak_torque is rows[0].saturated_share is None
    shown = printed(rows)
    assert "turn" in shown
    assert "torque" not in shown
    (turn, _) = summarise(log)
    assert turn.peak_share is None
    assert turn.peak_torque == pytest.approx(4.0)
    blank = {**log.signals, "arm_torques": np.full((4001, 2), np.nan)}
    assert summarise(RunLog(log.robots, blank, log.times))[0].peak_torque is None


def test_printed_table_has_units_and_json_has_si() -> None:
    rows = summarise(sine_run())
    shown = printed(rows, "a run")
    assert "a run" in shown
    assert "+4 Nm" in shown  # joints of two units: each value has its own
    assert "40.0" in shown
    lwr = printed(summarise(simulated().log))
    above, _, below = lwr.partition("A1")
    assert "Nm" in above
    assert "Nm" not in below
    found = json.loads(json.dumps(as_json(rows)))
    assert [row["joint"] for row in found] == ["turn", "slide"]
    assert found[0]["peak_torque"] == pytest.approx(4.0)


def test_table_wider_than_the_terminal_is_printed_whole(
    capsys: pytest.CaptureFixture[str],
) -> None:
    table = Table()
    cells = [f"-{k}.123456 Nm" for k in range(20)]
    for k in range(20):
        table.add_column(f"joint {k}", no_wrap=True)
    table.add_row(*cells)
    print_table(table)
    out = capsys.readouterr().out
    assert all(cell in out for cell in cells)
    assert "…" not in out and len({len(line) for line in out.splitlines()}) == 1
