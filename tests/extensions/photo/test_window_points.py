"""Clicking points of the robot in a photo: the board without a window, and the window."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from photos import camera, lwr
from PIL import Image, ImageGrab
from window_tools import MISSING, screen

from sero_mj import Placer, Scene, World
from sero_mj.base.frames import Array
from sero_mj.extensions.photo.calibration import point_of, points_apart
from sero_mj.extensions.photo.camera_file import read_camera, write_camera
from sero_mj.extensions.photo.photo_camera import PhotoCamera
from sero_mj.extensions.photo.point_board import PointBoard

SIZE = (1000, 640)
PHOTO = (640, 400)


def robot(by: PhotoCamera) -> tuple[list[str], Array, Array]:
    """Returns names of points, the points, and their pixels in the camera image."""
    world = World(Scene(robots=[lwr(joint_angles=[0.3, 0.6, 0.5, -1.3, 0.8, 0.9, 0.0])]))
    data = world.make_data()
    Placer(world).place(data)
    names = points_apart(world, data)
    points = np.array([point_of(world, data, name, np.zeros(3)) for name in names])
    return names, points, by.project(points)[0]


def make_board(find_focal: bool = False) -> tuple[PointBoard, Array]:
    by = camera("none", PHOTO)
    names, points, pixels = robot(by)
    lens = PhotoCamera(*PHOTO, by.matrix, np.eye(4))
    photo = np.full((PHOTO[1], PHOTO[0], 3), 128, np.uint8)
    board = PointBoard(photo, names, points, lens, find_focal=find_focal)
    board.resize(*SIZE, 18)
    return board, pixels


def on_board(board: PointBoard, pixel: Array) -> tuple[float, float]:
    x, y = board._to_board(pixel)
    return float(x), float(y)


def test_points_are_listed_from_base_to_flange_without_duplicates() -> None:
    names, points, _ = robot(camera("none", PHOTO))
    assert names[0] == "lwr/base" and names[-1] == "lwr/flange"
    assert names[1:-1] == [f"lwr/{joint}" for joint in ("A1", "A2", "E1", "A3", "A4", "A5", "A6")]
    apart = np.linalg.norm(points[:, None] - points, axis=2) + np.eye(len(points))
    assert apart.min() > 1e-3


def test_each_click_sets_the_next_point_and_the_fourth_finds_the_camera() -> None:
    board, pixels = make_board()
    for k in range(3):
        assert board.chosen == k
        board.click(*on_board(board, pixels[k]))
    assert board.found is None and "found 3 points" in board.message
    for k in range(3, 7):
        board.click(*on_board(board, pixels[k]))
    assert board.found is not None and board.found.rms < 1e-3
    assert np.allclose(board.clicked[4], pixels[4])
    expected = camera("none", PHOTO).T_world_camera
    assert np.abs(board.found.camera.T_world_camera - expected).max() < 1e-4
    # A wrong click is named. Once it is removed, the result is right again.
    board.click(*on_board(board, pixels[7] + [40, 10]))
    assert not board.found.used[7] and board.message.endswith(", without lwr/A6")
    board.press("backspace")
    assert board.chosen == 7 and 7 not in board.clicked and board.found.used.all()


def test_photo_is_zoomed_about_the_pointer_and_panned_with_it() -> None:
    board, pixels = make_board()
    at = on_board(board, pixels[3])
    board.zoom(8, *at)
    assert np.allclose(board._to_photo(np.array(at)), pixels[3])
    board.pan(30.0, -20.0)
    moved = board._to_board(pixels[3])
    assert np.allclose(moved - at, [30, -20])
    board.chosen = 3
    board.click(*moved.tolist())
    assert np.allclose(board.clicked[3], pixels[3])
    board.zoom(-50, *at)
    corner = board._to_board(np.array([-0.5, -0.5]))
    assert corner[0] == pytest.approx(board.panel_width - 0.5, abs=1)


def test_clicks_on_the_list_select_and_those_beside_the_photo_do_nothing() -> None:
    board, _ = make_board()
    first = 2.4 * 1.25 * 18
    board.click(20, first + 1.25 * 18 * 4.5)
    assert board.chosen == 4 and not board.clicked
    board.click(board.panel_width + 5, 5)  # above the photo
    assert not board.clicked
    board.press("up")
    assert board.chosen == 3


def test_image_shows_photo_marks_and_list_at_any_size() -> None:
    board, pixels = make_board()
    for k in range(6):
        board.click(*on_board(board, pixels[k]))
    picture = board.image().astype(int)
    assert picture.shape == (SIZE[1], SIZE[0], 3)
    x, y = np.rint(on_board(board, pixels[2])).astype(int)
    around = picture[y - 12 : y + 13, x - 12 : x + 13]
    assert (around[..., 0] - around[..., 2] > 100).sum() > 15  # its cross
    assert (around[..., 1] - around[..., 0] > 80).sum() > 5  # where the camera sees it
    assert (picture[:, board.panel_width + 30 :] == 128).all(axis=2).mean() > 0.5
    for size in ((300, 200), (1, 1), (3000, 200)):
        board.resize(*size, 18)
        assert board.image().shape == (size[1], size[0], 3)
    board.zoom(30, 2000, 100)
    board.image()


@pytest.mark.gl
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}")
@pytest.mark.thorough
def test_camera_is_found_by_clicks_in_a_window(tmp_path: Path) -> None:
    by = camera("none", PHOTO)
    _, _, pixels = robot(by)
    write_camera(tmp_path / "lens.toml", PhotoCamera(*PHOTO, by.matrix, np.eye(4)))
    Image.fromarray(np.full((PHOTO[1], PHOTO[0], 3), (90, 140, 90), np.uint8)).save(
        tmp_path / "p.png"
    )
    board, _ = make_board()
    with screen() as display:
        here = {**os.environ, "DISPLAY": display, "PYTHONPATH": str(ROOT)}
        here.pop("WAYLAND_DISPLAY", None)
        process = subprocess.Popen(
            [sys.executable, "-m", "sero_mj", "calibrate", "p.png", "--robot", "lwr",
             "--joint-angles", "0.3,0.6,0.5,-1.3,0.8,0.9,0", "--camera-file", "lens.toml",
             "-o", "cell.toml"], cwd=tmp_path, env=here, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

        def tool(*arguments: object) -> str:
            return subprocess.run(
                ["xdotool", *map(str, arguments)], env=here, check=True, timeout=20,
                capture_output=True, text=True,
            ).stdout  # fmt: skip

        try:
            (window,) = tool("search", "--sync", "--onlyvisible", "--name", "calibrate").split()
            shape = dict(
                line.split("=") for line in tool("getwindowgeometry", "--shell", window).split()
            )
            board.resize(int(shape["WIDTH"]), int(shape["HEIGHT"]), 18)
            left, top = int(shape["X"]), int(shape["Y"])

            def shown() -> Array:
                return np.asarray(ImageGrab.grab(xdisplay=display)).astype(int)

            x, y = (round(value) for value in on_board(board, np.array([10.0, 10.0])))
            end = time.monotonic() + 20
            while tuple(shown()[top + y, left + x]) != (90, 140, 90) and time.monotonic() < end:
                tool("sleep", 0.05)
            for pixel in pixels[:7]:
                at = [round(value) for value in on_board(board, pixel)]
                tool("mousemove", left + at[0], top + at[1], "click", 1, "sleep", 0.1)
            tool("key", "Return")
            out, _ = process.communicate(timeout=20)
        finally:
            process.kill()
            process.wait()
    assert process.returncode == 0
    assert "of 7 points" in out and "cell_points.csv" in out
    found = read_camera(tmp_path / "cell.toml", PHOTO)
    assert np.abs(found.T_world_camera - by.T_world_camera)[:3, 3].max() < 0.05
    assert (tmp_path / "cell_points.csv").read_text().count("lwr/") == 7
