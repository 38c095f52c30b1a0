"""Files: finding them, their errors, and that no other exception is raised."""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import tomllib
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from conftest import examples, raises_with
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

import sero_mj
from sero_mj.base import paths
from sero_mj.base.errors import DeclarationError, Problem, UnknownName, did_you_mean, nearest
from sero_mj.base.toml_file import located
from sero_mj.cli import main
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene_file import read_scene_file

MINIMAL = 'dh_convention = "craig"\n'


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """An empty working directory outside the checkout."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(path: Path, text: str = MINIMAL) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A fake package folder inside a checkout: models `arm` and `leg`, scene `both`."""
    home = tmp_path / "checkout"
    for name in ("leg", "arm"):
        write(home / "models" / name / "robot.toml")
    write(home / "scenes" / "both.toml", "")
    (home / "models" / "empty").mkdir()  # a folder without a robot.toml is not a model
    (home / "sero_mj").mkdir()
    monkeypatch.setattr(paths, "_PACKAGE", home / "sero_mj")
    return home


def test_shipped_robots_and_scenes_are_listed_by_name():
    assert "lwr" in paths.list_models()
    assert "lwr_udp" in paths.list_scenes()


def test_checkout_has_its_files_beside_the_package(package):
    assert paths.models_dir() == package / "models"
    assert paths.scenes_dir() == package / "scenes"
    assert (paths.list_models(), paths.list_scenes()) == (["arm", "leg"], ["both"])


def test_wheel_has_its_files_inside_the_package(package):
    inside = write(package / "sero_mj" / "models" / "hand" / "robot.toml")
    scene = write(package / "sero_mj" / "scenes" / "one.toml")
    assert (paths.list_models(), paths.list_scenes()) == (["hand"], ["one"])
    assert (paths.find_model("hand"), paths.find_scene("one")) == (inside, scene)


def test_model_can_be_a_shipped_name_a_folder_or_a_file(elsewhere, package):
    folder = write(elsewhere / "own" / "robot.toml")
    file = write(elsewhere / "own" / "other.toml")
    assert paths.find_model("arm") == package / "models" / "arm" / "robot.toml"
    assert paths.find_model("own") == folder
    assert paths.find_model(str(elsewhere / "own")) == folder
    assert paths.find_model("own/other.toml") == file


def test_model_beside_the_scene_takes_precedence_over_shipped_ones(elsewhere, package):
    beside = write(elsewhere / "scenes" / "arm" / "robot.toml")
    assert paths.find_model("arm", beside.parents[1]) == beside
    assert paths.find_model("leg", beside.parents[1]) == package / "models/leg/robot.toml"
    with pytest.raises(UnknownName):  # relative names start at the scene, not here
        paths.find_model("scenes/arm", beside.parents[1])


def test_scene_can_be_a_file_or_a_shipped_name(elsewhere, package):
    file = write(elsewhere / "my.toml")
    assert paths.find_scene("my.toml").resolve() == file
    assert paths.find_scene("both") == package / "scenes" / "both.toml"


@pytest.mark.parametrize(
    ("find", "name", "text"),
    [
        ("find_model", "amr", "no robot model 'amr'; did you mean 'arm'?"),
        ("find_model", "xyz", "no robot model 'xyz'; available: arm, leg"),
        ("find_model", "empty", "no robot model 'empty'; available: arm, leg"),
        ("find_scene", "bot", "no scene 'bot'; did you mean 'both'?"),
        ("find_scene", "xyz", "no scene 'xyz'; available: both"),
    ],
)
def test_unknown_name_is_rejected_with_the_nearest_or_all(elsewhere, package, find, name, text):
    with pytest.raises(UnknownName) as caught:
        getattr(paths, find)(name)
    assert str(caught.value) == text
    assert (caught.value.name, caught.value.available) == (
        name,
        ["both"] if find == "find_scene" else ["arm", "leg"],
    )


