"""The window's camera: orbit, pan, zoom, follow."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from sero_mj import Scene, SerialRobot, View, World
from sero_mj.base.errors import UnknownName
from sero_mj.robots.declared.surroundings import Camera as SceneCamera
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.image.camera import Navigator
from sero_mj.viewer.image.framing import axes


@pytest.fixture
def world() -> World:
    robot = SerialRobot.from_model("lwr")
    cameras = {"front": SceneCamera(position=[2.0, -1.0, 1.5], look_at=[0.0, 0.0, 0.5])}
    return World(Scene(robots=[robot], cameras=cameras, view=View(distance=2.0)))


def view_of(world: World, data: mujoco.MjData, camera: mujoco.MjvCamera) -> ImageView:
    scene = mujoco.MjvScene(world.model, maxgeom=2000)
    everything = mujoco.mjtCatBit.mjCAT_ALL
    option = mujoco.MjvOption()
    mujoco.mjv_updateScene(world.model, data, option, None, camera, everything, scene)
    return ImageView.of_scene(scene, 800, 600)


def test_pan_moves_the_look_at_point_with_the_pointer(world: World) -> None:
    navigator, data = Navigator(world), world.make_data()
    point = np.array(navigator.camera.lookat)
    view = view_of(world, data, navigator.camera)
    navigator.pan(0.2, 0.1, view.tan_half_fovy, navigator.camera.distance)
    pixel, _ = view_of(world, data, navigator.camera).project(point)
    # 0.2 heights to the right, and 0.1 down.
    assert pixel == pytest.approx([400 + 120, 300 - 60], abs=0.5)


def test_camera_axes_equal_those_of_mujoco(world: World) -> None:
    navigator, data = Navigator(world, "130,-35,2"), world.make_data()
    view = view_of(world, data, navigator.camera)
    forward, right, up = axes(130.0, -35.0)
    for ours, theirs in ((forward, view.forward), (right, view.right), (up, view.up)):
        assert ours == pytest.approx(theirs, abs=1e-6)


def test_orbits_stop_at_the_poles_and_zooms_stay_in_range(world: World) -> None:
    navigator = Navigator(world, "0,0,2")
    navigator.orbit(0.5, 3.0)
    assert navigator.camera.azimuth == pytest.approx(-90)
    assert navigator.camera.elevation == -89.0
    navigator.orbit(0.0, -9.0)
    assert navigator.camera.elevation == 89.0
    navigator.zoom(1e4)
    assert navigator.camera.distance == pytest.approx(0.02)
    for _ in range(3):
        navigator.zoom(-1e5)
    assert navigator.camera.distance == pytest.approx(500)


def test_scene_camera_can_be_moved_from_its_pose(world: World) -> None:
    navigator, data = Navigator(world), world.make_data()
    mujoco.mj_forward(world.model, data)
    assert navigator.choose(1) == "camera front"
    before = view_of(world, data, navigator.camera)
    navigator.free(before.position, before.forward)
    after = view_of(world, data, navigator.camera)
    assert after.position == pytest.approx(before.position, abs=1e-4)
    assert after.forward == pytest.approx(before.forward, abs=1e-4)
    assert "no camera 2: the scene has one camera" in navigator.choose(2)


def test_following_moves_along_and_ends(world: World) -> None:
    navigator, data = Navigator(world), world.make_data()
    mujoco.mj_forward(world.model, data)
    start = navigator.camera.lookat.copy()
    before = world.frame(data, "lwr/flange")[:3, 3].copy()
    assert navigator.follow(data, "lwr/flange") == "follows lwr/flange"
    data.qpos[0] += 0.8
    data.qpos[1] += 0.8
    mujoco.mj_forward(world.model, data)
    navigator.advance(data)
    moved = world.frame(data, "lwr/flange")[:3, 3] - before
    assert np.linalg.norm(moved) > 0.1
    assert navigator.camera.lookat == pytest.approx(start + moved)
    assert navigator.follow(data, "lwr/flange") == "follows nothing"  # once more
    with pytest.raises(UnknownName):
        navigator.follow(data, "nobody")
