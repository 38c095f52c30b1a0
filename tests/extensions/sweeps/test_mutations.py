"""Mutations are read and reported, and every shipped scenario detects typical mistakes.

`mutations/NAME.toml` has wrong gains, loads, friction, sensors, limits, motions and pushes. `make
test` tries the first two, which are subtle, of some scenarios; CI tries eight, or four of slow
scenarios; `make mutations` tries all.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from conftest import ROOT, examples, raises_with
from test_cli import run

from sero_mj.base.paths import find_scenario, list_scenarios
from sero_mj.extensions.sweeps.mutations import Mutations, judge
from sero_mj.extensions.sweeps.sweep import Sweep

SHIPPED = ROOT / "tests" / "mutations"
LEAST = 8
TRIED = {25: 2, 100: LEAST}[examples(100)]  # of every scenario, in quick tests and in CI
SLOW = ("biped_stand", "hit_hand_grasp", "justin_push")

SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]

[run]
duration = 0.05

[controllers.lwr]
kind = "joint_impedance"
stiffness = 800.0

[expect.it_holds]
measure = "position_error"
below = 1e-5
"""
MUTATIONS = """
["undeclared load"]
"disturbances.load" = { kind = "payload", robot = "lwr", mass = 2.0 }

["half as stiff"]
controllers.lwr.stiffness = 400.0

["too weak"]
"controllers.lwr" = { kind = "joint_impedance", stiffness = 800.0, torque_limits = 5.0 }
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "hold.toml"
    path.write_text(SCENARIO)
    return path


def written(folder: Path, text: str) -> Path:
    path = folder / "faults.toml"
    path.write_text(text)
    return path


def test_every_mutation_is_a_variant_with_its_overrides(file: Path, tmp_path: Path) -> None:
    design = Mutations.read(written(tmp_path, MUTATIONS))
    assert design.variants == [
        {},
        {"disturbances.load": {"kind": "payload", "robot": "lwr", "mass": 2.0}},
        {"controllers.lwr.stiffness": 400.0},
        {"controllers.lwr": {"kind": "joint_impedance", "stiffness": 800.0, "torque_limits": 5.0}},
    ]
    sweep = Sweep(file, design)
    assert sweep.columns[:3] == ["variant", "mutation", "held"]
    rows = dict(sweep.run())
    found = {design.name(number): judge(row, rows[0]) for number, row in rows.items()}
    assert {name: judged.noticed_by for name, judged in found.items()} == {
        "": [],
        "undeclared load": ["it_holds"],
        "half as stiff": [],  # at rest, the stiffness of a spring has no effect
        "too weak": ["it_holds"],
    }
    loaded = found["undeclared load"]
    assert loaded.moved == "it_holds"
    assert (loaded.value, loaded.value_without) == tuple(
        rows[number]["expect.it_holds.value"] for number in (1, 0)
    )
    assert found[""].moved is None


def test_sweep_reports_mutations_that_no_expectation_detects(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    mutations, out = written(tmp_path, MUTATIONS), tmp_path / "out.csv"
    asked = "sweep", str(file), "--mutations", str(mutations), "--jobs", "1"
    status, output, _ = run(capsys, *asked, "-o", str(out))
    assert status == 1
    lines = [line.split() for line in output.splitlines()]
    assert lines[-2][:5] == ["half", "as", "stiff", "nothing;", "it_holds"]
    assert lines[-1] == ["2", "detected,", "1", "not", "detected"]
    assert [line.split(",")[1:3] for line in out.read_text().splitlines()] == [
        ["mutation", "held"], ["", "true"], ["undeclared load", "false"],
        ["half as stiff", "true"], ["too weak", "false"],
    ]  # fmt: skip
    status, output, _ = run(capsys, *asked, "-o", str(out), "--resume", "--json")
    assert status == 1 and json.loads(output)["unnoticed"] == ["half as stiff"]
    mutations.write_text(MUTATIONS.replace("400", "401"))
    _, _, output = run(capsys, *asked, "-o", str(out), "--resume")
    assert "mutations.half as stiff.controllers.lwr.stiffness was 400.0 and is 401.0" in output
    mutations.write_text(MUTATIONS.partition('["half')[0])
    assert run(capsys, *asked, "--quiet")[:2] == (0, "")
    file.write_text(SCENARIO.replace("below", "holds_at = 'all'\nabove"))
    status, output, _ = run(capsys, *asked)
    assert status == 1 and "fail without a mutation: it_holds" in output


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", {"reason": "has no mutations"}),
        ("[load]", {"key": "load", "line": 1, "reason": "is empty"}),
        ("\nload = 3", {"key": "load", "line": 2, "reason": "is not a table"}),
        (
            '\n["soft"]\n"controllers.lwr.stifness" = 1',
            {"key": "soft.controllers.lwr.stifness", "line": 3, "near": "stiffness"},
        ),
        (
            "[stiff]\ncontrollers.lwr.stiffness = 9000",
            {"key": "stiff.controllers.lwr.stiffness", "line": 2, "found": 9000},
        ),
        (
            '["a load"]\n"disturbances.load" = { kind = "payload", robot = "lvr", mass = 1.0 }',
            {"key": "a load.disturbances.load.robot", "line": 2, "near": "lwr"},
        ),
    ],
)
def test_errors_in_a_mutation_file_have_their_line(
    file: Path, tmp_path: Path, text: str, problem: dict[str, Any]
) -> None:
    path = written(tmp_path, text)
    with raises_with(file=str(path), **problem):
        Sweep(file, Mutations.read(path))


def test_every_shipped_scenario_has_mutations() -> None:
    assert sorted(path.stem for path in SHIPPED.iterdir()) == sorted(list_scenarios())
    for path in SHIPPED.iterdir():
        assert len(Mutations.read(path).tables) >= LEAST, path


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.thorough] if name in SLOW else [])
        for name in list_scenarios()
    ],
)
def test_mutations_of_shipped_scenarios_are_detected(name: str) -> None:
    sweep = Sweep(find_scenario(name), Mutations.read(SHIPPED / f"{name}.toml"))
    tried = TRIED // 2 if name in SLOW else TRIED
    numbers = range(len(sweep.variants))[: tried + 1]
    rows = dict(sweep.run(numbers=numbers))
    found = {number: judge(row, rows[0]).noticed_by for number, row in rows.items()}
    assert found.pop(0) == []
    assert [sweep.design.cells(number) for number, by in found.items() if not by] == []
