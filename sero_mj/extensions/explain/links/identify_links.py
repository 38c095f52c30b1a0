"""`identify_links`: identifies links, drives and sensors of a whole robot in one regression.

The declared masses are not needed. The steps are:

1. Weighted least squares of all joints (see `RobotEquations`), whose standard errors account for
   autocorrelated residuals. Joints are weighted by their residuals (Aitken).
2. Optional parameters (Stribeck and load-dependent friction, angle offsets, inclination of the
   base) are added one by one, as long as they are highly significant and predict parts of the run
   that were not used for the fit. The last two are nonlinear, so the fit is repeated
   (Gauss-Newton method).
3. Physically consistent links that fit the base parameters and are otherwise close to the declared
   links (see `consistent_parameters`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ....base.errors import Problem, UsageError
from ....base.frames import MIRROR, Array
from ....robots.assemble.robot_dynamics import robot_dynamics
from ....robots.declared.dynamics import Dynamics
from ....robots.declared.robot import SerialRobot
from ....simulate.runs.run_log import RunLog, event_of
from ..base_parameters import BaseParameters, standard_parameters
from ..regression import Estimate, Regression, condition_number, regression
from ..torque_residuals import TorqueResiduals, torque_residuals
from .consistent_links import consistent_parameters
from .equations import EquationBuilder, Parameter, RobotEquations, separable_inertias

_MAX_ROWS = 1500
_FLOOR = 2e-5  # share of the torque limit that is added to the residuals, as in `identify`
_FOLDS = 5  # parts of the run for cross-validation
_MIN_SIGNIFICANCE = 6.0  # standard errors of an optional parameter
_MIN_GAIN = 0.02  # share of the cross-validated squared error that it explains
_MAX_OPTIONAL = 20
_MAX_INFLATION = 1e6  # of an optional parameter
_DEPENDENT = 1e7  # inflation of a parameter that the run does not determine
_ROUNDS = 3  # of the Gauss-Newton method
# Weights of the declared and of the estimated links, for relative errors of about 50 % and 200 %.
_DECLARED, _ESTIMATED = 4.0, 0.25
_NONLINEAR = ("angle_offset", "tilt")


@dataclass(frozen=True, eq=False)
class WholeRobot:
    """The identified parameters of a whole robot.

    Attributes:
        run: name of the recording.
        robot: declared robot.
        identified: robot with the identified links, friction and motor inertias.
        base: base parameters of the links.
        parameters: names and units of the parameters.
        estimates: estimates of these parameters, without the condition of physical consistency.
        values: values of these parameters for the consistent links, shape (p,).
        shift: angle offsets and inclinations about x and y, shape (n + 2,), rad or m.
        has_sensors: whether the run contains measured torques.
        reasons: reasons why parts of the robot were not identified.
        condition: condition number of the normalized columns.
        begin: start time of the run, s.
        end: end time of the run, s.
    """

    run: str
    robot: SerialRobot
    identified: SerialRobot
    base: BaseParameters
    parameters: list[Parameter]
    estimates: list[Estimate]
    values: Array
    shift: Array
    has_sensors: bool
    reasons: list[str]
    condition: float
    begin: float
    end: float

    def named(self) -> dict[str, tuple[Estimate, str]]:
        """Returns a mapping from names of parameters to estimates with units."""
        pairs = zip(self.parameters, self.estimates, strict=True)
        return {each.name: (estimate, each.unit) for each, estimate in pairs}


@dataclass(frozen=True)
class PredictionError:
    """Root mean square of the errors of predicted torques of one joint.

    Attributes:
        side: `link` for measured torques, `drive` for friction and motor inertia.
        before: error of the declared robot.
        after: error of the identified robot.
    """

    joint: str
    side: str
    before: float
    after: float
    unit: str


def identify_links(log: RunLog, name: str) -> WholeRobot:
    """Identifies links, drives, torque offsets and, if needed, further parameters of a robot.

    Raises:
        UsageError: there is no such robot or torque, its base moves, it carries another robot, or
            the run is too short or contains too little motion.
    """
    build, reasons = _builder(log, name)
    found, n = build.found, build.robot.n
    if bool(found.motion.slow.all()):
        reason = f"no joint of '{name}' moves"
        raise UsageError(Problem(log.name, reason, expected="a run that moves the robot"))
    shift, extras = np.zeros(n + 2), list[Parameter]()
    equations = build.plain(shift)
    for _ in range(_MAX_OPTIONAL):
        weights = _weights(equations)
        links = _any_links(build, equations, weights)
        best = _best_optional(build, equations, weights, links, shift, extras)
        if best is None:
            break
        extras.append(best)
        equations, shift = _with_optional(build, extras, shift)
    return _result(log, build, equations, extras, shift, reasons)


def prediction_errors(whole: WholeRobot, log: RunLog, name: str) -> list[PredictionError]:
    """Returns the errors of predicted torques of another run, by joint and side."""
    build, _ = _builder(log, name)
    if build.has_sensors != whole.has_sensors:
        found = "measured" if build.has_sensors else "no measured"
        raise UsageError(f"{log.name} has {found} torques, in contrast to {whole.run}")
    plain = build.plain(np.zeros(build.robot.n + 2))
    before = plain.y - plain.X @ build.declared(plain)
    after = build.plain(whole.shift)
    for each in whole.parameters:
        if each.kind in ("stribeck_friction", "load_friction"):
            column = build.column(each, np.zeros(0), whole.shift, after.y.shape[1])
            after = after.with_column(each, column)
    values = {each.name: value for each, value in zip(whole.parameters, whole.values, strict=True)}
    theta = np.array([values.get(each.name, 0.0) for each in after.parameters])
    left, rows = after.y - after.X @ theta, []
    sides = ["link"] * build.robot.n if build.has_sensors else ["drive"] * build.robot.n
    sides += ["drive"] * (plain.y.shape[1] - build.robot.n)
    for k, side in enumerate(sides):
        known = after.known[:, k]
        if known.any():
            old, new = (float(np.sqrt(np.mean(each[known, k] ** 2))) for each in (before, left))
            joint = k % build.robot.n
            unit = "Nm" if build.robot.types[joint] == "revolute" else "N"
            rows.append(PredictionError(build.robot.names[joint], side, old, new, unit))
    return rows


def _builder(log: RunLog, name: str) -> tuple[EquationBuilder, list[str]]:
    reasons, has_sensors = [], log.has(name, "torques")
    has_commands = log.has(name, "commanded_torques")
    if not has_sensors and has_commands:
        commanded = log.signals[event_of(name, "commanded_torques")]
        log = replace(
            log, signals={**log.signals, event_of(name, "torques"): commanded}, derived={}
        )
    found = torque_residuals(
        log, name, max_rows=_MAX_ROWS, torque_control=None if has_sensors else False
    )
    if found.no_model and "estimated" not in found.no_model:
        raise UsageError(Problem(log.name, found.no_model, expected="a robot on a fixed base"))
    has_drives = has_commands and not found.torque_control
    if not has_commands:
        reasons.append("friction and motor inertia: the run has no commanded torques")
    elif found.torque_control:
        reasons.append("friction and motor inertia: joint torque control compensates friction")
    base = BaseParameters.of(found.robot)
    is_separable = np.ones(found.robot.n, bool)
    if not has_sensors:
        is_separable = separable_inertias(found.robot, base)
        reasons += [
            f"motor inertia of {joint}: it acts like the inertia of the link, so its declared "
            "value is used"
            for joint, each in zip(found.robot.names, is_separable, strict=True) if not each
        ]  # fmt: skip
    return EquationBuilder(found, base, has_sensors, has_drives, is_separable), reasons


def _weights(equations: RobotEquations) -> Array:
    # Inverse standard deviations of the residuals of the series, (s,).
    known = equations.known.sum(axis=0)
    weights = 1.0 / equations.scale
    for _ in range(3):
        X = (equations.X * weights[:, None]).reshape(-1, equations.X.shape[2])
        scale = np.maximum(np.linalg.norm(X, axis=0), 1e-300)
        y = (equations.y * weights).ravel()
        values = np.linalg.lstsq(X / scale, y, rcond=1e-9)[0] / scale
        left = equations.y - equations.X @ values
        spread = np.sqrt((left**2).sum(axis=0) / np.maximum(known, 1))
        weights = 1.0 / np.hypot(spread, _FLOOR * equations.scale)
    return np.asarray(weights)


def _fit(equations: RobotEquations, weights: Array) -> Regression:
    return regression(
        equations.X * weights[:, None], equations.y * weights, drift=equations.drift * weights
    )


def _any_links(build: EquationBuilder, equations: RobotEquations, weights: Array) -> Array:
    # Standard parameters (10 n,) with the fitted base parameters.
    prior, K = standard_parameters(build.robot), build.base.combination
    values = _fit(equations, weights).values[: len(build.base)]
    return prior + np.linalg.pinv(K) @ (values - K @ prior)


def _best_optional(
    build: EquationBuilder, equations: RobotEquations, weights: Array, links: Array, shift: Array,
    extras: list[Parameter],
) -> Parameter | None:  # fmt: skip
    K, s, p = equations.X.shape
    X = (equations.X * weights[:, None]).reshape(-1, p)
    Q = np.linalg.qr(X / np.maximum(np.linalg.norm(X, axis=0), 1e-300))[0]
    left = (equations.y * weights).ravel()
    left = left - Q @ (Q.T @ left)
    candidates = []
    taken = {each.name for each in extras}
    for each in (each for each in build.optional() if each.name not in taken):
        column = build.column(each, links, shift, s)
        column = (np.where(equations.known, column, 0.0) * weights).ravel()
        rest = column - Q @ (Q.T @ column)
        if rest @ rest * _MAX_INFLATION > column @ column > 0.0:
            test = regression(rest.reshape(K, s, 1), left.reshape(K, s))
            size = abs(test.values[0]) / max(np.sqrt(test.covariance[0, 0]), 1e-300)
            if size > _MIN_SIGNIFICANCE:
                candidates.append((float(size), each, column.reshape(K, s)))
    error = _cross_validated(equations, weights)
    candidates.sort(key=lambda each: -each[0])
    for _, each, column in candidates[:3]:
        more = equations.with_column(each, column / weights)
        if _cross_validated(more, weights) < (1.0 - _MIN_GAIN) * error:
            return each
    return None


def _cross_validated(equations: RobotEquations, weights: Array) -> float:
    # Squared error of each fifth of the run by a fit of the other four.
    X, y = equations.X * weights[:, None], equations.y * weights
    parts = [
        (part.reshape(-1, X.shape[2]), data.ravel())
        for part, data in zip(np.array_split(X, _FOLDS), np.array_split(y, _FOLDS), strict=True)
    ]
    products = [(part.T @ part, part.T @ data) for part, data in parts]
    H, b = (sum(each) for each in zip(*products, strict=True))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(H), 1e-300))
    error = 0.0
    for (part, data), (own, pull) in zip(parts, products, strict=True):
        inverse = np.linalg.pinv((H - own) * np.outer(scale, scale), rcond=1e-10, hermitian=True)
        error += float(np.sum((data - part @ (scale * (inverse @ (scale * (b - pull))))) ** 2))
    return error


def _with_optional(
    build: EquationBuilder, extras: list[Parameter], shift: Array
) -> tuple[RobotEquations, Array]:
    # The equations with all optional parameters, and the shift at which the fit converges.
    n, nonlinear = build.robot.n, [each for each in extras if each.kind in _NONLINEAR]
    plain = build.plain(shift)
    for last in [False] * (_ROUNDS if nonlinear else 0) + [True]:
        equations = plain
        weights = _weights(plain)
        links = _any_links(build, plain, weights)
        for each in extras:
            column = build.column(each, links, shift, plain.y.shape[1])
            equations = equations.with_column(each, column)
        if not last:
            values = _fit(equations, _weights(equations)).values
            shift = shift.copy()
            for each, value in zip(equations.parameters, values, strict=True):
                if each.kind in _NONLINEAR:
                    shift[each.joint + n * (each.kind == "tilt")] += value
            plain = build.plain(shift)
    return equations, shift


def _result(
    log: RunLog, build: EquationBuilder, equations: RobotEquations, extras: list[Parameter],
    shift: Array, reasons: list[str],
) -> WholeRobot:  # fmt: skip
    robot, weights = build.robot, _weights(equations)
    fitted = _fit(equations, weights)
    X = (equations.X * weights[:, None]).reshape(-1, equations.X.shape[2])
    condition = condition_number(X)
    reason = f"the run moves the robot too little (condition number {condition:.0f})"
    values = fitted.values.copy()
    for k, each in enumerate(equations.parameters):
        if each.kind in _NONLINEAR:
            values[k] = shift[each.joint + robot.n * (each.kind == "tilt")]
    estimates = replace(fitted, values=values).estimates(reason, _DEPENDENT)
    links, values = _consistent(build, X, values, fitted.covariance)
    estimates = [
        Estimate(None, None, f"{each.name.partition('.')[0]} moves in one direction only")
        if each.kind in ("coulomb_friction", "drive_offset")
        and _is_one_sided(build.found, each.joint)
        else estimate
        for each, estimate in zip(equations.parameters, estimates, strict=True)
    ]
    identified = _identified(robot, links, equations.parameters, estimates, values)
    return WholeRobot(
        log.name, robot, identified, build.base, equations.parameters, estimates, values, shift,
        build.has_sensors, reasons, condition, float(log.times[0]), float(log.times[-1]),
    )  # fmt: skip


def _is_one_sided(found: TorqueResiduals, j: int) -> bool:
    signs = np.rint(found.motion.signs[np.isfinite(found.motor[:, j]), j])
    return len(np.unique(signs)) == 1


def _consistent(
    build: EquationBuilder, X: Array, values: Array, covariance: Array
) -> tuple[Array, Array]:
    # Consistent standard parameters (10 n,), and the values (p,) of all parameters that fit them.
    b, robot = len(build.base), build.robot
    H = X.T @ X
    others = np.linalg.pinv(H[b:, b:], hermitian=True) @ H[b:, :b]
    information = H[:b, :b] - H[:b, b:] @ others
    # Autocorrelation makes the covariance larger than that of white residuals.
    white = np.diag(np.linalg.pinv(information, rcond=1e-10, hermitian=True))
    ratio = float(np.median(np.diag(covariance)[:b] / np.maximum(white, 1e-300)))
    is_estimate = "masses" in robot_dynamics(robot).estimated
    links = consistent_parameters(
        standard_parameters(robot), build.base.combination, values[:b],
        information / max(ratio, 1.0), _ESTIMATED if is_estimate else _DECLARED,
    )  # fmt: skip
    base = build.base.combination @ links
    return links, np.concatenate([base, values[b:] + others @ (values[:b] - base)])


def _identified(
    robot: SerialRobot, links: Array, parameters: list[Parameter], estimates: list[Estimate],
    values: Array,
) -> SerialRobot:  # fmt: skip
    before = robot_dynamics(robot)
    masses, centers, tensors = before.masses.copy(), before.centers.copy(), before.tensors.copy()
    for i, (m, hx, hy, hz, xx, yy, zz, xy, xz, yz) in enumerate(links.reshape(-1, 10)):
        c = np.array([hx, hy, hz]) / m
        about = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        masses[i + 1], centers[i + 1] = m, c
        tensors[i + 1] = about - m * (c @ c * np.eye(3) - np.outer(c, c))
    if robot.mirrored:
        S = MIRROR[:3, :3]
        centers, tensors = centers @ S, S @ tensors @ S
    found = {"masses": masses, "centers_of_mass": centers, "inertias": tensors, "frames": "dh",
             "frame_origins": None, "mass_scale": 1.0}  # fmt: skip
    for key, kind in (("motor_inertias", "motor_inertia"), ("viscous_friction",) * 2,
                      ("coulomb_friction",) * 2):  # fmt: skip
        column = getattr(before, key).copy()
        known = [(each.joint, value) for each, estimate, value
                 in zip(parameters, estimates, values, strict=True)
                 if each.kind == kind and estimate.value is not None]  # fmt: skip
        for joint, value in known:
            column[joint] = max(value, 0.0)
        if known:
            found[key] = column
    fields = {**{key: getattr(robot.dynamics, key) for key in Dynamics.model_fields}, **found}
    return robot.model_copy(update={"dynamics": Dynamics(**fields)})
