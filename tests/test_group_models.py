"""Group models: their robots and poses, overrides in a scene, and errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from poses import chain, move, rot

from sero_mj import DeclarationError, Scene, SerialRobot, World, group_from_model, load_scene
from sero_mj.base.errors import Problem
from sero_mj.cli import main

FINGER = """
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.02], [1.5707963267948966, 0.01, 0, 0]]
flange_frame = { xyz = [0.05, 0, 0] }
"""
HAND = """
show_axes = true
axes_size = 0.03

[robots.index]
model = "finger"
base_frame = { xyz = [0.0, 0.04, 0.1], rpy = [0.3, 0.0, 0.2] }
joint_angles = [0.1, 0.2]

[robots.thumb]
model = "finger"
base_frame = { xyz = [0.03, 0.05, 0.06] }

[robots.nail]
model = "finger"
mount = "thumb/flange"
base_frame = { xyz = [0.0, 0.01, 0.0] }

[groups.two]
robots = ["thumb", "nail"]

[objects.palm]
shape = "box"
size = [0.02, 0.08, 0.1]
frame = { xyz = [0.0, 0.0, 0.05] }
"""
BODY = """
members = ["trunk", "left", "right"]

[robots.trunk]
model = "finger"

[groups.right]
model = "hand"
mount = "trunk/flange"
base_frame = { xyz = [0.0, -0.2, 0.0], rpy = [0.5, 0.0, 0.0] }

[groups.left]
model = "hand"
mirrored = true
mount = "trunk/flange"
base_frame = { xyz = [0.0, 0.2, 0.0], rpy = [-0.5, 0.0, 0.0] }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Returns a folder with a finger, a hand of these, and a body with two hands."""
    for name, text in (("finger/robot", FINGER), ("hand/group", HAND), ("body/group", BODY)):
        (tmp_path / name).parent.mkdir()
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


def loaded(folder: Path, text: str, overrides: dict[str, Any] | None = None) -> Scene:
    (folder / "scene.toml").write_text(text)
    return load_scene(folder / "scene.toml", overrides)


def scene_problems(folder: Path, text: str) -> list[Problem]:
    with pytest.raises(DeclarationError) as caught:
        loaded(folder, text)
    return [
        replace(problem, file=problem.file and problem.file.removeprefix(f"{folder}/"))
        for problem in caught.value.problems
    ]


def changed(folder: Path, name: str, old: str, new: str) -> None:
    file = folder / name
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new))


def finger(*q: float) -> np.ndarray:
    """Returns a finger's flange in its base, computed by hand."""
    steps = (rot(2, q[0]), move(z=0.02), rot(0, np.pi / 2), move(x=0.01), rot(2, q[1]))
    # Craig: the rotation about x precedes a; here both are along x.
    return chain(*steps, move(x=0.05))


def test_group_model_becomes_robots_and_groups_in_the_order_of_its_members(folder: Path) -> None:
    scene = loaded(folder, '[groups.b]\nmodel = "body"\n')
    one = ["index", "thumb", "nail"]
    robots = ["b_trunk", *(f"b_left_{n}" for n in one), *(f"b_right_{n}" for n in one)]
    assert scene.members("b") == robots
    assert scene.members("b_left_two") == ["b_left_thumb", "b_left_nail"]
    assert scene.groups["b"].robots == ["b_trunk", "b_left", "b_right"]
    assert not scene.robots["b_trunk"].show_axes
    assert scene.robots["b_left_nail"].show_axes
    assert scene.robots["b_left_nail"].axes_size == 0.03


