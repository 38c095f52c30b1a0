"""Round arrows as numbers: place, direction of turning, width, colour, count."""

from itertools import pairwise

import numpy as np
import pytest
from decor_tools import GEOM, drawn, labels, of_kind, toggles_of, view_at, world_of
from hypothesis import given
from hypothesis import strategies as st

from sero_mj.assemble.robot import SerialRobot
from sero_mj.assemble.scene import Scene
from sero_mj.assemble.shapes import housing_radii
from sero_mj.assemble.world import World
from sero_mj.decor.draw import Decor
from sero_mj.decor.pen import Kind
from sero_mj.decor.round_arrows import (
    NEGATIVE_RGBA,
    POSITIVE_RGBA,
    TURNING_SPEED,
    WIDEST,
    arrow_widths,
    ribbon_shape,
)
from sero_mj.drive.place import follow

BAND = np.array([0.002])  # the default dead band
POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])


def ribbons(world: World, data=None, toggles=None):
    """Boxes of every arrow, (arrows, segments)."""
    decor = Decor(world)
    data = world.make_data() if data is None else data
    toggles = toggles or toggles_of(world)
    toggles.status = False  # its panel is a box as well
    pen = decor.draw(data, toggles, view_at())
    boxes = of_kind(pen.rows[: pen.count], GEOM.mjGEOM_BOX)
    arrows = len(set(pen.items[: pen.count][pen.kinds[: pen.count] == Kind.ARROW].tolist()))
    return boxes.reshape(arrows, -1 if arrows else 1)


def one_arrow(torque: float, joint: int = 3, **fields):
    torques = np.zeros(7)
    torques[joint] = torque
    world = world_of(torques=torques, show_arrows=True, joint_angles=POSE, **fields)
    return world, ribbons(world)


def in_joint_frame(world: World, data, joint: int, points):
    """Points in the frame of the arrow's site, whose z is the joint's axis."""
    site = world.joints.centre_site[joint]
    return (points - data.site_xpos[site]) @ data.site_xmat[site].reshape(3, 3)


@pytest.mark.parametrize("joint", range(7))
def test_an_arrow_lies_about_its_joints_axis_at_the_declared_offset(joint: int) -> None:
    world, arrows = one_arrow(10.0, joint)
    assert arrows.shape[0] == 1
    robot = world.robots["lwr"].robot
    # By DH, not by the model: axis and centre of the joint.
    frame = robot.dh.frames(POSE)[joint + 1]
    centre = frame[:3, 3] + frame[:3, :3] @ robot.offsets[joint]
    out = arrows["pos"][0] - centre
    assert np.abs(out @ frame[:3, 2]).max() < 1e-6
    assert np.linalg.norm(out, axis=1) == pytest.approx(np.full(len(out), 0.1), abs=1e-6)
    # Every box is turned so that its width lies along the axis and its thickness outward.
    assert np.abs(arrows["mat"][0][:, :, 2] - frame[:3, 2]).max() < 1e-6
    assert np.abs(arrows["mat"][0][:, :, 0] * 0.1 - out).max() < 1e-6
    assert np.linalg.det(arrows["mat"][0]) == pytest.approx(np.ones(len(out)), abs=1e-5)


@pytest.mark.parametrize("torque", [20.0, -20.0])
def test_an_arrow_turns_by_the_right_hand_rule_at_constant_speed(torque: float) -> None:
    world, _ = one_arrow(torque)
    data = world.make_data()
    angles = []
    for k in range(9):
        data.time = 0.25 * k
        first_box = ribbons(world, data)["pos"][0, 0].astype(float)
        x, y, _ = in_joint_frame(world, data, 3, first_box)
        angles.append(np.arctan2(y, x))
    speeds = np.diff(np.unwrap(angles)) / 0.25
    assert speeds == pytest.approx(np.full(8, np.sign(torque) * TURNING_SPEED), abs=1e-3)


def test_the_speed_does_not_depend_on_the_joints_own_motion() -> None:
    world, _ = one_arrow(20.0)
    data = world.make_data()
    positions = []
    for q in (0.0, 0.9):  # only the arrow's own joint moves; time stands still
        data.qpos[3] = q
        follow(world.model, data)
        positions.append(ribbons(world, data)["pos"][0].astype(float))
    assert positions[0] == pytest.approx(positions[1], abs=1e-6)


