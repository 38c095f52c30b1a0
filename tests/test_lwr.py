"""The LWR: its values against their sources, its meshes, and its exports."""

from __future__ import annotations

import math
import re
import shutil

import mujoco
import numpy as np
import pytest

from sero_mj.base import paths
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.scene_file import read_scene_file
from sero_mj.robots.declared.surroundings import Object

HALF_PI = math.pi / 2
SNIPPET = (
    '<mujoco><worldbody><body name="jaw" pos="0 0 0.1"><geom size="0.02"/></body></worldbody>'
    "</mujoco>"
)


def test_table_equals_the_paper_with_pi_to_the_last_digit(lwr):
    # PAPER.md Fig. 7 (it writes 1.5708) and orocos_kdl kukaLWR_DHnew.cpp.
    alpha = [0, HALF_PI, -HALF_PI, -HALF_PI, HALF_PI, HALF_PI, -HALF_PI]
    expected = np.zeros((7, 4))
    expected[:, 0], expected[[0, 2, 4], 3] = alpha, [0.31, 0.4, 0.39]
    np.testing.assert_array_equal(lwr.dh_params, expected)
    assert (lwr.dh_convention, lwr.types) == ("craig", ["revolute"] * 7)
    # 0.078: CentroEPiaggio/kuka-lwr, kuka-isir/rtt_lwr, FloBaRoID and Lwr4.java agree.
    expected = np.eye(4)
    expected[2, 3] = 0.078
    np.testing.assert_array_equal(lwr.flange_frame, expected)


def test_limits_names_and_offsets_equal_the_published_ones(lwr, lwr_world):
    # ROBOTS.md 1.1 and 1.2.
    assert lwr.names == ["A1", "A2", "E1", "A3", "A4", "A5", "A6"]
    reach = np.array([170, 120, 170, 120, 170, 120, 170]) * math.pi / 180
    np.testing.assert_allclose(lwr.position_limits, np.column_stack([-reach, reach]))
    np.testing.assert_allclose(lwr_world.model.jnt_range, np.column_stack([-reach, reach]))
    assert lwr_world.model.jnt_limited.all()
    speed = np.array([112.5, 112.5, 112.5, 112.5, 180, 112.5, 112.5]) * math.pi / 180
    np.testing.assert_allclose(lwr.velocity_limits, speed)
    assert lwr.torque_limits.tolist() == [176, 176, 100, 100, 100, 38, 38]
    assert lwr.offsets.tolist() == [[0, 0, z] for z in (-0.2, 0, -0.2, 0, -0.2, 0, 0.1)]


# ROBOTS.md 4.2: computed from the table and confirmed by the URDF chains of CentroEPiaggio and
# ISIR; no pose of the LWR is published.
@pytest.mark.parametrize(
    ("q", "position", "rotation"),
    [
        ([0] * 7, [0, 0, 1.178], np.eye(3)),
        (np.deg2rad([0, 30, 0, -90, 0, 60, 0]), [-0.537750, 0, 0.383410], np.diag([-1, 1, -1])),
        ([1.6, 0, -1.6, -1.57, 0, 1.57, -0.8], [-0.390124, 0, 0.632311], None),
    ],
)
def test_flange_is_at_the_regression_poses(lwr, lwr_world, q, position, rotation):
    data = lwr_world.make_data()
    lwr_world.set_input(data, "lwr.joint_angles", q)
    mujoco.mj_kinematics(lwr_world.model, data)
    for pose in (lwr.fwd_kin_base_to_flange(q), lwr_world.fwd_kin_base_to_flange(data, "lwr")):
        np.testing.assert_allclose(pose[:3, 3], position, atol=5e-7)
        if rotation is not None:
            np.testing.assert_allclose(pose[:3, :3], rotation, atol=1e-12)


