"""`Plant`: a robot arm in plain MuJoCo, with its own controller, friction, sensors and faults.

This module does not import sero_mj, so that an error of the product cannot hide itself here.

Convention of a log, the same as that of `sero-mj simulate --csv`: a row contains the angles at the
end of a step, and the torques that acted in this step. With the time step h, row k satisfies

    torques[k] = M(q[k-1]) a[k] + C(q[k-1], v[k-1]) v[k-1] + g(q[k-1])
    commands[k] - torques[k] = B a[k] + friction(v[k-1]),   a[k] = (v[k] - v[k-1]) / h

where v[k] = (q[k] - q[k-1]) / h. Torques are those of the joint on its outer link, positive in the
direction of the angle. The torque sensor is between gear and link, behind the motor inertia B and
the friction of the motor.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

Array = np.ndarray[Any, np.dtype[np.float64]]
STEP = 0.001  # s
HERE = Path(__file__).resolve().parent
MODELS = HERE.parents[1] / "models"
_BANDWIDTH = 20.0  # rad/s, of the position control
_COULOMB_SPEED = 0.003  # rad/s; below it, Coulomb friction is proportional to the velocity
_NOISE = 3e-4  # share of the torque limit; standard deviation of the torque sensors
_ABORT = 0.5  # rad; a larger error of an angle ends the run
_STILL = 1e5  # Nm s/rad, damping of a closed brake
# Angles around which the robots move, deg, and the flange on the last link, m.
_POSES = {
    "lwr": [0, 30, 0, -90, 0, 60, 0],
    "fr3": [0, -30, 0, -120, 0, 100, 30],
    "g3": [0, 30, 0, 80, 0, 60, 0],
}
_FLANGES = {"lwr": 0.078, "fr3": 0.107, "g3": -0.0615}
# The URDF of g3 declares no friction and no motor inertia.
_G3 = {
    "torque_limits": [39.0, 39.0, 39.0, 39.0, 9.0, 9.0, 9.0],
    "motor_inertias": [0.6, 0.6, 0.6, 0.6, 0.3, 0.3, 0.3],
    "viscous_friction": [1.0, 1.0, 1.0, 1.0, 0.5, 0.5, 0.5],
    "coulomb_friction": [0.8, 0.8, 0.8, 0.8, 0.3, 0.3, 0.3],
}
ROBOTS = tuple(_POSES)


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot as data: its model, and the parameters of its drives, shape (n,) each.

    Attributes:
        scene: scene that declares the robot for sero-mj: a name or a file.
        is_declared: whether the scene declares motor inertia and friction.
    """

    name: str
    scene: str
    is_declared: bool
    text: str
    limits: Array
    motor_inertias: Array
    viscous: Array
    coulomb: Array
    pose: Array
    flange: float

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(joint.name for joint in self.spec().joints)

    def spec(self) -> Any:
        """Returns a new model specification without contacts and joint stops."""
        spec = mujoco.MjSpec.from_string(self.text)
        spec.option.timestep = STEP
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        for geom in spec.geoms:
            geom.contype = geom.conaffinity = 0
        for joint in spec.joints:
            joint.limited = 0
        return spec


@cache
def load_robot(name: str) -> Robot:
    """Returns one of the `ROBOTS`, with the drive parameters that its files declare."""
    if name == "g3":
        text = (HERE / "robots" / "g3.urdf").read_text("utf-8")
        extension = '<mujoco><compiler fusestatic="true" balanceinertia="true"/></mujoco>'
        text = text.replace('<robot name="g3">', f'<robot name="g3">{extension}')
        table, scene = _G3, str(HERE / "robots" / "g3.urdf")
    else:
        text = (HERE / "robots" / f"{name}.xml").read_text("utf-8")
        declared = tomllib.loads((MODELS / name / "robot.toml").read_text("utf-8"))
        file = HERE / "robots" / f"{name}.toml"
        scene = str(file) if file.exists() else name
        more = tomllib.loads(file.read_text("utf-8"))["robots"][name] if file.exists() else {}
        table = {**declared, **declared["dynamics"], **more.get("dynamics", {})}
    keys = ("torque_limits", "motor_inertias", "viscous_friction", "coulomb_friction")
    limits, inertias, viscous, coulomb = (np.array(table[key], float) for key in keys)
    pose, is_declared = np.deg2rad(_POSES[name]), name != "g3"
    return Robot(
        name, scene, is_declared, text, limits, inertias, viscous, coulomb, pose, _FLANGES[name]
    )


@dataclass
class State:
    """The state before a step, for faults of drive, friction and links, shape (n,) each.

    Attributes:
        torques: link torques of the step before.
        gravity: gravity torques of the nominal model at the measured angles.
        past: commanded torques of all steps up to now.
    """

    t: float
    q: Array
    v: Array
    torques: Array
    gravity: Array
    past: list[Array]


