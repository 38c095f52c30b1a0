"""Identifies friction, payload and torque offsets of a robot by linear regression.

Both sides of every joint are linear in the parameters (see `TorqueResiduals`):

    motor side, each joint:      commanded - measured = B ddtheta + v dq + f sign(dq) + c
    link side, all together:     measured - model = Y(q, dq, ddq) p + o

with the motor inertia B, viscous and Coulomb friction v and f, the asymmetry of friction or offset
of the drive c, the ten parameters p of a body at the flange, and the sensor offsets o.
Joints are weighted by their residuals (Aitken's generalized least squares, as in Gautier). The
residuals are not white, so the standard errors are those for autocorrelated residuals of all joints
together (see `regression`).

A parameter is reported as not identifiable if its variance is far larger than that of an
uncorrelated estimate, or if too few rows contribute to it.

The samples of angles and torques are not simultaneous to better than a sampling interval. The
standard errors contain a delay of half an interval, which makes viscous friction look like inertia.

Source: Swevers, Verdonck, De Schutter, Dynamic model identification for industrial robots, IEEE
Control Systems Magazine 27(5), 2007.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...base.errors import Problem, UsageError
from ...base.frames import Array
from ...base.reduction import rms, rms_with_error
from ...robots.declared.robot import SerialRobot
from ...simulate.runs.run_log import RunLog
from ...study.compare import one_unit, unit_of
from ...study.explanation import Parameter
from ...study.figure import BLUE, MIN_SHARE, ORANGE, Figure, check_suffix, save_figures, styled
from .regression import Estimate, condition_number, regression
from .torque_residuals import TorqueResiduals, torque_residuals

if TYPE_CHECKING:
    from rich.table import Table

_MAX_ROWS = 4000
_MIN_MOVING = 20  # rows in which a joint moves
_INERTIA = 0.3  # kg m2, prior standard deviation of the payload's inertia
# Share of the torque limit, above the residuals of a perfect run, which are due to friction at low
# speed and filtering.
_FLOOR = 2e-5
_UNITS = ("N", "N s/m", "kg"), ("Nm", "Nm s/rad", "kg m2")  # prismatic, revolute
# Smallest changes that matter in trends: shares of the torque limit for other torques, and for
# friction and inertia at 1 rad/s and 1 rad/s2; and of a payload, kg.
_OF_TORQUES, _OF_DRIVES, _OF_LOAD = 1e-3, 2e-4, 0.02
_MIN_SIGNIFICANCE = 3.0  # standard errors; minimum significance of a payload


@dataclass(frozen=True, eq=False)
class JointFigures:
    """The estimated parameters of a joint.

    Attributes:
        coulomb_friction: friction torque, Nm or N.
        viscous_friction: friction coefficient, Nm s/rad or N s/m.
        motor_inertia: inertia reflected to the joint, kg m2 or kg.
        torque_offset: offset of the torque sensor, Nm or N.
        condition: condition number of the normalized columns of the motor side; infinite if the
            joint does not move.
    """

    joint: str
    coulomb_friction: Estimate
    viscous_friction: Estimate
    motor_inertia: Estimate
    torque_offset: Estimate
    condition: float


@dataclass(frozen=True, eq=False)
class Identified:
    """The estimated parameters of a robot.

    Attributes:
        run: name of the recording.
        joints: estimates from base to flange.
        mass: mass of the payload, kg.
        center: center of mass of the payload in the flange frame, m.
        condition: condition number of the normalized columns of the link side.
        times: times of the residuals, shape (K,), s.
        motor: commanded minus measured torques, shape (K, n), Nm or N; `motor_fit` is the fit.
        link: measured minus model torques, shape (K, n), Nm or N; `link_fit` is the fit.
        begin: start time of the run, s.
        end: end time of the run, s.
    """

    run: str
    robot: SerialRobot
    joints: list[JointFigures]
    mass: Estimate
    center: list[Estimate]
    condition: float
    times: Array
    motor: Array
    motor_fit: Array
    link: Array
    link_fit: Array
    begin: float
    end: float

    @property
    def has_payload(self) -> bool:
        """Whether the payload is significant."""
        mass = self.mass
        return mass.value is not None and mass.value > _MIN_SIGNIFICANCE * (mass.error or 0.0)


def identify(log: RunLog, name: str) -> Identified:
    """Estimates friction, payload and torque sensor offsets of a robot.

    Raises:
        UsageError: there is no such robot or measured torque, or the run is too short or
            contains too little motion.
    """
    found = torque_residuals(log, name, max_rows=_MAX_ROWS)
    n = found.robot.n
    if bool(found.motion.slow.all()):
        reason = f"no joint of '{name}' moves"
        raise UsageError(Problem(log.name, reason, expected="a run that moves the robot"))
    motors = [_motor_side(found, log.has(name, "commanded_torques"), k) for k in range(n)]
    payload, offsets, condition, link_fit = _link_side(found)
    joints = [
        JointFigures(joint, coulomb, viscous, inertia, offset, number)
        for joint, ((coulomb, viscous, inertia), number, _), offset in zip(
            found.robot.names, motors, offsets, strict=True
        )
    ]
    return Identified(
        log.name, found.robot, joints, payload[0], payload[1:], condition, found.times, found.lag,
        np.stack([fit for _, _, fit in motors], axis=1), found.link, link_fit,
        float(log.times[0]), float(log.times[-1]),
    )  # fmt: skip


def _motor_side(
    found: TorqueResiduals, is_commanded: bool, k: int
) -> tuple[list[Estimate], float, Array]:
    # Coulomb and viscous friction and motor inertia of joint k, condition number and fit (K,).
    name, nothing = found.robot.names[k], np.full(len(found.times), np.nan)
    reason = None
    if not is_commanded:
        reason = "the run has no commanded torques"
    elif found.torque_control:
        reason = "joint torque control compensates friction"
    rows = np.isfinite(found.motor[:, k])
    if reason is None and rows.sum() < _MIN_MOVING:
        reason = f"the run moves {name} too little"
    if reason is not None:
        return [Estimate(None, None, reason)] * 3, np.inf, nothing
    columns = [
        found.motion.signs,
        found.motion.velocities - 0.5 * found.sample_time * found.motion.accelerations,
        found.motion.accelerations,
        np.ones_like(found.motion.signs),
    ]
    X = np.stack([column[:, k] for column in columns], axis=1)
    y = found.lag[:, k]
    X, y = np.where(rows[:, None], X, 0.0), np.where(rows, y, 0.0)
    drift = np.where(rows, _drift(found, found.lag)[:, k], 0.0)
    fitted = regression(X[:, None], y[:, None], drift=drift[:, None])
    left = float(np.mean((y - X @ fitted.values)[rows] ** 2))
    floor = 1.0 + (_FLOOR * found.scale[k]) ** 2 / max(left, 1e-30)
    condition = condition_number(X[rows])
    reason = f"the run moves {name} too little (condition number {condition:.0f})"
    estimates = replace(fitted, covariance=floor * fitted.covariance).estimates(reason)
    if len(np.unique(np.rint(X[rows, 0]))) < 2:
        estimates[0] = Estimate(None, None, f"the run moves {name} in one direction only")
    if _is_negative(estimates[2]):
        unit = _UNITS[found.robot.types[k] == "revolute"][2]
        reason = f"{name} would have {estimates[2]} {unit}. Check that commands are drive torques."
        estimates[2] = Estimate(None, None, reason)
    fit = np.where(rows, X @ fitted.values, np.nan)
    return estimates[:3], condition, fit


def _link_side(found: TorqueResiduals) -> tuple[list[Estimate], list[Estimate], float, Array]:
    # Mass and center of the payload, offsets of the torque sensors, condition number, fit (K, n).
    n, K = found.robot.n, len(found.times)
    if not found.has_model:
        unknown = Estimate(None, None, found.no_model)
        return [unknown] * 4, [unknown] * n, np.inf, np.full((K, n), np.nan)
    known = np.isfinite(found.link)
    if not known.any():
        unknown = Estimate(None, None, "the run has no valid link torques")
        return [unknown] * 4, [unknown] * n, np.inf, np.full((K, n), np.nan)
    X = np.concatenate(
        [found.torques.payload, np.broadcast_to(np.eye(n), (K, n, n))], axis=2
    )  # (K, n, 10 + n)
    X, y = np.where(known[..., None], X, 0.0), np.where(known, found.link, 0.0)
    priors = np.concatenate([np.zeros(4), np.full(6, _INERTIA**-2), np.zeros(n)])
    drift = np.where(known, _drift(found, found.torques.measured), 0.0)
    weights = np.ones(n)
    for _ in range(3):
        weighted = weights[:, None]
        fitted = regression(X * weighted, y * weights, priors, drift * weights)
        left = np.where(known, y - X @ fitted.values, 0.0)
        spread = np.sqrt((left**2).sum(axis=0) / np.maximum(known.sum(axis=0), 1))
        weights = 1.0 / np.hypot(spread, _FLOOR * found.scale)
    # The weights include the floor, the residuals do not.
    is_known = known.any(axis=0)
    values = fitted.values
    covariance = fitted.covariance / float(np.mean((weights * spread)[is_known] ** 2))
    fitted = replace(fitted, covariance=covariance)
    reported = np.r_[0:4, 10 : 10 + n]
    condition = condition_number((X * weights[:, None]).reshape(-1, 10 + n)[:, reported])
    reason = f"the run moves the flange too little (condition number {condition:.0f})"
    estimates = fitted.estimates(reason)
    offsets = estimates[10:]
    offsets = [
        each if each.value is not None
        else Estimate(None, None, f"the run moves {joint} too little to separate offset and load")
        for joint, each in zip(found.robot.names, offsets, strict=True)
    ]  # fmt: skip
    mass = estimates[0]
    fit = np.where(known, X @ values, np.nan)
    if _is_negative(mass):
        reason = f"the best fit is a payload of {mass} kg, so another force acts on the robot"
        unknown = Estimate(None, None, reason)
        return [unknown] * 4, [unknown] * n, condition, fit
    if mass.value is None or mass.error is None or mass.value < _MIN_SIGNIFICANCE * mass.error:
        reason = mass.reason or "no significant payload"
        return [mass, *[Estimate(None, None, reason)] * 3], offsets, condition, fit
    # c = h / m, with error propagation.
    center = values[1:4] / mass.value
    slopes = np.column_stack([-center, np.eye(3)]) / mass.value
    errors = np.sqrt(np.diag(slopes @ covariance[:4, :4] @ slopes.T))
    centers = [
        Estimate(float(value), float(error)) if each.value is not None else each
        for value, error, each in zip(center, errors, estimates[1:4], strict=True)
    ]
    return [mass, *centers], offsets, condition, fit


def _drift(found: TorqueResiduals, torques: Array) -> Array:
    # Change of torques (K, n) in half a sampling interval, zero if unknown.
    rates = np.gradient(torques, found.step, axis=0)
    return np.asarray(np.nan_to_num(0.5 * found.sample_time * rates))


def _is_negative(mass: Estimate) -> bool:
    return mass.value is not None and mass.value < -_MIN_SIGNIFICANCE * (mass.error or 0.0)


def figures(found: Identified) -> dict[str, tuple[Estimate, str]]:
    """Returns a mapping from `JOINT.NAME` and `payload.NAME` to estimates with units."""
    named: dict[str, tuple[Estimate, str]] = {}
    for joint, kind in zip(found.joints, found.robot.types, strict=True):
        force, rate, inertia = _UNITS[kind == "revolute"]
        units = {"coulomb_friction": force, "viscous_friction": rate, "motor_inertia": inertia,
                 "torque_offset": force}  # fmt: skip
        named |= {f"{joint.joint}.{key}": (getattr(joint, key), unit)
                  for key, unit in units.items()}  # fmt: skip
    named["payload.mass"] = found.mass, "kg"
    center = dict(zip("xyz", found.center, strict=True))
    return named | {f"payload.{axis}": (estimate, "m") for axis, estimate in center.items()}


def parameters(found: Identified) -> list[Parameter]:
    """Returns the estimates of all joints and of the payload's mass, for trends.

    The parameter `gravity_error` is the root mean square of measured minus model torques that
    neither a payload nor offsets of the sensors explain.
    """
    limits = dict(zip(found.robot.names, found.robot.torque_bounds, strict=True))
    estimates = {
        key: pair for key, pair in figures(found).items() if not key.startswith("payload.")
    }
    unknown = found.mass.reason if np.isinf(found.condition) else None
    for k, (joint, left) in enumerate(
        zip(found.robot.names, (found.link - found.link_fit).T, strict=True)
    ):
        value, error = rms_with_error(left)
        known = np.isfinite(value)
        found_error = Estimate(value if known else None, error if known else None, unknown)
        estimates[f"{joint}.gravity_error"] = (
            found_error,
            _UNITS[found.robot.types[k] == "revolute"][0],
        )
    listed = []
    for key, (each, unit) in estimates.items():
        joint, _, name = key.rpartition(".")
        share = _OF_TORQUES if name in ("torque_offset", "gravity_error") else _OF_DRIVES
        least = share * limits[joint] if np.isfinite(limits[joint]) else 0.0
        listed.append(Parameter(joint, name, unit, each.value, each.error, each.reason, least))
    mass = found.mass
    load = Parameter("payload", "mass", "kg", mass.value, mass.error, mass.reason, _OF_LOAD)
    return [*listed, load]


def as_json(found: Identified) -> dict[str, Any]:
    """Returns the estimates as JSON types."""
    return {
        "run": found.run,
        "robot": found.robot.name,
        "begin": found.begin,
        "end": found.end,
        "joints": [asdict(each) for each in found.joints],
        "payload": {
            "mass": asdict(found.mass),
            "center_of_mass": [asdict(each) for each in found.center],
        },
        "condition": found.condition,
    }


def as_table(found: Identified) -> Table:
    """Returns a table for the terminal."""
    from rich import box
    from rich.table import Table

    title = f"{found.run}: {found.robot.name}, {found.begin:.3f} s to {found.end:.3f} s"
    table = Table(title=title, title_justify="left", title_style="bold", box=box.SIMPLE_HEAD)
    units = dict.fromkeys(_UNITS[kind == "revolute"] for kind in found.robot.types)
    force, rate, inertia = (" or ".join(each) for each in zip(*units, strict=True))
    table.add_column("joint", no_wrap=True)
    for heading in (f"Coulomb\nfriction, {force}", f"viscous\nfriction, {rate}",
                    f"motor\ninertia, {inertia}", f"torque\noffset, {force}"):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    for each in found.joints:
        figures = (each.coulomb_friction, each.viscous_friction, each.motor_inertia)
        table.add_row(each.joint, *map(str, figures), str(each.torque_offset))
    return table


def remarks(found: Identified) -> list[str]:
    """Returns lines about the payload and about each reason why parameters are unidentifiable."""
    if found.has_payload:
        center = ", ".join(map(str, found.center))
        lines = [f"payload: {found.mass} kg at ({center}) m in the flange frame"]
    elif found.mass.value is not None:
        lines = [f"payload: not significant ({found.mass} kg)"]
    else:
        lines = [f"payload: not identifiable: {found.mass.reason}"]
    unknown: dict[str, list[str]] = {}
    for each in found.joints:
        for what, estimate in (
            ("friction", each.coulomb_friction), ("friction", each.viscous_friction),
            ("motor inertia", each.motor_inertia), ("torque offset", each.torque_offset),
        ):  # fmt: skip
            if estimate.reason is not None:
                words = unknown.setdefault(estimate.reason, [])
                words += [what] if what not in words else []
    return lines + [
        f"not identifiable: {', '.join(words)}: {why}" for why, words in unknown.items()
    ]


def as_toml(found: Identified) -> str:
    """Returns lines for a robot file, followed by lines for a scenario as comments.

    Parameters that are not identifiable have the declared values.
    """
    from ...robots.assemble.robot_dynamics import robot_dynamics

    declared = robot_dynamics(found.robot)
    name = found.robot.name
    lines = [f"# Identified from {found.run}, {found.begin:.3f} s to {found.end:.3f} s. In a scene",
             f"# with the robot, for example from URDF, the table is [robots.{name}.dynamics].",
             "[dynamics]"]  # fmt: skip
    inertias = [each.motor_inertia for each in found.joints]
    known = any(each.value is not None for each in inertias)
    for key, old, estimates in (
        ("viscous_friction", declared.viscous_friction,
         [each.viscous_friction for each in found.joints]),
        ("coulomb_friction", declared.coulomb_friction,
         [each.coulomb_friction for each in found.joints]),
        *([("motor_inertias", declared.motor_inertias, inertias)] if known else []),
    ):  # fmt: skip
        values = [
            float(before) if each.value is None else max(each.value, 0.0)
            for before, each in zip(old, estimates, strict=True)
        ]
        errors = ", ".join("-" if each.error is None else f"{each.error:.1g}" for each in estimates)
        lines += [f"# standard errors {errors}", f"{key} = {_numbers(values)}"]
        unchanged = [joint.joint for joint, each in zip(found.joints, estimates, strict=True)
                     if each.value is None]  # fmt: skip
        if unchanged:
            lines.append(f"# not identifiable from the run, unchanged: {', '.join(unchanged)}")
    offsets = [each.torque_offset for each in found.joints]
    if any(each.value is not None for each in offsets):
        errors = ", ".join("-" if each.error is None else f"{each.error:.1g}" for each in offsets)
        lines += ["", "# For a scenario:",
                  f"# [sensors.{found.robot.name}.torques]", f"# standard errors {errors}",
                  f"# bias = {_numbers([each.value or 0.0 for each in offsets])}"]  # fmt: skip
    if found.has_payload and found.mass.value is not None:
        center = [each.value or 0.0 for each in found.center]
        estimates = [found.mass, *found.center]
        errors = ", ".join("-" if each.error is None else f"{each.error:.1g}" for each in estimates)
        unknown = [axis for axis, each in zip("xyz", found.center, strict=True)
                   if each.value is None]  # fmt: skip
        lines += ["#", "# [disturbances.payload]", '# kind = "payload"',
                  f'# robot = "{found.robot.name}"', f"# standard errors {errors}",
                  f"# mass = {found.mass.value:.5g}",
                  f"# center_of_mass = {_numbers(center)}"]  # fmt: skip
        if unknown:
            lines.append(f"# not identifiable from the run, 0 here: {', '.join(unknown)}")
    return "\n".join(lines) + "\n"


def _numbers(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{value + 0.0:.5g}' for value in values)}]"


def _brief(estimate: Estimate) -> str:
    # Adding 0 removes the sign of -0.
    return "unknown" if estimate.value is None else f"{round(estimate.value, 3) + 0.0:.3f}"


def plot_identified(found: Identified, path: Path | str) -> None:
    """Draws the measured and fitted torques of each joint's motor and link side."""
    path = check_suffix(path)
    from matplotlib.lines import Line2D

    robot = found.robot
    unit = one_unit(unit_of("torques", kind) for kind in robot.types) or "Nm or N"
    limits = robot.torque_bounds
    with styled():
        figure = Figure(
            [(each.joint, f"friction {_brief(each.coulomb_friction)}\n"
                          f"offset {_brief(each.torque_offset)}")
             for each in found.joints],
            [(f"commanded − measured, {unit}", 1.0), (f"measured − model, {unit}", 1.0)],
            title=f"{found.run}: {robot.name} identified",
            subtitle=remarks(found)[0],
            times=(float(found.times[0]), float(found.times[-1])),
        )  # fmt: skip
        for k, panels in enumerate(figure.axes):
            for panel, values, fit in zip(
                panels, (found.motor[:, k], found.link[:, k]),
                (found.motor_fit[:, k], found.link_fit[:, k]), strict=True,
            ):  # fmt: skip
                figure.line(panel, found.times, values, "run", color=BLUE, linewidth=1.5)
                figure.line(panel, found.times, fit, "fit", color=ORANGE, linewidth=0.8)
                if figure.fit(panel, [values, fit], least=MIN_SHARE * limits[k], floor=0.2):
                    figure.note(panel, f"residual rms {rms(values - fit):.2g}")
        figure.legend([
            Line2D([], [], color=BLUE, linewidth=1.5, label="run"),
            Line2D([], [], color=ORANGE, linewidth=1.0, label="fit"),
        ])  # fmt: skip
        save_figures([figure], path)
