"""`sero-mj new` and `sero-mj schema`: files to start from, and schemas for editors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from test_cli import run

from sero_mj import Mirror, Scene, SerialRobot, World, load_scene
from sero_mj.base.declaration import Declaration
from sero_mj.base.plugins import SOURCES, plugins
from sero_mj.cli.listing import scenario_tables, scene_tables
from sero_mj.cli.schema import KINDS, schema_of

SHIPPED = {
    "robot": "models/*/robot.toml",
    "group": "models/*/group.toml",
    "scene": "scenes/*.toml",
    "scenario": "scenes/scenarios/*.toml",
}


def validator_of(schema: dict[str, Any]) -> Any:
    import jsonschema  # takes a second, which every worker would spend while collecting tests

    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


def found(kind: str, tables: dict[str, Any]) -> list[str]:
    return [
        f"{'.'.join(map(str, each.absolute_path))}: {each.message}"
        for each in validator_of(schema_of(kind)).iter_errors(tables)
    ]


@pytest.mark.parametrize("kind", KINDS)
def test_shipped_files_are_valid_against_their_schema(kind: str) -> None:
    validator = validator_of(schema_of(kind))
    files = sorted(ROOT.glob(SHIPPED[kind]))
    assert len(files) > 3
    for file in files:
        wrong = [error.message for error in validator.iter_errors(tomllib.loads(file.read_text()))]
        assert wrong == [], file


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [
        ("robot", 'dh_conventon = "craig"', "'dh_conventon' was unexpected"),
        ("robot", 'dh_convention = "denavit"', "dh_convention: 'denavit' is not one of"),
        ("robot", 'stale_after = "soon"', "stale_after: 'soon' is not of type 'number'"),
        ("robot", "[dynamics]\nmass = [1.0]", "dynamics: Additional properties are not allowed"),
        ("scene", "[robots.a]\nshow_axis = true", "robots.a: Additional properties"),
        ("scene", "[sources.a]\nport = 1", "sources.a: {'port': 1} is not valid under any"),
        ("scene", "[view]\nlook = 3", "view.look: 3 is not"),
        ("scene", "[run]\nduration = 1", "'run' was unexpected"),
        ("scenario", "[run]\nduration = -1.0", "run.duration: -1.0 is less than or equal to"),
        ("scenario", '[controllers.a]\nkind = "pid"', "controllers.a: {'kind': 'pid'} is not"),
    ],
)
def test_schema_detects_mistakes(kind: str, text: str, expected: str) -> None:
    assert any(expected in each for each in found(kind, tomllib.loads(text)))


def test_schema_contains_every_kind_and_describes_keys() -> None:
    schema = schema_of("scenario")
    text = json.dumps(schema)
    for kind in plugins(SOURCES):
        assert json.dumps({"const": kind}) in text
    for header in scenario_tables():
        kind = header.partition('kind = "')[2].rstrip('"')
        assert not kind or json.dumps({"const": kind}) in text
    robot = schema["properties"]["robots"]["additionalProperties"]["properties"]
    assert robot["velocity_limits"]["description"] == "velocity limits, shape (n,), rad/s or m/s."
    assert "model" in robot and "name" not in robot


def test_every_table_of_a_robot_is_documented() -> None:
    documented = set(scene_tables().values())
    fields = (field.annotation for field in SerialRobot.model_fields.values())
    tables = {kind for kind in fields if isinstance(kind, type) and issubclass(kind, Declaration)}
    assert {each.__name__ for each in tables} >= {"Dynamics", "TorqueControl"}
    assert tables <= documented


def test_schema_is_printed_or_written(capsys: Any, tmp_path: Path) -> None:
    status, out, _ = run(capsys, "check", "--schema", "robot")
    assert status == 0 and json.loads(out) == schema_of("robot")
    file = tmp_path / "editor" / "scene.json"
    status, out, _ = run(capsys, "check", "--schema", "scene", "-o", str(file))
    assert out == f"{file}\n" and json.loads(file.read_text()) == schema_of("scene")


@pytest.mark.thorough
@pytest.mark.parametrize("n", [1, 2, 6, 7, 64])
def test_new_robot_is_valid_and_moves_from_packets(
    n: int, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    status, out, _ = run(capsys, "new", "mine", "--joints", str(n))
    assert status == 0
    assert out.splitlines()[-2:] == ["  sero-mj send mine.toml", "  sero-mj view mine.toml"]
    scene = load_scene("mine.toml", {"mine.show_axes": True})
    scene.sources["udp"]["port"] = 0
    robot = scene.robots["mine"]
    assert robot.n == n and len(robot.torque_limits) == n
    with Mirror(scene) as mirror:
        assert mirror.sources["udp"].structure == f"{n}F{n}F"
    assert World(scene, dynamic=True).model.nv == n
    for kind, file in (("robot", "mine/robot.toml"), ("scene", "mine.toml")):
        text = Path(file).read_text()
        assert found(kind, tomllib.loads(text)) == []
        named = text.splitlines()[0].removeprefix("#:schema ")
        assert json.loads((Path(file).parent / named).read_text()) == schema_of(kind)
    low, high = robot.position_limits.T
    assert ((low < robot.home) & (robot.home < high)).all()
    reach = np.linalg.norm(robot.fwd_kin_base_to_flange(robot.home)[:3, 3])
    assert 0.3 < reach < 3.0


@pytest.mark.parametrize("like", ["lwr", "panda"])  # the latter has meshes of another robot
def test_copy_equals_the_original_robot(
    like: str, capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(capsys, "new", "ours", "--like", like)[0] == 0
    ours, original = SerialRobot.from_model("ours/robot.toml"), SerialRobot.from_model(like)
    np.testing.assert_array_equal(ours.dh_params, original.dh_params)
    made, there = (World(Scene(robots=[robot])).model for robot in (ours, original))
    np.testing.assert_array_equal(made.mesh_vert, there.mesh_vert)
    assert Path("ours/meshes").is_dir() and Path(ours.directory).is_relative_to(tmp_path)
    again = run(capsys, "new", "theirs", "--like", "ours")
    assert again[0] == 0
    assert Path("theirs/robot.toml").read_text().count("#:schema") == 1


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("taken",), "taken already exists; choose another name"),
        (("scened",), "scened.toml already exists; choose another name"),
        (("a b",), "NAME: found 'a b'; expected letters, digits, _ and -"),
        (("../up",), "NAME: found '../up'"),
        (("x", "--joints", "0"), "found '0'; expected a whole number from 1 to 64"),
        (("x", "--like", "lwrr"), "no robot model 'lwrr'; did you mean 'lwr'?"),
        (("x", "--like", "lwr", "--joints", "3"), "--joints cannot be combined with --like"),
    ],
)
def test_new_overwrites_nothing_and_rejects_invalid_names(
    arguments: tuple[str, ...],
    expected: str,
    capsys: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("taken").mkdir()
    Path("scened.toml").write_text("")
    before = sorted(tmp_path.rglob("*"))
    status, _, err = run(capsys, "new", *arguments)
    assert status == 2 and expected in err
    assert sorted(tmp_path.rglob("*")) == before


def test_copy_of_a_robot_in_another_format_suggests_import(
    capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text("<robot name='arm'/>")
    status, _, err = run(capsys, "new", "ours", "--like", "arm.urdf")
    assert status == 2 and not Path("ours").exists()
    assert "--like: found arm.urdf; expected a robot in TOML. Run `sero-mj import arm.urdf" in err


def test_new_rejects_a_scene_and_an_invalid_robot_as_template(
    capsys: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    file = ROOT / "scenes" / "scenarios" / "hand_guiding.toml"
    status, _, err = run(capsys, "new", "ours", "--like", str(file))
    assert status == 2 and f"--like: found {file}, a scene or scenario" in err
    Path("wrong.toml").write_text('dh_convention = "craig"\ndh_params = [[0.0, 0.0]]\n')
    status, _, err = run(capsys, "new", "ours", "--like", "./wrong.toml")
    assert status == 2 and "wrong.toml:2: dh_params" in err
    assert not Path("ours").exists()
