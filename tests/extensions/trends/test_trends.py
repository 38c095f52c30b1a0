"""Trends of recordings without an explainer: dates, temperatures, tables, pages and errors."""

from __future__ import annotations

import csv
import json
import os
import re
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from runs import record_packets

from sero_mj.base.reduction import rms_with_error
from sero_mj.cli import main
from sero_mj.data.record.recording_format import RecordingClock
from sero_mj.extensions.trends import measured as measured_file
from sero_mj.extensions.trends.change_points import fit_segments
from sero_mj.extensions.trends.measured import Measured, date_of
from sero_mj.extensions.trends.trend import Trend, date_texts, find_trends
from sero_mj.extensions.trends.trend_page import write_trend_page
from sero_mj.study.explanation import Parameter

FIRST = datetime(2026, 10, 30, 3, 15).astimezone()
NIGHTS = 12
SCENE = """\
[robots.arm]
dh_convention = "craig"
dh_params = [[0.0, 0.0, 0.0, 0.2], [0.0, 0.3, 0.0, 0.0]]
joint_names = ["lower", "upper"]
torque_limits = [10.0, 10.0]
inputs = ["temperatures"]
[sources.udp]
kind = "udp"
port = 1
structure = "{structure}"
[routes]
"arm.joint_angles" = "udp.q"
"arm.torques" = "udp.measured"
"arm.commanded_torques" = "udp.commanded"
"arm.temperatures" = "udp.heat"
"""
STRUCTURE = "q:2F measured:2F commanded:2F heat:2F"


def record(
    path: Path,
    date: datetime,
    *,
    amplitude: float = 1.0,
    heat: float = 35.0,
    motion: float = 0.3,
    scene: str = SCENE,
) -> Path:
    """Records torque errors that are sines, with the root mean square `amplitude` / sqrt(2)."""
    times = np.arange(200) / 200.0
    wave = np.sin(2.0 * np.pi * 4.0 * times)[:, None]
    rows = {
        "q": motion * wave @ np.ones((1, 2)),
        "measured": np.zeros((200, 2)),
        "commanded": wave @ np.array([[1.0, amplitude]]),
        "heat": np.tile([31.0, heat], (200, 1)),
    }
    clock = RecordingClock(round(date.timestamp() * 1e9), 0)
    files = {"scene.toml": scene.format(structure=STRUCTURE)}
    return record_packets(path, STRUCTURE, rows, times, files, clock=clock)


@pytest.fixture
def nights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(measured_file, "find_explainer", lambda: None)
    rng = np.random.default_rng(3)
    record(tmp_path / "good.mcap", FIRST - timedelta(days=40))
    for k in range(NIGHTS):
        amplitude = (1.0 if k < 7 else 1.6) * (1.0 + 0.01 * rng.standard_normal())
        heat = 35.0 + 1.0 * k + rng.normal(0.0, 0.3)
        file, date = tmp_path / f"night{k:02d}.mcap", FIRST + timedelta(days=k)
        record(file, date, amplitude=amplitude, heat=heat)
    return tmp_path


def compare(folder: Path, *arguments: object) -> int:
    recordings = sorted(folder.glob("[a-z]*.mcap"), reverse=True)  # the order does not matter
    given = ["compare", *recordings, "--baseline", folder / "good.mcap", "--jobs", 1, *arguments]
    with pytest.raises(SystemExit) as ended:
        main([str(each) for each in given])
    return int(ended.value.code or 0)


