"""Camera files: intrinsics and pose of a camera in the formats of OpenCV, ROS and sero-mj.

- YAML files of OpenCV (`FileStorage`) have the keys `camera_matrix`, `distortion_coefficients`,
  `image_width` and `image_height`, and `fisheye_model: 1` for fisheye lenses.
- YAML files of ROS have the same keys and `distortion_model`. Matrices have `rows`, `cols` and
  `data`. Messages `camera_info` (`K`, `D`, `width`, `height`) are also supported.
- TOML files have the same keys with lists, or `intrinsics = "camera.yaml"` for a YAML file.

Each file can declare T_world_camera as `frame`, in the same form as in scenes: 4 x 4 numbers, or a
table of `xyz` (m) and `quat` (w, x, y, z), `rpy` or `rpy_deg`. The x axis of the camera points to
the right of the image, y points down and z forward, as in OpenCV and the optical frames of ROS.
"""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...base.declaration import numbers
from ...base.errors import (
    DeclarationError,
    Problem,
    UsageError,
    did_you_mean,
    mismatch,
    problems_of,
    shown,
)
from ...base.frames import Array, frame_from, quat_from_rotation
from ...base.paths import read_file
from ...base.toml_file import read_toml
from .photo_camera import COUNTS, MODELS, PhotoCamera

log = logging.getLogger(__name__)

ENDINGS = (".yaml", ".yml", ".toml")
_MAX_BYTES = 1_000_000
_MAX_SIDE = 16384  # maximum width and height of images, pixels
_MIN_DRAWABLE = 0.75  # minimum fraction of the image in which distortion coefficients are valid
# Lowercase names of the keys in all formats.
_KEYS = {
    "camera_matrix": ("camera_matrix", "k"),
    "distortion_coefficients": ("distortion_coefficients", "d"),
    "image_width": ("image_width", "width"),
    "image_height": ("image_height", "height"),
    "distortion_model": ("distortion_model",),
    "fisheye_model": ("fisheye_model",),
    "frame": ("frame",),
    "intrinsics": ("intrinsics",),
}
_OTHER_NAMES = {"fisheye": "equidistant", "kannala_brandt": "equidistant", "radtan": "plumb_bob"}
_REQUIRED = "is required: fx, 0, cx, 0, fy, cy, 0, 0, 1 in pixels from a camera calibration"


def read_camera(path: Path, size: tuple[int, int] | None = None) -> PhotoCamera:
    """Reads the intrinsics and the pose of a camera from a camera file.

    Args:
        size: width and height of the images, pixels (default: the size in the file).

    Raises:
        DeclarationError: the file is invalid, or is for images of another size. The exception lists
            all errors.
        UsageError: a package that is needed to read the file is not installed.
    """
    problems: list[Problem] = []
    table = _table(path)
    camera = _camera(path, table, size, problems)
    place = _place(table, problems)
    if problems or camera is None or place is None:
        raise DeclarationError([replace(each, file=str(path)) for each in problems])
    return _checked(path, camera, place)


def read_intrinsics(path: Path, size: tuple[int, int] | None = None) -> PhotoCamera:
    """Reads the intrinsics of a camera from a camera file, and ignores the pose."""
    problems: list[Problem] = []
    camera = _camera(path, _table(path), size, problems)
    if problems or camera is None:
        raise DeclarationError([replace(each, file=str(path)) for each in problems])
    return _checked(path, camera, np.eye(4))


def _checked(path: Path, camera: PhotoCamera, place: Array) -> PhotoCamera:
    made = PhotoCamera(
        camera.width, camera.height, camera.matrix, place, camera.distortion, camera.model
    )
    share = made.drawable
    if share < _MIN_DRAWABLE:
        message = (
            f"are invalid in {100 * (1 - share):.0f} % of the image, at the edges; expected "
            "a calibration with points up to the edges, in OpenCV's order k1, k2, p1, p2, k3"
        )
        raise Problem("distortion_coefficients", message, str(path)).error()
    if share < 1.0:
        log.warning(
            "%s: the coefficients are invalid in %.1f %% of the image, at the edges; nothing is "
            "drawn there", path, 100 * (1 - share),
        )  # fmt: skip
    return made


def _table(path: Path) -> dict[str, Any]:
    def wrong(message: str, key: str = "", line: int | None = None) -> DeclarationError:
        return Problem(key, message, str(path), line).error()

    if path.suffix.lower() not in ENDINGS:
        raise wrong(f"expected a camera file with a name that ends in {', '.join(ENDINGS)}")
    if path.suffix.lower() == ".toml":
        found = read_toml(path)
        known = [key for names in _KEYS.values() for key in names]
        for key in found:
            if key.lower() not in known:
                raise wrong(f"unknown key{did_you_mean(key, _KEYS)}", key)
    else:
        found = _yaml(path)
    lower = {str(key).lower(): value for key, value in found.items()}
    table = {
        ours: lower[name] for ours, names in _KEYS.items() for name in names[::-1] if name in lower
    }
    if "intrinsics" in table and isinstance(table["intrinsics"], str):
        table = {**_table(path.parent / table["intrinsics"]), **table}
    table.setdefault("_others", [*lower])
    return table


