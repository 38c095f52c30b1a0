"""`sero-mj new`: writes a commented robot file and a scene, or prints example code."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from importlib import resources
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Annotated, NamedTuple, Self

from pydantic import AfterValidator, model_validator

from ..base import paths
from ..base.declaration import is_name
from ..base.errors import UnknownName, UsageError
from ..base.options import Option, Options, Port, positional, whole
from ..base.plugins import SNIPPETS, load_all
from .arguments import check_new, command, writing
from .schema import schema_text

if TYPE_CHECKING:
    from collections.abc import Mapping

_HELP = """\
examples:
  sero-mj new my_robot                     my_robot/robot.toml with 6 joints, and a scene
  sero-mj new my_lwr --like lwr            a copy of an included robot
  sero-mj new --snippet c                  code that sends from your control loop to sero-mj

The first line of both files lets editors complete and check keys. Existing files are not replaced.

--snippet prints example code that sends data from your control loop to a scene: c, rust, simulink,
lcm, or a snippet of an extension (sero-mj list). It also prints controllers for simulated robots,
as libraries (controller-c, controller-cpp, controller-rust) or programs (controller-udp-c,
controller-udp-python). --scene prints the matching scene or scenario instead. Each packet has a
counter, a time (s), and angles (rad), measured and commanded torques (Nm) of all joints as
little-endian float64. NaN means no data.
"""
_MAX_JOINTS = 64
# Dimensions of the example arm: heights and lengths in m, torques in Nm, ratios of each link and
# joint to the previous one, and angles of the joints that bend the arm (every second joint) in rad.
_BASE_HEIGHT, _FIRST_LENGTH, _LENGTH_RATIO = 0.34, 0.4, 0.85
_FIRST_TORQUE, _TORQUE_RATIO = 150.0, 0.7
_BENT = (0.5, 1.1, 0.7)

_ROBOT = """\
#:schema ./robot.schema.json
# The robot {name}. Edit this file. `sero-mj list --fields` lists all keys, and docs/robots.md
# explains them.
description = "{name}, {n} joints"

# Denavit-Hartenberg table, one row per joint: alpha (deg), a (m), theta (deg), d (m).
# "craig" (modified) rotates and translates along x first, "standard" along z first.
dh_convention = "craig"
dh_params_deg = [
{rows}
]
# joint_types = ["revolute", "prismatic", ...]   # default: all revolute
flange_frame = {{ xyz = [0.0, 0.0, 0.1] }}         # relative to the last joint's frame, m

position_limits_deg = [
{limits}
]
velocity_limits_deg = [{velocities}]   # deg/s
torque_limits = [{torques}]   # Nm; arrows reach full width at these torques

joint_angles = [{angles}]   # rad; initial pose, until the first packet

# Without mesh files, the link shapes are generated from the table. With mesh files, list one for
# the base and one for the link of each joint, in the frame of its row:
# directory = "meshes"
# filenames = ["base.stl", "link1.stl", ...]
# mesh_scale = 0.001                             # if the files are in mm

# Simulations also need masses, friction and motor inertias. Values that are not declared here are
# estimated:
# [dynamics]
# masses = [...]                                 # kg, base first; requires the next two
# centers_of_mass = [[...], ...]                 # m, in the frames of the rows
# inertias = [[...], ...]                        # kg m2: Ixx, Iyy, Izz, Ixy, Ixz, Iyz
# motor_inertias = [...]                         # kg m2, at the joint (after the gear)
"""

_SCENE = """\
#:schema ./{name}/scene.schema.json
# Mirrors {name} from UDP packets of {n} joint angles (rad) and {n} torques (Nm), as float64.
{joints}description = "{name} from packets of {n} angles and {n} torques"
{more}
[robots.{name}]
model = "{name}"                   # the folder next to this file
show_arrows = true

[sources.udp]
kind = "udp"
port = 32000
structure = "{n}F{n}F"             # `sero-mj structure {n}F{n}F` prints the offsets

