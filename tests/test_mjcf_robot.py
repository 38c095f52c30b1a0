"""Robots from MJCF: the same kinematics, dynamics and looks as the compiled file."""

import logging
from importlib.util import find_spec
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.base.errors import DeclarationError, SeroError
from sero_mj.data.drive.wiring import wire
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import DOUBLE_GROUP, Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.importers.mjcf_robot import mjcf_tables, tree_of
from sero_mj.simulate import external_loads

# Several joints on a body, joint values with an offset, frames, classes, an enclosed wrist, a
# coupling, an actuated tendon, a free ball, textures and a mesh.
TWO_LEGS = """
<mujoco model="two legs">
  <compiler angle="degree" eulerseq="zyx"/>
  <default>
    <joint damping="0.3" armature="0.02"/>
    <default class="foot"><geom rgba="0.8 0.1 0.1 1" friction="0.9 0.1 0.1"/></default>
  </default>
  <asset>
    <texture name="squares" type="2d" builtin="checker" width="32" height="32"
             rgb1="0 0 1" rgb2="1 1 0"/>
    <material name="tiled" texture="squares" texrepeat="3 3" specular="0.7" reflectance="0.1"/>
    <mesh name="wedge" vertex="0 0 0  0.2 0 0  0 0.1 0  0 0 0.3  0.2 0 0.3"/>
  </asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="ground" type="plane" size="5 5 0.1"/>
    <body name="trunk" pos="0.1 0.2 1" euler="30 0 0">
      <freejoint name="root"/>
      <geom type="box" size="0.2 0.1 0.1" material="tiled" mass="4"/>
      <frame pos="0 0.15 0" euler="0 20 0">
        <body name="left thigh">
          <joint name="left hip x" axis="1 0 0" range="-60 60" frictionloss="0.2"/>
          <joint name="left hip y" axis="0 1 0.2" pos="0 0 0.03" ref="10" range="-90 45"/>
          <joint name="left hip z" axis="0 0 1"/>
          <geom type="capsule" fromto="0 0 0 0 0.05 -0.4" size="0.05" mass="2"/>
          <body name="left shank" pos="0 0.05 -0.4">
            <joint name="left knee" axis="0 1 0" range="0 150" actuatorfrcrange="-80 80"/>
            <geom type="mesh" mesh="wedge" euler="0 0 40" pos="0 0 -0.2"/>
            <body name="left foot" pos="0 0 -0.4" quat="0.9 0.1 0.3 0.1">
              <geom class="foot" type="ellipsoid" size="0.1 0.04 0.03" mass="0.4"/>
              <site name="left_tool" pos="0.1 0 0" euler="10 20 30"/>
            </body>
          </body>
        </body>
      </frame>
      <body name="right thigh" pos="0 -0.15 0">
        <joint name="right hip" axis="0 1 0" type="hinge"/>
        <geom type="cylinder" size="0.05 0.2" pos="0 0 -0.2" group="3" mass="2"/>
        <geom type="capsule" size="0.06 0.2" pos="0 0 -0.2" contype="0" conaffinity="0" mass="0"/>
        <body name="right shank" pos="0 0 -0.4">
          <joint name="right slide" axis="0 0 -1" type="slide" ref="0.02" range="0 0.1"/>
          <joint name="right follower" axis="0 1 0" ref="5"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.04" mass="1"/>
        </body>
      </body>
    </body>
    <body name="ball" pos="1 0 0.1"><freejoint/><geom size="0.1"/></body>
    <body name="target" mocap="true"><geom size="0.02" rgba="0 1 0 0.5"/></body>
  </worldbody>
  <tendon><fixed name="cord"><joint joint="right slide" coef="2"/></fixed></tendon>
  <actuator>
    <motor joint="left hip x" gear="50" ctrlrange="-1 1"/>
    <position joint="left knee" kp="100" forcerange="-60 60"/>
    <motor tendon="cord"/>
  </actuator>
  <equality>
    <joint joint1="right follower" joint2="right hip" polycoef="0.1 -0.5 0 0 0"/>
  </equality>
  <contact><exclude body1="trunk" body2="left foot"/></contact>
  <keyframe>
    <key name="home" qpos="0.1 0.2 0.8 1 0 0 0  0.1 0 0.2 0.5  0.3 0.05 0  1 0 0.1 1 0 0 0"/>
  </keyframe>
</mujoco>
"""
NAMES = [
    "left hip x", "left hip y", "left hip z", "left knee",
    "right hip", "right slide", "right follower",
]  # fmt: skip
ALONE = "<mujoco><worldbody><body>{}</body></worldbody></mujoco>"
ARM = """
<mujoco><worldbody><body name="a"><geom size="0.1"/><joint name="j1" axis="0 1 0"/>
<body pos="0 0 0.3"><joint axis="1 0 0"/><geom size="0.05" pos="0 0 0.2"/></body></body></worldbody>
</mujoco>
"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "two-legs.xml"
    file.write_text(TWO_LEGS)
    return file


@pytest.fixture
def robot(path):
    return SerialRobot.from_mjcf(path, name="legs")


def test_joints_limits_and_couplings_match_the_file(robot, caplog):
    inf = np.inf
    assert robot.names == NAMES and robot.types[5] == "prismatic"
    assert robot.parents == ["base", *NAMES[:3], "base", *NAMES[4:6]]
    limits = np.rad2deg(robot.position_limits)
    np.testing.assert_allclose(limits[[0, 1, 3]], [[-60, 60], [-90, 45], [0, 150]])
    np.testing.assert_allclose(robot.position_limits[5], [0, 0.1])
    assert robot.position_limits[2].tolist() == [-inf, inf]
    # The motor range times its gear, or the lower limit of joint and actuator; one is undeclared.
    assert robot.torque_limits.tolist() == [50, inf, inf, 60, inf, inf, inf]
    coupling = robot.couplings["right follower"]
    assert (coupling.to, coupling.ratio) == ("right hip", -0.5)
    assert coupling.offset == pytest.approx(0.1 + np.deg2rad(5))
    assert robot.dynamics.motor_inertias.tolist() == [0.02] * 7
    assert robot.dynamics.coulomb_friction.tolist() == [0.2] + [0.0] * 6
    assert robot.free_base and robot.flange_on == "left knee"


def test_warnings_name_ignored_elements(path, caplog):
    text = path.read_text()
    more = '<geom type="plane" size="3 3 1"/><geom name="wall" size="1 1 1"/><camera name="side"/>'
    text = text.replace("<worldbody>", f"<worldbody>{more}<site name='s1'/><site name='s2'/>", 1)
    rope = '<spatial name="rope"><site site="s1"/><site site="s2"/></spatial>'
    path.write_text(text.replace("<tendon>", f"<tendon>{rope}", 1))
    with caplog.at_level(logging.WARNING):
        SerialRobot.from_mjcf(path)
    told = [record.getMessage().partition("xml: ")[2] for record in caplog.records]
    assert told == [
        "bodies that no actuator of the robot moves are left out: ball, target",
        "geoms of the world are left out: wall",
        "spatial tendons are left out: rope",
        "cameras are left out: side",
    ]


def test_kinematics_and_dynamics_match_the_file(robot):
    tree = tree_of(robot.mjcf, Path(robot.directory))
    model, data = tree.model, mujoco.MjData(tree.model)
    world = World(Scene(robots=[robot]), dynamic=True)
    own, part = world.make_data(), world.robots["legs"]
    rng = np.random.default_rng(1)
    place = np.array([0.3, -0.2, 1.2, *rng.normal(size=4)])
    place[3:] /= np.linalg.norm(place[3:])
    for _ in range(20):
        q, v = rng.uniform(-1, 1, 7), rng.uniform(-1, 1, 7)
        data.qpos[:7], own.qpos[part.free] = place, place
        data.qpos[model.jnt_qposadr[tree.joints]], own.qpos[part.qpos] = q, q
        data.qvel[model.jnt_dofadr[tree.joints]], own.qvel[part.dofs] = v, v
        mujoco.mj_forward(model, data)
        mujoco.mj_forward(world.model, own)
        for body in np.flatnonzero(tree.links >= 0):
            link = part.bodies[tree.links[body]]
            T = np.linalg.inv(tree.poses[tree.links[body]]) @ tree.bodies[body]
            found = own.xpos[link] + own.xmat[link].reshape(3, 3) @ T[:3, 3]
            np.testing.assert_allclose(found, data.xpos[body], atol=1e-9)
        np.testing.assert_allclose(
            own.qfrc_bias[part.dofs], data.qfrc_bias[model.jnt_dofadr[tree.joints]], atol=1e-6
        )
    flange = world.frame(own, "legs/flange")
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, "left_tool")
    np.testing.assert_allclose(flange[:3, 3], data.site_xpos[site], atol=1e-9)
    np.testing.assert_allclose(flange[:3, :3].ravel(), data.site_xmat[site], atol=1e-9)
    mine = tree.links >= 0
    mass = world.model.body_mass[part.bodies].sum()
    assert mass == pytest.approx(model.body_mass[mine].sum())


def seen_geoms(world, name="legs"):
    model = world.model
    scope = f"{name}/"
    return [
        g for g in range(model.ngeom)
        if model.body(model.geom_bodyid[g]).name.startswith(scope) and model.geom_group[g] == 1
    ]  # fmt: skip


def test_geoms_have_the_same_poses_meshes_and_materials(robot, path):
    world = World(Scene(robots=[robot], floor=False))
    alone = mujoco.MjModel.from_xml_path(str(path))
    data, own = mujoco.MjData(alone), world.make_data()
    data.qpos[:] = alone.key_qpos[0]
    own.qpos[world.robots["legs"].qpos] = robot.home
    # In the keyframe, the coupled joint does not satisfy its coupling.
    data.qpos[alone.jnt("right follower").qposadr] = robot.home[6]
    mujoco.mj_forward(alone, data)
    mujoco.mj_forward(world.model, own)
    shown = [g for g in range(1, alone.ngeom - 2) if alone.geom_group[g] < 3]
    found = seen_geoms(world)
    assert len(found) == len(shown)
    order = np.argsort(own.geom_xpos[found][:, 2]), np.argsort(data.geom_xpos[shown][:, 2])
    for one, other in zip(np.array(found)[order[0]], np.array(shown)[order[1]], strict=True):
        assert world.model.geom_type[one] == alone.geom_type[other]
        np.testing.assert_allclose(world.model.geom_rgba[one], alone.geom_rgba[other])
        if alone.geom_type[other] != mujoco.mjtGeom.mjGEOM_MESH:
            np.testing.assert_allclose(own.geom_xpos[one], data.geom_xpos[other], atol=1e-6)
            np.testing.assert_allclose(world.model.geom_size[one], alone.geom_size[other])
    box = next(g for g in found if world.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_BOX)
    material = world.model.mat(int(world.model.geom_matid[box]))
    assert material.specular[0] == pytest.approx(0.7)
    texture = int(material.texid[mujoco.mjtTextureRole.mjTEXROLE_RGB])
    pixels = alone.tex_data[: 32 * 32 * 3]
    start = world.model.tex_adr[texture]
    assert (world.model.tex_data[start : start + len(pixels)] == pixels).all()
    mesh = next(g for g in found if world.model.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH)
    vertices = own.geom_xmat[mesh].reshape(3, 3) @ world.model.mesh_vert.T
    there = next(g for g in shown if alone.geom_type[g] == mujoco.mjtGeom.mjGEOM_MESH)
    expected = data.geom_xmat[there].reshape(3, 3) @ alone.mesh_vert.T
    one, other = (np.sort((a + b[:, None]).round(6), axis=1) for a, b in
                  ((vertices, own.geom_xpos[mesh]), (expected, data.geom_xpos[there])))  # fmt: skip
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_mesh_with_several_normals_at_a_vertex_keeps_them(tmp_path):
    corners = [f"v {x} {y} {z}" for x in (0, 0.1) for y in (0, 0.2) for z in (0, 0.3)]
    normals = [f"vn {x} {y} {z}" for x, y, z in np.concatenate([np.eye(3), -np.eye(3)])]
    squares = [(5, 7, 8, 6), (3, 4, 8, 7), (2, 6, 8, 4), (1, 2, 4, 3), (1, 5, 6, 2), (1, 3, 7, 5)]
    faces = [
        "f " + " ".join(f"{corner}//{k + 1}" for corner in part)
        for k, (a, b, c, d) in enumerate(squares)
        for part in ((a, b, c), (a, c, d))
    ]
    (tmp_path / "box.obj").write_text("\n".join([*corners, *normals, *faces]))
    (tmp_path / "arm.xml").write_text("""
