"""The kinds of faults: each function adds one to a `Plant`, and declares what is right about it.

Sizes, joints and times are drawn from the random generator of the plant, in a range that is clearly
visible in the residuals and occurs in laboratories. Faults of sensors and logs change the rows of
the run. All other faults act in the simulation.

A kind that the product cannot name has no right verdict except `unexplained`. A comment explains a
right verdict that has another name than the fault.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from judge import Named, Truth
from plant import STEP, Array, Log, Plant, Robot

Pair = tuple[str, str]  # kind and part of a verdict
KINDS: dict[str, Callable[[Plant], Truth]] = {}
NAMED: set[str] = set()  # kinds that the product can name
SENSOR, DRIVE = "torque sensor", "drive"
FRICTION, PAYLOAD = ("friction", "joint"), ("flange", "payload", "flange")
CLEAN = "none"


def make_plant(name: str, seed: int, robot: Robot) -> tuple[Plant, Truth]:
    """Returns a plant with a fault of this kind, and what is right about the fault."""
    plant = Plant(robot, np.random.default_rng([seed, *name.encode(), *robot.name.encode()]))
    return plant, Truth() if name == CLEAN else KINDS[name](plant)


# Declarations


def kind(function: Callable[[Plant], Truth]) -> Callable[[Plant], Truth]:
    KINDS[function.__name__] = function
    return function


def named(function: Callable[[Plant], Truth]) -> Callable[[Plant], Truth]:
    NAMED.add(function.__name__)
    return kind(function)


def at_joint(add: Any, choose: Callable[[Plant], int], *right: Pair) -> Callable[[Any], Any]:
    """Declares a fault that is visible at one joint: `add` adds what the function returns."""

    def declare(function: Any) -> Any:
        def make(p: Plant) -> Truth:
            joint = choose(p)
            add(p, joint, function(p, joint))
            return at(p, joint, *right)

        make.__name__ = function.__name__
        (named if right else kind)(make)
        return make

    return declare


def at(p: Plant, joints: int | Iterable[int], *right: Pair) -> Truth:
    """Returns the truth of a fault that is visible only at some joints."""
    joints = [joints] if isinstance(joints, int) else joints
    names = [p.robot.joints[joint] for joint in joints]
    return Truth(frozenset((name, *each) for name in names for each in right), frozenset(names))


def everywhere(p: Plant, *right: Named) -> Truth:
    """Returns the truth of a fault that is visible at all joints."""
    return Truth(frozenset(right), frozenset(p.robot.joints))


# Draws


def any_joint(p: Plant) -> int:
    return int(p.rng.integers(len(p.robot.limits)))


def loaded_joints(p: Plant) -> list[int]:
    """Returns the four joints whose link torques change most, relative to their limits."""
    order: list[int] = np.argsort(-p.loads()[1] / p.robot.limits).tolist()
    return order[:4]


def loaded(p: Plant) -> int:
    return int(p.rng.choice(loaded_joints(p)))


def elbow(p: Plant) -> int:
    """Returns joint 2, 4 or 6, if its angle changes gravity torques clearly."""
    load = np.hypot(*p.loads()) / p.robot.limits
    return int(p.rng.choice([joint for joint in (1, 3, 5) if load[joint] > 0.02]))


def begin(p: Plant) -> float:
    """Returns the start of a fault: half of them exist from the start of the run."""
    return float(p.rng.choice([0.0, p.rng.uniform(1.5, 3.5)]))


def signed(p: Plant, least: float, most: float) -> float:
    return float(p.rng.choice([-1.0, 1.0]) * p.rng.uniform(least, most))


def factor(p: Plant) -> float:
    return float(p.rng.choice([p.rng.uniform(0.6, 0.85), p.rng.uniform(1.2, 1.5)]))


# Effects


def only(p: Plant, joint: int, size: float = 1.0) -> Array:
    column = np.zeros(len(p.robot.limits))
    column[joint] = size
    return column


def _changed(joint: int, change: Callable[[Array, Array], Array]) -> Callable[[Log], Log]:
    def apply(log: Log) -> Log:
        torques = log.torques.copy()
        torques[:, joint] = change(log.times, torques[:, joint])
        return log.with_(torques=torques)

    return apply


def sensor(p: Plant, joint: int, change: Callable[[Array, Array], Array]) -> None:
    """Changes the true torques of a joint; `change` has the times and the torques."""
    p.sensors.append(_changed(joint, change))


def reading(p: Plant, joint: int, change: Callable[[Array, Array], Array]) -> None:
    """Changes the torques of a joint after the noise of the sensor."""
    p.logged.append(_changed(joint, change))


def drive(p: Plant, joint: int, change: Callable[[Any, float], float]) -> None:
    """Changes the motor torque of a joint; `change` has the state and the torque."""

    def apply(state: Any, torques: Array) -> Array:
        return torques + only(p, joint, change(state, torques[joint]) - torques[joint])

    p.drive.append(apply)


def friction(p: Plant, joint: int, share: Callable[[Any], float]) -> None:
    """Adds a share of a friction of 1 to 2.5 % of the torque limit."""
    size = p.rng.uniform(0.01, 0.025) * p.robot.limits[joint]
    # A wide transition through zero is stable also for a large torque and a small inertia.
    width = max(0.003, 3.0 * STEP * size / p.motor_inertias[joint])

    def lost(s: Any) -> Array:
        sign = np.clip(s.v[joint] / width, -1.0, 1.0)
        return only(p, joint, size * (sign + 0.5 * s.v[joint]) * share(s))

    p.friction.append(lost)


def encoder(p: Plant, joint: int, change: Callable[[float], float]) -> None:
    p.encoders.append(lambda q: q + only(p, joint, change(q[joint]) - q[joint]))


def on_log(p: Plant, signal: str, change: Callable[[Array, Array], Array]) -> None:
    """Changes the signals of all joints in the log; `change` has the times and the signals."""
    p.logged.append(lambda log: log.with_(**{signal: change(log.times, getattr(log, signal))}))


def late(times: Array, values: Array, delay: float | Array) -> Array:
    """Returns values of one signal or of several joints, delayed by a time in s."""
    columns = values.reshape(len(times), -1).T
    moved = [np.interp(times - delay, times, column) for column in columns]
    return np.stack(moved, axis=1).reshape(values.shape)


# Torque sensors


@at_joint(sensor, loaded, ("sign", SENSOR))
def sensor_sign(p: Plant, j: int) -> Any:
    return lambda t, x: -x


@at_joint(sensor, loaded, ("gain", SENSOR))
def sensor_gain(p: Plant, j: int) -> Any:
    start, gain = begin(p), factor(p)
    return lambda t, x: np.where(t > start, gain, 1.0) * x


@at_joint(sensor, any_joint, ("bias", SENSOR))
def sensor_bias(p: Plant, j: int) -> Any:
    start, size = begin(p), signed(p, 0.02, 0.06) * p.robot.limits[j]
    return lambda t, x: x + size * (t > start)


@at_joint(sensor, any_joint, ("bias", SENSOR))  # an offset that grows
def sensor_drift(p: Plant, j: int) -> Any:
    size = signed(p, 0.03, 0.08) * p.robot.limits[j]
    return lambda t, x: x + size * t / p.duration


@at_joint(sensor, loaded, ("delay", SENSOR))
def sensor_delay(p: Plant, j: int) -> Any:
    delay = p.rng.uniform(0.03, 0.08)
    return lambda t, x: late(t, x, delay)


@at_joint(sensor, loaded, ("delay", SENSOR))  # a filter delays slow signals by its time constant
def sensor_lowpass(p: Plant, j: int) -> Any:
    share = STEP / p.rng.uniform(0.03, 0.08)

    def smooth(t: Array, x: Array) -> Array:
        result: Array = x.copy()
        for k in range(1, len(x)):
            result[k] = result[k - 1] + share * (x[k] - result[k - 1])
        return result

    return smooth


@at_joint(sensor, any_joint, ("noise", SENSOR))
def sensor_noise(p: Plant, j: int) -> Any:
    start, size = begin(p), p.rng.uniform(0.005, 0.02) * p.robot.limits[j]
    return lambda t, x: x + size * (t > start) * p.rng.normal(size=len(t))


@at_joint(sensor, any_joint, ("noise", SENSOR))
def sensor_noise_bursts(p: Plant, j: int) -> Any:
    size, starts = p.rng.uniform(0.01, 0.03) * p.robot.limits[j], p.rng.uniform(0.5, 6.0, 4)

    def burst(t: Array, x: Array) -> Array:
        is_on = ((t[:, None] > starts) & (t[:, None] < starts + 0.4)).any(axis=1)
        return np.asarray(x + size * is_on * p.rng.normal(size=len(t)))

    return burst


@at_joint(reading, loaded, ("stuck", SENSOR))
def sensor_stuck(p: Plant, j: int) -> Any:
    start, is_zero = p.rng.uniform(1.5, 3.5), p.rng.random() < 0.5
    return lambda t, x: np.where(t > start, 0.0 if is_zero else x[np.argmax(t > start)], x)


# Rounding is like noise, and a coarse value is constant for a while.
@at_joint(reading, loaded, ("noise", SENSOR), ("stuck", SENSOR))
def sensor_quantized(p: Plant, j: int) -> Any:
    unit = p.rng.uniform(0.01, 0.03) * p.robot.limits[j]
    return lambda t, x: np.round(x / unit) * unit


@at_joint(reading, loaded, ("stuck", SENSOR))  # it is constant while the torque is out of range
def sensor_clipped(p: Plant, j: int) -> Any:
    share = p.rng.uniform(0.3, 0.6)

    def clip(t: Array, x: Array) -> Array:
        side = np.sign(x.max() + x.min())
        edge = side * (np.max(side * x) - share * np.ptp(x))
        return np.asarray(side * np.minimum(side * x, side * edge))

    return clip


@at_joint(sensor, loaded)
def sensor_hysteresis(p: Plant, j: int) -> Any:
    half = p.rng.uniform(0.3, 0.6) * p.loads()[1][j] + 0.005 * p.robot.limits[j]

    def play(t: Array, x: Array) -> Array:
        result, value = np.empty_like(x), x[0]
        for k, each in enumerate(x):
            value = np.clip(value, each - half, each + half)
            result[k] = value
        return result

    return play


@kind
def sensor_crosstalk(p: Plant) -> Truth:
    source, share = int(np.argmax(p.loads()[1])), signed(p, 0.1, 0.25)
    j = (source + int(p.rng.integers(1, 7))) % 7
    p.sensors.append(
        lambda log: log.with_(
            torques=log.torques + only(p, j, share) * log.torques[:, source, None]
        )
    )
    return at(p, j)


# Drives


@at_joint(drive, any_joint, ("sign", DRIVE))
def drive_sign(p: Plant, j: int) -> Any:
    start = p.rng.uniform(2.0, 5.0)
    return lambda s, u: -u if s.t > start else u


@at_joint(drive, any_joint, ("gain", DRIVE))
def drive_gain(p: Plant, j: int) -> Any:
    start, gain = begin(p), factor(p)
    return lambda s, u: gain * u if s.t > start else u


@at_joint(drive, any_joint, ("gain", DRIVE))  # the motor torque per commanded torque is different
def torque_constant(p: Plant, j: int) -> Any:
    share = p.rng.choice([0.75, 0.85, 1.2, 1.3])
    return lambda s, u: share * u


@at_joint(drive, any_joint, ("bias", DRIVE))
def drive_bias(p: Plant, j: int) -> Any:
    start, size = begin(p), signed(p, 0.02, 0.06) * p.robot.limits[j]
    return lambda s, u: u + size * (s.t > start)


@at_joint(drive, loaded, ("delay", DRIVE))
def drive_delay(p: Plant, j: int) -> Any:
    rows = int(p.rng.integers(15, 30))
    return lambda s, u: s.past[max(len(s.past) - 1 - rows, 0)][j]


@at_joint(drive, loaded, ("saturation", "drive"))
def drive_saturated(p: Plant, j: int) -> Any:
    mean, spread = (each[j] for each in p.loads())
    level = p.rng.uniform(0.75, 0.95) * (abs(mean) + 1.8 * spread + p.robot.coulomb[j])
    return lambda s, u: np.clip(u, -level, level)


@at_joint(drive, any_joint)
def drive_runaway(p: Plant, j: int) -> Any:
    start, size = p.rng.uniform(2.0, 5.0), signed(p, 0.3, 0.8) * p.robot.limits[j]
    return lambda s, u: size if s.t > start else u


@at_joint(drive, loaded)
def drive_dropouts(p: Plant, j: int) -> Any:
    starts, lengths = p.rng.uniform(0.5, 6.5, 5), p.rng.uniform(0.05, 0.12, 5)
    return lambda s, u: 0.0 if ((s.t > starts) & (s.t < starts + lengths)).any() else u


@at_joint(drive, any_joint)
def torque_ripple(p: Plant, j: int) -> Any:
    count, phase = p.rng.integers(15, 40), p.rng.uniform(0.0, 6.0)
    size = p.rng.uniform(0.01, 0.03) * p.robot.limits[j]
    return lambda s, u: u + size * np.sin(count * s.q[j] + phase)


@named
def no_gravity_compensation(p: Plant) -> Truth:
    start = begin(p)
    p.drive.append(lambda s, u: u - s.gravity if s.t > start else u)
    return everywhere(p, ("commands", "gravity compensation", "drive"))


@named
def motor_inertia(p: Plant) -> Truth:
    j = any_joint(p)
    p.motor_inertias[j] *= p.rng.choice([0.4, 0.5, 1.8, 2.2])
    return at(p, j, ("motor inertia", "drive"))


# Friction. All of these are friction, but not all are constant during the run.


@at_joint(friction, any_joint, FRICTION)
def friction_more(p: Plant, j: int) -> Any:
    start = begin(p)
    return lambda s: float(s.t > start)


@named
def friction_less(p: Plant) -> Truth:
    j, share = any_joint(p), p.rng.uniform(0.1, 0.4)
    p.coulomb[j] *= share
    p.viscous[j] *= share
    return at(p, j, FRICTION)


@at_joint(friction, any_joint, FRICTION, ("friction drift", "joint"))
def friction_warming(p: Plant, j: int) -> Any:
    return lambda s: 1.5 * s.t / p.duration


@at_joint(friction, loaded, FRICTION, ("load friction", "joint"))
def friction_of_load(p: Plant, j: int) -> Any:
    usual = max(np.hypot(*p.loads())[j], 0.1 * p.robot.limits[j])  # at most 0.25 Nm per Nm
    return lambda s: abs(s.torques[j]) / usual


@at_joint(friction, any_joint, FRICTION)
def friction_stribeck(p: Plant, j: int) -> Any:
    speed = p.rng.uniform(0.05, 0.15)
    return lambda s: 1.5 * np.exp(-((s.v[j] / speed) ** 2))


# Friction in one direction is half a symmetric friction and half a constant torque.
@at_joint(friction, any_joint, FRICTION, ("bias", DRIVE))
def friction_asymmetric(p: Plant, j: int) -> Any:
    side = p.rng.choice([-1.0, 1.0])
    return lambda s: 1.5 * (side * s.v[j] > 0)


@named
def brake_closed(p: Plant) -> Truth:
    p.brake = (loaded(p), p.rng.uniform(1.5, 3.5))
    return at(p, p.brake[0], ("stuck", "joint"))


# Springs. With play, the angle of the link differs from that of the encoder.


@named
def backlash(p: Plant) -> Truth:
    j = elbow(p)
    p.play = (j, 50.0 * p.robot.limits[j], np.deg2rad(p.rng.uniform(0.5, 1.2)))
    name = p.robot.joints[j]
    # The play has elastic ends. While the torque has one sign, it is like an encoder offset.
    right = [("backlash", "joint"), ("elasticity", "joint"), ("encoder", "encoder")]
    return everywhere(p, *((name, *each) for each in right))


@named
def elastic_joint(p: Plant) -> Truth:
    j = int(p.rng.choice([1, 3]))
    p.play = (j, p.rng.uniform(4.0, 10.0) * p.robot.limits[j], 0.0)
    return everywhere(p, (p.robot.joints[j], "elasticity", "joint"))


@named
def cable_spring(p: Plant) -> Truth:
    j, center = any_joint(p), p.rng.uniform(-0.2, 0.2)
    size = p.rng.uniform(0.05, 0.15) * p.robot.limits[j]
    p.links.append(lambda s: only(p, j, -size * np.tanh(2.0 * (s.q[j] - p.start[j] - center))))
    return at(p, j, ("spring", "joint"))


# Encoders


@named
def encoder_offset(p: Plant) -> Truth:
    j, offset = elbow(p), np.deg2rad(signed(p, 1.5, 5.0))
    encoder(p, j, lambda q: q + offset)
    return everywhere(p, (p.robot.joints[j], "encoder", "encoder"))


@named
def encoder_eccentric(p: Plant) -> Truth:
    j, size = elbow(p), np.deg2rad(p.rng.uniform(2.0, 5.0))
    phase = p.rng.choice([0.0, np.pi]) + p.rng.uniform(0.5, 1.2) - p.start[j]
    encoder(p, j, lambda q: q + size * np.sin(q + phase))
    # In a range of 30 degrees, this is an offset that changes by about half.
    name = p.robot.joints[j]
    return everywhere(p, (name, "encoder", "encoder"), (name, "encoder scale", "encoder"))


@kind
def encoder_quantized(p: Plant) -> Truth:
    p.resolution[any_joint(p)] = np.deg2rad(p.rng.uniform(0.05, 0.2))
    return everywhere(p)


@named
def gear_ratio(p: Plant) -> Truth:
    j, ratio = elbow(p), p.rng.choice([0.9, 1.1, 1.25])
    encoder(p, j, lambda q: ratio * q)
    name = p.robot.joints[j]
    return everywhere(p, (name, "encoder scale", "encoder"), (name, "scale", "angles"))


# Links, base and forces


def _bodies(p: Plant, spec: Any) -> list[Any]:
    """Returns the bodies that the joints move, from base to flange."""
    return [joint.parent for joint in spec.joints if joint.name in p.robot.joints]


def _scale(body: Any, share: float) -> None:
    body.mass *= share
    for name in ("inertia", "fullinertia"):
        setattr(body, name, share * np.array(getattr(body, name)))  # one of them is NaN or 0


def _load(p: Plant) -> Callable[[Any], None]:
    mass, out = p.rng.uniform(0.02, 0.05) * p.robot.limits[1], p.rng.uniform(0.02, 0.1)
    place = [*p.rng.uniform(-0.05, 0.05, 2), p.robot.flange + np.sign(p.robot.flange) * out]

    def attach(spec: Any) -> None:
        load = _bodies(p, spec)[-1].add_body(name="load", pos=place)
        load.mass, load.ipos, load.inertia = mass, [0, 0, 0], [2e-3 * mass] * 3
        load.explicitinertial = 1

    return attach


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

    def scale(spec: Any) -> None:
        for body in _bodies(p, spec):
            _scale(body, share)

    p.edits.append(scale)
    return everywhere(p, ("links", "masses", "links"))


# The mass of a link near the flange would be like a payload, so only links 3 and 4 change.


@named
def link_mass(p: Plant) -> Truth:
    link, share = p.rng.integers(2, 4), p.rng.choice([0.6, 1.4, 1.7])
    p.edits.append(lambda spec: _scale(_bodies(p, spec)[link], share))
    return everywhere(p, (p.robot.joints[link], "link mass", "link"))


@named
def link_center(p: Plant) -> Truth:
    link, shift = p.rng.integers(2, 4), p.rng.normal(size=3)
    shift *= p.rng.uniform(0.03, 0.06) / np.linalg.norm(shift)

    def move(spec: Any) -> None:
        body = _bodies(p, spec)[link]
        body.ipos = np.array(body.ipos) + shift

    p.edits.append(move)
    return everywhere(p, (p.robot.joints[link], "link center", "link"))


@named
def tilted_base(p: Plant) -> Truth:
    tilt, heading = np.deg2rad(p.rng.uniform(3.0, 8.0)), p.rng.uniform(0.0, 2.0 * np.pi)
    up = np.array([*np.sin(tilt) * np.array([np.cos(heading), np.sin(heading)]), np.cos(tilt)])
    p.edits.append(lambda spec: setattr(spec.option, "gravity", -9.81 * up))
    return everywhere(p, ("base", "tilt", "base"))


def _push(p: Plant, strength: Callable[[float], float]) -> Truth:
    # A vertical force would be like a payload.
    heading = p.rng.uniform(0.0, 2.0 * np.pi)
    direction = np.array([np.cos(heading), np.sin(heading), p.rng.uniform(-0.4, 0.4)])
    force = p.rng.uniform(0.08, 0.2) * p.robot.limits[1] * direction
    link = p.rng.integers(3, 7)
    body = _bodies(p, p.robot.spec())[link]
    p.pushes.append((body.name, lambda t: force * strength(t)))
    return everywhere(p, (p.robot.joints[link], "force", "link"))


@named
def contact(p: Plant) -> Truth:
    start, length = p.rng.uniform(1.5, 4.0), p.rng.uniform(0.8, 2.0)
    return _push(p, lambda t: np.sin(np.pi * np.clip((t - start) / length, 0.0, 1.0)) ** 2)


@named
def external_force(p: Plant) -> Truth:
    return _push(p, lambda t: 1.0)


# Logs


def _flip(p: Plant, joint: int, signal: str) -> None:
    on_log(p, signal, lambda t, x: x * (1.0 - 2.0 * only(p, joint)))


def _swap(p: Plant, signal: str) -> list[int]:
    pair: list[int] = p.rng.choice(loaded_joints(p), 2, replace=False).tolist()
    order = np.arange(len(p.robot.limits))
    order[pair] = pair[::-1]
    on_log(p, signal, lambda t, x: x[:, order])
    return pair


@named
def log_angle_sign(p: Plant) -> Truth:
    j = any_joint(p)
    _flip(p, j, "angles")
    return everywhere(p, (p.robot.joints[j], "sign", "angles"))


@named
def log_torque_sign(p: Plant) -> Truth:
    j = loaded(p)
    _flip(p, j, "torques")
    return at(p, j, ("sign", SENSOR))  # the log is that of a sensor with a wrong sign


@named
def log_command_sign(p: Plant) -> Truth:
    j = loaded(p)
    _flip(p, j, "commands")
    return at(p, j, ("sign", DRIVE))  # the log is that of a drive with a wrong sign


@named
def log_torques_swapped(p: Plant) -> Truth:
    return at(p, _swap(p, "torques"), ("swap", "measured torques"))


@named
def log_angles_swapped(p: Plant) -> Truth:
    pair = _swap(p, "angles")
    return everywhere(p, *((p.robot.joints[j], "swap", "angles") for j in pair))


@named
def log_commands_swapped(p: Plant) -> Truth:
    return at(p, _swap(p, "commands"), ("swap", "commanded torques"))


@named
def log_degrees(p: Plant) -> Truth:
    on_log(p, "angles", lambda t, x: np.rad2deg(x))
    return everywhere(p, ("all joints", "scale", "angles"))


@named
def log_torques_late(p: Plant) -> Truth:
    delay = p.rng.uniform(0.03, 0.08)
    on_log(p, "torques", lambda t, x: late(t, x, delay))
    # In the log, each torque sensor is delayed.
    right = [(name, "delay", SENSOR) for name in p.robot.joints]
    return everywhere(p, ("all joints", "delay", "measured torques"), *right)


@named
def log_angles_late(p: Plant) -> Truth:
    delay = p.rng.uniform(0.03, 0.06)
    on_log(p, "angles", lambda t, x: late(t, x, delay))
    return everywhere(p, ("all joints", "delay", "angles"))


@named
def log_clock_drift(p: Plant) -> Truth:
    rate = signed(p, 0.005, 0.015)  # up to 0.1 s at the end
    on_log(p, "commands", lambda t, x: late(t, x, rate * t))
    return everywhere(p, ("commands", "clock", "commands"))


@kind
def log_dropped_samples(p: Plant) -> Truth:
    share, gap, length = p.rng.uniform([0.1, 1.0, 0.05], [0.3, 5.0, 0.2])

    def drop(log: Log) -> Log:
        stays = p.rng.random(len(log.times)) > share
        stays &= (log.times < gap) | (log.times > gap + length)
        return Log(log.times[stays], log.angles[stays], log.torques[stays], log.commands[stays])

    p.logged.append(drop)
    return Truth()


@named
def two_faults(p: Plant) -> Truth:
    first = p.rng.choice(["sensor_bias", "sensor_gain", "payload", "encoder_offset"])
    a, b = KINDS[first](p), KINDS[p.rng.choice(["friction_more", "drive_gain", "sensor_noise"])](p)
    return Truth(a.right | b.right, a.visible | b.visible)
