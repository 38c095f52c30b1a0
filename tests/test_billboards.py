"""Billboards, their text, leaders and panels, and the status corner, as numbers."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import examples
from decor_tools import GEOM, drawn, labels, of_kind, rectangle, toggles_of, view_at, world_of
from hypothesis import given, settings
from hypothesis import strategies as st

from sero_mj.base.errors import UnknownName
from sero_mj.data.drive.place import Placer, follow
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import ARROW_QUANTITIES, BillboardLine
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor import billboard_layout
from sero_mj.viewer.decor.billboards import billboard_lines, joint_formats
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.decor.joint_titles import short_joint_names, shortened, titles
from sero_mj.viewer.decor.layout import columns
from sero_mj.viewer.decor.quantities import joint_values
from sero_mj.viewer.decor.round_arrows import NEGATIVE_RGBA, POSITIVE_RGBA
from sero_mj.viewer.decor.toggles import Toggles
from sero_mj.viewer.image.clicks import click
from sero_mj.viewer.image.picking import pick
from sero_mj.viewer.image.typesetting import Typesetter

TORQUES = np.array([-12.34, 0.04, -0.04, 100.0, 5.0, -38.0, 0.0])


def text_boxes(view: ImageView, rows) -> list[tuple[np.ndarray, np.ndarray]]:
    """Returns the pixel rectangle of each label, from its position and the font's widths."""
    boxes = []
    for row in of_kind(rows, GEOM.mjGEOM_LABEL):
        start, _ = view.project(row["pos"].astype(float))
        size = np.array([view.font.width(row["label"]), view.font.height])
        boxes.append((start, start + size))
    return boxes


def test_billboard_shows_name_value_and_unit() -> None:
    rows = drawn(world_of(torques=TORQUES, show_billboards=True))
    assert labels(rows) == [
        "A1   -12.3 Nm",
        "A2     0.0 Nm",
        "E1     0.0 Nm",  # a small negative is no -0.0
        "A3   100.0 Nm",
        "A4     5.0 Nm",
        "A5   -38.0 Nm",
        "A6     0.0 Nm",
    ]


def test_billboards_of_joints_without_data_show_no_data() -> None:
    rows = drawn(world_of(show_billboards=True, billboard_lines=["torques"]))
    assert labels(rows)[3] == "A3  no data"


def test_billboards_show_joint_angles_if_there_are_no_torques() -> None:
    rows = drawn(world_of(joint_angles=np.full(7, -0.5), show_billboards=True))
    assert labels(rows)[0] == "A1    -0.500 rad"


def test_declared_lines_set_label_unit_scale_and_decimals() -> None:
    lines = [
        {"value": "joint_angles", "unit": "deg", "scale": 57.29577951308232, "decimals": 0},
        {"value": "billboard_values", "label": "T", "unit": "C"},
    ]
    world = world_of(
        joint_angles=np.full(7, np.pi / 2),
        billboard_values=np.full(7, 31.256),
        show_billboards=True,
        billboard_lines=lines,
    )
    rows = drawn(world)
    assert labels(rows)[:2] == ["A1  pos     90 deg", "    T    31.26 C"]
    assert len(of_kind(rows, GEOM.mjGEOM_BOX)) == 7


def test_billboard_of_prismatic_joint_shows_newtons_and_meters() -> None:
    for field, text in (("torques", "J1     3.0 N"), ("joint_angles", "J1     3.0000 m")):
        robot = SerialRobot(
            dh_convention="craig",
            joint_types=["prismatic"],
            show_billboards=True,
            billboard_lines=[field],
            **{field: [3.0]},
        )
        rows = drawn(World(Scene(robots=[robot], floor=False)), view_at(distance=20))
        assert labels(rows) == [text]


