"""Recordings with missing, doubled and constant data: what is printed, and what is concluded."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from explain_runs import swing

from sero_mj.base.frames import Array
from sero_mj.cli import main
from sero_mj.extensions.explain.usable_rows import usable
from sero_mj.simulate.runs.run_log import RunLog

BIAS = json.dumps({"kind": "sensor", "bias": -4.0, "joints": ["A2"]})  # from 1.3 s on
SIGNALS = ("joint_angles", "torques", "commanded_torques")
Table = dict[str, Array]  # with the key `time`


def rows(table: Table, kept: Array) -> Table:
    return {name: values[kept] for name, values in table.items()}


def changed(table: Table, name: str, where: object, value: object) -> Table:
    values = table[name].copy()
    values[where] = value
    return {**table, name: values}


def lost(table: Table) -> Table:
    return rows(table, np.flatnonzero(np.random.default_rng(0).random(len(table["time"])) > 0.1))


def gap(table: Table) -> Table:
    return rows(table, np.flatnonzero((table["time"] < 1.6) | (table["time"] > 2.0)))


def doubled(table: Table) -> Table:
    return rows(table, np.sort(np.r_[np.arange(2601), np.arange(500, 900)]))


def clock_jump(table: Table) -> Table:
    return {**table, "time": table["time"] + np.where(table["time"] > 2.1, 1.7e9, 0.0)}


def missing_values(table: Table) -> Table:
    table = changed(table, "torques", np.s_[700:720], np.nan)
    return changed(table, "torques", np.s_[:, 4], np.nan)


def missing_angles(table: Table) -> Table:
    return changed(table, "joint_angles", np.s_[:, 3], np.nan)


def infinite(table: Table) -> Table:
    return changed(table, "joint_angles", 1200, np.inf)


def no_commands(table: Table) -> Table:
    return {name: values for name, values in table.items() if name != "commanded_torques"}


def empty_commands(table: Table) -> Table:
    return changed(table, "commanded_torques", np.s_[:], np.nan)


def stopped(table: Table) -> Table:
    held = {name: np.where(np.arange(2601)[:, None] < 1800, values, values[1800])
            for name, values in table.items() if name != "time"}  # fmt: skip
    return {**held, "time": table["time"]}


def zeros(table: Table) -> Table:
    for name in SIGNALS:
        table = changed(table, name, np.s_[1800:], 0.0)
    return table


def no_torques(table: Table) -> Table:
    return changed(table, "torques", np.s_[:], 0.0)


def no_angles(table: Table) -> Table:
    return changed(table, "joint_angles", np.s_[:], np.nan)


def still(table: Table) -> Table:
    return {**table, **{name: table[name] * 0.0 + table[name][0] for name in SIGNALS}}


def short(table: Table) -> Table:
    return rows(table, np.arange(400))


def three_rows(table: Table) -> Table:
    return rows(table, np.arange(3))


def without_time(table: Table) -> Table:
    return {**table, "time": table["time"] * 0.0}


def run(change: Callable[[Table], Table], folder: Path, *more: str) -> int:
    """Compares a table with the model of the LWR; returns the exit status."""
    log = swing(BIAS)
    table = change({"time": log.times, **{each: log.of("lwr", each) for each in SIGNALS}})
    columns = {"time": table["time"][:, None]} | {n: v for n, v in table.items() if n != "time"}
    names = ["time"]
    for name, values in columns.items():
        names += [f"{name}_{k}" for k in range(1, values.shape[1] + 1)] if name != "time" else []
    file = folder / "run.csv"
    np.savetxt(file, np.hstack(list(columns.values())), delimiter=",", header=",".join(names),
               comments="")  # fmt: skip
    with pytest.raises(SystemExit) as ended:
        main(["compare", str(file), "--scene", "lwr", *more])
    return int(ended.value.code or 0)


def compared_with_model(
    change: Callable[[Table], Table],
    notes: list[str],
    folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> Any:
    """Compares a changed table with the model, and checks that the result contains the notes."""
    assert run(change, folder, "--against-model", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    about = "\n".join(found["about"])
    assert all(each in about for each in notes), about
    return found


@pytest.mark.parametrize(
    ("change", "notes"),
    [
        (lost, ["% of the rows at 1000 Hz are missing"]),
        (gap, ["15 % of the rows at 1000 Hz are missing", "gap or missing value 21 %"]),
        (doubled, ["rows with the time of the row before: 400"]),
        (clock_jump, ["times jump by 1.7e+09 s after 2.10 s", "from 0.00 s to 2.10 s are used"]),
        (missing_values, ["no measured torques of A4", "link side (left out: gap"]),
        (missing_angles, ["no angles of A3: link torques of all joints are unknown"]),
        (
            infinite,
            [
                "rows with infinite or huge joint_angles: 1",
                "link side (left out: gap or missing value 5 %)",
            ],
        ),
        (no_commands, ["no commanded torques: drives and friction are not examined"]),
        (empty_commands, ["no commanded torques of all joints"]),
        (stopped, ["all signals are constant from 1.80 s to 2.60 s: these rows are not used"]),
        (zeros, ["all signals are constant from 1.80 s to 2.60 s: these rows are not used"]),
    ],
)
def test_fault_is_found_in_the_remaining_data(
    change: Callable[[Table], Table],
    notes: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = compared_with_model(change, notes, tmp_path, capsys)
    (bias,) = found["explanations"]
    part = "sensor or drive" if change is missing_angles else "torque sensor"
    assert (bias["joint"], bias["kind"], bias["part"]) == ("A2", "bias", part)
    assert bias["size"] == pytest.approx(-4.0, abs=0.1)
    assert bias["begin"] == pytest.approx(1.3, abs=0.05)


@pytest.mark.parametrize(
    ("change", "notes"),
    [
        (no_torques, ["constant torques of all joints: they are not used", "cannot be compared"]),
        (no_angles, ["no angles of all joints", "lwr cannot be compared with its model"]),
        (still, ["all signals are constant: there is only one pose", "no motion of all joints"]),
    ],
)
def test_nothing_is_concluded_without_data(
    change: Callable[[Table], Table],
    notes: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = compared_with_model(change, notes, tmp_path, capsys)
    assert [each for each in found["explanations"] if each["kind"] != "bias"] == []
    # The noise of the only pose is a bias.
    assert all(abs(each["size"]) < 0.1 for each in found["explanations"])


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (short, "run has 0.399 s of 'lwr'; expected at least 0.5 s"),
        (three_rows, "run has 3 different times of 'lwr'; expected 4 or more"),
        (without_time, "run has 1 different times of 'lwr'; expected 4 or more"),
    ],
)
def test_too_little_data_is_an_error_or_has_no_explanation(
    change: Callable[[Table], Table],
    problem: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert run(change, tmp_path, "--against-model") == 2
    assert problem in capsys.readouterr().err
    assert run(change, tmp_path) == 0
    assert f"no explanation: {problem}" in " ".join(capsys.readouterr().out.split())


def test_intact_log_is_returned_as_it_is() -> None:
    log = swing(BIAS)
    assert usable(log, "lwr") == (log, [])


def test_the_longest_part_between_clock_jumps_is_used() -> None:
    log = swing(BIAS)
    for first, part in ((500, slice(500, None)), (2000, slice(None, 2000))):
        times = log.times + 1e6 * (np.arange(len(log.times)) >= first)
        found, notes = usable(RunLog(log.robots, log.signals, times), "lwr")
        np.testing.assert_array_equal(found.times, times[part])
        assert len(notes) == 1 and "jump by 1e+06 s" in notes[0]
