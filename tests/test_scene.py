"""Scene files: reading them, and all their errors at once, with lines."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from pydantic import BaseModel

from sero_mj.base.errors import DeclarationError, Problem
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene, View
from sero_mj.robots.declared.scene_file import read_scene_file

ARM = '[robots.arm]\ndh_convention = "craig"\n'
LIFTED = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]


@pytest.fixture
def read(tmp_path):
    """Reads a scene text and returns the scene and its problems without the folder."""

    def read(text, overrides=None):
        file = tmp_path / "s.toml"
        file.write_text(text, encoding="utf-8")
        scene, problems = read_scene_file(file, overrides)
        return scene, [replace(each, file=each.file and Path(each.file).name) for each in problems]

    return read


def plain(value):
    """Returns lists and dicts of numbers and strings, so that whole robots can be compared."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, BaseModel):
        value = dict(value)
    if isinstance(value, dict):
        return {key: plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, list) else value


def test_ten_line_scene_is_read(read, tmp_path):
    scene, problems = read(
        '[robots.left]\nmodel = "lwr"\nbase_frame = { xyz = [0, 0.5, 0] }\n'
        '[robots.right]\nmodel = "lwr"\nshow_axes = true\n'
        '[sources.udp]\nkind = "udp"\n'
        '[routes]\n"left.torques" = "udp.values0"\n'
    )
    assert problems == []
    assert list(scene.robots) == ["left", "right"]
    assert [robot.name for robot in scene.robots.values()] == ["left", "right"]
    assert scene.robots["left"].base_frame[1, 3] == 0.5
    assert scene.robots["right"].show_axes and not scene.robots["left"].show_axes
    assert scene.sources == {"udp": {"kind": "udp"}}
    assert scene.routes == {"left.torques": "udp.values0"}
    assert (scene.name, scene.file, scene.floor) == ("s", tmp_path / "s.toml", True)
    assert scene.view == View()


def test_every_section_is_read(read):
    scene, problems = read(
        'name = "cell"\nfloor = false\n'
        '[objects.box]\nshape = "box"\nsize = [1, 2, 3]\nframe = { xyz = [1, 0, 0] }\n'
        "[cameras.front]\nposition = [1, 2, 3]\nlook_at = [0, 0, 1]\nfovy_deg = 30\n"
        "[lights.sun]\nposition = [0, 0, 5]\ncast_shadow = false\n"
        '[view]\ncamera = "front"\nazimuth_deg = 10\nlook_at = [1, 1, 1]\n'
    )
    assert problems == []
    assert (scene.name, scene.floor, scene.robots) == ("cell", False, {})
    (box,) = scene.objects
    assert (box.name, box.size.tolist(), box.frame[0, 3]) == ("box", [1, 2, 3], 1)
    camera, light = scene.cameras["front"], scene.lights["sun"]
    assert (camera.look_at.tolist(), camera.fovy_deg) == ([0, 0, 1], 30)
    assert (light.cast_shadow, light.directional) == (False, True)
    assert (scene.view.camera, scene.view.azimuth_deg) == ("front", 10)


MODEL = """
dh_convention = "craig"
dh_params = [0, 0, 0, 0.5]
description = "below"
position_limits = [-2, 2]
torque_limits = [9]
filenames = ["a.stl", "b.stl"]
directory = "meshes"
flange_frame = { xyz = [0, 0, 0.1] }
show_axes = true
axes_size = 0.4
joint_names = ["below"]
colors = { red = [1, 0, 0, 1], blue = [0, 0, 1, 1] }
billboard_lines = ["torques"]
[[children]]
name = "tool"
shape = "sphere"
size = [0.1]
"""


