"""Robots found in a model: names, joints, limits, and the sizes of their decor."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from foreign_models import arm, compiled, jaco

import sero_mj
from sero_mj.robots.assemble.decor_sizes import MeasuredBodies, Sizes, measure
from sero_mj.robots.assemble.solids import Solids
from sero_mj.robots.external._model_trees import Tree, find_trees, without_scope
from sero_mj.robots.external.model_world import ModelWorld
from sero_mj.robots.importers.mjcf_model import torque_limits


def body(name: str, inside: str = "<joint/>") -> str:
    return f'<body name="{name}">{inside}<geom size=".1"/></body>'


def measured(model: mujoco.MjModel, data: mujoco.MjData, tree: Tree) -> Sizes:
    return measure(model, data, MeasuredBodies(tree.bodies, tree.joints, tree.trunk))


def names(*bodies: str) -> list[str]:
    model, _ = compiled(f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>")
    return [tree.name for tree in find_trees(model)]


def test_every_tree_with_a_revolute_or_prismatic_joint_is_a_robot() -> None:
    assert names(
        body("a"),
        body("still", ""),
        body("free", "<freejoint/>"),
        body("ball", '<joint type="ball"/>'),
        body("slide", '<joint type="slide"/>'),
        body("deep", body("deeper")),
    ) == ["a", "slide", "deep"]


def test_names_are_valid_in_routes_and_unique() -> None:
    found = names(*map(body, ("left arm", "left.arm", "2nd", "world1", "toggles", "toggles2")))
    assert found == ["left_arm", "left_arm2", "_2nd", "world1", "toggles2", "toggles22"]
    nameless = '<body><joint/><geom size=".1"/></body>'
    assert names(nameless, nameless) == ["robot", "robot2"]


def test_joint_names_omit_their_common_scope() -> None:
    model, _ = jaco(2)
    trees = find_trees(model)
    assert [tree.name for tree in trees] == ["jaco0", "jaco1"]
    for tree in trees:
        expected = [f"joint_{i}" for i in range(1, 7)]
        expected += [f"jaco_hand/finger_{i}" for i in range(1, 4)]
        assert tree.joint_names == expected
    nameless = '<body name="b"><joint/><joint axis="1 0 0"/><geom size=".1"/></body>'
    model, _ = compiled(f"<mujoco><worldbody>{nameless}</worldbody></mujoco>")
    assert find_trees(model)[0].joint_names == ["b", "b2"]


def test_chain_ends_where_a_robot_branches() -> None:
    model, _ = jaco()
    tree = find_trees(model)[0]
    assert tree.chain.tolist() == [0, 1, 2, 3, 4, 5]
    assert model.body(tree.last).name.endswith("/hand")
    model, _ = arm()
    tree = find_trees(model)[0]
    assert tree.chain.tolist() == [0, 1, 2, 3]
    assert model.body(tree.last).name == "gripper"


def test_limits_come_from_joints_and_actuators() -> None:
    model, _ = arm()
    tree = find_trees(model)[0]
    # motor: 2 * 10; force range: 30 * 2; the joint's range, below 2 * 100; none
    assert torque_limits(model, tree.joints).tolist() == [20.0, 60.0, 15.0, np.inf]


def sizes_of(xml: str) -> tuple[Tree, np.ndarray, np.ndarray]:
    model, data = compiled(xml)
    tree = find_trees(model)[0]
    mujoco.mj_fwdPosition(model, data)
    sizes = measured(model, data, tree)
    return tree, sizes.arrow_radius, sizes.load


def test_arrows_are_outside_the_housing_and_not_larger_than_needed() -> None:
    model, data = jaco()
    tree = find_trees(model)[0]
    radius = measured(model, data, tree).arrow_radius
    # Measured on the meshes: housings of 41 mm, a wrist of 32 mm.
    assert (radius[:3] > 0.045).all() and (radius[:3] < 0.085).all()
    assert (radius[3:6] > 0.036).all() and (radius[3:6] < 0.065).all()
    assert (radius[6:] < 0.036).all()  # fingers, without their palm


@pytest.mark.parametrize("scale", [0.01, 1.0, 50.0])
def test_sizes_scale_with_the_robot(scale: float) -> None:
    s = scale
    _, radius, load = sizes_of(f"""<mujoco><worldbody><body name="a">
      <joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 {s}" size="{0.1 * s}" mass="3"/>
      <body pos="0 0 {s}"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 {s} 0 0" size="{0.1 * s}" mass="1"/>
      </body></body></worldbody></mujoco>""")
    assert radius == pytest.approx([0.145 * s] * 2, rel=0.05)
    # 1 kg at half of the last link; 4 kg at the distance of their common center of mass
    com = np.array([3 * 0.0 + 0.5, 3 * 0.5 + 1.0]) / 4
    assert load == pytest.approx([4 * 9.81 * s * np.hypot(*com), 9.81 * s * 0.5], rel=1e-3)


def test_points_inside_geoms_are_hidden() -> None:
    model, data = compiled("""<mujoco><worldbody><body><joint/>
      <geom size=".1"/><geom type="box" size=".05 .05 .05" pos=".2 0 0"/>
      <geom size=".9" group="4"/></body></worldbody></mujoco>""")
    radii = np.array([0.01, 0.09, 0.13, 0.2, 0.5])
    shares = Solids(model, data).hidden_shares(np.zeros(3), np.array([0, 0, 1.0]), radii, 0.01)
    assert shares[:2] == pytest.approx(1.0) and shares[2] == shares[4] == 0.0
    assert shares[3] == pytest.approx(2 * np.arcsin(0.05 / 0.2) / (2 * np.pi), abs=0.07)


SKIN = """<mujoco><worldbody><body name="bone"><joint axis="0 0 1"/>
    <geom type="capsule" size=".01" fromto="0 0 -.1 0 0 .1" group="3"/></body></worldbody>
  <deformable><skin name="fur" vertex="{vertices}"
    face="0 2 1 1 2 3 4 5 6 5 7 6 0 1 4 1 5 4 2 6 3 3 6 7 0 4 2 2 4 6 1 3 5 3 7 5">
    <bone body="bone" bindpos="0 0 0" bindquat="1 0 0 0" vertid="0 1 2 3 4 5 6 7"
      vertweight="1 1 1 1 1 1 1 1"/></skin></deformable></mujoco>"""


def test_arrows_are_outside_of_skins() -> None:
    corners = [(x, y, z) for z in (-0.3, 0.3) for y in (-0.05, 0.05) for x in (-0.05, 0.05)]
    vertices = " ".join(f"{x} {y} {z}" for x, y, z in corners)
    model, data = compiled(SKIN.format(vertices=vertices))
    (tree,) = find_trees(model)
    assert 0.05 < measured(model, data, tree).arrow_radius[0] < 0.1
    up, radii = np.array([0.0, 0.0, 1.0]), np.array([0.04, 0.08])
    assert Solids(model, data).hidden_shares(np.zeros(3), up, radii, 0.02) == pytest.approx([1, 0])


def test_arrows_of_close_joints_are_narrow_and_of_similar_size() -> None:
    vertebra = '<body pos="0 0 .02"><joint axis="0 0 1"/><geom size=".1"/>{}</body>'
    spine = "{}"
    for _ in range(8):
        spine = spine.format(vertebra)
    model, data = compiled(f"<mujoco><worldbody>{spine.format('')}</worldbody></mujoco>")
    (tree,) = find_trees(model)
    sizes = measured(model, data, tree)
    assert (sizes.arrow_radius > 0.05).all() and np.ptp(np.log(sizes.arrow_radius)) < np.log(1.5)
    assert sizes.full_width == pytest.approx(0.02 / sizes.arrow_radius)
    overlay = sero_mj.overlay(model, data)
    widths = overlay.world.joints.arrow_width_scale / 0.01
    assert widths == pytest.approx(sizes.full_width)
    wide = sero_mj.overlay(model, data, robots={tree.name: {"arrow_width_scale": 0.01}})
    assert wide.world.joints.arrow_width_scale == pytest.approx(0.01)


def test_joint_without_geometry_has_sizes() -> None:
    _, radius, load = sizes_of("""<mujoco><worldbody><body name="a"><joint/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody></mujoco>""")
    assert np.isfinite(radius).all() and (radius > 0).all()
    assert np.isfinite(load).all() and (load > 0).all()


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ([], []),  # of a robot with one body
        (["a"], ["a"]),
        (["s/a"], ["a"]),
        (["s/a", "s/b"], ["a", "b"]),
        (["s/t/a", "s/t/a/b"], ["a", "a/b"]),
        (["s/a", "r/b"], ["s/a", "r/b"]),
        (["s/a", "b"], ["s/a", "b"]),
    ],
)
def test_common_scopes_are_omitted(names: list[str], expected: list[str]) -> None:
    assert without_scope(names) == expected


def test_pendulum_is_a_robot() -> None:
    joint = '<body name="rod"><joint name="pivot" axis="0 1 0"/><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{joint}</worldbody></mujoco>")
    overlay = sero_mj.overlay(model, mujoco.MjData(model))
    assert overlay.robots == {"rod": ["pivot"]}


def limb(name: str, at: str) -> str:
    return f"""<body name="{name}" pos="{at}"><joint name="{name}" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.3" size=".03"/></body>"""