[routes]
"{name}.joint_angles" = "udp.values0"
"{name}.torques" = "udp.values1"
"""
GROUP, ORDER = "simulate", 34


def _checked(name: str | None) -> str | None:
    return None if name is None else is_name(name)


class NewOptions(Options):
    """Write a robot file and a scene, or print example code.

    Attributes:
        name: name of the robot.
        joints: number of joints.
        like: robot to copy: the name of an included robot, or a folder.
        snippet: name of example code to print instead of writing files.
        robot: robot in the scene of the snippet: the name of an included robot, or a file.
        host: address at which the robot's computer reaches sero-mj.
        port: UDP port to which the example code sends.
        scene: print the scene or scenario of the snippet instead of the code.
    """

    name: Annotated[str | None, AfterValidator(_checked), positional("NAME")] = None
    joints: Annotated[int, whole(1, _MAX_JOINTS), Option("N")] = 6
    like: Annotated[str | None, Option("ROBOT")] = None
    snippet: Annotated[str | None, Option("NAME")] = None
    robot: Annotated[str | None, Option("ROBOT")] = None
    host: Annotated[str, Option("HOST")] = "127.0.0.1"
    port: Port = 32000
    scene: bool = False

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        if (self.name is None) == (self.snippet is None):
            raise ValueError("expected either the NAME of a new robot or --snippet NAME")
        if self.snippet is not None:
            self.refuse(("joints", "like"), " cannot be combined with --snippet")
        else:
            self.refuse(("robot", "host", "port", "scene"), " needs --snippet NAME")
        if self.like is not None and self.set_among("joints"):
            raise ValueError("--joints cannot be combined with --like, which copies all joints")
        return self


def run(options: NewOptions) -> int:
    """Writes a robot file and a scene, or prints a snippet; returns 0."""
    from ..robots.declared.robot import SerialRobot
    from ..robots.importers.importer import is_robot_file

    if options.snippet is not None:
        text = snippet_text(
            options.snippet, options.robot, options.host, options.port, is_scene=options.scene
        )
        print(text, end="")
        return 0
    name = str(options.name)
    like = None if options.like is None else paths.find_model(options.like)
    if like is not None and like.suffix != ".toml":
        hint = f'Write model = "{options.like}" in a scene to use it directly.'
        if like.suffix in (".urdf", ".xacro"):
            hint = f"Run `sero-mj import {options.like} --out {name}`."
        raise UsageError(f"--like: found {like.name}; expected a robot in TOML. {hint}")
    if like is not None and not is_robot_file(like):
        raise UsageError(f"--like: found {like}, a scene or scenario; expected a robot file")
    folder, scene = Path(name), Path(f"{name}.toml")
    check_new((folder, scene), "choose another name")
    robot = folder / "robot.toml"
    with writing():
        if like is None:
            folder.mkdir()
            robot.write_text(robot_text(name, options.joints), encoding="utf-8")
        else:
            SerialRobot.from_model(str(like))  # errors then name the original file
            _copy(like, robot)
        n = SerialRobot.from_model(str(robot)).n
        write_scene(folder, scene_text(name, n))
    print(f"{robot}: the robot")
    print_next(scene)
    return 0


add_to = command("new", run, NewOptions, _HELP)


def write_scene(folder: Path, text: str) -> None:
    """Writes a scene next to a robot folder, and schemas for scene and robot into the folder."""
    folder.with_name(f"{folder.name}.toml").write_text(text, encoding="utf-8")
    for kind in ("robot", "scene"):
        (folder / f"{kind}.schema.json").write_text(schema_text(kind), encoding="utf-8")


def print_next(scene: Path) -> None:
    """Prints the commands that show a new scene."""
    print(f"{scene}: a scene that mirrors the robot")
    print(f"Next, run in two terminals:\n  sero-mj send {scene}\n  sero-mj view {scene}")


def scene_text(name: str, n: int, more: str = "", joints: str = "") -> str:
    """Returns the text of a scene that mirrors a robot with n independent joints.

    `more` contains further keys of the scene, and `joints` comments on the order of the joints.
    """
    return _SCENE.format(name=name, n=n, more=more, joints=joints)


def _copy(model: Path, to: Path) -> None:
    to.parent.mkdir()
    for each in model.parent.iterdir():
        if each.is_dir() and not each.name.startswith(("_", ".")):
            shutil.copytree(each, to.parent / each.name)
    lines = model.read_text(encoding="utf-8").splitlines(keepends=True)
    lines = [line for line in lines if not line.startswith("#:schema")]
    shared = tomllib.loads("".join(lines)).get("directory", "")
    if ".." in Path(shared).parts:  # meshes of another robot
        own = Path(shared).name
        shutil.copytree(model.parent / shared, to.parent / own)
        lines = [line.replace(json.dumps(shared), json.dumps(own)) for line in lines]
    to.write_text("".join(["#:schema ./robot.schema.json\n", *lines]), encoding="utf-8")


def robot_text(name: str, n: int) -> str:
    """Returns the text of a robot file for an example arm with n joints.

    The joint axes are alternately parallel and perpendicular to the links.
    """
    rows, limits, velocities, torques, angles = [], [], [], [], []
    for k in range(n):
        is_across, arm = k % 2 == 1, _FIRST_LENGTH * _LENGTH_RATIO ** (k // 2 - 1)
        alpha = 0.0 if k == 0 else (-90.0 if is_across else 90.0)
        d = 0.0 if is_across else _BASE_HEIGHT if k == 0 else arm
        rows.append(f"  [{alpha:5.1f}, 0.0, 0.0, {d:.3f}],   # joint {k + 1}")
        limits.append("  [-120, 120]," if is_across else "  [-170, 170],")
        velocities.append(f"{100 + 10 * min(k, 8)}")
        torques.append(f"{_FIRST_TORQUE * _TORQUE_RATIO**k:.3g}")
        angles.append(f"{_BENT[k // 2 % len(_BENT)] if is_across else 0.0}")
    return _ROBOT.format(
        name=name,
        n=n,
        rows="\n".join(rows),
        limits="\n".join(limits),
        velocities=", ".join(velocities),
        torques=", ".join(torques),
        angles=", ".join(angles),
    )


_SNIPPET_SCENE = """\
# Mirrors a robot from the packets that the code of `sero-mj new --snippet {name}` sends:
# angles (rad), measured torques and commanded torques (Nm) of {n} joints.
[robots.{robot}]
model = "{model}"
show_arrows = true
show_billboards = true

