"""Scene files: what is read, and what is wrong in them, all at once and with the line."""

from __future__ import annotations

import numpy as np
import pytest
from pydantic import BaseModel

from sero_mj.base.errors import DeclarationError
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene, View
from sero_mj.robots.declared.scene_file import read_scene_file

ARM = '[robots.arm]\ndh_convention = "craig"\n'
LIFTED = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2], [0, 0, 0, 1]]


@pytest.fixture
def read(tmp_path):
    """Reads a scene text; returns the scene and its problems with the folder left out."""

    def read(text, overrides=None):
        file = tmp_path / "s.toml"
        file.write_text(text, encoding="utf-8")
        scene, problems = read_scene_file(file, overrides)
        return scene, [str(problem).replace(f"{tmp_path}/", "") for problem in problems]

    return read


def plain(value):
    """Lists and dicts of numbers and words, so that whole robots can be compared."""
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
def test_scene_may_set_any_field_over_the_robots_file(read, tmp_path, field, written, expected):
    (tmp_path / "arm").mkdir()
    (tmp_path / "arm" / "robot.toml").write_text(MODEL)
    scene, problems = read(f'[robots.one]\nmodel = "arm"\n{field} = {written}\n')
    assert problems == []
    below = plain(SerialRobot.from_model(str(tmp_path / "arm"), name="one"))
    assert below[field] != expected  # or this would prove nothing
    assert plain(scene.robots["one"]) == {**below, field: expected}


def test_files_are_looked_for_beside_the_scene_unless_a_model_brings_them(read, tmp_path):
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


