"""Smart axes as numbers."""

import itertools

import numpy as np
import pytest
from conftest import examples
from decor_tools import belonging, drawn, look, rigid, toggles_of, turned, view_at, world_of
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import ReceivedFrame
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.viewer.decor.axes import AXIS_RGB, ranks
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.image.picking import pick

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])


def test_axes_are_drawn_at_base_joints_and_flange_along_x_y_z() -> None:
    world = world_of(joint_angles=POSE, show_axes=True, axes_size=0.15, axes_transparency=0.25)
    rows = drawn(world).reshape(-1, 3)
    robot = world.robots["lwr"].robot
    frames = robot.dh.frames(POSE, robot.base_frame)
    frames = np.concatenate([frames, frames[-1:] @ robot.flange_frame])
    assert len(rows) == len(frames) == 9
    for k, (bars, frame) in enumerate(zip(rows, frames, strict=True)):
        for axis in range(3):
            direction = frame[:3, axis]
            bar = bars[axis]
            assert bar["mat"][:, 2] == pytest.approx(direction, abs=1e-6)
            start = bar["pos"]
            end = bar["pos"] + bar["mat"][:, 2] * bar["size"][2]
            assert start == pytest.approx(frame[:3, 3], abs=1e-6)
            # Frames at one place are nested, the earlier ones longer.
            before = [f for f in frames[:k] if np.allclose(f[:3, 3], frame[:3, 3], atol=1e-9)]
            length = 0.15 / (1 + 0.45 * len(before))
            assert end == pytest.approx(frame[:3, 3] + length * direction, abs=1e-6)
            assert bar["rgba"] == pytest.approx([*AXIS_RGB[axis], 0.75])
            assert np.linalg.det(bar["mat"]) == pytest.approx(1.0, abs=1e-5)


def test_fully_transparent_axes_are_not_drawn() -> None:
    assert len(drawn(world_of(show_axes=True, axes_transparency=1.0))) == 0


def test_objects_of_shape_axes_are_always_shown() -> None:
    tool = Object(name="tcp", shape="axes", size=[0.1], frame={"xyz": [0, 0, 0.2]})
    world = world_of(joint_angles=POSE, children=[tool])
    rows = drawn(world)
    assert len(rows) == 3
    robot = world.robots["lwr"].robot
    tcp = robot.fwd_kin_base_to_flange(POSE) @ tool.frame
    assert rows["pos"][2] == pytest.approx(tcp[:3, 3], abs=1e-6)
    fixed = World(Scene(objects=[tool], floor=False))
    assert drawn(fixed)["pos"][0] == pytest.approx([0, 0, 0.2], abs=1e-6)


def frames_world(*frames: ReceivedFrame, **fields) -> World:
    return World(Scene(frames=list(frames), floor=False, **fields))


def at(name: str, rotation=None, position=(0, 0, 0.6), **fields) -> ReceivedFrame:
    T = rigid(np.eye(3) if rotation is None else rotation, position)
    return ReceivedFrame(name=name, frame=T.tolist(), **fields)


def draw(world: World, data=None, *, view=None, toggles=None):
    data = world.make_data() if data is None else data
    Placer(world).place(data)
    return Decor(world).draw(data, toggles or toggles_of(world), view or view_at())


def sizes(buffer, item: int) -> tuple[float, float]:
    """Returns length and half width of a frame's bars, which are equal for all three axes."""
    bars = belonging(buffer, Kind.AXES, item)
    assert len(bars) == 3
    assert np.ptp(bars["size"], axis=0).max() == 0
    assert bars["size"][0, 0] == bars["size"][0, 1]
    return float(bars["size"][0, 2]), float(bars["size"][0, 0]) / 2


def test_coincident_frames_are_nested_by_length_and_thickness() -> None:
    buffer = draw(frames_world(*[at(f"f{k}") for k in range(6)]))
    lengths, widths = zip(*(sizes(buffer, k) for k in range(6)), strict=True)
    assert lengths[0] == pytest.approx(0.2, rel=1e-6)
    assert widths[0] == pytest.approx(0.0044, rel=1e-5)
    # The tips of the earlier frames and the sides of the later ones stay visible by millimeters.
    assert (np.diff(lengths) < -0.008).all()
    assert (np.diff(widths) > 0.001).all()
    assert lengths[-1] > 0.05


