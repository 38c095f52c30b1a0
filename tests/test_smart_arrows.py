"""Smart arrows: position, direction, length, width, rotation, color, count."""

from typing import Any

import numpy as np
import pytest
from conftest import examples
from decor_tools import (
    bands,
    belonging,
    heads,
    length_of,
    rigid,
    rounds,
    tip_of,
    toggles_of,
    turned,
    vertices_of,
    view_at,
    width_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame, SmartArrow
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import GeomBuffer, Kind
from sero_mj.viewer.decor.smart_arrows import frames_along

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
TARGET = np.array([-0.4, 0.9, 0.1, -1.1, 0.6, 0.5, -0.3])
BASE = rigid(turned([1, 2, 3], 0.9), [0.2, -0.3, 0.4])
VECTOR = np.array([3.0, -4.0, 12.0])  # 13 long
POINT = [0.4, -0.1, 0.9]
AXIS_ALIGNED = [sign * row for sign in (1.0, -1.0) for row in np.eye(3)]


def world_with(*arrows: SmartArrow) -> World:
    robot = SerialRobot.from_model("lwr", joint_angles=POSE, base_frame=BASE.tolist())
    double = Double(name="goal", of="lwr", joint_angles=TARGET)
    sensor = ReceivedFrame(name="sensor", relative_to="lwr/base", frame=SENSOR.tolist())
    return World(
        Scene(robots=[robot], doubles=[double], frames=[sensor], arrows=list(arrows), floor=False)
    )


SENSOR = rigid(turned([0, 1, 1], -0.7), [0.5, 0.1, 0.3])


def frame_by_hand(world: World, name: str) -> np.ndarray:
    """Returns T_world_name from the DH table."""
    robot = world.scene.robots["lwr"]
    if name == "world":
        return np.eye(4)
    if name == "sensor":
        return BASE @ SENSOR
    owner, _, label = name.partition("/")
    frames = robot.dh.frames(POSE if owner == "lwr" else TARGET, BASE)
    if label == "flange":
        return frames[-1] @ robot.flange_frame
    return frames[0 if label == "base" else int(label.removeprefix("link"))]


def draw(world: World, data=None, *, toggles=None, time: float = 0.0) -> GeomBuffer:
    if data is None:
        data = world.make_data()
    Placer(world).place(data)
    data.time = time
    toggles = toggles or toggles_of(world)
    toggles.axes[:] = False
    return Decor(world).draw(data, toggles, view_at())


def distance_of_ends(pair: Any, point: Any) -> float:
    """Returns the distance of a point from the closer end of a straight arrow, m."""
    return min(float(np.linalg.norm(end - point)) for end in (pair["pos"][0], tip_of(pair)))


def test_arrow_whose_head_would_be_inside_a_link_ends_at_its_point() -> None:
    world = world_with(SmartArrow(name="push", at="lwr/flange", scale=0.005))
    data, decor, toggles = world.make_data(), Decor(world), toggles_of(world)
    flange = frame_by_hand(world, "lwr/flange")[:3, 3]

    def drawn(*vector: float) -> Any:
        world.set_input(data, "push.vector", vector)
        buffer = decor.draw(data, toggles, view_at())
        pair = belonging(buffer, Kind.VECTOR, 0)
        assert pair["mat"][0][:, 2] @ world.frame(data, "lwr/flange")[:3, :3] == pytest.approx(
            np.array(vector) / np.linalg.norm(vector), abs=1e-6
        )
        return pair

    assert drawn(0, 0, 20.0)["pos"][0] == pytest.approx(flange, abs=1e-6)  # away from the hand
    assert tip_of(drawn(0, 0, -20.0)) == pytest.approx(flange, abs=1e-6)
    # Neither end is inside: it is unchanged until its head is well outside.
    assert tip_of(drawn(0, 10.0, -20.0)) == pytest.approx(flange, abs=1e-6)
    assert drawn(0, 40.0, 0)["pos"][0] == pytest.approx(flange, abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("at", "expressed_in"),
    [
        ("lwr/link4", None),
        ("lwr/flange", None),
        ("lwr/flange", "world"),
        ("lwr/base", "lwr/flange"),
        ("goal/link5", None),
        ("goal/flange", "lwr/link2"),
        ("sensor", None),
        ("lwr/link3", "sensor"),
        (POINT, None),
        (POINT, "lwr/link3"),
    ],
)
@pytest.mark.parametrize("kind", ["force", "torque"])
def test_arrow_is_at_its_frame_and_points_along_its_components(kind: str, at, expressed_in) -> None:
    arrow = SmartArrow(name="push", kind=kind, at=at, expressed_in=expressed_in, vector=VECTOR)
    world = world_with(arrow)
    buffer = draw(world)
    rows = belonging(buffer, Kind.VECTOR, 0)
    assert len(rows) == buffer.count == (2 if kind == "force" else 1)
    start = np.array(at) if isinstance(at, list) else frame_by_hand(world, at)[:3, 3]
    default = "world" if isinstance(at, list) else at
    direction = frame_by_hand(world, expressed_in or default)[:3, :3] @ VECTOR / 13.0
    for row in rows:
        assert row["mat"][:, 2] == pytest.approx(direction, abs=1e-6)
        assert row["mat"].T @ row["mat"] == pytest.approx(np.eye(3), abs=1e-5)
        assert np.linalg.det(row["mat"]) == pytest.approx(1.0, abs=1e-5)
    if kind == "force":
        assert distance_of_ends(rows, start) == pytest.approx(0, abs=1e-6)
        return
    assert rows["pos"][0] == pytest.approx(start, abs=1e-6)
    assert rows["size"][0, :2] == pytest.approx([0.12, 0.12])


@pytest.mark.parametrize(
    ("kind", "scale", "rgba"),
    [
        ("force", 0.004, (0.76, 0.08, 0.50, 1.0)),
        ("torque", 0.005, (0.50, 0.16, 0.72, 1.0)),
        ("velocity", 0.5, (0.00, 0.50, 0.52, 1.0)),
        ("angular_velocity", 0.05, (0.36, 0.42, 0.05, 1.0)),
    ],
)
def test_every_kind_has_its_color_scale_and_shape(kind: str, scale: float, rgba) -> None:
    vector = np.array([0.0, 0.03, 0.04]) / scale  # drawn 50 mm long or wide
    rows = belonging(draw(world_with(SmartArrow(name="v", kind=kind, at=POINT, vector=vector))), 5)
    turns = kind in ("torque", "angular_velocity")
    assert len(rows) == (1 if turns else 2)
    assert rows["rgba"] == pytest.approx(np.tile(rgba, (len(rows), 1)))
    drawn = width_of(rows[0]) if turns else length_of(rows)
    assert drawn == pytest.approx(0.05, rel=1e-5)
    assert (rows["label"] == b"").all()


@pytest.mark.parametrize("length", [0.01, 0.08, 0.2, 0.4])
def test_length_is_scale_times_magnitude_and_thickness_is_limited(length: float) -> None:
    arrow = SmartArrow(name="push", at=POINT, scale=0.02, vector=VECTOR / 13 * length / 0.02)
    pair = belonging(draw(world_with(arrow)), Kind.VECTOR)
    assert length_of(pair) == pytest.approx(length, rel=1e-5)
    width = min(max(0.09 * length, 0.008), 0.024)
    assert pair["size"][0, :2] == pytest.approx([width, width], rel=1e-5)
    assert 2 * width < pair["size"][1, 0] < 3 * width
    assert pair["size"][1, 2] == pytest.approx(min(2.9 * width, length / 2), rel=1e-5)


@pytest.mark.parametrize("longest", [None, 0.25])
def test_straight_arrow_is_limited_to_longest_and_then_dark(longest: float | None) -> None:
    limit = longest or 0.5
    own = np.array([0.2, 0.4, 0.6, 0.8])
    for size, length, bright in ((0.99, 0.99, 1), (1.0, 1.0, 1), (1.01, 1.0, 0.4), (9, 1.0, 0.4)):
        vector = [0, -2 * size * limit, 0]
        arrow = SmartArrow(
            name="v", at=POINT, scale=0.5, longest=longest, rgba=own, vector=vector
        )  # fmt: skip
        pair = belonging(draw(world_with(arrow)), Kind.VECTOR)
        assert length_of(pair) == pytest.approx(length * limit, rel=1e-5)
        for row in pair:
            assert row["rgba"] == pytest.approx([*(bright * own[:3]), 0.8])
            assert row["mat"][:, 2] == pytest.approx([0, -1, 0], abs=1e-6)


@pytest.mark.parametrize(("longest", "limit"), [(None, 0.25), (0.125, 0.125)])
def test_round_arrow_is_limited_to_longest_and_then_striped(longest, limit) -> None:
    for size, width, stripes in ((0.5, 0.5, 0), (1.0, 1.0, 0), (1.01, 1.0, 1), (9.0, 1.0, 1)):
        arrow = SmartArrow(
            name="turn", kind="torque", at=POINT, radius=0.25, scale=0.5, longest=longest,
            vector=[2 * size * limit, 0, 0],
        )  # fmt: skip
        rows = belonging(draw(world_with(arrow)), Kind.VECTOR)
        (arrow,) = rounds(rows)
        assert width_of(arrow) == pytest.approx(width * limit, rel=1e-5)
        assert np.ptp(vertices_of(arrow)[:, 0]) > width * limit  # over the barbs
        assert arrow["rgba"][:3] == pytest.approx((0.50, 0.16, 0.72))
        dark = bands(rows)
        assert len(dark) == stripes
        for band in dark:
            assert (band["rgba"][:3] < 0.1).all()
            for field in ("pos", "mat", "size"):
                assert (band[field] == arrow[field]).all()


@pytest.mark.parametrize("kind", ["force", "torque"])
def test_vectors_below_four_millimeters_are_not_drawn(kind: str) -> None:
    for size, there in ((0.0, False), (0.0039, False), (0.0041, True)):
        arrow = SmartArrow(name="v", kind=kind, at=POINT, scale=0.1, vector=[0, size / 0.1, 0])
        assert (draw(world_with(arrow)).count > 0) == there


@pytest.mark.parametrize("kind", ["force", "torque"])
def test_vector_without_data_or_with_nan_is_not_drawn(kind: str) -> None:
    world = world_with(
        SmartArrow(name="first", kind=kind, at="lwr/flange"),
        SmartArrow(name="second", at=POINT, vector=VECTOR),
    )
    data = world.make_data()

    def items() -> set[int]:
        buffer = draw(world, data)
        assert (buffer.kinds[: buffer.count] == Kind.VECTOR).all()
        return set(buffer.items[: buffer.count].tolist())

    assert items() == {1}
    world.set_input(data, "first.vector", VECTOR)
    assert items() == {0, 1}
    for wrong in (np.nan, np.inf, -np.inf):
        for axis in range(3):
            world.set_input(data, "first.vector", VECTOR)
            data.userdata[world.slots["first.vector"]][axis] = wrong
            assert items() == {1}
    world.set_input(data, "first.vector", VECTOR)
    assert items() == {0, 1}


@given(
    direction=st.one_of(
        st.sampled_from([tuple(row) for row in AXIS_ALIGNED]),
        st.sampled_from([(1, 1, 0), (-1, 0, 1), (1, -1, -1), (0, 1e-9, -1), (1e-7, -1e-7, 1)]),
        st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-3),
    )
)
def test_any_direction_gets_a_rotation_with_that_z(direction: tuple[float, float, float]) -> None:
    unit = np.array(direction, float) / np.linalg.norm(direction)
    (R,) = frames_along(unit[None])
    assert R[:, 2] == pytest.approx(unit, abs=1e-12)
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0, abs=1e-12)


