"""A robot without fresh data is gray and labeled, in geoms and in images."""

import mujoco
import numpy as np
import pytest
from decor_tools import belonging, labels, of_kind, rectangle, texts_in, toggles_of, view_at
from source_slots import set_source

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.viewer.decor.axes import AXIS_RGB
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import GREY, Kind
from sero_mj.viewer.decor.scene_writer import SceneWriter
from sero_mj.viewer.decor.staleness import Staleness
from sero_mj.viewer.image.render import HeadlessRenderer

GEOM = mujoco.mjtGeom


def two_arms(**fields) -> World:
    """Returns a world in which a source feeds `left`, and `right` stays as declared."""
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


def with_age(world: World, age: float, **more: float) -> mujoco.MjData:
    data = world.make_data()
    set_source(data, world, "udp", received=5, age=age, size=56, **more)
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
def test_robot_shows_the_age_of_its_data(age: float, text: str | None) -> None:
    world = two_arms()
    decor = Decor(world)
    buffer = decor.draw(with_age(world, age), toggles_of(world), view_at(distance=5))
    rows = of_kind(buffer.rows[: buffer.count], GEOM.mjGEOM_LABEL)
    assert [row["label"].decode() for row in rows] == ([text] if text else [])
    assert (buffer.grey is None) == (text is None)


@pytest.mark.parametrize(
    ("target", "ages", "text"),
    [
        ("joint_angles", (-1.0, -1.0), None),  # whoever moves it does not wait for packets
        ("joint_angles", (12.3, -1.0), "no data for 12.3 s"),  # its accelerations arrived, too
        ("joint_angles", (0.0, 4.5), "no data for 4.5 s"),  # torques arrived once and no more
        ("joint_accelerations", (-1.0, 0.0), None),
        ("joint_accelerations", (4.5, 0.0), "no data for 4.5 s"),
    ],
)
def test_inputs_set_by_a_program_count_as_data(
    target: str, ages: tuple[float, float], text: str | None
) -> None:
    sources = {
        name: {"kind": "udp", "port": port, "structure": "7F"}
        for port, name in enumerate(("angles", "efforts"), 1)
    }
    routes = {
        "lwr.joint_angles": "angles.values0",
        "lwr.joint_accelerations": "angles.values0",
        "lwr.torques": "efforts.values0",
    }
    world = World(
        Scene(robots=[SerialRobot.from_model("lwr")], sources=sources, routes=routes, floor=False)
    )
    data = world.make_data()
    world.set_input(data, f"lwr.{target}", np.zeros(7))
    for name, age in zip(sources, ages, strict=True):
        set_source(data, world, name, received=5, age=age, size=56)
    assert Staleness(world).find(data) == ({} if text is None else {"lwr": text})
    world.reset(data)
    for name in sources:
        set_source(data, world, name)
    assert Staleness(world).find(data) == {"lwr": "no data yet"}


def test_flange_check_without_fresh_data_shows_no_values() -> None:
    world = two_arms()
    for age, text in ((0.0, b"left flange check   0.00 mm    0.00 deg"),
                      (1.2, b"left flange check: no data for 1.2 s")):  # fmt: skip
        data = with_age(world, age)
        own = world.fwd_kin_base_to_flange(data, "left")
        world.set_input(data, "left.flange_check", own)
        buffer = Decor(world).draw(data, toggles_of(world), view_at(distance=5))
        rows = of_kind(buffer.rows[: buffer.count], GEOM.mjGEOM_LABEL)
        found = [label for label in rows["label"].tolist() if b"flange" in label]
        assert found == [text]


def test_malformed_packets_are_not_silence() -> None:
    world = two_arms()
    data = with_age(world, 1.2, fault_age=0.01)
    decor = Decor(world)
    buffer = decor.draw(data, toggles_of(world), view_at(distance=5))
    rows = of_kind(buffer.rows[: buffer.count], GEOM.mjGEOM_LABEL)
    assert b"left: no valid data for 1.2 s" in rows["label"].tolist()


def test_stale_robot_and_its_tool_are_gray_and_others_are_not() -> None:
    world = two_arms()
    buffer = Decor(world).draw(with_age(world, -1), toggles_of(world), view_at(distance=5))
    assert buffer.grey is not None
    of_left = [
        world.model.body(int(body)).name.startswith("left/") for body in world.model.geom_bodyid
    ]
    assert buffer.grey.tolist() == of_left
    assert sum(of_left) == 25


