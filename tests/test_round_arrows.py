"""Round arrows: position, direction of rotation, width, color, count."""

import mujoco
import numpy as np
import pytest
from decor_tools import (
    GEOM,
    bands,
    belonging,
    drawn,
    labels,
    length_of,
    rounds,
    tip_of,
    toggles_of,
    view_at,
    width_of,
    world_of,
)
from hypothesis import given
from hypothesis import strategies as st
from newton_euler import inverse_dynamics

from sero_mj.base.errors import DeclarationError
from sero_mj.data.drive.place import follow
from sero_mj.robots.assemble.friction_torques import SLOW, friction_of
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.robot_parts import ARROW_QUANTITIES
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.arrow_shapes import RATIOS, SHAFT
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import FIRST_SHAPE, Kind
from sero_mj.viewer.decor.quantities import arrow_values, joint_values
from sero_mj.viewer.decor.round_arrows import (
    FULL_WIDTH,
    NEGATIVE_RGBA,
    POSITIVE_RGBA,
    TURNING_SPEED,
    WIDEST,
    arrow_widths,
)

BAND = np.array([0.002])  # the default dead band
POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])


def arrows_of(world: World, data=None, toggles=None):
    """Returns the geoms of all arrows, and of their dark bands."""
    buffer = Decor(world).draw(
        world.make_data() if data is None else data, toggles or toggles_of(world), view_at()
    )
    return belonging(buffer, Kind.ARROW)


def one_arrow(torque: float, joint: int = 3, **fields):
    torques = np.zeros(7)
    torques[joint] = torque
    world = world_of(torques=torques, show_arrows=True, joint_angles=POSE, **fields)
    return world, arrows_of(world)


@pytest.mark.parametrize("torque", [10.0, -10.0])
@pytest.mark.parametrize("joint", range(7))
def test_arrow_surrounds_its_joint_axis_at_the_declared_offset(joint: int, torque: float) -> None:
    world, (arrow,) = one_arrow(torque, joint)
    robot = world.robots["lwr"].robot
    # From the DH table, not from the model: axis and center of the joint.
    frame = robot.dh.frames(POSE)[joint + 1]
    centre = frame[:3, 3] + frame[:3, :3] @ robot.offsets[joint]
    assert arrow["pos"] == pytest.approx(centre, abs=1e-6)
    assert arrow["size"][:2] == pytest.approx([0.1, 0.1])
    # Meshes are right-handed about z.
    assert arrow["mat"][:, 2] == pytest.approx(np.sign(torque) * frame[:3, 2], abs=1e-6)
    assert arrow["mat"].T @ arrow["mat"] == pytest.approx(np.eye(3), abs=1e-5)
    assert np.linalg.det(arrow["mat"]) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("torque", [20.0, -20.0])
def test_arrow_rotates_by_the_right_hand_rule_at_constant_speed(torque: float) -> None:
    world, _ = one_arrow(torque)
    data = world.make_data()
    axes = data.site_xmat[world.joints.centre_site[3]].reshape(3, 3)
    angles = []
    for k in range(9):
        data.time = 0.25 * k
        x, y, _ = arrows_of(world, data)["mat"][0][:, 0] @ axes
        angles.append(np.arctan2(y, x))
    speeds = np.diff(np.unwrap(angles)) / 0.25
    assert speeds == pytest.approx(np.full(8, np.sign(torque) * TURNING_SPEED), abs=1e-3)


def test_speed_does_not_depend_on_the_joint_motion() -> None:
    world, _ = one_arrow(20.0)
    data = world.make_data()
    rotations = []
    for q in (0.0, 0.9):  # only the arrow's own joint moves; time is constant
        data.qpos[3] = q
        follow(world.model, data)
        rotations.append(arrows_of(world, data)["mat"][0].astype(float))
    assert rotations[0] == pytest.approx(rotations[1], abs=1e-6)


def test_colors_show_the_sign() -> None:
    for torque, rgba in ((5.0, POSITIVE_RGBA), (-5.0, NEGATIVE_RGBA)):
        _, (arrow,) = one_arrow(torque)
        assert np.abs(arrow["rgba"] - np.array(rgba)).max() < 1e-6
    # Distinguishable without color, too: their lightness differs by more than a fifth.
    light = [np.dot(rgba[:3], (0.2126, 0.7152, 0.0722)) for rgba in (POSITIVE_RGBA, NEGATIVE_RGBA)]
    assert abs(light[0] - light[1]) > 0.2


