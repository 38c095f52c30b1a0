"""The kinds of faults: each function adds one to a `Plant` and returns what is right about it.

Sizes, joints and times are drawn from the random generator of the plant, in a range that is clearly
visible in the residuals and occurs in laboratories. A fault of a log or a sensor changes the rows
of the run. All other faults act in the simulation.

A kind that the product cannot name has no right verdict except `unexplained`. The comment at a
right verdict gives the reason if it does not have the name of the fault.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from judge import Named, Truth
from plant import STEP, Array, Log, Plant, Robot

KINDS: dict[str, Callable[[Plant], Truth]] = {}
NAMED: set[str] = set()  # kinds that the product can name
SENSOR, DRIVE = "torque sensor", "drive"
CLEAN = "none"


def kind(function: Callable[[Plant], Truth]) -> Callable[[Plant], Truth]:
    KINDS[function.__name__] = function
    return function


def named(function: Callable[[Plant], Truth]) -> Callable[[Plant], Truth]:
    NAMED.add(function.__name__)
    return kind(function)


def make_plant(name: str, seed: int, robot: Robot) -> tuple[Plant, Truth]:
    """Returns a plant with a fault of this kind, and what is right about the fault."""
    number = sorted(KINDS).index(name) if name != CLEAN else 1000
    plant = Plant(robot, np.random.default_rng([seed, number, *robot.name.encode()]))
    truth = Truth() if name == CLEAN else KINDS[name](plant)
    return plant, truth


# Draws


def any_joint(p: Plant) -> int:
    return int(p.rng.integers(len(p.robot.limits)))


def loaded_joint(p: Plant) -> int:
    """Returns one of the four joints whose link torque changes most, relative to its limit."""
    order = np.argsort(-p.loads()[1] / p.robot.limits)
    return int(p.rng.choice(order[:4]))


def gravity_joint(p: Plant) -> int:
    """Returns joint 2, 4 or 6, if its angle changes gravity torques clearly."""
    load = np.hypot(*p.loads()) / p.robot.limits
    return int(p.rng.choice([joint for joint in (1, 3, 5) if load[joint] > 0.02]))


def two_joints(p: Plant) -> tuple[int, int]:
    first, second = p.rng.choice(np.argsort(-p.loads()[1] / p.robot.limits)[:4], 2, replace=False)
    return int(first), int(second)


def begin(p: Plant) -> float:
    """Returns the start of a fault: half of them exist from the start of the run."""
    return float(p.rng.choice([0.0, p.rng.uniform(1.5, 3.5)]))


def signed(p: Plant, least: float, most: float) -> float:
    return float(p.rng.choice([-1.0, 1.0]) * p.rng.uniform(least, most))


def factor(p: Plant) -> float:
    return float(p.rng.choice([p.rng.uniform(0.6, 0.85), p.rng.uniform(1.2, 1.5)]))


# Truths


def at(p: Plant, joints: int | Iterable[int], *pairs: tuple[str, str]) -> Truth:
    """Returns the truth of a fault that is visible only at some joints."""
    joints = [joints] if isinstance(joints, int) else list(joints)
    names = [p.robot.joints[joint] for joint in joints]
    right = {(name, *pair) for name in names for pair in pairs}
    return Truth(frozenset(right), frozenset(names))


def everywhere(p: Plant, *right: Named) -> Truth:
    """Returns the truth of a fault that is visible at all joints."""
    return Truth(frozenset(right), frozenset(p.robot.joints))


# Effects


def only(p: Plant, joint: int, size: float = 1.0) -> Array:
    column = np.zeros(len(p.robot.limits))
    column[joint] = size
    return column


def on_sensor(p: Plant, joint: int, change: Callable[[Array, Array], Array]) -> None:
    """Changes the true torques of a joint; `change` has the times and the torques."""

    def apply(log: Log) -> Log:
        torques = log.torques.copy()
        torques[:, joint] = change(log.times, torques[:, joint])
        return log.with_(torques=torques)

    p.sensors.append(apply)


def on_drive(p: Plant, joint: int, change: Callable[[Any, float], float]) -> None:
    """Changes the motor torque of a joint; `change` has the state and the torque."""

    def apply(state: Any, torques: Array) -> Array:
        torques = torques.copy()
        torques[joint] = change(state, torques[joint])
        return torques

    p.drive.append(apply)


def on_encoder(p: Plant, joint: int, change: Callable[[float], float]) -> None:
    def apply(q: Array) -> Array:
        q = q.copy()
        q[joint] = change(q[joint])
        return q

    p.encoders.append(apply)


def late(times: Array, values: Array, delay: float | Array) -> Array:
    """Returns values of one signal or of several joints, delayed by a time in s."""
    columns = values.reshape(len(times), -1)
    moved = [np.interp(times - delay, times, column) for column in columns.T]
    return np.stack(moved, axis=1).reshape(values.shape)


def smooth(values: Array, seconds: float) -> Array:
    """Returns the values after a first-order low-pass filter."""
    result, share = values.copy(), STEP / (seconds + STEP)
    for k in range(1, len(values)):
        result[k] = result[k - 1] + share * (values[k] - result[k - 1])
    return result


# Torque sensors


@named
def sensor_sign(p: Plant) -> Truth:
    j = loaded_joint(p)
    on_sensor(p, j, lambda t, x: -x)
    return at(p, j, ("sign", SENSOR))


@named
def sensor_gain(p: Plant) -> Truth:
    j, start, gain = loaded_joint(p), begin(p), factor(p)
    on_sensor(p, j, lambda t, x: np.where(t > start, gain, 1.0) * x)
    return at(p, j, ("gain", SENSOR))


@named
def sensor_bias(p: Plant) -> Truth:
    j, start = any_joint(p), begin(p)
    size = signed(p, 0.02, 0.06) * p.robot.limits[j]
    on_sensor(p, j, lambda t, x: x + size * (t > start))
    return at(p, j, ("bias", SENSOR))


@named
def sensor_delay(p: Plant) -> Truth:
    j, delay = loaded_joint(p), p.rng.uniform(0.02, 0.08)
    on_sensor(p, j, lambda t, x: late(t, x, delay))
    return at(p, j, ("delay", SENSOR))


@named
def sensor_noise(p: Plant) -> Truth:
    j, start, rng = any_joint(p), begin(p), p.rng
    size = rng.uniform(0.005, 0.02) * p.robot.limits[j]
    on_sensor(p, j, lambda t, x: x + size * (t > start) * rng.normal(size=len(t)))
    return at(p, j, ("noise", SENSOR))


@named
def sensor_stuck(p: Plant) -> Truth:
    j, start = loaded_joint(p), p.rng.uniform(1.5, 3.5)
    is_zero = p.rng.random() < 0.5

    def freeze(log: Log) -> Log:
        torques, after = log.torques.copy(), log.times > start
        torques[after, j] = 0.0 if is_zero else torques[np.argmax(after), j]
        return log.with_(torques=torques)

    p.logged.append(freeze)
    return at(p, j, ("stuck", SENSOR))


@named
def sensor_lowpass(p: Plant) -> Truth:
    j, seconds = loaded_joint(p), p.rng.uniform(0.03, 0.08)
    on_sensor(p, j, lambda t, x: smooth(x, seconds))
    return at(p, j, ("delay", SENSOR))  # a filter delays slow signals by its time constant


@named
def sensor_drift(p: Plant) -> Truth:
    j = any_joint(p)
    size = signed(p, 0.03, 0.08) * p.robot.limits[j]
    on_sensor(p, j, lambda t, x: x + size * t / p.duration)
    return at(p, j, ("bias", SENSOR))  # an offset that grows


@named
def noise_bursts(p: Plant) -> Truth:
    j, rng = any_joint(p), p.rng
    size = rng.uniform(0.01, 0.03) * p.robot.limits[j]
    starts = rng.uniform(0.5, p.duration - 1.0, 4)

    def burst(t: Array, x: Array) -> Array:
        is_on = ((t[:, None] > starts) & (t[:, None] < starts + 0.4)).any(axis=1)
        return x + size * is_on * rng.normal(size=len(t))

    on_sensor(p, j, burst)
    return at(p, j, ("noise", SENSOR))


@named
def sensor_quantized(p: Plant) -> Truth:
    j = loaded_joint(p)
    unit = p.rng.uniform(0.01, 0.03) * p.robot.limits[j]

    def coarse(log: Log) -> Log:
        torques = log.torques.copy()
        torques[:, j] = np.round(torques[:, j] / unit) * unit
        return log.with_(torques=torques)

    p.logged.append(coarse)
    # Errors of rounding are noise, and a coarse value is constant for a while.
    return at(p, j, ("noise", SENSOR), ("stuck", SENSOR))


@named
def sensor_clipped(p: Plant) -> Truth:
    j, share = loaded_joint(p), p.rng.uniform(0.3, 0.6)

    def clip(log: Log) -> Log:
        torques = log.torques.copy()
        low, high = torques[:, j].min(), torques[:, j].max()
        is_upper = abs(high) > abs(low)
        edge = high - share * (high - low) if is_upper else low + share * (high - low)
        torques[:, j] = np.clip(torques[:, j], *((-np.inf, edge) if is_upper else (edge, np.inf)))
        return log.with_(torques=torques)

    p.logged.append(clip)
    return at(p, j, ("stuck", SENSOR))  # it shows a constant value while it is out of range


@kind
def sensor_hysteresis(p: Plant) -> Truth:
    j = loaded_joint(p)
    half = p.rng.uniform(0.3, 0.6) * p.loads()[1][j] + 0.005 * p.robot.limits[j]

    def play(t: Array, x: Array) -> Array:
        result, value = np.empty_like(x), x[0]
        for k, each in enumerate(x):
            value = np.clip(value, each - half, each + half)
            result[k] = value
        return result

    on_sensor(p, j, play)
    return at(p, j)


@kind
def sensor_crosstalk(p: Plant) -> Truth:
    source = int(np.argmax(p.loads()[1]))
    j = int(p.rng.choice([k for k in range(len(p.robot.limits)) if k != source]))
    share = signed(p, 0.1, 0.25)

    def mix(log: Log) -> Log:
        torques = log.torques.copy()
        torques[:, j] += share * torques[:, source]
        return log.with_(torques=torques)

    p.sensors.append(mix)
    return at(p, j)


# Drives


@named
def drive_sign(p: Plant) -> Truth:
    j, start = any_joint(p), p.rng.uniform(2.0, 5.0)
    on_drive(p, j, lambda s, u: -u if s.t > start else u)
    return at(p, j, ("sign", DRIVE))


@named
def drive_gain(p: Plant) -> Truth:
    j, start, gain = any_joint(p), begin(p), factor(p)
    on_drive(p, j, lambda s, u: gain * u if s.t > start else u)
    return at(p, j, ("gain", DRIVE))


@named
def torque_constant(p: Plant) -> Truth:
    j, share = any_joint(p), p.rng.choice([0.75, 0.85, 1.2, 1.3])
    on_drive(p, j, lambda s, u: share * u)
    return at(p, j, ("gain", DRIVE))  # the motor exerts another torque per commanded torque


@named
def drive_bias(p: Plant) -> Truth:
    j, start = any_joint(p), begin(p)
    size = signed(p, 0.02, 0.06) * p.robot.limits[j]
    on_drive(p, j, lambda s, u: u + size * (s.t > start))
    return at(p, j, ("bias", DRIVE))


@named
def drive_delay(p: Plant) -> Truth:
    j, rows = loaded_joint(p), int(p.rng.integers(15, 30))
    on_drive(p, j, lambda s, u: s.past[max(len(s.past) - 1 - rows, 0)][j])
    return at(p, j, ("delay", DRIVE))


@kind
def drive_saturated(p: Plant) -> Truth:
    j = loaded_joint(p)
    mean, spread = p.loads()
    level = p.rng.uniform(0.9, 1.3) * (spread[j] + p.robot.coulomb[j])
    on_drive(p, j, lambda s, u: float(np.clip(u, mean[j] - level, mean[j] + level)))
    return at(p, j)


@kind
def drive_runaway(p: Plant) -> Truth:
    j, start = any_joint(p), p.rng.uniform(2.0, 5.0)
    size = signed(p, 0.3, 0.8) * p.robot.limits[j]
    on_drive(p, j, lambda s, u: size if s.t > start else u)
    return at(p, j)


@kind
def drive_dropouts(p: Plant) -> Truth:
    j = loaded_joint(p)
    starts = p.rng.uniform(0.5, p.duration - 0.5, 5)
    lengths = p.rng.uniform(0.05, 0.12, 5)
    on_drive(p, j, lambda s, u: 0.0 if ((s.t > starts) & (s.t < starts + lengths)).any() else u)
    return at(p, j)


@kind
def no_gravity_compensation(p: Plant) -> Truth:
    start = begin(p)
    p.drive.append(lambda s, u: u - s.gravity if s.t > start else u)
    return everywhere(p)


@kind
def torque_ripple(p: Plant) -> Truth:
    j, count, phase = any_joint(p), p.rng.integers(15, 40), p.rng.uniform(0, 6)
    size = p.rng.uniform(0.01, 0.03) * p.robot.limits[j]
    p.friction.append(lambda s: only(p, j, size * np.sin(count * s.q[j] + phase)))
    return at(p, j)


@kind
def motor_inertia(p: Plant) -> Truth:
    j, share = any_joint(p), p.rng.choice([0.4, 0.5, 1.8, 2.2])
    p.motor_inertias[j] *= share
    return at(p, j)


# Friction


def _friction(p: Plant, joint: int, share: Callable[[Any], float]) -> Truth:
    """Adds friction in proportion to 2 % of the torque limit, by a share of the state."""
    size = p.rng.uniform(0.015, 0.035) * p.robot.limits[joint]

    def lost(s: Any) -> Array:
        # A wide transition through zero is stable also for a large torque and a small inertia.
        width = max(0.003, 3.0 * STEP * size / p.motor_inertias[joint])
        sign = float(np.clip(s.v[joint] / width, -1.0, 1.0))
        return only(p, joint, size * (sign + 0.5 * s.v[joint]) * share(s))

    p.friction.append(lost)
    return at(p, joint, ("friction", "joint"))


@named
def friction_more(p: Plant) -> Truth:
    start = begin(p)
    return _friction(p, any_joint(p), lambda s: float(s.t > start))


@named
def friction_less(p: Plant) -> Truth:
    j, share = any_joint(p), p.rng.uniform(0.1, 0.4)
    p.coulomb[j] *= share
    p.viscous[j] *= share
    return at(p, j, ("friction", "joint"))


@named
def friction_warming(p: Plant) -> Truth:
    return _friction(p, any_joint(p), lambda s: s.t / p.duration)  # friction, but not constant


@named
def friction_of_load(p: Plant) -> Truth:
    j = loaded_joint(p)
    usual = 2.0 * p.loads()[1][j]
    return _friction(p, j, lambda s: min(abs(s.torques[j]) / usual, 3.0))  # friction, not constant


@named
def friction_stribeck(p: Plant) -> Truth:
    j, speed = any_joint(p), p.rng.uniform(0.05, 0.15)
    return _friction(p, j, lambda s: float(np.exp(-((s.v[j] / speed) ** 2))))  # at low speed only


@named
def friction_asymmetric(p: Plant) -> Truth:
    j = any_joint(p)
    side = p.rng.choice([-1.0, 1.0])
    truth = _friction(p, j, lambda s: float(side * s.v[j] > 0))
    # Friction of one direction is half a symmetric friction and half a constant torque.
    return Truth(truth.right | {(p.robot.joints[j], "bias", DRIVE)}, truth.visible)


@named
def brake_closed(p: Plant) -> Truth:
    j, start = loaded_joint(p), p.rng.uniform(1.5, 3.5)
    p.brake = (j, start)
    return at(p, j, ("stuck", "joint"))


# Joints


@kind
def backlash(p: Plant) -> Truth:
    half = np.deg2rad(p.rng.uniform(0.3, 1.0))
    p.play = (gravity_joint(p), 0.0, half)
    p.play = (p.play[0], 50.0 * p.robot.limits[p.play[0]], half)
    return everywhere(p)  # the angle of the link differs from that of the encoder


@kind
def elastic_joint(p: Plant) -> Truth:
    j = int(p.rng.choice([1, 3]))
    p.play = (j, p.rng.uniform(4.0, 10.0) * p.robot.limits[j], 0.0)
    return everywhere(p)


@kind
def cable_spring(p: Plant) -> Truth:
    j, center = any_joint(p), p.rng.uniform(-0.2, 0.2)
    size = p.rng.uniform(0.1, 0.25) * p.robot.limits[j]
    p.links.append(lambda s: only(p, j, -size * np.tanh(2.0 * (s.q[j] - p.start[j] - center))))
    return at(p, j)


# Encoders


@named
def encoder_offset(p: Plant) -> Truth:
    j, offset = gravity_joint(p), np.deg2rad(signed(p, 1.5, 5.0))
    on_encoder(p, j, lambda q: q + offset)
    return everywhere(p, (p.robot.joints[j], "encoder", "encoder"))


@named
def encoder_eccentric(p: Plant) -> Truth:
    j, size = gravity_joint(p), np.deg2rad(p.rng.uniform(2.0, 5.0))
    phase = p.rng.choice([0.0, np.pi]) + p.rng.uniform(0.5, 1.2) - p.start[j]
    on_encoder(p, j, lambda q: q + size * np.sin(q + phase))
    # In a range of 30 degrees, this is an offset that changes by less than half.
    return everywhere(p, (p.robot.joints[j], "encoder", "encoder"))


@kind
def encoder_quantized(p: Plant) -> Truth:
    j = any_joint(p)
    p.resolution[j] = np.deg2rad(p.rng.uniform(0.05, 0.2))
    return everywhere(p)


@kind
def gear_ratio(p: Plant) -> Truth:
    j, ratio = gravity_joint(p), p.rng.choice([0.9, 1.1, 1.25])
    on_encoder(p, j, lambda q: ratio * q)
    return everywhere(p)


# Links and base


def _scale(body: Any, share: float) -> None:
    body.mass *= share
    for name in ("inertia", "fullinertia"):
        values = getattr(body, name)
        if np.isfinite(values).all():
            setattr(body, name, share * np.array(values))


def _moving(p: Plant, spec: Any) -> list[Any]:
    """Returns the bodies of the joints from base to flange."""
    return [next(j.parent for j in spec.joints if j.name == name) for name in p.robot.joints]


def _middle_link(p: Plant) -> int:
    """Returns a link that is not near the flange, where its mass would be like a payload."""
    return int(p.rng.integers(2, 4))


def _load(p: Plant) -> Callable[[Any], None]:
    mass = p.rng.uniform(0.02, 0.05) * p.robot.limits[1]
    side, out = p.rng.uniform(-0.05, 0.05, 2), p.rng.uniform(0.02, 0.1)

    def attach(spec: Any) -> None:
        z = p.robot.flange + np.sign(p.robot.flange) * out
        load = _moving(p, spec)[-1].add_body(name="load", pos=[*side, z])
        load.mass, load.ipos, load.inertia = mass, [0, 0, 0], [2e-3 * mass] * 3
        load.explicitinertial = 1

    return attach


PAYLOAD: Named = ("flange", "payload", "flange")


@named
def payload(p: Plant) -> Truth:
    p.edits.append(_load(p))
    return everywhere(p, PAYLOAD)


@named
def payload_picked(p: Plant) -> Truth:
    p.changed = (p.rng.uniform(2.0, 4.0), _load(p))
    return everywhere(p, PAYLOAD)


@named
def masses(p: Plant) -> Truth:
    share = p.rng.choice([0.8, 0.9, 1.1, 1.2])
    p.edits.append(lambda spec: [_scale(body, share) for body in _moving(p, spec)])
    return everywhere(p, ("links", "masses", "links"))


@kind
def link_mass(p: Plant) -> Truth:
    link, share = _middle_link(p), p.rng.choice([0.6, 1.4, 1.7])
    p.edits.append(lambda spec: _scale(_moving(p, spec)[link], share))
    return everywhere(p)


@kind
def link_center(p: Plant) -> Truth:
    link, shift = _middle_link(p), p.rng.normal(size=3)
    shift *= p.rng.uniform(0.03, 0.06) / np.linalg.norm(shift)

    def move(spec: Any) -> None:
        body = _moving(p, spec)[link]
        body.ipos = np.array(body.ipos) + shift

    p.edits.append(move)
    return everywhere(p)


@kind
def tilted_base(p: Plant) -> Truth:
    tilt, heading = np.deg2rad(p.rng.uniform(3.0, 8.0)), p.rng.uniform(0, 2 * np.pi)
    along = np.sin(tilt) * np.array([np.cos(heading), np.sin(heading)])

    def turn(spec: Any) -> None:
        spec.option.gravity = -9.81 * np.array([*along, np.cos(tilt)])

    p.edits.append(turn)
    return everywhere(p)


def _push(p: Plant, force: Callable[[float], Array]) -> Truth:
    link = int(p.rng.integers(3, 7))
    p.pushes.append((_moving(p, p.robot.spec())[link].name, force))
    return everywhere(p)


def _sideways(p: Plant) -> Array:
    """Returns a random force that is mostly horizontal, N."""
    heading = p.rng.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(heading), np.sin(heading), p.rng.uniform(-0.4, 0.4)])
    return p.rng.uniform(0.08, 0.2) * p.robot.limits[1] * direction


@kind
def contact(p: Plant) -> Truth:
    start, length, force = p.rng.uniform(1.5, 4.0), p.rng.uniform(0.8, 2.0), _sideways(p)
    return _push(p, lambda t: force * np.sin(np.pi * np.clip((t - start) / length, 0.0, 1.0)) ** 2)


@kind
def external_force(p: Plant) -> Truth:
    force = _sideways(p)
    return _push(p, lambda t: force)


# Logs


def on_log(p: Plant, signal: str, change: Callable[[Log, Array], Array]) -> None:
    p.logged.append(lambda log: log.with_(**{signal: change(log, getattr(log, signal))}))


def _flip(p: Plant, joint: int, signal: str) -> None:
    on_log(p, signal, lambda log, x: x * (1.0 - 2.0 * only(p, joint)))


def _swap(p: Plant, pair: tuple[int, int], signal: str) -> None:
    order = np.arange(len(p.robot.limits))
    order[list(pair)] = order[list(pair)[::-1]]
    on_log(p, signal, lambda log, x: x[:, order])


@kind
def log_angle_sign(p: Plant) -> Truth:
    _flip(p, any_joint(p), "angles")
    return everywhere(p)


@named
def log_torque_sign(p: Plant) -> Truth:
    j = loaded_joint(p)
    _flip(p, j, "torques")
    return at(p, j, ("sign", SENSOR))  # the log is that of a sensor with a wrong sign


@named
def log_command_sign(p: Plant) -> Truth:
    j = loaded_joint(p)
    _flip(p, j, "commands")
    return at(p, j, ("sign", DRIVE))  # the log is that of a drive with a wrong sign


@kind
def log_torques_swapped(p: Plant) -> Truth:
    pair = two_joints(p)
    _swap(p, pair, "torques")
    return at(p, pair)


@kind
def log_angles_swapped(p: Plant) -> Truth:
    _swap(p, two_joints(p), "angles")
    return everywhere(p)


@kind
def log_commands_swapped(p: Plant) -> Truth:
    pair = two_joints(p)
    _swap(p, pair, "commands")
    return at(p, pair)


@kind
def log_degrees(p: Plant) -> Truth:
    on_log(p, "angles", lambda log, x: np.rad2deg(x))
    return everywhere(p)


@named
def log_torques_late(p: Plant) -> Truth:
    delay = p.rng.uniform(0.02, 0.08)
    on_log(p, "torques", lambda log, x: late(log.times, x, delay))
    # In the log, each torque sensor is delayed.
    return everywhere(p, *((name, "delay", SENSOR) for name in p.robot.joints))


@kind
def log_angles_late(p: Plant) -> Truth:
    delay = p.rng.uniform(0.02, 0.06)
    on_log(p, "angles", lambda log, x: late(log.times, x, delay))
    return everywhere(p)


@kind
def log_clock_drift(p: Plant) -> Truth:
    rate = signed(p, 0.005, 0.015)  # up to 0.1 s at the end
    on_log(p, "commands", lambda log, x: late(log.times, x, rate * log.times))
    return everywhere(p)


@kind
def log_dropped_samples(p: Plant) -> Truth:
    share, gap = p.rng.uniform(0.1, 0.3), p.rng.uniform(1.0, 5.0)
    length, rng = p.rng.uniform(0.05, 0.2), p.rng

    def drop(log: Log) -> Log:
        stays = rng.random(len(log.times)) > share
        stays &= (log.times < gap) | (log.times > gap + length)
        return Log(log.times[stays], log.angles[stays], log.torques[stays], log.commands[stays])

    p.logged.append(drop)
    return Truth()


# Several faults


@named
def two_faults(p: Plant) -> Truth:
    first, second = p.rng.choice([sensor_bias, sensor_gain, payload, encoder_offset], 2, False)
    third = p.rng.choice([friction_more, drive_gain])
    truths = [each(p) for each in (first, third)] if p.rng.random() < 0.5 else [first(p), second(p)]
    return Truth(
        frozenset().union(*(each.right for each in truths)),
        frozenset().union(*(each.visible for each in truths)),
    )
