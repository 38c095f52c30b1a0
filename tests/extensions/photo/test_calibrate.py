"""Cameras from points of the robot: pose, uncertainty, and impossible cases."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from photos import LENSES, POSE, camera, lwr
from PIL import Image

from sero_mj import Placer, Scene, World, load_scene
from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.base.frames import Array, rotation_angle
from sero_mj.cli import main
from sero_mj.data.drive.record_sources import record_sources
from sero_mj.data.drive.wiring import wire
from sero_mj.data.receive.intake import pad_packets
from sero_mj.extensions.photo.calibration import (
    calibrate,
    full_name,
    point_names,
    point_of,
    read_points,
)
from sero_mj.extensions.photo.camera_file import read_camera, write_camera
from sero_mj.extensions.photo.photo_camera import PhotoCamera

NAMES = ["base", "A1", "A2", "E1", "A3", "A4", "A5", "flange", "flange", "base", "A2", "A3"]
OFFSETS = np.zeros((len(NAMES), 3))
OFFSETS[8:] = [[0.05, 0, 0.1], [0, 0.1, 0], [0, 0, 0.08], [0.05, 0, 0.07]]


@pytest.fixture(scope="module")
def world() -> World:
    return World(Scene(robots=[lwr()], floor=False))


@pytest.fixture(scope="module")
def points(world: World) -> Array:
    data = world.make_data()
    Placer(world).place(data)
    return np.array(
        [point_of(world, data, full_name(world, n), d) for n, d in zip(NAMES, OFFSETS, strict=True)]
    )


def bare(by: PhotoCamera) -> PhotoCamera:
    """Returns the lens alone."""
    return PhotoCamera(by.width, by.height, by.matrix, np.eye(4), by.distortion, by.model)


def test_points_are_frames_and_the_centers_of_joints(world: World, points: Array) -> None:
    assert {"lwr/base", "lwr/flange", "lwr/link4", "lwr/A3"} <= set(point_names(world))
    robot = world.scene.robots["lwr"]
    T_flange = robot.fwd_kin_base_to_flange(np.array(POSE))
    assert np.allclose(points[7], T_flange[:3, 3], atol=1e-6)
    assert np.allclose(points[8], (T_flange @ [0.05, 0, 0.1, 1])[:3], atol=1e-6)
    # By DH: A2, the second joint, is 0.31 m above the base with its axis along y.
    assert np.allclose(points[2], [0, 0, 0.31], atol=1e-6)
    for name, near in (("flnge", "flange"), ("lwr/A9", "lwr/A6")):
        with raises_with(reason="no frame or joint", found=name, near=near):
            full_name(world, name)


@pytest.mark.parametrize("lens", LENSES)
def test_camera_is_found_from_exact_points(lens: str, points: Array) -> None:
    by = camera(lens, (1280, 800))
    found = calibrate(NAMES, points, by.project(points)[0], bare(by), find_focal=False)
    assert found.used.all() and found.rms < 1e-3
    assert np.abs(found.camera.T_world_camera - by.T_world_camera).max() < 1e-5


@pytest.mark.thorough
def test_noise_of_a_pixel_causes_the_reported_errors(points: Array) -> None:
    by = camera("barrel", (1280, 800))
    off, reported = [], []
    for seed in range(10):
        noise = np.random.default_rng(seed).normal(0, 1.0, (len(points), 2))
        pixels = by.project(points)[0] + noise
        found = calibrate(NAMES, points, pixels, bare(by), find_focal=False)
        T = found.camera.T_world_camera
        off.append(T[:3, 3] - by.T_world_camera[:3, 3])
        reported.append(found.position_error)
        assert rotation_angle(T[:3, :3].T @ by.T_world_camera[:3, :3]) < 0.02
        assert 0.4 < found.rms < 2.5
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all(spread < 2.0 * np.mean(reported, axis=0)) and np.all(
        spread > 0.4 * np.mean(reported, axis=0)
    )
    print(f"1 pixel: {1e3 * spread} mm, told {1e3 * np.mean(reported, axis=0)} mm")


def test_wrong_points_are_named_and_excluded(points: Array) -> None:
    by = camera("barrel", (1280, 800))
    pixels = by.project(points)[0] + np.random.default_rng(0).normal(0, 0.5, (len(points), 2))
    exact = calibrate(NAMES, points, pixels, bare(by), find_focal=False)
    assert exact.used.all()
    wrong = pixels.copy()
    wrong[3] += [40, -25]
    wrong[[5, 7]] = wrong[[7, 5]]  # swapped names
    found = calibrate(NAMES, points, wrong, bare(by), find_focal=False)
    assert np.flatnonzero(~found.used).tolist() == [3, 5, 7]
    assert np.linalg.norm(found.errors[3] + [40, -25]) < 4
    assert found.rms < 1.5
    assert np.abs(found.camera.T_world_camera - by.T_world_camera)[:3, 3].max() < 0.02


@pytest.mark.thorough
def test_focal_length_is_found_without_intrinsics(points: Array) -> None:
    by = camera("none", (1280, 800))
    by.matrix[1, 1] = by.matrix[0, 0]
    by.matrix[:2, 2] = [639.5, 399.5]
    pixels = by.project(points)[0]
    lens = bare(by)
    lens.matrix[[0, 1], [0, 1]] = 1.0
    true = 0.62 * 1280
    found = calibrate(NAMES, points, pixels, lens, find_focal=True)
    assert found.camera.matrix[0, 0] == pytest.approx(true, rel=1e-3)
    noise = np.random.default_rng(0).normal(0, 0.5, pixels.shape)
    found = calibrate(NAMES, points, pixels + noise, lens, find_focal=True)
    assert abs(found.camera.matrix[0, 0] - true) < 4 * found.focal_error < 0.3 * true


def test_impossible_calibrations_are_rejected(points: Array) -> None:
    by = camera("none", (1280, 800))
    pixels = by.project(points)[0]

    def message(index: list[int], *, find_focal: bool = False, of: Array = points) -> str:
        seen = by.project(of)[0]
        with pytest.raises(UsageError) as caught:
            names = [NAMES[k] for k in index]
            calibrate(names, of[index], seen[index], bare(by), find_focal=find_focal)
        return str(caught.value)

    assert message([0, 4, 7]) == "found 3 points; the camera pose needs 4 or more"
    assert message([0, 1, 4, 7, 8], find_focal=True) == (
        "found 5 points; pose and focal length of the camera need 6 or more, or --camera-file "
        "with intrinsics and 4 points"
    )
    upright = np.array([[0, 0, 0.1 * k] for k in range(12)])
    assert "the points are on one line" in message([0, 2, 4, 6, 8], of=upright)
    # Far away and small, a plane looks the same from two sides.
    flat = np.array([[0.02 * (k % 3), 0.02 * (k // 3), 0.4] for k in range(12)])
    with pytest.raises(UsageError, match="the points are in one plane, and two cameras fit"):
        near = by.project(flat)[0] + np.random.default_rng(0).normal(0, 1.0, (12, 2))
        calibrate(["p"] * 12, flat, near, bare(by), find_focal=False)
    assert "are in one plane, whose distance is unknown" in message(
        [*range(9)], find_focal=True, of=flat
    )
    rng = np.random.default_rng(0)
    mixed = pixels[rng.permutation(len(pixels))]
    random = rng.uniform(0, [1280, 800], pixels.shape)
    unseen = {
        "reason": "no camera fits the points",
        "expected": "the pose of the robot in the photo, and the correct names of points",
    }
    behind = {
        "reason": "base would be behind the camera",
        "expected": "points in the photo, with their correct names",
    }
    for wrong, expected in (
        (mixed, unseen),
        (np.tile(pixels[:1], (len(pixels), 1)), unseen),
        (random, unseen),
        (random[:4], behind),
    ):
        with raises_with(UsageError, **expected):
            count = len(wrong)
            calibrate(NAMES[:count], points[:count], wrong, bare(by), find_focal=False)


def test_points_are_read_from_csv_and_toml_and_errors_are_reported(
    tmp_path: Path, world: World
) -> None:
    (tmp_path / "p.csv").write_text("point,x,y,dx,dy,dz\nflange,10,20.5,0,0,0.1\nlwr/A3,30,40,,,\n")
    (tmp_path / "p.toml").write_text(
        '[[points]]\npoint = "flange"\npixel = [10, 20.5]\noffset = [0, 0, 0.1]\n'
        '[[points]]\npoint = "lwr/A3"\npixel = [30, 40]\n'
    )
    for name in ("p.csv", "p.toml"):
        found = read_points(tmp_path / name, world, (640, 400))
        assert [p.name for p in found] == ["lwr/flange", "lwr/A3"]
        assert [p.pixel.tolist() for p in found] == [[10, 20.5], [30, 40]]
        assert found[0].offset.tolist() == [0, 0, 0.1] and not found[1].offset.any()
    for text, lines in (
        ("point,x,y\nflng,10,20\nA3,900,20\nA3,a,b\n", [
            "p.csv:2: no frame or joint 'flng'; did you mean 'flange'?",
            "p.csv:3: pixel 900, 20 is outside the photo, which has 640x400 pixels",
            "p.csv:4: found 'A3,a,b'; expected the name of a point and its pixel",
        ]),
        ("name,u,v\n", [
            "p.csv:1: found columns name, u, v; expected point,x,y and optionally dx,dy,dz",
        ]),
    ):  # fmt: skip
        (tmp_path / "p.csv").write_text(text)
        with pytest.raises(DeclarationError) as caught:
            read_points(tmp_path / "p.csv", world, (640, 400))
        assert str(caught.value).replace(f"{tmp_path}/", "").splitlines() == lines
    (tmp_path / "p.toml").write_text('[[points]]\npoint = "A3"\npixl = [1, 2]\n')
    with pytest.raises(DeclarationError) as caught:
        read_points(tmp_path / "p.toml", world, (640, 400))
    required, unknown = caught.value.problems
    assert required.file == unknown.file == str(tmp_path / "p.toml")
    assert (unknown.key, unknown.line, unknown.reason) == ("points.0.pixl", 3, "unknown key")
    assert unknown.near == "pixel"
    assert (required.key, required.reason) == ("points.0.pixel", "is required")


def run(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    out, err = capsys.readouterr()
    return int(ended.value.code or 0), out, err


def test_calibrate_prints_every_point_and_writes_the_camera(
    tmp_path: Path,
    points: Array,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    by = camera("barrel", (640, 400))
    write_camera(Path("lens.yaml"), bare(by))
    Image.fromarray(np.zeros((400, 640, 3), np.uint8)).save("p.png")
    pixels = by.project(points)[0]
    pixels[4] += 30
    rows = [
        f"{name},{x},{y},{','.join(map(str, offset))}"
        for name, (x, y), offset in zip(NAMES, pixels, OFFSETS, strict=True)
    ]
    Path("p.csv").write_text("\n".join(["point,x,y,dx,dy,dz", *rows]))
    pose = ["--robot", "lwr", "--joint-angles", ",".join(map(str, POSE))]
    line = ["calibrate", "p.png", *pose, "--points", "p.csv", "--camera-file", "lens.yaml"]
    status, out, _ = run([*line, "-o", "cell.toml"], capsys)
    assert status == 0
    assert "root mean square error of 11 points: 0.00 pixels" in out
    (wrong,) = [row for row in out.splitlines() if "ignored" in row]
    assert "lwr/A3" in wrong and "42.4" in wrong
    found = read_camera(Path("cell.toml"), (640, 400))
    assert np.abs(found.T_world_camera - by.T_world_camera).max() < 1e-4
    status, out, _ = run([*line, "--json"], capsys)
    assert np.allclose(json.loads(out)["T_world_camera"], found.T_world_camera, atol=1e-6)
    status, out, _ = run(["calibrate", "p.png", *pose, "--names"], capsys)
    assert status == 0 and "lwr/flange" in out.split()
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    status, _, err = run(["calibrate", "p.png", *pose], capsys)
    assert status == 2 and "no display for a window in which to click points" in err
    status, _, err = run(["calibrate", "p.png", "--robot", "justin", "--joint-angles", "1",
                          "--points", "p.csv"], capsys)  # fmt: skip
    assert (
        status == 2 and "--joint-angles is for a single robot, but 'justin' has justin_torso" in err
    )


@pytest.mark.thorough
def test_pose_can_come_from_a_recording(
    tmp_path: Path,
    points: Array,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    by = camera("none", (640, 400))
    write_camera(Path("lens.toml"), bare(by))
    Image.fromarray(np.zeros((400, 640, 3), np.uint8)).save("p.png")
    rows = [
        f"{name},{x},{y},{','.join(map(str, offset))}"
        for name, (x, y), offset in zip(NAMES, by.project(points)[0], OFFSETS, strict=True)
    ]
    Path("p.csv").write_text("\n".join(["point,x,y,dx,dy,dz", *rows]))
    scene = load_scene("lwr_udp")
    source = wire(scene).sources["udp"]
    packed = [
        source.layout.encode({"values0": np.array(pose), "values1": np.zeros(7)})
        for pose in (np.zeros(7), POSE)
    ]
    with record_sources({"udp": source}, tmp_path / "run.mcap", scene=scene) as recorder:
        begin = recorder.clock.monotonic_ns / 1e9
        source._tap(*pad_packets(packed, source.size), begin + np.array([0.0, 1.0]))  # type: ignore[misc]
    line = ["calibrate", "p.png", "--robot", "lwr_udp", "--points", "p.csv", "--json",
            "--camera-file", "lens.toml"]  # fmt: skip
    status, out, _ = run([*line, "--replay", "run.mcap", "--start", "1"], capsys)
    assert status == 0 and json.loads(out)["rms"] < 1e-2
    status, _, err = run([*line, "--replay", "run.mcap"], capsys)
    assert status == 2 and "no camera fits the points" in err
    status, _, err = run([*line, "--start", "1"], capsys)
    assert status == 2 and "--start needs a recording: add --replay REC.mcap" in err