@settings(max_examples=examples(40), deadline=None)
@given(
    seed=st.integers(0, 2**31),
    size=st.sampled_from([(1280, 800), (640, 480), (3840, 2160), (901, 333)]),
    distance=st.floats(1.2, 9),
    azimuth=st.floats(-3, 3),
)
def test_text_fits_its_billboard_and_billboards_do_not_overlap(
    billboard_world, seed, size, distance, azimuth
) -> None:
    rng = np.random.default_rng(seed)
    world = billboard_world
    data = world.make_data()
    world.set_input(data, "lwr.joint_angles", rng.uniform(-2, 2, 7))
    # Beyond every limit and then some: the panel must grow with the number.
    world.set_input(data, "lwr.torques", rng.uniform(-1, 1, 7) * 10.0 ** rng.integers(0, 7, 7))
    follow(world.model, data)
    view = view_at(azimuth, distance, *size)
    toggles = Toggles(world)
    toggles.status = False  # its panel has several lines
    buffer = Decor(world).draw(data, toggles, view)
    rows = buffer.rows[: buffer.count]
    panels = [rectangle(view, row) for row in of_kind(rows, GEOM.mjGEOM_BOX)]
    texts = text_boxes(view, rows)
    assert len(panels) == len(texts)
    for (low, high), (start, end) in zip(panels, texts, strict=True):
        assert (start >= low - 0.5).all() and (end <= high + 0.5).all()
        assert (low >= -0.5).all() and (high <= np.array(size) + 0.5).all()
    for i, (low, high) in enumerate(panels):
        for other_low, other_high in panels[:i]:
            assert ((low >= other_high - 0.5) | (other_low >= high - 0.5)).any()


@pytest.fixture(scope="module")
def billboard_world() -> World:
    return world_of(torques=TORQUES, show_billboards=True)


def test_billboards_face_the_camera_in_front_of_everything(billboard_world) -> None:
    view = view_at()
    rows = drawn(billboard_world, view)
    for row in of_kind(rows, GEOM.mjGEOM_BOX):
        assert row["mat"] == pytest.approx(view.facing, abs=1e-6)
        assert (row["pos"] - view.position) @ view.forward == pytest.approx(
            1.5 * view.near, rel=1e-3
        )
        assert 0.5 < row["rgba"][3] < 0.95  # semitransparent


def test_leader_connects_billboard_and_joint(billboard_world) -> None:
    view = view_at()
    world = billboard_world
    data = world.make_data()
    rows = drawn(world, view)
    joints, _ = view.project(data.site_xpos[world.joints.centre_site])
    panels = [rectangle(view, row) for row in of_kind(rows, GEOM.mjGEOM_BOX)]
    leaders = of_kind(rows, GEOM.mjGEOM_TRIANGLE)
    assert len(leaders) == 7
    for row, joint, (low, high) in zip(leaders, joints, panels, strict=True):
        corner = row["pos"].astype(float)
        base = corner + row["mat"][:, 0] * row["size"][0]
        tip = corner + row["mat"][:, 1] * row["size"][1]
        (corner_px, base_px, tip_px), _ = view.project(np.array([corner, base, tip]))
        assert tip_px == pytest.approx(joint, abs=4.0)
        middle = (corner_px + base_px) / 2
        assert low[0] - 1 <= middle[0] <= high[0] + 1
        assert low[1] - 1 <= middle[1] <= high[1] + 1


def test_joint_outside_the_image_has_no_billboard(billboard_world) -> None:
    behind = view_at()
    turned = ImageView(
        behind.position, -behind.right, behind.up, -behind.forward, 0.4, 0.02, 1280, 800
    )
    assert len(drawn(billboard_world, turned)) == 0


def test_toggles_select_the_joints_with_billboards(billboard_world) -> None:
    toggles = Toggles(billboard_world)
    toggles.billboards[:] = False
    toggles.billboards[5] = True
    buffer = Decor(billboard_world).draw(billboard_world.make_data(), toggles, view_at())
    assert labels(buffer.rows[: buffer.count]) == ["A5   -38.0 Nm"]


def test_several_lines_of_a_billboard_are_labeled() -> None:
    world = world_of(
        torques=np.full(7, 10.0),
        commanded_torques=np.full(7, 12.5),
        show_billboards=True,
        billboard_lines=["torques", "commanded_torques", "torque_error"],
    )
    assert labels(drawn(world))[:3] == [
        "A1  msr    10.0 Nm",
        "    cmd    12.5 Nm",
        "    err     2.50 Nm",
    ]


def test_huge_values_are_shown_with_an_exponent() -> None:
    world = world_of(torques=np.full(7, 1.0), show_billboards=True)
    data = world.make_data()
    data.userdata[world.slots["lwr.torques"]][:2] = (-1.5e300, 123456.0)
    buffer = Decor(world).draw(data, Toggles(world), view_at())
    assert {"A1  -1.500e+300 Nm", "A2  123456.0 Nm"} < {*labels(buffer.rows[: buffer.count])}