def robots_of(bodies: str, driven: str, model_name: str = "") -> dict[str, list[str]]:
    """Returns the robots of a model with motors on some joints."""
    motors = "".join(f'<motor joint="{joint}"/>' for joint in driven.split())
    model, _ = compiled(f"""<mujoco model="{model_name or "MuJoCo Model"}">
      <worldbody>{bodies}</worldbody><actuator>{motors}</actuator></mujoco>""")
    return {tree.name: tree.joint_names for tree in find_trees(model)}


TRUNK = '<geom type="box" size=".3 .1 .05" pos="0 0 1"/>'
LEGS = limb("front", ".3 .1 1") + limb("rear", "-.3 .1 1")


def test_limbs_of_a_trunk_fixed_to_the_world_are_one_robot() -> None:
    assert robots_of(TRUNK + LEGS, "front rear", "dog scene") == {"dog": ["front", "rear"]}
    # Without a trunk, or on something much larger, limbs are separate robots.
    apart = {"front": ["front"], "rear": ["rear"]}
    assert robots_of(LEGS, "front rear", "dog") == apart
    wall = TRUNK.replace(".3 .1 .05", "9 .1 9")
    assert robots_of(wall + LEGS, "front rear", "dog") == apart
    far = limb("front", "3 .1 1") + limb("rear", "-3 .1 1")
    assert robots_of(TRUNK + far, "front rear", "dog") == apart
    scoped = limb("left/front", ".3 .1 1") + limb("right/rear", "-.3 .1 1")
    assert set(robots_of(TRUNK + scoped, "left/front right/rear")) == {"left_front", "right_rear"}