def test_stale_after_is_declared() -> None:
    world = two_arms(stale_after=2.0)
    decor, toggles, view = Decor(world), toggles_of(world), view_at(distance=5)
    assert decor.draw(with_age(world, 1.9), toggles, view).grey is None
    assert decor.draw(with_age(world, 2.1), toggles, view).grey is not None


def test_arrows_and_billboards_of_a_stale_robot_are_gray() -> None:
    world = two_arms(show_arrows=True, show_billboards=True)
    decor, toggles, view = Decor(world), toggles_of(world), view_at(distance=5)
    toggles.arrows[:] = toggles.billboards[:] = True
    colours = {}
    for age in (0.1, 3.0):
        data = with_age(world, age)
        for name in ("left", "right"):
            world.set_input(data, f"{name}.torques", [20.0, -30.0, 9.0, -9.0, 5.0, 5.0, -5.0])
        buffer = decor.draw(data, toggles, view)
        for kind in (Kind.ARROW, Kind.BILLBOARD):
            for joint in range(14):
                colours[age, kind, joint] = belonging(buffer, kind, joint)["rgba"][0].copy()
    for kind in (Kind.ARROW, Kind.BILLBOARD):
        for joint in range(14):
            fresh, stale = colours[0.1, kind, joint], colours[3.0, kind, joint]
            if joint < 7:
                assert np.ptp(stale[:3]) < 0.02  # gray
                assert stale[3] == fresh[3]
                assert np.abs(stale - fresh).max() > 0.05
            else:
                assert stale.tolist() == fresh.tolist()


def test_labels_covered_by_one_in_front_are_not_drawn() -> None:
    world = two_arms()
    decor, toggles, view = Decor(world), toggles_of(world), view_at(distance=5)
    toggles.billboards[:] = True
    data = with_age(world, 0.1)
    buffer = decor.draw(data, toggles, view)
    written = labels(buffer.rows[: buffer.count])
    low, high = rectangle(view, belonging(buffer, Kind.BILLBOARD, 3)[0])
    toggles.hover = ("left/link4 " * 8, ((low + high) / 2).tolist())  # too wide for any corner
    buffer = decor.draw(data, toggles, view)
    now = labels(buffer.rows[: buffer.count])
    assert "left/link4 " * 8 in now
    assert 1 <= len(written) + 1 - len(now) <= 4
    front = view.project(buffer.rows["pos"][: buffer.count][-1].astype(float))[1]
    boxes = of_kind(buffer.rows[: buffer.count], GEOM.mjGEOM_BOX)
    depths = view.project(boxes["pos"].astype(float))[1]
    assert depths.min() < front or (depths < 1.4 * view.near).sum() == 1


@pytest.mark.parametrize("fast", [True, False])
def test_scene_writer_grays_the_marked_geoms_only(fast: bool) -> None:
    world = two_arms()
    data = with_age(world, -1)
    scene = mujoco.MjvScene(world.model, 200)
    host = SceneWriter(scene)
    if not fast:
        host._view = None
    buffer = Decor(world).draw(data, toggles_of(world), view_at(distance=5))
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(
        world.model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene
    )
    model_geoms = scene.ngeom
    host.add(buffer)
    assert model_geoms == 49
    for geom in scene.geoms[:model_geoms]:
        declared = world.model.geom_rgba[geom.objid]
        if buffer.grey is not None and buffer.grey[geom.objid]:
            expected = 0.2 * declared[:3] + 0.8 * np.array(GREY)
            assert geom.rgba[:3] == pytest.approx(expected, abs=1e-5)
            assert geom.rgba[3] == pytest.approx(declared[3])
        else:
            assert geom.rgba == pytest.approx(declared, abs=1e-6)


@pytest.mark.parametrize("fast", [True, False])
def test_scene_writer_does_not_show_hidden_geoms(fast: bool) -> None:
    world = fed_world()
    toggles = toggles_of(world)
    toggles.doubles[:] = False
    toggles.axes[:] = toggles.vectors[:] = False
    data = world.make_data()
    Placer(world).place(data)
    scene = mujoco.MjvScene(world.model, 200)
    host = SceneWriter(scene)
    if not fast:
        host._view = None
    everything = mujoco.mjtCatBit.mjCAT_ALL.value
    mujoco.mjv_updateScene(
        world.model, data, mujoco.MjvOption(), None, mujoco.MjvCamera(), everything, scene
    )
    assert scene.ngeom == 3 * 24
    host.add(Decor(world).draw(data, toggles, view_at(distance=4)))
    seen = [geom.objid for geom in scene.geoms[: scene.ngeom] if geom.rgba[3] > 0]
    assert sorted(seen) == (~np.array(geoms_of(world, "double-"))).nonzero()[0].tolist()


