"""Arrows, billboards and axes of doubles, and the space for all of them."""

import mujoco
import numpy as np
import pytest
from decor_tools import (
    GEOM,
    belonging,
    labels,
    of_kind,
    rigid,
    texts_in,
    tip_of,
    toggles_of,
    turned,
    view_at,
    width_of,
)

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import COMMANDED_RGBA, DOUBLE_GROUP, Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.axes import AXIS_RGB
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import CAPACITY, GeomBuffer, Kind
from sero_mj.viewer.decor.panels import PANEL_RGBA
from sero_mj.viewer.decor.quantities import jacobian
from sero_mj.viewer.decor.round_arrows import FULL_WIDTH, NEGATIVE_RGBA, POSITIVE_RGBA
from sero_mj.viewer.decor.scene_writer import SceneWriter

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
TARGET = np.array([-0.4, 0.9, 0.1, -1.1, 0.6, 0.5, -0.3])
BASE = rigid(turned([1, 2, 3], 0.5), [0.1, -0.2, 0.2])
TORQUES = np.array([30.0, -60.0, 20.0, -9.0, 12.0, -7.0, 5.0])
JUSTIN = [3, 7, 7, 12, 12, 2, 8]  # chains of 51 joints, as in benchmarks/worlds.py
TURNING = 1.6  # rad/s


def world_with(*doubles: Double, **fields) -> World:
    fields = {"joint_angles": POSE, "base_frame": BASE.tolist(), **fields}
    robot = SerialRobot.from_model("lwr", **fields)
    return World(Scene(robots=[robot], doubles=list(doubles), floor=False))


def goal(**fields) -> Double:
    return Double(name="goal", of="lwr", **{"joint_angles": TARGET, **fields})


def draw(
    world: World, data=None, *, toggles=None, view=None, time: float = 0.0, capacity=CAPACITY
) -> GeomBuffer:
    data = world.make_data() if data is None else data
    Placer(world).place(data)
    data.time = time
    decor = Decor(world, capacity)
    return decor.draw(data, toggles or toggles_of(world), view or view_at(distance=3))


def texts_of(world: World) -> list[str]:
    buffer = draw(world)
    return labels(buffer.rows[: buffer.count])


@pytest.mark.parametrize("target", [TARGET, POSE])  # also where the robot hides its links
def test_arrows_are_at_the_joints_of_the_target_pose(target: np.ndarray) -> None:
    world = world_with(goal(joint_angles=target, torques=TORQUES, show_arrows=True))
    robot = world.scene.robots["lwr"]
    frames = robot.dh.frames(target, BASE)
    buffer = draw(world)
    assert set(buffer.kinds[: buffer.count]) == {Kind.ARROW}
    limit = robot.torque_limits
    for joint in range(7):
        (arrow,) = belonging(buffer, Kind.ARROW, 7 + joint)
        frame = frames[joint + 1]
        centre = frame[:3, 3] + frame[:3, :3] @ robot.offsets[joint]
        assert arrow["pos"] == pytest.approx(centre, abs=1e-6)
        axis = np.sign(TORQUES[joint]) * frame[:3, 2]
        assert arrow["mat"][:, 2] == pytest.approx(axis, abs=1e-6)
        assert arrow["size"][:2] == pytest.approx([0.85 * 0.1] * 2)
        colour = POSITIVE_RGBA if TORQUES[joint] > 0 else NEGATIVE_RGBA
        assert arrow["rgba"] == pytest.approx([*colour[:3], 0.55])
        width = FULL_WIDTH * 0.085 * np.sqrt(abs(TORQUES[joint]) / limit[joint])
        assert width_of(arrow) == pytest.approx(width, rel=1e-5)