def test_zero_and_missing_torques_show_no_arrow() -> None:
    assert len(drawn(world_of(torques=np.zeros(7), show_arrows=True))) == 0
    assert len(drawn(world_of(show_arrows=True))) == 0
    # A thousandth of the limit is noise, a hundredth is not.
    limit = SerialRobot.from_model("lwr").torque_limits
    assert len(drawn(world_of(torques=limit * 5e-4, show_arrows=True))) == 0
    assert len(arrows_of(world_of(torques=limit * 1e-2, show_arrows=True))) == 7


def test_hidden_arrow_is_not_drawn_and_the_others_are() -> None:
    world = world_of(torques=np.full(7, 10.0), show_arrows=True)
    toggles = toggles_of(world)
    toggles.arrows[[1, 4]] = False
    assert len(arrows_of(world, toggles=toggles)) == 5


def test_width_at_the_limit_and_at_smaller_loads() -> None:
    limit, radius = np.array([176.0]), np.array([0.1])
    full = arrow_widths(limit, limit, radius, np.array([0.01]), BAND)
    assert full == pytest.approx([0.1 * FULL_WIDTH])
    assert arrow_widths(0.02 * limit, limit, radius, np.array([0.01]), BAND) > 0.14 * full
    assert arrow_widths(limit, limit, radius, np.array([0.013]), BAND) == pytest.approx(1.3 * full)
    # 10, 50 and 100 % of the limit differ by more than three pixels in an image of 640x480, where
    # the radius of an LWR's arrow has about 31 pixels.
    pixels = 31 / 0.1 * arrow_widths(limit * [0.1, 0.5, 1.0], limit, radius, np.array([0.01]), BAND)
    assert (np.diff(pixels) > 3.0).all()


@given(
    a=st.floats(0, 500),
    b=st.floats(0, 500),
    limit=st.one_of(st.just(np.inf), st.floats(0.1, 300)),
    radius=st.floats(0.01, 1),
    scale=st.floats(1e-4, 0.1),
)
def test_width_is_monotone_bounded_and_independent_of_the_sign(a, b, limit, radius, scale) -> None:
    torques = np.array([min(a, b), max(a, b), -max(a, b)])
    limits, radii = np.full(3, limit), np.full(3, radius)
    low, high, negative = arrow_widths(torques, limits, radii, np.full(3, scale), BAND)
    assert 0 <= low <= high == negative <= WIDEST * radius * (1 + 1e-12)
    assert arrow_widths(np.zeros(3), limits, radii, np.full(3, scale), BAND).tolist() == [0, 0, 0]


def test_width_without_a_limit_follows_the_scale() -> None:
    width = arrow_widths(
        np.array([3.0]), np.array([np.inf]), np.array([0.1]), np.array([0.01]), BAND
    )
    assert width == pytest.approx([0.03])


def test_drawn_width_equals_arrow_widths() -> None:
    for torque in (0.5, 25.0, 31.0, 100.0):
        _, (arrow,) = one_arrow(torque)
        width = FULL_WIDTH * 0.1 * np.sqrt(torque / 100.0)
        assert width_of(arrow) == pytest.approx(width, rel=1e-5)


@pytest.mark.parametrize("force", [4.0, -4.0])
def test_prismatic_joint_has_a_straight_arrow_along_its_force(force: float) -> None:
    robot = SerialRobot(
        dh_convention="craig",
        dh_params=[[0.4, 0.1, 0.2, 0.3]],
        joint_types=["prismatic"],
        torques=[force],
        show_arrows=True,
    )
    rows = drawn(World(Scene(robots=[robot], floor=False)))
    assert length_of(rows) == pytest.approx(2.5 * robot.arrow_radii[0])
    axis = robot.dh.frames([0.0])[1][:3, 2]
    assert rows["mat"][0][:, 2] == pytest.approx(np.sign(force) * axis, abs=1e-6)
    # Beside the link, where it is visible: its center is one radius from the axis.
    radius = robot.arrow_radii[0]
    middle = (rows["pos"][0] + tip_of(rows)) / 2
    off = middle - robot.dh.frames([0.0])[1][:3, 3]
    assert np.linalg.norm(off - (off @ axis) * axis) == pytest.approx(radius, rel=1e-5)
    assert abs(off @ axis) < 1e-6
    assert np.linalg.det(rows["mat"][0]) == pytest.approx(1.0, abs=1e-5)