@pytest.fixture(scope="module")
def both() -> World:
    """Returns a world with a force and a torque at a link, in its frame."""
    return world_with(
        SmartArrow(name="push", kind="force", at="lwr/link6", scale=0.1),
        SmartArrow(name="turn", kind="torque", at="lwr/link6", scale=0.1, radius=0.2),
    )


@settings(max_examples=examples(60), deadline=None)
@given(
    direction=st.one_of(
        st.sampled_from([tuple(row) for row in AXIS_ALIGNED]),
        st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 1e-2),
    ),
    size=st.floats(0.06, 4.0),
    time=st.floats(0, 100),
)
def test_force_and_torque_of_any_direction_are_drawn_by_the_right_hand_rule(
    both: World, direction, size: float, time: float
) -> None:
    unit = np.array(direction, float) / np.linalg.norm(direction)
    data = both.make_data()
    both.set_input(data, "push.vector", size * unit)
    both.set_input(data, "turn.vector", size * unit)
    frame = frame_by_hand(both, "lwr/link6")
    axis = frame[:3, :3] @ unit
    buffer = draw(both, data, time=time)
    straight = belonging(buffer, Kind.VECTOR, 0)
    assert distance_of_ends(straight, frame[:3, 3]) == pytest.approx(0, abs=1e-6)
    assert straight["mat"][0][:, 2] == pytest.approx(axis, abs=1e-6)
    assert length_of(straight) == pytest.approx(min(0.1 * size, 0.5), rel=1e-5)
    first, later = (
        rounds(belonging(each, Kind.VECTOR, 1))[0]
        for each in (buffer, draw(both, data, time=time + 0.1))
    )
    assert first["pos"] == pytest.approx(frame[:3, 3], abs=1e-6)
    assert first["mat"][:, 2] == pytest.approx(axis, abs=1e-6)
    # In a tenth of a second, it has rotated by 0.16 rad about the vector.
    out, then = (each["mat"][:, 0].astype(float) for each in (first, later))
    assert np.arctan2(np.cross(out, then) @ axis, out @ then) == pytest.approx(0.16, abs=1e-4)


