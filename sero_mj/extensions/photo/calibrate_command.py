"""`sero-mj calibrate`: computes the pose of a camera from points of the robot in a photo."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ...base.errors import UsageError
from ...base.options import JointValues, Option, positional
from ...cli.arguments import (
    check_ending,
    command,
    print_json,
    print_table,
    read_scene,
    replay_instead,
    until_ended,
)
from ...cli.shared_options import File, JsonOptions, ReplayOptions, SettingOptions

if TYPE_CHECKING:
    from ...robots.assemble.world import World
    from ...robots.declared.scene import Scene
    from .calibration import Calibration, ClickedPoint
    from .photo_camera import PhotoCamera

_MAX_CLICK_ERROR = 6.0  # maximum root mean square error of careful clicks, pixels
_HELP = """\
examples:
  sero-mj calibrate photo.png --robot lwr --joint-angles 0,0.5,0,-1.5,0,1,0 -o cell.toml
  sero-mj calibrate photo.png --robot lwr --joint-angles 0,0.5,0,-1.5,0,1,0 \\
      --points points.csv --camera-file intrinsics.yaml -o cell.toml
  sero-mj calibrate photo.png --robot lwr_udp --replay run.mcap --start 2 -o cell.toml

Without --points, a window shows the photo beside a list of points and a sketch of the robot. Click
the marked point in the photo. From the fourth point on, the window shows the error of each point.
Enter writes the camera file and the points.

points.csv contains points of the robot and their pixels, counted from 0 at the upper left. A point
is a frame or a joint (the middle of its axis), with an optional offset in m along the frame axes:

  point,x,y,dx,dy,dz
  lwr/flange,612,301,0,0,0
  lwr/A3,410,255,0.06,0,0

