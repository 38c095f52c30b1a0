"""`sero-mj identify --design`: designs a motion for identification, and writes it as a table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from ...base.declaration import expecting
from ...base.errors import UsageError
from ...base.options import Count, JointValues, Option, Options, Positive, Seed, whole
from ...cli.arguments import print_json, progress_bar, read_scene
from ...data.record.csv_files import TIME, column_names, csv_table

if TYPE_CHECKING:
    from .excitation import Excitation

MAX_RATE = 1e4  # rows/s
_DIGITS = 9  # decimal places in tables, so that differences of angles give smooth velocities
_SIGNALS = ("joint_angles", "joint_velocities", "torques")
_STEP = 0.005  # s, time between rows for summary and figure
_LARGE = 1000.0  # condition number above which estimates are inaccurate
# Options that have an effect only with --design.
DESIGN = ("period", "periods", "harmonics", "share", "clearance", "at", "rate", "seed")


class DesignOptions(Options):
    """Options for designing a motion.

    Attributes:
        design: design a motion that excites the parameters of a robot, instead of reading
            recordings; --robot or --scene is the name or file of the robot or scene.
        period: duration of the motion in seconds.
        periods: number of repetitions of the motion.
        harmonics: number of harmonics of the Fourier series of each joint.
        share: share of the joint ranges, velocity limits and torque limits that the motion may use.
        clearance: minimum distance between parts of the robot, and to its surroundings, in m.
        at: joint values at start and end, in rad or m, separated by commas (default: the declared
            values).
        rate: number of rows per second in the table.
        seed: seed of the random motions from which the search starts.
    """

    title: ClassVar[str] = "designing a motion"
    design: bool = False
    period: Annotated[Positive, Option("S")] = 10.0
    periods: Count = 1
    harmonics: Annotated[int, whole(2, 20), Option("N")] = 5
    share: Annotated[
        float, Field(gt=0, lt=1), expecting("a share between 0 and 1"), Option("P")
    ] = 0.8
    clearance: Annotated[Positive, Option("M")] = 0.02
    at: Annotated[JointValues | None, Option("Q", ("--start",))] = None
    rate: Annotated[
        float, Field(gt=0, le=MAX_RATE), expecting(f"rows/s, up to {MAX_RATE:g}"), Option("HZ")
    ] = 1000.0
    seed: Seed = 0


def design(
    options: DesignOptions,
    scene_name: str | None,
    robot: str | None,
    *,
    output: Path | None,
    plot: Path | None,
    as_json: bool,
    quiet: bool,
) -> int:
    """Designs a motion, and returns the exit status.

    Without `scene_name`, `robot` is the name or file of a robot instead of the name in the scene.
    """
    from .excitation import design_excitation

    if scene_name is None:
        scene_name, robot = robot, None
    if scene_name is None:
        raise UsageError("--design: expected --robot or --scene with a robot, scene or file")
    scene = read_scene(scene_name)
    name = robot or (next(iter(scene.robots)) if len(scene.robots) == 1 else None)
    if name not in scene.robots:
        found = f"found '{name}'" if name else f"scene {scene_name} has several robots"
        expected = f"expected one of {', '.join(scene.robots)}, with --scene"
        raise UsageError(f"--robot: {found}; {expected}")
    with progress_bar("designing", quiet=quiet) as update:
        motion = design_excitation(
            scene, name, period=options.period, harmonics=options.harmonics, share=options.share,
            clearance=options.clearance, seed=options.seed, progress=update,
            start=None if options.at is None else np.array(options.at),
        )  # fmt: skip
    if output is not None:
        write_motion(motion, output, options.rate, options.periods)
    if plot is not None:
        from .design_figure import plot_excitation

        plot_excitation(motion, plot)
    summary = summarize(motion, options.periods)
    if as_json:
        print_json(summary)
    elif not quiet:
        print("\n".join(as_lines(summary)))
    return 0


def write_motion(found: Excitation, path: Path, rate: float, periods: int = 1) -> None:
    """Writes a table with times, joint angles, velocities and required torques, in SI units.

    Raises:
        CsvError: the file cannot be written.
    """
    robot = found.regressor.robot
    times = np.arange(round(found.series.period * periods * rate) + 1) / rate
    motion = found.motion(times)
    names = column_names(dict.fromkeys(_SIGNALS, (robot.n,)), robot.names)
    values = np.column_stack([times, motion.angles, motion.velocities, found.torques(times)])
    with csv_table(path) as table:
        table.writerow([TIME, *names])
        table.writerows((np.round(values, _DIGITS) + 0.0).tolist())  # without negative zeros


def summarize(found: Excitation, periods: int = 1) -> dict[str, Any]:
    """Returns condition numbers, and the largest use of each limit as a share.

    The entry `torque` is None if no torque limits are declared. Distances are in m, times in s.
    """
    limits, names = found.limits, found.regressor.robot.names
    times = np.arange(0.0, found.series.period, _STEP)
    condition, parameters = found.condition()
    summary: dict[str, Any] = {
        "robot": found.regressor.robot.name,
        "joints": limits.names,
        "coupled_joints": [each for each in names if each not in limits.names],
        "duration": found.series.period * periods,
        "condition": condition,
        "parameters": parameters,
        "chirp_condition": found.chirp_condition(),
    }
    for kind, shares in found.used(times).items():
        row, joint = divmod(int(shares.argmax()), shares.shape[1])
        share = limits.share * float(shares[row, joint])
        summary[kind] = {"share": share, "joint": limits.names[joint], "time": float(times[row])}
    if not np.isfinite(limits.torques).any():
        summary["torque"] = None
    distance, between, row = found.clearance.nearest(found.motion(times).angles)
    summary["distance"] = {"minimum": distance, "between": between, "time": float(times[row])}
    notes = [*limits.notes, *found.clearance.notes]
    if condition > _LARGE:
        notes.append("the motion hardly excites some parameters; choose another pose with --start")
    return summary | {"notes": notes}


def as_lines(summary: dict[str, Any]) -> list[str]:
    """Returns the summary as lines for the terminal."""
    follow = ", ".join(summary["coupled_joints"])
    lines = [
        f"{summary['robot']}: {summary['duration']:g} s, moves {', '.join(summary['joints'])}"
        + (f", and with them {follow}" if follow else ""),
        f"condition number: {summary['condition']:.3g} for {summary['parameters']} parameters "
        f"({summary['chirp_condition']:.3g} for a chirp within the same limits)",
    ]
    for kind in ("position", "velocity", "torque"):
        if (used := summary[kind]) is None:
            continue
        limit = "half the range" if kind == "position" else "the limit"
        where = f"{used['joint']} at {used['time']:.2f} s"
        lines.append(f"{kind}: at most {used['share']:.0%} of {limit} ({where})")
    near = summary["distance"]
    where = f"{near['between']} at {near['time']:.2f} s"
    far = (
        f"at least {near['minimum']:.3f} m ({where})"
        if near["between"]
        else "unknown, or more than 1 m"
    )
    return [*lines, f"distance: {far}", *(f"note: {text}" for text in summary["notes"])]