<mujoco><asset><mesh name="box" file="box.obj"/></asset>
<worldbody><body><joint/><geom type="mesh" mesh="box"/></body></worldbody></mujoco>
""")
    alone = mujoco.MjModel.from_xml_path(str(tmp_path / "arm.xml"))
    assert (alone.nmeshvert, alone.nmeshnormal) == (8, 6)
    robot = SerialRobot.from_model(str(tmp_path / "arm.xml"))
    model = World(Scene(robots=[robot])).model
    a, b, c = np.moveaxis(model.mesh_vert[model.mesh_face], 1, 0)
    across = np.cross(b - a, c - a)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    for k in range(3):
        np.testing.assert_allclose(
            model.mesh_normal[model.mesh_facenormal[:, k]], across, atol=1e-4
        )


def test_collision_geoms_touch_with_their_friction(robot):
    world = World(Scene(robots=[robot]), dynamic=True)
    model = world.model
    touching = [g for g in range(model.ngeom) if model.geom_group[g] == 4]
    kinds = sorted(int(model.geom_type[g]) for g in touching)
    assert len(kinds) == 6  # all except the visual-only capsule
    feet = [g for g in touching if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_ELLIPSOID]
    np.testing.assert_allclose(model.geom_friction[feet[0]], [0.9, 0.1, 0.1])
    trunk, foot = model.body("legs/").id, model.body("legs/link4").id
    pairs = {(s >> 16, s & 0xFFFF) for s in model.exclude_signature.tolist()}
    assert (trunk, foot) in pairs or (foot, trunk) in pairs
    data = world.make_data()
    for _ in range(3000):
        mujoco.mj_step(model, data)
    assert data.ncon > 0 and np.isfinite(data.qpos).all()  # it lies on the floor
    assert data.qpos[world.robots["legs"].free[2]] > 0.0


def test_scene_has_robots_of_several_files_with_doubles(path, tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    (tmp_path / "s.toml").write_text("""
[robots.one]
model = "two-legs.xml"
base_frame = { xyz = [0, 0, 2] }
[robots.two]
model = "arm.xml"
mount = "one/flange"
[robots.three]
model = "arm.xml"
mirrored = true
[doubles.goal]
of = "one"
[routes]
"goal.joint_angles" = [0.1, 0.2, 0.3, 0.4, 0.5, 0.05, -0.05]
""")
    scene = load_scene(tmp_path / "s.toml")
    assert [robot.n for robot in scene.robots.values()] == [7, 2, 2]
    assert scene.robots["two"].names == ["j1", "joint2"]
    world = World(scene)
    model = world.model
    doubled = model.geom_group == DOUBLE_GROUP
    assert (model.geom_matid[doubled] == -1).all() and doubled.sum() >= 5
    assert np.unique(model.geom_rgba[doubled], axis=0).shape == (1, 4)


def test_single_robot_is_on_the_floor(path):
    world = World(load_scene(path), dynamic=True)
    model, data = world.model, world.make_data()
    floor = data.geom("floor").xpos[2]
    assert -0.1 < floor < -0.01
    bare = world.physics_model()
    moved = mujoco.MjData(bare)
    mujoco.mj_kinematics(bare, moved)
    assert moved.geom("floor").xpos[2] == floor
    for _ in range(1000):
        mujoco.mj_step(model, data)
    height = data.xpos[world.robots["two-legs"].bodies, 2]
    assert floor - 0.1 < height.min() and height.max() < floor + 1.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<mujoco/>", "has no hinge and no slide; expected a robot with joints"),
        ("<mujoco><worldbody><body/></mujoco>", "bad.xml cannot be read: XML parse error"),
        (
            ALONE.format('<joint type="ball"/><geom size="1"/>'),
            "has no hinge and no slide",
        ),
        (
            ALONE.format('<joint/><geom type="mesh" mesh="m"/>'),
            "mesh",
        ),
    ],
)  # fmt: skip
def test_files_without_robot_are_reported(tmp_path, text, message):
    (tmp_path / "bad.xml").write_text(text)
    with pytest.raises(DeclarationError) as caught:
        SerialRobot.from_model(str(tmp_path / "bad.xml"))
    assert message in str(caught.value)


def test_ball_joints_are_fixed_with_a_warning(caplog):
    text = ARM.replace('<joint name="j1" axis="0 1 0"/>', '<joint name="wrist" type="ball"/>')
    with caplog.at_level(logging.WARNING):
        robot = SerialRobot.from_mjcf(text, name="arm")
    assert robot.n == 1
    assert "ball joints become fixed joints, because they have no single axis: wrist" in caplog.text


def test_mjspec_and_mjcf_text_can_be_robots():
    spec = mujoco.MjSpec.from_string(ARM)
    one, other = SerialRobot.from_mjcf(spec, name="a"), SerialRobot.from_mjcf(ARM, name="b")
    assert one.names == other.names
    np.testing.assert_allclose(one.joint_frames, other.joint_frames)
    world = World(Scene(robots=[one, other], doubles=[Double(name="d", of="a")]))
    assert world.model.njnt == 4


def test_different_number_of_joints_is_rejected(path):
    robot = SerialRobot(
        joint_frames=[np.eye(4)], mjcf=path.name, directory=str(path.parent), name="legs"
    )
    with pytest.raises(DeclarationError) as caught:
        World(Scene(robots=[robot]))
    expected = "mjcf: found 7 joints in the model; expected 1, as in the robot declaration"
    assert expected in str(caught.value)


def test_collision_geoms_are_not_drawn_over_visual_ones():
    looks = '<geom type="box" size=".1 .1 .1" group="1" contype="0" conaffinity="0"/>'
    text = ARM.replace('<geom size="0.1"/>', f'{looks}<geom size="0.1" group="0"/>')
    world = World(Scene(robots=[SerialRobot.from_mjcf(text, name="arm")]))
    kinds = [int(world.model.geom_type[g]) for g in seen_geoms(world, "arm")]
    # The first link's sphere is collision-only. The second link has no other geom to draw.
    assert kinds == [int(mujoco.mjtGeom.mjGEOM_BOX), int(mujoco.mjtGeom.mjGEOM_SPHERE)]


def test_implausible_torque_limits_are_ignored(caplog):
    drives = '<actuator><motor joint="j1" ctrlrange="-9e5 9e5"/></actuator></mujoco>'
    text = ARM.replace("</mujoco>", drives)
    with caplog.at_level(logging.WARNING):
        robot = SerialRobot.from_mjcf(text, name="arm")
    assert robot.torque_limits is None
    assert "torque limits up to 900000 exceed 10 times the torque" in caplog.text


BOUNDS = """
<mujoco>
  <worldbody>
    <site name="nail" pos="0.3 0.1 0.2"/>
    <body name="b0"><joint name="motor" axis="0 0 1"/><geom size="0.2" mass="30"/>
      <body><joint name="both" axis="0 1 0"/><geom size="0.1"/>
        <body><joint name="one way" actuatorfrcrange="-3 9"/><geom size="0.1"/>
          <body><joint name="antagonists"/><geom size="0.1"/>
            <body><joint name="f1"/><geom size="0.1"/>
              <body><joint name="f2"/><geom size="0.1"/>
                <body><joint name="filtered"/><geom size="0.1"/>
                  <body><joint name="activated"/><geom size="0.1"/>
                    <body><joint name="unbounded"/><geom size="0.1"/></body>
    </body></body></body></body></body></body></body></body>
    <body pos="0 0 0.1"><joint name="crank" axis="0 1 0" range="-120 150"/>
      <geom size="0.1" mass="30"/><site name="end" pos="0.2 0 0"/></body>
  </worldbody>
  <tendon>
    <fixed name="two"><joint joint="f1" coef="0.5"/><joint joint="f2" coef="-0.2"/></fixed>
    <fixed name="clamped" limited="false" actuatorfrclimited="true" actuatorfrcrange="-1 2">
      <joint joint="f1" coef="1"/></fixed>
    <spatial name="rope"><site site="nail"/><site site="end"/></spatial>
  </tendon>
  <actuator>
    <motor joint="motor" gear="5" ctrlrange="-2 1"/>
    <motor joint="both" gear="2" ctrlrange="-10 10" forcerange="-4 4"/>
    <motor joint="one way" ctrlrange="-20 0"/>
    <motor joint="antagonists" gear="3" ctrlrange="0 1"/>
    <motor joint="antagonists" gear="-3" ctrlrange="0 1"/>
    <motor tendon="two" gear="2" ctrlrange="-8 8"/>
    <motor tendon="clamped" gear="3" ctrlrange="-8 8"/>
    <motor tendon="clamped" gear="3" ctrlrange="-8 8"/>
    <general joint="filtered" dyntype="filterexact" dynprm="0.1" gainprm="7" ctrlrange="-1 1"/>
    <general joint="activated" dyntype="integrator" gainprm="7" actrange="-2 3"/>
    <general joint="activated" gainprm="2" biastype="affine" biasprm="4" ctrlrange="0 1"/>
    <position joint="unbounded" kp="100" ctrlrange="-1 1"/>
    <motor tendon="rope" ctrlrange="-10 10"/>
  </actuator>