@dataclass(frozen=True, eq=False)
class Log:
    """The rows of a run: times (T,), and angles, torques and commanded torques, (T, n)."""

    times: Array
    angles: Array
    torques: Array
    commands: Array

    def with_(self, **signals: Array) -> Log:
        return replace(self, **signals)

    def write(self, path: Path) -> None:
        """Writes the log as a table that `sero-mj compare` reads."""
        signals = ("joint_angles", "torques", "commanded_torques")
        names = [f"{signal}[{k}]" for signal in signals for k in range(self.angles.shape[1])]
        rows = np.column_stack([self.times, self.angles, self.torques, self.commands])
        header = ",".join(["time", *names])
        np.savetxt(path, rows, "%.9g", delimiter=",", header=header, comments="")


Effect = Callable[[State], Array]
Edit = Callable[[Any], None]


@dataclass(eq=False)
class Plant:
    """A robot that performs a smooth random motion; faults add entries to its lists.

    Attributes:
        edits: changes of the true model. The controller does not know them.
        changed: time in s and further changes of the true model from then on.
        drive: changes of the commanded torques to the torques of the motors.
        friction: additional torques against the motion, on the motor side.
        links: additional torques on the link side.
        pushes: body, and the force on its center of mass in the world frame by time.
        encoders: changes of the measured angles, also for the controller.
        sensors: changes of the log before the noise of the torque sensors is added.
        logged: changes of the log after that.
        play: joint, stiffness (Nm/rad) and half the free play (rad) between a motor and its link.
        brake: joint, and the time in s from which its brake is closed.
    """

    robot: Robot
    rng: np.random.Generator
    duration: float = 7.0
    edits: list[Edit] = field(default_factory=list)
    changed: tuple[float, Edit] | None = None
    drive: list[Callable[[State, Array], Array]] = field(default_factory=list)
    friction: list[Effect] = field(default_factory=list)
    links: list[Effect] = field(default_factory=list)
    pushes: list[tuple[str, Callable[[float], Array]]] = field(default_factory=list)
    encoders: list[Callable[[Array], Array]] = field(default_factory=list)
    sensors: list[Callable[[Log], Log]] = field(default_factory=list)
    logged: list[Callable[[Log], Log]] = field(default_factory=list)
    play: tuple[int, float, float] | None = None
    brake: tuple[int, float] | None = None

    def __post_init__(self) -> None:
        robot, rng, n = self.robot, self.rng, len(self.robot.limits)
        self.motor_inertias = robot.motor_inertias.copy()
        self.viscous, self.coulomb = robot.viscous.copy(), robot.coulomb.copy()
        self.nominal = robot.spec().compile()
        self.resolution = np.full(n, 1e-5)  # rad, of the encoders
        spread = np.where(np.arange(n) % 2 == 0, 30.0, 10.0)  # axes 1, 3, ... may turn far
        self.start = robot.pose + np.deg2rad(rng.uniform(-spread, spread))
        self._sizes = np.deg2rad(rng.uniform(4.0, 9.0, (3, n))) * rng.choice([-1.0, 1.0], n)
        low, high = np.array([[0.1], [0.2], [0.35]]), np.array([[0.2], [0.35], [0.6]])
        self._rates = 2.0 * np.pi * rng.uniform(low, high, (3, n))

    def reference(self, t: float) -> tuple[Array, Array]:
        """Returns the desired angles and velocities: three sines per joint, at rest at first."""
        angles = self.start + (self._sizes * (1.0 - np.cos(self._rates * t))).sum(axis=0)
        return angles, (self._sizes * self._rates * np.sin(self._rates * t)).sum(axis=0)

    def loads(self) -> tuple[Array, Array]:
        """Returns mean and standard deviation of the nominal link torques in the motion."""
        data, found = mujoco.MjData(self.nominal), []
        for t in np.arange(0.0, self.duration, 0.05):
            data.qpos[:], data.qvel[:] = self.reference(float(t))
            mujoco.mj_forward(self.nominal, data)
            found.append(data.qfrc_bias.copy())
        return np.mean(found, axis=0), np.std(found, axis=0)

    def measured(self, q: Array) -> Array:
        for encoder in self.encoders:
            q = encoder(q)
        return np.asarray(np.round(q / self.resolution) * self.resolution)

    def run(self) -> Log:
        """Simulates the run; it ends early if a joint leaves the desired motion."""
        rows = self._rows()
        times = np.asarray(STEP * np.arange(1, len(rows) + 1), np.float64)
        log = Log(times, *(np.array([row[k] for row in rows]) for k in range(3)))
        for change in self.sensors:
            log = change(log)
        noise = self.rng.normal(0.0, _NOISE, log.torques.shape) * self.robot.limits
        log = log.with_(torques=log.torques + noise)
        for change in self.logged:
            log = change(log)
        return log

    def _rows(self) -> list[tuple[Array, Array, Array]]:
        robot, n = self.robot, len(self.robot.limits)
        models = [self._true_model(self.edits)]
        if self.changed is not None:
            models.append(self._true_model([*self.edits, self.changed[1]]))
        model, model_data, spring = models[0], mujoco.MjData(models[0]), self._spring(models[0])
        dofs = [model.joint(name).dofadr[0] for name in robot.joints]
        nominal_data = mujoco.MjData(self.nominal)
        K, D = self._gains(nominal_data)
        q = self.start
        for _ in range(5):  # the measured angles are at the start of the desired motion
            q = q + self.start - self.measured(q)
        model_data.qpos[dofs] = q
        torques, rows, past = np.zeros(n), [], []
        widest = np.maximum(_COULOMB_SPEED, 1.5 * STEP * self.coulomb / self.motor_inertias)
        shift, inertia_torques = np.zeros(model.nv), np.zeros(model.nv)
        for k in range(round(self.duration / STEP)):
            t, data = k * STEP, model_data
            if self.changed is not None and t >= self.changed[0] and model is models[0]:
                model, data = models[1], mujoco.MjData(models[1])
                data.qpos[:], data.qvel[:] = model_data.qpos, model_data.qvel
                model_data = data
            if self.brake is not None and t >= self.brake[1]:
                model.dof_damping[dofs[self.brake[0]]] = _STILL
            q, v, before = data.qpos[dofs], data.qvel[dofs], data.qvel.copy()
            sensed = self.measured(q)
            nominal_data.qpos[:] = sensed
            mujoco.mj_forward(self.nominal, nominal_data)
            gravity = nominal_data.qfrc_bias.copy()
            desired, desired_velocity = self.reference(t)
            command = K * (desired - sensed) + D * (desired_velocity - v) + gravity
            command = np.clip(command, -robot.limits, robot.limits)
            past.append(command)
            state = State(t, q, v, torques, gravity, past)
            motor = command
            for drive in self.drive:
                motor = drive(state, motor)
            lost = self.coulomb * np.clip(v / widest, -1.0, 1.0) + self.viscous * v
            lost = lost + sum((each(state) for each in self.friction), np.zeros(n))
            shift[:] = 0.0
            shift[dofs] = sum((each(state) for each in self.links), np.zeros(n))
            for body, force in self.pushes:
                at = data.body(body)
                mujoco.mj_applyFT(model, data, force(t), np.zeros(3), at.xipos.copy(), at.id, shift)
            data.qfrc_applied[:] = shift
            data.qfrc_applied[dofs] += motor - lost
            spring(data)
            mujoco.mj_step(model, data)
            acceleration = (data.qvel - before) / STEP
            mujoco.mj_mulM(model, data, inertia_torques, acceleration)
            inertia_torques -= model.dof_armature * acceleration
            torques = (inertia_torques + data.qfrc_bias - shift)[dofs]
            rows.append((self.measured(data.qpos[dofs]), torques, command))
            if not np.abs(rows[-1][0] - desired).max() < _ABORT:
                break
        return rows

    def _true_model(self, edits: list[Edit]) -> Any:
        spec = self.robot.spec()
        for edit in edits:
            edit(spec)
        joints = list(spec.joints)  # from base to flange
        for joint, inertia in zip(joints, self.motor_inertias, strict=True):
            joint.armature = inertia
        if self.play is not None:
            joint = joints[self.play[0]]
            joint.parent.add_joint(
                name="play", type=mujoco.mjtJoint.mjJNT_HINGE, axis=joint.axis, pos=joint.pos
            )
        return spec.compile()

    def _spring(self, model: Any) -> Callable[[Any], None]:
        # The torque between motor and link at a joint with play: a spring outside of the dead zone.
        if self.play is None:
            return lambda data: None
        _, stiffness, half = self.play
        dof = model.joint("play").dofadr[0]
        damping = 0.0005 * stiffness

        def apply(data: Any) -> None:
            twist, rate = data.qpos[dof], data.qvel[dof]
            wound = twist - np.clip(twist, -half, half)
            is_wound = half == 0.0 or wound != 0.0
            data.qfrc_applied[dof] = -stiffness * wound - damping * rate * is_wound

        return apply

    def _gains(self, data: Any) -> tuple[Array, Array]:
        data.qpos[:] = self.start
        mujoco.mj_forward(self.nominal, data)
        full = np.zeros((self.nominal.nv, self.nominal.nv))
        mujoco.mj_fullM(self.nominal, data, full)
        inertia = np.diag(full) + self.robot.motor_inertias
        return inertia * _BANDWIDTH**2, 1.4 * inertia * _BANDWIDTH


def residuals(robot: Robot, log: Log) -> tuple[Array, Array]:
    """Returns the residuals of link and motor side by the nominal model, (T - 2, n) each.

    This is the convention above, with accelerations and inverse dynamics of plain MuJoCo.
    """
    model = robot.spec().compile()
    data = mujoco.MjData(model)
    q = log.angles
    v, a = np.diff(q, axis=0) / STEP, np.diff(q, n=2, axis=0) / STEP**2
    link, motor = np.empty_like(a), np.empty_like(a)
    for k, acceleration in enumerate(a):
        data.qpos[:], data.qvel[:], data.qacc[:] = q[k + 1], v[k], acceleration
        mujoco.mj_inverse(model, data)
        link[k] = log.torques[k + 2] - data.qfrc_inverse
        lost = robot.coulomb * np.clip(v[k] / _COULOMB_SPEED, -1, 1) + robot.viscous * v[k]
        motor[k] = log.commands[k + 2] - log.torques[k + 2] - lost
        motor[k] -= robot.motor_inertias * acceleration
    return link, motor