def test_legend_explains_arrows_positive_direction_and_full_width() -> None:
    world = world_of(torques=np.full(7, 10.0), show_arrows=True)
    toggles = Toggles(world)
    decor, data = Decor(world), world.make_data()
    buffer = decor.draw(data, toggles, view_at())
    legend = [
        "round arrows: joint torque",
        "orange: + about z, blue: -",
        "     10 %     50 %     torque limit",
    ]
    assert labels(buffer.rows[: buffer.count]) == legend
    toggles.arrow_quantity[3:] = 1  # switched live
    buffer = decor.draw(data, toggles, view_at())
    found = labels(buffer.rows[: buffer.count])
    assert found[:3] == legend
    assert found[3] == "round arrows: torque error, commanded - measured"
    toggles.arrows[:] = False
    assert decor.draw(data, toggles, view_at()).count == 0
    # The words match the colors: orange is mostly red, blue mostly blue.
    assert np.argmax(POSITIVE_RGBA[:3]) == 0
    assert np.argmax(NEGATIVE_RGBA[:3]) == 2


def test_billboards_of_several_robots_name_the_robot() -> None:
    robots = [
        SerialRobot(name=name, dh_convention="craig", torques=[2.0], show_billboards=True)
        for name in ("left", "right")
    ]
    rows = drawn(World(Scene(robots=robots, floor=False)), view_at(distance=20))
    assert sorted(labels(rows)) == ["left J1     2.0 Nm", "right J1     2.0 Nm"]


def test_long_names_are_shortened_in_the_middle_and_stay_distinct() -> None:
    assert shortened(["left", "right_manipulator_arm"]) == ["left", "right_..or_arm"]
    alike = ["front_left_of_the_hip", "front_lost_of_the_hip", "front_left_of_the_hip"]
    assert shortened(alike) == ["front_le.._the_hip", "front_lo.._the_hip", "front_le.._the_hip"]
    nearly = ["front_left_1_of_the_hip", "front_left_2_of_the_hip"]
    assert shortened(nearly) == nearly
    robots = [
        SerialRobot(name=name, dh_convention="craig", torques=[2.0], show_billboards=True)
        for name in ("left_manipulator_arm", "right_manipulator_arm")
    ]
    world = World(Scene(robots=robots, floor=False))
    short = ["left_m..or_arm J1     2.0 Nm", "right_..or_arm J1     2.0 Nm"]
    assert sorted(labels(drawn(world, view_at(distance=20, width=640, height=480)))) == short
    # There is space for the whole name.
    whole = ["left_manipulator_arm J1     2.0 Nm", "right_manipulator_arm J1     2.0 Nm"]
    assert sorted(labels(drawn(world, view_at(distance=20)))) == whole


@pytest.mark.parametrize(
    ("robot", "joints", "expected"),
    [
        ("iiwa", ["lbr_iiwa_joint_1", "lbr_iiwa_joint_2"], ["joint_1", "joint_2"]),
        ("panda", ["panda_joint1", "panda_finger_joint1"], ["joint1", "finger_joint1"]),
        (
            "a1",
            ["FR_hip_joint", "FL_hip_joint", "FR_upper_joint"],
            ["FR_hip", "FL_hip", "FR_upper"],
        ),
        ("r", ["robot0:WRJ1", "robot0:FFJ0"], ["WRJ1", "FFJ0"]),
        ("door", ["door_hinge"], ["hinge"]),
        ("chest", ["right_elbow", "left_elbow"], ["right_elbow", "left_elbow"]),
        ("arm", ["hip_joint", "hip_link"], ["hip_joint", "hip_link"]),
        ("arm", ["arm", "arm_2"], ["arm", "arm_2"]),
        ("arm", ["J1", "J2"], ["J1", "J2"]),
        ("none", [], []),
    ],
)
def test_joint_names_on_billboards_omit_repeated_parts(
    robot: str, joints: list[str], expected: list[str]
) -> None:
    assert short_joint_names(joints, robot) == expected


def test_title_does_not_repeat_a_name() -> None:
    joints, owners = [["RIGHT_HIP_X"], ["lift", "turn"]], ["RIGHT_HIP_X_LINK", "arm"]
    assert titles(joints, owners, [True, True]) == ["RIGHT_..X_LINK", "arm lift", "arm turn"]
    assert titles(joints, owners, [False, False]) == ["RIGHT_HIP_X", "lift", "turn"]


def test_small_images_have_no_legend() -> None:
    world = world_of(torques=np.full(7, 10.0), show_arrows=True)
    decor, toggles, data = Decor(world), Toggles(world), world.make_data()
    assert labels(
        decor.draw(data, toggles, view_at(width=640, height=480)).rows[: decor.buffer.count]
    )
    small = decor.draw(data, toggles, view_at(width=320, height=200))
    assert labels(small.rows[: small.count]) == []


TEMPERATURE = {"value": "temperatures", "label": "T", "unit": "C", "decimals": 0}