@pytest.mark.parametrize("torque", [20.0, -20.0])
def test_the_head_runs_ahead_of_the_tail(torque: float) -> None:
    world, arrows = one_arrow(torque)
    data = world.make_data()
    local = in_joint_frame(world, data, 3, arrows["pos"][0].astype(float))
    along = np.unwrap(np.arctan2(local[:, 1], local[:, 0])) * np.sign(torque)
    assert (np.diff(along) > 0).all()  # tail to tip, in the direction of turning
    assert np.ptp(along) < 2 * np.pi
    width = arrows["size"][0][:, 2]
    widest = int(np.argmax(width))
    assert widest > len(width) / 2  # the widest box begins the head
    assert (np.diff(width[widest:]) < 0).all()  # from there it tapers to the tip
    assert width[-1] < 0.25 * width[widest]


def test_neighbouring_boxes_touch_so_that_the_ribbon_has_no_gaps() -> None:
    _, arrows = one_arrow(50.0)
    boxes = arrows[0]
    for a, b in pairwise(boxes):
        ahead = a["pos"] + a["mat"][:, 1] * a["size"][1]
        behind = b["pos"] - b["mat"][:, 1] * b["size"][1]
        if ahead @ b["mat"][:, 1] < behind @ b["mat"][:, 1]:
            ahead = a["pos"] - a["mat"][:, 1] * a["size"][1]
            behind = b["pos"] + b["mat"][:, 1] * b["size"][1]
        # The ends overlap or meet within the ribbon's thickness.
        assert np.linalg.norm(ahead - behind) < a["size"][0] * 2 + b["size"][0] * 2


def test_colours_tell_the_sign() -> None:
    for torque, rgba in ((5.0, POSITIVE_RGBA), (-5.0, NEGATIVE_RGBA)):
        _, arrows = one_arrow(torque)
        assert np.abs(arrows["rgba"][0] - np.array(rgba)).max() < 1e-6
    # Told apart without colour as well: their lightness differs by more than a fifth.
    light = [np.dot(rgba[:3], (0.2126, 0.7152, 0.0722)) for rgba in (POSITIVE_RGBA, NEGATIVE_RGBA)]
    assert abs(light[0] - light[1]) > 0.2


def test_zero_torque_and_missing_torque_show_no_arrow() -> None:
    assert len(drawn(world_of(torques=np.zeros(7), show_arrows=True))) == 0
    assert len(drawn(world_of(show_arrows=True))) == 0
    # A thousandth of the limit is noise, a hundredth is not.
    limit = SerialRobot.from_model("lwr").torque_limits
    assert len(drawn(world_of(torques=limit * 5e-4, show_arrows=True))) == 0
    assert ribbons(world_of(torques=limit * 1e-2, show_arrows=True)).shape[0] == 7


def test_a_hidden_arrow_is_not_drawn_and_the_others_are() -> None:
    world = world_of(torques=np.full(7, 10.0), show_arrows=True)
    toggles = toggles_of(world)
    toggles.arrows[[1, 4]] = False
    assert ribbons(world, toggles=toggles).shape[0] == 5


def test_width_at_the_limit_is_the_radius_and_two_percent_is_still_readable() -> None:
    limit, radius = np.array([176.0]), np.array([0.1])
    full = arrow_widths(limit, limit, radius, np.array([0.01]), BAND)
    assert full == pytest.approx([0.1])
    # A seventh of full width: at 800 pixels height and the default camera, 5 pixels.
    assert arrow_widths(0.02 * limit, limit, radius, np.array([0.01]), BAND) > 0.14 * full
    assert arrow_widths(limit, limit, radius, np.array([0.02]), BAND) == pytest.approx([0.15])


@given(
    a=st.floats(0, 500),
    b=st.floats(0, 500),
    limit=st.one_of(st.just(np.inf), st.floats(0.1, 300)),
    radius=st.floats(0.01, 1),
    scale=st.floats(1e-4, 0.1),
)
def test_width_is_monotone_bounded_and_blind_to_the_sign(a, b, limit, radius, scale) -> None:
    torques = np.array([min(a, b), max(a, b), -max(a, b)])
    limits, radii = np.full(3, limit), np.full(3, radius)
    low, high, negative = arrow_widths(torques, limits, radii, np.full(3, scale), BAND)
    assert 0 <= low <= high == negative <= WIDEST * radius * (1 + 1e-12)
    assert arrow_widths(np.zeros(3), limits, radii, np.full(3, scale), BAND).tolist() == [0, 0, 0]


def test_without_a_limit_the_scale_alone_gives_the_width() -> None:
    width = arrow_widths(
        np.array([3.0]), np.array([np.inf]), np.array([0.1]), np.array([0.01]), BAND
    )
    assert width == pytest.approx([0.03])


def test_drawn_width_is_what_arrow_widths_says() -> None:
    _, arrows = one_arrow(25.0)
    limit = 100.0
    tail = arrows["size"][0][:5, 2] * 2
    assert tail == pytest.approx(np.full(5, 0.1 * np.sqrt(25.0 / limit)), rel=1e-5)


