"""A robot without fresh data is grey and says so, in geoms and in pictures."""

import mujoco
import numpy as np
import pytest
from decor_tools import of_kind, toggles_of, view_at

from sero_mj.assemble.objects import Object
from sero_mj.assemble.robot import SerialRobot
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.world import World
from sero_mj.decor.draw import Decor
from sero_mj.decor.pen import GREY, Host
from sero_mj.show.headless import HeadlessRenderer

GEOM = mujoco.mjtGeom


def two_arms(**fields) -> World:
    """`left` is fed by a source, `right` stands as declared."""
    tool = Object(name="tool", shape="sphere", size=[0.05])
    return World(
        Scene(
            robots=[
                SerialRobot.from_model("lwr", name="left", children=[tool], **fields),
                SerialRobot.from_model("lwr", name="right", base_frame={"xyz": [0, 0.7, 0]}),
            ],
            sources={"udp": {"kind": "udp", "port": 1, "structure": "7F"}},
            routes={"left.joint_angles": "udp.values0"},
            floor=False,
        )
    )


def with_age(world: World, age: float) -> mujoco.MjData:
    data = world.make_data()
    data.userdata[world.slots["sources.udp"]] = (5, 0, 0, age, 0, 0, 56, -1, 0)
    return data


@pytest.mark.parametrize(
    ("age", "text"),
    [
        (-1.0, "left: no data yet"),
        (0.0, None),
        (0.49, None),
        (0.51, "left: no data for 0.5 s"),
        (12.34, "left: no data for 12.3 s"),
        (300.0, "left: no data for 5 min"),
        (7200.0, "left: no data for 2 h"),
    ],
)
def test_a_robot_says_how_old_its_data_is(age: float, text: str | None) -> None:
    world = two_arms()
    decor = Decor(world)
    pen = decor.draw(with_age(world, age), toggles_of(world), view_at(distance=5))
    rows = of_kind(pen.rows[: pen.count], GEOM.mjGEOM_LABEL)
    assert [row["label"].decode() for row in rows] == ([text] if text else [])
    assert (pen.grey is None) == (text is None)


def test_bad_packets_are_no_silence() -> None:
    world = two_arms()
    data = with_age(world, 1.2)
    data.userdata[world.slots["sources.udp"]][7] = 0.01  # s since a malformed one
    decor = Decor(world)
    pen = decor.draw(data, toggles_of(world), view_at(distance=5))
    rows = of_kind(pen.rows[: pen.count], GEOM.mjGEOM_LABEL)
    assert b"left: no good data for 1.2 s" in rows["label"].tolist()


def test_the_robot_with_its_tool_is_grey_and_the_other_is_not() -> None:
    world = two_arms()
    pen = Decor(world).draw(with_age(world, -1), toggles_of(world), view_at(distance=5))
    assert pen.grey is not None
    of_left = [
        world.model.body(int(body)).name.startswith("left/") for body in world.model.geom_bodyid
    ]
    assert pen.grey.tolist() == of_left
    assert sum(of_left) == 25


def test_how_long_it_takes_is_declared() -> None:
    world = two_arms(stale_after=2.0)
    decor, toggles, view = Decor(world), toggles_of(world), view_at(distance=5)
    assert decor.draw(with_age(world, 1.9), toggles, view).grey is None
    assert decor.draw(with_age(world, 2.1), toggles, view).grey is not None


@pytest.mark.parametrize("fast", [True, False])
def test_a_host_greys_what_it_is_told_and_nothing_else(fast: bool) -> None:
    world = two_arms()
    data = with_age(world, -1)
    scene = mujoco.MjvScene(world.model, 200)
    host = Host(scene)
    if not fast:
        host._view = None
    pen = Decor(world).draw(data, toggles_of(world), view_at(distance=5))
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(
        world.model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene
    )
    model_geoms = scene.ngeom
    host.add(pen)
    assert model_geoms == 49
    for geom in scene.geoms[:model_geoms]:
        declared = world.model.geom_rgba[geom.objid]
        if pen.grey is not None and pen.grey[geom.objid]:
            expected = 0.2 * declared[:3] + 0.8 * np.array(GREY)
            assert geom.rgba[:3] == pytest.approx(expected, abs=1e-5)
            assert geom.rgba[3] == pytest.approx(declared[3])
        else:
            assert geom.rgba == pytest.approx(declared, abs=1e-6)


@pytest.mark.gl
def test_a_stale_robot_is_seen_grey_in_the_picture_and_fresh_again() -> None:
    world = two_arms()
    with HeadlessRenderer(world, 400, 300, "150,-14,3") as renderer:
        fresh = renderer.render(with_age(world, 0.1)).astype(int)
        stale = renderer.render(with_age(world, 3.0)).astype(int)
        again = renderer.render(with_age(world, 0.1)).astype(int)
    assert np.array_equal(fresh, again)
    darker = (fresh.sum(axis=2) - stale.sum(axis=2)) > 120
    assert darker.sum() > 1500
