"""`SerialRobot`: the proto's defaults, and validation errors."""

from __future__ import annotations

import datetime
import math
import re

import numpy as np
import pytest
from conftest import raises_with

from sero_mj.base.errors import DeclarationError, Problem, shown
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.surroundings import Object
from sero_mj.robots.importers.mesh_files import mesh_endings
from sero_mj.robots.kinematics.dh import COLUMNS

ORDERED = "a lower limit below the upper limit"
TWO_JOINTS = [[0, 0, 0, 0.3], [0, 0.4, 0, 0]]


def robot(**fields) -> SerialRobot:
    return SerialRobot(**{"dh_convention": "craig", **fields})


def refusal(**fields) -> str:
    with pytest.raises(DeclarationError) as caught:
        robot(**fields)
    return str(caught.value)


def test_robot_has_the_defaults_of_the_proto_in_the_paper():
    # PAPER.md, Fig. 3. dhConvention is ours and has no default.
    bare = robot()
    assert bare.name == "robot"
    np.testing.assert_array_equal(bare.dh_params, [[0, 0, 0, 0]])
    assert (bare.directory, bare.filenames, bare.children) == ("", [], [])
    np.testing.assert_array_equal(bare.base_frame, np.eye(4))
    np.testing.assert_array_equal(bare.flange_frame, np.eye(4))
    np.testing.assert_array_equal(bare.home, [0])
    assert bare.enable_touch_sensor is True
    np.testing.assert_array_equal(bare.offsets, [[0, 0, 0]])
    assert (bare.show_axes, bare.show_arrows, bare.show_billboards) == (False, False, False)
    assert (bare.axes_size, bare.axes_transparency) == (0.2, 0)
    assert (bare.arrow_radius, bare.arrow_width_scale) == (0.1, 0.01)
    assert bare.billboard_scale == 0.05
    assert (bare.torques, bare.billboard_values) == (None, None)  # events: nothing received yet
    assert (bare.n, bare.names, bare.types) == (1, ["J1"], ["revolute"])


def test_default_frames_are_not_shared_between_robots():
    robot().base_frame[0, 3] = 1.0
    assert robot().base_frame[0, 3] == 0.0


def test_dh_params_can_be_flat_as_in_the_paper():
    # PAPER.md, Fig. 7, number by number.
    flat = [0, 0, 0, 0.31, 1.5708, 0, 0, 0, -1.5708, 0, 0, 0.4, -1.5708, 0, 0, 0,
            1.5708, 0, 0, 0.39, 1.5708, 0, 0, 0, -1.5708, 0, 0, 0]  # fmt: skip
    offsets = [0, 0, -0.2, 0, 0, 0, 0, 0, -0.2, 0, 0, 0, 0, 0, -0.2, 0, 0, 0, 0, 0, 0.1]
    paper = robot(dh_params=flat, offsets_to_center_of_joints=offsets)
    assert paper.n == 7
    assert paper.dh.alpha.tolist() == [0, 1.5708, -1.5708, -1.5708, 1.5708, 1.5708, -1.5708]
    assert paper.dh.d.tolist() == [0.31, 0, 0.4, 0, 0.39, 0, 0]
    assert not paper.dh.a.any() and not paper.dh.theta.any()
    assert paper.offsets[:, 2].tolist() == [-0.2, 0, -0.2, 0, -0.2, 0, 0.1]


def test_dh_columns_can_be_permuted():
    permuted = robot(dh_columns=["d", "theta", "a", "alpha"], dh_params=[[4, 3, 2, 1]])
    assert [getattr(permuted.dh, name)[0] for name in COLUMNS] == [1, 2, 3, 4]


def test_per_joint_fields_are_used_by_the_table():
    mixed = robot(
        dh_params=TWO_JOINTS,
        joint_types=["prismatic", "revolute"],
        joint_names=["rail", "elbow"],
        joint_angles=[0.5, 1],
        dh_convention="standard",
    )
    assert mixed.dh.revolute.tolist() == [False, True]
    assert (mixed.dh.convention, mixed.names) == ("standard", ["rail", "elbow"])
    # By hand: 0.3 + 0.5 along the rail, then 0.4 along x rotated by 1 rad.
    position = [0.4 * math.cos(1), 0.4 * math.sin(1), 0.8]
    np.testing.assert_allclose(mixed.fwd_kin_base_to_flange()[:3, 3], position, atol=1e-15)


