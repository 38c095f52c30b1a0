"""Camera files of OpenCV, ROS and ours: reading them, and their errors."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from photos import LENSES, camera

from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.extensions.photo.camera_file import read_camera, read_intrinsics, write_camera
from sero_mj.extensions.photo.photo_camera import PhotoCamera

FRAME = "frame: {xyz: [1, 2, 0.5], quat: [0.5, -0.5, 0.5, -0.5]}\n"
ROS = """\
image_width: 640
image_height: 480
camera_name: cell
camera_matrix:
  rows: 3
  cols: 3
  data: [500.5, 0, 320, 0, 501, 240.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0.05, 1e-04, 0.0002, 0.0]
rectification_matrix: {rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}
"""
INFO = """\
header: {stamp: 0, frame_id: cell}
height: 480
width: 640
distortion_model: "rational_polynomial"
D: [0.3, -0.1, 0.0005, 0.0002, 0.02, 0.5, -0.05, 0.01]
K: [500.5, 0.0, 320.0, 0.0, 501.0, 240.5, 0.0, 0.0, 1.0]
P: [500.5, 0.0, 320.0, 0.0, 0.0, 501.0, 240.5, 0.0, 0.0, 0.0, 1.0, 0.0]
"""
TOML = """\
image_width = 640
image_height = 480
camera_matrix = [[500.5, 0, 320], [0, 501, 240.5], [0, 0, 1]]
frame = { xyz = [1, 2, 0.5], rpy_deg = [-90, 0, 90] }
"""
MATRIX = [[500.5, 0, 320], [0, 501, 240.5], [0, 0, 1]]


@pytest.mark.parametrize(
    ("name", "text", "model", "distortion"),
    [
        ("c.yaml", ROS + FRAME, "plumb_bob", [-0.2, 0.05, 1e-4, 2e-4, 0.0]),
        ("c.yml", INFO + FRAME, "rational_polynomial", LENSES["rational"][1]),
        ("c.toml", TOML, "plumb_bob", []),
    ],
)
def test_camera_files_of_ros_and_ours_are_read(
    name: str, text: str, model: str, distortion: list[float], tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    found = read_camera(tmp_path / name, (640, 480))
    assert np.array_equal(found.matrix, MATRIX) and (found.width, found.height) == (640, 480)
    assert found.model == model and np.allclose(found.distortion, distortion)
    assert found.T_world_camera[:3, 3].tolist() == [1, 2, 0.5]
    if name == "c.toml":
        # Rotated by -90 degrees about x, then by 90 about z.
        expected = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]]).astype(float)
        assert np.allclose(found.T_world_camera[:3, :3], expected)


def test_file_written_by_opencv_is_read(tmp_path: Path) -> None:
    path = tmp_path / "opencv.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("calibration_time", "now")
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array(MATRIX))
    storage.write("distortion_coefficients", np.array([[-0.2, 0.05, 1e-4, 2e-4, 1e-9]]))
    storage.release()
    assert path.read_text().startswith("%YAML")
    found = read_intrinsics(path)
    assert np.array_equal(found.matrix, MATRIX)
    assert found.distortion.tolist() == [-0.2, 0.05, 1e-4, 2e-4, 1e-9]
    # A file of ours declares the pose and names theirs.
    (tmp_path / "cell.toml").write_text('intrinsics = "opencv.yml"\nframe = { xyz = [0, 0, 1] }\n')
    placed = read_camera(tmp_path / "cell.toml", (640, 480))
    assert np.array_equal(placed.matrix, MATRIX) and placed.T_world_camera[2, 3] == 1.0


def test_distortion_that_folds_the_corners_is_reported_and_not_drawn(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    wide = np.array([-0.31, 0.1, 0.0005, 0.0003, -0.014])
    matrix = np.array([[640.0, 0, 640], [0, 640, 360], [0, 0, 1]])
    write_camera(tmp_path / "c.toml", PhotoCamera(1280, 720, matrix, np.eye(4), wide))
    by = read_camera(tmp_path / "c.toml")
    assert "the coefficients are invalid in 5.9 % of the image, at the edges" in caplog.text
    rays = by.undistort(np.array([[0.0, 0.0], [640, 360], [1279, 360], [640, 719]]))
    assert np.isnan(rays[0]).all() and np.isfinite(rays[1:]).all()
    # Points beyond the fold stay outside of the drawable area.
    away = by.distort(np.array([[x, 0.0] for x in np.linspace(0, 50, 300)]))[:, 0]
    assert (np.diff(away) > 0).all() and away[-1] > 1280


def test_toml_lens_without_distortion_needs_no_opencv_or_yaml(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cv2", "yaml"):
        monkeypatch.setitem(sys.modules, name, None)
    (tmp_path / "c.toml").write_text(TOML)
    by = read_camera(tmp_path / "c.toml")
    assert by.project(np.array([[1.0, 3.0, 0.5]]))[1].shape == (1,)
    (tmp_path / "d.toml").write_text(TOML + "distortion_coefficients = [-0.2, 0.05, 0, 0]\n")
    with pytest.raises(UsageError, match=r"OpenCV is required .*`pip install 'sero-mj\[camera\]'`"):
        read_camera(tmp_path / "d.toml")
    (tmp_path / "c.yaml").write_text(ROS + FRAME)
    with pytest.raises(UsageError, match=r"YAML needs PyYAML .*, or use TOML"):
        read_camera(tmp_path / "c.yaml")


@pytest.mark.parametrize("name", ["c.toml", "c.yaml"])
@pytest.mark.parametrize("lens", LENSES)
def test_written_camera_is_read_back(lens: str, name: str, tmp_path: Path) -> None:
    by = camera(lens)
    write_camera(tmp_path / name, by, "a note\nof two lines")
    found = read_camera(tmp_path / name)
    assert np.array_equal(found.matrix, by.matrix) and found.model == by.model
    assert np.array_equal(found.distortion, by.distortion)
    assert np.allclose(found.T_world_camera, by.T_world_camera, atol=1e-8)
    assert (tmp_path / name).read_text().startswith("# a note\n# of two lines\n")


@pytest.mark.parametrize(
    ("name", "text", "problems"),
    [
        ("c.yaml", FRAME, [
            "camera_matrix is required: fx, 0, cx, 0, fy, cy, 0, 0, 1 in pixels from a "
            "camera calibration",
            "image_width is required: the size of the images in pixels",
            "image_height is required: the size of the images in pixels",
        ]),
        ("c.yaml", ROS, [
            "frame is required: the pose of the camera in the world, 4 x 4 or { xyz = [...], "
            "quat = [...] }, with x to the right, y down and z forward; `sero-mj calibrate` "
            "computes it",
        ]),
        ("c.yaml", ROS.replace("plumb_bob", "plum_bob") + FRAME,
         ["distortion_model: found 'plum_bob'; did you mean 'plumb_bob'?; there are plumb_bob, "
          "rational_polynomial, equidistant"]),
        ("c.yaml", ROS.replace("plumb_bob", "equidistant") + FRAME,
         ["distortion_coefficients: found 5; expected 4 coefficients of the model equidistant"]),
        ("c.yaml", ROS.replace("500.5", "0") + FRAME,
         ["camera_matrix: found fx = 0, fy = 501 (not calibrated); expected "
          "focal lengths above 0 pixels"]),
        ("c.yaml", ROS.replace("500.5, 0,", "500.5, 3,") + FRAME,
         ["camera_matrix: found a skew of 3; expected 0, as in OpenCV"]),
        ("c.yaml", ROS.replace("0, 0, 1]\ndis", "0, 0]\ndis") + FRAME,
         ["camera_matrix: found 8 numbers; expected 3 x 3"]),
        ("c.yaml", ROS.replace("[-0.2", "[.nan") + FRAME, ["distortion_coefficients: found "]),
        ("c.yaml", ROS.replace("-0.2, 0.05", "-0.9, 0.0") + FRAME,
         ["distortion_coefficients are invalid in "]),
        ("c.yaml", ROS + FRAME.replace("quat: [0.5,", "quat: ["),
         ["frame: 'quat' has 3 numbers; expected 4"]),
        ("c.yaml", ROS + "frame: [[1, 0, 0, 0]]\n", ["frame: found 4 numbers; expected 4 x 4"]),
        ("c.yaml", "a: [1,\nb: }", [":2: not valid YAML: "]),
        ("c.yaml", "just words", ["found no table; expected camera_matrix"]),
        ("c.toml", TOML.replace("camera_matrix", "camera_matrx"),
         ["camera_matrx: unknown key; did you mean 'camera_matrix'?"]),
        ("c.toml", TOML.replace("640", "0"), ["image_width: found 0; expected 1 to 16384 pixels"]),
        ("c.txt", TOML, ["expected a camera file with a name that ends in .yaml, .yml, .toml"]),
    ],
)  # fmt: skip
def test_all_errors_in_a_camera_file_are_reported_at_once(
    name: str, text: str, problems: list[str], tmp_path: Path
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(DeclarationError) as caught:
        read_camera(tmp_path / name)
    lines = str(caught.value).replace(str(tmp_path / name), "").splitlines()
    assert len(lines) == len(problems)
    for line, problem in zip(lines, problems, strict=True):
        assert problem in line