@pytest.mark.gl
def test_stale_robot_is_rendered_gray_and_then_fresh_again() -> None:
    world = two_arms()
    with HeadlessRenderer(world, 400, 300, "150,-14,3") as renderer:
        fresh = renderer.render(with_age(world, 0.1)).astype(int)
        stale = renderer.render(with_age(world, 3.0)).astype(int)
        again = renderer.render(with_age(world, 0.1)).astype(int)
    assert np.array_equal(fresh, again)
    darker = (fresh.sum(axis=2) - stale.sum(axis=2)) > 120
    assert darker.sum() > 1500


def fed_world(**routes: str) -> World:
    """Returns a world of a robot with a double, smart arrows and frames, with these routes."""
    sources = {
        name: {"kind": "udp", "port": port, "structure": "7F1V1M1F"}
        for port, name in enumerate(("arm", "goal_in", "sensor", "tracker", "keys"), 1)
    }
    arrow = {"at": [0, 0, 0.5], "vector": [0, 0, 9.0], "scale": 0.01}
    return World(
        Scene(
            robots=[SerialRobot.from_model("lwr"), SerialRobot.from_model("lwr", name="other")],
            doubles=[Double(name="goal", of="lwr", joint_angles=np.full(7, 0.4))],
            arrows=[
                SmartArrow(name="push", **arrow),
                SmartArrow(name="long", longest=0.02, **arrow),
                SmartArrow(name="turn", kind="torque", **arrow),
                SmartArrow(name="wide", kind="torque", longest=0.02, **arrow),
                SmartArrow(name="fixed", **arrow),
            ],
            frames=[
                ReceivedFrame(name="seen", frame={"xyz": [0.2, 0.3, 0.4]}),
                ReceivedFrame(name="still", frame={"xyz": [0.2, -0.3, 0.4]}),
            ],
            sources=sources,
            routes={target.replace("__", "."): origin for target, origin in routes.items()},
            floor=False,
        )
    )


def drawn_with(world: World, **ages: float):
    """Returns the buffer with these ages of sources; other sources are fresh."""
    data = world.make_data()
    for name in world.scene.sources:
        set_source(data, world, name, received=5, age=ages.get(name, 0.1), size=216)
    Placer(world).place(data)
    return Decor(world).draw(data, toggles_of(world), view_at(distance=4))


def written(buffer) -> list[str]:
    return labels(buffer.rows[: buffer.count])


def geoms_of(world: World, start: str) -> list[bool]:
    return [world.model.body(int(body)).name.startswith(start) for body in world.model.geom_bodyid]


def test_stale_double_alone_is_gray_and_labeled_at_its_robot_base() -> None:
    world = fed_world(lwr__joint_angles="arm.values0", goal__joint_angles="goal_in.values0")
    buffer = drawn_with(world, goal_in=1.4)
    assert written(buffer) == ["goal: no data for 1.4 s"]
    assert buffer.grey is not None
    assert buffer.grey.tolist() == geoms_of(world, "double-goal-")
    buffer = drawn_with(world, arm=-1)
    assert written(buffer) == ["lwr: no data yet"]
    assert buffer.grey is not None
    assert buffer.grey.tolist() == geoms_of(world, "lwr/")


def test_lines_of_a_robot_and_its_double_are_stacked() -> None:
    world = fed_world(
        lwr__joint_angles="arm.values0",
        goal__joint_angles="goal_in.values0",
        other__torques="sensor.values0",
    )
    view = view_at(distance=4)
    buffer = drawn_with(world, arm=3.0, goal_in=-1)
    rows = buffer.rows[: buffer.count]
    assert written(buffer) == ["lwr: no data for 3.0 s", "goal: no data yet"]
    panels = of_kind(rows, GEOM.mjGEOM_BOX)
    (panel,) = panels[panels["emission"] == 1]
    assert texts_in(view, rows, panel) == written(buffer)
    starts, _ = view.project(of_kind(rows, GEOM.mjGEOM_LABEL)["pos"].astype(float))
    assert starts[0, 0] == pytest.approx(starts[1, 0], abs=0.5)
    assert starts[0, 1] - starts[1, 1] == pytest.approx(view.font.height, abs=0.5)
    # Under the base.
    (base,), _ = view.project(np.zeros((1, 3)))
    low, high = rectangle(view, panel)
    assert low[0] < base[0] < high[0]
    assert high[1] < base[1]
    assert buffer.grey is not None
    both = np.array(geoms_of(world, "lwr/")) | geoms_of(world, "double-goal-")
    assert buffer.grey.tolist() == both.tolist()


