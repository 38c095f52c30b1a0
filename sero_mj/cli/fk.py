"""`sero-mj fk`: forward kinematics by `dh` and by MuJoCo, and their difference."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..base.errors import UsageError, did_you_mean
from ..base.options import JointValues, Option, positional
from .arguments import command
from .shared_options import JsonOptions, PackageOptions

if TYPE_CHECKING:
    from ..robots.declared.robot import SerialRobot

_EPILOG = """\
examples:
  sero-mj fk lwr --joint-angles 0,0.5,0,-1.5,0,1,0
  sero-mj fk lwr --deg --joint-angles 0,30,0,-90,0,60,0
  sero-mj fk my_robot/robot.toml --joint-angles 0.1,0.2 --json
  sero-mj fk justin --of justin_left_arm
  sero-mj fk my_scene.toml
"""
ORDER = 49  # in the help of `sero-mj`


class FkOptions(PackageOptions, JsonOptions):
    """Print base-to-flange of a robot by DH and by MuJoCo.

    Attributes:
        robot: robot or scene: a file, a folder or a shipped name.
        joint_angles: joint values with commas, rad or m (default: home).
        of: which robot of a scene that has several.
        deg: angles are in degrees.
    """

    robot: Annotated[str, positional("ROBOT")]
    joint_angles: JointValues | None = None
    of: Annotated[str | None, Option("NAME")] = None
    deg: bool = False


def run(options: FkOptions) -> int:
    """Prints; returns 0."""
    from ..robots.declared.degrees import degrees_warning

    robot = _robot_of(options.robot, options.of)
    q = robot.home
    if options.joint_angles is not None:
        q = np.array(options.joint_angles)
        coupled = robot.coupled
        if len(q) not in (coupled.n, coupled.k):
            fewer = f", or {coupled.k} without the coupled ones" if coupled.is_coupled else ""
            found = f"found {len(q)} number{'s' * (len(q) != 1)}"
            raise UsageError(f"--joint-angles: {found}; {robot.name} has {robot.n} joints{fewer}")
        if options.deg:
            turns = robot.kinematics.revolute
            turns = turns if len(q) == coupled.n else turns[coupled.independent]
            q = np.where(turns, np.deg2rad(q), q)
        q = q if len(q) == coupled.n else coupled.positions(q)
        if not options.deg and (warning := degrees_warning(robot, q)):
            print(f"WARNING: {warning} Use --deg.", file=sys.stderr)
    result = compare(robot, q)
    if options.as_json:
        print(json.dumps({key: np.asarray(value).tolist() for key, value in result.items()}))
        return 0
    with np.printoptions(precision=6, suppress=True, floatmode="fixed"):
        how = "its DH table" if robot.dh is not None else "its joint frames"
        by_table, by_mujoco = (np.round(result[key], 6) + 0.0 for key in ("dh", "mujoco"))  # no -0
        print(f"T_base_flange of {robot.name}, by {how}\n{by_table}")
        print(f"by MuJoCo\n{by_mujoco}")
    print(
        f"difference: {result['position_difference']:.1e} m, {result['angle_difference']:.1e} rad"
    )
    return 0


add_to = command("fk", run, FkOptions, _EPILOG)


def _robot_of(name: str, of: str | None) -> SerialRobot:
    """Returns a robot by name or file, or one of a scene's.

    Raises:
        UsageError: the scene has several robots, or none of that name.
    """
    from ..load import load_scene

    robots = load_scene(name).robots
    if not robots:
        raise UsageError(f"{name}: found no robot; expected one or more")
    if of is None and len(robots) == 1:
        (of,) = robots
    if of is None:
        found = f"has {len(robots)} robots"
        raise UsageError(f"{name}: {found}; expected --of with one of {', '.join(robots)}")
    if of not in robots:
        raise UsageError(f"{name}: has no robot '{of}'{did_you_mean(of, robots)}")
    return robots[of]


def compare(robot: Any, q: Any) -> dict[str, Any]:
    """Returns base-to-flange by DH and by MuJoCo, and their difference (m, rad)."""
    import mujoco

    from ..base import frames
    from ..robots.assemble.world import World
    from ..robots.declared.scene import Scene

    # Alone: what carries it does not matter from its base on.
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
