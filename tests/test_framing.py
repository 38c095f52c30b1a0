"""Camera positions that show robots in all their poses and in images of every shape."""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from conftest import sampled

from sero_mj.base import paths
from sero_mj.base.frames import frame
from sero_mj.data.drive.place import Placer
from sero_mj.load import load_scene
from sero_mj.robots.assemble.solids import geom_boxes, geom_corners
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.image.camera import Navigator, find_camera
from sero_mj.viewer.image.framing import Framing, stand_back
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.image.sampling import recorded_poses
from sero_mj.viewer.player import capture as capture_file

SIZES = [(390, 844), (1280, 800), (360, 270)]


def shipped() -> list[str]:
    return [*paths.list_scenes(), *paths.list_scenarios()]


def corners_in_picture(
    world: World, camera: mujoco.MjvCamera, data: mujoco.MjData, size, needed: float
) -> bool:
    """Returns whether the corners of all bounding boxes of robots are in the image."""
    scene = mujoco.MjvScene(world.model, maxgeom=0)
    mujoco.mjv_updateCamera(world.model, data, camera, scene)
    stand_back(scene, camera, *size, needed)
    view = ImageView.of_scene(scene, *size)
    points = geom_corners(world.model, data, world.geoms_in_view())
    return bool(view.sees(*view.project(points.reshape(-1, 3))).all())


def driven(world: World, x: float, y: float) -> mujoco.MjData:
    data, T = world.make_data(), np.eye(4)
    T[:2, 3] = x, y
    world.set_input(data, "justin.base_frame", T)
    mujoco.mj_kinematics(world.model, data)
    return data


@pytest.fixture(scope="module")
def justin() -> World:
    scene = load_scene("justin")
    scene.view.follow = None
    return World(scene)


@pytest.mark.gl
@pytest.mark.parametrize("name", sampled(sorted(shipped(), key="hit_hand_grasp".__ne__), 1))
def test_no_robot_touches_the_border_of_an_image(name: str) -> None:
    world = World(load_scene(name))
    data = world.make_data()
    Placer(world).place(data)
    owners = {*world.robots, *world.doubles}
    for size in SIZES:
        with HeadlessRenderer(world, *size, quality="draft") as renderer:
            parts, names = renderer.segmentation(data), renderer.part_names
        is_robot = np.array([each.partition("/")[0] in owners for each in names])[parts]
        assert is_robot.any()
        for border in (is_robot[0], is_robot[-1], is_robot[:, 0], is_robot[:, -1]):
            assert not border.any(), f"{name} at {size}"


@pytest.mark.parametrize("size", SIZES)
def test_view_contains_all_known_poses(justin: World, size) -> None:
    poses = [driven(justin, x, y) for x, y in ((0.8, 0.4), (-0.8, 0.4), (0.0, -1.5))]
    camera = find_camera(justin)
    framing = Framing(justin, camera)
    before = camera.distance
    assert not all(corners_in_picture(justin, camera, p, SIZES[1], framing.needed) for p in poses)
    framing.hold(camera, poses, size)
    assert camera.distance >= before
    assert (camera.azimuth, camera.elevation) == (205.0, -10.0)
    assert all(corners_in_picture(justin, camera, p, size, framing.needed) for p in poses)


def test_view_contains_a_robot_throughout_a_turntable(justin: World) -> None:
    poses = [driven(justin, 1.2, 0.0)]
    camera = find_camera(justin)
    framing = Framing(justin, camera)
    turns = np.linspace(0, 360, 25).tolist()
    framing.hold(camera, poses, SIZES[2], turns)
    for turn in turns:
        camera.azimuth = 205.0 + turn
        assert corners_in_picture(justin, camera, poses[0], SIZES[2], framing.needed)


