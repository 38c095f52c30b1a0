"""Tables and JSON of an identified whole robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from ....robots.assemble.robot_dynamics import robot_dynamics
from ..base_parameters import standard_parameters
from .equations import DRIVE
from .identify_links import PredictionError, WholeRobot

if TYPE_CHECKING:
    from rich.console import JustifyMethod
    from rich.table import Table

_NAME_WIDTH = 48  # of sums, characters
_OF_JOINTS = (*DRIVE, "torque_offset")


def joint_table(whole: WholeRobot) -> Table:
    """Returns a table with the links and drives of the joints."""
    title = f"{whole.run}: {whole.robot.name}, {whole.begin:.3f} s to {whole.end:.3f} s"
    table = _table(title)
    named = {(each.kind, each.joint): estimate
             for each, estimate in zip(whole.parameters, whole.estimates, strict=True)}  # fmt: skip
    kinds = [kind for kind in _OF_JOINTS if any(key == kind for key, _ in named)]
    table.add_column("joint", no_wrap=True)
    for heading in ("link mass,\nkg", "declared,\nkg"):
        table.add_column(heading, justify="right", no_wrap=True)
    for kind in kinds:
        units = dict.fromkeys(each.unit for each in whole.parameters if each.kind == kind)
        heading = kind.replace("_", "\n").replace("coulomb", "Coulomb")
        table.add_column(f"{heading}, {' or '.join(units)}", justify="right", no_wrap=True)
    after, before = (robot_dynamics(each).masses for each in (whole.identified, whole.robot))
    for k, joint in enumerate(whole.robot.names):
        cells = [str(named.get((kind, k), "-")) for kind in kinds]
        table.add_row(joint, f"{after[k + 1]:.4g}", f"{before[k + 1]:.4g}", *cells)
    return table


def base_table(whole: WholeRobot) -> Table:
    """Returns a table with the base parameters of the links."""
    table = _table("Sums of link parameters that the torques determine (base parameters)")
    table.add_column("base parameter", max_width=_NAME_WIDTH)
    for heading in ("", "identified", "declared"):
        table.add_column(heading, justify="left" if not heading else "right", no_wrap=True)
    declared = whole.base.combination @ standard_parameters(whole.robot)
    links = [each for each in zip(whole.parameters, whole.estimates, strict=True)
             if each[0].kind == "link"]  # fmt: skip
    for (parameter, estimate), old in zip(links, declared, strict=True):
        table.add_row(parameter.name, parameter.unit, str(estimate), f"{old + 0.0:.4g}")
    return table


def error_table(rows: Sequence[PredictionError], run: str) -> Table:
    """Returns a table of prediction errors of the declared and of the identified robot."""
    table = _table(f"{run}: errors of predicted torques")
    for heading in ("joint", "torque", "declared\nrobot, rms", "identified\nrobot, rms", "unit"):
        justify: JustifyMethod = "right" if "rms" in heading else "left"
        table.add_column(heading, justify=justify, no_wrap=True)
    for each in rows:
        table.add_row(each.joint, each.side, f"{each.before:.3g}", f"{each.after:.3g}", each.unit)
    return table


def remarks(whole: WholeRobot) -> list[str]:
    """Returns lines about optional parameters, and about what is not identified."""
    lines = []
    for parameter, estimate in zip(whole.parameters, whole.estimates, strict=True):
        if parameter.kind in ("stribeck_friction", "load_friction", "angle_offset", "tilt"):
            text = f"{parameter.name.replace('_', ' ')}: {estimate} {parameter.unit}".rstrip()
            speed = f", Stribeck velocity {parameter.speed:g}" if parameter.speed else ""
            lines.append(text + speed)
    unknown: dict[str, list[str]] = {}
    for name, (estimate, _) in whole.named().items():
        if estimate.reason is not None:
            unknown.setdefault(estimate.reason, []).append(name)
    lines += [f"not identifiable: {', '.join(names)}: {why}" for why, names in unknown.items()]
    return lines + [f"not identified: {each}" for each in whole.reasons]


def as_json(whole: WholeRobot, errors: Sequence[PredictionError]) -> dict[str, Any]:
    """Returns the estimates and prediction errors as JSON types."""
    dynamics = robot_dynamics(whole.identified)
    return {
        "run": whole.run,
        "robot": whole.robot.name,
        "begin": whole.begin,
        "end": whole.end,
        "parameters": [
            {"name": each.name, "kind": each.kind, "unit": each.unit, **asdict(estimate)}
            for each, estimate in zip(whole.parameters, whole.estimates, strict=True)
        ],
        "links": {
            "masses": dynamics.masses.tolist(),
            "centers_of_mass": dynamics.centers.tolist(),
            "inertias": np.asarray(dynamics.tensors).tolist(),
        },
        "not_identified": whole.reasons,
        "condition": whole.condition,
        "prediction_errors": [asdict(each) for each in errors],
    }


def _table(title: str) -> Table:
    from rich import box
    from rich.table import Table

    return Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
