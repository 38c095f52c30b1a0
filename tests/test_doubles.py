"""Transparent doubles: target poses, hiding coincident links, and paths."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
from decor_tools import toggles_of, view_at
from polling import until

from sero_mj.base.errors import DeclarationError
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.place import Placer
from sero_mj.data.send.motion import LEAD
from sero_mj.data.send.play import MotionPackets
from sero_mj.load import load_scene
from sero_mj.robots.assemble.link_geometry import generated
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.double import COMMANDED_RGBA, DOUBLE_GROUP, Double
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.image.camera import bounding_sphere
from sero_mj.viewer.image.picking import pick

POSE = np.array([0.3, -0.7, 0.4, 1.2, -0.5, 0.8, 0.2])
TARGET = np.array([-0.4, 0.9, 0.1, -1.1, 0.6, 0.5, -0.3])
BASE = {"xyz": [0.2, -0.3, 0.4], "rpy": [0.1, -0.2, 1.0]}


def world_with(*doubles: Double, **fields) -> World:
    fields = {"joint_angles": POSE, "base_frame": BASE, **fields}
    robot = SerialRobot.from_model("lwr", **fields)
    return World(Scene(robots=[robot], doubles=list(doubles), floor=False))


def posed(world: World) -> mujoco.MjData:
    data = world.make_data()
    Placer(world).place(data)
    return data


def test_double_is_at_its_target_on_the_base_of_its_robot() -> None:
    world = world_with(Double(name="target", of="lwr", joint_angles=TARGET))
    data = posed(world)
    robot = world.robots["lwr"].robot
    expected = robot.dh.frames(TARGET, robot.base_frame)
    (bodies,) = world.doubles["target"].bodies
    # The base coincides with the robot's, so it is hidden. The links are elsewhere.
    np.testing.assert_allclose(data.xpos[bodies[1:]], expected[1:, :3, 3], atol=1e-12)
    turned = data.xmat[bodies[1:]].reshape(-1, 3, 3)
    np.testing.assert_allclose(turned, expected[1:, :3, :3], atol=1e-12)
    assert data.xpos[bodies[0], 2] == -1000
    # The robot itself did not move.
    actual = robot.dh.frames(POSE, robot.base_frame)
    np.testing.assert_allclose(data.xpos[world.robots["lwr"].bodies], actual[:, :3, 3], atol=1e-12)


def test_only_links_that_coincide_with_the_robot_are_hidden() -> None:
    near = POSE.copy()
    near[4] += 0.3  # the first four links coincide with the robot's
    world = world_with(Double(name="target", of="lwr", joint_angles=near))
    heights = posed(world).xpos[world.doubles["target"].bodies[0], 2]
    assert (heights[:5] == -1000).all()
    assert (heights[5:] > -1).all()


def test_double_without_a_target_is_out_of_view() -> None:
    world = world_with(Double(name="target", of="lwr"))
    assert (posed(world).xpos[world.doubles["target"].bodies, 2] == -1000).all()
    data = world.make_data()
    world.set_input(data, "target.joint_angles", TARGET)
    Placer(world).place(data)
    assert (data.xpos[world.doubles["target"].bodies[0, 1:], 2] > -1).all()
    world.reset(data)
    assert (data.mocap_pos[world.doubles["target"].mocap, 2] == -1000).all()


def test_double_is_transparent_without_contacts_and_keeps_the_scale() -> None:
    plain = world_with()
    world = world_with(Double(name="target", of="lwr"))
    model = world.model
    of_double = model.geom_group == DOUBLE_GROUP
    assert of_double.sum() == 24
    np.testing.assert_allclose(
        model.geom_rgba[of_double], np.tile(COMMANDED_RGBA, (24, 1)), rtol=1e-6
    )
    assert not model.geom_contype[of_double].any()
    assert not model.geom_conaffinity[of_double].any()
    assert model.nq == plain.model.nq == 7
    # A double out of view must not make MuJoCo treat the scene as a kilometer large.
    assert model.stat.extent == pytest.approx(plain.model.stat.extent, rel=0.1)
    assert bounding_sphere(world)[1] == pytest.approx(bounding_sphere(plain)[1])


def test_double_is_slightly_smaller_than_its_robot() -> None:
    world = world_with(Double(name="target", of="lwr"))
    model = world.model
    volumes = {}
    for group in (1, DOUBLE_GROUP):
        meshes = model.geom_dataid[model.geom_group == group]
        volumes[group] = np.sort(model.geom_rbound[model.geom_group == group])
        assert len(meshes) == 24
    np.testing.assert_allclose(volumes[DOUBLE_GROUP], 0.985 * volumes[1], rtol=1e-4)


def test_robot_without_meshes_can_have_doubles() -> None:
    robot = SerialRobot(
        name="arm",
        dh_convention="standard",
        dh_params=[[1.57, 0, 0, 0.4], [0, 0.3, 0, 0.1]],
        joint_types=["prismatic", "revolute"],
    )
    double = Double(name="target", of="arm", joint_angles=[0.2, 0.5])
    world = World(Scene(robots=[robot], doubles=[double]))
    data = posed(world)
    expected = robot.dh.frames([0.2, 0.5])
    bodies = world.doubles["target"].bodies[0]
    np.testing.assert_allclose(data.xpos[bodies[1:]], expected[1:, :3, 3], atol=1e-12)
    shapes = sum(map(len, generated(robot)))  # without geoms that are only drawn on them
    assert (world.model.geom_group == DOUBLE_GROUP).sum() == shapes


def test_path_is_a_row_of_doubles_fading_towards_its_start() -> None:
    path = np.array([POSE, TARGET, TARGET + 0.5])
    double = Double(name="drive", of="lwr", path=path, path_length=5)
    poses = double.poses()
    np.testing.assert_allclose(poses[[0, -1]], path[[0, -1]])
    # Evenly in joint space.
    lengths = np.linalg.norm(np.diff(poses, axis=0), axis=1)
    assert lengths.max() < 1.5 * lengths.min()
    world = world_with(double)
    data = posed(world)
    part = world.doubles["drive"]
    assert part.bodies.shape == (5, 8)
    robot = part.robot
    expected = robot.dh.frames(poses, robot.base_frame)
    np.testing.assert_allclose(data.xpos[part.bodies[2, 1:]], expected[2, 1:, :3, 3], atol=1e-12)
    assert (data.xpos[part.bodies[0], 2] == -1000).all()  # it begins at the robot's pose
    opacity = [
        world.model.geom_rgba[world.model.geom_bodyid == row[3]][0, 3] for row in part.bodies
    ]
    assert (np.diff(opacity) > 0).all()
    assert opacity[-1] < COMMANDED_RGBA[3]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ('[doubles.d]\nof = "lrw"', "s.toml:4: doubles.d.of: no robot 'lrw'; did you mean 'lwr'?"),
        (
            '[doubles.lwr]\nof = "lwr"',
            "s.toml:3: doubles.lwr: a robot already has this name; expected a different name",
        ),
        (
            '[doubles.d]\nof = "lwr"\njoint_angles = [1, 2]',
            "s.toml:5: doubles.d.joint_angles: found values of 2 joints, but lwr has 7",
        ),
        (
            '[doubles.d]\nof = "lwr"\npath = [[1, 2], [1, 2]]',
            "s.toml:5: doubles.d.path: found values of 2 joints, but lwr has 7",
        ),
        (
            '[doubles.d]\nof = "lwr"\nrgb = [1]',
            "s.toml:5: doubles.d.rgb: unknown key; did you mean 'rgba'?",
        ),
        (
            '[doubles.d]\nof = "lwr"\n[sources.u]\nkind = "udp"\nport = 1\nstructure = "7F"\n'
            '[routes]\n"d.torqes" = "u.values0"',
            "s.toml:10: routes.d.torqes: no input 'torqes' of d; did you mean 'torques'?",
        ),
        (
            '[doubles.d]\nof = "lwr"\n[sources.u]\nkind = "udp"\nport = 1\nstructure = "6F"\n'
            '[routes]\n"d.joint_angles" = "u.values0"',
            "s.toml:10: routes.d.joint_angles: u.values0 has 6 values, but "
            "d.joint_angles takes 7, one per joint",
        ),
    ],
)  # fmt: skip
def test_invalid_doubles_are_rejected(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "s.toml"
    file.write_text(f'[robots.lwr]\nmodel = "lwr"\n{text}\n')
    with pytest.raises(DeclarationError) as caught:
        load_scene(file)
    assert str(caught.value).replace(f"{tmp_path}/", "") == problem


def test_packets_move_robot_and_double(tmp_path: Path) -> None:
    import socket

    scene = load_scene("lwr_double")
    scene.sources["udp"] = {**scene.sources["udp"], "port": 0}
    packets = MotionPackets(scene)
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.sendto(packets.at(1.0), ("127.0.0.1", mirror.sources["udp"].port))  # type: ignore[attr-defined]
        assert until(mirror.advance)
        robot = scene.robots["lwr"]
        sent = np.frombuffer(packets.at(1.0)).reshape(2, 7)
        ahead = np.frombuffer(packets.at(1.0 + LEAD)).reshape(2, 7)
        np.testing.assert_allclose(sent[1], ahead[0])  # the command leads the robot
        for name, bodies in (
            ("lwr", mirror.world.robots["lwr"].bodies),
            ("commanded", mirror.world.doubles["commanded"].bodies[0]),
        ):
            q = sent[0] if name == "lwr" else sent[1]
            expected = robot.dh.frames(q, robot.base_frame)[1:, :3, 3]
            np.testing.assert_allclose(mirror.data.xpos[bodies[1:]], expected, atol=1e-12)


def robot_joint(name: str) -> str:
    """Returns the name of the joint that moves a link, for example of `target/link4`."""
    return ["A1", "A2", "E1", "A3", "A4", "A5", "A6"][int(name[-1]) - 1]


def test_picking_a_double_returns_its_name() -> None:
    world = world_with(Double(name="target", of="lwr", joint_angles=TARGET), base_frame={})
    data, view = posed(world), view_at()
    toggles = toggles_of(world)
    buffer = Decor(world).draw(data, toggles, view)
    (bodies,) = world.doubles["target"].bodies
    geom = int((world.model.geom_bodyid == bodies[4]).nonzero()[0][0])
    (x, y), _ = view.project(data.geom_xpos[geom])
    found = pick(world, data, buffer, view, (float(x), float(y)))
    assert found is not None
    assert (found.kind, found.owner) == ("double", "target")
    assert world.joints.names[found.index - 7] == robot_joint(found.name)
    assert found.name.startswith("target/link")


@pytest.mark.parametrize("convention", ["craig", "standard"])
def test_rod_is_long_enough_for_its_stroke(convention: str) -> None:
    """Extended to its limit, the rod of a prismatic joint still reaches back to its housing."""
    robot = SerialRobot(
        name="slide",
        dh_convention=convention,
        dh_params=[[0.3, 0.1, 0.2, 0.2]],
        joint_types=["prismatic"],
        position_limits=[[0.0, 0.5]],
        joint_angles=[0.5],
    )
    world = World(Scene(robots=[robot], floor=False))
    data = world.make_data()
    frames = robot.dh.frames([0.5])
    axis, point = robot.dh.joint_axes(robot.dh.frames([0.0]))
    start = point[0] - (0.2 * axis[0] if convention == "craig" else 0.0)  # the origin of d
    capsules = (world.model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).nonzero()[0]
    ends = []
    for geom in capsules:
        half = data.geom_xmat[geom].reshape(3, 3)[:, 2] * world.model.geom_size[geom, 1]
        ends += [data.geom_xpos[geom] - half, data.geom_xpos[geom] + half]
    # Or its rounded end does, if that would be below the base.
    radius = world.model.geom_size[capsules, 0].max()
    assert np.linalg.norm(np.array(ends) - start, axis=1).min() < radius + 1e-6
    assert frames.shape == (2, 4, 4)