With intrinsics (--camera-file, from OpenCV or ROS), 4 points are enough and 8 are better. Without
intrinsics, the focal length is computed from 6 or more points, for a lens without distortion.
"""
GROUP, ORDER = "see", 16


class CalibrateOptions(SettingOptions, ReplayOptions, JsonOptions):
    """Compute the pose of a camera from points of the robot in a photo.

    Attributes:
        photo: photo taken by the camera.
        robot: file or included name of a robot or scene.
        joint_angles: joint angles of the robot in the photo, separated by commas, in rad or m.
        replay: take the joint angles from a recording.
        start: time of the photo in the recording, in seconds (default: the first packet).
        points: .csv or .toml file with points of the robot and their pixels.
        camera_file: YAML or TOML file with the intrinsics of the camera.
        output: camera file to write, .yaml or .toml.
        names: print the valid names of points and exit.
    """

    photo: Annotated[Path, positional("PHOTO")]
    robot: Annotated[str, Option("SCENE")]
    joint_angles: JointValues | None = None
    points: File | None = None
    camera_file: File | None = None
    output: Annotated[Path | None, Option("OUT", ("-o", "--output"))] = None
    names: bool = False


def run(options: CalibrateOptions) -> int:
    """Runs `sero-mj calibrate`, and returns exit code 0."""
    from ...viewer.image.backend import has_display

    if options.points is None and not options.names:
        if not has_display():
            raise UsageError(
                "there is no display for a window in which to click points; use --points "
                "POINTS.csv with points of the robot and their pixels"
            )
        os.environ["MUJOCO_GL"] = "glfw"  # MuJoCo uses the OpenGL context of the window
    from .calibration import calibrate, point_names, point_of, read_points, write_points
    from .camera_file import ENDINGS, write_camera
    from .footage import read_photo

    if options.output is not None:
        check_ending(f"-o {options.output}", options.output, ENDINGS)
    world, data = _pose(_scene_of_photo(options), is_replayed=options.replay is not None)
    if options.names:
        print("\n".join(point_names(world)))
        return 0
    pixels = read_photo(options.photo)
    size = (pixels.shape[1], pixels.shape[0])
    lens = _lens(options.camera_file, size)
    if options.points is not None:
        clicked = read_points(options.points, world, size)
    else:
        clicked = _click(options, world, data, pixels, lens)
    points = np.array([point_of(world, data, p.name, p.offset) for p in clicked]).reshape(-1, 3)
    found = calibrate(
        [point.name for point in clicked],
        points,
        np.array([point.pixel for point in clicked]).reshape(-1, 2),
        lens,
        find_focal=options.camera_file is None,
    )
    if options.output is not None:
        note = (
            f"Computed by sero-mj calibrate from {int(found.used.sum())} points in "
            f"{options.photo.name}, root mean square error {found.rms:.2f} pixels."
        )
        write_camera(options.output, found.camera, note)
        if options.points is None:
            write_points(_points_beside(options.output), clicked)
    _report(options, clicked, found)
    return 0


add_to = command("calibrate", run, CalibrateOptions, _HELP)


def _scene_of_photo(options: CalibrateOptions) -> Scene:
    scene = read_scene(options.robot, options.settings, replay=options.replay)
    if options.joint_angles is not None:
        if len(scene.robots) != 1:
            names = ", ".join(scene.robots)
            raise UsageError(
                f"--joint-angles is for a single robot, but '{options.robot}' has {names}: use "
                "--set ROBOT.joint_angles=..."
            )
        (name,) = scene.robots
        angles = f"{name}.joint_angles={[*options.joint_angles]}"
        settings = [*options.settings, angles]
        scene = read_scene(options.robot, settings, replay=options.replay)
    if options.replay is not None:
        replay_instead(scene, options.replay, options.start, options.source, options.columns)
    return scene


def _lens(camera_file: Path | None, size: tuple[int, int]) -> PhotoCamera:
    from .camera_file import read_intrinsics
    from .photo_camera import PhotoCamera

    if camera_file is not None:
        return read_intrinsics(camera_file, size)
    matrix = np.array([[1.0, 0, (size[0] - 1) / 2], [0, 1.0, (size[1] - 1) / 2], [0, 0, 1]])
    return PhotoCamera(*size, matrix, np.eye(4))


def _pose(scene: Scene, *, is_replayed: bool) -> tuple[World, Any]:
    from ...data.drive.mirror import Mirror
    from ...data.drive.place import Placer
    from ...robots.assemble.world import World

    if is_replayed:
        with Mirror(scene) as mirror:
            mirror.advance(0.0)
            return mirror.world, mirror.data
    world = World(scene)
    data = world.make_data()
    Placer(world).place(data)
    return world, data


def _points_beside(output: Path) -> Path:
    return output.with_name(f"{output.stem}_points.csv")


def _click(
    options: CalibrateOptions, world: Any, data: Any, pixels: Any, lens: PhotoCamera
) -> list[ClickedPoint]:
    from .calibration import ClickedPoint, point_of, points_apart
    from .point_board import PointBoard
    from .point_window import PointWindow

    names = points_apart(world, data)
    points = np.array([point_of(world, data, name, np.zeros(3)) for name in names])
    board = PointBoard(pixels, names, points, lens, find_focal=options.camera_file is None)
    title = f"{options.photo.name} - sero-mj calibrate"
    with until_ended(), PointWindow(world, data, points, board, title) as window:
        is_done = window.run()
    if not is_done:
        raise UsageError("the window was closed without pressing Enter; no file was written")
    return [
        ClickedPoint(names[k], pixel, np.zeros(3)) for k, pixel in sorted(board.clicked.items())
    ]


def _report(options: CalibrateOptions, clicked: list[ClickedPoint], found: Calibration) -> None:
    T, off = found.camera.T_world_camera, np.linalg.norm(found.errors, axis=1)
    if options.as_json:
        print_json(_plain(clicked, found))
        return
    from rich.table import Table

    table = Table(box=None)
    table.add_column("point")
    for title in ("x", "y", "error"):
        table.add_column(title, justify="right")
    table.add_column("")
    for point, distance, is_used in zip(clicked, off, found.used, strict=True):
        at = [f"{value:.1f}" for value in point.pixel]
        note = "" if is_used else "ignored; check its pixel and name"
        table.add_row(point.name, *at, f"{distance:.2f} pixels", note)
    print_table(table)
    print(f"root mean square error of {int(found.used.sum())} points: {found.rms:.2f} pixels")
    if found.rms > _MAX_CLICK_ERROR:
        print("This exceeds the error of careful clicks. Check the pose, names and intrinsics.")
    errors = ", ".join(f"{value:.1f}" for value in 1e3 * found.position_error)
    place = ", ".join(f"{value:.4f}" for value in T[:3, 3])
    print(f"camera at {place} m, standard errors {errors} mm")
    if options.camera_file is None:
        focal = found.camera.matrix[0, 0]
        print(
            f"focal length {focal:.1f} pixels, standard error {found.focal_error:.1f}; a lens "
            "without distortion is assumed"
        )
    if options.output is not None:
        print(options.output)
        if options.points is None:
            print(_points_beside(options.output))


def _plain(clicked: list[ClickedPoint], found: Calibration) -> dict[str, Any]:
    camera = found.camera
    return {
        "rms": found.rms,
        "points": [
            {"point": point.name, "off": float(np.hypot(*error)), "used": bool(is_used)}
            for point, error, is_used in zip(clicked, found.errors, found.used, strict=True)
        ],
        "T_world_camera": camera.T_world_camera.tolist(),
        "position_error": found.position_error.tolist(),
        "camera_matrix": camera.matrix.tolist(),
        "focal_error": found.focal_error,
    }