def test_arrows_of_a_double_rotate_as_fast_as_those_of_a_robot() -> None:
    world = world_with(goal(torques=TORQUES, show_arrows=True))
    robot = world.scene.robots["lwr"]
    data = world.make_data()
    q = TARGET.copy()
    angles = []
    for k in range(6):
        q[3] += 0.4  # only this joint moves
        world.set_input(data, "goal.joint_angles", q)
        # The joint's frame if it did not rotate; all joints before it are fixed.
        axis_frame = robot.dh.frames(np.where(np.arange(7) == 3, 0.0, q), BASE)[4]
        first = belonging(draw(world, data, time=0.25 * k), Kind.ARROW, 7 + 3)["mat"][0]
        x, y, _ = axis_frame[:3, :3].T @ first[:, 0]
        angles.append(np.arctan2(y, x))
    speed = np.diff(np.unwrap(angles)) / 0.25
    assert speed == pytest.approx(np.full(5, np.sign(TORQUES[3]) * TURNING), abs=1e-3)


def test_arrows_of_a_standard_table_surround_the_axes_before_the_links() -> None:
    robot = SerialRobot(
        name="arm",
        dh_convention="standard",
        dh_params=[[1.2, 0.1, 0.3, 0.4], [-0.7, 0.3, 0, 0.1], [0.4, 0.2, -0.5, 0.2]],
        base_frame=BASE.tolist(),
        torque_limits=[10.0] * 3,
        arrow_radius=0.2,
    )
    q = np.array([0.4, -0.8, 1.1])
    double = Double(name="goal", of="arm", joint_angles=q, torques=[3, -4, 5], show_arrows=True)
    buffer = draw(World(Scene(robots=[robot], doubles=[double], floor=False)))
    frames = robot.dh.frames(q, BASE)
    for joint in range(3):
        (arrow,) = belonging(buffer, Kind.ARROW, 3 + joint)
        centre = frames[joint] @ [0, 0, robot.dh.d[joint], 1]  # the radius of the housing
        assert arrow["pos"] == pytest.approx(centre[:3], abs=1e-6)
        assert abs(arrow["mat"][:, 2] @ frames[joint][:3, 2]) == pytest.approx(1.0, abs=1e-6)
        assert arrow["size"][0] == pytest.approx(0.17)


def test_prismatic_joint_of_a_double_has_a_straight_arrow() -> None:
    robot = SerialRobot(
        name="arm", dh_convention="craig", dh_params=[[0.4, 0.1, 0.2, 0.3]],
        joint_types=["prismatic"], arrow_radius=0.2,
    )  # fmt: skip
    double = Double(name="goal", of="arm", joint_angles=[0.5], torques=[-4], show_arrows=True)
    buffer = draw(World(Scene(robots=[robot], doubles=[double], floor=False)))
    pair = belonging(buffer, Kind.ARROW, 1)
    frame = robot.dh.frames([0.5])[1]
    assert pair["mat"][0][:, 2] == pytest.approx(-frame[:3, 2], abs=1e-6)
    middle = (pair["pos"][0] + tip_of(pair)) / 2
    assert np.linalg.norm(middle - frame[:3, 3]) == pytest.approx(0.17, rel=1e-5)
    assert pair["rgba"] == pytest.approx(np.tile([*NEGATIVE_RGBA[:3], 0.55], (2, 1)))


def test_billboards_of_a_double_name_the_joint_and_are_tinted() -> None:
    rgba = [0.9, 0.1, 0.2, 0.3]
    world = world_with(
        goal(torques=TORQUES, show_billboards=True, rgba=rgba),
        torques=2 * TORQUES,
        show_billboards=True,
    )
    view = view_at(distance=3)
    buffer = draw(world, view=view)
    rows = buffer.rows[: buffer.count]
    names = world.scene.robots["lwr"].names
    for joint in range(14):
        (panel,) = belonging(buffer, Kind.BILLBOARD, joint)
        name, torque = names[joint % 7], TORQUES[joint % 7]
        if joint < 7:
            text, colour = f"{name}  {2 * torque:6.1f} Nm", np.array(PANEL_RGBA)
        else:
            text = f"goal {name}  {torque:6.1f} Nm"
            tinted = 0.7 * np.array(PANEL_RGBA[:3]) + 0.3 * np.array(rgba[:3])
            colour = np.array([*tinted, PANEL_RGBA[3]])
        assert texts_in(view, rows, panel) == [text]
        assert panel["rgba"] == pytest.approx(colour, rel=1e-5)
    # Each leader ends at its joint: the robot's at its pose, the double's at its target.
    robot = world.scene.robots["lwr"]
    leaders = of_kind(rows, GEOM.mjGEOM_TRIANGLE)
    assert len(leaders) == 14
    for joint, row in enumerate(leaders):
        frame = robot.dh.frames(POSE if joint < 7 else TARGET, BASE)[joint % 7 + 1]
        centre = frame[:3, 3] + frame[:3, :3] @ robot.offsets[joint % 7]
        tip = row["pos"] + row["mat"][:, 1] * row["size"][1].astype(float)
        assert view.project(tip)[0] == pytest.approx(view.project(centre)[0], abs=4.0)


