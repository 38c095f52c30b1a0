"""Converts X3D scenes to TOML and TOML scenes to X3D, for `sero-mj export`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from ...base.declaration import changed_fields, plain
from ...base.errors import Problem, UsageError, raise_any
from ...base.frames import Array, frame, rotation_about, rotation_from_quat
from ...cli.arguments import check_new, read_scene, writing
from ...robots.assemble.link_geometry import drawn_geoms
from .importer import X3d
from .writer import face_set, shape_lines, x3d_text

if TYPE_CHECKING:
    from ...cli.export import ExportOptions
    from ...robots.declared.robot import SerialRobot
    from ...robots.declared.robot_parts import LinkGeometry
    from ...robots.declared.scene import Scene

# The values of these robot fields were converted when the robot was created.
_OTHER_FORMS = ("name", "dh_params", "dh_columns", "length_unit")
_CREASE = 0.7  # angle in rad above which edges are not smoothed, as in MuJoCo
_UPRIGHT = frame(rotation_about(0, np.pi / 2))  # Cylinder axes are z in MuJoCo and y in X3D.
Geom = mujoco.mjtGeom


def write_toml(options: ExportOptions) -> int:
    """Writes an X3D scene as TOML. Returns the exit code."""
    return _write(options, to_x3d=False)


def write_x3d(options: ExportOptions) -> int:
    """Writes a scene as X3D, and links as VRML97 in OUTPUT_links/ROBOT. Returns the exit code."""
    return _write(options, to_x3d=True)


def _write(options: ExportOptions, *, to_x3d: bool) -> int:
    options.accept("overwrite")
    output = options.path
    if to_x3d == (Path(options.scene).suffix.lower() in X3d.endings):
        both = "X3D" if to_x3d else "TOML"
        message = f"both files are {both}; expected one X3D file and one TOML file"
        raise UsageError(f"{options.scene} and {output}: {message}")
    files: dict[Path, str] = {}
    if to_x3d:
        text, lost = _as_x3d(options.scene, output, files)
    else:
        text, lost = _as_toml(options.scene, output), []
    files[output] = text
    if not options.overwrite:
        check_new(files, "use --overwrite to replace it")
    with writing():
        for path, contents in files.items():
            if path is not output:
                path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(contents, encoding="utf-8")
    if lost:
        line = f"sero-mj: X3D cannot express these parts of the scene: {', '.join(lost)}"
        print(fill(line, 100, subsequent_indent="  ", break_on_hyphens=False), file=sys.stderr)
    print(output)
    return 0


def _as_toml(name: str, output: Path) -> str:
    from ...robots.importers.toml_text import toml_text
    from .reader import read_x3d

    read_scene(name)  # This reports all errors, including those of robots and sources.
    described = read_x3d(Path(name))
    for robot in described.tables.get("robots", {}).values():
        if robot.get("directory"):
            folder = Path(name).parent / robot["directory"]
            robot["directory"] = _relative(folder, output)
    comments = [f"Converted from {Path(name).name}."]
    for warning in described.warnings:
        comments += fill(f"Note: {warning}", 98, subsequent_indent="  ").splitlines()
    return toml_text(described.tables, comments)


def _relative(folder: Path, output: Path) -> str:
    try:
        return Path(os.path.relpath(folder.absolute(), output.absolute().parent)).as_posix()
    except ValueError:  # no relative path to another drive
        return folder.absolute().as_posix()


def _as_x3d(name: str, output: Path, files: dict[Path, str]) -> tuple[str, list[str]]:
    text, lost = x3d_text(scene_tables(read_scene(name), output, files))
    if "SerialRobot {" not in text and "Shape {" not in text:
        raise UsageError(f"{name}: X3D cannot express any part of the scene: {', '.join(lost)}")
    return text, lost


def scene_tables(scene: Scene, output: Path, files: dict[Path, str]) -> dict[str, Any]:
    """Returns the tables of a scene file. Robots have fields of `SerialRobot` instead of `model`.

    Args:
        scene: scene to convert.
        output: path of the X3D file. Folder names in the tables are relative to its folder.
        files: mapping from paths to contents, to which the files of links are added.
    """
    from ...data.drive.wiring import wire

    sources = {}
    for key, source in wire(scene).sources.items():
        fields = source.model_dump(by_alias=True, exclude_defaults=True, exclude={"name"})
        sources[key] = {"kind": source.kind, **plain(fields)}
    tables: dict[str, Any] = {
        "description": scene.description,
        "note": scene.note,
        "robots": {key: robot_table(robot, output, files) for key, robot in scene.robots.items()},
        "sources": sources,
        "routes": dict(scene.routes),
        "objects": {item.name: changed_fields(item, "name", "directory") for item in scene.objects},
        "cameras": {key: changed_fields(camera) for key, camera in scene.cameras.items()},
        "lights": {key: changed_fields(light) for key, light in scene.lights.items()},
        "view": changed_fields(scene.view),
        "toggles": changed_fields(scene.toggles),
        "decor": {key: dict(table) for key, table in scene.decor.items()},
        "groups": scene.groups,
        "doubles": scene.doubles,
        "arrows": scene.arrows,
        "frames": scene.frames,
    }
    return {key: value for key, value in tables.items() if value}


def robot_table(robot: SerialRobot, output: Path, files: dict[Path, str]) -> dict[str, Any]:
    """Returns the table of a robot for `scene_tables`, without fields that have default values."""
    table = changed_fields(robot, *_OTHER_FORMS)
    if robot.dh is not None:
        dh = robot.dh
        table["dh_params"] = np.column_stack([dh.alpha, dh.a, dh.theta, dh.d]).tolist()
    if robot.children:
        table["children"] = [changed_fields(child, "directory") for child in robot.children]
    for key in ("filenames", "directory", "colors", "mesh_scale"):
        table.pop(key, None)
    if not robot.filenames:
        return table
    is_vrml = robot.mesh_scale == 1.0 and all(
        len(link) <= 1 and all(_is_vrml(part) for part in link) for link in robot.filenames
    )
    if is_vrml:
        table["filenames"] = [str(link[0].file) if link else "" for link in robot.filenames]
        table["directory"] = _relative(Path(robot.directory), output)
    elif robot.dh is not None and robot.dh_convention == "craig" and not robot.mirrored:
        folder = output.parent / f"{output.stem}_links" / robot.name
        texts = link_files(robot)
        files |= {folder / name: text for name, text in texts.items()}
        table["filenames"] = [*texts]
        table["directory"] = _relative(folder, output)
    else:
        table["filenames"] = []  # Mesh frames differ from X3D, which the writer reports.
    return table


def _is_vrml(part: LinkGeometry) -> bool:
    is_file = part.file is not None and Path(part.file).suffix.lower() == ".wrl"
    return is_file and not changed_fields(part, "file")


def link_files(robot: SerialRobot) -> dict[str, str]:
    """Returns the VRML97 files of the base and all links, as a mapping from names to contents."""
    root, problems = mujoco.MjSpec(), list[Problem]()
    links = drawn_geoms(root, robot, problems)
    raise_any(problems)
    owners = [i for i, geoms in enumerate(links) for _ in geoms]
    for geom in (geom for geoms in links for geom in geoms):
        root.worldbody.add_geom(contype=0, conaffinity=0, mass=0, **geom)
    model = root.compile()
    files = {}
    for i in range(len(links)):
        lines = ["#VRML V2.0 utf8", f"# {robot.name}, {'base' if i == 0 else f'link {i}'}; m"]
        for k in (k for k, owner in enumerate(owners) if owner == i):
            lines += _shapes(model, k)
        files[f"link{i}.wrl" if i else "base.wrl"] = "\n".join([*lines, ""])
    return files


def _shapes(model: Any, k: int) -> list[str]:
    kind, size = Geom(model.geom_type[k]), model.geom_size[k]
    T = frame(rotation_from_quat(model.geom_quat[k]), model.geom_pos[k])
    rgba = model.geom_rgba[k].round(6).tolist()
    if kind == Geom.mjGEOM_MESH:
        return shape_lines(_face_set(model, int(model.geom_dataid[k]), T), rgba)
    if kind == Geom.mjGEOM_BOX:
        lengths = " ".join(f"{2 * length:.7g}" for length in size)
        return shape_lines(f"Box {{ size {lengths} }}", rgba, T)
    if kind == Geom.mjGEOM_SPHERE:
        return shape_lines(f"Sphere {{ radius {size[0]:.7g} }}", rgba, T)
    if kind == Geom.mjGEOM_ELLIPSOID:
        return shape_lines("Sphere { radius 1 }", rgba, T, size)
    tube = f"Cylinder {{ radius {size[0]:.7g} height {2 * size[1]:.7g} }}"
    lines = shape_lines(tube, rgba, T @ _UPRIGHT)
    if kind == Geom.mjGEOM_CAPSULE:
        for end in (-size[1], size[1]):
            there = T @ frame(position=np.array([0.0, 0.0, end]))
            lines += shape_lines(f"Sphere {{ radius {size[0]:.7g} }}", rgba, there)
    return lines


def _face_set(model: Any, mesh: int, T: Array) -> str:
    first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    points = model.mesh_vert[first : first + count].astype(np.float64) @ T[:3, :3].T + T[:3, 3]
    face, faces = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return face_set(points, model.mesh_face[face : face + faces], _CREASE)