def test_arrows_of_51_joints_are_one_geom_each() -> None:
    robot = SerialRobot(
        dh_convention="craig",
        dh_params=[[0.1, 0.05, 0, 0.05]] * 51,
        torques=np.full(51, 5.0),
        show_arrows=True,
        show_billboards=True,
        show_axes=True,
    )
    world = World(Scene(robots=[robot], floor=False))
    buffer = Decor(world).draw(world.make_data(), toggles_of(world), view_at(distance=12))
    assert buffer.dropped == 0
    assert len(belonging(buffer, Kind.ARROW)) == 51


def test_no_arrow_below_the_dead_band_and_continuous_growth_above() -> None:
    limit, radius, scale = np.full(4, 50.0), np.full(4, 0.1), np.full(4, 0.01)
    shares = np.array([0.019, 0.0201, 0.03, 0.04])
    widths = arrow_widths(shares * limit, limit, radius, scale, np.full(4, 0.02))
    assert widths[0] == 0
    assert 0 < widths[1] < 0.1 * widths[3]  # no jump at the edge of the band
    assert widths[3] == pytest.approx(0.1 * FULL_WIDTH * np.sqrt(0.04))


def test_arrow_beyond_its_limit_is_striped_and_one_at_it_is_not() -> None:
    for torque, stripes in ((100.0, 0), (101.0, 1), (-150.0, 1)):
        _, rows = one_arrow(torque)
        (arrow,) = rounds(rows)
        assert arrow["rgba"] == pytest.approx(POSITIVE_RGBA if torque > 0 else NEGATIVE_RGBA)
        dark = bands(rows)
        assert len(rows) == 1 + len(dark) == 1 + stripes
        for band in dark:
            assert (band["rgba"][:3] < 0.2).all()
            assert band["dataid"] - arrow["dataid"] == len(RATIOS)  # of the same shape
            for field in ("pos", "mat", "size"):
                assert (band[field] == arrow[field]).all()


@pytest.mark.parametrize(
    ("quantity", "expected"),
    [("torques", [30, 0, 0]), ("torque_error", [-20, 40, 0]), ("joint_accelerations", [0, 0, -2])],
)
def test_arrows_show_the_quantity_declared_in_the_scene(quantity, expected) -> None:
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
    arrows = arrows_of(world)
    shown = values.nonzero()[0]
    assert len(arrows) == len(shown)
    for arrow, joint in zip(arrows, shown, strict=True):
        width = FULL_WIDTH * 0.1 * np.sqrt(abs(values[joint]) / limit[joint])
        assert width_of(arrow) == pytest.approx(width, rel=1e-5)
        colour = POSITIVE_RGBA if values[joint] > 0 else NEGATIVE_RGBA
        assert arrow["rgba"] == pytest.approx(colour)


def test_arrows_show_the_torque_not_explained_by_gravity() -> None:
    angles = np.array([0.2, 0.6, -0.3, -1.2, 0.4, 0.8, 0.1])
    lwr = SerialRobot.from_model("lwr", arrow_quantity="torque_without_gravity", name="lwr")
    held = inverse_dynamics(lwr, robot_dynamics(lwr), angles)
    pushed = np.array([5.0, -8.0, 2.0, 6.0, 0.5, -1.0, 0.2])
    robot = lwr.model_copy(update={"joint_angles": angles, "torques": held + pushed})
    double = Double(name="goal", of="lwr", torques=held)
    world = World(Scene(robots=[robot], doubles=[double], floor=False))
    data = world.make_data()
    quantity = np.full(14, ARROW_QUANTITIES.index("torque_without_gravity"))
    shown, limit = arrow_values(world, data, joint_values(world, data), quantity)
    assert shown[:7] == pytest.approx(pushed, abs=1e-6)
    assert np.isnan(shown[7:]).all()  # a double has no weight
    assert limit == pytest.approx(world.joints.torque_limit)


def test_floating_robot_has_no_arrows_without_gravity(caplog: pytest.LogCaptureFixture) -> None:
    robot = SerialRobot.from_model("lwr", name="lwr", free_base=True, torques=np.ones(7))
    world = World(Scene(robots=[robot], floor=False))
    data, quantity = world.make_data(), np.full(7, 4)
    for _ in range(2):
        shown, _ = arrow_values(world, data, joint_values(world, data), quantity)
        assert np.isnan(shown).all()
    reason = "joint torques cannot hold a robot with a free base against gravity"
    assert caplog.text.count(reason) == 1