def test_double_can_declare_its_own_billboard_lines() -> None:
    lines = [{"value": "joint_angles", "unit": "deg", "scale": 180 / np.pi, "decimals": 0}]
    q = np.deg2rad([10, 20, 30, 40, 50, 60, 70])
    own = goal(joint_angles=q, show_billboards=True, billboard_lines=lines)
    world = world_with(own, billboard_lines=["torques"])
    assert texts_of(world)[:7:6] == ["goal A1     10 deg", "goal A6     70 deg"]
    # Without its own lines it shows those of its robot for which it has values.
    double = goal(torques=TORQUES, show_billboards=True)
    world = world_with(double, billboard_lines=["joint_angles", "torques"])
    assert texts_of(world)[:2] == ["goal A1  pos    -0.400 rad", "         msr    30.0 Nm"]
    world = world_with(double, billboard_lines=["torques", "billboard_values"])
    assert texts_of(world)[:2] == ["goal A1    30.0 Nm", "goal A2   -60.0 Nm"]
    double = goal(torques=TORQUES, commanded_torques=TORQUES + 2, show_billboards=True)
    world = world_with(double, billboard_lines=["torque_error"])
    assert texts_of(world)[:2] == ["goal A1     2.00 Nm", "goal A2     2.00 Nm"]


def test_axes_are_at_the_links_and_flange_of_a_double() -> None:
    world = world_with(goal(show_axes=True), axes_size=0.15, axes_transparency=0.2)
    robot = world.scene.robots["lwr"]
    frames = robot.dh.frames(TARGET, BASE)
    frames = np.concatenate([frames[1:], frames[-1:] @ robot.flange_frame])
    buffer = draw(world)
    names = [*(f"goal/link{i + 1}" for i in range(7)), "goal/flange"]
    assert buffer.count == 3 * len(names)
    for name, frame in zip(names, frames, strict=True):
        bars = belonging(buffer, Kind.AXES, world.frames.names.index(name))
        for axis in range(3):
            assert bars[axis]["pos"] == pytest.approx(frame[:3, 3], abs=1e-6)
            assert bars[axis]["mat"][:, 2] == pytest.approx(frame[:3, axis], abs=1e-6)
            assert bars[axis]["rgba"] == pytest.approx([*AXIS_RGB[axis], 0.4])


EVERYTHING = {"show_arrows": True, "show_billboards": True, "show_axes": True, "torques": TORQUES}


def test_double_without_a_target_is_not_drawn() -> None:
    world = world_with(goal(joint_angles=None, **EVERYTHING))
    data = world.make_data()
    assert draw(world, data).count == 0
    world.set_input(data, "goal.joint_angles", TARGET)
    buffer = draw(world, data)
    assert set(buffer.kinds[: buffer.count]) >= {Kind.ARROW, Kind.BILLBOARD, Kind.AXES}
    world.reset(data)
    assert draw(world, data).count == 0


def test_coincident_links_of_a_double_are_hidden_and_its_decor_is_not() -> None:
    world = world_with(goal(joint_angles=POSE, **EVERYTHING))
    data = world.make_data()
    buffer = draw(world, data)
    assert (data.xpos[world.doubles["goal"].bodies, 2] == -1000).all()
    flange = BASE @ world.scene.robots["lwr"].fwd_kin_base_to_flange(POSE)
    assert world.frame(data, "goal/flange") == pytest.approx(flange, abs=1e-9)
    assert len(belonging(buffer, Kind.BILLBOARD)) == 7
    assert len(belonging(buffer, Kind.AXES)) == 3 * 8
    assert {int(i) for i in buffer.items[: buffer.count][buffer.kinds[: buffer.count] == 1]} == set(
        range(7, 14)
    )
    assert (buffer.rows[: buffer.count]["pos"][:, 2] > -2).all()


