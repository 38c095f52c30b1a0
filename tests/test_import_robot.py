"""`sero-mj import` writes a robot folder in our format for the same robot as in its URDF."""

from __future__ import annotations

import os
import re
import shutil
from itertools import chain
from pathlib import Path

import mujoco
import numpy as np
import pytest
import trimesh
from conftest import raises_with
from PIL import Image
from test_mesh_files import COLLADA
from test_mjcf_robot import TWO_LEGS
from test_urdf import BALL, CHAIN, GRIPPER, poses_in_xml, write

from sero_mj import HeadlessRenderer, Scene, SerialRobot, load_scene
from sero_mj.base import paths
from sero_mj.base.errors import DeclarationError
from sero_mj.cli import main
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.importers.package_files import ARGUMENTS_VARIABLE, PACKAGES_VARIABLE

ROBOTS = {"tree": GRIPPER, "chain": CHAIN}
MESHES = """<visual><origin xyz="0 0 0.3"/><geometry>
<mesh filename="package://arm_meshes/visual/two.dae"/></geometry></visual>
<visual><geometry><mesh filename="package://arm_meshes/box.stl" scale="0.1 0.2 0.1"/></geometry>
<material name="red"/></visual></link>
  <joint name="turn.table\""""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Returns robots with meshes in a package that is found only through an option."""
    package = tmp_path / "far" / "away"
    (package / "visual").mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export(package / "box.stl")
    Image.new("RGB", (4, 4), (255, 128, 0)).save(package / "visual" / "orange.png")
    text = COLLADA.format(picture="orange.png", second="pic")
    (package / "visual" / "two.dae").write_text(text, encoding="utf-8")
    for name, text in ROBOTS.items():
        meshes = text.replace('</link>\n  <joint name="turn.table"', MESHES, 1)
        assert meshes != text
        write(tmp_path, meshes, f"{name}.urdf")
    monkeypatch.setenv(PACKAGES_VARIABLE, "")
    monkeypatch.setenv(ARGUMENTS_VARIABLE, "")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as ended:
        main([*arguments])
    return int(ended.value.code or 0)


def same(one: SerialRobot, other: SerialRobot) -> None:
    """Asserts that both are the same robot; positions to 1e-9 m."""
    assert one.names == other.names and one.types == other.types
    assert (one.carriers is None) == (other.carriers is None)
    for q in np.random.default_rng(0).uniform(-2, 2, (10, one.n)):
        frames = one.kinematics.frames(q), other.kinematics.frames(q)
        assert np.allclose(*frames, rtol=0, atol=1e-9)
        flanges = one.fwd_kin_base_to_flange(q), other.fwd_kin_base_to_flange(q)
        assert np.allclose(*flanges, rtol=0, atol=1e-9)
    mine, its = robot_dynamics(one), robot_dynamics(other)
    for key in ("masses", "centers", "tensors", "viscous_friction", "coulomb_friction"):
        assert np.allclose(getattr(mine, key), getattr(its, key), rtol=1e-9, atol=1e-12), key
    for key in ("position_limits", "velocity_limits", "torque_limits", "home"):
        found, expected = getattr(one, key), getattr(other, key)
        assert (found is None) == (expected is None)
        assert found is None or np.allclose(found, expected), key
    assert one.flange_link == other.flange_link and one.couplings.keys() == other.couplings.keys()
    for name, coupling in one.couplings.items():
        assert coupling.model_dump() == pytest.approx(other.couplings[name].model_dump())
    for key in ("filenames", "collisions"):
        links = getattr(one, key) or [], getattr(other, key) or []
        assert [len(link) for link in links[0]] == [len(link) for link in links[1]]
        for a, b in zip(*map(chain.from_iterable, links), strict=True):
            assert (a.shape, a.color) == (b.shape, b.color)
            assert np.allclose(a.frame, b.frame, atol=1e-12)
    assert {k: v.tolist() for k, v in one.colors.items()} == {
        k: v.tolist() for k, v in other.colors.items()
    }


@pytest.mark.parametrize("name", ROBOTS)
def test_imported_robot_is_the_same(folder: Path, name: str, capsys) -> None:
    option = f"arm_meshes={folder / 'far' / 'away'}"
    assert run("import", f"{name}.urdf", "--out", "my_arm", "--package", option) == 0
    robot = SerialRobot.from_model(str(folder / "my_arm"))
    packages = {"arm_meshes": folder / "far" / "away"}
    same(robot, SerialRobot.from_urdf(folder / f"{name}.urdf", packages))
    # The file and its folder suffice.
    os.environ[PACKAGES_VARIABLE] = ""
    (folder / "far").rename(folder / "gone")
    files = {path.relative_to(folder / "my_arm" / "meshes").as_posix()
             for path in (folder / "my_arm" / "meshes").rglob("*") if path.is_file()}  # fmt: skip
    assert files == {"box.stl", "visual/two.dae", "visual/orange.png"}
    model = World(load_scene("my_arm")).model
    colours = {tuple(np.round(rgba, 2)) for rgba in model.geom_rgba.tolist()}
    assert {(0.8, 0.1, 0.2, 1.0), (1.0, 0.5, 0.0, 1.0), (0.8, 0.1, 0.1, 1.0)} <= colours
    scene = load_scene("my_arm.toml")
    assert set(scene.routes) == {"my_arm.joint_angles", "my_arm.torques"}
    # k values in packets: the coupled finger follows.
    size = robot.coupled.k
    assert size == {"tree": 3, "chain": 2}[name]
    listed = (folder / "my_arm.toml").read_text()
    assert f'structure = "{size}F{size}F"' in listed
    assert "# Order of the joints in packets:\n#   1 turn.table, 2 slide" in listed
    follows = "# Coupled joints, not in packets (1):\n#   "
    assert (follows in listed) == robot.coupled.is_coupled
    text = (folder / "my_arm" / "robot.toml").read_text(encoding="utf-8")
    assert text.startswith("#:schema ./robot.schema.json\n# Converted from ")
    assert ": joints 1 to 2, turn.table ... slide, on base, to lower\n" in text
    for limb, joints in robot.limb_joints.items():
        assert re.search(rf"^# - {limb}: joints? {joints[0] + 1}\b", text, re.MULTILINE)
    assert re.search(r"^  \[0\.1, 0\.4\], +# slide$", text, re.MULTILINE)
    out = capsys.readouterr().out
    assert "sero-mj send my_arm.toml" in out


def test_fk_and_check_accept_urdf_files(folder: Path, capsys) -> None:
    option = f"arm_meshes={folder / 'far' / 'away'}"
    assert run("check", "tree.urdf", "--package", option) == 0
    assert "robot   tree: 4 joints" in capsys.readouterr().out
    assert run("check", "--fk", "chain.urdf", "--joint-angles", "0.4,0.3", "--json") == 0
    import json

    found = json.loads(capsys.readouterr().out)
    expected = poses_in_xml(CHAIN, {"turn.table": 0.4, "slide": 0.3})["lower"]
    assert np.allclose(found["dh"], expected, rtol=0, atol=1e-9)
    assert found["position_difference"] < 1e-9 and found["angle_difference"] < 1e-9


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["no.urdf"], "no.urdf: no such file"),
        (["robot.toml"], "FILE: expected a name that ends in .urdf, .xacro, .xml"),
        (["arm.usda"], "arm.usda is a USD file; expected URDF, xacro or MJCF"),
        (["ball.urdf"], "ball.urdf:1: robot has no movable joint"),
        (["tree.urdf", "--arg", "ur5e"], "--arg: found 'ur5e'; expected NAME=VALUE"),
        (["no.xml"], "no.xml: no such file"),
        (["sdf.xml"], "sdf.xml is an SDF file; expected URDF (<robot>) or MJCF (<mujoco>)"),
        (["text.xml"], "text.xml is not XML"),
        (
            ["fig7.x3d"],
            "fig7.x3d: found a scene; expected a robot in URDF or MJCF. "
            "`sero-mj view fig7.x3d` shows the scene.",
        ),
        (["tree.urdf", "--out", "far"], "far already exists; choose another with --out"),
        (["tree.urdf", "--out", "1st"], "--out: found '1st'; expected letters"),
        (["tree.urdf", "--package", "x"], "--package: found 'x'; expected NAME=DIR"),
        (["tree.urdf", "--package", "x=no"], "--package: found 'no', which is not a folder"),
    ],
)
def test_unreadable_imports_are_reported(folder: Path, capsys, arguments, message) -> None:
    (folder / "mjcf.xml").write_text("<!-- <robot> -->\n<mujoco/>")
    (folder / "sdf.xml").write_text("<?xml version='1.0'?><sdf/>")
    (folder / "text.xml").write_text("no XML")
    (folder / "arm.usda").write_text("#usda 1.0")
    (folder / "ball.urdf").write_text(BALL)
    (folder / "fig7.x3d").write_text("#X3D V3.0 utf8")
    assert run("import", *arguments) == 2
    assert message in capsys.readouterr().err
    assert not (folder / "tree").exists()


def test_urdf_file_can_have_the_suffix_xml(folder: Path, capsys) -> None:
    (folder / "arm").mkdir()
    (folder / "tree.urdf").rename(folder / "arm" / "robot.xml")
    option = f"arm_meshes={folder / 'far' / 'away'}"
    assert run("check", "arm/robot.xml", "--package", option) == 0
    out = capsys.readouterr().out
    assert "robot   arm: 4 joints" in out  # named after its folder, since `robot` is not specific
    assert "flange: on link" in out
    assert run("import", "arm/robot.xml", "--out", "mine", "--package", option) == 0


def test_fk_accepts_scenes(capsys) -> None:
    fig7 = str(Path(__file__).with_name("fig7.x3d"))
    assert run("check", "--fk", fig7, "--joint-angles", "0,0.5,0,0,0,0,0") == 0
    assert "T_base_flange of lwr, from the DH table" in capsys.readouterr().out
    assert run("check", "--fk", "lwr_hit_hand", "--of", "arm") == 0
    assert "T_base_flange of arm" in capsys.readouterr().out
    file = paths.scenes_dir() / "lwr_udp.toml"
    assert run("check", "--fk", str(file)) == 0
    # A robot that another one carries, as in the command's help.
    assert (
        run("check", "--fk", "justin", "--of", "justin_left_arm", "--joint-angles", "0,0,0,0,0,0,0")
        == 0
    )
    assert "difference: " in capsys.readouterr().out
    for arguments, message in (
        (("lwr_hit_hand",), "lwr_hit_hand has 6 robots; choose one with --of: arm, hand_"),
        (
            ("lwr_hit_hand", "--of", "foot"),
            "lwr_hit_hand has no robot 'foot'; available: arm",
        ),
        (("lwr", "--of", "arm"), "lwr has no robot 'arm'; available: lwr"),
        (("lwrr",), "no scene or robot 'lwrr'; did you mean 'lwr'?"),
    ):
        assert run("check", "--fk", *arguments) == 2
        assert message in capsys.readouterr().err


def test_imported_mjcf_is_the_same(folder: Path, capsys) -> None:
    (folder / "source" / "meshes").mkdir(parents=True)
    trimesh.creation.box((0.1, 0.1, 0.4)).export(folder / "source" / "meshes" / "wedge.stl")
    given = 'vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.3  0.2 0 0.3"'
    assert given in TWO_LEGS
    inner = TWO_LEGS.replace(given, 'file="meshes/wedge.stl"')
    write(folder / "source", inner, "legs.xml")
    write(folder / "source", '<mujoco><include file="legs.xml"/></mujoco>', "scene.xml")
    assert run("import", "source/scene.xml", "--out", "legs", "--convention", "craig") == 0
    output = capsys.readouterr().out
    assert "no craig DH table" in output and "legs/robot.toml: 7 joints" in output
    worlds = [World(load_scene(name), dynamic=True) for name in ("legs", "source/scene.xml")]
    one, other = (next(iter(world.robots.values())).robot for world in worlds)
    shutil.rmtree(folder / "source")
    same(one, other)
    assert one.home == pytest.approx(other.home)
    for key in ("position_limits", "torque_limits", "base_frame", "flange_frame"):
        np.testing.assert_allclose(getattr(one, key), getattr(other, key), atol=1e-12)
    assert (one.free_base, one.link_names) == (other.free_base, other.link_names)
    for key in ("body_mass", "body_inertia", "geom_size", "geom_pos", "dof_damping", "mesh_vert"):
        found, expected = (getattr(world.model, key) for world in worlds)
        np.testing.assert_allclose(found, expected, atol=1e-6)
    assert run("check", "legs.toml") == 0


def test_robot_file_stores_a_planar_base_and_link_frames(folder: Path) -> None:
    root = (
        '<link name="odom"/><joint name="drive" type="planar"><parent link="odom"/>'
        '<child link="base_link"/><axis xyz="0 0.6 0.8"/></joint>'
    )
    path = write(folder, GRIPPER.replace("  <link", f"{root}<link", 1), "mobile.urdf")
    assert run("import", "mobile.urdf", "--out", "mobile") == 0
    one, other = SerialRobot.from_urdf(path), SerialRobot.from_model("mobile")
    assert (other.free_base, other.base_joint) == ("planar", "drive")
    np.testing.assert_allclose(other.base_normal, [0, 0.6, 0.8])
    assert one.link_poses.keys() == other.link_poses.keys() >= {"base_link", "sensor", "right"}
    for link, (body, T) in one.link_poses.items():
        assert other.link_poses[link][0] == body
        np.testing.assert_allclose(other.link_poses[link][1], T, atol=1e-12)


def test_chain_is_imported_in_either_convention(folder: Path) -> None:
    option = f"arm_meshes={folder / 'far' / 'away'}"
    robots = []
    for name in ("craig", "standard"):
        arguments = ["chain.urdf", "--out", name, "--package", option, "--convention", name]
        assert run("import", *arguments) == 0
        robots.append(SerialRobot.from_model(name))
    one, other = robots
    assert (one.dh_convention, other.dh_convention) == ("craig", "standard")
    for q in np.random.default_rng(0).uniform(-2, 2, (10, one.n)):
        flanges = one.fwd_kin_base_to_flange(q), other.fwd_kin_base_to_flange(q)
        np.testing.assert_allclose(*flanges, atol=1e-9)
        held = []
        for robot in robots:
            world = World(Scene(robots=[robot]), dynamic=True)
            data = world.make_data()
            data.qpos[:] = q
            mujoco.mj_forward(world.model, data)
            held.append(data.qfrc_bias.copy())
        np.testing.assert_allclose(*held, atol=1e-9)


UR = """<robot name="ur" xmlns:xacro="http://www.ros.org/wiki/xacro">
<xacro:arg name="fast" default="false"/>
<xacro:property name="length" value="${dict(ur5e=0.4, ur10e=0.6)['$(arg ur_type)']}"/>
<link name="a"/><link name="b"/>
<joint name="j" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
<origin xyz="0 0 ${length}"/>
<limit lower="-1" upper="1" velocity="${2 if '$(arg fast)' == 'true' else 1}"/></joint>
</robot>"""


def test_xacro_accepts_arguments(folder: Path, capsys) -> None:
    pytest.importorskip("xacro")
    path = write(folder, UR, "ur.urdf.xacro")
    assert run("check", "ur.urdf.xacro") == 2
    assert "set it with --arg ur_type=VALUE" in capsys.readouterr().err
    reach = {
        kind: SerialRobot.from_urdf(path, arguments={"ur_type": kind}).reach
        for kind in ("ur5e", "ur10e")
    }
    assert reach == {"ur5e": pytest.approx(0.4), "ur10e": pytest.approx(0.6)}
    table = '[robots.{0}]\nmodel = "ur.urdf.xacro"\narguments = {{ ur_type = "{0}" }}\n'
    scene = write(folder, table.format("ur5e") + table.format("ur10e"), "s.toml")
    robots = load_scene(scene).robots
    assert {name: robot.reach for name, robot in robots.items()} == reach
    over = load_scene(scene, {"ur10e.show_axes": True}).robots["ur10e"]
    assert (over.reach, over.show_axes) == (reach["ur10e"], True)
    write(folder, TWO_LEGS, "legs.xml")
    with pytest.raises(DeclarationError, match=re.escape("legs.xml: arguments.a: only xacro")):
        wrong = '[robots.x]\nmodel = "legs.xml"\narguments = { a = 1 }'
        load_scene(write(folder, wrong, "wrong.toml"))
    for wrong, expected in (
        (
            'model = "lwr"\narguments = { a = 1 }',
            {"reason": "arguments are only for xacro, but the model is robot.toml"},
        ),
        (
            'model = "ur.urdf.xacro"\narguments = [1]',
            {"found": [1], "expected": "a table of texts and numbers"},
        ),
    ):
        with raises_with(key="robots.x.arguments", **expected):
            load_scene(write(folder, f"[robots.x]\n{wrong}", "wrong.toml"))
    # Last, because an option applies to everything read after it.
    assert run("check", "ur.urdf.xacro", "--arg", "ur_type=ur10e") == 0
    assert "reach 0.6 m" in capsys.readouterr().out
    for file in ("tree.urdf", "ur.urdf.xacro"):
        assert run("check", file, "--arg", "fats=true") == 2
    output = capsys.readouterr().err
    assert "arguments.fats: only xacro files have arguments; this file is plain URDF" in output
    assert "arguments.fats: unknown xacro argument 'fats'; did you mean 'fast'?" in output


@pytest.mark.gl
def test_imported_robot_looks_the_same(folder: Path) -> None:
    option = f"arm_meshes={folder / 'far' / 'away'}"
    assert run("import", "tree.urdf", "--out", "my_arm", "--package", option) == 0
    pictures = []
    for name in ("my_arm", "tree.urdf"):
        world = World(load_scene(name))
        with HeadlessRenderer(world, 200, 150) as renderer:
            pictures.append(renderer.render(world.make_data()).astype(float))
    assert np.abs(pictures[0] - pictures[1]).max() <= 2
    assert pictures[0].std() > 10