@pytest.mark.parametrize("force", [4.0, -4.0])
def test_a_prismatic_joint_gets_a_straight_arrow_along_its_force(force: float) -> None:
    robot = SerialRobot(
        dh_convention="craig",
        dh_params=[[0.4, 0.1, 0.2, 0.3]],
        joint_types=["prismatic"],
        torques=[force],
        show_arrows=True,
    )
    rows = drawn(World(Scene(robots=[robot], floor=False)))
    assert len(rows) == 1
    assert rows["type"][0] == int(GEOM.mjGEOM_ARROW)
    axis = robot.dh.frames([0.0])[1][:3, 2]
    assert rows["mat"][0][:, 2] == pytest.approx(np.sign(force) * axis, abs=1e-6)
    # Beside the link, where it can be seen: its middle is one radius off the axis.
    radius = robot.arrow_radii[0]
    middle = rows["pos"][0] + rows["mat"][0][:, 2] * (1.25 * radius)
    off = middle - robot.dh.frames([0.0])[1][:3, 3]
    assert np.linalg.norm(off - (off @ axis) * axis) == pytest.approx(radius, rel=1e-5)
    assert abs(off @ axis) < 1e-6
    assert np.linalg.det(rows["mat"][0]) == pytest.approx(1.0, abs=1e-5)


def test_arrows_of_51_joints_stay_within_their_budget() -> None:
    rows = [[0.1, 0.05, 0, 0.05]] * 51
    robot = SerialRobot(
        dh_convention="craig",
        dh_params=rows,
        torques=np.full(51, 5.0),
        show_arrows=True,
        show_billboards=True,
        show_axes=True,
    )
    world = World(Scene(robots=[robot], floor=False))
    pen = Decor(world).draw(world.make_data(), toggles_of(world), view_at(distance=12))
    assert pen.dropped == 0
    assert pen.count < 1024


def test_below_the_dead_band_there_is_no_arrow_and_it_grows_from_there() -> None:
    limit, radius, scale = np.full(4, 50.0), np.full(4, 0.1), np.full(4, 0.01)
    shares = np.array([0.019, 0.0201, 0.03, 0.04])
    widths = arrow_widths(shares * limit, limit, radius, scale, np.full(4, 0.02))
    assert widths[0] == 0
    assert 0 < widths[1] < 0.1 * widths[3]  # no jump at the edge of the band
    assert widths[3] == pytest.approx(0.1 * np.sqrt(0.04))


def test_an_arrow_beyond_its_limit_is_striped_and_one_at_it_is_not() -> None:
    for torque, stripes in ((100.0, 0), (101.0, 22), (-150.0, 22)):
        _, arrows = one_arrow(torque)
        dark = (arrows["rgba"][0][:, :3] < 0.2).all(axis=1)
        assert dark.sum() == stripes
        assert not dark[0]