def _yaml(path: Path) -> dict[str, Any]:
    def wrong(message: str, line: int | None = None) -> DeclarationError:
        return Problem("", message, str(path), line).error()

    try:
        import yaml
    except ImportError as error:
        raise UsageError(
            f"{path}: YAML needs PyYAML ({error}): run `pip install 'sero-mj[camera]'`, or use TOML"
        ) from None

    class Loader(yaml.SafeLoader):  # type: ignore[misc]  # PyYAML has no types
        """A YAML loader that reads matrices of OpenCV as tables."""

    Loader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix",
        lambda self, node: self.construct_mapping(node, deep=True),
    )
    try:
        text = read_file(path, _MAX_BYTES).decode("utf-8-sig")
        # The first line of files from OpenCV is not valid YAML.
        found = yaml.load(re.sub(r"\A%YAML:[\d.]+", "", text), Loader)
    except FileNotFoundError:
        raise wrong("no such file") from None
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise wrong(f"is not UTF-8 text (byte {error.start})") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        what = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise wrong(f"not valid YAML: {what}", None if mark is None else mark.line + 1) from error
    if not isinstance(found, dict):
        raise wrong("found no table; expected camera_matrix, distortion_coefficients, image_width")
    return found


def _numbers(value: Any) -> Array:
    if isinstance(value, Mapping):
        if "data" not in value:
            raise ValueError(f"found {', '.join(map(str, value))}; expected rows, cols and data")
        data = _numbers(value["data"])
        shape = [value[key] for key in ("rows", "cols") if isinstance(value.get(key), int)]
        if len(shape) == 2 and np.prod(shape) != data.size:
            raise mismatch(data.size, f"{shape[0]} x {shape[1]}", of="numbers")
        return data
    if isinstance(value, list) and any(isinstance(each, str) for each in value):
        with contextlib.suppress(ValueError):  # PyYAML reads numbers such as 1e-05 as strings
            value = [float(each) for each in value]
    return numbers(value)


def _camera(
    path: Path, table: dict[str, Any], size: tuple[int, int] | None, problems: list[Problem]
) -> PhotoCamera | None:
    matrix = _matrix(table, problems)
    model, distortion = _distortion(table, problems)
    sides: list[int] = []
    for axis, key in enumerate(("image_width", "image_height")):
        found = table.get(key)
        if found is None and size is not None:
            found = size[axis]
        if found is None:
            problems.append(Problem(key, "is required: the size of the images in pixels"))
        elif type(found) not in (int, float) or found % 1 or not 1 <= found <= _MAX_SIDE:
            problems.append(Problem(key, found=found, expected=f"1 to {_MAX_SIDE} pixels"))
        else:
            sides.append(int(found))
    if len(sides) == 2 and size is not None and tuple(sides) != size:
        message = (
            f"found {sides[0]}x{sides[1]}, but the image is {size[0]}x{size[1]}; expected a camera "
            "file for images of this size (cropped or resized images have other intrinsics)"
        )
        problems.append(Problem("image_width", message))
    if matrix is None or model is None or len(sides) < 2 or problems:
        return None
    centre = matrix[:2, 2] / sides
    if (centre < -1).any() or (centre > 2).any():
        expected = f"a center near the image of {sides[0]}x{sides[1]} pixels"
        found = f"found the center at pixel {matrix[0, 2]:g}, {matrix[1, 2]:g}"
        problems.append(Problem("camera_matrix", found, expected=expected))
        return None
    return PhotoCamera(sides[0], sides[1], matrix, np.eye(4), distortion, model)  # type: ignore[arg-type]


def _matrix(table: dict[str, Any], problems: list[Problem]) -> Array | None:
    def wrong(message: str) -> None:
        problems.append(Problem("camera_matrix", message))

    if table.get("camera_matrix") is None:
        others = [key for key in table["_others"] if "matrix" in key or key in ("p", "projection")]
        near = f"; found '{others[0]}'" if others else ""
        wrong(_REQUIRED + near)
        return None
    try:
        matrix = _numbers(table["camera_matrix"])
    except ValueError as error:
        wrong(str(error))
        return None
    if matrix.size != 9:
        wrong(f"found {matrix.size} numbers; expected 3 x 3: fx, 0, cx, 0, fy, cy, 0, 0, 1")
        return None
    matrix = matrix.reshape(3, 3).copy()
    if matrix[2].tolist() != [0.0, 0.0, 1.0] or matrix[1, 0] != 0.0:
        wrong(
            f"found {matrix.ravel().tolist()}; expected fx, 0, cx, 0, fy, cy, 0, 0, 1 (row-major)"
        )
    elif matrix[0, 1] != 0.0:
        wrong(f"found a skew of {matrix[0, 1]:g}; expected 0, as in OpenCV")
    elif min(matrix[0, 0], matrix[1, 1]) <= 0:
        found = f"fx = {matrix[0, 0]:g}, fy = {matrix[1, 1]:g}"
        wrong(f"found {found} (not calibrated); expected focal lengths above 0 pixels")
    else:
        return matrix
    return None