def warm_world(*others: SerialRobot, doubles=(), **fields) -> World:
    fields = {"inputs": ["temperatures"], "billboard_lines": [TEMPERATURE], **fields}
    robot = SerialRobot.from_model("lwr", name="warm", show_billboards=True, **fields)
    return World(Scene(robots=[*others, robot], doubles=list(doubles), floor=False))


def texts_of(world: World, data=None, decor=None, toggles=None) -> list[str]:
    decor, toggles = decor or Decor(world), toggles or Toggles(world)
    buffer = decor.draw(data or world.make_data(), toggles, view_at(distance=4))
    return labels(buffer.rows[: buffer.count])


def test_declared_input_is_shown_on_the_billboards() -> None:
    world = warm_world()
    data = world.make_data()
    assert texts_of(world, data) == [f"{name}  T  no data" for name in world.joints.names]
    world.set_input(data, "warm.temperatures", [31.4, 30.6, -5.0, 99.9, 100.0, 0.2, 45.0])
    numbers = ["31", "31", "-5", "100", "100", "0", "45"]
    expected = [f"{n}  T  {t:>5} C" for n, t in zip(world.joints.names, numbers, strict=True)]
    assert texts_of(world, data) == expected


def test_nan_in_one_joint_shows_no_data_for_that_joint_only() -> None:
    lines = ["torques", TEMPERATURE, {"value": "currents", "unit": "A"}]
    inputs = ["temperatures", "currents"]
    world = warm_world(inputs=inputs, billboard_lines=lines, torques=TORQUES)
    data = world.make_data()
    world.set_input(data, "warm.temperatures", np.arange(20.0, 27.0))
    world.set_input(data, "warm.currents", np.arange(7) / 8)
    whole = texts_of(world, data)
    assert whole[3:6] == ["A2  msr     0.0 Nm", "    T     21 C", "    currents     0.12 A"]
    for wrong in (np.nan, np.inf):
        data.userdata[world.slots["warm.temperatures"]][4] = wrong
        found = texts_of(world, data)
        assert found[13] == "    T  no data"
        assert found[:13] + found[14:] == whole[:13] + whole[14:]


def test_robots_with_and_without_a_declared_input_are_shown_together() -> None:
    plain = SerialRobot.from_model("lwr", name="plain", show_billboards=True, torques=TORQUES)
    tiny = SerialRobot(name="tiny", dh_convention="craig", show_billboards=True)
    for order in (1, -1):
        world = warm_world(*[plain, tiny][::order])
        data = world.make_data()
        world.set_input(data, "warm.temperatures", np.arange(20.0, 27.0))
        found = texts_of(world, data)
        assert "plain A1   -12.3 Nm" in found
        assert "tiny J1     0.000 rad" in found
        for k, name in enumerate(world.robots["warm"].robot.names):
            assert f"warm {name}  T     {20 + k} C" in found
        assert len(found) == 15
        world.set_input(data, "toggles.flange_checks", 1.0)  # the last flag
        assert np.isnan(joint_values(world, data)["temperatures"]).sum() == 8
        with pytest.raises(UnknownName):
            world.set_input(data, "plain.temperatures", np.zeros(7))


def test_double_has_its_own_values_of_declared_inputs() -> None:
    shown = {"show_billboards": True, "billboard_lines": [TEMPERATURE]}
    double = Double(name="goal", of="warm", joint_angles=np.full(7, 0.5), **shown)
    world = warm_world(doubles=[double])
    data = world.make_data()
    Placer(world).place(data)
    world.set_input(data, "warm.temperatures", np.full(7, 40.0))
    assert texts_of(world, data)[6:8] == ["A6  T     40 C", "goal A1  T  no data"]
    world.set_input(data, "goal.temperatures", np.full(7, 55.0))
    assert texts_of(world, data)[6:8] == ["A6  T     40 C", "goal A1  T     55 C"]


@pytest.mark.parametrize("joints", [7, 4, 2])
def test_billboards_are_on_the_side_of_their_robot(joints: int) -> None:
    bases = np.stack([np.eye(4)] * 2)
    bases[:, 1, 3] = 0.5, -0.5
    robots = [
        SerialRobot.from_model("lwr", name=name, base_frame=base, show_billboards=True)
        for name, base in zip(("first", "second"), bases, strict=True)
    ]
    table = robots[0].dh_params[:joints]  # a robot with fewer joints has its own side, too
    robots[1] = SerialRobot(
        name="second", dh_params=table, dh_convention="craig", base_frame=bases[1],
        show_billboards=True,
    )  # fmt: skip
    world = World(Scene(robots=robots, floor=False))
    decor, data, toggles = Decor(world), world.make_data(), toggles_of(world)
    for azimuth, first_is_left in ((0.0, True), (np.pi, False), (0.0, True)):
        view = view_at(azimuth=azimuth, distance=3.0)
        buffer = decor.draw(data, toggles, view)
        panels = np.flatnonzero(buffer.kinds[: buffer.count] == Kind.BILLBOARD)
        across = view.project(buffer.rows["pos"][panels])[0][:, 0]
        is_of_first = buffer.items[panels] < robots[0].n
        assert ((across < view.width / 2) == (is_of_first == first_is_left)).all()