def test_flange_follows_the_urdf_chain(lwr):
    # A second computation: lwr.urdf.xacro of kuka-isir/rtt_lwr, whose frames are all parallel to
    # the base at zero (ROBOTS.md 1.1 and 1.4). Its shoulder is 0.5 mm higher than the paper's.
    offsets = [0.102 - 0.0005, 0.2085, 0.1915, 0.2085, 0.1915, 0.1985, 0.078]
    axes = [(2, 1), (1, -1), (2, 1), (1, 1), (2, 1), (1, -1), (2, 1)]
    for q in np.random.default_rng(7).uniform(-2, 2, (50, 7)):
        T = np.eye(4)
        for (axis, sign), offset, angle in zip(axes, offsets, q, strict=True):
            quat, turn = np.empty(4), np.empty(9)
            mujoco.mju_axisAngle2Quat(quat, sign * np.eye(3)[axis], angle)
            mujoco.mju_quat2Mat(turn, quat)
            T[:3, 3] += T[:3, 2] * offset
            T[:3, :3] = T[:3, :3] @ turn.reshape(3, 3)
        np.testing.assert_allclose(lwr.fwd_kin_base_to_flange(q), T, atol=1e-12)


def test_meshes_have_few_triangles_near_their_links(lwr, lwr_world):
    model = lwr_world.model
    assert 0 < model.nmeshface < 9000
    assert model.ngeom == sum(map(len, lwr.filenames))
    # Meters, not millimeters, and near the links: within 0.12 m of the joint axes.
    data = lwr_world.make_data()
    for geom in range(model.ngeom):
        mesh = model.geom_dataid[geom]
        start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        corners = model.mesh_vert[start : start + count]
        corners = corners @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom]
        assert np.linalg.norm(corners[:, :2], axis=1).max() < 0.13  # the arm is upright
        assert corners[:, 2].min() > -1e-6 and corners[:, 2].max() < 1.1785
    tip = data.body("lwr/flange").xpos[2]
    assert tip == pytest.approx(1.178)


def test_every_mesh_file_is_used_and_every_color_exists(lwr):
    used = {mesh.file for link in lwr.filenames for mesh in link}
    assert used == {path.name for path in (paths.models_dir() / "lwr/meshes").glob("*.stl")}
    assert {mesh.color for link in lwr.filenames for mesh in link} == set(lwr.colors)


def test_shipped_scene_shows_the_lwr_without_a_problem():
    scene, problems = read_scene_file(paths.find_scene("lwr_udp"))
    assert problems == []
    assert list(scene.robots) == ["lwr"]
    assert scene.routes == {"lwr.joint_angles": "udp.values0", "lwr.torques": "udp.values1"}
    assert scene.sources["udp"]["structure"] == "7F7F"
    assert scene.sources["udp"]["port"] == 32000
    assert World(scene).model.njnt == 7


def export_scene(tmp_path) -> Scene:
    """Returns a scene with everything to export: meshes, MJCF, generated links, a pose."""
    (tmp_path / "source").mkdir()
    meshes = paths.models_dir() / "lwr" / "meshes"
    shutil.copy(meshes / "link7_white.stl", tmp_path / "source" / "tool.stl")
    tool = Object(name="tool", mesh="tool.stl", directory=str(tmp_path / "source"))
    jaw = Object(name="gripper", mjcf=SNIPPET, frame={"xyz": [0, 0, 0.1], "rpy": [0, 0.3, 0]})
    lwr = SerialRobot.from_model(
        "lwr",
        children=[tool, jaw],
        joint_angles=np.linspace(-1, 1, 7),
        base_frame={"xyz": [0.5, -0.5, 0.2], "rpy": [0.1, 0.2, 0.3]},
    )
    rail = SerialRobot(
        name="rail",
        dh_convention="standard",
        dh_params=[[HALF_PI, 0.1, 0.3, 0.2], [0.2, 0.3, 0, 0.1]],
        joint_types=["prismatic", "revolute"],
        joint_angles=[0.25, -0.5],
    )
    return Scene(robots=[lwr, rail], objects=[Object(name="axes", shape="axes")])