def _distortion(table: dict[str, Any], problems: list[Problem]) -> tuple[str | None, Array]:
    none = np.zeros(0)
    try:
        found = table.get("distortion_coefficients")
        distortion = none if found is None or found == [] else _numbers(found).ravel()
    except ValueError as error:
        problems += problems_of(error, "distortion_coefficients")
        return None, none
    model = table.get("distortion_model") or None
    if model is None and table.get("fisheye_model"):
        model = "equidistant"
    if model is None:  # files of OpenCV do not state the model
        model = "plumb_bob" if distortion.size <= 5 else "rational_polynomial"
    if not isinstance(model, str) or _OTHER_NAMES.get(model.lower(), model.lower()) not in MODELS:
        near = did_you_mean(str(model), (*MODELS, *_OTHER_NAMES))
        problems.append(
            Problem(
                "distortion_model",
                f"found {shown(model)}{near}"
                + ("" if "available" in near else f"; there are {', '.join(MODELS)}"),
            )
        )
        return None, none
    model = _OTHER_NAMES.get(model.lower(), model.lower())
    if not distortion.any() and model != "equidistant":
        return model, none
    if distortion.size not in COUNTS[model]:
        counts = " or ".join(map(str, COUNTS[model]))
        problems.append(
            Problem(
                "distortion_coefficients",
                found=distortion.size,
                expected=f"{counts} coefficients of the model {model}",
            )
        )
        return None, none
    return model, distortion


def _place(table: dict[str, Any], problems: list[Problem]) -> Array | None:
    if table.get("frame") is None:
        message = (
            "is required: the pose of the camera in the world, 4 x 4 or { xyz = [...], quat = "
            "[...] }, with x to the right, y down and z forward; `sero-mj calibrate` computes it"
        )
        problems.append(Problem("frame", message))
        return None
    found = table["frame"]
    try:
        if isinstance(found, Mapping) and "data" in found:
            found = _numbers(found)
        return frame_from(found, _numbers)
    except ValueError as error:
        problems += problems_of(error, "frame")
        return None


def write_camera(path: Path, camera: PhotoCamera, note: str = "") -> None:
    """Writes a camera file as TOML, or as YAML in the format of ROS with the additional `frame`."""
    if path.suffix.lower() not in ENDINGS:
        raise UsageError(f"{path}: expected a name that ends in {', '.join(ENDINGS)}")
    text = "".join(f"# {line}\n" for line in note.splitlines())
    text += _as_toml(camera) if path.suffix.lower() == ".toml" else _as_yaml(camera)
    try:
        path.write_text(text, "utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {path}: {error.strerror}") from error


def _list(values: Array) -> str:
    return f"[{', '.join(repr(float(value)) for value in np.ravel(values))}]"


def _parts(camera: PhotoCamera) -> tuple[str, str]:
    T = camera.T_world_camera
    return _list(T[:3, 3].round(9)), _list(quat_from_rotation(T[:3, :3]).round(12))


def _as_toml(camera: PhotoCamera) -> str:
    xyz, quat = _parts(camera)
    rows = ",\n".join(f"  {_list(row)}" for row in camera.matrix)
    return (
        f"image_width = {camera.width}\nimage_height = {camera.height}\n"
        f"camera_matrix = [\n{rows},\n]\n"
        f'distortion_model = "{camera.model}"\n'
        f"distortion_coefficients = {_list(camera.distortion)}\n"
        f"# In the world: x to the right of the image, y down, z forward; m, and w, x, y, z.\n"
        f"frame = {{ xyz = {xyz}, quat = {quat} }}\n"
    )


def _as_yaml(camera: PhotoCamera) -> str:
    xyz, quat = _parts(camera)
    count = camera.distortion.size
    return (
        f"image_width: {camera.width}\nimage_height: {camera.height}\n"
        f"camera_name: camera\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {_list(camera.matrix)}\n"
        f"distortion_model: {camera.model}\n"
        f"distortion_coefficients:\n  rows: 1\n  cols: {count}\n"
        f"  data: {_list(camera.distortion)}\n"
        f"# In the world: x to the right of the image, y down, z forward; m, and w, x, y, z.\n"
        f"frame:\n  xyz: {xyz}\n  quat: {quat}\n"
    )