def test_members_are_at_the_products_of_their_frames(folder: Path) -> None:
    world = World(loaded(folder, '[groups.b]\nmodel = "body"\nbase_frame = { xyz = [1, 2, 0] }\n'))
    data = world.make_data()
    trunk = chain(move(1, 2, 0), finger(0, 0))
    wrist = chain(trunk, move(0, -0.2, 0), rot(0, 0.5))
    index = chain(move(0, 0.04, 0.1), rot(2, 0.2), rot(0, 0.3), finger(0.1, 0.2))
    nail = chain(move(0.03, 0.05, 0.06), finger(0, 0), move(0, 0.01, 0), finger(0, 0))
    S = np.diag([1.0, -1.0, 1.0, 1.0])
    other = chain(trunk, move(0, 0.2, 0), rot(0, -0.5))
    for name, tip in (("index", index), ("nail", nail)):
        right, left = (world.frame(data, f"b_{side}_{name}/flange") for side in ("right", "left"))
        np.testing.assert_allclose(right, wrist @ tip, atol=1e-9)
        np.testing.assert_allclose(left, other @ S @ tip @ S, atol=1e-9)


@pytest.mark.parametrize("side", ["right", "left"])
def test_objects_of_a_group_model_move_with_it(folder: Path, side: str) -> None:
    world = World(loaded(folder, '[groups.b]\nmodel = "body"\n', {"b_trunk.joint_angles": [1, 2]}))
    data = world.make_data()
    turn = 0.5 if side == "right" else -0.5
    wrist = chain(finger(1, 2), move(0, -0.4 * turn, 0), rot(0, turn))
    palm = data.geom(f"b_{side}_index/palm")
    at = np.vstack([np.c_[palm.xmat.reshape(3, 3), palm.xpos], [0, 0, 0, 1]])
    np.testing.assert_allclose(at, chain(wrist, move(0, 0, 0.05)), atol=1e-9)


def test_scene_overrides_fields_of_members_and_defaults_of_the_group(folder: Path) -> None:
    scene = loaded(
        folder,
        """
        [groups.b]
        model = "body"
        arrow_radius = 0.07
        [groups.b.groups.left]
        axes_size = 0.01
        [groups.b.groups.left.robots.index]
        joint_angles = [0.5, 0.6]
        [groups.b.robots.trunk]
        torque_limits = [5, 6]
        """,
        {"b_right.show_billboards": True},
    )
    index = scene.robots["b_left_index"]
    assert index.joint_angles is not None
    assert (index.joint_angles.tolist(), index.axes_size) == ([0.5, 0.6], 0.01)
    assert scene.robots["b_right_index"].axes_size == 0.03
    assert scene.robots["b_right_nail"].show_billboards and not index.show_billboards
    assert {robot.arrow_radius for robot in scene.robots.values()} == {0.07}
    assert scene.robots["b_trunk"].torque_limits is not None


def test_group_model_is_a_scene_and_is_created_from_python(folder: Path) -> None:
    assert [*load_scene(folder / "hand" / "group.toml").robots] == [
        "hand_index", "hand_thumb", "hand_nail"
    ]  # fmt: skip
    arm = SerialRobot.from_model("lwr", name="arm")
    robots, groups = group_from_model(
        str(folder / "hand"), "left", mount="arm/flange", mirrored=True, show_arrows=True
    )
    scene = Scene(robots=[arm, *robots], groups=groups)
    assert scene.members("left") == ["left_index", "left_thumb", "left_nail"]
    assert all(scene.robots[name].mirrored for name in scene.members("left") or [])
    assert scene.robots["left_nail"].show_arrows
    with raises_with(key="groups.left.mirored", reason="unknown key", near="mirrored"):
        group_from_model(str(folder / "hand"), "left", mirored=True)


