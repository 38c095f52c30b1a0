"""A live camera in the window: its images behind decor, and a lost camera."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from photos import POSE, camera
from polling import until
from window_tools import MISSING, SIZE, Driven, screen

from sero_mj.base.errors import DeclarationError, RenderError, UsageError
from sero_mj.cli import main
from sero_mj.cli.arguments import read_scene
from sero_mj.cli.shared_options import OverOptions
from sero_mj.data.drive.mirror import Mirror
from sero_mj.extensions.photo.background import open_feed
from sero_mj.extensions.photo.camera_feed import CameraFeed, VideoFeed
from sero_mj.extensions.photo.camera_file import write_camera
from sero_mj.viewer.image.image_files import VideoWriter

SETTINGS = (
    f"lwr.joint_angles={POSE}",
    "lwr.torques=90,-170,80,90,60,30,30",
    "lwr.show_arrows=true",
)


def write_video(path: Path, shades: list[int], size: tuple[int, int] = (320, 180)) -> str:
    with VideoWriter(path, *size, 20.0) as film:
        for shade in shades:
            film.add(np.full((size[1], size[0], 3), shade, np.uint8))
    return str(path)


def test_latest_image_is_used_and_a_video_is_looped(tmp_path: Path) -> None:
    write_camera(tmp_path / "c.toml", camera("none", (320, 180)))
    video = write_video(tmp_path / "v.mp4", [40, 80, 120])
    with CameraFeed(video, tmp_path / "c.toml") as feed:
        assert feed.camera.width == 320
        seen = set()

        def is_all_seen() -> bool:
            number, pixels = feed.latest()
            seen.add(round(float(pixels.mean()) / 40) * 40)
            return seen == {40, 80, 120} and number > 5

        until(is_all_seen)
        assert feed.piece == (feed.piece[0], "good") and "v.mp4: " in feed.piece[0]
        # It is lost, and its last image stays. Then it is back.
        number, _ = feed.latest()
        (tmp_path / "v.mp4").rename(tmp_path / "away.mp4")
        until(lambda: feed.piece[1] == "bad")
        assert "lost for" in feed.piece[0]
        assert feed.latest()[1].shape == (180, 320, 3)
        lost, _ = feed.latest()
        (tmp_path / "away.mp4").rename(tmp_path / "v.mp4")
        until(lambda: feed.latest()[0] > lost)
        assert feed.latest()[0] > number
    with pytest.raises(DeclarationError, match=r"found 320x180, but the image is 160x90"):
        CameraFeed(write_video(tmp_path / "w.mp4", [40], (160, 90)), tmp_path / "c.toml")


def test_opencv_cameras_have_correct_colors_and_are_reopened(
    tmp_path: Path,
) -> None:
    write_camera(tmp_path / "c.toml", camera("none", (320, 180)))
    with VideoWriter(tmp_path / "v.mp4", 320, 180, 20.0) as film:
        for _ in range(5):
            film.add(np.full((180, 320, 3), (200, 100, 30), np.uint8))
    # An address that OpenCV opens; its frames arrive at once, and then no more.
    with CameraFeed(f"file://{tmp_path / 'v.mp4'}", tmp_path / "c.toml") as feed:
        assert np.abs(feed.latest()[1][90, 160].astype(int) - (200, 100, 30)).max() < 12
        until(lambda: "stopped sending images" in feed.piece[0] and feed.piece[1] == "bad")
        number, _ = feed.latest()
        until(lambda: feed.latest()[0] > number)


def test_video_is_read_at_the_shown_time_forward_and_back(tmp_path: Path) -> None:
    write_camera(tmp_path / "c.toml", camera("none", (320, 180)))
    shades = [20 + 9 * ((7 * k) % 25) for k in range(100)]  # 5 s
    write_video(tmp_path / "v.mp4", shades)
    with VideoFeed(tmp_path / "v.mp4", tmp_path / "c.toml", 3.0) as feed:

        def shows(time: float, frame: int) -> None:
            """Waits until that frame has been read."""
            until(lambda: abs(float(feed.latest(time)[1].mean()) - shades[frame]) < 3)

        shows(3.0, 0)
        shows(3.0 + 10.5 / 20, 10)
        shows(3.0 + 11.5 / 20, 11)  # the next one
        shows(3.0 + 90.5 / 20, 90)  # a seek
        shows(3.0 + 30.5 / 20, 30)  # and back
        assert feed.piece == ("v.mp4: 1.5 s", "good")
        shows(1.0, 0)
        assert feed.piece == ("v.mp4: starts in 2.0 s", "quiet")
        shows(9.0, 99)
        assert feed.piece == ("v.mp4: ended 1.0 s ago", "quiet")
        shows(3.2 + 1e-6, 4)
        number, _ = feed.latest(3.2 + 1e-6)
        assert feed.latest(3.21)[0] == number  # still the same frame


def test_video_follows_the_scenario_time_or_is_a_camera_for_live_scenes(
    tmp_path: Path,
) -> None:
    write_camera(tmp_path / "c.toml", camera("none", (320, 180)))
    video = write_video(tmp_path / "v.mp4", [40, 80, 120])
    options = OverOptions(over=str(video), camera_file=tmp_path / "c.toml", offset=1.5)
    feed = open_feed(Mirror(read_scene("impedance_push")), options)
    assert isinstance(feed, VideoFeed)
    feed.latest(1.0)
    assert feed.piece[0] == "v.mp4: starts in 0.5 s"
    feed.close()
    for scene in ("lwr_udp", "lwr"):  # live, and without sources
        with pytest.raises(UsageError, match="--offset needs a video file as --over"):
            open_feed(Mirror(read_scene(scene)), options)
        feed = open_feed(Mirror(read_scene(scene)), options.model_copy(update={"offset": None}))
        assert isinstance(feed, CameraFeed)
        feed.close()


def test_invalid_cameras_are_rejected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_camera(tmp_path / "c.toml", camera("none", (320, 180)))
    with pytest.raises(RenderError, match="camera 97: there is no such camera, or it is in use"):
        CameraFeed("97", tmp_path / "c.toml")
    with pytest.raises(RenderError, match=r"gone\.mp4: no such file"):
        CameraFeed(str(tmp_path / "gone.mp4"), tmp_path / "c.toml")
    (tmp_path / "none.mp4").write_bytes(b"nothing" * 99)
    with pytest.raises(RenderError, match=r"none\.mp4 is not a readable video"):
        CameraFeed(str(tmp_path / "none.mp4"), tmp_path / "c.toml")
    monkeypatch.setenv("DISPLAY", ":99999")
    for options, message in (
        (["--over", "0"], "--over needs --camera-file"),
        (["--over", "0", "--camera-file", "c.toml", "--web"], "--over needs a window"),
        (["--over", "0", "--camera-file", "c.toml", "--camera", "1,2,3"],
         "--camera cannot be combined with --over"),
    ):  # fmt: skip
        with pytest.raises(SystemExit) as ended:
            main(["view", "lwr", *options])
        assert ended.value.code == 2
        assert message in capsys.readouterr().err


@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
@pytest.mark.thorough
def test_window_shows_decor_over_the_camera_image(tmp_path: Path) -> None:
    by = camera("barrel", (320, 180))
    write_camera(tmp_path / "c.toml", by)
    video = write_video(tmp_path / "v.mp4", [100] * 4)
    over = (video, str(tmp_path / "c.toml"))
    with (
        screen() as display,
        Driven(display, tmp_path, "lwr", settings=SETTINGS, over=over) as window,
    ):
        left, bottom, width, height = window.ask(
            "[getattr(w.decor.rect, k) for k in ('left', 'bottom', 'width', 'height')]"
        )
        assert width == SIZE[0] and height == 360  # of 16:9, in the middle
        picture = np.array(window.ask("w.image()[::4, ::4]"))
        grey = np.abs(picture - 100).max(axis=2) < 8
        assert 0.5 < grey.mean() < 0.98 and grey[:3].all()
        assert (picture[..., 0] - picture[..., 2] > 100).sum() > 30  # orange arrows
        assert window.ask("w.decor.pieces[0][1]") == "good"
        # A click on an arrow is at the distorted pixel.
        joint = "w.decor.view.project(w.data.site_xpos[w.world.joints.centre_site])[0][1].tolist()"
        x, y = window.ask(joint)
        data = by.resized(width, height).project(np.array([[0.0, 0.0, 0.31]]))[0][0]
        assert [x - 0.5, height - 0.5 - y] == pytest.approx(data, abs=0.6)
        window.click(left + x, SIZE[1] - bottom - y)
        window.until("len(clicks) == 1 and clicks[0][1] is not None")
        # The view stays that of the camera.
        window.tool("mousemove", 100, 200, "mousedown", 1, "mousemove", 200, 230, "mouseup", 1)
        window.until("'the view is fixed to' in w.notice.text")
        assert window.ask(joint) == [x, y]
        assert "no command renders this image" in window.ask(
            "w.tools['copy_command'].actions()['copy']()"
        )
        # A lost camera is reported, and nothing stops.
        (tmp_path / "v.mp4").unlink()
        window.until("w.decor.pieces[0][1] == 'bad'")
        window.settle()