def test_steps_and_drifts_are_reported_with_their_dates(
    nights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    table, junit = nights / "trend.csv", nights / "trend.xml"
    assert compare(nights, "--table", table, "--junit", junit) == 1
    shown = capsys.readouterr()
    lines = shown.out.replace("\n  ", " ").splitlines()
    before, after = (f"{FIRST + timedelta(days=k):%Y-%m-%d}" for k in (6, 7))
    rose = "upper rms torque error rose from 0.7"
    (line,) = (line for line in lines if line.startswith(rose))
    step = re.search(r"to 1.1\d Nm \(\+(\d+) %\) between (\S+) and (\S+)$", line)
    assert step is not None and step.groups()[1:] == (before, after)
    assert int(step[1]) == pytest.approx(60, abs=2)
    (drift,) = (line for line in lines if "rises by" in line)
    rate = re.search(r"upper temperature rises by ([\d.]+) ± ([\d.]+) °C per day since", drift)
    assert rate is not None
    assert float(rate[1]) == pytest.approx(1.0, abs=0.1)
    assert "%" not in drift  # a share of a temperature in degrees is meaningless
    assert shown.err.strip().endswith("upper rms torque error, upper temperature")
    assert "good.mcap" in lines[0] and "12 recordings" in shown.out
    with table.open(encoding="utf-8") as file:
        rows = {Path(row["recording"]).name: row for row in csv.DictReader(file)}
    assert len(rows) == NIGHTS
    assert float(rows["night00.mcap"]["lower.rms_torque_error"]) == pytest.approx(
        (0.5 * 200 / 199) ** 0.5  # the first row has no command
    )
    assert float(rows["night00.mcap"]["lower.temperature"]) == pytest.approx(31.0)
    assert rows["night03.mcap"]["date"] == (FIRST + timedelta(days=3)).isoformat()
    suite = ElementTree.parse(junit).getroot()[0]
    failed = {(each.get("classname"), each.get("name")) for each in suite if len(each)}
    assert failed == {("upper", "rms_torque_error"), ("upper", "temperature")}
    assert (suite.get("tests"), suite.get("failures")) == ("4", "2")
    # Changes within the tolerance are not an error.
    assert compare(nights, "--tolerance-change", 70, "--quiet") == 0


def test_recordings_that_cannot_be_compared_are_skipped_with_the_reason(
    nights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (nights / "a_broken.mcap").write_bytes(b"none")
    date = FIRST + timedelta(days=1, hours=1)
    other = SCENE.replace("robots.arm", "robots.leg").replace('"arm.', '"leg.')
    record(nights / "b_other.mcap", date, scene=other)
    renamed = SCENE.replace('"lower", "upper"', '"hip", "knee"')
    record(nights / "c_joints.mcap", date, scene=renamed)
    silent = SCENE.replace('"arm.commanded_torques" = "udp.commanded"\n', "")
    record(nights / "d_partly.mcap", date, scene=silent)
    alone = silent.replace('"arm.temperatures" = "udp.heat"\n', "")
    record(nights / "e_useless.mcap", date, scene=alone)
    page = nights / "trend.html"
    assert compare(nights, "--json", "-o", page, "--junit", nights / "t.xml") == 1
    shown = capsys.readouterr()
    found = json.loads(shown.out)
    reasons = {Path(each["recording"]).name: each["reason"] for each in found["skipped"]}
    assert reasons.keys() == {"a_broken.mcap", "b_other.mcap", "c_joints.mcap", "e_useless.mcap"}
    assert "is not an MCAP file" in reasons["a_broken.mcap"]
    assert "no robot 'arm'" in reasons["b_other.mcap"] and "leg" in reasons["b_other.mcap"]
    assert reasons["c_joints.mcap"] == (
        "arm has the joints hip, knee; the baseline has lower, upper"
    )
    missing = "the run has no measured or no commanded torques"
    assert reasons["e_useless.mcap"].endswith(missing)
    assert f"no rms torque error: {missing}" in " ".join(found["notes"])
    assert all(f"skipped {nights / name}: {why}" in shown.err for name, why in reasons.items())
    trends = {(each["joint"], each["parameter"]): each for each in found["trends"]}
    changed = trends["upper", "rms_torque_error"]
    assert changed["changed"] and len(changed["values"]) == NIGHTS + 1
    assert [Path(each).name for each in changed["change_points"]] == ["night07.mcap"]
    assert len(trends["upper", "temperature"]["values"]) == NIGHTS + 2  # also d_partly.mcap
    assert not trends["lower", "rms_torque_error"]["changed"]
    text = page.read_text(encoding="utf-8")
    assert "c_joints.mcap: arm has the joints hip, knee" in text
    assert "http" not in text.replace('http-equiv="Content-Security-Policy"', "")
    assert "%%" not in text
    assert ElementTree.parse(nights / "t.xml").getroot().get("skipped") == "4"


@pytest.mark.slow
def test_page_draws_all_values_and_sorts_its_table(nights: Path, browser: Any) -> None:
    compare(nights, "-o", nights / "trend.html", "--quiet")
    page, errors = browser.new_page(viewport={"width": 390, "height": 844}), []
    page.on("console", lambda message: errors.append(message.text))
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"file://{nights / 'trend.html'}")
    assert page.evaluate("document.documentElement.scrollWidth") == 390
    assert page.locator("svg .point").count() == 4 * (NIGHTS + 1)
    # A screen length is proportional to time, and the old baseline is moved closer.
    figure = page.locator("figure.changed").first
    at = [float(each.get_attribute("cx")) for each in figure.locator(".point").all()]
    assert np.ptp(np.diff(at)[1:]) < 0.2 and at[1] - at[0] < 3.0 * (at[2] - at[1])
    assert page.locator("svg a").nth(1).get_attribute("href") == "night00.mcap"
    names = [row.split("\t")[1] for row in page.locator("tbody tr").all_inner_texts()]
    assert set(names[:2]) == {"rms torque error, Nm", "temperature, °C"}  # the significant ones
    for heading, column in (("baseline", 2), ("joint", 0)):
        page.get_by_role("button", name=heading).click()
        cells = [row.split("\t")[column] for row in page.locator("tbody tr").all_inner_texts()]
        key = float if heading == "baseline" else str
        assert cells == sorted(cells, key=key, reverse=True)
    assert errors == []
    page.close()


def test_unusable_baseline_is_an_error(nights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (nights / "good.mcap").write_bytes(b"none")
    assert compare(nights) == 2
    assert "good.mcap is not an MCAP file" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["compare", str(nights / "none.mcap"), "--baseline", str(nights / "night01.mcap")])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert "none.mcap: no such file" in said and "none of 1 recordings can be compared" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--junit", "t.xml"], "--junit needs --baseline"),
        (["--tolerance-change", "5"], "--tolerance-change needs --baseline"),
        (["--baseline", "b", "--offset", "auto"], "--offset cannot be combined with --baseline"),
        (["--baseline", "b", "--each"], "--each cannot be combined with --baseline"),
        (["--baseline", "b", "-o", "t.md"], "found 't.md'; expected .html with --baseline"),
        (["--baseline", "b", "--limit", "0"], "--limit: found '0'; expected a number above 0"),
    ],
)
def test_incompatible_options_of_trends_are_rejected(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["compare", "a.mcap", *arguments])
    assert ended.value.code == 2 and said in capsys.readouterr().err