@pytest.mark.parametrize("segments", [6, 10, 18, 27, 45])
def test_direction_marks_are_spread_over_the_ribbon(segments: int) -> None:
    middle, half_angle, is_head, taper = ribbon_shape(segments)
    assert (middle[1:] - half_angle[1:]) == pytest.approx(middle[:-1] + half_angle[:-1])
    tips = middle[is_head & ~np.append(is_head[1:], False) | (np.diff(taper, append=9.0) > 0)]
    count = min(max(segments // 9, 1), 3)
    assert tips == pytest.approx((np.arange(count) + 1) * np.deg2rad(315) / count, abs=0.2)


@pytest.mark.parametrize(
    ("quantity", "expected"),
    [("torques", [30, 0, 0]), ("torque_error", [-20, 40, 0]), ("joint_accelerations", [0, 0, -2])],
)
def test_arrows_show_the_quantity_that_the_scene_chooses(quantity, expected) -> None:
    pad = [0.0] * 4
    world = world_of(
        torques=[30.0, 0, 0, *pad],
        commanded_torques=[10.0, 40.0, 0, *pad],
        joint_accelerations=[0.0, 0, -2.0, *pad],
        acceleration_limits=np.full(7, 4.0),
        arrow_quantity=quantity,
        show_arrows=True,
    )
    values = np.array([*expected, *pad])
    limit = world.joints.torque_limit if quantity != "joint_accelerations" else np.full(7, 4.0)
    arrows = ribbons(world)
    shown = values.nonzero()[0]
    assert len(arrows) == len(shown)
    for arrow, joint in zip(arrows, shown, strict=True):
        width = 0.1 * np.sqrt(abs(values[joint]) / limit[joint])
        assert arrow["size"][0, 2] * 2 == pytest.approx(width, rel=1e-5)
        colour = POSITIVE_RGBA if values[joint] > 0 else NEGATIVE_RGBA
        assert arrow["rgba"][0] == pytest.approx(colour)


def test_one_joint_without_data_loses_its_arrow_and_the_others_go_on() -> None:
    world = world_of(torques=np.full(7, 20.0), show_arrows=True)
    data = world.make_data()
    slot = world.slots["lwr.torques"]
    for wrong in (np.nan, np.inf, -np.inf, 1e30):
        data.userdata[slot][2] = wrong
        assert len(ribbons(world, data)) == 6
    data.userdata[slot][2] = 20.0
    assert len(ribbons(world, data)) == 7


def test_a_straight_arrow_beyond_its_limit_is_dark() -> None:
    colours = []
    for force in (10.0, 11.0):
        robot = SerialRobot(
            dh_convention="craig",
            joint_types=["prismatic"],
            torques=[force],
            torque_limits=[10.0],
            show_arrows=True,
        )
        colours.append(drawn(World(Scene(robots=[robot], floor=False)))["rgba"][0])
    assert colours[0] == pytest.approx(POSITIVE_RGBA)
    assert colours[1][:3] == pytest.approx(0.4 * np.array(POSITIVE_RGBA[:3]))


def test_arrows_about_grown_shapes_are_clear_of_them() -> None:
    for scale in (0.02, 1.0, 30.0):
        robot = SerialRobot(
            dh_convention="craig",
            dh_params=scale * np.array([[0, 0, 0, 0.3], [0, 0.4, 0, 0], [0, 0.3, 0, 0]]),
            torques=[5.0, 5.0, 5.0],
            torque_limits=[10.0] * 3,
            show_arrows=True,
        )
        world = World(Scene(robots=[robot], floor=False))
        model = world.model
        housings = model.geom_size[model.geom_type == int(GEOM.mjGEOM_CYLINDER), 0]
        # The first cylinder is the pedestal's.
        assert (robot.arrow_radii > 1.5 * housings[1:]).all()
        assert ribbons(world).shape[0] == 3
    # Axes that meet: both are clear of the larger housing, whichever row has the offset.
    for convention, rows in (
        ("craig", [[0, 0, 0, 0.7], [-np.pi / 2, 0, 0, 0], [0, 0.45, 0, 0]]),
        ("standard", [[-np.pi / 2, 0, 0, 0.7], [0, 0.45, 0, 0]]),
    ):
        robot = SerialRobot(dh_convention=convention, dh_params=rows)
        housings = housing_radii(robot.dh, robot.T_n_flange)
        assert robot.arrow_radii[:2] == pytest.approx(1.7 * housings[0])
    assert SerialRobot.from_model("lwr").arrow_radii.tolist() == [0.1] * 7
    declared = SerialRobot(dh_convention="craig", arrow_radius=0.3)
    assert declared.arrow_radii.tolist() == [0.3]


def test_a_torque_that_cannot_be_is_said_where_no_arrow_shows_it() -> None:
    world = world_of(torques=np.full(7, 20.0), show_arrows=True)
    data = world.make_data()
    slot = world.slots["lwr.torques"]
    limit = world.joints.torque_limit[2]
    for value, said in (
        (1e12, ["E1: 1e+12 Nm is over 1000 times the limit; not drawn"]),
        (-1e300, ["E1: -1e+300 Nm is over 1000 times the limit; not drawn"]),
        (999.0 * limit, [f"E1: {999 * limit:.3g} Nm is 999 times the limit"]),
        (9.9 * limit, []),  # an arrow, striped
        (np.nan, []),
    ):
        data.userdata[slot][2] = value
        pen = Decor(world).draw(data, toggles_of(world), view_at())
        assert [text for text in labels(pen.rows[: pen.count]) if "times the limit" in text] == said


def test_the_z_axis_is_drawn_at_joints_that_were_clicked_on() -> None:
    world = world_of(torques=np.full(7, 20.0), show_arrows=True, joint_angles=POSE)
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    assert "z" not in labels(decor.draw(data, toggles, view_at()).rows[: decor.pen.count])
    toggles.details[3] = True
    rows = decor.draw(data, toggles, view_at()).rows[: decor.pen.count]
    axis = of_kind(rows, GEOM.mjGEOM_ARROW)
    site = world.joints.centre_site[3]
    assert axis["pos"][0] == pytest.approx(data.site_xpos[site], abs=1e-6)
    assert axis["mat"][0][:, 2] == pytest.approx(
        world.robots["lwr"].kinematics.frames(POSE)[4][:3, 2]
    )
    assert labels(rows).count("z") == 1
