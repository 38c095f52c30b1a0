"""The start time of a video of the robot, from the motion in video and recording."""

from __future__ import annotations

import time
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import raises_with, sampled
from photos import camera, lwr
from scipy.ndimage import gaussian_filter1d

from sero_mj import Scene, UdpReceiver, World
from sero_mj.base.errors import UsageError
from sero_mj.base.frames import Array
from sero_mj.cli import main
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.intake import pad_packets
from sero_mj.data.receive.structure import Structure
from sero_mj.extensions.photo.camera_file import write_camera
from sero_mj.extensions.photo.footage import Video
from sero_mj.extensions.photo.photo_camera import PhotoCamera, PlaneImage
from sero_mj.extensions.photo.video_offset import correlate, match
from sero_mj.viewer.image.image_files import VideoWriter
from sero_mj.viewer.image.render import make_renderer

FPS, RATE, SECONDS = 25.0, 100.0, 20.0
LAYOUT = Structure("7F")
CENTRE = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])


def motion(seed: int = 3) -> Array:
    """Returns joint angles over time, (T, 7), with a motion that never repeats."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(int(SECONDS * RATE), 7))
    smooth = gaussian_filter1d(noise, 0.4 * RATE, axis=0)
    return CENTRE + 0.35 * smooth / smooth.std(axis=0) * [1, 0.5, 1, 0.7, 1, 1, 1]


def scene() -> Scene:
    return Scene(
        robots=[lwr()],
        sources={"udp": UdpReceiver(structure="7F", udpport=32123)},
        routes={"lwr.joint_angles": "udp.values0"},
        name="cell",
    )


def write_recording(path: Path, angles: Array) -> None:
    of = scene()
    source = wire(of).sources["udp"]
    rows = pad_packets([LAYOUT.encode({"values0": row}) for row in angles], LAYOUT.size)
    with record_sources({"udp": source}, path, scene=of) as recorder:
        # At the recording's own time, after its start.
        begin = recorder.clock.monotonic_ns / 1e9
        source._tap(*rows, begin + np.arange(len(angles)) / RATE)  # type: ignore[misc]


def write_video(
    path: Path, angles: Array, by: PhotoCamera, begin: float, seconds: float, noise: float = 6.0
) -> None:
    """Writes the camera's view of the motion from a time on, with noise, compressed."""
    world = World(Scene(robots=[lwr()]))
    data, rng = world.make_data(), np.random.default_rng(0)
    plane = PlaneImage(by, (1024, 1024))
    renderer = make_renderer(world, *plane.size, is_draft=True)
    times = np.arange(len(angles)) / RATE
    with VideoWriter(path, by.width, by.height, FPS) as film:
        for k in range(int(seconds * FPS)):
            pose = [np.interp(begin + k / FPS, times, joint) for joint in angles.T]
            world.set_input(data, "lwr.joint_angles", pose)
            mujoco.mj_kinematics(world.model, data)
            mujoco.mj_camlight(world.model, data)
            renderer.update_scene(data)
            plane.look(renderer.scene)
            pixels = plane.to_photo(renderer.render(), 0) + rng.normal(
                0, noise, (by.height, by.width, 1)
            )
            film.add(np.clip(pixels, 0, 255).astype(np.uint8))
    renderer.close()