</mujoco>
"""


def test_torque_limits_are_the_largest_torques_that_mujoco_exerts():
    robot = SerialRobot.from_mjcf(BOUNDS, name="arm")
    model = mujoco.MjModel.from_xml_string(BOUNDS)
    data, chance = mujoco.MjData(model), np.random.default_rng(1)
    found = np.zeros(model.nv)
    for _ in range(1000):
        data.ctrl = chance.choice([-1e3, 1e3], model.nu)
        data.act = chance.choice([-1.0, 1.0]), chance.choice([-2.0, 3.0])  # where steps keep it
        data.qpos[-1] = chance.uniform(*model.jnt_range[-1])
        mujoco.mj_forward(model, data)
        found = np.maximum(found, np.abs(data.qfrc_actuator))
    exact = [10.0, 8.0, 3.0, 3.0, 14.0, 3.2, 7.0, 27.0]  # 0.5 * 16 + 2 * 3, say
    assert robot.torque_limits[:9].tolist() == pytest.approx([*exact, np.inf])
    np.testing.assert_allclose(found[:8], exact)
    assert robot.torque_limits[9] == pytest.approx(found[9], rel=0.01)  # over all poses


COUPLED = """
<mujoco>
  <worldbody>
    <body><joint name="j1" ref="0.2" range="-2 2"/><geom size="0.1"/><site name="a"/>
      <body><joint name="j2" axis="0 1 0"/><geom size="0.1"/><site name="b" pos="1 0 0"/>
        <body><joint name="j3" axis="0 1 0" ref="-0.1" range="0 4"/><geom size="0.1"/>
          <body><joint name="j4" axis="0 1 0"/><geom size="0.1"/>
            <body><joint name="j5" axis="0 1 0"/><geom size="0.1"/>
              <body><joint name="j6" axis="0 1 0"/><geom size="0.1"/>
                <body><joint name="j7" type="slide"/><geom size="0.1"/></body>
    </body></body></body></body></body></body>
    <body name="other"><joint name="hinge" axis="0 1 0"/><geom size="0.1"/></body>
  </worldbody>
  <tendon>
    <fixed name="t34"><joint joint="j3" coef="2"/><joint joint="j4" coef="-1"/></fixed>
    <fixed name="t5"><joint joint="j5" coef="0.5"/></fixed>
    <fixed name="t6"><joint joint="j6" coef="3"/></fixed>
    <fixed name="t156"><joint joint="j1" coef="1"/><joint joint="j5" coef="1"/>
      <joint joint="j6" coef="1"/></fixed>
    <spatial name="rope"><site site="a"/><site site="b"/></spatial>
  </tendon>
  <equality>
    <joint joint1="j1" joint2="j2" polycoef="0.1 2 0 0 0"/>
    <joint joint1="j2" joint2="j7" polycoef="0.02 4 0 0 0"/>
    <tendon tendon1="t34" polycoef="0.3 0 0 0 0"/>
    <tendon tendon1="t5" tendon2="t6" polycoef="0.05 0.5 0 0 0"/>
    <tendon tendon1="t156"/>
    <tendon tendon1="t5" tendon2="rope"/>
    <joint joint1="j2" joint2="j7" polycoef="0 0 1 0 0"/>
    <joint joint1="j7" polycoef="0.01"/>
    <joint joint1="j3" joint2="hinge"/>
    <joint joint1="j1" joint2="j7"/>
    <joint joint1="j4" joint2="j5" active="false"/>
  </equality>
  <actuator><motor joint="j1" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


