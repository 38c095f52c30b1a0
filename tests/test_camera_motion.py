"""Camera motion: keyframe paths, turntables, and following."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from conftest import problems_in, raises_with

from sero_mj.base.errors import DeclarationError, UnknownName, UsageError
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Camera, Scene, View
from sero_mj.viewer.image.camera import TIME_CONSTANT, Follower, Navigator, followed, roots
from sero_mj.viewer.image.camera_motion import (
    CameraKey,
    CameraPath,
    monotone_cubic,
    orbit,
    read_camera_path,
)
from sero_mj.viewer.image.image_options import VideoOptions
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.image.video_frames import video_frames

TIMES = np.array([0.0, 1.0, 1.5, 4.0, 5.0])
VALUES = np.array([[0.0, 3.0], [2.0, 3.0], [2.5, -1.0], [2.6, 4.0], [2.6, 5.0]])


def test_curves_pass_through_their_keys_and_stay_between_them() -> None:
    for time, value in zip(TIMES, VALUES, strict=True):
        assert monotone_cubic(TIMES, VALUES, time) == pytest.approx(value)
    fine = np.linspace(-1.0, 6.0, 7001)
    found = np.array([monotone_cubic(TIMES, VALUES, at) for at in fine])
    for i in range(len(TIMES) - 1):
        between = found[(fine >= TIMES[i]) & (fine <= TIMES[i + 1])]
        low, high = np.minimum(VALUES[i], VALUES[i + 1]), np.maximum(VALUES[i], VALUES[i + 1])
        assert (between >= low - 1e-12).all()
        assert (between <= high + 1e-12).all()
    speed = np.diff(found, axis=0) / np.diff(fine)[:, None]
    assert np.abs(np.diff(speed, axis=0)).max() < 0.1  # its slope has no steps
    assert speed[0] == pytest.approx(0.0)
    assert speed[-1] == pytest.approx(0.0)


def test_inner_slopes_equal_those_of_scipy() -> None:
    interpolate = pytest.importorskip("scipy.interpolate", reason="dm-control is not installed")
    theirs = interpolate.PchipInterpolator(TIMES, VALUES)
    for at in np.linspace(1.0, 4.0, 50):  # from the second key to the second-last one
        assert monotone_cubic(TIMES, VALUES, at) == pytest.approx(theirs(at), abs=1e-12)


def camera_at(path: CameraPath, time: float) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation, camera.lookat = 2.0, -14.0, (0.0, 0.0, 0.5)
    path(camera, time)
    return camera


def test_path_rotates_the_shorter_way_and_leaves_undeclared_values() -> None:
    keys = [(0.0, 170.0), (1.0, -170.0), (2.0, 90.0)]
    path = CameraPath([CameraKey(time=time, azimuth_deg=azimuth) for time, azimuth in keys])
    angles = [camera_at(path, time).azimuth for time in np.linspace(0, 2, 41)]
    assert np.ptp(angles) == pytest.approx(100.0)
    assert max(angles) == pytest.approx(190.0)
    assert angles[-1] == pytest.approx(90.0)
    camera = camera_at(path, 0.7)
    assert (camera.distance, camera.elevation) == (2.0, -14.0)
    assert camera.lookat == pytest.approx([0, 0, 0.5])


def test_values_omitted_in_a_key_are_interpolated_from_its_neighbors(tmp_path) -> None:
    file = tmp_path / "path.toml"
    file.write_text(
        "[[keys]]\ntime = 0\ndistance = 2\nlook_at = [0, 0, 0]\n"
        "[[keys]]\ntime = 1\nelevation_deg = -30\n"
        "[[keys]]\ntime = 2\ndistance = 4\nlook_at = [1, 0, 2]\n"
    )
    path = read_camera_path(file)
    assert path.has_look_at
    middle = camera_at(path, 1.0)
    assert middle.distance == pytest.approx(3.0)
    assert middle.lookat == pytest.approx([0.5, 0, 1])
    assert middle.elevation == -30


@pytest.mark.parametrize(
    ("text", "line", "key", "expected"),
    [
        ("[[key]]\ntime = 0\n", 1, "key", "unknown section; did you mean 'keys'?"),
        ("", None, "keys", "is required; expected tables [[keys]]"),
        ("[[keys]]\ntime = 0\nazimut_deg = 3\n", 3, "keys.0.azimut_deg", "'azimuth_deg'?"),
        ("[[keys]]\ndistance = 3\n", 1, "keys.0.time", "is required"),
        ("[[keys]]\ntime = 0\ndistance = -3\n", 3, "keys.0.distance", "found -3"),
        ("[[keys]]\ntime = 0\nlook_at = [1, 2]\n", 3, "keys.0.look_at", "3 numbers"),
        ("[[keys]]\ntime = 2\n\n[[keys]]\ntime = 1\n", 5, "keys.1.time", "found 1; expected more"),
    ],
)
def test_errors_in_a_camera_path_name_file_line_and_key(
    tmp_path, text, line, key, expected
) -> None:
    file = tmp_path / "path.toml"
    file.write_text(text)
    with pytest.raises(DeclarationError) as caught:
        read_camera_path(file)
    (problem,) = caught.value.problems
    assert (problem.file, problem.line, problem.key) == (str(file), line, key)
    assert expected in problem.message


def test_turntable_rotates_uniformly_and_ends_where_it_started() -> None:
    camera = mujoco.MjvCamera()
    camera.azimuth = 150.0
    move = orbit(camera, -360.0, 5.0)
    angles = []
    for k in range(25):
        move(camera, k / 5)
        angles.append(camera.azimuth)
    assert np.diff(angles) == pytest.approx(np.full(24, -14.4))
    assert angles[-1] - 14.4 == pytest.approx(150.0 - 360.0)  # same as the first frame


@pytest.fixture(scope="module")
def justin() -> World:
    return World(load_scene("justin"))


def drive(world: World, data: mujoco.MjData, x: float, time: float) -> None:
    T = np.eye(4)
    T[0, 3] = x
    world.set_input(data, "justin.base_frame", T)
    data.time = time
    mujoco.mj_kinematics(world.model, data)


def test_camera_follows_the_root_robot_of_a_group(justin: World) -> None:
    assert roots(justin, "justin") == ["justin_torso"]
    assert roots(justin, "justin_left_arm") == ["justin_left_arm"]
    assert roots(justin, "justin_torso/base") == []


def test_following_lags_by_its_time_constant_and_is_smooth(justin: World) -> None:
    data, speed, dt = justin.make_data(), 0.5, 1 / 30
    follower, noise = Follower(justin, "justin", data), np.random.default_rng(3)
    places, goals = [], []
    at = np.zeros(3)
    for k in range(300):
        goal = speed * k * dt + 0.002 * noise.standard_normal()
        drive(justin, data, goal, k * dt)
        at = at + follower.displacement(data)
        places.append(at[0])
        goals.append(goal)
    late = np.array(goals) - np.array(places)
    assert late[100:].mean() == pytest.approx(speed * TIME_CONSTANT, rel=0.1)
    jitter = np.std(np.diff(goals, 2)[100:]), np.std(np.diff(places, 2)[100:])
    assert jitter[1] < 0.15 * jitter[0]
    assert (np.diff(places[20:]) > 0).all()  # never moves back


def test_camera_follows_a_jump_in_time_at_once(justin: World) -> None:
    data = justin.make_data()
    drive(justin, data, 0.0, 0.0)
    follower = Follower(justin, "justin", data)
    # The first frame, a jump forward, and one back.
    for x, time in ((3.0, 0.0), (1.0, 20.0), (2.0, 5.0)):
        before = data.xpos[justin.robots["justin_torso"].bodies[0], 0]
        drive(justin, data, x, time)
        assert follower.displacement(data)[0] == pytest.approx(x - before)


@pytest.mark.thorough
def test_window_follows_the_robot_declared_in_the_view(justin: World) -> None:
    navigator, data = Navigator(justin), justin.make_data()
    assert navigator.following == "justin"
    start = navigator.camera.lookat.copy()
    drive(justin, data, 4.0, 0.0)
    navigator.advance(data)  # the camera is there when the window opens
    assert navigator.camera.lookat == pytest.approx(start + np.array([4.0, 0, 0]))
    assert navigator.follow(data, None) == "follows nothing"
    navigator.choose(0)
    assert navigator.following == "justin"


@pytest.mark.gl
def test_rendered_images_follow_unless_a_path_sets_the_position(justin: World, tmp_path) -> None:
    data, file = justin.make_data(), tmp_path / "path.toml"
    file.write_text("[[keys]]\ntime = 0\nlook_at = [0, 0, 1]\n")
    with HeadlessRenderer(justin, 32, 24, quality="draft") as renderer:
        start = renderer.camera.lookat.copy()
        drive(justin, data, 4.0, 0.0)
        renderer.render(data)
        assert renderer.camera.lookat == pytest.approx(start + np.array([4.0, 0, 0]))
        with pytest.raises(UsageError, match=r"look_at .* --follow justin"):
            video_frames(None, renderer, 1, 1.0, VideoOptions(camera_path=file, follow="justin"))
        video_frames(None, renderer, 1, 1.0, VideoOptions(camera_path=file))
        drive(justin, data, 8.0, 0.1)
        renderer.render(data)
        assert renderer.camera.lookat[0] == pytest.approx(4.0 + start[0])
        with pytest.raises(UsageError, match="--orbit and --camera-path both move the camera"):
            video_frames(None, renderer, 1, 1.0, VideoOptions(camera_path=file, orbit=90))


@pytest.mark.gl
def test_orbit_is_rejected_for_a_fixed_camera() -> None:
    cameras = {"front": Camera(position=[2.0, 0.0, 1.0])}
    world = World(Scene(robots=[SerialRobot.from_model("lwr")], cameras=cameras))
    told = "--orbit cannot move camera 'front'; expected the free camera"
    with (
        HeadlessRenderer(world, 32, 24, "front", "draft") as renderer,
        pytest.raises(UsageError, match=told),
    ):
        video_frames(None, renderer, 1, 1.0, VideoOptions(orbit=90))


def test_fixed_camera_follows_nothing() -> None:
    cameras = {"front": Camera(position=[2.0, 0.0, 1.0])}
    robot = SerialRobot.from_model("lwr")
    world = World(Scene(robots=[robot], cameras=cameras, view=View(follow="lwr/flange")))
    navigator = Navigator(world, "front")
    assert navigator.following is None
    with pytest.raises(
        UsageError, match=r"follow requires .* camera 'front' of the scene .* 'lwr'$"
    ):
        followed(world, navigator.camera, "lwr")


def test_unknown_follow_target_is_reported_with_a_suggestion(tmp_path) -> None:
    world = World(Scene(robots=[SerialRobot.from_model("lwr")]))
    kind = "robot, group or frame"
    with raises_with(UnknownName, kind=kind, name="lwr/flang", near="lwr/flange"):
        Follower(world, "lwr/flang", world.make_data())
    file = tmp_path / "scene.toml"
    text = '[robots.lwr]\nmodel = "lwr"\n[view]\nfollow = "lwe"\n'
    file.write_text(text)
    told = "no robot, group or frame 'lwe'; did you mean 'lwr'?"
    assert problems_in(file) == [f"4: view.follow: {told}"]
    file.write_text(
        f'{text.replace("lwe", "lwr")}camera = "a"\n[cameras.a]\nposition = [1, 1, 1]\n'
    )
    (problem,) = problems_in(file)
    assert problem.startswith("4: view.follow: ") and "view.camera" in problem


def test_view_angles_survive_setting_another_attribute() -> None:
    view = View(azimuth_deg=205.0, elevation_deg=-3.0)
    view.look = "dark"
    assert (view.azimuth_deg, view.elevation_deg, view.look) == (205.0, -3.0, "dark")
