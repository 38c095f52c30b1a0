"""The benchmark of verdicts: its plant, its faults, and how it judges."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from types import ModuleType

import numpy as np
import pytest
from conftest import ROOT, import_script

from sero_mj.study.explanation import Explanation

FOLDER = ROOT / "benchmarks" / "verdicts"
NOISE = 3e-4  # share of the torque limit


@pytest.fixture
def plants(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    monkeypatch.syspath_prepend(FOLDER)
    yield import_script(FOLDER / "plant.py")


@pytest.fixture
def faults(plants: ModuleType) -> ModuleType:
    return import_script(FOLDER / "faults.py")


@pytest.fixture
def judge() -> ModuleType:
    return import_script(FOLDER / "judge.py")


def verdict(joint: str, kind: str, part: str) -> Explanation:
    return Explanation(joint, kind, part, 0.0, "", 0.0, 0.99, 0.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["lwr", "fr3", "g3"])
def test_torques_without_fault_are_those_of_inverse_dynamics(plants: ModuleType, name: str) -> None:
    robot = plants.load_robot(name)
    plant = plants.Plant(robot, np.random.default_rng(1), duration=1.0)
    plant.resolution[:] = 1e-13
    for residual in plants.residuals(robot, plant.run()):
        assert np.abs(residual / robot.limits).max() < 6.0 * NOISE
        assert residual.std(axis=0) == pytest.approx(NOISE * robot.limits, rel=0.2)


def test_plain_urdf_without_a_fault_has_no_verdict(plants: ModuleType) -> None:
    # Its friction and motor inertia are not declared, so they are fitted to the recording.
    benchmark = import_script(FOLDER / "measure.py")
    row = benchmark.measure(("g3", "none", 0))
    assert (row["error"], row["verdicts"]) == ("", [])


def test_fault_acts_on_its_side_only(plants: ModuleType, faults: ModuleType) -> None:
    robot = plants.load_robot("lwr")
    for name, is_on_link in (("friction_less", False), ("payload", True)):
        plant, _ = faults.make_plant(name, 0, robot)
        plant.duration, plant.resolution = 1.0, np.full(7, 1e-13)
        changes = [np.abs(each / robot.limits).max() for each in
                   plants.residuals(robot, plant.run())]  # fmt: skip
        assert [change > 10.0 * NOISE for change in changes] == [is_on_link, not is_on_link]


def test_runs_are_the_same_for_the_same_seed(plants: ModuleType, faults: ModuleType) -> None:
    robot, logs = plants.load_robot("g3"), []
    for seed in (0, 0, 1):
        plant, _ = faults.make_plant("sensor_noise", seed, robot)
        plant.duration = 0.2
        logs.append(plant.run().torques)
    assert np.array_equal(logs[0], logs[1])
    assert not np.array_equal(logs[0], logs[2])


def test_every_kind_names_joints_of_the_robot(plants: ModuleType, faults: ModuleType) -> None:
    assert len(faults.KINDS) >= 45
    for name in plants.ROBOTS:
        robot = plants.load_robot(name)
        for kind in faults.KINDS:
            _, truth = faults.make_plant(kind, 3, robot)
            assert truth.visible <= {*robot.joints}
            places = {*robot.joints, "flange", "links", "base", "commands", "all joints"}
            assert {place for place, *_ in truth.right} <= places
            assert bool(truth.right) == (kind in faults.NAMED)


@pytest.mark.parametrize("name", ["plant.py", "faults.py", "judge.py"])
def test_generator_does_not_import_the_product(name: str) -> None:
    for node in ast.walk(ast.parse((FOLDER / name).read_text("utf-8"))):
        names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
        names += [each.name for each in node.names] if isinstance(node, ast.Import) else []
        assert not any(each.split(".")[0] == "sero_mj" for each in names)


def test_verdict_is_right_if_place_kind_and_part_are(judge: ModuleType) -> None:
    truth = judge.Truth(frozenset({("A2", "gain", "drive")}), frozenset({"A2"}))
    assert judge.is_right(verdict("A2", "gain", "drive"), truth)
    for wrong in (("A2", "gain", "torque sensor"), ("A3", "gain", "drive"),
                  ("A2", "bias", "drive"), ("A3", "unexplained", "drive")):  # fmt: skip
        assert not judge.is_right(verdict(*wrong), truth)
    assert judge.is_right(verdict("A2", "unexplained", "joint"), truth)
    assert not judge.is_right(verdict("A2", "gain", "drive"), judge.Truth())


def test_estimated_friction_may_be_reported_at_every_joint(judge: ModuleType) -> None:
    truth = judge.Truth().of_undeclared(("a", "b"))
    assert judge.is_right(verdict("b", "friction", "joint"), truth)
    assert judge.is_right(verdict("a", "unexplained", "drive"), truth)
    assert not judge.is_right(verdict("a", "unexplained", "joint"), truth)
    assert not judge.is_right(verdict("a", "sign", "drive"), truth)


def test_wilson_interval_has_published_values(judge: ModuleType) -> None:
    # Newcombe 1998, Statistics in Medicine 17, table I, score method.
    assert judge.wilson(81, 263) == pytest.approx((0.2553, 0.3662), abs=1e-4)
    assert judge.wilson(0, 20) == pytest.approx((0.0, 0.1611), abs=1e-4)
