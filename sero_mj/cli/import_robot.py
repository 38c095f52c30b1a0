"""`sero-mj import`: converts URDF or MJCF to a robot folder, and writes a scene for it."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, TypeAlias

from ..base.declaration import is_name
from ..base.errors import UsageError
from ..base.options import Option, positional
from ..base.paths import format_of_file, model_name
from ..base.plugins import is_own_class
from ..robots.importers.importer import Mjcf, find_importer
from .arguments import check_ending, check_new, command, writing
from .new import print_next, scene_text, write_scene
from .shared_options import PackageOptions

if TYPE_CHECKING:
    from ..robots.declared.robot import SerialRobot
    from ..robots.importers.imported_tables import ImportedTables

_HELP = """\
examples:
  sero-mj import ur5.urdf --out my_ur5      my_ur5/robot.toml, its meshes; the scene my_ur5.toml
  sero-mj import arm.xacro --arg ur_type=ur5e --package ur_description=DIR
  sero-mj import arm.xml --convention standard

The robot file contains limits, masses and inertias, meshes with their frames, the joints of each
limb, a Denavit-Hartenberg table if one exists, and comments for editing by hand. Existing files are
not replaced. xacro files are converted to URDF if the package `xacro` is installed. The geoms of
MJCF stay in a copy of the file and of all files that it includes.
"""
_ENDINGS = (".urdf", ".xacro", ".xml")
_NO_BREAK = "\0"  # a non-breaking space
# Matches the names of other files in COLLADA, OBJ and MTL files.
_REFERENCE = re.compile(
    rb"<init_from>\s*(?:<ref>)?\s*([^<]+?)\s*<|^[ \t]*(?:mtllib|map_Kd)[ \t]+([^\r\n]+)",
    re.MULTILINE,
)
GROUP, ORDER = "files", 54


class ImportOptions(PackageOptions):
    """Write a robot folder and a scene from a URDF or MJCF file.

    Attributes:
        file: URDF, xacro or MJCF file.
        out: folder to create (default: the name of the robot).
        convention: convention of the Denavit-Hartenberg table (default: craig).
    """

    file: Annotated[Path, positional("FILE")]
    out: Annotated[Path | None, Option("DIR", ("-o", "--out"))] = None
    convention: Literal["craig", "standard"] | None = None


def run(options: ImportOptions) -> int:
    """Writes the robot folder and the scene; returns 0."""
    from ..robots.declared.robot import SerialRobot

    _check_format(options.file)
    source = _read(options)
    tables = source.described.tables
    folder = Path(tables["name"] if options.out is None else options.out)
    scene = folder.parent / f"{folder.name}.toml"
    try:
        is_name(folder.name)
    except ValueError as error:
        raise UsageError(f"--out: {error}") from None
    check_new((folder, scene), "choose another with --out")
    limbs = SerialRobot(**tables).limb_joints
    with writing():
        folder.mkdir(parents=True)
        text = source.write(folder, limbs)
        (folder / "robot.toml").write_text(text, encoding="utf-8")
        robot = SerialRobot.from_model(str(folder / "robot.toml"))
        # The floor is below the robot, because its base may be a trunk.
        joints = _about_joints(robot)
        write_scene(folder, scene_text(folder.name, robot.coupled.k, 'floor = "below"\n', joints))
    for warning in source.described.warnings:
        print(f"note: {warning}")
    if robot.dh is None and options.convention is not None:
        print(f"note: no {options.convention} DH table, because {source.why_no_table}")
    table = f"{robot.dh_convention} DH table" if robot.dh is not None else "joint frames"
    print(f"{folder}/robot.toml: {robot.n} joints, {table}")
    print_next(scene)
    return 0


add_to = command("import", run, ImportOptions, _HELP)


_Limbs: TypeAlias = Mapping[str, Sequence[int]]


class _Source(NamedTuple):
    described: ImportedTables
    write: Callable[[Path, _Limbs], str]  # writes meshes to a folder; returns the robot file's text
    why_no_table: str


def _read(options: ImportOptions) -> _Source:
    from ..robots.importers.mjcf_file import as_spec, write_mjcf
    from ..robots.importers.mjcf_robot import plain_tables, read_mjcf
    from ..robots.importers.robot_text import copied_meshes, robot_text
    from ..robots.importers.urdf import UrdfFile

    path: Path = options.file
    if isinstance(find_importer(path), Mjcf):
        described = read_mjcf(path)
        described.tables.update({"name": model_name(path), "directory": str(path.parent)})

        def write_geoms(folder: Path, limbs: _Limbs) -> str:
            spec = as_spec(path.name, path.parent)
            spec.compile()
            (copy, *_) = write_mjcf(spec, folder / f"{folder.name}.xml")
            tables = plain_tables(described.tables)
            count = len(tables["joint_names"])
            about = f"{count} joint{'s' * (count > 1)}, from {path.name}"
            tables |= {"mjcf": copy.name, "description": about}
            bodies = [[link] for link in tables["link_names"]]
            flange = f"behind {tables['flange_on']}"
            return robot_text(
                described, tables, limbs, file=path.name, bodies=bodies, flange=flange
            )

        return _Source(described, write_geoms, "MJCF geoms are placed in joint frames")
    file = UrdfFile(path, convention=options.convention or "craig")
    file.check()

    def write_meshes(folder: Path, limbs: _Limbs) -> str:
        tables = copied_meshes(
            file.described.tables, lambda mesh, name: _copy(mesh, folder / "meshes" / name)
        )
        bodies, flange = file.tree.bodies, f"of the link '{file.tree.flange}' of the URDF"
        return robot_text(
            file.described, tables, limbs, file=path.name, bodies=bodies, flange=flange
        )

    return _Source(file.described, write_meshes, "no DH table describes its joint frames")


def _about_joints(robot: SerialRobot) -> str:
    coupled, names = robot.coupled, robot.names
    independent = coupled.independent.tolist()
    lines = ["# Order of the joints in packets:"]
    lines += _comment([f"{k + 1} {names[i]}" for k, i in enumerate(independent)])
    followers = [
        f"{names[i]} = {coupled.ratio[i]:g} {names[independent[source]]}"
        + (f" {coupled.offset[i]:+g}" if coupled.offset[i] else "")
        for i, source in enumerate(coupled.source.tolist())
        if i not in independent
    ]
    if followers:
        lines += [f"# Coupled joints, not in packets ({len(followers)}):"]
        lines += _comment(followers)
    return "".join(f"{line}\n" for line in lines)


def _comment(items: Sequence[str]) -> list[str]:
    text = ", ".join(item.replace(" ", _NO_BREAK) for item in items)
    lines = wrap(text, 100, initial_indent="#   ", subsequent_indent="#   ")
    return [line.replace(_NO_BREAK, " ") for line in lines]


def _check_format(path: Path) -> None:
    ending = path.suffix.lower()
    importer = None if ending in _ENDINGS else find_importer(path)
    if importer is not None and importer.is_scene:
        hint = f"`sero-mj view {path}` shows the scene."
        raise UsageError(f"{path}: found a scene; expected a robot in URDF or MJCF. {hint}")
    if importer is not None and not is_own_class(type(importer)):
        raise UsageError(
            f"{path}: found {ending}; expected {', '.join(_ENDINGS)}. To use it in a scene, write "
            f'model = "{path}" in [robots.NAME].'
        )
    if ending not in _ENDINGS and (found := format_of_file(path)) is not None:
        raise UsageError(f"{path} is {found}; expected URDF, xacro or MJCF")
    check_ending("FILE", path, _ENDINGS)
    if not path.is_file():
        raise UsageError(f"{path}{' is a folder' if path.is_dir() else ': no such file'}")
    if ending == ".xml":
        found = format_of_file(path)
        if found not in ("a URDF file", "an MJCF file"):
            expected = "expected URDF (<robot>) or MJCF (<mujoco>)"
            raise UsageError(f"{path} is {found or 'not XML'}; {expected}")


def _copy(mesh: Path, to: Path) -> None:
    waiting, seen = [(mesh, to)], set()
    while waiting:
        source, target = waiting.pop()
        if source in seen or not source.is_file():
            continue
        seen.add(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
        if source.suffix.lower() in (".dae", ".obj", ".mtl"):
            for names in _REFERENCE.findall(source.read_bytes()):
                name = (names[0] or names[1]).strip().decode(errors="replace")
                name = name.removeprefix("file://")
                if name and not Path(name).is_absolute() and ".." not in Path(name).parts:
                    waiting.append((source.parent / name, target.parent / name))