def test_hidden_arrow_is_not_drawn_and_a_packet_switches_it() -> None:
    world = world_with(
        SmartArrow(name="first", at=POINT, vector=VECTOR),
        SmartArrow(name="second", kind="torque", at=POINT, vector=VECTOR, show=False),
    )
    data, toggles = world.make_data(), toggles_of(world)
    assert draw(world, data, toggles=toggles).count == 2
    toggles.vectors[:] = (False, True)
    buffer = draw(world, data, toggles=toggles)
    assert (buffer.count, set(buffer.items[: buffer.count])) == (1, {1})
    toggles.vectors[:] = False
    assert draw(world, data, toggles=toggles).count == 0
    world.set_input(data, "second.show", 1.0)
    assert draw(world, data, toggles=toggles).count == 1
    world.set_input(data, "second.show", 0.0)
    assert draw(world, data, toggles=toggles).count == 0


def test_arrow_follows_the_robot() -> None:
    world = world_with(SmartArrow(name="push", at="lwr/flange", vector=VECTOR))
    data = world.make_data()
    world.set_input(data, "lwr.joint_angles", TARGET)
    row, _ = belonging(draw(world, data), Kind.VECTOR)
    flange = frame_by_hand(world, "goal/flange")  # the arrow is at the flange
    assert row["pos"] == pytest.approx(flange[:3, 3], abs=1e-6)
    assert row["mat"][:, 2] == pytest.approx(flange[:3, :3] @ VECTOR / 13, abs=1e-6)


def test_many_arrows_of_both_shapes_keep_their_own_items() -> None:
    kinds = ["torque", "force", "velocity", "angular_velocity", "force"]
    scale = {"torque": 0.005, "force": 0.004, "velocity": 0.5, "angular_velocity": 0.05}
    arrows = [
        SmartArrow(
            name=f"v{k}",
            kind=kind,
            at=[0.1 * k, 0, 0.5],
            vector=[0, 0.02 * (k + 1) / scale[kind], 0],
        )
        for k, kind in enumerate(kinds)
    ]
    buffer = draw(world_with(*arrows))
    for k, arrow in enumerate(arrows):
        rows = belonging(buffer, Kind.VECTOR, k)
        assert len(rows) == (1 if arrow.is_round else 2)
        size = width_of(rows[0]) if arrow.is_round else length_of(rows)
        assert size == pytest.approx(0.02 * (k + 1), rel=1e-5)
        centre = rows["pos"].mean(axis=0)
        assert centre[0] == pytest.approx(0.1 * k, abs=0.05)
        assert rows["rgba"] == pytest.approx(np.tile(arrow.color, (len(rows), 1)))
    assert len(heads(buffer.rows[: buffer.count])) == 3