def test_errors_in_a_group_model_name_its_file_and_line(folder: Path) -> None:
    changed(folder, "hand/group.toml", "joint_angles = [0.1, 0.2]", "joint_angles = [0.1]")
    changed(folder, "hand/group.toml", '"thumb/flange"', '"thum/flange"')
    changed(folder, "hand/group.toml", "size = [0.02, 0.08, 0.1]", "size = [0.02, 0.08]")
    changed(folder, "hand/group.toml", "axes_size = 0.03", "axes_size = -1.0\naxes_sise = 0.03")
    changed(folder, "hand/group.toml", '["thumb", "nail"]', '["thumb", "nails"]')
    assert scene_problems(folder, '[groups.h]\nmodel = "hand"\n') == [
        Problem("axes_size", found=-1.0, expected="greater than 0", file="hand/group.toml", line=3),
        Problem(
            "axes_sise", "unknown key; did you mean 'axes_size'?", file="hand/group.toml", line=4
        ),
        Problem(
            "robots.index.joint_angles",
            found=1,
            of="entries",
            expected="2, one per row of dh_params",
            file="hand/group.toml",
            line=9,
        ),
        Problem(
            "robots.nail.mount",
            "no frame",
            found="h_thum/flange",
            available=["h_thumb/flange"],
            file="hand/group.toml",
            line=17,
        ),
        Problem(
            "groups.two.robots",
            "no robot or group",
            found="h_nails",
            available=["h_nail"],
            file="hand/group.toml",
            line=21,
        ),
        Problem(
            "objects.palm",
            "size of a box: found [0.02, 0.08]; expected positive length x, length y, length "
            "z in m",
            file="hand/group.toml",
            line=23,
        ),
    ]


def test_errors_in_the_scene_name_its_own_line(folder: Path) -> None:
    text = """[groups.h]
model = "hand"
mount = "arm/flanje"
[groups.h.robots.index]
joint_angles = [1, 2, 3]
[groups.h.robots.tumb]
joint_angles = [1, 2]
[groups.k]
model = "hnd"
[groups.l]
model = "hand"
base_frame = { xzy = [0, 0, 0] }
mirrored = "yes"
[robots.arm]
model = "lwr"
[robots.m_nail]
model = "lwr"
[groups.m]
model = "hand"
"""
    assert scene_problems(folder, text) == [
        Problem(
            "groups.h.mount",
            "no frame",
            found="arm/flanje",
            available=["arm/flange"],
            file="scene.toml",
            line=3,
        ),
        Problem(
            "groups.h.robots.index.joint_angles",
            found=3,
            of="entries",
            expected="2, one per row of dh_params",
            file="scene.toml",
            line=5,
        ),
        Problem(
            "groups.h.robots.tumb",
            "not a member of hand; did you mean 'thumb'?",
            file="scene.toml",
            line=6,
        ),
        Problem(
            "groups.k.model",
            "no model 'hnd' of a group; did you mean 'hand'?",
            file="scene.toml",
            line=9,
        ),
        Problem(
            "groups.l.base_frame",
            "unknown key",
            found="xzy",
            available=["xyz"],
            file="scene.toml",
            line=12,
        ),
        Problem(
            "groups.l.mirrored", found="yes", expected="true or false", file="scene.toml", line=13
        ),
        Problem(
            "robots.m_nail",
            "a robot of a group model already has this name",
            file="scene.toml",
            line=16,
        ),
    ]