def test_broken_link_is_reported(elsewhere):
    Path("x.toml").symlink_to("gone.toml")
    with pytest.raises(DeclarationError) as caught:
        paths.find_scene("x.toml")
    assert str(caught.value) == "x.toml is a link to gone.toml, which does not exist"


@pytest.mark.parametrize("find", [paths.find_model, paths.find_scene])
@pytest.mark.parametrize("name", ["a" * 300, "nul\0", "", ".", "a/b/../.."])
def test_invalid_file_name_is_an_unknown_name(elsewhere, find, name):
    with pytest.raises(UnknownName):
        find(name)


def test_nearest_name_ignores_case_and_must_be_similar():
    assert nearest("LWR", ["hand", "lwr"]) == "lwr"
    assert nearest("joint_angels", ["joint_angles", "torques"]) == "joint_angles"
    assert nearest("xyz", ["hand", "lwr"]) is None
    assert did_you_mean("x", []) == "; none is available"
    assert did_you_mean("x", ["b", "a"]) == "; available: a, b"


def test_problem_contains_known_file_line_key_and_message():
    assert str(Problem("", "is wrong")) == "is wrong"
    assert str(Problem("a.b", "is wrong", "f.toml")) == "f.toml: a.b is wrong"
    assert str(Problem("a.b", "is wrong", "f.toml", 3)) == "f.toml:3: a.b is wrong"
    assert Problem("b", "is wrong", "f.toml", 3).inside("a") == Problem(
        "a.b", "is wrong", "f.toml", 3
    )
    assert [Problem("", "x").inside("a").key, Problem("b", "x").inside("").key] == ["a", "b"]


def file_refusal(folder, text, **overrides) -> str:
    """Returns the error of a robot file, with its path shortened to its name."""
    (folder / "robot.toml").write_text(text)
    with pytest.raises(DeclarationError) as caught:
        SerialRobot.from_model(str(folder), name="arm", **overrides)
    return str(caught.value).replace(f"{folder}/", "")


def test_problems_of_a_robot_file_have_its_name_and_line(tmp_path):
    text = 'dh_convention = "craig"\n\ntorque_limits = [1, 2]\n[colors]\nred = [1]\n'
    assert file_refusal(tmp_path, text).splitlines() == [
        "robot.toml:3: torque_limits: found 2 entries; expected 1, one per row of dh_params",
        "robot.toml:5: colors.red: found 1; expected 4 numbers",
    ]


def test_problems_of_overrides_do_not_name_the_file(tmp_path):
    text = 'dh_convention = "craig"\ntorque_limits = [5]\n'
    assert file_refusal(tmp_path, text, torque_limits=[-1], axes_sise=1).splitlines() == [
        "torque_limits: found [-1]; expected positive numbers",
        "axes_sise: unknown key; did you mean 'axes_size'?",
    ]


def test_limits_in_degrees_of_the_wrong_length_have_their_own_line(tmp_path):
    text = 'dh_convention = "craig"\n\nvelocity_limits_deg = [1, 2]\n'
    assert file_refusal(tmp_path, text) == (
        "robot.toml:3: velocity_limits_deg: found 2 entries; expected 1, one per row of dh_params"
    )


@pytest.mark.parametrize("unit", ["", "_deg"])
@pytest.mark.parametrize("file_unit", ["", "_deg"])
def test_overridden_limits_can_have_another_unit_than_the_file(tmp_path, unit, file_unit):
    (tmp_path / "robot.toml").write_text(
        f'dh_convention = "craig"\nposition_limits{file_unit} = [[-5, 5]]\n'
    )
    overrides = {f"position_limits{unit}": [[-1.0, 1.0]]}
    built = SerialRobot.from_model(str(tmp_path), name="arm", **overrides)
    expected = math.radians(1) if unit else 1.0
    np.testing.assert_allclose(built.position_limits, [[-expected, expected]])


