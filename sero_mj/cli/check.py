"""`sero-mj check`: reports the errors and contents of a scene, or checks this machine."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Set
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from pydantic import model_validator

from ..base import paths, trust
from ..base.errors import UsageError, did_you_mean, in_one_line
from ..base.frames import rpy_from_rotation
from ..base.options import JointValues, Option, positional
from .arguments import command, writing
from .shared_options import JsonOptions, PackageOptions, ReplayOptions

if TYPE_CHECKING:
    from ..data.receive.source import Source
    from ..robots.declared.robot import SerialRobot
    from ..robots.declared.scene import Scene

_NAMED_JOINTS = 24  # maximum number of joints that are listed by name
_NO_BREAK = "\0"  # a non-breaking space
# File names and names of joints stay whole.
_fill = partial(fill, width=100, break_on_hyphens=False, break_long_words=False)
_HELP = """\
examples:
  sero-mj check lwr_udp                  errors of a scene, or its contents
  sero-mj check lwr --deg --joint-angles 0,30,0,-90,0,60,0    forward kinematics
  sero-mj check                          what works on this machine, and what to install

The command reads and compiles a scene, and opens no source. It prints all errors with file and
line, and exits with 2 if there are any. A recording is checked in the same scene in which
`sero-mj view` shows it, or in SCENE if SCENE --replay REC is used.

--fk and --joint-angles print the base-to-flange transform from the DH table, the one from MuJoCo,
and their difference.

