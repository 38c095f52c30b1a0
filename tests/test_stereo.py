"""Stereo images: the disparity of points, and text at the same place for both eyes."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image
from window_tools import MISSING, SIZE, Driven, screen

from sero_mj import HeadlessRenderer, Scene, SerialRobot, World, render_image, render_video
from sero_mj.base.errors import RenderError
from sero_mj.base.frames import Array
from sero_mj.cli import main
from sero_mj.viewer.image.stereo import anaglyph, each_eye, looked_at

WIDTH, HEIGHT, EYES = 640, 400, 0.1
VALUES = {
    "joint_angles": [0, 0.5, 0, -1.5, 0, 1, 0],
    "torques": [10.0, -80.0, 5.0, 30.0, 0.0, -2.0, 1.0],
}


def lwr(*, show_billboards: bool = True) -> SerialRobot:
    return SerialRobot.from_model("lwr", **VALUES, show_billboards=show_billboards)


def pixel(scene: mujoco.MjvScene, point: Array) -> Array:
    """Returns the position of a point in a square image by the camera frustum, -1 to 1."""
    camera = scene.camera[0]
    forward, up = np.array(camera.forward), np.array(camera.up)
    at = point - np.array(camera.pos)
    depth = at @ forward / camera.frustum_near
    half = (camera.frustum_top - camera.frustum_bottom) / 2
    x = at @ np.cross(forward, up) / depth - camera.frustum_center
    return np.array([x, at @ up / depth]) / half


def test_disparity_of_a_point_depends_on_its_distance_only() -> None:
    world = World(Scene(robots=[lwr()]))
    data, camera = world.make_data(), mujoco.MjvCamera()
    mujoco.mj_kinematics(world.model, data)
    camera.lookat, camera.distance, camera.azimuth, camera.elevation = (
        [0.2, 0.1, 0.5],
        2.5,
        130,
        -20,
    )
    scene = mujoco.MjvScene(world.model, 2000)
    option = mujoco.MjvOption()
    every = mujoco.mjtCatBit.mjCAT_ALL
    mujoco.mjv_updateScene(world.model, data, option, None, camera, every, scene)
    middle = (np.array(scene.camera[0].pos) + np.array(scene.camera[1].pos)) / 2
    forward, up = np.array(scene.camera[0].forward), np.array(scene.camera[0].up)
    right, near = np.cross(forward, up), scene.camera[0].frustum_near
    distance = looked_at(scene, camera, np.zeros(3))
    assert distance == pytest.approx(2.5)
    depths = np.array([1.0, 2.5, 10.0, 1.6 * near])
    points = [middle + z * (forward + 0.1 * right - 0.2 * up) for z in depths]
    # Decor in pixels is in front of everything and must not move.
    leader = scene.geoms[scene.ngeom]
    mujoco.mjv_initGeom(
        leader,
        mujoco.mjtGeom.mjGEOM_BOX,
        np.ones(3),
        points[3],
        np.eye(3).ravel(),
        np.ones(4, "f4"),
    )
    scene.ngeom += 1
    seen, leaders = [], []
    for _ in each_eye(scene, EYES, distance):
        seen.append([pixel(scene, point) for point in points[:3]])
        leaders.append(pixel(scene, np.array(leader.pos)))
    tan_half = np.tan(np.deg2rad(world.model.vis.global_.fovy) / 2)
    apart = np.array(seen[0]) - np.array(seen[1])
    # By similar triangles: eyes b apart see z and the screen at D apart by b (1/z - 1/D).
    expected = EYES * (1 / depths[:3] - 1 / 2.5) / tan_half
    assert np.allclose(apart[:, 0], expected, atol=1e-5) and np.allclose(apart[:, 1], 0, atol=1e-5)
    centre = np.array([0.1, -0.2]) / tan_half
    assert np.allclose(np.mean(seen, axis=0)[1], centre, atol=1e-5)
    assert np.allclose(leaders, centre, atol=2e-4)


def test_gray_is_unchanged_in_an_anaglyph_and_each_eye_has_its_color() -> None:
    grey = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    assert np.abs(anaglyph(grey, grey).astype(int) - grey).max() <= 1
    white, black = np.full((1, 1, 3), 255, np.uint8), np.zeros((1, 1, 3), np.uint8)
    assert anaglyph(white, black).tolist() == [[[255, 0, 0]]]
    assert anaglyph(black, white).tolist() == [[[0, 255, 255]]]


def picture(
    stereo: str | None,
    size: tuple[int, int] = (WIDTH, HEIGHT),
    *,
    show_billboards: bool = True,
) -> Array:
    world = World(Scene(robots=[lwr(show_billboards=show_billboards)]))
    with HeadlessRenderer(world, *size, stereo=stereo) as renderer:  # type: ignore[arg-type]
        data = world.make_data()
        mujoco.mj_kinematics(world.model, data)
        mujoco.mj_camlight(world.model, data)
        return np.asarray(renderer.render(data)).astype(int)


@pytest.mark.thorough
@pytest.mark.gl
def test_text_is_at_the_same_pixels_for_both_eyes_and_without_stereo() -> None:
    one = picture(None)
    bare = picture(None, show_billboards=False)
    is_text = (one > 230).all(axis=2) & (np.abs(one - bare) > 40).any(axis=2)
    assert is_text.sum() > 200
    mixed = picture("anaglyph")
    assert np.abs(mixed - one)[is_text].max() < 30
    assert np.abs(mixed - one).mean() > 1  # the scene itself differs
    both = picture("side-by-side", (2 * WIDTH, HEIGHT))
    left, right = both[:, :WIDTH], both[:, WIDTH:]
    for eye in (left, right):
        assert np.abs(eye - one)[is_text].max() < 30
    assert 0.5 < np.abs(left - right).mean() < 20


@pytest.mark.gl
def test_stereo_images_and_videos_are_written(tmp_path: Path) -> None:
    scene = Scene(robots=[lwr()])
    small = {"size": (160, 100), "quality": "draft", "stereo": "side-by-side"}
    render_image(scene, tmp_path / "a.png", **small)  # type: ignore[arg-type]
    pixels = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    assert pixels.shape == (100, 160, 3)
    assert np.abs(pixels[:, :80] - pixels[:, 80:]).max() > 20
    options = {**small, "stereo": "anaglyph", "duration": 0.1}
    render_video(scene, tmp_path / "a.mp4", **options)  # type: ignore[arg-type]
    assert (tmp_path / "a.mp4").stat().st_size > 1000


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
def test_window_shows_both_eyes_and_accepts_clicks_in_either(tmp_path: Path) -> None:
    settings = ("lwr.joint_angles=0,0.6,0,-1.2,0,0.8,0", "lwr.torques=20,60,-30,40,-9,5,3")
    joint = "w.decor.view.project(w.data.site_xpos[w.world.joints.centre_site])[0][1].tolist()"
    with (
        screen() as display,
        Driven(display, tmp_path, "lwr", settings=settings, stereo="side-by-side") as window,
    ):
        (x, y), bottom = window.ask(f"[{joint}, w.decor.rect.bottom]")
        for k, half in enumerate((0, SIZE[0] // 2)):
            window.click(half + x, SIZE[1] - bottom - y)
            window.until(f"len(clicks) == {k + 1}")
        assert window.ask("clicks[0] == clicks[1] and clicks[0][1] is not None")
        halves = "[w.image()[:, :320].astype(int), w.image()[:, 320:].astype(int)]"
        apart = f"(lambda a, b: float(abs(a - b).mean()))(*{halves})"
        assert 0.3 < window.ask(apart) < 20
        # Red is the left eye's channel, green and blue are the right one's.
        window.ask("setattr(w.decor, '_is_anaglyph', True)")
        window.settle()
        mixed = "w.image().astype(int)"
        assert window.ask(f"int(abs({mixed}[..., 0] - {mixed}[..., 1]).max())") > 60
        window.ask("setattr(w.decor, '_eye_distance', 1e-9)")
        window.settle()
        window.ask("setattr(w, '_mixed', w.image().astype(int)) or 0")
        window.ask("setattr(w.decor, '__class__', type(w.decor).__base__)")  # for one eye
        assert window.ask("int(abs(w._mixed - w.image()).max())") <= 2


def test_invalid_stereo_options_are_rejected(capsys: pytest.CaptureFixture[str]) -> None:
    world = World(Scene(robots=[lwr()]))
    for fields, message in (
        ({"stereo": "3d"}, "found stereo '3d'; expected side-by-side or anaglyph"),
        ({"stereo": "anaglyph", "eye_distance": 3.0},
         "found 3 m between the eyes; expected a distance above 0, up to 1 m"),
    ):  # fmt: skip
        with pytest.raises(RenderError) as caught:
            HeadlessRenderer(world, **fields)  # type: ignore[arg-type]
        assert str(caught.value) == message
    with pytest.raises(SystemExit):
        main(["render", "lwr", "-o", "a.png", "--eye-distance", "0.1"])
    assert "--eye-distance needs --stereo side-by-side or anaglyph" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["view", "lwr", "--web", "--stereo", "anaglyph"])
    assert "--stereo needs a window instead of a page" in capsys.readouterr().err