@pytest.mark.parametrize("value", ["5", '"abc"', "{ a = 1 }"])
def test_children_that_are_not_a_list_are_rejected(tmp_path, value):
    text = f'dh_convention = "craig"\nchildren = {value}\n'
    assert file_refusal(tmp_path, text).startswith("robot.toml:2: children: found ")


def test_files_of_a_robot_are_found_beside_its_file(tmp_path):
    text = 'dh_convention = "craig"\ndirectory = "meshes"\n'
    child = '[[children]]\nname = "tool"\nmesh = "tool.stl"\n'
    (tmp_path / "robot.toml").write_text(text + child)
    built = SerialRobot.from_model(str(tmp_path), name="arm")
    assert built.directory == str(tmp_path / "meshes")
    assert built.children[0].directory == str(tmp_path)


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("Überarm_机械臂.xml", "Uberarm"),
        ("机械臂.xml", "robot"),
        ("é 4.urdf", "e_4"),
        ("机1.urdf", "_1"),
        ("a b.urdf", "a_b"),
        ("Ärm 2/robot.toml", "Arm_2"),
        ("robot.toml", "here"),
    ],
)
def test_file_names_become_robot_names(file, name, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert paths.model_name(Path(file)) == name


def test_model_has_its_folder_name_unless_a_name_is_set(tmp_path):
    folder = tmp_path / "gripper"
    folder.mkdir()
    (folder / "robot.toml").write_text('dh_convention = "craig"\n')
    assert SerialRobot.from_model(str(folder)).name == "gripper"
    assert SerialRobot.from_model(str(folder / "robot.toml"), name="left").name == "left"


WORDS = st.sampled_from(
    ["robots", "objects", "cameras", "lights", "view", "routes", "sources", "floor", "name", "arm",
     "model", "dh_convention", "dh_params", "joint_types", "position_limits_deg", "base_frame",
     "velocity_limits_deg", "children", "filenames", "colors", "directory", "torque_limits", "xyz",
     "shape", "size", "mesh", "mjcf", "position", "look_at", "camera", "rgba", "self", "frame",
     "billboard_lines", "quat"]
)  # fmt: skip
TEXT = st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=8)
VALUES = st.recursive(
    st.sampled_from(["lwr", "craig", "box", "prismatic", "a.stl", 2**70, 1e200])
    | st.none() | st.booleans() | st.integers(-9, 9) | st.floats() | TEXT,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(WORDS | TEXT, inner, max_size=4),
    max_leaves=12,
)  # fmt: skip
ROBOTS = st.dictionaries(WORDS, VALUES, max_size=6).map(lambda t: {"dh_convention": "craig", **t})
SECTIONS = ("robots", "objects", "cameras", "lights", "view", "routes", "sources", "floor", "name")
SCENES = st.fixed_dictionaries(
    {},
    optional={key: VALUES | st.dictionaries(WORDS, VALUES, max_size=2) for key in SECTIONS}
    | {"robots": VALUES | st.dictionaries(WORDS, ROBOTS, max_size=2)},
)


def toml(value) -> str:
    """Returns a value as TOML; None, which TOML does not have, becomes a date."""
    match value:
        case dict():
            pairs = (f"{toml(str(key))} = {toml(each)}" for key, each in value.items())
            return "{ " + ", ".join(pairs) + " }"
        case list():
            return "[" + ", ".join(map(toml, value)) + "]"
        case str():
            return json.dumps(value, ensure_ascii=False)
        case bool():
            return str(value).lower()
        case None:
            return "1979-05-27T07:32:00Z"
    return repr(value)


def only_declaration_errors(contents: bytes, overrides=None) -> None:
    with TemporaryDirectory() as folder:
        file = Path(folder) / "s.toml"
        file.write_bytes(contents)
        with contextlib.suppress(DeclarationError):
            _, problems = read_scene_file(file, overrides)
            for problem in problems:
                assert problem.file and problem.message