def test_fixed_trunk_is_in_the_view_and_its_robot_base_is_the_world() -> None:
    model, data = compiled(f"<mujoco><worldbody>{TRUNK}{LEGS}</worldbody></mujoco>")
    overlay = sero_mj.overlay(model, data)
    assert overlay.robots == {"front": ["front", "rear"]}
    assert overlay.world.geoms_in_view().all()
    assert overlay.frame("front/base") == pytest.approx(np.eye(4))
    double = sero_mj.Double(name="goal", of="front", joint_angles=np.array([0.5, 0.0]))
    overlay = sero_mj.overlay(model, data, doubles=[double])
    state = overlay.world.state(data)
    (drawn,) = overlay.world.drawn_doubles(state, np.array([True]))
    # The links that differ, without the trunk.
    assert (drawn.opacity > 0).tolist() == [False, True, False]


def test_movable_objects_near_a_robot_are_in_the_view() -> None:
    model, data = compiled(f"""<mujoco><worldbody>{limb("arm", "0 0 1")}
      <body name="ball" pos=".3 0 1"><freejoint/><geom size=".05"/></body>
      <body name="far" pos="3 0 1"><freejoint/><geom size=".05"/></body>
      <body name="gate" pos=".3 0 1"><joint/><geom type="box" size="2 .01 2"/></body>
      <body name="table" pos=".3 0 .5"><geom type="box" size=".1 .1 .1"/></body>
      <body name="goal" pos=".3 0 1" mocap="true"><geom size=".05"/></body>
      <body name="hidden" pos=".3 0 1"><joint/><geom size=".05" group="4"/></body>
      <geom name="wall" type="box" pos=".3 0 1" size=".1 .1 .1"/>
      </worldbody><actuator><motor joint="arm"/></actuator></mujoco>""")
    shown = sero_mj.overlay(model, data).world.geoms_in_view()
    assert [model.body(body).name for body in model.geom_bodyid[shown]] == ["arm", "ball"]