--schema prints the JSON schema of one kind of file. Editors with Taplo (VS Code: Even Better TOML)
use it to complete and check files whose first line is `#:schema ./scene.json`. The files written by
`sero-mj new` start with such a line.
"""
GROUP, ORDER = "files", 50


class CheckOptions(PackageOptions, ReplayOptions, JsonOptions):
    """Check a scene, a recording or this machine.

    Attributes:
        scene: file or included name of a scene, robot or recording (default: check this machine).
        fk: print the base-to-flange transform of a robot.
        joint_angles: comma-separated joint values in rad or m; implies --fk (default: home pose).
        of: robot for --fk, required in a scene with several robots.
        deg: read --joint-angles in degrees.
        schema_of: print the JSON schema of robot, group, scene or scenario files, for editors.
        output: file for the schema (default: standard output).
        as_json: print JSON; only with --fk or without a scene.
    """

    scene: Annotated[str | None, positional("SCENE")] = None
    fk: bool = False
    joint_angles: JointValues | None = None
    of: Annotated[str | None, Option("NAME")] = None
    deg: bool = False
    schema_of: Annotated[
        Literal["robot", "group", "scene", "scenario"] | None, Option(flags=("--schema",))
    ] = None
    output: Annotated[Path | None, Option("OUT.json", ("-o", "--output"))] = None

    @model_validator(mode="after")
    def _check_kind(self) -> Self:
        is_fk = self.fk or self.joint_angles is not None
        if self.schema_of is None:
            self.refuse(("output",), " needs --schema")
        elif self.scene is not None:
            raise ValueError(f"--schema {self.schema_of} cannot be combined with {self.scene}")
        if not is_fk:
            self.refuse(("of", "deg"), " needs --fk")
        if self.scene is None:
            self.refuse(("fk", "joint_angles"), " needs a robot. Add its name.")
        if self.as_json and (self.scene is not None) != is_fk:
            raise ValueError("--json can only be used with --fk, or without a scene")
        return self


def run(options: CheckOptions) -> int:
    """Runs the requested check and returns the exit status."""
    if options.schema_of is not None:
        return _print_schema(options.schema_of, options.output)
    if options.scene is None:
        from .doctor import check_machine

        return check_machine(as_json=options.as_json)
    if options.fk or options.joint_angles is not None:
        return _print_kinematics(options, options.scene)
    return _check_scene(options)


add_to = command("check", run, CheckOptions, _HELP)


def _print_schema(kind: str, output: Path | None) -> int:
    from .schema import schema_text

    text = schema_text(kind)
    if output is None:
        print(text, end="")
        return 0
    with writing():
        output.parent.mkdir(parents=True, exist_ok=True)
        output.write_text(text, encoding="utf-8")
    print(output)
    return 0


def _check_scene(options: CheckOptions) -> int:
    from ..data.drive.wiring import wire
    from ..data.record.file_source import FileSource
    from ..robots.assemble.world import World
    from ..robots.declared.route_text import parts_of_origin
    from ..viewer.decor.feature import make_features
    from ..viewer.image.camera import list_cameras
    from .opening import with_scene
    from .status import DegreesCheck

    options = with_scene(options)
    assert options.scene is not None
    trust.log.setLevel(logging.ERROR)  # withheld actions are listed below
    scene = options.read_replayed(options.scene)
    world = World(scene)
    make_features(world)
    own = scene.file and not paths.is_temporary(scene.file)
    print(f"{scene.name}: no errors" + (f" in {scene.file}" if own else ""))
    if scene.description:
        print(f"  about   {in_one_line(scene.description)}")
    for name, part in world.robots.items():
        print("\n".join(_about_robot(name, part.robot)))
    wiring = wire(scene)
    degrees = DegreesCheck(scene, wiring)
    taken = {(o.name, o.key) for route in wiring.routes for o in route.value.origins if o.is_event}
    for name, source in wiring.sources.items():
        events = ", ".join(
            f"{event} ({' x '.join(map(str, shape))})".replace(" ", _NO_BREAK)
            for event, shape in source.events.items()
        )
        text = f"{name}: {source.about}, {source.size} bytes: {events}"
        lines = _fill(text, initial_indent="  source  ", subsequent_indent=" " * 12)
        print(lines.replace(_NO_BREAK, " "))
        print(_unused(name, source, taken), end="")
        if isinstance(source, FileSource) and (warning := degrees.check_recording(source)):
            print(f"          note: {warning}")
    for name in scene.groups:
        robots = [scene.robots[each] for each in scene.members(name) or []]
        joints = sum(robot.n for robot in robots)
        free = sum(robot.coupled.k for robot in robots)
        each = ", ".join(f"{robot.name} {robot.n}" for robot in robots)
        count = f"{joints} joints" + (f", in packets {joints} or {free}" if free < joints else "")
        print(_fill(f"  group   {name}: {count}: {each}", subsequent_indent=" " * 10))
    _print_decor(scene)
    for target, text in scene.routes.items():
        for event, names in parts_of_origin(text):
            listed = "" if names is None else f": {', '.join(names)}"
            print(_fill(f"  route   {event} -> {target}{listed}", subsequent_indent=" " * 10))
    for item in scene.objects:
        mass = "" if item.mass is None else f": {item.mass:g} kg, free in simulation"
        print(f"  object  {item.name}{mass}")
    for camera in list_cameras(world):
        print(f"  camera  {camera}")
    for action in () if scene.withheld is None else scene.withheld.actions:
        print(f"  asks to {action} when simulated")
    model = world.model
    print(f"  model   {model.nbody} bodies, {model.ngeom} geoms, {model.nmeshface} mesh triangles")
    return 0


def _print_decor(scene: Scene) -> None:
    for name, double in scene.doubles.items():
        print(f"  double  {name}: of {double.of}{', a path' if double.path is not None else ''}")
    for name, arrow in scene.arrows.items():
        scale = f"{arrow.metres_per_unit:g} m/{arrow.unit_text}"
        print(f"  arrow   {name}: {arrow.kind} at {arrow.at}, {scale}")
    for name, frame in scene.frames.items():
        print(f"  frame   {name}: relative to {frame.relative_to}")


def _kind(robot: SerialRobot) -> str:
    table = "frames of joints" if robot.dh is None else f"{robot.dh_convention} DH"
    if robot.mjcf is not None:
        look = "geoms of its MJCF"
    elif robot.filenames:
        has_mesh = any(part.file for link in robot.filenames for part in link)
        look = "meshes" if has_mesh else "primitive shapes"
    else:
        look = f"shapes generated from its {'joints' if robot.dh is None else 'DH table'}"
    return f"{robot.n} joints, {table}, {look}"


def _about_robot(name: str, robot: SerialRobot) -> list[str]:
    from ..robots.assemble.robot_dynamics import (
        about_large_inertias,
        about_masses,
        about_units,
        robot_dynamics,
    )

    lines = [f"  robot   {name}: {_kind(robot)}, reach {robot.reach:.4g} m"]
    lines.append(_fill(f"          joints: {_in_order(robot)}", subsequent_indent=" " * 18))
    lines.append(f"          flange: {_about_flange(robot)}")
    if robot.free_base:
        how = "planar" if robot.free_base == "planar" else "free"
        lines.append(f"          base: {how} joint {robot.base_joint}, input {name}.base_frame")
    limbs = robot.limb_joints
    if len(limbs) > 1:
        each = ", ".join(f"{limb} {len(joints)}" for limb, joints in limbs.items())
        lines.append(_fill(f"          limbs: {each}", subsequent_indent=" " * 17))
    dynamics = robot_dynamics(robot)
    lines.append(f"          mass: {about_masses(robot, dynamics)}")
    estimated = [key for key in dynamics.estimated if key != "masses"]
    about = f"estimated {', '.join(estimated)}" if estimated else "as declared"
    repaired = [f"          repaired  {line}" for line in robot.dynamics.repaired]
    notes = [
        _fill(f"          note: {line}", subsequent_indent=" " * 16)
        for line in (*about_units(robot, dynamics), *about_large_inertias(robot, dynamics))
    ]
    return [*lines, *notes, f"          dynamics: {about}", *repaired]


def _in_order(robot: SerialRobot) -> str:
    units = ["m" if kind == "prismatic" else "rad" for kind in robot.types]
    mixed = len(set(units)) > 1
    names = [f"{name} ({unit})" if mixed else name
             for name, unit in zip(robot.names, units, strict=True)]  # fmt: skip
    text = ", ".join(names[:_NAMED_JOINTS])
    if len(names) > _NAMED_JOINTS:
        text += f" and {len(names) - _NAMED_JOINTS} more"
    if robot.couplings:
        text += f"; {len(robot.couplings)} coupled, so packets may have {robot.coupled.k} values"
    return text


def _about_flange(robot: SerialRobot) -> str:
    link = robot.flange_link
    own = "" if robot.link_names is None else f" ({robot.link_names[link]})"
    on = f"link{link}{own}, moved by joint {robot.names[link - 1]}"
    T = robot.fwd_kin_base_to_flange(np.zeros(robot.n))
    at, rpy = (
        ", ".join(f"{value:g}" for value in np.round(values, digits) + 0.0)
        for values, digits in ((T[:3, 3], 4), (np.rad2deg(rpy_from_rotation(T[:3, :3])), 2))
    )
    return f"on {on}; at joint values 0: ({at}) m, rpy ({rpy}) deg"


def _unused(name: str, source: Source, taken: Set[tuple[str, str]]) -> str:
    if not any(of == name for of, _ in taken):
        return "            no route uses it\n"
    if "structure" not in getattr(source, "model_fields_set", ()):
        return ""  # the kind of source determines the events
    known = {getattr(source, key, "") for key in ("sequence", "time", "lock")}
    unused = [e for e in source.events if (name, e) not in taken and e not in known]
    if not unused:
        return ""
    text = f"not used: {', '.join(unused)}"
    return _fill(text, initial_indent=" " * 12, subsequent_indent=" " * 12) + "\n"


def _print_kinematics(options: CheckOptions, name: str) -> int:
    from ..robots.declared.degrees import degrees_warning

    robot = _robot_of(name, options.of)
    q = robot.home
    if options.joint_angles is not None:
        q = np.array(options.joint_angles)
        coupled = robot.coupled
        if len(q) not in (coupled.n, coupled.k):
            fewer = f", {coupled.k} of them independent" if coupled.is_coupled else ""
            found = f"found {len(q)} number{'s' * (len(q) != 1)}"
            needed = f"{robot.name} has {robot.n} joints{fewer}"
            raise UsageError(f"--joint-angles: {found}, but {needed}")
        if options.deg:
            revolute = robot.kinematics.revolute
            revolute = revolute if len(q) == coupled.n else revolute[coupled.independent]
            q = np.where(revolute, np.deg2rad(q), q)
        q = q if len(q) == coupled.n else coupled.positions(q)
        if not options.deg and (warning := degrees_warning(robot, q)):
            print(f"warning: {warning} Use --deg.", file=sys.stderr)
    result = _by_both(robot, q)
    if options.as_json:
        print(json.dumps({key: np.asarray(value).tolist() for key, value in result.items()}))
        return 0
    with np.printoptions(precision=6, suppress=True, floatmode="fixed"):
        how = "the DH table" if robot.dh is not None else "the joint frames"
        by_table, by_mujoco = (np.round(result[key], 6) + 0.0 for key in ("dh", "mujoco"))  # no -0
        print(f"T_base_flange of {robot.name}, from {how}\n{by_table}")
        print(f"from MuJoCo\n{by_mujoco}")
    print(
        f"difference: {result['position_difference']:.1e} m, {result['angle_difference']:.1e} rad"
    )
    return 0


def _robot_of(name: str, of: str | None) -> SerialRobot:
    from ..load import load_scene

    robots = load_scene(name).robots
    if not robots:
        raise UsageError(f"{name}: found no robot; expected one or more")
    if of is None and len(robots) == 1:
        (of,) = robots
    if of is None:
        found = f"has {len(robots)} robots"
        raise UsageError(f"{name} {found}; choose one with --of: {', '.join(robots)}")
    if of not in robots:
        raise UsageError(f"{name} has no robot '{of}'{did_you_mean(of, robots)}")
    return robots[of]


def _by_both(robot: Any, q: Any) -> dict[str, Any]:
    import mujoco

    from ..base import frames
    from ..robots.assemble.world import World
    from ..robots.declared.scene import Scene

    # The mount does not affect the base-to-flange transform.
    alone = robot.model_copy(update={"mount": None})
    world = World(Scene(robots=[alone], floor=False))
    data = world.make_data()
    world.set_input(data, f"{robot.name}.joint_angles", q)
    mujoco.mj_kinematics(world.model, data)
    by_dh = robot.fwd_kin_base_to_flange(q)
    by_mujoco = world.fwd_kin_base_to_flange(data, robot.name)
    between = frames.inverse(by_dh) @ by_mujoco
    return {
        "joint_angles": q,
        "dh": by_dh,
        "mujoco": by_mujoco,
        "position_difference": float(np.linalg.norm(by_mujoco[:3, 3] - by_dh[:3, 3])),
        "angle_difference": frames.rotation_angle(between[:3, :3]),
    }
