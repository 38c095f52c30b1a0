"""The robots that are found in a model: names, joints, limits, and how large their decor is."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from foreign_models import arm, compiled, jaco

import sero_mj
from sero_mj.foreign._model_trees import Tree, find_trees, measure, torque_limits, without_scope


def body(name: str, inside: str = "<joint/>") -> str:
    return f'<body name="{name}">{inside}<geom size=".1"/></body>'


def names(*bodies: str) -> list[str]:
    model, _ = compiled(f"<mujoco><worldbody>{''.join(bodies)}</worldbody></mujoco>")
    return [tree.name for tree in find_trees(model)]


def test_every_tree_with_a_hinge_or_slide_is_a_robot() -> None:
    assert names(
        body("a"),
        body("still", ""),
        body("free", "<freejoint/>"),
        body("ball", '<joint type="ball"/>'),
        body("slide", '<joint type="slide"/>'),
        body("deep", body("deeper")),
    ) == ["a", "slide", "deep"]


def test_names_are_fit_for_routes_and_differ() -> None:
    found = names(*map(body, ("left arm", "left.arm", "2nd", "world1", "toggles", "toggles2")))
    assert found == ["left_arm", "left_arm2", "_2nd", "world1", "toggles2", "toggles22"]
    nameless = '<body><joint/><geom size=".1"/></body>'
    assert names(nameless, nameless) == ["robot", "robot2"]


def test_joints_keep_their_names_without_the_scope_they_share() -> None:
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


def test_the_chain_ends_where_a_robot_branches() -> None:
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
    # motor: 2 * 10; force range: 30 * 2; the joint's own range is less than 2 * 100; none
    assert torque_limits(model, tree.joints).tolist() == [20.0, 60.0, 15.0, np.inf]


def sizes_of(xml: str) -> tuple[Tree, np.ndarray, np.ndarray]:
    model, data = compiled(xml)
    tree = find_trees(model)[0]
    mujoco.mj_fwdPosition(model, data)
    sizes = measure(model, data, tree)
    return tree, sizes.arrow_radius, sizes.load


def test_arrows_are_clear_of_the_housing_and_no_larger_than_needed() -> None:
    model, data = jaco()
    tree = find_trees(model)[0]
    radius = measure(model, data, tree).arrow_radius
    # Measured on the meshes by hand: housings of 41 mm, a wrist of 32 mm.
    assert (radius[:3] > 0.045).all() and (radius[:3] < 0.085).all()
    assert (radius[3:6] > 0.036).all() and (radius[3:6] < 0.065).all()
    assert (radius[6:] < 0.03).all()  # fingers, not their palm


@pytest.mark.parametrize("scale", [0.01, 1.0, 50.0])
def test_sizes_grow_with_the_robot(scale: float) -> None:
    s = scale
    _, radius, load = sizes_of(f"""<mujoco><worldbody><body name="a">
      <joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 {s}" size="{0.1 * s}" mass="3"/>
      <body pos="0 0 {s}"><joint axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 {s} 0 0" size="{0.1 * s}" mass="1"/>
      </body></body></worldbody></mujoco>""")
    assert radius == pytest.approx([0.145 * s] * 2, rel=0.05)
    # 1 kg at half of the last link; 4 kg at the distance of their common centre of mass
    com = np.array([3 * 0.0 + 0.5, 3 * 0.5 + 1.0]) / 4
    assert load == pytest.approx([4 * 9.81 * s * np.hypot(*com), 9.81 * s * 0.5], rel=1e-3)


def test_a_joint_without_any_geometry_still_has_sizes() -> None:
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
def test_scopes_that_all_share_are_left_out(names: list[str], expected: list[str]) -> None:
    assert without_scope(names) == expected


def test_a_pendulum_is_a_robot() -> None:
    joint = '<body name="rod"><joint name="pivot" axis="0 1 0"/><geom size=".1"/></body>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{joint}</worldbody></mujoco>")
    overlay = sero_mj.overlay(model, mujoco.MjData(model))
    assert overlay.robots == {"rod": ["pivot"]}
