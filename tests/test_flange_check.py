"""The received flange frame against the computed one: difference, bars, line and labels."""

import numpy as np
import pytest
from conftest import examples
from decor_tools import (
    GEOM,
    belonging,
    labels,
    of_kind,
    rectangle,
    rigid,
    texts_in,
    toggles_of,
    turned,
    view_at,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene, SceneToggles
from sero_mj.viewer.decor.axes import AXIS_RGB
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.flange_check import OFF_RGBA, flange_difference
from sero_mj.viewer.decor.geom_buffer import Kind

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
BASE = rigid(turned([1, 2, 3], 0.4), [0.1, -0.2, 0.1])


def world_of_arms(*names: str, **fields) -> World:
    robots = [
        SerialRobot.from_model(
            "lwr",
            name=name,
            joint_angles=POSE * (1 - 0.1 * i),
            base_frame=(rigid(np.eye(3), [0, 0.8 * i, 0]) @ BASE).tolist(),
            **fields,
        )
        for i, name in enumerate(names)
    ]
    return World(Scene(robots=robots, floor=False))


@pytest.fixture(scope="module")
def world() -> World:
    return world_of_arms("lwr")


def own_flange(world: World, name: str = "lwr") -> np.ndarray:
    """Returns T_base_flange from the DH table."""
    robot = world.scene.robots[name]
    return robot.dh.frames(robot.joint_angles)[-1] @ robot.flange_frame


def displaced(world: World, name: str, mm: float, deg: float, seed: int = 0) -> np.ndarray:
    """Returns T_base_flange, translated and rotated by these amounts in a random direction."""
    rng = np.random.default_rng(seed)
    away, axis = rng.normal(size=(2, 3))
    own = own_flange(world, name)
    T = own.copy()
    T[:3, :3] = own[:3, :3] @ turned(axis, np.deg2rad(deg))
    T[:3, 3] += 1e-3 * mm * away / np.linalg.norm(away)
    return T


def draw(world: World, data, view=None, toggles=None):
    Placer(world).place(data)
    buffer = Decor(world).draw(data, toggles or toggles_of(world), view or view_at(distance=3))
    return buffer, buffer.rows[: buffer.count]


def bars_and_line(rows):
    """Returns the bars of the received frame and the line, excluding boxes in front of the eye."""
    boxes = of_kind(rows, GEOM.mjGEOM_BOX)
    return of_kind(rows, GEOM.mjGEOM_MESH), boxes[boxes["emission"] < 1]


@settings(max_examples=examples(50), deadline=None)
@given(mm=st.floats(0, 500), deg=st.floats(0, 180), seed=st.integers(0, 2**31))
def test_difference_equals_the_displacement(world: World, mm: float, deg: float, seed: int) -> None:
    data = world.make_data()
    assert flange_difference(world, data, "lwr") is None
    world.set_input(data, "lwr.flange_check", displaced(world, "lwr", mm, deg, seed))
    found = flange_difference(world, data, "lwr")
    assert found is not None
    assert 1e3 * found[0] == pytest.approx(mm, abs=1e-6)
    assert np.rad2deg(found[1]) == pytest.approx(deg, abs=1e-5)


def test_received_frame_is_drawn_relative_to_the_base(world: World) -> None:
    data = world.make_data()
    T = displaced(world, "lwr", 120, 30)
    world.set_input(data, "lwr.flange_check", T)
    _, rows = draw(world, data)
    in_world, own = BASE @ T, BASE @ own_flange(world)
    bars, line = bars_and_line(rows)
    assert len(line) == 1
    length = 0.8 * 0.2  # of the robot's axes
    for axis, bar in enumerate(bars):
        direction = in_world[:3, axis]
        assert bar["mat"][:, 2] == pytest.approx(direction, abs=1e-6)
        assert bar["pos"] == pytest.approx(in_world[:3, 3], abs=1e-6)
        assert bar["size"] == pytest.approx([0.06 * length] * 2 + [length], rel=1e-5)
        pale = AXIS_RGB[axis] + 0.45 * (1 - AXIS_RGB[axis])
        assert bar["rgba"] == pytest.approx([*pale, 1.0], rel=1e-5)
        assert np.linalg.det(bar["mat"]) == pytest.approx(1.0, abs=1e-5)
    between = in_world[:3, 3] - own[:3, 3]
    assert line["pos"][0] == pytest.approx(own[:3, 3] + between / 2, abs=1e-6)
    assert line["mat"][0][:, 2] == pytest.approx(between / 0.12, abs=1e-5)
    assert line["size"][0] == pytest.approx([0.003, 0.003, 0.06], rel=1e-5)


def on_card(name: str, mm: float, deg: float) -> list[str]:
    return [f"{name} flange is off", f"  position {mm:8.2f} mm", f"  angle    {deg:8.2f} deg"]


@pytest.mark.parametrize(
    ("mm", "deg", "off"),
    [
        (0.0, 0.0, False),
        (0.99, 0.0, False),
        (0.99, 0.49, False),
        (1.01, 0.0, True),
        (0.0, 0.51, True),
        (0.0, 179.0, True),
        (1.01, 0.51, True),
        (80.0, 12.5, True),
    ],
)
def test_difference_is_red_at_the_flange_above_a_tolerance_else_in_the_corner(
    world: World, mm: float, deg: float, off: bool
) -> None:
    data, view = world.make_data(), view_at(distance=3)
    world.set_input(data, "lwr.flange_check", displaced(world, "lwr", mm, deg))
    buffer, rows = draw(world, data, view)
    numbers = f"{mm:7.2f} mm  {deg:6.2f} deg"
    checks = belonging(buffer, Kind.CHECK)
    _, line = bars_and_line(rows)
    if off:
        assert labels(rows) == on_card("lwr", mm, deg)
        (card,) = checks
        assert texts_in(view, rows, card) == on_card("lwr", mm, deg)
        assert card["rgba"] == pytest.approx(OFF_RGBA)
        assert card["rgba"][0] > 0.5 > 10 * card["rgba"][1]  # red
        (leader,) = of_kind(rows, GEOM.mjGEOM_TRIANGLE)
        tip, _ = view.project(leader["pos"] + leader["mat"][:, 1] * leader["size"][1].astype(float))
        point = (BASE @ displaced(world, "lwr", mm, deg))[:3, 3]
        assert tip == pytest.approx(view.project(point)[0], abs=4.0)
    else:
        assert labels(rows) == [f"lwr flange check{numbers}"]
        assert not len(checks)
        assert not len(of_kind(rows, GEOM.mjGEOM_TRIANGLE))
        low, high = rectangle(view, of_kind(rows, GEOM.mjGEOM_BOX)[-1])
        assert low[0] > view.width / 2 and low[1] > 0.9 * view.height
        assert high[0] <= view.width and high[1] <= view.height
    assert len(line) == (mm > 0)
    if mm:
        red = (0.78, 0.07, 0.07, 1.0) if off else (0.35, 0.37, 0.40, 1.0)
        assert line["rgba"][0] == pytest.approx(red)


def test_tolerances_are_declared_per_robot() -> None:
    world = world_of_arms("lwr", flange_tolerance=0.02, flange_tolerance_deg=5.0)
    data = world.make_data()
    for mm, deg, off in ((19.9, 4.9, False), (20.1, 0, True), (0, 5.1, True)):
        world.set_input(data, "lwr.flange_check", displaced(world, "lwr", mm, deg))
        buffer, _ = draw(world, data)
        assert len(belonging(buffer, Kind.CHECK)) == off


def test_several_robots_each_have_their_own_check() -> None:
    world = world_of_arms("first", "second", "third", "fourth", "fifth")
    data, view = world.make_data(), view_at(distance=7)
    assert draw(world, data, view)[0].count == 0
    world.set_input(data, "first.flange_check", displaced(world, "first", 40, 0))
    world.set_input(data, "second.flange_check", displaced(world, "second", 0.25, 0.12))
    world.set_input(data, "fourth.flange_check", displaced(world, "fourth", 0, 33))
    world.set_input(data, "fifth.flange_check", displaced(world, "fifth", 0.75, 0))
    buffer, rows = draw(world, data, view)
    first, fourth = belonging(buffer, Kind.CHECK)
    kinds = buffer.kinds[: buffer.count]
    assert sorted(buffer.items[: buffer.count][kinds == Kind.CHECK]) == [0, 3]
    assert texts_in(view, rows, first) == on_card("first", 40, 0)
    assert texts_in(view, rows, fourth) == on_card("fourth", 0, 33)
    # Checks within tolerance share one panel.
    corner = of_kind(rows, GEOM.mjGEOM_BOX)[-3]
    agreeing = [
        "second flange check   0.25 mm    0.12 deg",
        "fifth flange check   0.75 mm    0.00 deg",
    ]
    assert texts_in(view, rows, corner) == agreeing
    bars, lines = bars_and_line(rows)
    assert (len(bars), len(lines)) == (4 * 3, 3)  # the fourth is only rotated: no line


def test_moving_the_base_moves_the_received_frame_and_keeps_the_difference(world: World) -> None:
    data = world.make_data()
    T = displaced(world, "lwr", 15, 3)
    world.set_input(data, "lwr.flange_check", T)
    moved = rigid(turned([0, 0, 1], 1.1), [-0.3, 0.2, 0.2])
    world.set_input(data, "lwr.base_frame", moved)
    _, rows = draw(world, data)
    assert labels(rows) == on_card("lwr", 15, 3)
    bars, _ = bars_and_line(rows)
    tip = bars[2]["pos"] + 0.16 * bars[2]["mat"][:, 2]
    assert tip == pytest.approx((moved @ T @ [0, 0, 0.16, 1])[:3], abs=1e-5)


def test_moving_the_robot_changes_the_difference(world: World) -> None:
    data = world.make_data()
    world.set_input(data, "lwr.flange_check", own_flange(world))
    q = POSE.copy()
    q[6] += np.deg2rad(7.5)  # about the flange's own z
    world.set_input(data, "lwr.joint_angles", q)
    _, rows = draw(world, data)
    assert labels(rows) == on_card("lwr", 0, 7.5)


def test_no_data_or_nan_hides_the_check_of_that_robot_only() -> None:
    world = world_of_arms("first", "second")
    data = world.make_data()
    for name in ("first", "second"):
        world.set_input(data, f"{name}.flange_check", displaced(world, name, 30, 4))
    assert len(labels(draw(world, data)[1])) == 6
    slot = world.slots["first.flange_check"]
    for k in (0, 3, 7, 11):
        world.set_input(data, "first.flange_check", displaced(world, "first", 30, 4))
        data.userdata[slot][k] = np.nan
        assert flange_difference(world, data, "first") is None
        _, rows = draw(world, data)
        assert labels(rows)[0] == "second flange is off"
        bars, line = bars_and_line(rows)
        assert (len(bars), len(line)) == (3, 1)
        assert np.isfinite(rows["pos"]).all()
    data.userdata[world.slots["second.flange_check"]] = np.nan
    assert draw(world, data)[0].count == 0
    world.reset(data)
    assert draw(world, data)[0].count == 0


def test_check_that_is_switched_off_is_not_drawn(world: World) -> None:
    data, toggles = world.make_data(), toggles_of(world)
    world.set_input(data, "lwr.flange_check", displaced(world, "lwr", 30, 4))
    toggles.flange_checks = False
    assert draw(world, data, toggles=toggles)[0].count == 0
    toggles.flange_checks = True
    assert draw(world, data, toggles=toggles)[0].count > 0
    world.set_input(data, "toggles.flange_checks", 0.0)
    assert draw(world, data, toggles=toggles)[0].count == 0
    robots = list(world.scene.robots.values())
    declared = World(Scene(robots=robots, toggles=SceneToggles(flange_checks=False), floor=False))
    data = declared.make_data()
    declared.set_input(data, "lwr.flange_check", displaced(world, "lwr", 30, 4))
    assert draw(declared, data)[0].count == 0


def test_check_billboards_do_not_overlap_others_or_the_corner() -> None:
    world = world_of_arms("first", "second", show_billboards=True, torques=np.full(7, 3.0))
    data, view = world.make_data(), view_at(distance=4)
    world.set_input(data, "first.flange_check", displaced(world, "first", 30, 4))
    world.set_input(data, "second.flange_check", displaced(world, "second", 0.5, 0))
    _, rows = draw(world, data, view)
    boxes = of_kind(rows, GEOM.mjGEOM_BOX)
    panels = [rectangle(view, row) for row in boxes[boxes["emission"] == 1]]
    assert len(panels) == 14 + 2
    for i, (low, high) in enumerate(panels):
        assert (low >= -0.5).all() and (high <= np.array([1280.5, 800.5])).all()
        for other_low, other_high in panels[:i]:
            assert ((low >= other_high - 0.5) | (other_low >= high - 0.5)).any()