@given(SCENES, st.none() | st.dictionaries(st.sampled_from(["arm.torques", "arm", ""]), VALUES))
@example({"robots": {"arm": {"dh_convention": "craig", "velocity_limits_deg": {}}}}, None)
@example({"cameras": 5, "view": {"camera": "a"}}, None)
@example({"robots": 5, "routes": 5}, {"arm.torques": 1})
@settings(max_examples=examples(120), deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_any_tables_are_read_or_rejected_as_a_declaration(scene, overrides):
    text = "\n".join(f"{key} = {toml(value)}" for key, value in scene.items())
    tomllib.loads(text)  # otherwise this would only test the TOML parser
    only_declaration_errors(text.encode(), overrides)


@given(st.text(max_size=60) | st.text("[]{}=.\"'#\n ab1-", max_size=60))
@settings(max_examples=examples(150), deadline=None)
def test_any_text_is_read_or_rejected_as_a_declaration(text):
    only_declaration_errors(text.encode("utf-8", "surrogatepass"))


@given(st.binary(max_size=40))
@settings(max_examples=examples(60), deadline=None)
def test_any_bytes_are_read_or_rejected_as_a_declaration(contents):
    only_declaration_errors(contents)


NAMES = st.sampled_from(["a", "floor", "key", "sky", "arm", "a/b", "a b", "world", ""])
NUMBERS = st.sampled_from([0, 1, -0.5])
POINTS = st.lists(NUMBERS, min_size=3, max_size=3)
THINGS = st.sampled_from(
    [{"shape": "axes"}, {"mjcf": "<mujoco/>"}, {"shape": "sphere", "size": [1]}]
)
SOUND_SCENES = st.fixed_dictionaries(
    {
        "robots": st.dictionaries(NAMES, st.just({"dh_convention": "craig"}), max_size=2),
        "objects": st.dictionaries(NAMES, THINGS, max_size=2),
        "cameras": st.dictionaries(
            NAMES, st.fixed_dictionaries({"position": POINTS, "look_at": POINTS}), max_size=2
        ),
        "lights": st.dictionaries(
            NAMES, st.fixed_dictionaries({"position": POINTS, "direction": POINTS}), max_size=2
        ),
        "floor": st.booleans(),
        "name": NAMES,
    }
)


@given(SOUND_SCENES)
@settings(max_examples=examples(60), deadline=None)
def test_scene_without_problems_compiles_or_names_the_invalid_part(scene):
    with TemporaryDirectory() as folder:
        file = Path(folder) / "s.toml"
        file.write_text("\n".join(f"{key} = {toml(value)}" for key, value in scene.items()))
        read, problems = read_scene_file(file)
        try:
            world = World(read)
        except DeclarationError as error:
            assert all(problem.key for problem in error.problems)
            return
        if not problems:
            assert set(world.robots) == set(scene["robots"])
        for part in world.robots.values():
            assert part.bodies.min() > 0 and part.flange_body > 0


def test_importing_the_package_does_not_import_mujoco():
    # `import mujoco` fixes the OpenGL backend, so no module may import it as a side effect.
    code = "import sys, sero_mj; dir(sero_mj); print('mujoco' in sys.modules)"
    home = Path(sero_mj.__file__).parents[1]
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=home, capture_output=True, text=True, check=True
    )
    assert done.stdout == "False\n"


@pytest.mark.parametrize("name", sorted(sero_mj._HOME))
def test_public_name_is_what_its_module_defines(name):
    assert getattr(sero_mj, name).__name__ == name
    assert getattr(sero_mj, name).__module__ == f"sero_mj.{sero_mj._HOME[name]}"
    assert name in dir(sero_mj)


def test_unknown_public_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"^module 'sero_mj' has no attribute 'Robot'$"):
        _ = sero_mj.Robot


def test_version_equals_that_of_the_project_file():
    project = Path(__file__).parents[1] / "pyproject.toml"
    assert tomllib.loads(project.read_text())["project"]["version"] == sero_mj.__version__


