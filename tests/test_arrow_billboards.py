"""Billboards of smart arrows, and the scale in the legend."""

import re

import numpy as np
import pytest
from conftest import examples
from decor_tools import (
    GEOM,
    belonging,
    labels,
    length_of,
    look,
    of_kind,
    rectangle,
    texts_in,
    toggles_of,
    view_at,
    width_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from source_slots import set_source

from sero_mj.base.frames import round_down_1_2_5
from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.cartesian import SmartArrow
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
VECTOR = [3.0, -4.0, 12.0]  # 13 long


def world_with(*arrows: SmartArrow, **fields) -> World:
    robot = SerialRobot.from_model("lwr", joint_angles=POSE)
    return World(Scene(robots=[robot], arrows=list(arrows), floor=False, **fields))


def draw(world: World, data=None, *, view=None, cards=True, vectors=None, legend=False):
    data = world.make_data() if data is None else data
    Placer(world).place(data)
    toggles = toggles_of(world)
    toggles.legend = legend
    toggles.cards[:] = cards
    if vectors is not None:
        toggles.vectors[:] = vectors
    return Decor(world).draw(data, toggles, view or view_at())


def card_texts(buffer, item: int = 0, view=None) -> list[str]:
    (panel,) = belonging(buffer, Kind.CARD, item)
    return texts_in(view or view_at(), buffer.rows[: buffer.count], panel)


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        (
            {"kind": "force", "at": "lwr/flange"},
            [
                "push: force",
                "  x       3.00 N",
                "  y      -4.00 N",
                "  z      12.00 N",
                "  size   13.00 N",
                "  in lwr/flange",
            ],
        ),
        (
            {"kind": "torque", "at": "lwr/flange", "expressed_in": "world", "decimals": 0},
            [
                "push: torque",
                "  x        3 Nm",
                "  y       -4 Nm",
                "  z       12 Nm",
                "  size    13 Nm",
                "  in world",
            ],
        ),
        (
            {"kind": "velocity", "at": [0.1, 0, 0.8], "decimals": 4},
            [
                "push: velocity",
                "  x       3.0000 m/s",
                "  y      -4.0000 m/s",
                "  z      12.0000 m/s",
                "  size   13.0000 m/s",
                "  in world",
            ],
        ),
        (
            {
                "kind": "angular_velocity",
                "at": [0.1, 0, 0.8],
                "expressed_in": "lwr/link3",
                "unit": "deg/s",
                "decimals": 1,
            },
            [
                "push: angular velocity",
                "  x       3.0 deg/s",
                "  y      -4.0 deg/s",
                "  z      12.0 deg/s",
                "  size   13.0 deg/s",
                "  in lwr/link3",
            ],
        ),
    ],
)
def test_billboard_shows_name_kind_components_size_unit_and_frame(fields, text) -> None:
    buffer = draw(world_with(SmartArrow(name="push", vector=VECTOR, **fields)))
    assert card_texts(buffer) == text
    assert labels(buffer.rows[: buffer.count]) == text


def test_components_are_shown_as_received_not_in_world_coordinates() -> None:
    world = world_with(SmartArrow(name="push", at="lwr/flange"))
    data = world.make_data()
    world.set_input(data, "push.vector", [-0.004, 0.125, 7.5])
    assert card_texts(draw(world, data))[1:5] == [
        "  x       0.00 N",  # a small negative value is not -0.00
        "  y       0.12 N",
        "  z       7.50 N",
        "  size    7.50 N",
    ]


def test_billboard_without_data_shows_no_data() -> None:
    world = world_with(SmartArrow(name="push", kind="torque", at="lwr/link4"))
    data = world.make_data()
    nothing = ["push: torque", "  no data", "  in lwr/link4"]
    assert card_texts(draw(world, data)) == nothing
    for wrong in (np.nan, np.inf):
        world.set_input(data, "push.vector", VECTOR)
        assert len(card_texts(draw(world, data))) == 6
        data.userdata[world.slots["push.vector"]][1] = wrong
        assert card_texts(draw(world, data)) == nothing


def test_billboard_is_shown_on_request_with_its_arrow() -> None:
    arrows = [SmartArrow(name=f"v{k}", at=[0, 0.1 * k, 0.6], vector=VECTOR) for k in range(3)]
    world = world_with(*arrows)

    def cards(**shown) -> list[int]:
        buffer = draw(world, **shown)
        is_card = buffer.kinds[: buffer.count] == Kind.CARD
        return sorted(buffer.items[: buffer.count][is_card].tolist())

    assert cards() == [0, 1, 2]
    assert cards(cards=False) == []
    assert cards(cards=[False, True, False]) == [1]
    assert cards(vectors=[True, False, True]) == [0, 2]
    assert cards(vectors=False) == []
    assert not toggles_of(world).cards.any()  # none before a click


