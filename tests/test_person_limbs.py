"""Limbs of people reach for frames that move."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import problems_in
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.data.drive.place import Placer, middle_joint
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.surroundings import Object

points = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)
lengths = st.tuples(*[st.floats(0.05, 1)] * 2)


@given(points, lengths, points)
def test_both_links_have_constant_length_and_meet_if_they_can(end, both, towards) -> None:
    begin = np.array([0.1, -0.2, 0.3])
    joint = middle_joint(begin, end, both, towards)
    first, second = both
    distance = np.linalg.norm(end - begin)
    np.testing.assert_allclose(np.linalg.norm(joint - begin), first, atol=1e-8)
    if abs(first - second) < distance < first + second:
        np.testing.assert_allclose(np.linalg.norm(end - joint), second, atol=1e-6)
        along = (end - begin) / distance
        side = towards - (towards @ along) * along
        if np.linalg.norm(side) > 1e-6:
            assert (joint - begin) @ side >= -1e-9
    elif distance > 1e-6:
        out = np.cross(joint - begin, end - begin)
        np.testing.assert_allclose(out / distance, 0, atol=1e-6)


def test_user_of_the_haptic_device_holds_both_handles() -> None:
    world = World(load_scene("haptic_device"))
    data, placer = world.make_data(), Placer(world)
    for angle in (0.0, 0.3):
        world.set_input(data, "left.joint_angles", world.robots["left"].robot.home + angle)
        placer.place(data)
        for side in ("left", "right"):
            upper, lower = (data.body(f"limb-{side}_arm{k}") for k in ("", "_1"))
            hand = world.frame(data, f"{side}/flange") @ [0, 0, 0.062, 1]
            elbow = upper.xpos + 0.30 * upper.xmat.reshape(3, 3)[:, 2]
            np.testing.assert_allclose(lower.xpos, elbow, atol=1e-9)
            end = lower.xpos + 0.28 * lower.xmat.reshape(3, 3)[:, 2]
            np.testing.assert_allclose(end, hand[:3], atol=1e-9)
            assert elbow[2] < upper.xpos[2]  # the elbow is below the shoulder


@pytest.mark.parametrize(
    ("keys", "problem"),
    [
        (
            {"shape": "limb", "size": [0.3, 0.3, 0.05, 0.04]},
            "reaches: found none; expected the frame",
        ),
        ({"shape": "box", "size": [1, 1, 1], "reaches": "lwr/flange"}, "reaches: found lwr/fl"),
        ({"shape": "limb", "size": [0.3, 0.3], "reaches": "lwr/flange"}, "size of a limb: found"),
        (
            {"shape": "limb", "size": [0.3, 0.3, 0.05, 0.04], "reaches": "lwr/base", "mass": 1.0},
            "mass: found 1 for limb; expected a solid shape",
        ),
    ],
)
def test_invalid_limb_is_rejected(keys, problem) -> None:
    with pytest.raises(ValueError, match=problem):
        Object(name="arm", **keys)


def test_unknown_frame_and_route_to_a_limb_are_reported(tmp_path) -> None:
    file = tmp_path / "scene.toml"
    limb = 'shape = "limb"\nsize = [0.3, 0.3, 0.05, 0.04]\n'
    file.write_text(f'[robots.lwr]\nmodel = "lwr"\n[objects.arm]\n{limb}reaches = "lwr/flnge"\n')
    (problem,) = problems_in(file)
    assert "objects.arm.reaches: no frame 'lwr/flnge'" in problem and "lwr/flange" in problem
    file.write_text(
        f'[robots.lwr]\nmodel = "lwr"\n[objects.arm]\n{limb}reaches = "lwr/flange"\n'
        '[sources.udp]\nkind = "udp"\nport = 32000\nstructure = "16D"\n'
        '[routes]\n"arm.frame" = "udp.matrices0[0]"\n'
    )
    assert any("routes.arm.frame" in problem for problem in problems_in(file))