def test_only_actuated_trees_are_robots() -> None:
    door, arm_ = limb("door", "1 0 1"), limb("arm", "0 0 1")
    assert set(robots_of(door + arm_, "arm")) == {"arm"}
    assert set(robots_of(door + arm_, "")) == {"door", "arm"}
    model, data = compiled(f"""<mujoco><worldbody>{door}{arm_}</worldbody>
      <actuator><motor joint="arm"/></actuator></mujoco>""")
    # A tree that is named is a robot, too.
    assert list(sero_mj.overlay(model, data, robots={"door": {}}).robots) == ["door", "arm"]


def test_actuators_can_drive_tendons_and_sites() -> None:
    bodies = """<body name="{0}" pos="{1} 0 1"><joint name="{0}"/><geom size=".1"/>
      <site name="{0}" pos=".1 .1 0"/></body>"""
    world = "".join(
        bodies.format(name, at) for at, name in enumerate(("fixed", "wound", "site", "free"))
    )
    model, _ = compiled(f"""<mujoco><worldbody><site name="wall"/>{world}</worldbody>
      <tendon><fixed name="a"><joint joint="fixed" coef="1"/></fixed>
      <spatial name="b"><site site="wall"/><site site="wound"/></spatial></tendon>
      <actuator><motor tendon="a"/><motor tendon="b"/><general site="site"/></actuator></mujoco>""")
    assert [tree.name for tree in find_trees(model)] == ["fixed", "wound", "site"]


@pytest.mark.parametrize(
    ("root", "model_name", "expected"),
    [
        ("base_link", "ur5e", "ur5e"),
        ("base", "panda scene", "panda"),
        ("link0", "panda_scene", "panda"),
        ("panda_link0", "panda", "panda"),
        ("b_base", "jaco", "jaco"),
        ("torso", "planar walker", "planar_walker"),
        ("base_link", "", "base_link"),
        ("base", "scene", "base"),
        ("left/base_link", "lab", "left"),
        ("upper_arm", "lab", "upper_arm"),
    ],
)
def test_root_with_a_generic_name_gets_the_model_name(
    root: str, model_name: str, expected: str
) -> None:
    assert list(robots_of(body(root, "<joint name='j'/>"), "j", model_name)) == [expected]


def test_two_robots_do_not_take_the_model_name() -> None:
    two = body("base", "<joint name='a'/>") + body("base_link", "<joint name='b'/>")
    assert list(robots_of(two, "a b", "lab")) == ["base", "base_link"]


BRANCHED = """
<mujoco><compiler autolimits="true"/><worldbody>
  <body name="trunk" pos="0.1 -0.2 0.5" euler="10 20 30"><geom size=".05"/>
    <joint name="lift" type="slide" axis="0 0 1" ref="0.2"/>
    <body name="arm" pos="0.2 0 0.1" euler="0 45 0"><geom size=".05"/>
      <joint name="yaw" axis="0 0 1" pos="0.01 0.02 0"/>
      <joint name="pitch" axis="0 1 0.2" ref="15"/>
      <body name="hand" pos="0.3 0 0"><geom size=".05"/><joint name="roll" axis="1 0 0"/></body>
    </body>
    <body name="head" pos="-0.1 0 0.3"><geom size=".05"/><joint name="nod" axis="0 -1 0"/></body>
  </body>
</worldbody></mujoco>
"""


def test_kinematics_of_a_robot_equal_those_of_its_model() -> None:
    model, data = compiled(BRANCHED)
    world = ModelWorld(model, data)
    (part,) = world.robots.values()
    robot = part.robot
    assert robot.names == ["lift", "yaw", "pitch", "roll", "nod"]
    joints, rng = part.tree.joints, np.random.default_rng(3)
    for _ in range(20):
        q = rng.uniform(-1.0, 1.0, robot.n)
        data.qpos[part.qpos] = q
        mujoco.mj_kinematics(model, data)
        frames = robot.kinematics.frames(q, np.eye(4))
        base = part.tree.bodies[0]  # the trunk, which the first joint moves
        lifted = frames[0]
        assert base == model.body("trunk").id and lifted.shape == (4, 4)
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = data.xmat[base].reshape(3, 3), data.xpos[base]
        T = T @ np.linalg.inv(frames[1]) @ frames  # seen from the lifted trunk
        np.testing.assert_allclose(T[2:, :3, 2], data.xaxis[joints[1:]], atol=1e-12)
        turned = T[2:, :3, 3] - data.xanchor[joints[1:]]
        np.testing.assert_allclose(turned, 0.0, atol=1e-12)