def test_arrow_outside_the_image_has_no_billboard() -> None:
    world = world_with(
        SmartArrow(name="here", at=[0, 0, 0.6], vector=VECTOR),
        SmartArrow(name="aside", at=[0, 9.0, 0.6], vector=VECTOR),
        SmartArrow(name="behind", at=[9.0, 0.0, 0.6], vector=VECTOR),
    )
    view = look([2.5, 0.0, 0.6], [0, 0, 0.6])
    buffer = draw(world, view=view)
    assert len(belonging(buffer, Kind.CARD)) == 1
    assert card_texts(buffer, 0, view)[0] == "here: force"


def test_billboards_do_not_overlap_and_point_at_their_arrows() -> None:
    places = ["lwr/flange", "lwr/base", "lwr/link4", [0.1, 0.2, 0.3], "lwr/flange"]
    arrows = [SmartArrow(name=f"v{k}", at=at, vector=VECTOR) for k, at in enumerate(places)]
    world = world_with(*arrows)
    for size in ((1280, 800), (1920, 1080)):
        view = view_at(0.4, 2.5, *size)
        buffer = draw(world, view=view)
        rows = buffer.rows[: buffer.count]
        leaders = of_kind(rows, GEOM.mjGEOM_TRIANGLE)
        panels = [rectangle(view, row) for row in belonging(buffer, Kind.CARD)]
        assert len(panels) == len(leaders) == 5
        frames = world.robots["lwr"].kinematics.frames(POSE)
        flange = (frames[-1] @ world.scene.robots["lwr"].flange_frame)[:3, 3]
        points = [flange, frames[0][:3, 3], frames[4][:3, 3], np.array([0.1, 0.2, 0.3]), flange]
        for k, (low, high) in enumerate(panels):
            assert (low >= -0.5).all() and (high <= np.array(size) + 0.5).all()
            assert card_texts(buffer, k, view)[0] == f"v{k}: force"
            tip = leaders[k]["pos"] + leaders[k]["mat"][:, 1] * leaders[k]["size"][1].astype(float)
            assert view.project(tip)[0] == pytest.approx(view.project(points[k])[0], abs=4.0)
            for other_low, other_high in panels[:k]:
                assert ((low >= other_high - 0.5) | (other_low >= high - 0.5)).any()


@pytest.mark.parametrize(
    ("age", "expected"), [(0.1, []), (-1.0, ["  no data yet"]), (12.3, ["  no data for 12.3 s"])]
)
def test_billboard_shows_the_age_of_its_data(age: float, expected: list[str]) -> None:
    world = world_with(
        SmartArrow(name="push", at="lwr/flange", vector=VECTOR),
        SmartArrow(name="declared", at="lwr/base", vector=VECTOR),
        sources={"udp": {"kind": "udp", "port": 1, "structure": "1V"}},
        routes={"push.vector": "udp.vectors0"},
    )
    data = world.make_data()
    set_source(data, world, "udp", received=5, age=age, size=24)
    buffer = draw(world, data)
    assert card_texts(buffer)[6:] == expected
    assert len(card_texts(buffer, 1)) == 6


def scales(buffer) -> list[str]:
    return labels(buffer.rows[: buffer.count])


@pytest.mark.parametrize(
    ("fields", "expected"),
    [
        ({"kind": "force"}, "v: 80 mm long = 20 N"),
        ({"kind": "torque"}, "v: 100 mm wide = 20 Nm"),
        ({"kind": "velocity"}, "v: 100 mm long = 0.2 m/s"),
        ({"kind": "angular_velocity"}, "v: 100 mm wide = 2 rad/s"),
        ({"kind": "force", "scale": 0.003, "unit": "kN"}, "v: 60 mm long = 20 kN"),
        ({"kind": "torque", "scale": 2.5}, "v: 50 mm wide = 0.02 Nm"),
    ],
)
def test_legend_states_the_scale(fields, expected: str) -> None:
    world = world_with(SmartArrow(name="v", at="lwr/flange", vector=VECTOR, **fields))
    buffer = draw(world, cards=False, legend=True)
    assert scales(buffer) == [expected]
    view = view_at()
    rows = buffer.rows[: buffer.count]
    (panel,) = [row for row in rows if row["emission"] == 1 and row["type"] == 6]
    low, high = rectangle(view, panel)
    assert (low >= 0).all() and high[0] < view.width / 2 and high[1] < view.height / 4
    assert scales(draw(world, cards=False, legend=False)) == []
    assert scales(draw(world, cards=False, legend=True, vectors=False)) == []