@pytest.mark.thorough
@pytest.mark.gl
@pytest.mark.parametrize(("begin", "lens"), sampled([[13.0, "none"], [4.321, "barrel"]], 1))
def test_start_of_a_video_is_found_within_one_frame(
    begin: float, lens: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    by, angles = camera(lens, (320, 200)), motion()
    write_camera(tmp_path / "c.toml", by)
    write_recording(tmp_path / "run.mcap", angles)
    write_video(tmp_path / "v.mp4", angles, by, begin, 5.0)
    # The recorded scene, as a file.
    (tmp_path / "cell.toml").write_text(
        '[robots.lwr]\nmodel = "lwr"\nshow_axes = true\n[sources.udp]\nkind = "udp"\nport = 32123\n'
        'structure = "7F"\n[routes]\n"lwr.joint_angles" = "udp.values0"\n'
    )
    started = time.monotonic()
    with pytest.raises(SystemExit) as ended:
        main(
            ["render", f"{tmp_path}/cell.toml", "-o", f"{tmp_path}/o.mp4",
             "--over", f"{tmp_path}/v.mp4", "--camera-file", f"{tmp_path}/c.toml",
             "--replay", f"{tmp_path}/run.mcap", "--quality", "draft", "--duration", "0.3"]
        )  # fmt: skip
    out = capsys.readouterr().out
    assert ended.value.code == 0
    found = float(out.split("offset ")[1].split(" s")[0])
    print(f"{lens}: {1e3 * (found - begin):+.1f} ms off; {out.splitlines()[0]}; "
          f"{time.monotonic() - started:.1f} s")  # fmt: skip
    assert abs(found - begin) < 1 / FPS
    with Video(tmp_path / "o.mp4") as film:
        assert film.size == (320, 200)


def cells(seed: int, count: int, *, period: int = 0) -> Array:
    """Returns motion in 30 cells, (count, 30)."""
    rng = np.random.default_rng(seed)
    found = np.abs(gaussian_filter1d(rng.normal(size=(period or count, 30)), 3.0, axis=0))
    return np.resize(found, (count, 30)).astype(np.float32)


def test_offsets_are_found_to_a_fraction_of_a_frame_and_before_the_recording() -> None:
    swept = cells(0, 500)
    rng = np.random.default_rng(1)
    for shift in (0, 137, -60, 420):
        changed = np.zeros((150, 30), np.float32)
        for k in range(150):
            if 0 <= k + shift < 500:
                changed[k] = swept[k + shift]
        changed += 0.05 * rng.random(changed.shape).astype(np.float32)
        found = match(swept, changed, 25.0)
        assert found.offset == pytest.approx(shift / 25.0, abs=0.5 / 25.0)
        assert found.correlation > 0.8 > found.other
    half = (swept[137:287] + swept[138:288]) / 2
    assert match(swept, half, 25.0).offset * 25.0 == pytest.approx(137.5, abs=0.15)


def test_correlation_equals_the_direct_numpy_computation() -> None:
    swept, changed = cells(0, 80), cells(5, 40)
    lags, scores = correlate(swept, changed, 20)
    a, b = swept - swept.mean(axis=0), changed - changed.mean(axis=0)
    for lag, score in zip(lags.tolist(), scores.tolist(), strict=True):
        of_a, of_b = a[max(lag, 0) : lag + 40], b[max(-lag, 0) : 80 - lag]
        expected = (of_a * of_b).sum() / np.sqrt((of_a**2).sum() * (of_b**2).sum())
        assert score == pytest.approx(expected, abs=1e-5)
    assert lags[0] == -20 and lags[-1] == 60


def test_unclear_offset_is_rejected() -> None:
    with raises_with(
        UsageError,
        key="--offset auto",
        reason="video and recording do not match: found",
        found=pytest.approx(0.09, abs=0.015),
        of="correlation of their motion",
        expected="0.15 or more; check camera and recording, or use --offset S",
    ):
        match(cells(0, 500), cells(9, 150), 25.0)
    periodic = cells(0, 500, period=50)
    with pytest.raises(UsageError) as caught:
        match(periodic, periodic[60:210], 25.0)
    told = caught.value.problem
    assert told.key == "--offset auto"
    assert told.reason == "several offsets match (correlation 1.00 and 1.00): found"
    first, second = told.found  # s; rounding decides between the periods
    assert first != second
    assert [first % 2.0, second % 2.0] == pytest.approx([0.4, 0.4], abs=0.02)
    assert told.expected == "one of these as --offset S"
    still = np.zeros((150, 30), np.float32)
    with raises_with(
        UsageError,
        key="--offset auto",
        reason="the camera sees no motion of the robot in the video; use --offset S",
    ):
        match(cells(0, 500), still, 25.0)
    with raises_with(
        UsageError,
        key="--offset auto",
        reason="the camera sees no motion of the robot in the recording; use --offset S",
    ):
        match(still, cells(0, 150), 25.0)
    with raises_with(
        UsageError,
        key="--offset auto",
        reason="recording and video are too short",
        expected="1.5 s or more",
    ):
        match(cells(0, 20), cells(1, 20), 25.0)
