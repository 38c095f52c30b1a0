"""Billboard positions: no overlaps, inside the image, no jumps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.viewer.decor.layout import (
    LEFT,
    RIGHT,
    behind,
    bends,
    columns,
    crossings,
    place_clear,
    spread,
    spread_around,
    tangle,
    uncross,
    with_room,
)

heights = st.lists(st.floats(5, 60), min_size=1, max_size=12)


@given(heights=heights, data=st.data())
def test_spread_panels_never_overlap_and_fit_if_there_is_space(heights, data) -> None:
    size = np.array(heights)
    wanted = np.array([data.draw(st.floats(-500, 1500)) for _ in heights])
    got = spread(wanted, size, 4.0, 10.0, 900.0)
    low, high = got - size / 2, got + size / 2
    assert (low[1:] - high[:-1] > 4.0 - 1e-6).all()
    assert low[0] > 10.0 - 1e-6
    assert high[-1] < 900.0 + 1e-6


def test_panels_with_enough_space_stay_at_their_preferred_positions() -> None:
    wanted = np.array([100.0, 200.0, 300.0])
    assert spread(wanted, np.full(3, 30.0), 5.0, 0.0, 800.0) == pytest.approx(wanted)


def test_two_coincident_panels_move_apart_by_the_same_amount() -> None:
    assert spread(np.full(2, 200.0), np.full(2, 30.0), 10.0, 0.0, 800.0) == pytest.approx(
        [180, 220]
    )


def test_too_many_panels_overlap_evenly_inside_the_image() -> None:
    got = spread(np.linspace(0, 400, 20), np.full(20, 40.0), 5.0, 0.0, 400.0)
    assert got[0] == pytest.approx(20.0)
    assert got[-1] == pytest.approx(380.0)
    assert np.diff(got) == pytest.approx(np.full(19, 360 / 19))


@given(st.integers(2, 40), st.integers(0, 2**31))
def test_small_joint_motion_moves_panels_little(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    anchors = rng.uniform(100, 700, (count, 2))
    sizes = np.full((count, 2), (120.0, 34.0))
    side = np.arange(count) % 2
    before = columns(anchors, sizes, side, 8.0, 30.0, 1280, 800)
    step = rng.uniform(-1, 1, anchors.shape)
    after = columns(anchors + step, sizes, side, 8.0, 30.0, 1280, 800)
    assert np.abs(after - before).max() <= 2.0


@given(st.integers(1, 51), st.integers(0, 2**31), st.sampled_from([(1280, 800), (900, 700)]))
def test_panels_never_overlap_or_leave_the_image(count, seed, size) -> None:
    rng = np.random.default_rng(seed)
    anchors = rng.uniform(0, 1, (count, 2)) * size
    sizes = np.stack([rng.uniform(90, 150, count), np.full(count, 38.0)], axis=1)
    side = rng.integers(0, 2, count)
    centres = columns(anchors, sizes, side, 8.0, 40.0, *size)
    low, high = centres - sizes / 2, centres + sizes / 2
    assert (low >= -1e-6).all()
    assert (high <= np.array(size) + 1e-6).all()
    for i in range(count):
        apart = (low[i] >= high[:i] - 1e-6).any(axis=1) | (low[:i] >= high[i] - 1e-6).any(axis=1)
        assert apart.all()


def test_too_many_panels_stay_inside_the_image() -> None:
    anchors = np.random.default_rng(0).uniform(0, 400, (60, 2))
    sizes = np.full((60, 2), (150.0, 40.0))
    centres = columns(anchors, sizes, np.arange(60) % 2, 8.0, 40.0, 400, 400)
    assert (centres - sizes / 2 >= -1e-6).all()
    assert (centres + sizes / 2 <= 400 + 1e-6).all()


def test_columns_are_beside_the_robot_at_the_height_of_their_joints() -> None:
    anchors = np.stack([np.full(6, 640.0), np.linspace(100, 700, 6)], axis=1)
    side = np.arange(6) % 2
    centres = columns(anchors, np.full((6, 2), (100.0, 30.0)), side, 8.0, 50.0, 1280, 800)
    assert centres[side == 0, 0] == pytest.approx(np.full(3, 640 - 50 - 50))
    assert centres[side == 1, 0] == pytest.approx(np.full(3, 640 + 50 + 50))
    assert centres[:, 1] == pytest.approx(anchors[:, 1])


def test_order_in_a_column_never_changes() -> None:
    anchors = np.stack([np.full(4, 640.0), np.linspace(700, 100, 4)], axis=1)
    centres = columns(
        anchors, np.full((4, 2), (100.0, 30.0)), np.zeros(4, int), 8.0, 50.0, 1280, 800
    )
    assert (np.diff(centres[:, 1]) >= 38 - 1e-6).all()


def test_robot_that_fills_the_image_has_panels_over_it() -> None:
    anchors = np.array([[20.0, 300.0], [1260.0, 500.0]])
    centres = columns(
        anchors, np.full((2, 2), (100.0, 30.0)), np.array([0, 1]), 8.0, 50.0, 1280, 800
    )
    assert centres[:, 0] == pytest.approx([58.0, 1222.0])


# In steps that float64 represents exactly: leaders of 1e-247 pixels cross and do not get shorter.
pixels = st.tuples(*(st.integers(0, 8 * side).map(lambda n: n / 8) for side in (1280, 800)))


@given(st.lists(st.tuples(pixels, pixels), min_size=1, max_size=14))
def test_uncrossed_leaders_do_not_cross_and_become_shorter(leaders) -> None:
    starts, ends = (np.array(of_all) for of_all in zip(*leaders, strict=True))
    index = uncross(starts, ends)
    assert sorted(index) == list(range(len(starts)))
    assert not crossings(starts[index], ends).any()
    length = np.linalg.norm(starts - ends, axis=1).sum()
    assert np.linalg.norm(starts[index] - ends, axis=1).sum() <= length + 1e-6


def test_crossings_match_pairs_of_intersecting_segments() -> None:
    starts = np.array([[0.0, 0.0], [0.0, 10.0], [0.0, 20.0], [0.0, 40.0]])
    ends = np.array([[10.0, 10.0], [10.0, 0.0], [10.0, 20.0], [10.0, 30.0]])
    assert np.argwhere(crossings(starts, ends)).tolist() == [[0, 1], [1, 0]]


def column(count: int, widths: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Returns starts of leaders, centers and sizes of panels in one column."""
    sizes = np.stack([widths, np.full(count, 20.0)], axis=1)
    centres = np.stack([200 + sizes[:, 0] / 2, 300 + 25.0 * np.arange(count)], axis=1)
    return np.stack([np.full(count, 200.0), centres[:, 1]], axis=1), centres, sizes


