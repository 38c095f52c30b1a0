"""Images and videos on disk, and sampling of live sources."""

import errno
import itertools
import os
import socket
import struct
import subprocess
import sys

import av
import numpy as np
import pytest
from conftest import raises_with
from PIL import Image

from sero_mj.base.errors import DeclarationError, RenderError
from sero_mj.data.drive.mirror import Mirror
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene, View
from sero_mj.viewer.image.image_files import VideoWriter, default_fps, save_image
from sero_mj.viewer.image.render import render_image, render_video
from sero_mj.viewer.image.sampling import sampled_states

# The default view depends on the declared robot pose.
VIEW = View(distance=2.0, look_at=[0.0, 0.0, 0.5])


def a_frame(k: int, width: int = 64, height: int = 48) -> np.ndarray:
    return np.full((height, width, 3), (10 * k, 128, 255 - 10 * k), np.uint8)


def test_mp4_has_its_frames_size_and_rate(tmp_path) -> None:
    path = tmp_path / "new folder" / "film.mp4"
    with VideoWriter(path, 65, 49, 25.0) as film:  # odd sizes lose their last row and column
        for k in range(12):
            film.add(a_frame(k, 65, 49))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (64, 48, 25)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 12
    assert np.abs(frames[7].mean(axis=(0, 1)) - (70, 128, 185)).max() < 12
    assert [p.name for p in path.parent.iterdir()] == ["film.mp4"]


def test_webm_has_its_frames(tmp_path) -> None:
    path = tmp_path / "film.webm"
    with VideoWriter(path, 65, 49, 25.0) as film:
        for k in range(12):
            film.add(a_frame(k, 65, 49))
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name in ("vp9", "libvpx-vp9")
        assert (stream.width, stream.height, stream.average_rate) == (64, 48, 25)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 12
    assert np.abs(frames[7].mean(axis=(0, 1)) - (70, 128, 185)).max() < 12


def test_gif_has_its_frames_colors_and_timing(tmp_path) -> None:
    path = tmp_path / "film.gif"
    ramp = np.zeros((49, 65, 3), np.uint8)
    ramp[..., 0] = np.linspace(0, 255, 65)
    ramp[..., 1] = np.linspace(0, 255, 49)[:, None]
    frames = [np.roll(ramp, 7 * k, axis=1) for k in range(5)]
    for k in range(4):  # a small item of another color in front of a static background
        frames.append(ramp.copy())
        frames[-1][20:30, 10 * k : 10 * k + 8] = (30, 60 * k, 255)
    with VideoWriter(path, 65, 49, 30.0) as film:
        for k, frame in enumerate(frames):
            film.add(frame if k != 4 else a_frame(4, 65, 49))  # its own colors
    with Image.open(path) as gif:
        assert (gif.n_frames, gif.size, gif.info["loop"]) == (9, (65, 49), 0)
        shown, seconds = [], 0.0
        for k in range(9):
            gif.seek(k)
            seconds += gif.info["duration"] / 1000
            shown.append(np.asarray(gif.convert("RGB")).astype(int))
    assert abs(seconds - 9 / 30) < 0.02
    for k, (found, frame) in enumerate(zip(shown, frames, strict=True)):
        wanted = a_frame(4, 65, 49) if k == 4 else frame
        assert np.abs(found - wanted).mean() < (1 if k == 4 else 8), k
    assert [p.name for p in tmp_path.iterdir()] == ["film.gif"]


def test_interrupted_gif_is_saved_and_failed_one_is_not(tmp_path) -> None:
    for error, kept in ((KeyboardInterrupt, ["film.gif"]), (ZeroDivisionError, [])):
        folder = tmp_path / error.__name__
        with pytest.raises(error), VideoWriter(folder / "film.gif", 64, 48, 20.0) as film:
            film.add(a_frame(1))
            film.add(a_frame(2))
            raise error
        assert [p.name for p in folder.iterdir()] == kept
    with Image.open(tmp_path / "KeyboardInterrupt" / "film.gif") as gif:
        assert gif.n_frames == 2