def test_couplings_are_the_linear_constraints_of_joints_and_tendons(caplog):
    with caplog.at_level(logging.WARNING):
        robot = SerialRobot.from_mjcf(COUPLED, name="arm")
    coupled = {name: coupling.to for name, coupling in robot.couplings.items()}
    # The joint with an actuator is independent, on either side of the constraint.
    assert coupled == {"j2": "j1", "j7": "j2", "j4": "j3", "j6": "j5"}
    model = mujoco.MjModel.from_xml_string(COUPLED)
    data = mujoco.MjData(model)
    data.qpos[:7] = robot.coupled.positions(np.array([0.31, 0.2, -0.7]))
    mujoco.mj_forward(model, data)
    violated = data.efc_pos[data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)]
    np.testing.assert_allclose(violated[:4], 0.0, atol=1e-12)
    assert np.abs(violated[4:]).min() > 0.001
    for who, reason in (
        ("j1, j5, j6", "a coupling has two joints"),
        ("j5", "the length of a spatial tendon is not linear"),
        ("j2, j7", "it is not linear"),
        ("j7", "a coupling has two joints"),
        ("j3", "it contains a joint that is not part of the robot"),
        ("j1, j7", "the joints are already coupled"),
    ):
        assert f"the constraint of {who} is left out: {reason}" in caplog.text