@given(st.integers(1, 12), st.integers(0, 2**31))
def test_bent_leaders_cross_no_more_than_straight_ones(count, seed) -> None:
    rng = np.random.default_rng(seed)
    starts, centres, sizes = column(count, rng.uniform(60, 120, count))
    ends = rng.uniform((150, 0), (300, 800), (count, 2))
    low, high = centres - sizes / 2, centres + sizes / 2
    turns = bends(starts, ends, centres, sizes, 3.0)
    clear = ~behind(starts, ends, low, high).any(axis=1)
    assert (turns[clear] == starts[clear]).all()
    assert not behind(starts, turns, low, high).any()
    straight = tangle(starts, starts, ends, low, high)
    assert tangle(starts, turns, ends, low, high) <= straight + int((~clear).sum())


def test_leaders_bend_beside_a_column_whose_joints_are_above_or_below() -> None:
    starts, centres, sizes = column(5, np.array([90.0, 80.0, 110.0, 70.0, 100.0]))
    low, high = centres - sizes / 2, centres + sizes / 2
    for y in (100.0, 700.0):
        far = np.arange(5) if y > 400 else np.arange(5)[::-1]  # the farther, the farther right
        ends = np.stack([230.0 + 8.0 * far, np.full(5, y)], axis=1)
        assert behind(starts, ends, low, high).any()
        turns = bends(starts, ends, centres, sizes, 3.0)
        assert (turns != starts).any(axis=1).sum() == 4
        assert not behind(starts, turns, low, high).any()
        assert not behind(turns, ends, low, high).any()
        beside = 200.0 - turns[(turns != starts).any(axis=1), 0]
        assert sorted(beside) == [3.0, 6.0, 9.0, 12.0]


def test_leader_is_behind_panels_between_its_ends() -> None:
    starts, ends = np.array([[0.0, 5.0], [50.0, 5.0]]), np.array([[100.0, 5.0], [60.0, 40.0]])
    low, high = np.array([[-20.0, 0.0], [30.0, 0.0]]), np.array([[0.0, 10.0], [50.0, 10.0]])
    assert behind(starts, ends, low, high).tolist() == [[False, True], [False, False]]


def test_leaders_that_barely_cross_are_unchanged() -> None:
    starts, ends = np.array([[0.0, 0.0], [0.0, 10.0]]), np.array([[100.0, 5.1], [100.0, 5.0]])
    assert uncross(starts, ends).tolist() == [1, 0]
    assert uncross(starts, ends, least_gain=1.0).tolist() == [0, 1]