@pytest.mark.parametrize(
    ("field", "written", "expected"),
    [
        ("dh_convention", '"standard"', "standard"),
        ("dh_params", "[[0, 0, 0, 0.7]]", [[0, 0, 0, 0.7]]),
        ("dh_columns", '["d", "a", "theta", "alpha"]', ["d", "a", "theta", "alpha"]),
        ("joint_types", '["prismatic"]', ["prismatic"]),
        ("joint_names", '["above"]', ["above"]),
        ("position_limits", "[[-1, 1]]", [[-1, 1]]),
        ("velocity_limits", "[3]", [3]),
        ("torque_limits", "[5]", [5]),
        ("flange_frame", "{ xyz = [0, 0, 2] }", LIFTED),
        ("base_frame", "{ xyz = [0, 0, 2] }", LIFTED),
        ("joint_angles", "[0.5]", [0.5]),
        ("offsets_to_center_of_joints", "[0, 0, 1]", [[0, 0, 1]]),
        ("show_axes", "false", False),
        ("axes_size", "0.1", 0.1),
        ("description", '"above"', "above"),
        ("torques", "[1]", [1]),
        ("colors", "{ red = [0, 0, 0, 0] }", {"red": [0, 0, 0, 0]}),
        ("children", "[]", []),
        ("filenames", '[""]', []),
        ("billboard_lines", "[]", []),
    ],
)
def test_scene_can_override_any_field_of_a_robot_file(read, tmp_path, field, written, expected):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "robot.toml").write_text(MODEL)
    scene, problems = read(f'[robots.one]\nmodel = "arm"\n{field} = {written}\n')
    assert problems == []
    below = plain(SerialRobot.from_model(str(tmp_path / "arm"), name="one"))
    assert below[field] != expected  # otherwise this would prove nothing
    assert plain(scene.robots["one"]) == {**below, field: expected}


def test_files_are_found_beside_the_scene_or_beside_their_model(read, tmp_path):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "robot.toml").write_text(MODEL)
    scene, problems = read(
        '[robots.a]\nmodel = "arm"\n'
        '[robots.b]\nmodel = "arm"\ndirectory = "own"\n'
        '[robots.c]\ndh_convention = "craig"\nfilenames = ["a.stl", ""]\n'
        '[[robots.c.children]]\nname = "tool"\nmesh = "tool.stl"\ndirectory = "tools"\n'
        '[objects.d]\nmesh = "d.stl"\n'
        '[objects.e]\nmesh = "e.stl"\ndirectory = "parts"\n'
    )
    assert problems == []
    folders = [robot.directory for robot in scene.robots.values()]
    folders += [scene.robots["c"].children[0].directory]
    folders += [item.directory for item in scene.objects]
    wanted = ["arm/meshes", "own", "", "tools", "", "parts"]
    assert folders == [str(tmp_path / folder) for folder in wanted]