def test_palm_of_a_gripper_carries_the_flange():
    finger = '<body><joint name="{0}" type="slide" axis="0 1 0"/><geom size="0.01"/></body>'
    robot = SerialRobot.from_mjcf(
        f"""<mujoco><worldbody><body><joint name="j1"/><geom size="0.1"/>
      <body name="hand" pos="0 0 0.3"><joint name="j2"/><geom size="0.1"/>
        {finger.format("left")}{finger.format("right")}
      </body></body></worldbody></mujoco>""",
        name="arm",
    )
    assert robot.flange_on == "j2"
    np.testing.assert_allclose(robot.fwd_kin_base_to_flange()[:3, 3], [0, 0, 0.3], atol=1e-12)


def test_keyframe_is_the_initial_pose_of_coupled_joints():
    key = '<keyframe><key name="home" qpos="0.5 9 1 9 2 9 9 9"/></keyframe></mujoco>'
    robot = SerialRobot.from_mjcf(COUPLED.replace("</mujoco>", key), name="arm")
    np.testing.assert_allclose(robot.home, robot.coupled.positions(np.array([0.5, 1.0, 2.0])))


def test_frames_are_named_by_joints_and_links(path, tmp_path):
    (tmp_path / "s.toml").write_text("""
[robots.legs]
model = "two-legs.xml"
[[robots.legs.children]]
name = "pad"
shape = "box"
size = [0.1, 0.1, 0.1]
on = "right slide"
[robots.finger]
model = "hit_finger"
mount = "legs/left hip z"
[doubles.goal]
of = "legs"
[arrows.one]
at = "legs/left_knee"
expressed_in = "goal/left shank"
[frames.two]
relative_to = "legs/trunk"
[frames.three]
[routes]
"three.frame" = "legs/left_knee"
""")
    scene = load_scene(tmp_path / "s.toml")
    legs = scene.robots["legs"]
    assert legs.link_names == [
        "trunk", "link1", "link2", "left thigh", "left shank",
        "right thigh", "link6", "right shank",
    ]  # fmt: skip
    assert legs.children[0].on == "link6" and scene.robots["finger"].mount == "legs/link3"
    arrow = scene.arrows["one"]
    assert (arrow.at, arrow.expressed_in) == ("legs/link4", "goal/link4")
    assert scene.frames["two"].relative_to == "legs/base"
    assert [route.frame for route in wire(scene).frame_routes] == ["legs/link4"]
    world = World(scene)
    data = world.make_data()
    mujoco.mj_forward(world.model, data)
    for name in ("left_knee", "left shank"):
        assert np.array_equal(world.frame(data, f"legs/{name}"), world.frame(data, "legs/link4"))
    assert external_loads._site(world, "legs/trunk") == world.frame_site("legs/base")
    assert world.robots["legs"].own_link_names[4] == "legs/left shank"