def test_view_is_unchanged_if_it_shows_all_poses_or_was_set_by_the_user(justin: World) -> None:
    for wanted, poses in ((None, [driven(justin, 0.01, 0.0)]), ("0,-10,3", [driven(justin, 5, 0)])):
        camera = find_camera(justin, wanted)
        before = camera.distance, *camera.lookat, camera.azimuth
        Framing(justin, camera, wanted).hold(camera, poses, SIZES[1])
        assert (camera.distance, *camera.lookat, camera.azimuth) == before


def test_page_view_contains_all_poses_it_plays(justin: World, monkeypatch) -> None:
    pose = driven(justin, 1.5, -0.5)
    monkeypatch.setattr(capture_file, "known_poses", lambda *times: [pose])
    scene = load_scene("justin")
    scene.routes = {}  # moved by hand, so it is not live
    scene.view.follow = None  # otherwise the camera would follow
    page = capture_file.capture(scene, seconds=0.1, fps=10.0)
    assert page.camera.distance > scene.view.distance
    for size in SIZES:
        assert corners_in_picture(justin, page.camera, pose, size, page.needed)
    assert capture_file.eye(page)["aspect"] == pytest.approx(page.needed, abs=1e-4)


def test_initial_window_view_contains_all_poses_of_a_recording(justin: World) -> None:
    navigator, pose = Navigator(justin), driven(justin, 1.5, 0.0)
    navigator.hold(iter([]), SIZES[1])  # as for live sources
    declared = navigator.camera.distance
    assert declared == pytest.approx(2.9)
    navigator.hold(iter([pose]), SIZES[1])
    held = navigator.camera.distance
    assert held > declared
    assert corners_in_picture(justin, navigator.camera, pose, SIZES[0], navigator.needed)
    navigator.zoom(5)
    navigator.choose(0)
    assert navigator.camera.distance == held


@pytest.mark.parametrize(
    ("is_live", "end", "step", "count"),
    [(False, 9.0, None, 64), (True, 9.0, None, 0), (False, 9.0, 0.001, 0), (False, 999.0, None, 0),
     (False, None, None, 0)],
)  # fmt: skip
def test_short_recordings_are_read_before_they_are_shown(is_live, end, step, count) -> None:
    times: list[float] = []
    source = SimpleNamespace(end=end, step=step)
    mirror = SimpleNamespace(is_live=is_live, sources={"a": source}, advance=times.append, data=0)
    assert len(list(recorded_poses(mirror))) == count
    assert times == sorted(times, reverse=True)
    assert not times or (times[0], times[-1]) == (end, 0.0)


def test_deliberately_close_view_stays_close() -> None:
    scene = load_scene("lwr")
    # The hand of the robot.
    scene.view.look_at, scene.view.distance = np.array([0.0, 0.0, 1.1]), 0.3
    world = World(scene)
    camera = find_camera(world)
    Framing(world, camera).hold(camera, [world.make_data()], SIZES[1])
    assert camera.distance == pytest.approx(0.3)


def test_bounding_boxes_of_geoms_contain_their_rotated_boxes(justin: World) -> None:
    data = driven(justin, 0.3, 0.1)
    corners = geom_corners(justin.model, data)
    lows, highs = geom_boxes(justin.model, data)
    assert corners.min(axis=1) == pytest.approx(lows, abs=1e-12)
    assert corners.max(axis=1) == pytest.approx(highs, abs=1e-12)


def test_robot_far_from_its_declared_base_is_in_the_image() -> None:
    world = World(Scene(robots=[SerialRobot.from_model("lwr")]))
    data, camera = world.make_data(), find_camera(world)
    framing, distance = Framing(world, camera), camera.distance
    world.set_input(data, "lwr.base_frame", frame(position=[40.0, -30.0, 0.0]))
    mujoco.mj_forward(world.model, data)
    framing.fit(camera, data)
    assert np.linalg.norm(camera.lookat[:2] - [40.0, -30.0]) < 0.5
    assert camera.distance < 2 * distance
    placed = camera.lookat.copy()
    world.set_input(data, "lwr.base_frame", frame(position=[41.0, -30.0, 0.0]))
    framing.fit(camera, data)  # the camera does not follow
    assert (camera.lookat == placed).all()