[sources.udp]
kind = "udp"
host = "{host}"
port = {port}
structure = "count:1I time:1F angles:{n}F torques:{n}F commanded:{n}F"
sequence = "count"
time = "time"

[routes]
"{robot}.joint_angles" = "udp.angles"
"{robot}.torques" = "udp.torques"
"{robot}.commanded_torques" = "udp.commanded{more}"
"""
_SCENARIO = """\
# Runs the controller of `sero-mj new --snippet {name}` along a sine, and checks its position error.
[robots.{robot}]
model = "{model}"
show_arrows = true

[controllers.{robot}]
{controller}

[targets.{robot}]
kind = "sine"
amplitude_deg = 5
frequency = 0.5
ramp = 1.0

[run]
duration = 3.0

[expect.position_error]
robot = "{robot}"
measure = "position_error"
below = 0.05
"""
_CONTROLLERS = {
    "controller-c": 'kind = "library"\nfile = "controller.so"',
    "controller-cpp": 'kind = "library"\nfile = "controller.so"',
    "controller-rust": 'kind = "library"\nfile = "controller.so"',
    "controller-udp-c": 'kind = "udp"\ncommand = ["./controller", "{port}"]',
    "controller-udp-python": 'kind = "udp"\ncommand = ["python3", "controller.py", "{port}"]',
}
_HEADER = '#include "sero_mj_controller.h"\n'
_HOST, _PORT = re.compile(r"127\.0\.0\.1"), re.compile(r"\b32000\b")
_JOINTS = re.compile(r"(JOINTS\b[^\d\n]{1,9})\d+")


class Snippet(NamedTuple):
    """Example code, stored in the folder `snippets` of a package.

    A package adds a snippet by an entry point of the same name in the group `sero_mj.snippets`.

    Attributes:
        robot: default robot in the scene of the snippet.
        commanded: text that is appended to the route of the commanded torques in the scene, such as
            ` + {robot}.gravity_torques`.
    """

    package: str
    file: str
    robot: str = "lwr"
    commanded: str = ""

    @property
    def text(self) -> str:
        return (resources.files(self.package) / "snippets" / self.file).read_text("utf-8")


def snippets() -> Mapping[str, Snippet]:
    """Returns a mapping from names to snippets, including those of other packages."""
    files = sorted(each.name for each in (resources.files(__package__) / "snippets").iterdir())
    own = {PurePath(name).stem: Snippet(__package__, name) for name in files if "." in name}
    own["lcm"] = own["lcm"]._replace(robot="iiwa14")
    return {**own, **load_all(SNIPPETS)}


def snippet_text(name: str, robot: str | None, host: str, port: int, *, is_scene: bool) -> str:
    """Returns the code of a snippet, or its scene or scenario if `is_scene` is true.

    `robot` is a file or an included name. None selects the robot of the snippet.
    """
    from ..load import load_robot

    known = snippets()
    if name not in known:
        raise UnknownName("snippet", name, known)
    snippet = known[name]
    model = robot or snippet.robot
    loaded = load_robot(model)
    n = loaded.coupled.k  # packets omit coupled joints
    names = {"name": name, "robot": loaded.name, "model": model}
    if is_scene and name in _CONTROLLERS:
        return _SCENARIO.format(controller=_CONTROLLERS[name], **names)
    if is_scene:
        more = snippet.commanded.format(robot=loaded.name)
        return _SNIPPET_SCENE.format(n=n, more=more, host=host, port=port, **names)
    code = snippet.text
    if _HEADER in code:
        from ..simulate.external_control.library import HEADER

        return code.replace(_HEADER, HEADER.read_text(encoding="utf-8"))
    text = _JOINTS.sub(rf"\g<1>{n}", code)
    return _PORT.sub(str(port), _HOST.sub(host, text))