def test_links_fade_in_as_they_move_away_from_those_of_the_robot() -> None:
    world = world_with(goal(joint_angles=POSE))
    data = world.make_data()
    model, last = world.model, world.doubles["goal"].bodies[0, -1]  # rotated about its own axis
    for degrees in np.arange(0.25, 4.0, 0.1):
        world.set_input(data, "goal.joint_angles", [*POSE[:6], POSE[6] + np.deg2rad(degrees)])
        buffer = draw(world, data)
        scene = mujoco.MjvScene(model, maxgeom=model.ngeom + CAPACITY)
        everything, camera = mujoco.mjtCatBit.mjCAT_ALL, mujoco.MjvCamera()
        mujoco.mjv_updateScene(model, data, mujoco.MjvOption(), None, camera, everything, scene)
        count = scene.ngeom
        SceneWriter(scene).add(buffer)
        geoms = [geom for geom in scene.geoms[:count] if geom.objid >= 0]
        opacity = {geom.objid: geom.rgba[3] for geom in geoms if geom.pos[2] > -2}
        of_link = [opacity[i] for i in opacity if model.geom_bodyid[i] == last]
        expected = COMMANDED_RGBA[3] * np.clip((degrees - 0.5) / 2.0, 0, 1)
        assert max(of_link, default=0.0) == pytest.approx(expected, abs=1e-6)
        assert all(
            opacity[i] == pytest.approx(model.geom_rgba[i, 3])
            for i in opacity
            if model.geom_group[i] != DOUBLE_GROUP
        )


def test_double_that_is_switched_off_disappears_with_its_decor() -> None:
    path = Double(name="drive", of="lwr", path=[POSE, TARGET, TARGET + 0.3], path_length=3)
    world = world_with(goal(**EVERYTHING), path)
    toggles = toggles_of(world)
    model = world.model

    bodies = [model.body(int(body)).name for body in model.geom_bodyid]

    def geoms_of(name: str) -> list[bool]:
        return [body.startswith(f"double-{name}-") for body in bodies]

    assert draw(world, toggles=toggles).hidden is None
    toggles.doubles[:] = (False, True)
    toggles.details[9] = toggles.axes[:] = toggles.frame_names[:] = True
    buffer = draw(world, toggles=toggles)
    assert buffer.hidden is not None
    assert buffer.hidden.tolist() == geoms_of("goal")
    assert sum(geoms_of("goal")) == 24
    assert not any("goal" in text for text in labels(buffer.rows[: buffer.count]))
    # The robot's axes with their names.
    assert set(buffer.kinds[: buffer.count]) == {Kind.NONE, Kind.AXES, Kind.NAME}
    toggles.doubles[:] = (True, False)
    buffer = draw(world, toggles=toggles)
    assert buffer.hidden is not None
    assert buffer.hidden.tolist() == geoms_of("drive")
    assert len(belonging(buffer, Kind.BILLBOARD)) == 7
    toggles.doubles[:] = False
    buffer = draw(world, toggles=toggles)
    assert buffer.hidden is not None
    assert buffer.hidden.tolist() == (model.geom_group == DOUBLE_GROUP).tolist()


def test_packet_and_scene_switch_a_double() -> None:
    world = world_with(goal(visible=False, **EVERYTHING))
    data, toggles = world.make_data(), toggles_of(world)
    for on in (False, True):  # first as declared
        buffer = draw(world, data, toggles=toggles)
        assert ((buffer.count > 0), (buffer.hidden is None)) == (on, on)
        world.set_input(data, "goal.visible", 1.0)


