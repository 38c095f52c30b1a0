"""Decor over photos and videos of the real robot: pixel-accurate, with occlusion."""

from __future__ import annotations

from pathlib import Path

import cv2
import mujoco
import numpy as np
import pytest
from photos import LENSES, camera, lwr
from PIL import Image

from sero_mj import Double, Placer, Scene, World
from sero_mj.base.errors import RenderError
from sero_mj.base.frames import Array, inverse
from sero_mj.cli import main
from sero_mj.extensions.photo.camera_file import write_camera
from sero_mj.extensions.photo.footage import Video, at_rate, upright
from sero_mj.extensions.photo.over import PhotoRenderer
from sero_mj.extensions.photo.over_photo import PhotoPainter
from sero_mj.extensions.photo.photo_camera import PhotoCamera, PhotoView, PlaneImage
from sero_mj.viewer.image.image_files import VideoWriter
from sero_mj.viewer.image.mujoco_private import context_of, lend_shapes
from sero_mj.viewer.image.render import make_renderer
from sero_mj.viewer.image.scene_decor import SceneDecor

BOX = [-0.6, 0.9, -0.6, 0.6, 0.0, 1.1]  # of points near the robot, m


def by_opencv(of: PhotoCamera, points: Array) -> Array:
    """Returns pixels (k, 2) of points (k, 3), without our code."""
    T = inverse(of.T_world_camera)
    turn, shift = cv2.Rodrigues(T[:3, :3])[0], T[:3, 3:].copy()
    if of.model == "equidistant":
        found, _ = cv2.fisheye.projectPoints(points[:, None], turn, shift, of.matrix, of.distortion)
    else:
        found, _ = cv2.projectPoints(points, turn, shift, of.matrix, of.distortion)
    return np.asarray(found).reshape(-1, 2)