def test_unknown_video_formats_and_rates_are_rejected(tmp_path) -> None:
    with raises_with(
        RenderError,
        file=f"{tmp_path}/x.avi",
        found=".avi",
        expected="a name that ends in .mp4, .webm, .gif",
    ):
        VideoWriter(tmp_path / "x.avi", 64, 48, 30.0)
    expected = "at most 50, because programs play faster GIFs slowly"
    with raises_with(RenderError, found=60.0, of="frames per second", expected=expected):
        VideoWriter(tmp_path / "x.gif", 64, 48, 60.0)
    assert [default_fps(f"x{suffix}") for suffix in (".mp4", ".webm", ".GIF")] == [30, 30, 20]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.thorough
@pytest.mark.gl
def test_gif_and_webm_of_a_scene_are_written(lwr: SerialRobot, tmp_path) -> None:
    scene = Scene(robots=[lwr], view=VIEW)
    render_image(scene, tmp_path / "still.png", size=(160, 120))
    still = np.asarray(Image.open(tmp_path / "still.png").convert("RGB")).astype(float)
    assert still.std() > 10  # a robot, and not a uniform area
    for name, frames in (("film.gif", 4), ("film.webm", 6)):
        render_video(scene, tmp_path / name, duration=0.2, size=(160, 120))
        with av.open(str(tmp_path / name)) as container:
            pictures = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
        assert len(pictures) == frames
        assert np.abs(pictures[0] - still).mean() < 3  # 0.5 and 1.3; a uniform area has 12


def test_failed_video_leaves_no_file(tmp_path) -> None:
    path = tmp_path / "film.mp4"
    path.write_bytes(b"the film of yesterday")
    with pytest.raises(ZeroDivisionError), VideoWriter(path, 64, 48, 25.0) as film:
        film.add(a_frame(1))
        raise ZeroDivisionError
    assert [p.name for p in tmp_path.iterdir()] == ["film.mp4"]
    assert path.read_bytes() == b"the film of yesterday"


@pytest.mark.parametrize("ending", [".mp4", ".webm", ".gif", ".png"])
def test_file_that_cannot_be_written_is_named(tmp_path, ending) -> None:
    """The error names this file, not the temporary one, and no traceback of its removal."""
    path = tmp_path / f"{'x' * 300}{ending}"
    pixels = np.zeros((16, 16, 3), np.uint8)
    with pytest.raises(RenderError) as found:
        if ending == ".png":
            save_image(path, pixels)
        with VideoWriter(path, 16, 16, 10) as film:
            film.add(pixels)
    assert str(found.value) == f"cannot write {path}: {os.strerror(errno.ENAMETOOLONG)}"


def test_folder_that_cannot_be_made_is_named(tmp_path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with raises_with(RenderError, reason=f"cannot write {tmp_path}/file/film.mp4: File exists"):
        VideoWriter(blocked / "film.mp4", 64, 48, 25.0)
    with raises_with(RenderError, reason=f"cannot write {tmp_path}/file/picture.png: File exists"):
        save_image(blocked / "picture.png", a_frame(0))
    with raises_with(
        RenderError, reason=f"cannot write {tmp_path}/picture.xyz: unknown file extension: .xyz"
    ):
        save_image(tmp_path / "picture.xyz", a_frame(0))


@pytest.mark.gl
def test_scene_without_sources_needs_no_waiting(tmp_path) -> None:
    lwr = SerialRobot.from_model("lwr", torques=np.full(7, 20.0), show_arrows=True)
    steps: list[tuple[int, int]] = []
    silent = render_video(
        Scene(robots=[lwr]),
        tmp_path / "film.mp4",
        duration=0.5,
        fps=10,
        size=(160, 120),
        on_progress=lambda done, total: steps.append((done, total)),
    )
    assert silent == []
    assert steps == [(k, 5) for k in range(1, 6)]
    with av.open(str(tmp_path / "film.mp4")) as container:
        frames = [
            frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)
        ]
    # The arrows rotate: consecutive frames differ.
    assert all(np.abs(a - b).max() > 40 for a, b in itertools.pairwise(frames))