EVENT = 'expected an event such as "udp.values0", or numbers'
WRONG = {
    "robots = 5\nobjects = [1]\ncameras = 'a'\nview = 3\nroutes = 1\nsources = 2\nlights = 4": [
        "s.toml:1: robots: found 5; expected a table [robots]",
        "s.toml:2: objects: found [1]; expected a table [objects]",
        "s.toml:3: cameras: found 'a'; expected a table [cameras]",
        "s.toml:4: view: found 3; expected a table [view]",
        "s.toml:5: routes: found 1; expected a table [routes]",
        "s.toml:6: sources: found 2; expected a table [sources]",
        "s.toml:7: lights: found 4; expected a table [lights]",
    ],
    "\nfloor = 'no'\nname = 3\nobject = 1": [
        "s.toml:2: floor: found 'no'; expected true, false or 'below'",
        "s.toml:3: name: found 3; expected a text",
        "s.toml:4: object: unknown section; did you mean 'objects'?",
    ],
    "\n[robot.arm]\nx = 1": ["s.toml:2: robot: unknown section; did you mean 'robots'?"],
    "[robots]\narm = 5\n[objects]\nbox = 'x'": [
        "s.toml:2: robots.arm: found 5; expected a table [robots.arm]",
        "s.toml:4: objects.box: found 'x'; expected a table [objects.box]",
    ],
    '[routes]\nlwr.torques = "udp.values0"\nx = true': [
        "s.toml:2: routes.lwr: found {'torques': 'udp.values0'}; "
        f"{EVENT}; put quotes about the whole name",
        f"s.toml:3: routes.x: found True; {EVENT}",
    ],
    "[robots.arm]\n\nmodel = 5": ["s.toml:3: robots.arm.model: found 5; expected a robot's name"],
    "[robots.arm]\n\nmodel = 'lrw'": [
        "s.toml:3: robots.arm.model: no robot model 'lrw'; did you mean 'lwr'?"
    ],
    "[robots.arm]\n\nmodel = 'none.toml'": ["s.toml:3: robots.arm.model: none.toml: no such file"],
    "[robots.arm]\ndh_conventoin = 'craig'": [
        "s.toml:1: robots.arm.dh_convention: is required; expected 'craig' or 'standard' or 'none'",
        "s.toml:2: robots.arm.dh_conventoin: unknown key; did you mean 'dh_convention'?",
    ],
    f"{ARM}children = 5": ["s.toml:3: robots.arm.children: found 5; expected list"],
    "[cameras.a]\nfovy_deg = 180": [
        "s.toml:1: cameras.a.position: is required",
        "s.toml:2: cameras.a.fovy_deg: found 180; expected less than 180",
    ],
    "[cameras.a]\nposition = [1, 2]\nself = 1": [
        "s.toml:2: cameras.a.position: found 2; expected 3 numbers",
        "s.toml:3: cameras.a.self: unknown key; available: fovy_deg, frame, look_at, position",
    ],
    "[cameras.a]\nposition = [1, 2, 3]\nlook_at = [1, 2, 3]": [
        "s.toml:3: cameras.a.look_at: found [1.0, 2.0, 3.0]; expected another point than position"
    ],
    "[lights.a]\nposition = [0, 0, 1]\ndirection = [0, 0, 0]\ndiffuse = [5, 0, 0]": [
        "s.toml:3: lights.a.direction: found [0.0, 0.0, 0.0]; expected a direction",
        "s.toml:4: lights.a.diffuse: found [5.0, 0.0, 0.0]; expected three numbers from 0 to 1",
    ],
    "[view]\n\ncamera = 'fornt'\n[cameras.front]\nposition = [1, 1, 1]": [
        "s.toml:3: view.camera: no camera 'fornt'; did you mean 'front'?"
    ],
    "[view]\ncamera = 'front'\n[cameras.front]\nposition = [1, 1]": [  # and no second problem
        "s.toml:4: cameras.front.position: found 2; expected 3 numbers"
    ],
    "cameras = 5\n[view]\ncamera = 'front'": [
        "s.toml:1: cameras: found 5; expected a table [cameras]",
        "s.toml:3: view.camera: no camera 'front'; none is available",
    ],
    "[view]\nazimuth_deg = nan\ndistance = inf": [
        "s.toml:2: view.azimuth_deg: found nan; expected a finite number",
        "s.toml:3: view.distance: found inf; expected a finite number",
    ],
    "[objects.box]\nshape = 'bix'\nsize = [nan, 1, 1]": [
        "s.toml:2: objects.box.shape: found 'bix'; expected 'box', 'sphere', 'cylinder', 'capsule',"
        " 'ellipsoid' or 'axes'; did you mean 'box'?",
        "s.toml:3: objects.box.size: found [nan, 1, 1]; expected finite numbers, no NaN or inf",
    ],
    # Lines of keys that follow values over several lines.
    f"{ARM}dh_params = [\n  [0, 0, 0, 1],\n  [0, 0, 0, 0]\n]\ntorque_limits = [-1, 1]": [
        "s.toml:7: robots.arm.torque_limits: found [-1.0, 1.0]; expected positive numbers"
    ],
    f'{ARM}description = """\n[note]\naxes_size = 3\n"""\naxes_size = -1': [
        "s.toml:7: robots.arm.axes_size: found -1; expected greater than 0"
    ],
    # U+2028 and U+0085 end a line for str.splitlines, not for TOML and not for an editor.
    f"# a\u2028b\u0085c\n{ARM}axes_size = -1": [
        "s.toml:4: robots.arm.axes_size: found -1; expected greater than 0"
    ],
    f"{ARM}[[robots.arm.children]]\nname = 'a'\nshape = 'axes'\n"
    "[[robots.arm.children]]\nname = 'b'\nshape = 'sphere'\nsize = [-1]": [
        "s.toml:6: robots.arm.children.1: size of a sphere: found [-1.0]; expected positive radius"
        " in m"
    ],
    f'{ARM}[robots . "my arm"]\n"dh_params" = [1]\ndh_convention = "craig"': [
        "s.toml:3: robots.my arm.name: found 'my arm'; expected letters, digits, _ and -, "
        "the first a letter or _",
        "s.toml:4: robots.my arm.dh_params: found 1; expected n x 4 numbers",
    ],
}  # fmt: skip


@pytest.mark.parametrize("text", WRONG, ids=range(len(WRONG)))
def test_all_problems_of_a_file_come_at_once_with_their_lines(read, text):
    _, problems = read(text)
    assert sorted(problems) == sorted(WRONG[text])


def test_problems_of_a_model_carry_its_file_and_those_of_the_scene_the_scenes(read, tmp_path):
    (tmp_path / "arm.toml").write_text('dh_convention = "craig"\ntorque_limits = [-1]\n')
    _, problems = read('[robots.one]\nmodel = "arm.toml"\naxes_size = -1\naxes_sise = 1\n')
    assert sorted(problems) == [
        "arm.toml:2: torque_limits: found [-1.0]; expected positive numbers",
        "s.toml:3: robots.one.axes_size: found -1; expected greater than 0",
        "s.toml:4: robots.one.axes_sise: unknown key; did you mean 'axes_size'?",
    ]