def test_separate_frames_have_full_length_and_hidden_frames_are_not_counted() -> None:
    world = frames_world(at("a"), at("b", position=(0, 0.021, 0.6)), at("c", axes_size=0.1))
    toggles = toggles_of(world)
    buffer = draw(world, toggles=toggles)
    assert sizes(buffer, 0)[0] == sizes(buffer, 1)[0] == pytest.approx(0.2)
    assert sizes(buffer, 2)[0] == pytest.approx(0.1 / 1.45)
    toggles.axes[0] = False
    assert sizes(draw(world, toggles=toggles), 2) == pytest.approx((0.1, 0.0022), rel=1e-5)


@pytest.mark.parametrize(
    ("distance", "shared"), [(0.0, 1), (0.003, 1), (0.012, 0.5), (0.019, 0.0625), (0.021, 0)]
)
def test_axes_sizes_change_gradually_with_the_distance_of_frames(distance, shared) -> None:
    buffer = draw(frames_world(at("a"), at("b", position=(distance, 0, 0.6))))
    assert sizes(buffer, 1)[0] == pytest.approx(0.2 / (1 + 0.45 * shared), rel=1e-3)
    assert sizes(buffer, 1)[1] == pytest.approx(0.0044 * (1 + 0.35 * shared), rel=1e-3)


@settings(max_examples=examples(200))
@given(seed=st.integers(0, 2**31), count=st.integers(1, 12), step=st.floats(0, 1e-3))
def test_ranks_change_little_when_frames_move_little(seed: int, count: int, step: float) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-2, 2, 3) + rng.uniform(0, 0.03, (count, 3))
    moved = positions + rng.uniform(-1, 1, (count, 3)) * step / np.sqrt(3)
    before, after = ranks(positions), ranks(moved)
    # Each pair counts 1 from 4 mm on less, 0 from 20 mm on, and is linear in between.
    bound = np.arange(count) * 2 * step / 0.016 + 1e-5
    assert (np.abs(after - before) <= bound).all()
    expected = np.zeros(count)
    for k in range(count):
        for earlier in range(k):
            apart = np.linalg.norm(positions[k] - positions[earlier])
            expected[k] += min(max((0.020 - apart) / 0.016, 0), 1)
    assert before == pytest.approx(expected, abs=1e-5)
    assert before[0] == 0


# Every orientation whose axes lie along those of the world: bars of all of them coincide.
UPRIGHT = [
    np.array(rows, float)
    for rows in itertools.product([*np.eye(3), *-np.eye(3)], repeat=3)
    if np.isclose(np.linalg.det(np.array(rows)), 1)
]


EYES = [(1.6, 1.0, 1.3), (-1.1, 1.4, 0.2), (0.9, -1.2, 1.0)]


def tips_picked(world: World, rotations, eye) -> list[int]:
    """Returns the minimum number of picked tips of a frame, of three, from the camera side."""
    view = look(eye, [0, 0, 0.6])
    data = world.make_data()
    buffer = draw(world, data, view=view)
    counts = []
    for k, R in enumerate(rotations):
        length, half_width = sizes(buffer, k)
        names = []
        for axis in range(3):
            tip = np.array([0, 0, 0.6]) + 0.92 * length * R[:, axis]  # on the head
            sides = [sign * R[:, a] for a in range(3) if a != axis for sign in (1, -1)]
            towards = max(sides, key=lambda n: n @ (np.array(eye) - tip))
            (x, y), _ = view.project(tip + half_width * towards)
            hit = pick(world, data, buffer, view, (float(x), float(y)))
            assert hit is not None and hit.kind == "axes"
            names.append(hit.name)
        counts.append(names.count(f"f{k}"))
    return counts


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12))
def test_coincident_parallel_frames_are_each_picked_at_their_tips(seed: int) -> None:
    rng = np.random.default_rng(seed)
    chosen = rng.integers(0, 24, 5) if seed else [0] * 5
    rotations = [UPRIGHT[k] for k in chosen]
    world = frames_world(*[at(f"f{k}", R) for k, R in enumerate(rotations)])
    for eye in EYES:
        assert min(tips_picked(world, rotations, eye)) >= 2