@pytest.mark.parametrize("elbow", [-4.0, 9.0])
def test_singularity_arrows_of_a_double_equal_those_of_a_robot_in_its_pose(elbow: float) -> None:
    q = np.deg2rad([20, 40, 10, elbow, 30, 60, 0])
    fields = {"show_arrows": True, "arrow_quantity": "singularity"}
    far = np.deg2rad([0, 40, 0, -90, 0, 60, 0])
    double = world_with(goal(joint_angles=q, **fields), joint_angles=far)
    alone = world_with(joint_angles=q, **fields)
    theirs, own = draw(double), draw(alone)
    shown = 0
    for joint in range(7):
        at_double = belonging(theirs, Kind.ARROW, 7 + joint)
        at_robot = belonging(own, Kind.ARROW, joint)
        assert len(at_double) == len(at_robot)
        if len(at_robot):
            shown += 1
            ratio = at_double["size"][0, 2] / at_robot["size"][0, 2]
            assert ratio == pytest.approx(0.85, rel=1e-4)
            assert at_double["rgba"][:, :3] == pytest.approx(at_robot["rgba"][:, :3])
            middle = [rows["pos"].mean(axis=0) for rows in (at_double, at_robot)]
            assert np.linalg.norm(middle[0] - middle[1]) < 0.02
    assert shown >= 2
    assert not len(belonging(theirs, Kind.ARROW, 3))  # the robot is far from the singularity


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_jacobian_of_a_double_equals_that_of_its_table_at_the_target(convention: str) -> None:
    rng = np.random.default_rng(3)
    table = rng.uniform(-0.8, 0.8, (4, 4))
    robot = SerialRobot(
        name="arm", dh_convention=convention, dh_params=table, base_frame=BASE.tolist(),
        joint_types=["revolute", "revolute", "prismatic", "revolute"],
        flange_frame={"xyz": [0.1, 0.2, 0.3]},
        offsets_to_center_of_joints=rng.uniform(-0.3, 0.3, (4, 3)),
    )  # fmt: skip
    q = np.array([0.4, -0.8, 0.3, 1.1])
    double = Double(name="goal", of="arm", joint_angles=q)
    world = World(Scene(robots=[robot], doubles=[double], floor=False))
    data = world.make_data()
    Placer(world).place(data)
    for name, angles in (("goal", q), ("arm", np.zeros(4))):
        expected = robot.dh.jacobian(angles, BASE, robot.flange_frame)
        expected[:3] /= np.abs(table[:, [1, 3]]).sum()
        assert jacobian(world, data, world.owners[name]) == pytest.approx(expected, abs=1e-9)


def test_double_shows_its_own_arrow_quantity_or_that_of_its_robot() -> None:
    for own, expected in ((None, 1), ("torques", 0)):
        world = world_with(goal(arrow_quantity=own), arrow_quantity="torque_error")
        assert toggles_of(world).arrow_quantity[7:].tolist() == [expected] * 7


def test_everything_on_51_joints_and_their_doubles_fits_the_buffer() -> None:
    rng = np.random.default_rng(1)
    table = SerialRobot.from_model("lwr").dh_params
    robots, doubles = [], []
    for i, n in enumerate(JUSTIN):
        q = rng.uniform(-1, 1, n)
        robots.append(
            SerialRobot(
                name=f"robot{i}", dh_convention="craig", dh_params=np.resize(table, (n, 4)),
                base_frame={"xyz": [0.0, 0.6 * i, 0.0]}, torque_limits=np.full(n, 40.0),
                joint_angles=q, torques=rng.uniform(5, 30, n),
                show_arrows=True, show_billboards=True, show_axes=True,
            )
        )  # fmt: skip
        doubles.append(Double(name=f"double{i}", of=f"robot{i}", joint_angles=q + 0.5))
    world = World(Scene(robots=robots, doubles=doubles))
    toggles = toggles_of(world)
    toggles.legend = True
    view = view_at(azimuth=0.0, distance=12, width=3840, height=2160)
    buffer = draw(world, toggles=toggles, view=view)
    assert buffer.dropped == 0
    assert len(set(buffer.items[: buffer.count][buffer.kinds[: buffer.count] == Kind.ARROW])) == 51
    assert len(belonging(buffer, Kind.BILLBOARD)) == 51
    assert len(belonging(buffer, Kind.AXES)) == 3 * (51 + 2 * 7)
    assert len(labels(buffer.rows[: buffer.count])) == 51 + 3