def test_limits_in_degrees_are_converted_to_radians():
    in_degrees = robot(
        dh_params=TWO_JOINTS,
        position_limits_deg=[[-170, 170], [-90, 45]],
        velocity_limits_deg=[180, 90],
    )
    np.testing.assert_allclose(
        in_degrees.position_limits,
        [[-17 * math.pi / 18, 17 * math.pi / 18], [-math.pi / 2, math.pi / 4]],
        rtol=1e-15,
    )
    np.testing.assert_allclose(in_degrees.velocity_limits, [math.pi, math.pi / 2], rtol=1e-15)


def test_link_files_can_be_names_tables_lists_and_empty():
    links = robot(
        dh_params=TWO_JOINTS,
        colors={"red": [1, 0, 0, 1]},
        filenames=["a.STL", {"file": "sub/b.obj", "color": "red"}, ["c.msh", {"file": "d.stl"}]],
    ).filenames
    assert [[(m.file, m.color) for m in link] for link in links] == [
        [("a.STL", None)],
        [("sub/b.obj", "red")],
        [("c.msh", None), ("d.stl", None)],
    ]
    assert robot(filenames=[""]).filenames == []  # the proto's default: no geometry
    assert [len(link) for link in robot(filenames=["", "a.stl"]).filenames] == [0, 1]


def test_billboard_lines_can_be_names_and_tables():
    lines = robot(billboard_lines=["torques", {"value": "joint_angles", "scale": 57.3}])
    assert [(line.value, line.scale) for line in lines.billboard_lines] == [
        ("torques", 1.0),
        ("joint_angles", 57.3),
    ]


