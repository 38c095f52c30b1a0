"""Trends of identified parameters. The nights are simulated in plain MuJoCo."""

from __future__ import annotations

import json
import os
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT, import_script

from sero_mj.cli import main

NIGHTS, STEP_AT = 12, 7
WORN, DRIFTING = 4, 1  # A4, A2
FIRST = datetime(2026, 10, 29, 2, 15)


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Writes a table per night. Friction scatters by 2 %, and the motion is always the same."""
    plants = import_script(ROOT / "benchmarks" / "verdicts" / "plant.py")
    folder, robot = tmp_path_factory.mktemp("nights"), plants.load_robot("lwr")
    rng = np.random.default_rng(5)
    for night in range(NIGHTS + 1):
        plant = plants.Plant(robot, np.random.default_rng(2), duration=2.0)
        plant.rng = np.random.default_rng(night)  # of the noise
        plant.coulomb *= 1.0 + 0.02 * rng.standard_normal(7)
        plant.coulomb[DRIFTING] *= 1.0 + 0.03 * night
        if night >= STEP_AT:
            plant.coulomb[WORN] *= 1.54
        file = folder / (f"night{night:02d}.csv" if night else "good.csv")
        plant.run().write(file)
        date = (FIRST + timedelta(days=night)).timestamp()
        os.utime(file, (date, date))
    return folder


@pytest.mark.slow
def test_worn_gear_and_drift_are_found_among_all_joints(
    nights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recordings = [str(file) for file in sorted(nights.glob("*.csv"))]  # with the baseline
    (nights / "short.csv").write_text(
        "".join((nights / "good.csv").read_text("utf-8").splitlines(keepends=True)[:40]), "utf-8"
    )
    arguments = ["--baseline", str(nights / "good.csv"), "--scene", "lwr", "--json", "--jobs", "1"]
    with pytest.raises(SystemExit) as ended:
        main(["compare", *recordings, str(nights / "short.csv"), *arguments])
    assert ended.value.code == 1
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    (short,) = found["skipped"]
    assert "expected at least" in short["reason"]
    trends = {f"{each['joint']}.{each['parameter']}": each for each in found["trends"]}
    assert len(trends) == 7 * 6 + 1
    changed = {key for key, each in trends.items() if each["changed"]}
    assert changed == {"A4.coulomb_friction", "A2.coulomb_friction"}
    worn, drifting = trends["A4.coulomb_friction"], trends["A2.coulomb_friction"]
    before, after = FIRST + timedelta(days=STEP_AT - 1), FIRST + timedelta(days=STEP_AT)
    assert worn["events"][0].endswith(f"between {before:%Y-%m-%d} and {after:%Y-%m-%d}")
    assert worn["baseline"] == pytest.approx(0.2, rel=0.05)  # as the robot's file declares
    assert worn["last"] == pytest.approx(0.2 * 1.54, rel=0.05)
    assert drifting["slope_per_day"] == pytest.approx(0.03 * 0.8, rel=0.25)
    assert drifting["change_points"] == []
    assert "at this rate +50 % on about 2026-11-1" in drifting["events"][0]
    assert len(worn["values"]) == NIGHTS + 1  # the baseline is not repeated
    assert trends["A1.gravity_error"]["last"] < 0.05
    assert trends["payload.mass"]["last"] == pytest.approx(0.0, abs=0.02)
