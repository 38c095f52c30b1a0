"""`sero-mj import`: a robot folder in our format from a robot's URDF, and a scene to mirror it."""

from __future__ import annotations

import argparse
import re
import shutil
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING

from ..declaration import is_name
from ..describe.robot_file import is_urdf
from ..describe.xml_file import root_name
from ..errors import UsageError
from ..paths import SCENE_ENDINGS
from ._arguments import Commands, add_command, add_package_option, check_ending
from .new import scene_text
from .schema import schema_text

if TYPE_CHECKING:
    from ..assemble.robot import SerialRobot

_EPILOG = """\
example:
  sero-mj import ur5.urdf --out my_ur5      my_ur5/robot.toml, its meshes; the scene my_ur5.toml

The robot file is commented: limits, masses and inertias, meshes with their frames, which joints
belong to which limb, and a Denavit-Hartenberg table where there is one. It is to be changed by
hand. Nothing that is there is written over. xacro becomes URDF if the package `xacro` is installed.
"""
_TIED = "\0"  # a space at which no line is broken
_BESIDE = re.compile(
    rb"<init_from>\s*(?:<ref>)?\s*([^<]+?)\s*<|^[ \t]*(?:mtllib|map_Kd)[ \t]+([^\r\n]+)",
    re.MULTILINE,
)


def add_to(commands: Commands) -> None:
    """Adds the command."""
    about = "write a robot folder and a scene from a URDF file"
    parser = add_command(commands, "import", run, about, _EPILOG)
    parser.add_argument("file", metavar="FILE", type=Path, help="URDF or xacro; .xml if it is URDF")
    parser.add_argument(
        "--out", type=Path, metavar="DIR", help="folder to be made (default: the robot's name)"
    )
    add_package_option(parser)


def run(options: argparse.Namespace) -> int:
    """Writes the files; returns 0."""
    from ..assemble.robot import SerialRobot
    from ..describe.robot_text import copied_meshes, urdf_robot_text
    from ..describe.urdf import UrdfFile

    _check_format(options.file)
    file = UrdfFile(options.file)
    folder = Path(file.described.tables["name"] if options.out is None else options.out)
    scene = folder.parent / f"{folder.name}.toml"
    try:
        is_name(folder.name)
    except ValueError as error:
        raise UsageError(f"--out: {error}") from None
    for path in (folder, scene):
        if path.exists():
            raise UsageError(f"{path} is there already; choose another with --out")
    try:
        folder.mkdir(parents=True)
        tables = copied_meshes(
            file.described.tables, lambda mesh, name: _copy(mesh, folder / "meshes" / name)
        )
        limbs = SerialRobot(**file.described.tables).limb_joints
        (folder / "robot.toml").write_text(urdf_robot_text(file, tables, limbs), encoding="utf-8")
        robot = SerialRobot.from_model(str(folder / "robot.toml"))
        # The base of such a robot may be its trunk.
        joints = _about_joints(robot)
        text = scene_text(folder.name, robot.coupled.k, 'floor = "below"\n', joints)
        scene.write_text(text, encoding="utf-8")
        for kind in ("robot", "scene"):
            (folder / f"{kind}.schema.json").write_text(schema_text(kind), encoding="utf-8")
    except OSError as error:
        raise UsageError(f"cannot write {error.filename}: {error.strerror}") from error
    for warning in file.described.warnings:
        print(f"note: {warning}")
    how = f"{robot.dh_convention} DH table" if robot.dh is not None else "joint frames"
    print(f"{folder}/robot.toml: {robot.n} joints, {how}\n{scene}: a scene that mirrors it")
    print(f"next, in two terminals:\n  sero-mj send {scene}\n  sero-mj view {scene}")
    return 0


def _about_joints(robot: SerialRobot) -> str:
    """Comments: whose values packets have, in their order, and which joints follow which."""
    coupled, names = robot.coupled, robot.names
    independent = coupled.independent.tolist()
    lines = ["# The joints, in the order of packets:"]
    lines += _comment([f"{k + 1} {names[i]}" for k, i in enumerate(independent)])
    followers = [
        f"{names[i]} = {coupled.ratio[i]:g} {names[independent[source]]}"
        + (f" {coupled.offset[i]:+g}" if coupled.offset[i] else "")
        for i, source in enumerate(coupled.source.tolist())
        if i not in independent
    ]
    if followers:
        lines += [f"# Not in packets, as they follow others ({len(followers)}):"]
        lines += _comment(followers)
    return "".join(f"{line}\n" for line in lines)


def _comment(items: Sequence[str]) -> list[str]:
    """Lines of a comment, broken between items."""
    text = ", ".join(item.replace(" ", _TIED) for item in items)
    lines = wrap(text, 100, initial_indent="#   ", subsequent_indent="#   ")
    return [line.replace(_TIED, " ") for line in lines]


def _check_format(path: Path) -> None:
    """Raises UsageError for what is no URDF, and says what takes it."""
    ending = path.suffix.lower()
    if ending in SCENE_ENDINGS:
        raise UsageError(
            f"{path}: found a scene in X3D; expected a robot in URDF. `sero-mj convert {path} "
            f"{path.stem}.toml` writes it as a scene of ours, `sero-mj view {path}` shows it"
        )
    if ending != ".xml" or not path.exists() or is_urdf(path):
        check_ending("FILE", path, (".urdf", ".xacro", ".xml"), ", ")
        return
    root = root_name(path)
    if root == "mujoco":
        raise UsageError(
            f"{path}: found MJCF (<mujoco>), which is a robot as it is; expected URDF (<robot>). "
            f'`sero-mj view {path}` shows it, model = "{path}" puts it into a scene'
        )
    found = "no XML" if root is None else f"<{root}>"
    raise UsageError(f"{path}: found {found}; expected URDF, which begins with <robot>")


def _copy(mesh: Path, to: Path) -> None:
    """Copies a mesh, and the materials and pictures that it has beside it, for their colours."""
    waiting, seen = [(mesh, to)], set()
    while waiting:
        source, target = waiting.pop()
        if source in seen or not source.is_file():
            continue
        seen.add(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
        if source.suffix.lower() in (".dae", ".obj", ".mtl"):
            for names in _BESIDE.findall(source.read_bytes()):
                name = (names[0] or names[1]).strip().decode(errors="replace")
                name = name.removeprefix("file://")
                if name and not Path(name).is_absolute() and ".." not in Path(name).parts:
                    waiting.append((source.parent / name, target.parent / name))
