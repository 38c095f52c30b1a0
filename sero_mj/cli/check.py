"""`sero-mj check`: whether a scene is valid, and what it contains."""

from __future__ import annotations

import logging
from collections.abc import Set
from textwrap import fill
from typing import TYPE_CHECKING

import numpy as np

from ..base import paths, trust
from ..base.errors import in_one_line
from ..base.frames import rpy_from_rotation
from .arguments import command, read_scene, replay_instead
from .shared_options import PackageOptions, ReplayOptions, SceneArgument

if TYPE_CHECKING:
    from ..data.receive.source import Source
    from ..robots.declared.robot import SerialRobot
    from ..robots.declared.scene import Scene

_MOST_NAMED = 24  # joints
_TIED = "\0"  # a space at which no line is broken
_EPILOG = """\
Reads and compiles the scene and opens nothing. Prints every problem at once, with file and line,
and exits with 2; else prints what the scene holds. A recording is checked in the scene that
sero-mj view shows it by, or in that of SCENE --replay REC.
"""
ORDER = 52  # in the help of `sero-mj`


class CheckOptions(SceneArgument, PackageOptions, ReplayOptions):
    """Check a scene file and print its contents."""


def run(options: CheckOptions) -> int:
    """Prints; returns 0."""
    from ..data.drive.wiring import wire
    from ..data.record.file_source import FileSource
    from ..robots.assemble.world import World
    from ..robots.declared.route_text import parts_of_origin
    from ..viewer.decor.feature import make_features
    from ..viewer.image.camera import list_cameras
    from .angle_questions import AngleQuestions
    from .opening import with_scene

    options = with_scene(options)
    trust.log.setLevel(logging.ERROR)  # what is withheld is listed below
    scene = read_scene(options.scene, replay=options.replay)
    if options.replay is not None:
        replay_instead(scene, options.replay, options.start, options.source, options.columns)
    world = World(scene)
    make_features(world)
    own = scene.file and not paths.is_temporary(scene.file)
    print(f"{scene.name}: no errors" + (f" in {scene.file}" if own else ""))
    if scene.description:
        print(f"  about   {in_one_line(scene.description)}")
    for name, part in world.robots.items():
        print("\n".join(_about_robot(name, part.robot)))
    wiring = wire(scene)
    questions = AngleQuestions(scene, wiring)
    taken = {(o.name, o.key) for route in wiring.routes for o in route.value.origins if o.is_event}
    for name, source in wiring.sources.items():
        events = ", ".join(
            f"{event} ({' x '.join(map(str, shape))})".replace(" ", _TIED)
            for event, shape in source.events.items()
        )
        text = f"{name}: {source.about}, {source.size} bytes: {events}"
        lines = fill(text, 100, initial_indent="  source  ", subsequent_indent=" " * 12)
        print(lines.replace(_TIED, " "))
        print(_unused(name, source, taken), end="")
        if isinstance(source, FileSource) and (question := questions.about_recording(source)):
            print(f"          note: {question}")
    for name in scene.groups:
        robots = [scene.robots[each] for each in scene.members(name) or []]
        joints = sum(robot.n for robot in robots)
        free = sum(robot.coupled.k for robot in robots)
        each = ", ".join(f"{robot.name} {robot.n}" for robot in robots)
        count = f"{joints} joints" + (f", in packets {joints} or {free}" if free < joints else "")
        print(fill(f"  group   {name}: {count}: {each}", 100, subsequent_indent=" " * 10))
    _print_decor(scene)
    for target, text in scene.routes.items():
        for event, names in parts_of_origin(text):
            whom = "" if names is None else f": {', '.join(names)}"
            print(fill(f"  route   {event} -> {target}{whom}", 100, subsequent_indent=" " * 10))
    for item in scene.objects:
        mass = "" if item.mass is None else f": {item.mass:g} kg, free in simulation"
        print(f"  object  {item.name}{mass}")
    for camera in list_cameras(world):
        print(f"  camera  {camera}")
    for action in () if scene.withheld is None else scene.withheld.actions:
        print(f"  would   {action}, if it is simulated")
    model = world.model
    print(f"  model   {model.nbody} bodies, {model.ngeom} geoms, {model.nmeshface} mesh triangles")
    return 0


add_to = command("check", run, CheckOptions, _EPILOG)


def _print_decor(scene: Scene) -> None:
    """Prints doubles, arrows and frames."""
    for name, double in scene.doubles.items():
        print(f"  double  {name}: of {double.of}{', a path' if double.path is not None else ''}")
    for name, arrow in scene.arrows.items():
        scale = f"{arrow.metres_per_unit:g} m/{arrow.unit_text}"
        print(f"  arrow   {name}: {arrow.kind} at {arrow.at}, {scale}")
    for name, frame in scene.frames.items():
        print(f"  frame   {name}: relative to {frame.relative_to}")