def test_arrows_show_the_torque_not_explained_by_friction() -> None:
    lwr = SerialRobot.from_model(
        "lwr", name="lwr", inputs=["joint_velocities"], torques=np.linspace(-9.0, 9.0, 7)
    )
    double = Double(name="goal", of="lwr", torques=np.ones(7))
    scene = Scene(robots=[lwr], doubles=[double], floor=False)
    world, moving = World(scene), World(scene, dynamic=True)
    data, physics = world.make_data(), moving.make_data()
    velocities = np.array([0.5, -1.0, 0.02, -0.3, 2.0, -0.05, 0.8])
    dofs = moving.robots["lwr"].dofs
    physics.qvel[dofs] = velocities
    mujoco.mj_forward(moving.model, physics)  # MuJoCo's friction acts against the motion
    rows = physics.efc_type == int(mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF)
    friction = np.zeros(7)
    friction[physics.efc_id[rows]] = -physics.efc_force[rows]
    friction -= physics.qfrc_passive[dofs]
    quantity = np.full(14, ARROW_QUANTITIES.index("torque_without_friction"))
    for received in (False, True):
        if received:
            data.qvel[:] = 7.0  # nothing is subtracted from it
            world.set_input(data, "lwr.joint_velocities", velocities)
        else:
            data.qvel[world.robots["lwr"].dofs] = velocities
        shown, limit = arrow_values(world, data, joint_values(world, data), quantity)
        assert shown[:7] == pytest.approx(lwr.torques - friction, abs=1e-6)
        assert np.isnan(shown[7:]).all()
        assert limit == pytest.approx(world.joints.torque_limit)


def test_friction_changes_sign_without_a_jump() -> None:
    lwr = SerialRobot.from_model("lwr", name="lwr")
    slow = np.linspace(-2 * SLOW, 2 * SLOW, 401)[:, None] * np.ones(7)
    friction = friction_of(lwr, slow)
    assert friction[200] == pytest.approx(0.0)
    assert friction == pytest.approx(-friction[::-1])
    assert np.diff(friction, axis=0).max() < 0.01 * lwr.dynamics.coulomb_friction.max() + 1e-3
    assert friction[-1] == pytest.approx(
        lwr.dynamics.coulomb_friction + 2 * SLOW * lwr.dynamics.viscous_friction
    )


def test_robot_without_declared_friction_has_no_such_arrows(
    caplog: pytest.LogCaptureFixture,
) -> None:
    robots = [
        SerialRobot.from_model("lwr", name="lwr", torques=np.ones(7)),
        SerialRobot.from_model("fr3", name="fr3", torques=np.ones(7)),
    ]
    world = World(Scene(robots=robots, floor=False))
    data = world.make_data()
    quantity = np.full(14, ARROW_QUANTITIES.index("torque_without_friction"))
    for _ in range(2):
        shown, _ = arrow_values(world, data, joint_values(world, data), quantity)
        assert shown[:7] == pytest.approx(np.ones(7))
        assert np.isnan(shown[7:]).all()
    assert [record.message for record in caplog.records] == [
        "torques without friction are unavailable: robots.fr3: dynamics has neither "
        "viscous_friction nor coulomb_friction"
    ]


# ---- the largest torque so far


def largest_of(limits: object = "largest", **fields: object) -> World:
    lwr = SerialRobot.from_model("lwr", name="lwr", torque_limits=limits, **fields)
    double = Double(name="goal", of="lwr")
    return World(Scene(robots=[lwr], doubles=[double], floor=False))