def test_stale_arrow_is_gray_and_the_others_are_not() -> None:
    world = fed_world(
        **{f"{name}__vector": "sensor.vectors0" for name in ("push", "long", "turn", "wide")}
    )
    declared = world.arrows.rgba
    for age in (0.1, 0.6, -1.0):
        buffer = drawn_with(world, sensor=age)
        assert buffer.grey is None and written(buffer) == []
        for k, name in enumerate(("push", "long", "turn", "wide", "fixed")):
            rows = belonging(buffer, Kind.VECTOR, k)
            rgba = rows[rows["type"] != GEOM.mjGEOM_TRIANGLE]["rgba"]
            stale = age != 0.1 and name != "fixed"
            colour = np.array([*GREY, 1.0]) if stale else declared[k].copy()
            if name == "long":
                colour[:3] *= 0.4  # too long for the scale, still
            unstriped = rgba[::2] if name == "wide" else rgba
            assert unstriped == pytest.approx(np.tile(colour, (len(unstriped), 1)), rel=1e-5)


def test_stale_frame_is_gray_and_the_others_are_not() -> None:
    world = fed_world(seen__frame="tracker.matrices0")
    for age in (0.1, 0.6, -1.0):
        buffer = drawn_with(world, tracker=age)
        assert buffer.grey is None and written(buffer) == []
        for name in ("seen", "still"):
            bars = belonging(buffer, Kind.AXES, world.frames.names.index(name))
            grey = 0.75 if age != 0.1 and name == "seen" else 0.0
            expected = (1 - grey) * AXIS_RGB + grey * np.array(GREY)
            assert bars["rgba"][:, :3] == pytest.approx(expected, rel=1e-5)


def test_switches_do_not_count_as_data() -> None:
    world = fed_world(
        lwr__show_arrows="keys.values1",
        lwr__arrow_quantity="keys.values1",
        goal__visible="keys.values1",
        goal__show_axes="keys.values1",
        push__show="keys.values1",
        seen__show_axes="keys.values1",
        toggles__legend="keys.values1",
    )
    for age in (-1.0, 99.0):
        buffer = drawn_with(world, keys=age)
        assert buffer.grey is None and written(buffer) == []
        rgba = belonging(buffer, Kind.VECTOR, 0)["rgba"][0]
        assert rgba == pytest.approx(world.arrows.rgba[0])
        bars = belonging(buffer, Kind.AXES, world.frames.names.index("seen"))
        assert bars["rgba"][:, :3] == pytest.approx(AXIS_RGB)


def test_silent_switch_source_does_not_make_data_stale() -> None:
    world = fed_world(
        lwr__joint_angles="arm.values0",
        lwr__show_arrows="keys.values1",
        push__vector="sensor.vectors0",
        push__show="keys.values1",
    )
    assert written(drawn_with(world, keys=-1)) == []
    assert written(drawn_with(world, keys=-1, arm=2.0)) == ["lwr: no data for 2.0 s"]


def test_oldest_of_several_sources_counts_including_the_flange_check() -> None:
    world = fed_world(lwr__joint_angles="arm.values0", lwr__flange_check="tracker.matrices0")
    assert written(drawn_with(world, arm=0.2)) == []
    assert written(drawn_with(world, arm=0.2, tracker=0.7)) == ["lwr: no data for 0.7 s"]
    assert written(drawn_with(world, arm=1.2, tracker=0.7)) == ["lwr: no data for 1.2 s"]
    assert written(drawn_with(world, arm=1.2, tracker=-1)) == ["lwr: no data yet"]


def test_robot_that_follows_a_frame_has_no_age() -> None:
    world = fed_world(other__base_frame="lwr/flange", lwr__joint_angles="arm.values0")
    buffer = drawn_with(world, arm=5.0)
    assert written(buffer) == ["lwr: no data for 5.0 s"]
    assert buffer.grey is not None
    assert not buffer.grey[np.array(geoms_of(world, "other/"))].any()