def _kind(robot: SerialRobot) -> str:
    """Returns its number of joints, and the kinds of its kinematics and link geometry."""
    table = "frames of joints" if robot.dh is None else f"{robot.dh_convention} DH"
    if robot.mjcf is not None:
        look = "geoms of its MJCF"
    elif robot.filenames:
        has_mesh = any(part.file for link in robot.filenames for part in link)
        look = "meshes" if has_mesh else "boxes, cylinders and the like"
    else:
        look = f"shapes generated from its {'joints' if robot.dh is None else 'DH table'}"
    return f"{robot.n} joints, {table}, {look}"


def _about_robot(name: str, robot: SerialRobot) -> list[str]:
    """Returns lines about a robot's joints, limbs and dynamics."""
    from ..robots.assemble.robot_dynamics import (
        about_large_inertias,
        about_masses,
        robot_dynamics,
    )
    from ..robots.assemble.unit_checks import about_units

    lines = [f"  robot   {name}: {_kind(robot)}, reach {robot.reach:.4g} m"]
    lines.append(fill(f"          joints: {_in_order(robot)}", 100, subsequent_indent=" " * 18))
    lines.append(f"          flange: {_about_flange(robot)}")
    if robot.free_base:
        how = "in a plane" if robot.free_base == "planar" else "freely"
        lines.append(f"          base: {robot.base_joint} moves it {how}; input {name}.base_frame")
    limbs = robot.limb_joints
    if len(limbs) > 1:
        each = ", ".join(f"{limb} {len(joints)}" for limb, joints in limbs.items())
        lines.append(fill(f"          limbs: {each}", 100, subsequent_indent=" " * 17))
    dynamics = robot_dynamics(robot)
    lines.append(f"          weighs {about_masses(robot, dynamics)}")
    estimated = [key for key in dynamics.estimated if key != "masses"]
    about = f"estimated {', '.join(estimated)}" if estimated else "as declared"
    repaired = [f"          repaired  {line}" for line in robot.dynamics.repaired]
    notes = [
        fill(f"          note: {line}", 100, subsequent_indent=" " * 16)
        for line in (*about_units(robot, dynamics), *about_large_inertias(robot, dynamics))
    ]
    return [*lines, *notes, f"          dynamics: {about}", *repaired]


def _in_order(robot: SerialRobot) -> str:
    """The joints in the order of their values in packets, and which need none there."""
    units = ["m" if kind == "prismatic" else "rad" for kind in robot.types]
    mixed = len(set(units)) > 1
    names = [f"{name} ({unit})" if mixed else name
             for name, unit in zip(robot.names, units, strict=True)]  # fmt: skip
    text = ", ".join(names[:_MOST_NAMED])
    if len(names) > _MOST_NAMED:
        text += f" and {len(names) - _MOST_NAMED} more"
    if robot.couplings:
        count = len(robot.couplings)
        follow = "1 follows another" if count == 1 else f"{count} follow others"
        text += f"; {robot.coupled.k} values suffice, as {follow}"
    return text


def _about_flange(robot: SerialRobot) -> str:
    """Returns the link and the position of the flange at zero joint values."""
    link = robot.flange_link
    own = "" if robot.link_names is None else f" ({robot.link_names[link]})"
    on = f"link{link}{own}, which joint {robot.names[link - 1]} moves"
    T = robot.fwd_kin_base_to_flange(np.zeros(robot.n))
    at, rpy = (
        ", ".join(f"{value:g}" for value in np.round(values, digits) + 0.0)
        for values, digits in ((T[:3, 3], 4), (np.rad2deg(rpy_from_rotation(T[:3, :3])), 2))
    )
    return f"on {on}; at zero at ({at}) m, rpy ({rpy}) deg"


def _unused(name: str, source: Source, taken: Set[tuple[str, str]]) -> str:
    """Returns a line about fields of a source that no route uses; they are received too."""
    if not any(of == name for of, _ in taken):
        return "            no route leads from it\n"
    if "structure" not in getattr(source, "model_fields_set", ()):
        return ""  # nobody has asked for all that is in these packets
    known = {getattr(source, key, "") for key in ("sequence", "time", "lock")}
    unused = [e for e in source.events if (name, e) not in taken and e not in known]
    text = f"not used: {', '.join(unused)}"
    return f"{fill(text, 100, initial_indent=' ' * 12, subsequent_indent=' ' * 12)}\n" * bool(
        unused
    )