def udp_scene(port: int) -> Scene:
    return Scene(
        robots=[SerialRobot.from_model("lwr", show_arrows=True)],
        sources={"udp": {"kind": "udp", "port": port, "structure": "7F7F"}},
        routes={"lwr.joint_angles": "udp.values0", "lwr.torques": "udp.values1"},
        view=VIEW,
    )


@pytest.mark.realtime
@pytest.mark.slow
def test_live_video_samples_states_at_its_rate_despite_slow_rendering() -> None:
    """The joint angle is the sender's clock: frames must be a tenth of a second apart."""
    sender_code = (
        "import socket, struct, sys, time\n"
        "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "start = time.monotonic()\n"
        "while True:\n"
        "    t = time.monotonic() - start\n"
        "    s.sendto(struct.pack('<14d', *[t] * 7, *[0] * 7), ('127.0.0.1', int(sys.argv[1])))\n"
        "    time.sleep(0.001)\n"
    )
    mirror = Mirror(udp_scene(0))
    with mirror:
        port = str(mirror.sources["udp"].port)  # type: ignore[attr-defined]
        sender = subprocess.Popen([sys.executable, "-c", sender_code, port])
        try:
            assert mirror.wait(20) == []
            angles = []
            for k, state in enumerate(sampled_states(mirror, 8, 10.0)):
                if k < 4:  # rendering of the first frames takes three times their duration
                    mirror.sources["udp"].wait(0)
                    subprocess.run(["sleep", "0.3"], check=True)
                angles.append(state[1])  # time, then qpos
        finally:
            sender.kill()
            sender.wait()
    assert np.diff(angles) == pytest.approx(np.full(7, 0.1), abs=0.03)


@pytest.mark.gl
def test_image_shows_the_received_pose(tmp_path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    pose = [0.5, 1.0, -0.7, 1.5, 0.9, -1.4, 0.3]
    scene = udp_scene(port)
    silent = render_image(scene, tmp_path / "silent.png", size=(200, 150), wait=0.0)
    assert silent == ["udp"]
    code = (
        "import socket, sys, time\n"
        "s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)\n"
        "while True:\n"
        "    s.sendto(bytes.fromhex(sys.argv[2]), ('127.0.0.1', int(sys.argv[1])))\n"
        "    time.sleep(0.01)\n"
    )
    packet = struct.pack("<14d", *pose, *[20.0] * 7).hex()
    sender = subprocess.Popen([sys.executable, "-c", code, str(port), packet])
    try:
        assert render_image(scene, tmp_path / "live.png", size=(200, 150), wait=20) == []
    finally:
        sender.kill()
        sender.wait()
    still = Scene(
        robots=[
            SerialRobot.from_model(
                "lwr", show_arrows=True, joint_angles=pose, torques=np.full(7, 20.0)
            )
        ],
        view=VIEW,
    )
    render_image(still, tmp_path / "still.png", size=(200, 150))
    live, still_pixels, silent_pixels = (
        np.asarray(Image.open(tmp_path / f"{name}.png"), int)
        for name in ("live", "still", "silent")
    )
    assert np.abs(live - still_pixels).max() <= 2
    assert (np.abs(live - silent_pixels).max(axis=2) > 60).sum() > 300


@pytest.mark.parametrize(
    ("name", "options", "error"),
    [
        ("x.mp4", {"duration": -1}, DeclarationError),
        ("x.mp4", {"fps": float("nan")}, DeclarationError),
        ("x.avi", {}, RenderError),
    ],
)
def test_invalid_videos_are_rejected(tmp_path, name, options, error) -> None:
    expected = {"found": ".avi", "expected": "a name that ends in .mp4, .webm, .gif"}
    for key, value in options.items():
        expected = {"key": key, "found": value, "expected": "a number above 0"}
    with raises_with(error, **expected):
        render_video(udp_scene(0), tmp_path / name, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.gl
def test_unknown_camera_is_reported_before_anything_is_written(tmp_path) -> None:
    from sero_mj.base.errors import UnknownName

    with raises_with(UnknownName, kind="camera", name="side", available=[]):
        render_video(udp_scene(0), tmp_path / "film.mp4", camera="side", wait=0)
    assert list(tmp_path.iterdir()) == []