WRONG = [
    ({"dh_convention": None}, Problem("dh_convention", found=None,
                                      expected="'craig', 'standard' or 'none'")),
    ({"dh_convention": "craigg"},
     Problem("dh_convention", found="craigg", expected="'craig', 'standard' or 'none'",
             available=["craig"])),
    ({"dh_convention": "Modified"},
     Problem("dh_convention", found="Modified",
             expected="'craig', the name of this convention in sero-mj")),
    ({"show_axis": True}, Problem("show_axis", "unknown key", available=["show_axes"])),
    ({"dh_params": [0, 0, 0]}, Problem("dh_params", "found 3; expected n x 4 numbers")),
    ({"dh_params": [[0, 0, 0]]}, Problem("dh_params", "found 1 x 3; expected n x 4 numbers")),
    ({"dh_params": [[0, 0, 0, 0], [0]]}, Problem("dh_params", "expected rows of equal length")),
    ({"dh_params": [["x", 0, 0, 0]]}, Problem("dh_params", found=[['x', 0, 0, 0]],
                                              expected="numbers")),
    ({"dh_params": []}, Problem("dh_params", found=0, of="rows", expected="1 to 128")),
    ({"dh_params": [0.0] * 516}, Problem("dh_params", found=129, of="rows", expected="1 to 128")),
    ({"dh_params": [0, 0, math.nan, 0]},
     Problem("dh_params", found=[0, 0, math.nan, 0], expected="finite numbers without NaN or inf")),
    ({"dh_columns": ["a", "a", "d", "theta"]},
     Problem("dh_columns",
             "found ['a', 'a', 'd', 'theta']; expected alpha, a, theta, d in any order")),
    ({"dh_columns": ["alfa", "a", "d", "theta"]},
     Problem("dh_columns.0", found="alfa", expected="'alpha', 'a', 'theta' or 'd'",
             available=["alpha"])),
    (
        {"joint_types": ["revolut"]},
        Problem("joint_types.0", found="revolut", expected="'revolute' or 'prismatic'",
                available=["revolute"]),
    ),
    ({"dh_params": TWO_JOINTS, "joint_names": ["a", "a"]},
     Problem("joint_names", "'a' appears twice; expected different names")),
    *(({"joint_names": [name]}, Problem("joint_names.0", found=name,
                                        expected="1 to 200 printable characters"))
      for name in ("A1\n", " ", "j\u202e1")),
    ({"position_limits": [[1, -1]]},
     Problem("position_limits", "row 1 is", found=[1.0, -1.0], expected=ORDERED)),
    (
        {"dh_params": TWO_JOINTS, "position_limits": [-1, 1, 2, 2]},
        Problem("position_limits", "row 2 is", found=[2.0, 2.0], expected=ORDERED),
    ),
    ({"position_limits": [1, 2, 3]}, Problem("position_limits", "found 3; expected n x 2 numbers")),
    ({"velocity_limits": [-1]}, Problem("velocity_limits", found=[-1.0],
                                        expected="positive numbers")),
    ({"torque_limits": [0]}, Problem("torque_limits", found=[0.0], expected="positive numbers")),
    ({"torque_limits": 5}, Problem("torque_limits", "found one number; expected n numbers")),
    ({"joint_angles": "x"}, Problem("joint_angles", found="x", expected="numbers")),
    ({"torques": [math.inf]}, Problem("torques", found=[math.inf],
                                      expected="finite numbers without NaN or inf")),
    ({"filenames": 5}, Problem("filenames", found=5, expected="list")),
    ({"filenames": ["", "", "a.stl"]},
     Problem("filenames", found=3, of="entries", expected="2, one for the base and one per joint")),
    (
        {"filenames": ["", "../b.stl"]},
        Problem("filenames.1.0.file", found="../b.stl",
                expected="a file inside the directory, without '..'"),
    ),
    (
        {"filenames": ["", "a/../../b.stl"]},
        Problem("filenames.1.0.file", found="a/../../b.stl",
                expected="a file inside the directory, without '..'"),
    ),
    (
        {"filenames": ["/etc/b.stl", ""]},
        Problem("filenames.0.0.file", found="/etc/b.stl",
                expected="a file inside the directory, without '..'"),
    ),
    (
        {"filenames": ["", "b.doc"]},
        Problem("filenames.1.0.file", found="b.doc",
                expected=f"a mesh file ({', '.join(mesh_endings())})"),
    ),
    (
        {"filenames": ["", {"file": "b.stl", "colour": "red"}]},
        Problem("filenames.1.0.colour", "unknown key", available=["color"]),
    ),
    (
        {"filenames": ["", {"file": "b.stl", "color": "gray"}], "colors": {"grey": [1, 1, 1, 1]}},
        Problem("filenames", "b.stl: no color", found="gray", available=["grey"]),
    ),
    ({"colors": {"red": [1, 0, 0]}}, Problem("colors.red", "found 3; expected 4 numbers")),
    (
        {"colors": {"red": [255, 0, 0, 1]}},
        Problem("colors.red", found=[255.0, 0.0, 0.0, 1.0], expected="four numbers from 0 to 1"),
    ),
    ({"base_frame": [1, 2]},
     Problem("base_frame", found=2, of="numbers",
             expected="4 x 4, or { xyz = [...], rpy = [...] }")),
    ({"flange_frame": {"xzy": [0, 0, 1]}},
     Problem("flange_frame", "unknown key", found="xzy", available=["xyz"])),
    ({"axes_size": -1}, Problem("axes_size", found=-1, expected="greater than 0")),
    ({"axes_size": "big"}, Problem("axes_size", found="big", expected="number")),
    ({"axes_size": True}, Problem("axes_size", found=True, expected="number")),
    ({"axes_transparency": 1.5}, Problem("axes_transparency", found=1.5,
                                         expected="less than or equal to 1")),
    ({"billboard_scale": 0.6}, Problem("billboard_scale", found=0.6,
                                       expected="less than or equal to 0.5")),
    ({"show_axes": "yes"}, Problem("show_axes", found="yes", expected="true or false")),
    (
        {"billboard_lines": ["torque"]},
        Problem("billboard_lines.0.value", found="torque",
                expected="'torques', 'commanded_torques', 'torque_error', 'joint_accelerations', "
                "'joint_angles' or 'billboard_values'; did you mean 'torques'?"),
    ),
    (
        {"children": [{"name": "a", "shape": "sphere", "size": [1]}] * 2},
        Problem("children", "two children have the name 'a'"),
    ),
    ({"children": [{"name": "a", "shpe": "box"}]},
     Problem("children.0.shpe", "unknown key", available=["shape"])),
]  # fmt: skip


@pytest.mark.parametrize(("fields", "problem"), WRONG)
def test_invalid_field_is_rejected_with_found_and_expected_values(fields, problem):
    with pytest.raises(DeclarationError) as caught:
        robot(**fields)
    assert caught.value.problems == [problem]


def test_convention_is_required_and_the_error_lists_the_choices():
    choices = "'craig' or 'standard' or 'none'"
    with raises_with(key="dh_convention", reason="is required", expected=choices):
        SerialRobot()