def test_robots_beside_a_scene_are_suggested(tmp_path: Path) -> None:
    (tmp_path / "kestrel").mkdir()
    (tmp_path / "kestrel" / "robot.toml").write_text("")
    with raises_with(UnknownName, kind="robot model", name="kestrl", near="kestrel"):
        paths.find_model("kestrl", tmp_path)
    with pytest.raises(UnknownName) as caught:
        paths.find_model("nothing_like_it", tmp_path)
    assert {"kestrel", "lwr"} <= set(caught.value.available)


def test_file_named_without_its_suffix_is_suggested(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "gripper6.toml").write_text("")
    monkeypatch.chdir(tmp_path)
    hint = "; did you mean the file gripper6.toml?"
    with raises_with(
        UnknownName,
        kind="scene",
        name="gripper6",
        hint=hint,
        args=(f"no scene 'gripper6'{hint}",),
    ):
        paths.find_scene("gripper6")
    with pytest.raises(SystemExit) as caught:
        main(["check", "gripper6"])
    assert caught.value.code == 2
    assert capsys.readouterr().err == f"sero-mj: no scene or robot 'gripper6'{hint}\n"


def test_array_entry_has_its_own_line(tmp_path: Path) -> None:
    file = tmp_path / "x.toml"
    file.write_text(
        '[robots.arm]\nlines = [\n  { value = "a", unit = "deg" },\n  # no ], and no entry\n'
        '  "b", "c",\n  [1,\n   2],\n]\na.b = [[1, 2],\n  [3, 4]]\nc = """[\n1"""\n'
    )

    def line(key: str) -> int | None:
        return located([Problem(f"robots.arm.{key}", "")], file)[0].line

    assert line("lines") == 2
    assert [line(f"lines.{i}") for i in range(4)] == [3, 5, 5, 6]
    assert (line("lines.0.unit"), line("lines.3.1")) == (3, 6)
    assert [line(key) for key in ("a.b.0", "a.b.1", "a.b.1.1", "c")] == [9, 10, 10, 11]


MJCF = '<mujoco><worldbody><body><joint axis="0 0 1"/><geom size=".1"/></body></worldbody></mujoco>'


def test_third_party_folder_opens_its_scene_or_its_only_model(elsewhere):
    robot = write(elsewhere / "ur16e" / "ur16e.xml", MJCF)
    write(elsewhere / "ur16e" / "package.xml", "<package/>")
    write(elsewhere / "ur16e" / "assets" / "base.obj", "")
    assert paths.find_model("ur16e/") == robot
    own = write(elsewhere / "fr3" / "fr3.xml", MJCF)
    assert paths.find_model("fr3/") == own  # and not the shipped one
    inner = write(elsewhere / "talos_data" / "robots" / "talos.urdf", "<robot/>")
    assert paths.find_model("talos_data") == inner
    write(elsewhere / "ur16e" / "ur16e_mjx.xml", MJCF)
    with pytest.raises(DeclarationError) as caught:
        load_scene("ur16e")
    (problem,) = caught.value.problems
    assert problem.message == (
        "found 2 models in this folder; expected one of ur16e.xml, ur16e_mjx.xml"
    )
    scene = write(elsewhere / "ur16e" / "scene.xml", '<mujoco><include file="ur16e.xml"/></mujoco>')
    assert paths.find_model("ur16e") == scene
    assert list(load_scene("ur16e").robots) == ["ur16e"]


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("arm.sdf", "<sdf/>", "an SDF file"),
        ("arm.usda", "#usda 1.0\n", "a USD file"),
        ("arm.doc", "an arm", "not a robot or scene file"),
    ],
)
def test_model_in_another_format_is_reported_with_its_format(elsewhere, name, text, what):
    write(elsewhere / name, text)
    scene = write(elsewhere / "s.toml", f'[robots.arm]\nmodel = "{name}"')
    with pytest.raises(DeclarationError) as caught:
        load_scene(scene)
    assert f"{name} is {what}; expected a file that ends in .toml, .urdf" in str(caught.value)