@pytest.mark.parametrize("seed", range(8))
def test_coincident_rotated_frames_are_each_picked_from_some_side(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotations = [turned(rng.normal(size=3), rng.uniform(0, 3)) for _ in range(5)]
    world = frames_world(*[at(f"f{k}", R) for k, R in enumerate(rotations)])
    best = np.max([tips_picked(world, rotations, eye) for eye in EYES], axis=0)
    assert (best >= 2).all(), best


def test_received_frame_is_hidden_before_the_first_packet_and_after_nan() -> None:
    robot = SerialRobot.from_model(
        "lwr", joint_angles=POSE, base_frame=rigid(turned([1, 2, 3], 0.7), [0.1, 0.2, 0.1]).tolist()
    )
    frames = [
        ReceivedFrame(name="target", relative_to="lwr/flange", axes_transparency=0.5),
        ReceivedFrame(name="free", axes_size=0.1),
    ]
    world = World(Scene(robots=[robot], frames=frames, floor=False))
    data = world.make_data()
    assert draw(world, data).count == 0
    T = rigid(turned([3, -1, 1], 1.2), [0.05, 0.0, 0.15])
    world.set_input(data, "target.frame", T)
    buffer = draw(world, data)
    assert buffer.count == 3
    own = robot.dh.frames(POSE, robot.base_frame)[-1] @ robot.flange_frame
    check_bars(belonging(buffer, Kind.AXES, world.frames.names.index("target")), own @ T, 0.2, 0.5)
    world.set_input(data, "lwr.joint_angles", -POSE)  # it goes along
    moved = robot.dh.frames(-POSE, robot.base_frame)[-1] @ robot.flange_frame
    index = world.frames.names.index("target")
    check_bars(belonging(draw(world, data), Kind.AXES, index), moved @ T, 0.2, 0.5)
    world.set_input(data, "free.frame", T)
    index = world.frames.names.index("free")
    check_bars(belonging(draw(world, data), Kind.AXES, index), T, 0.1, 1.0)
    for k in (0, 7, 11):
        data.userdata[world.slots["target.frame"]] = T.ravel()
        data.userdata[world.slots["target.frame"]][k] = np.nan
        buffer = draw(world, data)
        assert data.mocap_pos[world.placed["target"], 2] == -1000
        rows = buffer.rows[: buffer.count]
        assert (rows["pos"][:, 2] > -10).sum() == 3  # those of the other frame
        assert np.isfinite(rows["pos"]).all() and np.isfinite(rows["mat"]).all()
    world.set_input(data, "target.frame", T)
    assert (draw(world, data).rows["pos"][:6, 2] > -10).all()
    world.reset(data)
    assert draw(world, data).count == 0


def check_bars(bars, T, length: float, alpha: float) -> None:
    assert len(bars) == 3
    for axis, bar in enumerate(bars):
        assert bar["mat"][:, 2] == pytest.approx(T[:3, axis], abs=1e-6)
        assert bar["pos"] == pytest.approx(T[:3, 3], abs=1e-6)
        assert bar["size"][2] == pytest.approx(length, rel=1e-5)
        assert bar["rgba"] == pytest.approx([*AXIS_RGB[axis], alpha], rel=1e-5)


def test_scene_user_and_packet_switch_the_axes_of_a_frame() -> None:
    world = frames_world(at("a", show_axes=False), at("b", position=(0.3, 0, 0.6)))
    data, toggles = world.make_data(), toggles_of(world)

    def shown() -> list[int]:
        buffer = draw(world, data, toggles=toggles)
        return sorted(set(buffer.items[: buffer.count].tolist()))

    assert shown() == [1]
    toggles.axes[:] = (True, False)
    assert shown() == [0]
    world.set_input(data, "b.show_axes", 1.0)
    assert shown() == [0, 1]