def test_export_loads_in_plain_mujoco_with_the_same_poses(tmp_path):
    scene = export_scene(tmp_path)
    world = World(scene)
    data = world.make_data()
    shutil.rmtree(tmp_path / "source")  # the export does not need the original files
    written = world.export(tmp_path / "a" / "b" / "scene.xml")
    assert written[0] == tmp_path / "a" / "b" / "scene.xml"
    folder = written[0].parent
    assert set(written) == {path for path in folder.rglob("*") if path.is_file()}
    assert {path.name for path in folder.iterdir()} == {"scene.xml", "scene_assets"}
    assert len(written) == len(set(written)) > 1
    loaded = mujoco.MjModel.from_xml_path(str(written[0]))
    fresh = mujoco.MjData(loaded)
    mujoco.mj_resetDataKeyframe(loaded, fresh, loaded.key("home").id)
    mujoco.mj_kinematics(loaded, fresh)
    assert loaded.nbody == world.model.nbody and loaded.nuserdata == world.model.nuserdata
    for i in range(loaded.nbody):
        name = mujoco.mj_id2name(loaded, mujoco.mjtObj.mjOBJ_BODY, i)
        there = data.body(name)
        np.testing.assert_allclose(fresh.xpos[i], there.xpos, rtol=0, atol=1e-12)
        np.testing.assert_allclose(fresh.xmat[i], there.xmat, rtol=0, atol=1e-12)
    np.testing.assert_allclose(fresh.geom_xpos, data.geom_xpos, rtol=0, atol=1e-12)
    np.testing.assert_allclose(loaded.jnt_range, world.model.jnt_range, rtol=0, atol=1e-12)


def test_exporting_twice_writes_the_same_files(tmp_path):
    world = World(Scene(robots=[SerialRobot(dh_convention="craig", joint_angles=[0.5])]))
    first = world.export(tmp_path / "scene.xml")[0].read_text()
    assert world.export(tmp_path / "scene.xml")[0].read_text() == first
    assert mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml")).nkey == 1


def test_scene_without_joints_exports_without_a_keyframe(tmp_path):
    path = World(Scene()).export(tmp_path / "empty.xml")[0]
    assert mujoco.MjModel.from_xml_path(str(path)).nkey == 0


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "kg", "told"),
    [
        ("lwr", 15.946, ["lwr: 15.95 kg, as declared"]),
        ("hit_hand2", 1.597, ["hit_hand2_thumb: 0.1447 kg, as declared"]),
        (
            "justin",
            114.84,
            [
                "justin_torso: 54.22 kg, estimated from the link shapes at 400 kg/m3 "
                "(no mass is declared)",
                "justin_left_arm: 15.95 kg, as declared",
            ],
        ),
    ],
)
def test_export_has_the_simulated_mass_and_lists_estimated_values(tmp_path, name, kg, told):
    scene = load_scene(name)
    (path, *_) = World(scene).export(tmp_path / "scene.xml")
    loaded = mujoco.MjModel.from_xml_path(str(path))
    simulated = World(load_scene(name), dynamic=True).model
    names = [loaded.body(i).name for i in range(1, loaded.nbody)]
    for body in names:
        found, expected = loaded.body(body), simulated.body(body)
        np.testing.assert_allclose(found.mass, expected.mass, rtol=1e-9, atol=1e-8)
        np.testing.assert_allclose(found.inertia, expected.inertia, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(found.ipos, expected.ipos, rtol=0, atol=1e-9)
    assert loaded.body_mass.sum() == pytest.approx(kg, abs=0.005)
    comment = path.read_text(encoding="utf-8").partition("-->")[0]
    for line in told:
        assert line in comment
    # The mass in the comment is that of the exported robot.
    group = paths.models_dir() / name / "group.toml"
    if group.exists():
        text = group.read_text(encoding="utf-8")
        (said,) = re.findall(r"(?:mass of the hand|simulated mass) is ([\d.]+) kg", text)
        assert float(said) == pytest.approx(kg, rel=0.005)


def test_zero_mass_is_noted_in_an_export(tmp_path):
    text = "[dynamics]\nmasses = [1, 0, 2]\ncenters_of_mass = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]\n"
    tensors = "[[1, 1, 1, 0, 0, 0], [0, 0, 0, 0, 0, 0], [1, 1, 1, 0, 0, 0]]"
    table = 'dh_convention = "craig"\ndh_params = [[0, 0, 0, 0.2], [1, 0.2, 0, 0]]\n'
    (tmp_path / "robot.toml").write_text(f"{table}{text}inertias = {tensors}\n")
    (path, *_) = World(load_scene(str(tmp_path))).export(tmp_path / "x.xml")
    assert ": 3 kg, as declared (without mass: link 1) -->" in path.read_text()