def test_push_at_a_link_of_the_file_is_shown_there(path, tmp_path):
    (tmp_path / "s.toml").write_text("""
[robots.legs]
model = "two-legs.xml"
[run]
duration = 0.1
[disturbances.push]
kind = "force"
at = "legs/left shank"
point = [0, 0, 0.1]
expressed_in = "legs/trunk"
force = [0, 0, 1]
""")
    scene = load_scene(tmp_path / "s.toml")
    arrow = scene.arrows["push"]
    assert (scene.frames[arrow.at].relative_to, arrow.expressed_in) == ("legs/link4", "legs/base")


def test_unknown_frame_is_reported_with_known_frames(path, tmp_path):
    (tmp_path / "s.toml").write_text("""
[robots.legs]
model = "two-legs.xml"
[arrows.one]
at = "legs/left_kne"
[arrows.two]
at = "legs/nothing at all"
""")
    with pytest.raises(DeclarationError) as caught:
        load_scene(tmp_path / "s.toml")
    message = str(caught.value)
    assert "no frame 'legs/left_kne'; did you mean 'legs/left knee'?" in message
    assert (
        "no frame 'legs/nothing at all'; available: legs/base, legs/flange, and legs/link"
        in message
    )


def test_only_independent_joints_determine_the_flange(robot):
    q = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.05])
    whole = [*q, robot.couplings["right follower"].offset - 0.5 * q[4]]
    np.testing.assert_allclose(
        robot.fwd_kin_base_to_flange(q), robot.fwd_kin_base_to_flange(whole), atol=1e-12
    )


