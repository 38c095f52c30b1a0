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

from sero_mj.base.frames import Array
from sero_mj.cli import main

NIGHTS, STEP_AT = 12, 7
WORN, DRIFTING = 4, 1  # A4, A2
FIRST = datetime(2026, 10, 29, 2, 15)


@pytest.fixture(scope="module")
def nights(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Array]:
    """Writes a table per night; returns the folder, and the friction of the drifting joint, Nm.

    Friction scatters by 2 %, and the motion is always the same.
    """
    plants = import_script(ROOT / "benchmarks" / "verdicts" / "plant.py")
    folder, robot = tmp_path_factory.mktemp("nights"), plants.load_robot("lwr")
    rng, friction = np.random.default_rng(5), []
    for night in range(NIGHTS + 1):
        plant = plants.Plant(robot, np.random.default_rng(2), duration=2.0)
        plant.rng = np.random.default_rng(night)  # of the noise
        plant.coulomb *= 1.0 + 0.02 * rng.standard_normal(7)
        plant.coulomb[DRIFTING] *= 1.0 + 0.03 * night
        friction.append(plant.coulomb[DRIFTING])
        if night >= STEP_AT:
            plant.coulomb[WORN] *= 1.54
        file = folder / (f"night{night:02d}.csv" if night else "good.csv")
        plant.run().write(file)
        date = (FIRST + timedelta(days=night)).timestamp()
        os.utime(file, (date, date))
    return folder, np.array(friction)


@pytest.mark.slow
def test_worn_gear_and_drift_are_found_among_all_joints(
    nights: tuple[Path, Array], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, friction = nights
    recordings = [str(file) for file in sorted(folder.glob("*.csv"))]  # with the baseline
    good, short = folder / "good.csv", folder / "short.csv"
    short.write_text("".join(good.read_text("utf-8").splitlines(keepends=True)[:40]), "utf-8")
    arguments = ["--baseline", str(good), "--scene", "lwr", "--json", "--jobs", "1"]
    with pytest.raises(SystemExit) as ended:
        main(["compare", *recordings, str(short), *arguments])
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
    # The rate is that of the friction of these nights, whose scatter changes it by its error.
    slope, error = drifting["slope_per_day"], drifting["slope_error_per_day"]
    assert slope == pytest.approx(np.polyfit(np.arange(NIGHTS + 1), friction, 1)[0], rel=0.02)
    assert slope == pytest.approx(0.03 * 0.8, abs=3.0 * error)
    of_scatter = np.std(friction / (1.0 + 0.03 * np.arange(NIGHTS + 1))) / np.sqrt(NIGHTS + 1)
    assert error == pytest.approx(of_scatter / np.std(np.arange(NIGHTS + 1)), rel=0.35)
    assert f"rises by {slope:.4f} ± {error:.4f} Nm per day" in drifting["events"][0]
    assert drifting["change_points"] == []
    assert "at this rate +50 % on about 2026-11-1" in drifting["events"][0]
    assert len(worn["values"]) == NIGHTS + 1  # the baseline is not repeated
    assert trends["A1.gravity_error"]["last"] < 0.05
    assert trends["payload.mass"]["last"] == pytest.approx(0.0, abs=0.02)