def bounds_of_cards(decor: Decor) -> tuple[np.ndarray, np.ndarray]:
    """Returns the lower left and upper right corners of all billboards, (k, 2) each, pixels."""
    cards = [panels for panels in decor.panels if panels.has_values]
    centres = np.concatenate([panels.centres for panels in cards])
    half = np.concatenate([panels.sizes for panels in cards]) / 2
    return centres - half, centres + half


def test_billboards_in_a_crowded_image_do_not_cover_four_robots() -> None:
    places = [(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    robots = [
        SerialRobot.from_model(
            "lwr", name=f"arm{k}", base_frame={"xyz": [x, y, 0]}, show_billboards=True
        )
        for k, (x, y) in enumerate(places)
    ]
    world = World(Scene(robots=robots, floor=False))
    data, decor, rng = world.make_data(), Decor(world), np.random.default_rng(7)
    links = np.flatnonzero(world.model.geom_bodyid > 0)
    for azimuth in np.linspace(0, 2 * np.pi, 8, endpoint=False):
        for name in world.robots:
            world.set_input(data, f"{name}.joint_angles", rng.uniform(-1.4, 1.4, 7))
            world.set_input(data, f"{name}.torques", rng.normal(0, 40, 7))
        follow(world.model, data)
        view = view_at(azimuth, distance=4.0, width=640, height=480)
        decor.draw(data, toggles_of(world), view)
        low, high = bounds_of_cards(decor)
        middles, _ = view.project(data.geom_xpos[links])
        within = (middles[:, None] > low) & (middles[:, None] < high)
        assert not within.all(axis=2).any()
        shown = [text for p in decor.panels if p.kind == Kind.LIMB for text in p.texts]
        assert 1 <= len(shown) <= 4
        assert all(b"7 joints" in text[0] and b"max" in text[1] for text in shown)


def test_hand_has_one_billboard_with_its_most_loaded_joint() -> None:
    """A hand on an arm: 27 joints, with space for some of them."""
    scene = load_scene("lwr_hit_hand")
    world = World(scene)
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    toggles.billboards[:] = True
    rng = np.random.default_rng(4)
    share = rng.permutation(np.linspace(0.01, 0.6, 27))
    share[7::4] = np.nan  # the last joint of a finger has no sensor
    for name, part in world.robots.items():
        torques = share[part.joints] * world.joints.torque_limit[part.joints]
        world.set_input(data, f"{name}.torques", torques)
    Placer(world).place(data)
    font = Typesetter(18).font
    for azimuth in np.linspace(-3, 3, 7):
        view = replace(view_at(azimuth, 2.0, 480, 360), font=font)
        decor.draw(data, toggles, view)
        limbs, cards = (panels for panels in decor.panels if panels.has_values)
        assert limbs.kind == Kind.LIMB and cards.items.tolist() == [*range(7)]
        top = 7 + int(np.nanargmax(share[7:]))
        finger = list(world.robots)[world.joints.owner[top]].removeprefix("hand_")
        label = f"{finger} {world.joints.names[top]}"
        (lines,) = limbs.texts
        assert lines[0].split() == [b"hand", b"20", b"joints"]
        assert lines[1].endswith(b"  %.0f %%" % (100 * share[top]))
        words = lines[1].decode().removeprefix("max ").rsplit("  ", 1)[0].partition("..")
        assert label.startswith(words[0]) and label.endswith(words[2])


def test_click_on_the_billboard_of_a_limb_shows_all_its_joints() -> None:
    world = World(load_scene("lwr_hit_hand"))
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    toggles.billboards[:] = True
    Placer(world).place(data)
    view = view_at(0.5, 2.0, 1280, 800)
    buffer = decor.draw(data, toggles, view)
    (limbs,) = (panels for panels in decor.panels if panels.kind == Kind.LIMB)
    assert [text[0].split()[1:] for text in limbs.texts] == [[b"20", b"joints"]]  # without data
    picked = pick(world, data, buffer, view, tuple(limbs.centres[0]))
    assert picked is not None and picked.kind == "limb"
    click(world, toggles, picked)
    decor.draw(data, toggles, view)
    (cards,) = (panels for panels in decor.panels if panels.kind == Kind.BILLBOARD)
    assert set(cards.items.tolist()) >= {*range(7, 27)}
    toggles.clicked[:] = False
    click(world, toggles, picked, "shift")
    assert toggles.billboards.nonzero()[0].tolist() == [*range(7)]


def test_billboards_of_a_hand_are_grouped_on_its_side() -> None:
    world = World(load_scene("lwr_hit_hand"))
    data, toggles = world.make_data(), toggles_of(world)
    toggles.billboards[:] = True
    Placer(world).place(data)
    for azimuth in (-1.0, 2.1):
        decor, view = Decor(world), view_at(azimuth, 2.6, 1800, 1600)
        decor.draw(data, toggles, view)
        (cards,) = (panels for panels in decor.panels if panels.has_values)
        assert len(cards.texts) == 27
        across = view.project(data.site_xpos[world.joints.centre_site])[0][:, 0]
        is_finger = world.joints.owner > 0
        on_left = across[is_finger].mean() < across[~is_finger].mean()
        sides = cards.centres[is_finger[cards.items], 0] < view.width / 2
        assert (sides == on_left).all()


@pytest.mark.parametrize(("azimuth", "distance"), [(0.3, 2.6), (-0.4, 2.6), (0.0, 3.2)])
def test_leaders_do_not_cross_billboards_of_another_robot(azimuth: float, distance: float) -> None:
    robots = [
        SerialRobot.from_model("lwr", name=name, base_frame={"xyz": [0, y, 0]})
        for name, y in (("left", 0.5), ("right", -0.5))
    ]
    world = World(Scene(robots=robots, floor=False))
    data, toggles, rng = world.make_data(), toggles_of(world), np.random.default_rng(5)
    toggles.billboards[:] = toggles.legend = True
    font = Typesetter(18).font
    for _ in range(12):
        decor = Decor(world)
        for name in world.robots:
            world.set_input(data, f"{name}.joint_angles", rng.uniform(-1.4, 1.4, 7))
            world.set_input(data, f"{name}.torques", rng.normal(0, 40, 7))
        follow(world.model, data)
        view = replace(view_at(azimuth, distance, 640, 480), font=font)
        decor.draw(data, toggles, view)
        (cards,) = (panels for panels in decor.panels if panels.has_values)
        ends = view.project(data.site_xpos[world.joints.centre_site[cards.items]])[0]
        owner = world.joints.owner[cards.items]
        half = cards.sizes / 2
        starts = cards.centres.copy()
        beside = ends[:, 0] - starts[:, 0]
        inward = np.sign(view.width / 2 - starts[:, 0])
        edge = np.where(np.abs(beside) > half[:, 0], np.sign(beside), inward)
        starts[:, 0] += edge * half[:, 0]
        along = np.linspace(0, 1, 200)[:, None, None]
        points = starts + along * (ends - starts)  # (200, leaders, 2)
        away = np.abs(points[:, :, None] - cards.centres)
        over = (away < half - 1).all(axis=3).any(axis=0)
        assert not over[owner[:, None] != owner].any()


def test_decimals_follow_the_torque_of_a_full_width_arrow() -> None:
    """A hundredth of the limit is readable."""
    limits = [200.0, 38.0, 9.0, 3.0, 0.5, 0.004]
    robot = SerialRobot(
        name="r", dh_convention="craig", dh_params=np.zeros((6, 4)), torque_limits=limits,
        torques=0.1234 * np.array(limits), show_billboards=True,
    )  # fmt: skip
    world = World(Scene(robots=[robot], floor=False))
    texts = {text.split()[0]: text.split()[1] for text in labels(drawn(world, view_at(distance=9)))}
    expected = ["24.7", "4.7", "1.11", "0.37", "0.062", "0.0005"]
    assert texts == {f"J{k + 1}": text for k, text in enumerate(expected)}


@pytest.mark.parametrize(
    ("limits", "expected", "error"),
    [
        ([1e-5, 1e-6, 5e-8], ["5.0 uNm", "0.50 uN", "0.0250 uNm"], "err     2.50 uNm"),
        ([0.05, np.inf, 0.002], ["25.0 mNm", "0.0 N", "1.00 mNm"], "err    12.50 mNm"),
        ([9000.0, 20.0, 9.0], ["4500.0 Nm", "10.0 N", "4.50 Nm"], "err  2250.00 Nm"),
        ([2e6, 2e4, 8e5], ["1000.0 kNm", "10.0 kN", "400.0 kNm"], "err   500.00 kNm"),
    ],
)
def test_torques_of_a_robot_share_a_unit_prefix_from_its_largest_limit(
    limits: list[float], expected: list[str], error: str
) -> None:
    torques = np.where(np.isfinite(limits), 0.5 * np.array(limits), 0.0)
    robot = SerialRobot(
        name="r", dh_convention="craig", dh_params=np.zeros((3, 4)), torque_limits=limits,
        joint_types=["revolute", "prismatic", "revolute"], torques=torques,
        commanded_torques=1.5 * torques, show_billboards=True,
    )  # fmt: skip
    world = World(Scene(robots=[robot], floor=False))
    lines = joint_formats(world)
    found = [" ".join(each.split()[1:]) for each in labels(drawn(world, view_at(distance=9)))]
    assert found == expected
    details = [line.text(value).decode() for line, value in zip(
        lines.details[0][2:4], [0.25 * limits[0], limits[0]], strict=True)]  # fmt: skip
    assert details[0].strip() == error
    assert details[1].endswith(expected[0].split()[1])
    # A declared unit or scale is used unchanged.
    own = BillboardLine(value="torques", unit="ozin", scale=141.6, decimals=1)
    (line,) = billboard_lines("J", [own], False, world.joints.torque_units[0], limits[0])
    assert line.text(1.0) == b"J   141.6 ozin"


def test_torques_set_at_run_time_replace_angles_on_billboards() -> None:
    world = world_of(show_billboards=True)
    data = world.make_data()
    assert texts_of(world, data)[0] == "A1     0.000 rad"
    world.set_input(data, "lwr.torques", np.arange(7.0))
    assert texts_of(world, data)[2] == "E1     2.0 Nm"
    world = world_of(show_billboards=True, billboard_lines=["joint_angles"])  # as declared
    data = world.make_data()
    world.set_input(data, "lwr.torques", np.arange(7.0))
    assert texts_of(world, data)[0] == "A1     0.000 rad"


@pytest.mark.parametrize("lines", [None, ["torques"]])
def test_billboard_shows_the_torque_error_of_its_arrow_unless_lines_are_declared(
    lines: list[str] | None,
) -> None:
    shown = {"show_arrows": True, "show_billboards": True}
    world = world_of(torques=[10.0] * 7, billboard_lines=lines, **shown)
    data, decor, toggles = world.make_data(), Decor(world), toggles_of(world)
    world.set_input(data, "lwr.commanded_torques", np.full(7, 12.5))

    def card() -> str:
        return texts_of(world, data, decor, toggles)[0].strip()

    torque = card()
    assert torque == "A1    10.0 Nm"
    toggles.arrow_quantity[:] = ARROW_QUANTITIES.index("torque_error")
    assert card() == ("A1  err     2.50 Nm" if lines is None else torque)
    toggles.arrows[:] = False
    assert card() == torque


def test_billboards_are_placed_again_only_after_changes(monkeypatch) -> None:
    world = world_of(torques=TORQUES, show_billboards=True)
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    placed = []
    monkeypatch.setattr(
        billboard_layout, "columns", lambda *a, **k: placed.append(0) or columns(*a, **k)
    )

    def times_placed(view: ImageView) -> int:
        placed.clear()
        rows = decor.draw(data, toggles, view).rows[: decor.buffer.count]
        again = Decor(world).draw(data, toggles, view)
        assert rows.tobytes() == again.rows[: again.count].tobytes()
        return len(placed) - 1  # one call is of the other decor

    view = view_at()
    # The first call fills an empty cache.
    assert [times_placed(view) for _ in range(3)] == [1, 1, 0]
    world.set_input(data, "lwr.torques", 1.1 * np.array(TORQUES))
    assert times_placed(view) == 0
    data.qpos[1] += 0.1
    mujoco.mj_kinematics(world.model, data)
    assert [times_placed(view) for _ in range(2)] == [1, 0]
    assert [times_placed(view_at(width=1000)) for _ in range(4)][::3] == [1, 0]
    toggles.billboards[4:] = False
    assert times_placed(view_at(width=1000)) > 0  # and compares arrays of another length


def test_frame_names_do_not_overlap_billboards_or_each_other() -> None:
    """SpaceJustin names eight frames of its body, shoulders and wrists."""
    world = World(load_scene("space_justin"))
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    toggles.billboards[:] = toggles.frame_names[:8] = True
    Placer(world).place(data)
    view = replace(view_at(np.pi, 2.6, 640, 480), font=Typesetter(18).font)
    decor.draw(data, toggles, view)
    low = np.concatenate([panels.centres - panels.sizes / 2 for panels in decor.panels])
    high = np.concatenate([panels.centres + panels.sizes / 2 for panels in decor.panels])
    is_name = np.concatenate([[p.kind == Kind.NAME] * len(p.texts) for p in decor.panels])
    over = ((low[:, None] < high - 1e-6) & (high[:, None] > low + 1e-6)).all(axis=2)
    assert is_name.sum() >= 4
    assert not (over & ~np.eye(len(low), dtype=bool))[is_name].any()


def test_joints_without_data_are_not_called_the_most_loaded() -> None:
    snake = SerialRobot(name="snake", dh_params=[[0.0, 0.05, 0.0, 0.0]] * 27, dh_convention="craig")
    world = World(Scene(robots=[snake]))
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    toggles.billboards[:] = True
    toggles.status = False
    Placer(world).place(data)
    view = replace(view_at(0.5, 4.0, 480, 360), font=Typesetter(18).font)

    def note() -> str:
        buffer = decor.draw(data, toggles, view)
        told = labels(buffer.rows[: buffer.count])
        (found,) = [text for text in told if " shown" in text]
        return found

    assert note().endswith(" of 27 joints shown")
    for name, part in world.robots.items():
        world.set_input(data, f"{name}.torques", np.full(part.robot.n, 0.1))
    assert note().endswith(" of 27 joints shown: highest loads")


def test_narrow_image_has_one_column_of_the_most_loaded_joints() -> None:
    world = World(load_scene("lwr_hit_hand"))
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    toggles.billboards[:] = True
    for name, part in world.robots.items():
        world.set_input(data, f"{name}.torques", np.arange(1.0, part.robot.n + 1))
    Placer(world).place(data)
    view = replace(view_at(0.5, 4.0, 390, 844), font=Typesetter(18).font)
    decor.draw(data, toggles, view)
    low, high = bounds_of_cards(decor)
    assert len(low) == 8  # of the arm and the hand
    assert (low >= 0).all() and (high <= [390, 844]).all()
    over = ((low[:, None] < high - 1e-6) & (high[:, None] > low + 1e-6)).all(axis=2)
    assert not (over & ~np.eye(8, dtype=bool)).any()


def test_model_torques_are_labeled_as_model() -> None:
    world = world_of(torques=np.arange(7.0), show_billboards=True)
    toggles = toggles_of(world)
    toggles.modelled[:] = True
    buffer = Decor(world).draw(world.make_data(), toggles, view_at())
    assert labels(buffer.rows[: buffer.count])[2] == "E1  model     2.0 Nm"


@pytest.mark.slow
@pytest.mark.parametrize("lines", [1, 2, 3])
@pytest.mark.parametrize("size", [(360, 270), (270, 360), (640, 480)])
def test_billboards_of_several_lines_do_not_overlap_in_small_images(
    size: tuple[int, int], lines: int
) -> None:
    keys = ["torques", "joint_angles", "torque_error"][:lines]
    world = world_of(torques=np.arange(7.0), show_billboards=True, billboard_lines=keys)
    data, decor = world.make_data(), Decor(world)
    for azimuth in np.linspace(-3, 3, 7):
        view = replace(view_at(azimuth, 2.5, *size), font=Typesetter(18).font)
        decor.draw(data, toggles_of(world), view)
        low = np.concatenate([panels.centres - panels.sizes / 2 for panels in decor.panels])
        high = np.concatenate([panels.centres + panels.sizes / 2 for panels in decor.panels])
        over = ((low[:, None] < high - 1e-6) & (high[:, None] > low + 1e-6)).all(axis=2)
        assert not (over & ~np.eye(len(low), dtype=bool)).any()
        assert (low >= -1e-6).all() and (high <= np.array(size) + 1e-6).all()


def test_billboard_without_data_accepts_any_name() -> None:
    robot = SerialRobot(
        dh_convention="craig", dh_params=[[0, 0.3, 0, 0]] * 2, joint_names=["hüfte", "%s/関節"],
        show_billboards=True, billboard_values=None, inputs=["load"],
        billboard_lines=[{"value": "load"}],
    )  # fmt: skip
    world = World(Scene(robots=[robot]))
    for lines in joint_formats(world).declared:
        for value in (math.nan, 1.5):
            assert lines[0].text(value).decode().startswith(("hüfte", "joint 2"))