def measured(value: float | None, day: float, **fields: float) -> Measured:
    parameter = Parameter("A4", "coulomb_friction", "Nm", value, error=0.01, **fields)
    date, motion = FIRST + timedelta(days=day), np.zeros((2, 1))
    return Measured(f"{day}.mcap", date, False, "lwr", ["A4"], [parameter], motion)


def trend_of(values: list[float], tolerance: float = 0.1, **fields: float) -> Trend:
    runs = [measured(value, day, **fields) for day, value in enumerate(values)]
    (found,) = find_trends(runs[0], runs[1:], tolerance, 0.5)
    return found


def test_drift_is_extrapolated_to_the_date_of_the_limit() -> None:
    rng = np.random.default_rng(0)
    values = [0.6 + 0.005 * day + 0.005 * rng.standard_normal() for day in range(30)]
    found = trend_of(values)
    assert found.is_changed and not found.steps and found.limit_date is not None
    # It reaches 0.9 Nm after 60 days.
    assert (found.limit_date - FIRST).days == pytest.approx(60, abs=3)
    (text,) = found.events
    assert f"at this rate +50 % on about {found.limit_date:%Y-%m-%d}" in text
    assert "A4 Coulomb friction rises by 0.00498 ± 0.00025 Nm per day since" in text
    falling = trend_of([1.2 - value for value in values])
    assert falling.limit_date is not None and "at this rate -50 %" in falling.events[0]


def test_repaired_robot_is_not_changed_but_its_steps_are_listed() -> None:
    values = [0.60, 0.61, 0.60, 0.59, 0.60, 0.95, 0.94, 0.95, 0.96, 0.6, 0.61, 0.59, 0.6, 0.61]
    found = trend_of(values)
    assert found.steps == [5, 9] and not found.is_changed
    assert "rose" in found.events[0] and "fell" in found.events[1]


