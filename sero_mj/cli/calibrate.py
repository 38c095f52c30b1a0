"""`sero-mj calibrate`: finds where a camera is, from points of the robot in a photo."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UsageError
from ._arguments import (
    Commands,
    add_command,
    add_package_option,
    add_set_option,
    check_ending,
    numbers,
    print_json,
    print_table,
    read_scene,
)

if TYPE_CHECKING:
    from ..show.calibration import Calibration, ClickedPoint

_EPILOG = """\
examples:
  sero-mj calibrate photo.png --robot lwr --names
  sero-mj calibrate photo.png --robot lwr --joint-angles 0,0.5,0,-1.5,0,1,0 \\
      --points points.csv --camera-file intrinsics.yaml -o cell.toml
  sero-mj render lwr_udp -o now.png --over photo.png --camera-file cell.toml

points.csv says which pixel (counted from 0 at the upper left) shows which point of the robot, a
frame or a joint (the middle of its axis), perhaps with an offset in m along the frame's axes:

  point,x,y,dx,dy,dz
  lwr/flange,612,301,0,0,0
  lwr/A3,410,255,0.06,0,0

With intrinsics (--camera-file, OpenCV's or ROS's) 4 points do, 8 are better; without them the focal
length is found from 6 or more, for a lens without distortion.
"""


def add_to(commands: Commands) -> None:
    """Adds the command."""
    summary = "find where a camera is, from points of the robot in a photo"
    parser = add_command(commands, "calibrate", run, summary, _EPILOG)
    parser.add_argument("photo", metavar="PHOTO", type=Path, help="what the camera has taken")
    parser.add_argument(
        "--robot", required=True, metavar="SCENE", help="robot or scene: a file, or a shipped name"
    )
    parser.add_argument(
        "--joint-angles", metavar="Q", help="of the robot in the photo, with commas, rad or m"
    )
    parser.add_argument(
        "--points", type=Path, metavar="FILE", help="which pixel shows which point; .csv or .toml"
    )
    parser.add_argument(
        "--camera-file", type=Path, metavar="FILE", help="the camera's intrinsics; YAML or TOML"
    )
    parser.add_argument(
        "-o", "--output", type=Path, metavar="OUT", help="camera file to write; .yaml or .toml"
    )
    parser.add_argument("--names", action="store_true", help="print the points' names, and end")
    parser.add_argument("--json", action="store_true", help="print JSON")
    add_package_option(parser)
    add_set_option(parser, "ROBOT.FIELD=VALUE", "set a field over the scene's; may be repeated")


def run(options: argparse.Namespace) -> int:
    """Finds the camera; returns 0."""
    from ..assemble.world import World
    from ..drive.place import Placer
    from ..show.calibration import calibrate, point_names, point_of, read_points
    from ..show.camera_file import ENDINGS, read_intrinsics, write_camera
    from ..show.footage import read_photo
    from ..show.photo_camera import PhotoCamera

    if options.output is not None:
        check_ending(f"-o {options.output}", options.output, ENDINGS)
    settings = [*options.settings]
    scene = read_scene(options.robot, settings)
    if options.joint_angles is not None:
        if len(scene.robots) != 1:
            names = ", ".join(scene.robots)
            raise UsageError(
                f"--joint-angles is for one robot; '{options.robot}' has {names}: use "
                "--set ROBOT.joint_angles=..."
            )
        (name,) = scene.robots
        angles = numbers(options.joint_angles, "--joint-angles")
        scene = read_scene(options.robot, [*settings, f"{name}.joint_angles={angles.tolist()}"])
    world = World(scene)
    if options.names:
        print("\n".join(point_names(world)))
        return 0
    if options.points is None:
        raise UsageError("which pixel shows which point of the robot? expected --points POINTS.csv")
    pixels = read_photo(options.photo)
    size = (pixels.shape[1], pixels.shape[0])
    if options.camera_file is not None:
        lens = read_intrinsics(options.camera_file, size)
    else:
        centre = [(size[0] - 1) / 2, (size[1] - 1) / 2]
        matrix = np.array([[1.0, 0, centre[0]], [0, 1.0, centre[1]], [0, 0, 1]])
        lens = PhotoCamera(*size, matrix, np.eye(4))
    clicked = read_points(options.points, world, size)
    data = world.make_data()
    Placer(world).place(data)
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
            f"Found by sero-mj calibrate from {int(found.used.sum())} points of "
            f"{options.photo.name}, which are {found.rms:.2f} pixels off (root mean square)."
        )
        write_camera(options.output, found.camera, note)
    _report(options, clicked, found)
    return 0


def _report(options: argparse.Namespace, clicked: list[ClickedPoint], found: Calibration) -> None:
    T, off = found.camera.T_world_camera, np.linalg.norm(found.errors, axis=1)
    if options.json:
        print_json(_plain(clicked, found))
        return
    from rich.table import Table

    table = Table(box=None)
    table.add_column("point")
    for title in ("x", "y", "off"):
        table.add_column(title, justify="right")
    table.add_column("")
    for point, distance, is_used in zip(clicked, off, found.used, strict=True):
        at = [f"{value:.1f}" for value in point.pixel]
        note = "" if is_used else "left out: another point, or a wrong name?"
        table.add_row(point.name, *at, f"{distance:.2f} pixels", note)
    print_table(table)
    print(f"{found.rms:.2f} pixels root mean square, of {int(found.used.sum())} points")
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