def test_what_is_right_is_kept_beside_what_is_wrong(read):
    scene, problems = read(f"{ARM}[robots.leg]\n[objects.a]\nshape = 'axes'\n[objects.b]\n")
    assert len(problems) == 2
    assert (list(scene.robots), [item.name for item in scene.objects]) == (["arm"], ["a"])


def test_overrides_stand_over_the_file_and_end_its_routes(read):
    text = (
        f"{ARM}axes_size = 0.5\n"
        '[routes]\n"arm.joint_angles" = "a.values0"\n"arm.torques" = "a.values1"\n'
    )
    scene, problems = read(text, {"arm.joint_angles": [0.25], "arm.axes_size": 0.75})
    assert problems == []
    assert (scene.robots["arm"].home.tolist(), scene.robots["arm"].axes_size) == ([0.25], 0.75)
    assert scene.routes == {"arm.torques": "a.values1"}


@pytest.mark.parametrize(
    ("text", "target", "expected"),
    [
        (ARM, "amr.torques", "s.toml: amr.torques: no robot 'amr' to set this for;"
         " did you mean 'arm'?"),
        (ARM, "arm.torqes", "s.toml:1: robots.arm.torqes: unknown key; did you mean 'torques'?"),
        (ARM, "arm", "s.toml: arm: names no field; expected robot.field, e.g. arm.joint_angles"),
        ("x = 1", "arm.torques", "s.toml: arm.torques: no robot 'arm' to set this for;"
         " none is available"),
        ("robots = 5", "arm.torques", "s.toml: arm.torques: no robot 'arm' to set this for;"
         " none is available"),
        (f"routes = 5\n{ARM}", "arm.torques", "s.toml:1: routes: found 5;"
         " expected a table [routes]"),
    ],
)  # fmt: skip
def test_overrides_that_fit_nothing_are_problems(read, text, target, expected):
    assert expected in read(text, {target: [1.0]})[1]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"robots": "lwr"}, "robots: found 'lwr'; expected a list of SerialRobot"),
        ({"doubles": [{"of": "lwr"}]}, "doubles: found [{'of': 'lwr'}]; expected a list of Double"),
        ({"objects": [3]}, "objects: found [3]; expected a list of Object"),
        ({"cameras": {"a": 3}}, "cameras: found {'a': 3}; expected a mapping from names to Camera"),
        ({"sources": [3]}, "sources: found [3]; expected a mapping from names"),
        ({"view": {"look": "dark"}}, "view: found {'look': 'dark'}; expected a View"),
    ],
)
def test_what_is_of_another_type_is_refused(fields, message):
    with pytest.raises(DeclarationError) as caught:
        Scene(**fields)
    assert str(caught.value) == message


def test_two_robots_of_one_name_are_refused():
    robots = [SerialRobot(name="arm", dh_convention="craig") for _ in range(2)]
    with pytest.raises(DeclarationError) as caught:
        Scene(robots=robots)
    text = "robots.arm: two robots have the name 'arm'; expected different names"
    assert str(caught.value) == text


@pytest.mark.parametrize(
    ("contents", "text"),
    [
        (None, "no such file"),
        (b"\xff\xfe", "is not UTF-8 text (byte 0)"),
        (b"a = 1\nb = \n", "is not TOML: Invalid value (at line 2, column 5)"),
        (b"a = 1\na = 2\n", "is not TOML: Cannot overwrite a value (at line 2, column 6)"),
        (b"a = " + b"[" * 10_000, "is not TOML: "),
        (b"a = " + b"1" * 5_000, "is not TOML: "),
    ],
)
def test_file_that_is_no_toml_is_refused_with_its_name(tmp_path, contents, text):
    file = tmp_path / "s.toml"
    if contents is not None:
        file.write_bytes(contents)
    with pytest.raises(DeclarationError) as caught:
        read_scene_file(file)
    line = ":2" if "line 2" in text else ""
    assert str(caught.value).startswith(f"{file}{line}: {text}")
    assert "\n" not in str(caught.value)


def test_folder_in_place_of_a_file_is_refused(tmp_path):
    with pytest.raises(DeclarationError) as caught:
        read_scene_file(tmp_path)
    assert str(caught.value) == f"{tmp_path}: cannot be read: Is a directory"


def test_a_robot_of_a_urdf_stands_on_the_floor_as_when_it_is_opened(tmp_path):
    # As many humanoids: the base is the trunk.
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