def some_points(of: PhotoCamera, count: int) -> Array:
    """Returns points (count, 3) near the robot and well inside the image."""
    rng = np.random.default_rng(0)
    points = rng.uniform(BOX[::2], BOX[1::2], (400, 3))
    pixels = by_opencv(of, points)
    inside = ((pixels > 8) & (pixels < [of.width - 8, of.height - 8])).all(axis=1)
    return points[inside & ((points - of.T_world_camera[:3, 3]) @ of.T_world_camera[:3, 2] > 0.3)][
        :count
    ]


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_projected_like_opencv_and_pixels_back(lens: str) -> None:
    by = camera(lens)
    points = some_points(by, 60)
    pixels, depth = by.project(points)
    assert np.abs(pixels - by_opencv(by, points)).max() < 1e-6
    view = PhotoView.of_camera(by, 0.01)
    seen, in_view = view.project(points)
    assert np.allclose(in_view, depth)
    assert np.allclose(seen, np.stack([pixels[:, 0] + 0.5, by.height - 0.5 - pixels[:, 1]], axis=1))
    assert np.abs(view.at(seen, depth[:, None]) - points).max() < 1e-6
    half = by.resized(by.width // 2, by.height // 2)
    assert np.allclose(half.project(points)[0] + 0.5, (pixels + 0.5) / 2, atol=1e-6)


@pytest.mark.parametrize("lens", LENSES)
def test_points_far_outside_the_image_are_not_bent_back_into_it(lens: str) -> None:
    by = camera(lens)
    T = by.T_world_camera
    for angle in np.linspace(0.0, 2 * np.pi, 16):
        aside = np.cos(angle) * T[:3, 0] + np.sin(angle) * T[:3, 1]
        pixels = by.project(T[:3, 3] + T[:3, 2] + np.geomspace(3.0, 1e4, 30)[:, None] * aside)[0]
        away = np.linalg.norm(pixels - by.matrix[:2, 2], axis=1)
        assert (np.diff(away) > 0).all()
        assert ((pixels < 0) | (pixels > [by.width, by.height])).any(axis=1).all()


@pytest.mark.gl
@pytest.mark.parametrize("lens", LENSES)
def test_geoms_are_drawn_within_half_a_pixel_of_the_opencv_projection(lens: str) -> None:
    by = camera(lens)
    world = World(Scene(robots=[lwr()]))
    painter = PhotoPainter(world, by, (4096, 4096))
    renderer = make_renderer(world, *painter.size, is_draft=False)
    renderer.update_scene(world.make_data())
    scene = renderer.scene
    painter.look(scene, PhotoView.font)
    points = some_points(by, 40)
    expected = by_opencv(by, points)
    apart = np.linalg.norm(expected[:, None] - expected, axis=2) + np.eye(len(points)) * 99
    points, expected = points[(apart > 20).all(axis=1)], expected[(apart > 20).all(axis=1)]
    assert len(points) > 10
    for k, point in enumerate(points):  # instead of the robot, which would hide some
        depth = (point - by.T_world_camera[:3, 3]) @ by.T_world_camera[:3, 2]
        radius = 3.0 * depth / by.matrix[0, 0]  # 3 pixels
        dot, turn, white = scene.geoms[k], np.eye(3).ravel(), np.ones(4, np.float32)
        kind = mujoco.mjtGeom.mjGEOM_SPHERE
        mujoco.mjv_initGeom(dot, kind, np.full(3, radius), point, turn, white)
        dot.category, dot.emission = int(mujoco.mjtCatBit.mjCAT_DECOR), 1.0
    scene.ngeom = len(points)
    black = np.zeros((by.height, by.width, 3), np.uint8)
    drawn = painter.over(black, scene, renderer.render).max(axis=2).astype(float)
    renderer.close()
    errors = []
    for u, v in expected:
        left, top = round(u) - 8, round(v) - 8
        part = drawn[top : top + 17, left : left + 17]
        assert 10 < (part > 20).sum() < 120
        y, x = np.mgrid[top : top + 17, left : left + 17]
        errors.append(
            np.hypot((part * x).sum() / part.sum() - u, (part * y).sum() / part.sum() - v)
        )
    assert max(errors) < 0.5
    print(f"{lens}: at most {max(errors):.3f} pixels, {np.mean(errors):.3f} on average")


def drawn_alone(world: World, data: mujoco.MjData, by: PhotoCamera, *, decor: bool) -> Array:
    """Returns the scene as windows show it, from this camera, without panels."""
    plane = PlaneImage(by, (4096, 4096))
    renderer = make_renderer(world, *plane.size, is_draft=False)
    renderer.update_scene(data)
    plane.look(renderer.scene)
    if decor:
        shown = SceneDecor(world, with_text=False)
        shown.first_shape = lend_shapes(context_of(renderer))
        shown.draw(
            data,
            PhotoView.of_camera(by, float(renderer.scene.camera[0].frustum_near)),
            renderer.scene,
        )
    pixels: Array = plane.to_photo(renderer.render(), 0).astype(int)
    renderer.close()
    return pixels


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.parametrize("lens", ["none", "barrel"])
def test_robot_hides_decor_and_neither_robot_nor_floor_is_drawn(lens: str) -> None:
    by = camera(lens)
    world = World(Scene(robots=[lwr(show_arrows=True)]))
    data = world.make_data()
    noise = np.random.default_rng(1).integers(0, 256, (by.height, by.width, 3), dtype=np.uint8)
    with PhotoRenderer(world, by) as renderer:
        renderer.decor.toggles.legend = False
        mujoco.mj_kinematics(world.model, data)
        mujoco.mj_camlight(world.model, data)
        assert np.array_equal(renderer.render(data, noise), noise)  # no torque, no arrow
        world.set_input(data, "lwr.torques", [90.0, -170.0, 80.0, 90.0, 60.0, 30.0, 30.0])
        changed = (renderer.render(data, noise) != noise).any(axis=2)
        on_black = renderer.render(data, np.zeros_like(noise)).astype(int)
    shown, without = (drawn_alone(world, data, by, decor=decor) for decor in (True, False))
    visible = np.abs(shown - without).max(axis=2) > 8
    assert visible.sum() > 3000
    assert (changed & visible).sum() / (changed | visible).sum() > 0.96
    # Arrows have the colors that windows show.
    inside = cv2.erode(visible.astype(np.uint8), np.ones((3, 3))).astype(bool)
    assert np.abs(on_black - shown)[inside].mean() < 6


@pytest.mark.gl
def test_photo_is_visible_through_a_transparent_double(tmp_path: Path) -> None:
    by = camera("none")
    world = World(Scene(robots=[lwr()], doubles=[Double(name="goal", of="lwr")]))
    data = world.make_data()
    world.set_input(data, "goal.joint_angles", [1.2, 0.6, 0, -1.2, 0, 0.8, 0])
    Placer(world).place(data)
    grey, dark = (np.full((by.height, by.width, 3), value, np.uint8) for value in (200, 40))
    with PhotoRenderer(world, by) as renderer:
        bright, shade = renderer.render(data, grey).astype(int), renderer.render(data, dark)
    is_double = np.abs(bright - 200).max(axis=2) > 12
    assert is_double.sum() > 3000
    through = (bright - shade.astype(int))[is_double].max(axis=1) / 160
    assert 0.1 < np.median(through) < 0.95  # neither opaque nor invisible


@pytest.mark.gl
def test_click_picks_the_item_at_the_distorted_pixel() -> None:
    by = camera("barrel")
    world = World(Scene(robots=[lwr(torques=[90.0, -170, 80, 90, 60, 30, 30], show_arrows=True)]))
    data = world.make_data()
    Placer(world).place(data)
    black = np.zeros((by.height, by.width, 3), np.uint8)
    with PhotoRenderer(world, by) as renderer:
        renderer.decor.toggles.legend = False
        drawn = renderer.render(data, black).astype(int)
        # In the middle of the orange area farthest from the center of the image.
        orange = ((drawn[..., 0] - drawn[..., 2]) > 120).astype(np.uint8)
        inside = np.argwhere(cv2.erode(orange, np.ones((5, 5))) > 0)
        y, x = inside[np.argmax(np.linalg.norm(inside - [by.height / 2, by.width / 2], axis=1))]
        picked = renderer.click(data, float(x), float(y))
        assert picked is not None and picked.kind == "arrow"
        assert renderer.hover(data, 3.0, 3.0) is None
        after = renderer.render(data, black).astype(int)
        assert np.abs(after - drawn).max() > 60  # the click has switched something


def write_video(path: Path, pictures: list[Array], fps: float = 10.0) -> Path:
    with VideoWriter(path, pictures[0].shape[1], pictures[0].shape[0], fps) as film:
        for picture in pictures:
            film.add(picture)
    return path


@pytest.mark.thorough
@pytest.mark.gl
def test_image_and_video_have_the_size_and_length_of_the_input(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by = camera("barrel", (320, 200))
    write_camera(tmp_path / "c.yaml", by)
    Image.fromarray(np.full((200, 320, 3), 90, np.uint8)).save(tmp_path / "p.png")
    settings = ["--set", "lwr.torques=10,-80,5,30,0,-2,1", "--set", "lwr.show_arrows=true"]
    over = ["--camera-file", str(tmp_path / "c.yaml"), "--quality", "draft", "--quiet", *settings]
    main_ok(["render", "lwr", "-o", f"{tmp_path}/o.png", "--over", f"{tmp_path}/p.png", *over])
    made = np.asarray(Image.open(tmp_path / "o.png")).astype(int)
    assert made.shape == (200, 320, 3)
    orange = (made[..., 0] - made[..., 2] > 100).sum()
    assert orange > 50 and (made == 90).all(axis=2).mean() > 0.5
    shades = [np.full((200, 320, 3), 40 + 10 * k, np.uint8) for k in range(8)]
    write_video(tmp_path / "v.mp4", shades)
    main_ok(["render", "lwr", "-o", f"{tmp_path}/o.mp4", "--over", f"{tmp_path}/v.mp4", *over])
    with Video(tmp_path / "o.mp4") as video:
        frames = list(video.frames())
        assert video.size == (320, 200) and video.fps == pytest.approx(10)
    assert np.allclose([time for time, _ in frames], 0.1 * np.arange(8), atol=1e-3)
    corner = [int(pixels[5, -5, 0]) for _, pixels in frames]
    assert np.allclose(corner, [40 + 10 * k for k in range(8)], atol=4)


@pytest.mark.gl
def test_image_over_a_video_uses_the_frame_of_its_time(tmp_path: Path) -> None:
    by = camera("none", (320, 200))
    write_camera(tmp_path / "c.toml", by)
    shades = [np.full((200, 320, 3), 40 + 20 * k, np.uint8) for k in range(8)]
    write_video(tmp_path / "v.mp4", shades)
    over = ["--over", f"{tmp_path}/v.mp4", "--camera-file", f"{tmp_path}/c.toml", "--quiet"]
    # The scenario at 2.45 s, and the video frame 0.45 s after the first one, which is at 2 s.
    for name, options, frame in (
        ("impedance_push", ["--offset", "2", "--at", "2.45"], 4),
        ("impedance_push", ["--offset", "2"], 0),
        ("lwr", ["--at", "0.3", "--show", "arrows=1"], 3),
    ):
        line = ["render", name, "-o", f"{tmp_path}/o.png", *over, *options, "--quality", "draft"]
        main_ok(line)
        made = np.asarray(Image.open(tmp_path / "o.png")).astype(int)
        assert np.abs(made[3, -3] - (40 + 20 * frame)).max() < 5


def main_ok(arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 0


def error_of(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    return capsys.readouterr().err.strip()


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Writes a photo, a video and their camera file."""
    write_camera(tmp_path / "c.toml", camera("none", (64, 40)))
    Image.fromarray(np.full((40, 64, 3), 90, np.uint8)).save(tmp_path / "p.png")
    Image.fromarray(np.full((40, 60, 3), 90, np.uint8)).save(tmp_path / "narrow.png")
    write_video(tmp_path / "v.mp4", [np.full((40, 64, 3), 90, np.uint8)] * 3)
    (tmp_path / "none.mp4").write_bytes(b"no video" * 100)
    (tmp_path / "none.png").write_bytes(b"no photo" * 100)
    return tmp_path


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--over p.png",
         "--over needs --camera-file CAMERA.yaml or .toml"),
        ("--camera-file c.toml", "--camera-file needs --over FILE"),
        ("--offset 3", "--offset needs --over FILE"),
        ("--over p.png --camera-file c.toml --offset 3",
         "--offset is for videos; use --start for the time of a photo in a recording"),
        ("--over v.mp4 --camera-file c.toml --at 7",
         "v.mp4 has no frame at 7.00 s; the video ends at 0.30 s"),
        ("--over p.png --camera-file c.toml --camera 1,2,3",
         "--camera cannot be combined with --over: the photo or video determines size and camera"),
        ("--over none.png --camera-file c.toml", "none.png is not a readable photo"),
        ("--over gone.png --camera-file c.toml", "gone.png: no such file"),
        ("--over p.png --camera-file gone.toml", "gone.toml: no such file"),
        ("--over narrow.png --camera-file c.toml",
         "c.toml: image_width: found 64x40, but the image is 60x40; expected a camera file for "
         "images of this size (cropped or resized images have other intrinsics)"),
        ("-o o.mp4 --over p.png --camera-file c.toml",
         "-o o.mp4: expected an image file such as .png, because --over is a photo"),
        ("-o o.mp4 --over v.mp4 --camera-file c.toml --offset 3",
         "--offset is for recordings and scenarios; the scene has no sources"),
        ("-o o.mp4 --over none.mp4 --camera-file c.toml", "none.mp4 is not a readable video"),
        ("-o o.mp4 --over c.toml --camera-file c.toml", "c.toml is not a readable video"),
    ],
)  # fmt: skip
def test_invalid_options_are_rejected(
    options: str, message: str, files: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(files)
    output = [] if "-o" in options.split() else ["-o", "o.png"]
    assert f"sero-mj: {message}" in error_of(["render", "lwr", *output, *options.split()], capsys)


def test_live_robot_cannot_be_combined_with_a_video(
    files: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(files)
    line = ["render", "lwr_udp", "-o", "o.mp4", "--over", "v.mp4", "--camera-file", "c.toml"]
    assert "v.mp4: live sources cannot be combined with a video; use a recording" in error_of(
        line, capsys
    )


def test_truncated_video_ends_at_its_last_frame(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 256, (40, 64, 3), dtype=np.uint8) for _ in range(30)]
    whole = write_video(tmp_path / "v.webm", noise)
    with Video(whole) as video:
        count = len(list(video.frames()))
    whole.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    with Video(whole) as video:
        assert 5 < len(list(video.frames())) < count == 30
    whole.write_bytes(whole.read_bytes()[:300])
    with pytest.raises(RenderError, match=r"v\.webm( is not a readable video|: no frame)"):
        Video(whole)


def test_phone_videos_are_upright_and_have_their_mean_rate(tmp_path: Path) -> None:
    class Frame:
        rotation = 90

        def to_ndarray(self, **_: str) -> Array:
            return np.arange(24, dtype=np.uint8).reshape(2, 4, 3)

    turned = upright(Frame())  # type: ignore[arg-type]
    assert turned.shape == (4, 2, 3)
    # Rotated counterclockwise: the left is at the bottom.
    assert turned[-1, 0].tolist() == [0, 1, 2]

    class Varying:
        def frames(self) -> list[tuple[float, int]]:
            return [(0.0, 0), (0.11, 1), (0.19, 2), (0.62, 3), (0.7, 4)]

    found = list(at_rate(Varying(), 10.0, None))  # type: ignore[arg-type]
    # Frames shown at 0, 0.1, ... with their own times.
    assert [frame for _, frame in found] == [0, 1, 2, 2, 2, 2, 3, 4]
    assert found[3][0] == 0.19
    assert len(list(at_rate(Varying(), 10.0, 0.3))) == 3  # type: ignore[arg-type]