def test_arrows_with_one_scale_share_a_line_and_hidden_ones_have_none() -> None:
    world = world_with(
        SmartArrow(name="left", at="lwr/flange", vector=VECTOR),
        SmartArrow(name="turn", kind="torque", at="lwr/flange", vector=VECTOR),
        SmartArrow(name="right", at="lwr/base", vector=VECTOR),
        SmartArrow(name="fine", at="lwr/base", scale=0.05, vector=VECTOR),
        SmartArrow(name="silent", at="lwr/base", scale=0.1),
        SmartArrow(name="none", at="lwr/base", scale=0.2, vector=np.zeros(3)),
    )
    fine, turn = "fine: 100 mm long = 2 N", "turn: 100 mm wide = 20 Nm"
    found = scales(draw(world, cards=False, legend=True))
    assert found == ["left, right: 80 mm long = 20 N", turn, fine]
    found = scales(draw(world, cards=False, legend=True, vectors=[False, True, True, *[False] * 3]))
    assert found == [turn, "right: 80 mm long = 20 N"]


def test_scale_of_many_arrows_is_not_cut_off_after_their_names() -> None:
    names = [f"contact_force_of_finger_{k}" for k in range(6)]
    fields = {"at": "lwr/flange", "kind": "force", "vector": VECTOR}
    world = world_with(*(SmartArrow(name=name, **fields) for name in names))
    for count, listed in ((1, names[0]), (2, "force arrows"), (6, "force arrows")):
        found = scales(draw(world, cards=False, legend=True, vectors=np.arange(6) < count))
        assert found == [f"{listed}: 80 mm long = 20 N"]


def test_legend_follows_live_toggles() -> None:
    world = world_with(
        SmartArrow(name="push", at="lwr/flange"),
        SmartArrow(name="turn", kind="torque", at="lwr/flange", vector=VECTOR),
    )
    decor, data, toggles = Decor(world), world.make_data(), toggles_of(world)
    toggles.legend = True
    assert scales(decor.draw(data, toggles, view_at())) == ["turn: 100 mm wide = 20 Nm"]
    world.set_input(data, "push.vector", VECTOR)  # a contact, which adds its scale
    decor.draw(data, toggles, view_at())
    world.set_input(data, "push.vector", np.zeros(3))
    push, turn = "push: 80 mm long = 20 N", "turn: 100 mm wide = 20 Nm"
    for shown, said in (
        ((True, True), [push, turn]),
        ((False, True), [turn]),
        ((False, False), []),
        ((True, False), [push]),
    ):
        toggles.vectors[:] = shown
        assert scales(decor.draw(data, toggles, view_at())) == said


@settings(max_examples=examples(40), deadline=None)
@given(scale=st.floats(1e-4, 50), turns=st.booleans())
def test_stated_scale_equals_the_drawn_size(scale: float, turns: bool) -> None:
    kind = "torque" if turns else "force"
    limits = {"longest": 1.0, "radius": 0.2}
    world = world_with(SmartArrow(name="v", kind=kind, at=[0, 0, 1], scale=scale, **limits))
    data = world.make_data()
    world.set_input(data, "v.vector", [0, 0, 0.9 / scale])
    (said,) = scales(draw(world, data, cards=False, legend=True))
    match = re.fullmatch(r"v: (\S+) mm (long|wide) = (\S+) Nm?", said)
    assert match is not None
    millimetres, value = float(match[1]), float(match[3])
    assert match[2] == ("wide" if turns else "long")
    assert 39.9 < millimetres < 100.1
    assert value / 10 ** np.floor(np.log10(value) + 1e-9) == pytest.approx(
        round(value / 10 ** np.floor(np.log10(value) + 1e-9))
    )
    world.set_input(data, "v.vector", [0, value * 0.6, value * 0.8])
    rows = belonging(draw(world, data, cards=False), Kind.VECTOR)
    drawn = width_of(rows[0]) if turns else length_of(rows)
    assert 1e3 * drawn == pytest.approx(millimetres, rel=1e-4)


@given(st.floats(1e-9, 1e9))
def test_round_down_1_2_5_is_the_largest_step_not_above_the_value(value: float) -> None:
    steps = np.array([step * 10.0**k for k in range(-11, 11) for step in (1, 2, 5)])
    found = steps[steps <= value * (1 - 1e-8)].max(), steps[steps <= value * (1 + 1e-8)].max()
    assert round_down_1_2_5(value) == pytest.approx(found[0]) or round_down_1_2_5(
        value
    ) == pytest.approx(found[1])


@pytest.mark.parametrize("k", range(-6, 7))
def test_round_down_1_2_5_returns_round_numbers_unchanged(k: int) -> None:
    for value, expected in ((1, 1), (2, 2), (5, 5), (1.99, 1), (4.99, 2), (9.99, 5)):
        assert round_down_1_2_5(value * 10.0**k) == pytest.approx(expected * 10.0**k)


def test_arrow_billboard_needs_no_robot() -> None:
    arrow = SmartArrow(name="push", kind="force", at=[0.0, 0.0, 0.6], vector=[0.0, 0.0, 20.0])
    world = World(Scene(robots=[], arrows=[arrow], floor=False))
    toggles = toggles_of(world)
    toggles.cards[:] = True
    buffer = Decor(world).draw(world.make_data(), toggles, view_at())
    assert "push: force" in labels(buffer.rows[: buffer.count])