@pytest.mark.parametrize("field", ["axes_size", "arrow_radius", "arrow_width_scale", "mesh_scale"])
@pytest.mark.parametrize("value", [math.inf, math.nan])
def test_single_number_that_is_not_finite_is_rejected(field, value):
    with pytest.raises(DeclarationError) as caught:
        robot(**{field: value})
    (problem,) = caught.value.problems
    assert (problem.key, str(problem.found)) == (field, str(value))
    assert "finite" in str(problem.expected)


def test_billboard_scale_that_is_not_finite_is_rejected():
    with raises_with(key="billboard_lines.0.scale", found=math.nan, expected="a finite number"):
        robot(billboard_lines=[{"value": "torques", "scale": math.nan}])


@pytest.mark.parametrize("name", ["my arm", "2arm", "a/b", "a.b", ""])
def test_invalid_robot_name_is_rejected_without_showing_a_pattern(name):
    expected = "a name of letters, digits, _ and - that begins with a letter or _"
    with raises_with(key="name", found=name, expected=expected):
        robot(name=name)


def test_key_named_self_is_unknown():
    with raises_with(key="self", reason="unknown key"):
        robot(**{"self": 1})


@pytest.mark.parametrize(
    "field",
    ["joint_types", "joint_names", "velocity_limits", "torque_limits", "joint_angles", "torques",
     "billboard_values", "position_limits", "offsets_to_center_of_joints"],
)  # fmt: skip
def test_field_with_one_entry_per_joint_must_match_the_table(field):
    one = {
        "joint_types": "revolute",
        "joint_names": "a",
        "position_limits": [-1, 1],
        "offsets_to_center_of_joints": [0, 0, 1],
    }.get(field, 1.0)
    with raises_with(key=field, found=1, of="entries", expected="2, one per row of dh_params"):
        robot(dh_params=TWO_JOINTS, **{field: [one]})


def test_all_problems_are_reported_at_once_without_consequent_errors():
    text = refusal(
        dh_params=[[0, 0, 0, "d"]],
        joint_angles=[1, 2],
        torque_limits=[-1, 1],
        children=[{"name": "a", "shape": "blox"}, 5, {"shape": "sphere", "size": [1]}],
        shw_axes=1,
    )
    assert sorted(re.split("[: ]", line)[0] for line in text.splitlines()) == [
        "children.0.shape", "children.1", "children.2.name", "dh_params", "shw_axes",
        "torque_limits",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "value",
    [{"a": 1}, datetime.date(2020, 1, 1), ["abc"], ["90"], [[1], [1, 2]], [True], [None], "x"],
)
@pytest.mark.parametrize("field", ["position_limits_deg", "velocity_limits_deg"])
def test_invalid_limits_in_degrees_are_rejected_by_their_own_key(field, value):
    lines = refusal(**{field: value}).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith(f"{field}: ")
    assert "expected " in lines[0]


def test_invalid_limits_in_degrees_do_not_hide_other_problems():
    lines = refusal(velocity_limits_deg=["abc"], axes_size=-1).splitlines()
    assert sorted(line.split(":")[0] for line in lines) == ["axes_size", "velocity_limits_deg"]


def test_limits_in_both_units_are_rejected_beside_other_problems():
    text = refusal(velocity_limits_deg=[1], velocity_limits=[1], axes_size=-1)
    assert "found both velocity_limits and velocity_limits_deg; expected one of them" in text
    assert "axes_size: found -1; expected greater than 0" in text.splitlines()


def test_pose_in_degrees_is_converted_and_replaces_that_of_a_model():
    degrees = [0, 30, 0, -60, 0, 90, 0]
    bent = SerialRobot.from_model("lwr", joint_angles_deg=degrees)
    np.testing.assert_allclose(bent.joint_angles, np.deg2rad(degrees), rtol=1e-15)
    assert bent.joint_angles_deg is None
    hand = SerialRobot.from_model("hit_finger")  # the last joint is coupled
    bent = SerialRobot.from_model("hit_finger", joint_angles_deg=np.full(hand.coupled.k, 10.0))
    free = np.full(hand.coupled.k, np.deg2rad(10.0))
    np.testing.assert_allclose(bent.joint_angles, hand.coupled.positions(free), rtol=1e-15)
    with raises_with(
        key="joint_angles_deg",
        reason="found both joint_angles and joint_angles_deg; expected one of them",
    ):
        robot(joint_angles=[0], joint_angles_deg=[0])
    with raises_with(
        key="joint_angles_deg",
        reason="is for revolute joints only. Use joint_angles instead, in rad and m",
    ):
        robot(joint_types=["prismatic"], joint_angles_deg=[0])
    with raises_with(key="joint_angles_deg", found=3):
        robot(joint_angles_deg=[0, 0, 0])