EVENT = 'an event such as "udp.values0", or numbers'
WRONG = {
    "robots = 5\nobjects = [1]\ncameras = 'a'\nview = 3\nroutes = 1\nsources = 2\nlights = 4": [
        Problem("robots", found=5, expected="a table [robots]", file="s.toml", line=1),
        Problem("objects", found=[1], expected="a table [objects]", file="s.toml", line=2),
        Problem("cameras", found="a", expected="a table [cameras]", file="s.toml", line=3),
        Problem("view", found=3, expected="a table [view]", file="s.toml", line=4),
        Problem("routes", found=1, expected="a table [routes]", file="s.toml", line=5),
        Problem("sources", found=2, expected="a table [sources]", file="s.toml", line=6),
        Problem("lights", found=4, expected="a table [lights]", file="s.toml", line=7),
    ],
    "\nfloor = 'no'\nname = 3\nobject = 1": [
        Problem("floor", found="no", expected="true, false or 'below'", file="s.toml", line=2),
        Problem("name", found=3, expected="a text", file="s.toml", line=3),
        Problem("object", "unknown section", available=["objects"], file="s.toml", line=4),
    ],
    "\n[robot.arm]\nx = 1": [Problem("robot", "unknown section", available=["robots"],
                                     file="s.toml", line=2)],
    "[robots]\narm = 5\n[objects]\nbox = 'x'": [
        Problem("robots.arm", found=5, expected="a table [robots.arm]", file="s.toml", line=2),
        Problem("objects.box", found="x", expected="a table [objects.box]", file="s.toml", line=4),
    ],
    '[routes]\nlwr.torques = "udp.values0"\nx = true': [
        Problem("routes.lwr", found={'torques': 'udp.values0'},
                expected=f"{EVENT}; put quotes around the whole name",
                file="s.toml", line=2),
        Problem("routes.x", found=True, expected=EVENT, file="s.toml", line=3),
    ],
    "[robots.arm]\n\nmodel = 5": [Problem("robots.arm.model", found=5, file="s.toml", line=3,
                                          expected="the name of a robot")],
    "[robots.arm]\n\nmodel = 'lrw'": [
        Problem("robots.arm.model", "no robot model", found="lrw", available=["lwr"],
                file="s.toml", line=3)
    ],
    "[robots.arm]\ndh_conventoin = 'craig'": [
        Problem("robots.arm.dh_convention", "is required",
                expected="'craig' or 'standard' or 'none'", file="s.toml", line=1),
        Problem("robots.arm.dh_conventoin", "unknown key", available=["dh_convention"],
                file="s.toml", line=2),
    ],
    f"{ARM}children = 5": [Problem("robots.arm.children", found=5, expected="list", file="s.toml",
                                   line=3)],
    "[cameras.a]\nfovy_deg = 180": [
        Problem("cameras.a.position", "is required", file="s.toml", line=1),
        Problem("cameras.a.fovy_deg", found=180, expected="less than 180", file="s.toml", line=2),
    ],
    "[cameras.a]\nposition = [1, 2]\nself = 1": [
        Problem("cameras.a.position", "found 2; expected 3 numbers", file="s.toml", line=2),
        Problem("cameras.a.self", "unknown key",
                available=["fovy_deg", "frame", "look_at", "position"], file="s.toml", line=3),
    ],
    "[cameras.a]\nposition = [1, 2, 3]\nlook_at = [1, 2, 3]": [
        Problem("cameras.a.look_at", found=[1.0, 2.0, 3.0],
                expected="a point that differs from position", file="s.toml", line=3)
    ],
    "[lights.a]\nposition = [0, 0, 1]\ndirection = [0, 0, 0]\ndiffuse = [5, 0, 0]": [
        Problem("lights.a.direction", found=[0.0, 0.0, 0.0],
                expected="a nonzero vector", file="s.toml", line=3),
        Problem("lights.a.diffuse", found=[5.0, 0.0, 0.0], expected="three numbers from 0 to 1",
                file="s.toml", line=4),
    ],
    "[view]\n\ncamera = 'fornt'\n[cameras.front]\nposition = [1, 1, 1]": [
        Problem("view.camera", "no camera", found="fornt", available=["front"], file="s.toml",
                line=3)
    ],
    "[view]\ncamera = 'front'\n[cameras.front]\nposition = [1, 1]": [  # and no second problem
        Problem("cameras.front.position", "found 2; expected 3 numbers", file="s.toml", line=4)
    ],
    "cameras = 5\n[view]\ncamera = 'front'": [
        Problem("cameras", found=5, expected="a table [cameras]", file="s.toml", line=1),
        Problem("view.camera", "no camera", found="front", available=[], file="s.toml", line=3),
    ],
    "[view]\nazimuth_deg = nan\ndistance = inf": [
        Problem("view.azimuth_deg", found=math.nan, expected="a finite number",
                file="s.toml", line=2),
        Problem("view.distance", found=math.inf, expected="a finite number",
                file="s.toml", line=3),
    ],
    "[objects.box]\nshape = 'bix'\nsize = [nan, 1, 1]": [
        Problem("objects.box.shape", found="bix",
                expected="'box', 'sphere', 'cylinder', 'capsule', 'ellipsoid', 'axes' or 'limb'",
                available=["box"], file="s.toml", line=2),
        Problem("objects.box.size", found=[math.nan, 1, 1],
                expected="finite numbers without NaN or inf", file="s.toml", line=3),
    ],
    # Lines of keys that follow values of several lines.
    f"{ARM}dh_params = [\n  [0, 0, 0, 1],\n  [0, 0, 0, 0]\n]\ntorque_limits = [-1, 1]": [
        Problem("robots.arm.torque_limits", found=[-1.0, 1.0], expected="positive numbers",
                file="s.toml", line=7)
    ],
    f'{ARM}description = """\n[note]\naxes_size = 3\n"""\naxes_size = -1': [
        Problem("robots.arm.axes_size", found=-1, expected="greater than 0", file="s.toml", line=7)
    ],
    # U+2028 and U+0085 end a line for str.splitlines, but not in TOML or an editor.
    f"# a\u2028b\u0085c\n{ARM}axes_size = -1": [
        Problem("robots.arm.axes_size", found=-1, expected="greater than 0", file="s.toml", line=4)
    ],
    f"{ARM}[[robots.arm.children]]\nname = 'a'\nshape = 'axes'\n"
    "[[robots.arm.children]]\nname = 'b'\nshape = 'sphere'\nsize = [-1]": [
        Problem("robots.arm.children.1",
                "size of a sphere: found [-1.0]; expected positive radius in m", file="s.toml",
                line=6)
    ],
    f'{ARM}[robots . "my arm"]\n"dh_params" = [1]\ndh_convention = "craig"': [
        Problem("robots.my arm.name", found="my arm",
                expected="a name of letters, digits, _ and - that begins with a letter or _",
                file="s.toml", line=3),
        Problem("robots.my arm.dh_params", "found 1; expected n x 4 numbers", file="s.toml",
                line=4),
    ],
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_all_problems_of_a_file_are_reported_at_once_with_their_lines(read, text):
    _, problems = read(text)
    assert sorted(problems, key=str) == sorted(WRONG[text], key=str)


def test_missing_model_file_is_reported_with_the_line_of_its_name(read, tmp_path):
    _, (problem,) = read("[robots.arm]\n\nmodel = 'none.toml'")
    missing = f"{tmp_path / 'none.toml'}: no such file"
    assert problem == Problem("robots.arm.model", missing, file="s.toml", line=3)


def test_problems_of_a_model_and_of_the_scene_have_their_own_files(read, tmp_path):
    (tmp_path / "arm.toml").write_text('dh_convention = "craig"\ntorque_limits = [-1]\n')
    _, problems = read('[robots.one]\nmodel = "arm.toml"\naxes_size = -1\naxes_sise = 1\n')
    assert sorted(problems, key=str) == [
        Problem(
            "torque_limits", found=[-1.0], expected="positive numbers", file="arm.toml", line=2
        ),
        Problem("robots.one.axes_size", found=-1, expected="greater than 0", file="s.toml", line=3),
        Problem(
            "robots.one.axes_sise", "unknown key", available=["axes_size"], file="s.toml", line=4
        ),
    ]


def test_valid_entries_are_read_beside_invalid_ones(read):
    scene, problems = read(f"{ARM}[robots.leg]\n[objects.a]\nshape = 'axes'\n[objects.b]\n")
    assert len(problems) == 2
    assert (list(scene.robots), [item.name for item in scene.objects]) == (["arm"], ["a"])


def test_overrides_replace_values_of_the_file_and_their_routes(read):
    text = (
        f"{ARM}axes_size = 0.5\n"
        '[routes]\n"arm.joint_angles" = "a.values0"\n"arm.torques" = "a.values1"\n'
    )
    scene, problems = read(text, {"arm.joint_angles": [0.25], "arm.axes_size": 0.75})
    assert problems == []
    assert (scene.robots["arm"].home.tolist(), scene.robots["arm"].axes_size) == ([0.25], 0.75)
    assert scene.routes == {"arm.torques": "a.values1"}


@pytest.mark.parametrize(
    ("text", "target", "problem"),
    [
        (ARM, "amr.torques", Problem("amr.torques", "no robot", found="amr", of="to set this for",
                                     available=["arm"], file="s.toml")),
        (ARM, "arm.torqes", Problem("robots.arm.torqes", "unknown key", available=["torques"],
                                    file="s.toml", line=1)),
        (ARM, "arm", Problem("arm", "the key has no field", file="s.toml", expected="the names of "
                             "a robot and a field, such as arm.joint_angles")),
        ("x = 1", "arm.torques", Problem("arm.torques", "no robot", found="arm",
                                         of="to set this for", available=[], file="s.toml")),
        ("robots = 5", "arm.torques", Problem("arm.torques", "no robot", found="arm",
                                              of="to set this for", available=[], file="s.toml")),
        (f"routes = 5\n{ARM}", "arm.torques", Problem("routes", found=5,
                                                      expected="a table [routes]", file="s.toml",
                                                      line=1)),
    ],
)  # fmt: skip
def test_unknown_overrides_are_problems(read, text, target, problem):
    assert problem in read(text, {target: [1.0]})[1]


@pytest.mark.parametrize(
    ("fields", "problem"),
    [
        ({"robots": "lwr"}, Problem("robots", found="lwr", expected="a list of SerialRobot")),
        (
            {"doubles": [{"of": "lwr"}]},
            Problem("doubles", found=[{"of": "lwr"}], expected="a list of Double"),
        ),
        ({"objects": [3]}, Problem("objects", found=[3], expected="a list of Object")),
        (
            {"cameras": {"a": 3}},
            Problem("cameras", found={"a": 3}, expected="a mapping from names to Camera"),
        ),
        ({"sources": [3]}, Problem("sources", found=[3], expected="a mapping from names")),
        ({"view": {"look": "dark"}}, Problem("view", found={"look": "dark"}, expected="a View")),
    ],
)
def test_values_of_another_type_are_rejected(fields, problem):
    with pytest.raises(DeclarationError) as caught:
        Scene(**fields)
    assert caught.value.problems == [problem]


def test_two_robots_with_one_name_are_rejected():
    robots = [SerialRobot(name="arm", dh_convention="craig") for _ in range(2)]
    expected = "different names"
    with raises_with(key="robots.arm", found="arm", expected=expected):
        Scene(robots=robots)


@pytest.mark.parametrize(
    ("contents", "text"),
    [
        (None, "no such file"),
        (b"\xff\xfe", "is not UTF-8 text (byte 0)"),
        (b"a = 1\nb = \n", "not valid TOML: Invalid value (at line 2, column 5)"),
        (b"a = 1\na = 2\n", "not valid TOML: Cannot overwrite a value (at line 2, column 6)"),
        (b"a = " + b"[" * 10_000, "not valid TOML: "),
        (b"a = " + b"1" * 5_000, "not valid TOML: "),
    ],
)
def test_file_that_is_not_toml_is_rejected_with_its_name(tmp_path, contents, text):
    file = tmp_path / "s.toml"
    if contents is not None:
        file.write_bytes(contents)
    with pytest.raises(DeclarationError) as caught:
        read_scene_file(file)
    line = ":2" if "line 2" in text else ""
    colon = "" if text.startswith("is") else ":"
    assert str(caught.value).startswith(f"{file}{line}{colon} {text}")
    assert "\n" not in str(caught.value)


def test_folder_in_place_of_a_file_is_rejected(tmp_path):
    with pytest.raises(DeclarationError) as caught:
        read_scene_file(tmp_path)
    assert str(caught.value) == f"{tmp_path} cannot be read: Is a directory"


def test_urdf_robot_in_a_scene_is_on_the_floor_as_when_opened_alone(tmp_path):
    # As for many humanoids, the base is the trunk.
    (tmp_path / "leg.urdf").write_text(
        '<robot name="leg"><link name="hip"/><link name="shank"><visual><origin xyz="0 0 -0.4"/>'
        '<geometry><box size="0.1 0.1 0.8"/></geometry></visual></link><joint name="knee" '
        'type="continuous"><parent link="hip"/><child link="shank"/><axis xyz="0 1 0"/>'
        '<origin xyz="0 0 -0.3"/></joint></robot>'
    )
    heights = {}
    for name, text in (
        ("stands", '[robots.leg]\nmodel = "leg.urdf"'),
        ("sinks", 'floor = true\n[robots.leg]\nmodel = "leg.urdf"'),
        ("lwr", '[robots.lwr]\nmodel = "lwr"\nbase_frame = { xyz = [0, 0, -0.5] }'),
    ):
        (tmp_path / f"{name}.toml").write_text(text)
        scene = load_scene(str(tmp_path / f"{name}.toml"))
        heights[name] = World(scene).model.geom("floor").pos[2]
    alone = World(load_scene(str(tmp_path / "leg.urdf"))).model.geom("floor").pos[2]
    assert alone == pytest.approx(-1.1, abs=1e-6)
    assert heights == {"stands": alone, "sinks": 0.0, "lwr": 0.0}
    with_leg = Scene(robots=[SerialRobot.from_urdf(tmp_path / "leg.urdf")])
    assert World(with_leg).model.geom("floor").pos[2] == alone