FILES = ["acrobot", "cheetah", "fish", "hopper", "humanoid", "quadruped", "swimmer", "walker"]


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_robots_of_dm_control_match_plain_mujoco(name):
    pytest.importorskip("dm_control", reason="dm-control is not installed")
    folder = Path(find_spec("dm_control").submodule_search_locations[0]) / "suite"
    robot = SerialRobot.from_mjcf(folder / f"{name}.xml", name="robot")
    tree = tree_of(f"{name}.xml", folder)
    model, data = tree.model, mujoco.MjData(tree.model)
    world = World(Scene(robots=[robot]), dynamic=True)
    mine, part = np.flatnonzero(tree.links >= 0), world.robots["robot"]
    to_body = np.linalg.inv(tree.poses[tree.links[mine]]) @ tree.bodies[mine]
    for q in np.random.default_rng(0).uniform(-1.5, 1.5, (10, robot.n)):
        data.qpos[model.jnt_qposadr[tree.joints]] = q
        mujoco.mj_kinematics(model, data)
        found = robot.kinematics.frames(q, tree.poses[0])[tree.links[mine]] @ to_body
        np.testing.assert_allclose(found[:, :3, 3], data.xpos[mine], atol=1e-9)
    masses = world.model.body_mass[part.bodies].sum()
    assert masses == pytest.approx(model.body_mass[mine].sum(), rel=1e-6)


def test_implausible_values_are_clipped_or_ignored(tmp_path):
    joint = '<joint name="lift" type="slide" axis="0 0 1" {}/>'
    stated = joint.format('damping="1e11" limited="true" range="-999999 999999"')
    (tmp_path / "fetch.xml").write_text(ALONE.format(f'{stated}<geom size="0.1"/>'))
    robot = SerialRobot.from_model(str(tmp_path / "fetch.xml"))
    assert robot.dynamics.viscous_friction.tolist() == [1e9]
    assert (robot.position_limits, robot.reach) == (None, 0.0)
    _, lost = mjcf_tables("fetch.xml", tmp_path)
    assert lost == [
        "limits of 1000 rad or m and more are ignored: lift",
        "damping is clipped to 1e+09: lift",
    ]


@pytest.mark.parametrize(
    "keys, expected",
    [
        ('<key qpos="0.4"/>', [0.4]),
        ('<key name="falling" qpos="0.4"/>', None),
        ('<key qpos="0.4"/><key qpos="0.3"/>', None),
        ('<key qpos="0.4"/><key name="home" qpos="0.3"/>', [0.3]),
    ],
)
def test_single_unnamed_keyframe_is_the_initial_pose(tmp_path, keys, expected):
    text = ALONE.format('<joint/><geom size="0.1"/>')
    keyed = text.replace("</mujoco>", f"<keyframe>{keys}</keyframe></mujoco>")
    (tmp_path / "arm.xml").write_text(keyed)
    tables, _ = mjcf_tables("arm.xml", tmp_path)
    found = tables.get("joint_angles")
    assert (found is None) == (expected is None)
    assert expected is None or found.tolist() == expected