def test_limits_in_degrees_are_rejected_for_prismatic_joints():
    text = refusal(joint_types=["prismatic"], velocity_limits_deg=[1])
    wanted = (
        "velocity_limits_deg is for revolute joints only. Use velocity_limits instead, in rad and m"
    )
    assert text.endswith(wanted)


@pytest.mark.parametrize("types", [5, True])
def test_joint_types_that_are_not_a_list_are_rejected_beside_limits_in_degrees(types):
    text = refusal(joint_types=types, velocity_limits_deg=[1])
    assert f"joint_types: found {shown(types)}; expected list" in text.splitlines()


def test_table_in_degrees_is_converted_and_excludes_the_other():
    columns = ["a", "alpha", "d", "theta"]
    turned = robot(dh_params_deg=[[1, 90, 2, 180]], dh_columns=columns)
    np.testing.assert_allclose(turned.dh_params, [[1, math.pi / 2, 2, math.pi]], rtol=1e-15)
    text = refusal(dh_params=[0, 0, 0, 1], dh_params_deg=[90, 0, 0, 2])
    assert "found both dh_params and dh_params_deg" in text
    # The number of joints is unknown, so no error mentions it.
    text = refusal(dh_params_deg=[90, 0, 0], joint_angles=[1, 2])
    assert text == "dh_params_deg: found 3; expected n x 4 numbers"


def test_rejected_assignment_changes_nothing():
    box = Object(name="a", shape="box", size=[1, 2, 3])
    with raises_with(
        reason=(
            "size of a box: found [1.0, 2.0]; expected positive length x, length y, length z in m"
        )
    ):
        box.size = [1, 2]
    assert box.size.tolist() == [1, 2, 3]
    held = robot(joint_angles=[0.5])
    with raises_with(key="joint_angles", found=1, expected="2, one per row of dh_params"):
        held.dh_params = TWO_JOINTS
    assert held.n == 1


def test_robot_repr_has_a_few_lines() -> None:
    assert repr(SerialRobot.from_model("lwr")).splitlines() == [
        "SerialRobot 'lwr': 7 joints, craig DH, reach 1.178 m",
        "  joints: A1, A2, E1, A3, A4, A5, A6",
    ]
    many = SerialRobot(
        name="many",
        dh_convention="none",
        joint_frames=[np.eye(4)] * 30,
        parents=["base", *(f"J{i + 1}" for i in range(9)), *["base"] * 20],
    )
    text = str(many)
    assert len(text.splitlines()) == 10 and len(text) < 600
    assert text.splitlines()[0].startswith("SerialRobot 'many': 30 joints, frames of joints, reach")
    assert ": J1, J2, J3, J4, ..., J7, J8, J9, J10" in text
    assert text.splitlines()[-1] == "  and 13 more limbs"


@pytest.mark.parametrize("field", sorted(SerialRobot.checked_alone))
def test_field_validated_alone_rejects_what_the_constructor_rejects(field) -> None:
    robot = SerialRobot.from_model("lwr")
    with pytest.raises(DeclarationError) as made:
        SerialRobot.from_model("lwr", **{field: object()})
    with pytest.raises(DeclarationError) as assigned:
        setattr(robot, field, object())
    keys = [problem.key for problem in assigned.value.problems]
    assert keys == [problem.key for problem in made.value.problems] == [field]
    assert getattr(robot, field) == getattr(SerialRobot.from_model("lwr"), field)


def test_assignment_keeps_other_fields_and_updates_the_kinematics() -> None:
    robot = SerialRobot.from_model("lwr", flange_tolerance_deg=2.0)
    before, copied = robot.fwd_kin_base_to_flange(), robot.model_copy()
    robot.show_axes = True
    assert robot.kinematics is robot.kinematics
    robot.dh_params = robot.dh_params * [1, 1, 1, 2]
    assert robot.show_axes and robot.flange_tolerance_deg == 2.0
    assert not np.allclose(robot.fwd_kin_base_to_flange(), before)
    np.testing.assert_array_equal(copied.fwd_kin_base_to_flange(), before)
    moved = robot.model_copy(update={"dh_params": copied.dh_params})
    np.testing.assert_array_equal(moved.fwd_kin_base_to_flange(), before)
    with pytest.raises(ValueError, match="read-only"):
        robot.dh_params[0, 3] = 1.0