def test_group_models_are_found_from_any_working_directory(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changed(folder, "body/group.toml", 'model = "hand"\nmount', 'model = "../hand"\nmount')
    changed(folder, "hand/group.toml", 'shape = "box"', 'mesh = "palm.stl"')
    changed(folder, "hand/group.toml", "size = [0.02, 0.08, 0.1]\n", "")
    scene = f'[groups.b]\nmodel = "{folder.name}/body"\n'
    (folder.parent / "scene.toml").write_text(scene)
    (folder / "scene.toml").write_text('[groups.b]\nmodel = "body"\n')
    palm = (folder / "hand").resolve()
    ways = [
        (folder.parent, "scene.toml"), (folder, "scene.toml"), (folder, "../scene.toml"),
        (folder, "body/group.toml"), (folder / "body", "group.toml"),
        (folder / "body", "../scene.toml"), (folder / "hand", "group.toml"),
    ]  # fmt: skip
    for place, file in ways:
        monkeypatch.chdir(place)
        robots = load_scene(file).robots
        assert len(robots) == (3 if place.name == "hand" else 7), (place, file)
        index = next(robot for name, robot in robots.items() if name.endswith("index"))
        found = [Path(child.directory).resolve() for child in index.children]
        assert found == [palm], (place, file)
    monkeypatch.chdir(folder.parent)
    changed(folder, "finger/robot.toml", "1.5707963267948966", "1.5, 3")
    with pytest.raises(DeclarationError) as caught:
        load_scene("scene.toml")
    lines = {str(problem).partition(": ")[0] for problem in caught.value.problems}
    assert lines == {f"{folder.name}/finger/robot.toml:3"}


def test_group_model_that_contains_itself_is_rejected(folder: Path) -> None:
    changed(
        folder, "hand/group.toml", "[robots.index]", '[groups.x]\nmodel = "body"\n[robots.index]'
    )
    (problem, *_) = scene_problems(folder, '[groups.b]\nmodel = "body"\n')
    circle = "group models contain each other: body in hand in body"
    assert problem == Problem("groups.x.model", circle, file="hand/group.toml", line=6)


def test_values_set_for_group_members_are_reported_by_their_names(folder: Path) -> None:
    (folder / "scene.toml").write_text('[groups.b]\nmodel = "body"\njoint_angles = [1, 2]\n')
    robots = ["trunk", *(f"{side}_{n}" for side in ("left", "right")
                         for n in ("index", "thumb", "nail"))]  # fmt: skip
    each = ", ".join(f"b_{name} 2" for name in robots)
    for setting, text in (
        ({}, f":3: groups.b.joint_angles: found values of 2 joints; expected 14 ({each})"),
        ({"b_trunk.show_axs": 1}, ": b_trunk.show_axs: unknown key; did you mean 'show_axes'?"),
        ({"b.show_axes": 1}, ": b.show_axes: found 1; expected true or false"),
        ({"b.show_axs": 1}, ": b.show_axs: no robot has this field; did you mean 'show_axes'?"),
    ):  # fmt: skip
        with pytest.raises(DeclarationError) as caught:
            load_scene(folder / "scene.toml", {"b.joint_angles": [0.1] * 14, **setting} if setting
                       else None)  # fmt: skip
        assert str(caught.value) == f"{folder}/scene.toml{text}"


def test_single_invalid_group_is_the_only_error(folder: Path) -> None:
    assert scene_problems(folder, '[groups.h]\nmodel = "hnd"\n') == [
        Problem(
            "groups.h.model",
            "no model 'hnd' of a group; did you mean 'hand'?",
            file="scene.toml",
            line=2,
        )
    ]


def test_fk_and_check_list_the_robots_of_a_group(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (folder / "hand", folder / "hand" / "group.toml"):
        with pytest.raises(SystemExit, match="2"):
            main(["check", "--fk", str(name)])
        assert capsys.readouterr().err == (
            f"sero-mj: {name} has 3 robots; choose one with --of: hand_index, hand_thumb, "
            "hand_nail\n"
        )
    changed(folder, "hand/group.toml", 'mount = "thumb', 'couplings.J2.to = "J1"\nmount = "thumb')
    with pytest.raises(SystemExit, match="0"):
        main(["check", str(folder / "hand" / "group.toml")])
    assert (
        "  group   hand: 6 joints, in packets 6 or 5: hand_index 2, hand_thumb 2, hand_nail 2\n"
        in capsys.readouterr().out
    )


def test_objects_of_a_group_model_need_a_base_robot(folder: Path) -> None:
    (folder / "hand/group.toml").write_text('[objects.palm]\nshape = "sphere"\nsize = [0.1]\n')
    reason = "no robot can carry the object; expected one that is neither mounted nor mirrored"
    problem = scene_problems(folder, '[groups.h]\nmodel = "hand"\n')[0]
    assert problem == Problem("objects.palm", reason, file="hand/group.toml", line=1)


def test_group_model_that_contains_itself_through_a_link_is_rejected(folder: Path) -> None:
    (folder / "hand/again").symlink_to(folder / "hand")
    changed(folder, "hand/group.toml", "[objects", '[groups.x]\nmodel = "again"\n[objects')
    circle = "group models contain each other: hand in hand"
    problem = scene_problems(folder, '[groups.h]\nmodel = "hand"\n')[0]
    assert problem == Problem("groups.x.model", circle, file="hand/group.toml", line=23)