def test_negative_damping_is_set_to_zero(tmp_path):
    joint = '<joint name="wrist" damping="-0.0132" frictionloss="0.2"/>'
    (tmp_path / "panda.xml").write_text(ALONE.format(f'{joint}<geom size="0.1"/>'))
    robot = SerialRobot.from_model(str(tmp_path / "panda.xml"))
    assert robot.dynamics.viscous_friction.tolist() == [0.0]
    assert robot.dynamics.coulomb_friction.tolist() == [0.2]
    _, lost = mjcf_tables("panda.xml", tmp_path)
    assert lost == ["negative damping is set to 0: wrist"]


def test_nan_in_a_joint_is_reported(tmp_path: Path) -> None:
    root = ElementTree.fromstring(TWO_LEGS)
    next(root.iter("joint")).set("ref", "nan")
    path = tmp_path / "nan.xml"
    path.write_text(ElementTree.tostring(root, encoding="unicode"), encoding="utf-8")
    with pytest.raises(DeclarationError) as caught:
        load_scene(path)
    assert caught.value.problems[0].key == "joint_frames"


WORDS = ["0", "-1", "nan", "1e400", "", "a", "free", "ball", "mesh", "left knee", "tiled", "../x"]


@given(st.data())
def test_mutated_files_raise_only_sero_errors(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "mutated.xml"
    text = TWO_LEGS
    for _ in range(data.draw(st.integers(1, 3))):
        kind = data.draw(st.sampled_from(["cut", "word", "element"]))
        if kind == "cut":
            start = data.draw(st.integers(0, max(len(text) - 1, 0)))
            text = text[:start] + text[start + data.draw(st.integers(1, 60)) :]
            continue
        root = ElementTree.fromstring(TWO_LEGS)
        each = data.draw(st.sampled_from([*root.iter()]))
        if kind == "word" and each.attrib:
            name = data.draw(st.sampled_from(sorted(each.attrib)))
            each.set(name, data.draw(st.sampled_from(WORDS)))
        else:
            each[:] = data.draw(st.permutations([*each]))[1:]
        text = ElementTree.tostring(root, encoding="unicode")
    path.write_text(text, encoding="utf-8")
    try:
        world = World(load_scene(path))
    except SeroError as error:
        assert str(error)
    else:
        mujoco.mj_forward(world.model, world.make_data())


MOBILE = """<mujoco><worldbody><body name="platform" pos="0.3 0 0.1" euler="30 0 0">
  {} <geom type="box" size="0.4 0.3 0.1" mass="40"/>
  <body name="upper" pos="0.2 0 0.1"><joint name="arm" axis="0 1 0"/><geom size="0.1"/></body>
</body></worldbody><actuator><motor joint="arm"/>{}</actuator>
<keyframe><key name="home" qpos="{} 0.3"/></keyframe></mujoco>"""
IDIOM = (
    '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 0 1"/>'
    '<joint name="yaw" axis="0 -1 0"{}/>'
)


@pytest.mark.parametrize(
    ("joints", "actuator", "key", "expected"),
    [
        (IDIOM.format(""), "", "1 2 0.5", ("planar", "free_base", [0, -1, 0])),
        ('<freejoint name="root"/>', "", "1 2 3 0.6 0.8 0 0", (True, "root", [0, 0, 1])),
        (IDIOM.format(""), '<motor joint="y"/>', "1 2 0.5", (False, "free_base", [0, 0, 1])),
        (IDIOM.format(' range="-1 1"'), "", "1 2 0.5", (False, "free_base", [0, 0, 1])),
        (IDIOM.replace("0 0 1", "0 1 1").format(""), "", "1 2 0.5",
         (False, "free_base", [0, 0, 1])),
    ],
)  # fmt: skip
def test_passive_platform_is_a_free_base_at_its_keyframe(joints, actuator, key, expected):
    text = MOBILE.format(joints, actuator, key)
    robot = SerialRobot.from_mjcf(text, name="mobile")
    assert (robot.free_base, robot.base_joint, robot.base_normal.tolist()) == expected
    assert robot.names == (["arm"] if robot.free_base else ["x", "y", "yaw", "arm"])
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    world = World(Scene(robots=[robot], floor=False))
    ours = world.make_data()
    mujoco.mj_kinematics(world.model, ours)
    flange = world.frame(ours, "mobile/flange")
    body = model.body("upper").id
    np.testing.assert_allclose(flange[:3, 3], data.xpos[body], atol=1e-9)
    np.testing.assert_allclose(flange[:3, :3].ravel(), data.xmat[body], atol=1e-9)
