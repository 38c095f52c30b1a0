"""Motion blur: means in linear light of moving parts, below sharp text."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.image_view import ImageView
from sero_mj.viewer.image.image_options import VideoOptions
from sero_mj.viewer.image.render import HeadlessRenderer
from sero_mj.viewer.image.video_frames import SHUTTER, SUBFRAMES, Exposure, video_frames

AXES = np.eye(3)
VIEW = ImageView(np.zeros(3), AXES[0], AXES[1], -AXES[2], 0.5, 0.01, 200, 100)


def test_mean_of_black_and_white_is_half_the_light() -> None:
    exposure = Exposure()
    for level in (0, 255):
        exposure.add(np.full((2, 2, 3), level, np.uint8))
    assert exposure.image()[0, 0].tolist() == [188, 188, 188]  # sRGB of 0.5


def test_every_level_of_a_static_image_is_unchanged() -> None:
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    exposure = Exposure()
    exposure.add(levels)
    for _ in range(SUBFRAMES - 1):
        exposure.add()  # nothing has moved
    assert np.array_equal(exposure.image(), levels)


def test_motion_below_half_a_pixel_needs_no_subframe() -> None:
    exposure, metres = Exposure(), VIEW.pixel_size(2.0)
    point, right = np.array([[0.0, 0.0, -2.0], [0.3, 0.1, -2.0]]), metres * AXES[0]
    assert exposure.moves(VIEW, point)
    assert not exposure.moves(VIEW, point + 0.3 * right)
    assert exposure.moves(VIEW, point + 0.6 * right)  # since it was drawn
    assert not exposure.moves(VIEW, point + 0.6 * right + 0.001 * AXES[2])
    behind = point * [1, 1, -1]
    assert Exposure().moves(VIEW, behind)
    exposure.moves(VIEW, behind)
    assert not exposure.moves(VIEW, behind + 20 * right)  # outside the image


@pytest.fixture(scope="module")
def world() -> World:
    robot = SerialRobot.from_model("lwr", show_billboards=True, torques=[20.0] * 7)
    return World(Scene(robots=[robot]))


def posed(world: World, angle: float) -> mujoco.MjData:
    data = world.make_data()
    world.set_input(data, "lwr.joint_angles", [angle, 0.6, 0.0, -1.2, 0.0, 0.5, 0.0])
    Placer(world).place(data)
    return data


@pytest.fixture(scope="module")
def renderer(world):
    with HeadlessRenderer(world, 240, 180, quality="fine", renderer="classic") as renderer:
        yield renderer


@pytest.mark.thorough
@pytest.mark.gl
def test_billboard_values_stay_sharp_over_a_moving_arm(renderer, world) -> None:
    first = posed(world, 0.5)
    for _ in range(2):  # until billboards have settled
        still = renderer.render(first)
    assert np.array_equal(renderer.render_blurred(first for _ in range(SUBFRAMES)), still)
    blurred = renderer.render_blurred(posed(world, 0.5 + 0.05 * k) for k in range(SUBFRAMES))
    assert not np.array_equal(blurred, still)
    renderer.toggles.billboards[:] = False
    bare = renderer.render(first)
    renderer.toggles.billboards[:] = True
    letters = (still != bare).any(axis=2) & (still.min(axis=2) > 215)
    assert letters.sum() > 30
    # The edge of a letter is mixed with the background of the billboard.
    assert np.quantile(np.abs(blurred[letters].astype(int) - still[letters]), 0.9) <= 2


@pytest.mark.gl
def test_blurred_arm_is_the_mean_of_its_subframes_in_linear_light(renderer, world) -> None:
    renderer.toggles.billboards[:] = False
    moments = [posed(world, 0.5 + 0.05 * k) for k in range(SUBFRAMES)]
    sharp = np.stack([renderer.render(data).copy() for data in moments]) / 255.0
    blurred = renderer.render_blurred(iter(moments))
    renderer.toggles.billboards[:] = True
    linear = np.where(sharp <= 0.04045, sharp / 12.92, ((sharp + 0.055) / 1.055) ** 2.4).mean(0)
    mean = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(255 * mean - blurred).max() < 2


class VideoMirror:
    """The part of a mirror that videos need: an arm with constant angular velocity."""

    is_live = False
    sources = {"sim": None}

    def __init__(self, world: World, speed: float) -> None:
        self.world, self.data, self._speed = world, world.make_data(), speed
        self.times: list[float] = []

    def advance(self, now: float) -> None:
        self.times.append(now)
        angle = 0.2 + self._speed * now
        self.world.set_input(self.data, "lwr.joint_angles", [angle, 0.6, 0, -1.2, 0, 0.5, 0])
        self.data.time = now
        Placer(self.world).place(self.data)

    def state(self) -> np.ndarray:
        kind = mujoco.mjtState.mjSTATE_INTEGRATION
        state = np.empty(mujoco.mj_stateSize(self.world.model, kind))
        mujoco.mj_getState(self.world.model, self.data, state, kind)
        return state


@pytest.mark.gl
@pytest.mark.parametrize("quality", ["fine", "draft"])
def test_video_shutter_is_open_for_half_a_frame(world, quality: str) -> None:
    mirror = VideoMirror(world, 2.0)
    options = VideoOptions(size=(64, 48), quality=quality, camera="150,-14,2.2")
    with HeadlessRenderer(world, 64, 48, options.camera, quality, renderer="classic") as renderer:
        frames = [each.copy() for each in video_frames(mirror, renderer, 3, 10.0, options)]
    assert len(frames) == 3
    count = SUBFRAMES if quality == "fine" else 1
    wanted = [(k + SHUTTER * j / SUBFRAMES) / 10 for k in range(3) for j in range(count)]
    assert mirror.times[-3 * count :] == pytest.approx(wanted)
    assert not np.array_equal(frames[0], frames[2])


@pytest.mark.gl
def test_turntable_begins_at_the_view_and_rotates_uniformly(world) -> None:
    mirror, angles = VideoMirror(world, 0.0), []
    with HeadlessRenderer(world, 32, 24, "150,-14,2.2", "draft") as renderer:
        for _ in video_frames(mirror, renderer, 8, 4.0, VideoOptions(orbit=180.0)):
            angles.append(renderer.camera.azimuth)
    assert angles == pytest.approx([150 + 22.5 * k for k in range(8)])