@given(heights=heights, data=st.data())
def test_panels_avoid_blocked_ranges_if_there_is_space(heights, data) -> None:
    size = np.array(heights)
    wanted = np.array([data.draw(st.floats(0, 3000)) for _ in heights])
    ranges = st.tuples(st.floats(0, 3000), st.floats(1, 300))
    blocked = np.array(
        [(low, low + size) for low, size in data.draw(st.lists(ranges, min_size=1, max_size=3))]
    )
    got = spread_around(wanted, size, 4.0, 0.0, 3000.0, blocked)
    low, high = got - size / 2, got + size / 2
    assert (low[1:] - high[:-1] > -1e-6).all()
    # The largest gap between three ranges of 300 is at least 525 high, so the panels fit into it.
    if size.sum() + 4.0 * len(size) < 500:
        assert (
            (high[:, None] <= blocked[:, 0] + 1e-6) | (low[:, None] >= blocked[:, 1] - 1e-6)
        ).all()


def test_panels_without_blocked_ranges_are_spread_as_usual() -> None:
    wanted = np.array([100.0, 110.0, 300.0])
    args = (wanted, np.full(3, 30.0), 5.0, 0.0, 800.0)
    assert spread_around(*args, np.zeros((0, 2))) == pytest.approx(spread(*args))
    assert spread_around(*args, np.array([[0.0, 800.0]])) == pytest.approx(spread(*args))


PICTURE = np.array([0.0, 0.0]), np.array([640.0, 480.0])


@given(st.integers(1, 8), st.integers(0, 12), st.integers(0, 2**31))
def test_labels_are_placed_clear_of_occupied_areas_and_each_other(count, taken, seed) -> None:
    rng = np.random.default_rng(seed)
    middles = rng.uniform(60, 400, (taken, 2))
    half = np.array([40.0, 12.0])
    rectangles = np.hstack([middles - half, middles + half])
    sizes = rng.uniform(10, 60, (count, 2))
    wanted = rng.uniform(60, 400, (count, 2))
    placed, has_room = place_clear(wanted, sizes, rectangles, *PICTURE, np.ones(count, bool))
    assert has_room.all()
    low = np.concatenate([placed - sizes / 2, rectangles[:, :2]])
    high = np.concatenate([placed + sizes / 2, rectangles[:, 2:]])
    over = ((low[:, None] < high - 1e-3) & (high[:, None] > low + 1e-3)).all(axis=2)
    assert not np.triu(over, 1)[:count].any()
    assert (low[:count] >= -1e-9).all() and (high[:count] <= PICTURE[1] + 1e-9).all()


def test_label_moves_minimally_and_stays_if_there_is_no_space() -> None:
    corner = np.array([[0.0, 0.0, 200.0, 70.0]])
    size = np.array([[100.0, 20.0]])

    def placed(x: float, y: float, taken: np.ndarray = corner) -> list[float]:
        (found,), (has_room,) = place_clear(
            np.array([[x, y]]), size, taken, *PICTURE, np.ones(1, bool)
        )
        assert has_room == (len(taken) == 1 and taken[0, 2] < 600)
        return list(found)

    assert placed(300.0, 60.0) == [300.0, 60.0]
    assert placed(150.0, 60.0) == [150.0, 80.0]  # above it
    assert placed(240.0, 20.0) == [250.0, 20.0]  # beside it
    assert placed(150.0, 60.0, np.array([[0.0, 0.0, 640.0, 480.0]])) == [150.0, 60.0]


def test_first_panels_fit_on_their_side_or_the_other() -> None:
    nothing = np.zeros((0, 4))

    def found(sides: list[int], may_move: bool, covered: np.ndarray = nothing) -> tuple:
        count, side = with_room(
            np.full((len(sides), 2), (100.0, 30.0)), np.array(sides), 10.0, 640.0, 100.0,
            kept_free=nothing, covered=covered, may_move=may_move,
        )  # fmt: skip
        return count, side[:count].tolist()

    # A side has space for two: (100 - 2 * 10 + 2) / 32.
    assert found([LEFT] * 5, may_move=False) == (2, [LEFT] * 2)
    assert found([LEFT] * 5, may_move=True) == (4, [LEFT, LEFT, RIGHT, RIGHT])
    assert found([LEFT, RIGHT, LEFT, LEFT, RIGHT], may_move=False) == (3, [LEFT, RIGHT, LEFT])
    robot = np.array([[600.0, 0.0, 640.0, 100.0]])
    assert found([RIGHT] * 3, may_move=True, covered=robot) == (2, [LEFT] * 2)
    assert found([RIGHT] * 3, may_move=False, covered=robot) == (0, [])