def test_largest_torque_so_far_is_the_scale_without_a_limit() -> None:
    world = largest_of(show_arrows=True)
    data, quantity = world.make_data(), np.zeros(14, np.intp)

    def seen(torques: np.ndarray, target: str = "lwr.torques") -> tuple[np.ndarray, np.ndarray]:
        world.set_input(data, target, torques)
        shown, limit = arrow_values(world, data, joint_values(world, data), quantity)
        return shown.copy(), limit.copy()

    floor = world.joints.torque_limit.copy()
    noise = floor[:7] / 100
    shown, limit = seen(noise)
    assert shown[:7] == pytest.approx(noise)
    assert limit == pytest.approx(floor)
    peaks = floor[:7] * np.array([5.0, -80.0, 3.0, 0.5, -2.0, 7.0, 900.0])
    _, limit = seen(peaks)
    largest = np.maximum(np.abs(peaks), floor[:7])
    assert limit == pytest.approx(np.tile(largest, 2))  # a double has its robot's scale
    assert seen(noise)[1] == pytest.approx(np.tile(largest, 2))  # so far
    widths = arrow_widths(peaks, limit[:7], np.full(7, 0.1), np.full(7, 0.01), np.full(7, 0.002))
    assert widths[[0, 1, 6]] == pytest.approx(0.1 * FULL_WIDTH)
    for wrong in (np.nan, np.inf, 1e30):
        shown, limit = seen(np.full(7, wrong))
        assert np.isnan(shown[:7]).all()
        assert limit == pytest.approx(np.tile(largest, 2))
    commanded = np.zeros(7)
    commanded[5] = largest[5] = 2 * largest[5]
    assert seen(commanded, "goal.commanded_torques")[1] == pytest.approx(np.tile(largest, 2))
    assert np.isinf(world.robots["lwr"].robot.torque_bounds).all()  # it limits nothing


def test_initial_scale_is_a_share_of_the_gravity_load() -> None:
    joints = largest_of(fit_arrows=True).joints
    assert np.isfinite(joints.arrow_load).all()
    assert joints.torque_limit == pytest.approx(0.1 * joints.arrow_load)
    joints = largest_of(arrow_width_scale=0.02).joints
    assert np.isinf(joints.arrow_load).all()
    assert joints.torque_limit == pytest.approx(np.ones(14))


def test_declared_limits_are_combined_with_the_largest_torque() -> None:
    world = largest_of([100.0, "largest", 50.0, "largest", 20.0, 10.0, 10.0])
    data = world.make_data()
    world.set_input(data, "lwr.torques", np.full(7, 400.0))
    joint_values(world, data)
    found = [100.0, 400.0, 50.0, 400.0, 20.0, 10.0, 10.0]
    assert world.joints.torque_limit[:7] == pytest.approx(found)
    assert np.flatnonzero(world.joints.is_largest[:7]).tolist() == [1, 3]


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ("largest", "largest seen so far"),
        ([9.0, "largest", *[9.0] * 5], "torque limit, or largest seen so far"),
        ([9.0] * 7, "torque limit"),
    ],
)
def test_legend_and_billboards_name_the_largest_torque_as_scale(
    limits: object, expected: str
) -> None:
    world = largest_of(limits, show_arrows=True, torques=np.full(7, 5.0))
    toggles = toggles_of(world)
    toggles.legend = True
    toggles.details[1] = toggles.billboards[1] = True
    decor = Decor(world)
    decor.draw(world.make_data(), toggles, view_at())
    texts = [b"\n".join(lines).decode() for panel in decor.panels for lines in panel.texts]
    (legend,) = [text for text in texts if text.startswith("round arrows")]
    assert legend.endswith(f"     {expected}")
    (card,) = [text for text in texts if "share" in text]
    assert ("largest seen" in card) == (limits != [9.0] * 7)
    assert ("limit" in card) == (limits == [9.0] * 7)


@pytest.mark.parametrize(
    ("limits", "expected"),
    [(None, "stanford"), ([9.0, np.inf, 9.0, 9.0, 9.0, 9.0], "without a limit")],
)
def test_legend_names_robots_without_torque_limits(limits: object, expected: str) -> None:
    other = SerialRobot.from_model(
        "stanford", show_arrows=True, torques=np.ones(6), torque_limits=limits
    )
    lwr = SerialRobot.from_model("lwr", show_arrows=True, torques=np.ones(7))
    world = World(Scene(robots=[lwr, other], floor=False))
    toggles = toggles_of(world)
    toggles.legend = True
    decor = Decor(world)
    decor.draw(world.make_data(), toggles, view_at())
    ((lines,),) = [panel.texts for panel in decor.panels if panel.of_arrows]
    assert lines[2].decode().partition(":")[0] == expected
    assert lines[3].endswith(b"torque limit")