def test_names_on_the_page_are_not_markup(tmp_path: Path) -> None:
    hostile = Parameter('<script>"&', "<i>", "<b>", 1.0)
    runs = [
        Measured('<u>".mcap', FIRST + timedelta(days=k), False, "lwr", ["A"],
                 [replace(hostile, value=1.0 + (k > 5))], np.zeros((2, 1)))
        for k in range(12)
    ]  # fmt: skip
    found = find_trends(runs[0], runs[1:], 0.1, 0.5)
    assert found[0].is_changed
    write_trend_page(tmp_path / "t.html", "<u>", found, [("<u>", "<u>")], ["<u>"])
    text = (tmp_path / "t.html").read_text(encoding="utf-8")
    assert not re.search('<(u|i)>|<b><|<script>"|">"', text)
    assert text.count("<script>") == 1


def test_small_changes_are_not_reported() -> None:
    values = [0.60] * 10 + [0.70] * 10
    assert trend_of(values).is_changed
    assert not trend_of(values, tolerance=0.2).is_changed
    assert not trend_of(values, min_change=0.2).is_changed
    assert trend_of(values, tolerance=0.2).events == []
    offset = trend_of([0.0, 0.01, -0.01, 0.0, 0.0, 0.01, 1.5, 1.49, 1.5, 1.51])
    assert offset.is_changed and "%" not in offset.events[0] and offset.limit_date is None


def test_baseline_may_be_newer_than_the_other_recordings() -> None:
    runs = [measured(0.9 if day < 6 else 0.6, day) for day in range(12)]
    (found,) = find_trends(runs[-1], runs[:6], 0.1, 0.5)
    assert found.values[found.latest] == 0.9 and found.is_changed
    assert found.change == pytest.approx(0.3, abs=0.02)


def test_false_alarms_of_a_whole_report_are_rare() -> None:
    rng = np.random.default_rng(7)
    times, errors = 86400.0 * np.arange(30), np.full(30, 0.015)
    alarms = []
    for _ in range(30):
        segments = fit_segments(times, 0.6 + 0.02 * rng.standard_normal(30), errors, 0.05)
        alarms.append(len(segments) > 1 or segments[0].slope != 0.0)
    assert np.mean(alarms) <= 0.05


def test_error_of_a_root_mean_square_is_that_of_independent_runs() -> None:
    rng = np.random.default_rng(2)
    white = rng.standard_normal((400, 300)) + 0.5
    found, errors = np.transpose([rms_with_error(run) for run in white])
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(np.std(found), rel=0.15)
    assert np.mean(found**2) == pytest.approx(1.25, rel=0.02)
    assert np.isnan(rms_with_error(np.array([1.0, np.nan, 2.0]))).all()
    assert rms_with_error(np.zeros(9)) == (0.0, 0.0)


def test_other_motion_is_noted(nights: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(nights / "z_fast.mcap", FIRST + timedelta(days=20), motion=0.6)
    compare(nights)
    shown = capsys.readouterr().out.replace("\n  ", " ")
    assert "another motion than in the baseline in z_fast.mcap: parameters may differ" in shown


def test_date_is_that_of_the_recording_or_of_the_file(tmp_path: Path) -> None:
    file = record(tmp_path / "run.mcap", FIRST)
    os.utime(file, (1e9, 1e9))
    assert date_of(file) == (FIRST, False)
    unset = record(tmp_path / "unset.mcap", datetime(1971, 1, 1).astimezone())
    table = tmp_path / "table.csv"
    table.write_text("time\n")
    for each in (unset, table):
        os.utime(each, (1.5e9, 1.5e9))
        date, is_of_file = date_of(each)
        assert is_of_file and date.timestamp() == 1.5e9
    days = [FIRST, FIRST + timedelta(days=1)]
    assert date_texts(days) == ["2026-10-30", "2026-10-31"]
    assert date_texts([FIRST, FIRST + timedelta(minutes=2)]) == ["03:15", "03:17"]
    assert date_texts([*days, FIRST + timedelta(minutes=2)])[2] == "2026-10-30 03:17"