@pytest.mark.parametrize("limits", ["larger", [1.0, "largest", "x", 1, 1, 1, 1]])
def test_unknown_words_are_rejected_as_torque_limits(limits: object) -> None:
    with pytest.raises(DeclarationError) as caught:
        SerialRobot.from_model("lwr", torque_limits=limits)
    (problem,) = caught.value.problems
    word = limits if isinstance(limits, str) else "x"
    assert problem.message == f"found '{word}'; expected a number, inf for no limit, or \"largest\""


def test_joint_without_valid_data_loses_only_its_own_arrow() -> None:
    world = world_of(torques=np.full(7, 20.0), show_arrows=True)
    data = world.make_data()
    slot = world.slots["lwr.torques"]
    for wrong in (np.nan, np.inf, -np.inf, 1e30):
        data.userdata[slot][2] = wrong
        assert len(arrows_of(world, data)) == 6
    data.userdata[slot][2] = 20.0
    assert len(arrows_of(world, data)) == 7


def test_straight_arrow_beyond_its_limit_is_dark() -> None:
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


def test_arrows_are_outside_of_generated_shapes() -> None:
    for scale in (0.02, 1.0, 30.0):
        robot = SerialRobot(
            dh_convention="craig",
            dh_params=scale * np.array([[0, 0, 0, 0.3], [0, 0.4, 0, 0], [0, 0.3, 0, 0]]),
            torques=[5.0, 5.0, 5.0],
            torque_limits=[10.0] * 3,
            show_arrows=True,
        )
        world = World(Scene(robots=[robot], floor=False))
        assert (robot.arrow_radii > 1.5 * robot.housing_radii).all()
        model = world.model  # only the pedestal's cylinder is as large
        sizes = model.geom_size[model.geom_type == int(GEOM.mjGEOM_CYLINDER), 0]
        assert np.sort(sizes)[-2] == pytest.approx(robot.housing_radii.max())
        assert len(arrows_of(world)) == 3
    # Intersecting axes: both arrows are outside the larger housing, whichever row has the offset.
    for convention, rows in (
        ("craig", [[0, 0, 0, 0.7], [-np.pi / 2, 0, 0, 0], [0, 0.45, 0, 0]]),
        ("standard", [[-np.pi / 2, 0, 0, 0.7], [0, 0.45, 0, 0]]),
    ):
        robot = SerialRobot(dh_convention=convention, dh_params=rows)
        assert robot.arrow_radii[:2] == pytest.approx(1.7 * robot.housing_radii[0])
    assert SerialRobot.from_model("lwr").arrow_radii.tolist() == [0.1] * 7
    declared = SerialRobot(dh_convention="craig", arrow_radius=0.3)
    assert declared.arrow_radii.tolist() == [0.3]


def test_implausible_torque_is_reported_where_no_arrow_shows_it() -> None:
    world = world_of(torques=np.full(7, 20.0), show_arrows=True)
    data = world.make_data()
    slot = world.slots["lwr.torques"]
    limit = world.joints.torque_limit[2]
    for value, said in (
        (1e12, ["E1: 1e+12 Nm is over 1000 times the limit and is not drawn"]),
        (-1e300, ["E1: -1e+300 Nm is over 1000 times the limit and is not drawn"]),
        (999.0 * limit, [f"E1: {999 * limit:.3g} Nm is 999 times the limit"]),
        (9.9 * limit, []),  # an arrow, striped
        (np.nan, []),
    ):
        data.userdata[slot][2] = value
        buffer = Decor(world).draw(data, toggles_of(world), view_at())
        shown = labels(buffer.rows[: buffer.count])
        assert [text for text in shown if "times the limit" in text] == said


def test_z_axis_is_drawn_at_clicked_joints() -> None:
    world = world_of(torques=np.full(7, 20.0), show_arrows=True, joint_angles=POSE)
    data, toggles, decor = world.make_data(), toggles_of(world), Decor(world)
    assert "z" not in labels(decor.draw(data, toggles, view_at()).rows[: decor.buffer.count])
    toggles.details[3] = True
    rows = decor.draw(data, toggles, view_at()).rows[: decor.buffer.count]
    axis = rows[rows["dataid"] == FIRST_SHAPE + SHAFT]
    site = world.joints.centre_site[3]
    assert axis["pos"][0] == pytest.approx(data.site_xpos[site], abs=1e-6)
    assert axis["mat"][0][:, 2] == pytest.approx(
        world.robots["lwr"].kinematics.frames(POSE)[4][:3, 2]
    )
    assert labels(rows).count("z") == 1
