"""Joint torque control against closed forms of one joint, and the robot's behavior with it."""

from __future__ import annotations

import gc
import weakref
from typing import Any

import numpy as np
import pytest
from conftest import raises_with
from numpy.typing import NDArray

from sero_mj import Plant, Scenario, Scene, SerialRobot, Simulation, World
from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.dynamics import TorqueControl
from sero_mj.simulate.control.torque_loop import LoopGains, TorqueLoop
from sero_mj.simulate.drives import Drives
from sero_mj.simulate.scenario import Run

Array = NDArray[np.float64]
HOME = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]
LINK, MOTOR = 1.5, 2.0  # kg m2, of the single joint
FRICTIONLESS = {"viscous_friction": [0.0] * 7, "coulomb_friction": [0.0] * 7}
FREE = {"kind": "gravity_compensation"}
SOFT = {"kind": "joint_impedance", "stiffness": 800.0}
CARTESIAN = {"kind": "cartesian_impedance", "stiffness": [1000.0, 1000, 1000, 80, 80, 80]}


def single(elastic: bool = False, viscous: float = 0.0, **control: Any) -> SerialRobot:
    """Returns one upright joint, which gravity does not load."""
    tensor = [LINK, LINK, LINK, 0.0, 0.0, 0.0]
    return SerialRobot(
        name="one",
        dh_convention="craig",
        dh_params=[[0.0, 0.0, 0.0, 0.5]],
        torque_limits=[100.0],
        elastic_joints=elastic,
        dynamics={
            "masses": [1.0, 1.0],
            "centers_of_mass": [[0.0, 0.0, 0.0]] * 2,
            "inertias": [tensor, tensor],
            "motor_inertias": [MOTOR],
            "viscous_friction": [viscous],
            "coulomb_friction": [0.0],
            "joint_stiffness": [8000.0],
            "joint_damping": [0.0],
        },
        torque_control=control,
    )


def step_response(robot: SerialRobot, asked: float, seconds: float) -> tuple[Array, Array]:
    """Returns times, s, and measured torques, Nm, after a command step, with physics at 100 kHz."""
    run = Run(timestep=1e-5, torque_control=True)
    plant = Plant(World(Scene(robots=[robot], floor=False), dynamic=True), timestep=1e-5)
    drives = Drives(plant.rows, {robot.name: robot}, run)
    torques = []
    for _ in range(round(seconds / 1e-5)):
        drives.step(np.array([asked]))
        torques.append(plant.measured[2, 0])
    return 1e-5 * (np.arange(len(torques)) + 0.5), np.array(torques)


def simulation(controller: dict[str, Any], elastic: bool = False, **fields: Any) -> Simulation:
    robot = {"joint_angles": HOME, "elastic_joints": elastic}
    robot |= {key: fields.pop(key) for key in ("dynamics", "torque_control") if key in fields}
    on = fields.pop("on", True)
    scene = Scene(robots=[SerialRobot.from_model("lwr", **robot)], floor=False)
    return Simulation(
        Scenario(scene, controllers={"lwr": controller}, **{"torque_control": on, **fields})
    )


def force(*newton: float, begin: float, end: float | None = None) -> dict[str, Any]:
    return {"kind": "force", "at": "lwr/flange", "force": newton, "begin": begin, "end": end}


def ran(made: Simulation) -> Simulation:
    made.advance(made.steps)
    return made


def flanges(made: Simulation, rows: Any = slice(None)) -> Array:
    """Returns the flange positions, (T, 3), m."""
    angles = made.log.of("lwr", "joint_angles")[rows]
    model = made.robot_model(made.robots["lwr"])
    found = []
    for each in angles:
        model.update(each, np.zeros(7))
        found.append(model.flange_position.copy())
    return np.array(found)


def test_rigid_joint_responds_to_a_step_as_a_first_order_lag() -> None:
    bandwidth, ratio, asked = 400.0, 4.0, 5.0
    robot = single(bandwidth=bandwidth, inertia_ratio=1 / ratio, friction_bandwidth=0.0)
    times, torques = step_response(robot, asked, 0.01)
    share = LINK / (LINK + MOTOR)  # of the motor torque that reaches the link
    last = asked * LINK / (LINK + MOTOR / ratio)
    rate = bandwidth * (1.0 + share * (ratio - 1.0))
    expected = last + (asked * share - last) * np.exp(-rate * times)
    # It includes the lag of the first step.
    np.testing.assert_allclose(torques, expected, rtol=0.01)
    assert torques[-1] > 1.5 * torques[0]


@pytest.mark.parametrize("damping", [0.2, 0.7])
def test_elastic_joint_responds_to_a_step_as_a_second_order_system(damping: float) -> None:
    robot = single(elastic=True, damping=damping, bandwidth=4000.0, friction_bandwidth=0.0)
    asked, shaped, stiffness = 5.0, MOTOR / 4, 8000.0
    times, torques = step_response(robot, asked, 0.1)
    # tau'' + (K T / Bt) tau' + K (1 / Bt + 1 / M) tau = K u / Bt
    slope = stiffness * 2 * damping * np.sqrt(shaped / stiffness) / shaped
    square = stiffness * (1 / shaped + 1 / LINK)
    last = asked * stiffness / shaped / square
    swing = np.sqrt(square - slope**2 / 4)
    expected = last * (
        1
        - np.exp(-slope * times / 2)
        * (np.cos(swing * times) + slope / (2 * swing) * np.sin(swing * times))
    )
    assert np.abs(torques - expected).max() < 0.03 * last
    assert torques.max() > 1.01 * last  # it oscillates


def test_friction_observer_is_a_first_order_low_pass() -> None:
    bandwidth, timestep = 80.0, 1 / 3000
    control = TorqueControl(friction_bandwidth=bandwidth)
    gains = LoopGains.of(control, robot_dynamics(single()), False)
    loop = TorqueLoop(gains, timestep, np.full(1, 30.0))  # drives saturate meanwhile
    loop.reset(np.zeros(1), np.zeros(1))
    loop.command(np.array([20.0]))
    rng, velocity, torque = np.random.default_rng(0), np.zeros(1), np.zeros(1)
    found, motors = [], []
    for _ in range(200):
        given = np.zeros(1)
        loop.sensed[0, 0], loop.sensed[0, 1] = velocity, torque
        loop.step(given[None])
        found.append(loop.friction[0, 0])
        motors.append(given[0])
        torque = rng.normal(0.0, 5.0, 1)  # regardless of the link's motion
        velocity = velocity + timestep / MOTOR * (given - torque - 3.0)
    expected = 3.0 * -np.expm1(-bandwidth * timestep * np.arange(200))
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert max(motors) == 30.0


@pytest.mark.parametrize("elastic", [False, True])
def test_inertia_felt_in_hand_guiding_is_the_shaped_one(elastic: bool) -> None:
    pushed = np.array([0.0, 15.0, 0.0])
    made = ran(simulation(FREE, elastic, duration=0.3, disturbances={"p": force(*pushed, begin=0)}))
    velocities = made.log.of("lwr", "joint_velocities")
    angles = made.log.of("lwr", "joint_angles")
    first, last = 100, 250  # after the loop's own transients
    found = (velocities[last] - velocities[first]) / (last - first) / 1e-3
    shaped = robot_dynamics(made.robots["lwr"]).motor_inertias / 4
    model = made.robot_model(made.robots["lwr"])
    np.testing.assert_allclose(model.motor_inertia, shaped)
    middle = (first + last) // 2
    model.update(angles[middle], velocities[middle])
    outer = model.jacobian()[:3].T @ pushed - model.coriolis()
    felt = (outer - model.mass() @ found)[0] / found[0] + shaped[0]
    assert felt == pytest.approx(shaped[0], rel=0.05)
    whole = model.mass()[0, 0] * outer[0] / (model.mass() @ found)[0]
    assert whole == pytest.approx(model.mass()[0, 0], rel=0.05)


@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_cartesian_stiffness_is_accurate_despite_friction(axis: int, elastic: bool) -> None:
    pushed = np.roll([20.0, 0.0, 0.0], axis)
    disturbances = {"p": force(*pushed, begin=0.2)}
    made = ran(simulation(CARTESIAN, elastic, duration=2.0, disturbances=disturbances))
    before, after = flanges(made, [199, -1])
    assert 20.0 / (after - before)[axis] == pytest.approx(1000.0, rel=0.01)
    assert np.abs(made.log.of("lwr", "joint_velocities")[-300:]).max() < 1e-3  # no limit cycle
    error = made.log.of("lwr", "commanded_torques")[-1] - made.log.of("lwr", "torques")[-1]
    assert np.abs(error).max() < 0.02


def test_friction_reduces_accuracy_without_the_loop() -> None:
    disturbances = {"p": force(0.0, 0.0, 8.0, begin=0.2)}
    stiffness = []
    for on in (False, True):
        made = ran(simulation(CARTESIAN, on=on, duration=2.0, disturbances=disturbances))
        before, after = flanges(made, [199, -1])
        stiffness.append(8.0 / (after - before)[2])
    assert abs(stiffness[0] - 1000.0) > 10 * abs(stiffness[1] - 1000.0)


def test_elastic_joints_hold_still_without_friction() -> None:
    drifts = []
    for on in (False, True):
        made = ran(simulation(FREE, True, dynamics=FRICTIONLESS, on=on, duration=2.0))
        angles = made.log.of("lwr", "joint_angles")
        drifts.append(np.abs(angles[-1] - angles[0]).max())
    assert drifts[0] > 0.01
    assert drifts[1] < 1e-9


def test_links_of_elastic_joints_are_held_at_the_target() -> None:
    made = ran(simulation(SOFT, True, duration=0.5))
    np.testing.assert_allclose(made.log.of("lwr", "joint_angles")[-1], HOME, atol=1e-9)


def test_joint_stiffness_acts_at_the_links_of_elastic_joints() -> None:
    pushed, stiffness = np.array([6.0, -5.0, 8.0]), 2000.0
    made = ran(
        simulation(
            {**SOFT, "stiffness": stiffness}, True, dynamics=FRICTIONLESS,
            duration=2.0, disturbances={"p": force(*pushed, begin=0.2)},
        )
    )  # fmt: skip
    before, after = made.log.of("lwr", "joint_angles")[[199, -1]]
    model = made.robot_model(made.robots["lwr"])
    model.update(after, np.zeros(7))
    torques = model.jacobian()[:3].T @ pushed
    np.testing.assert_allclose((after - before) * stiffness, torques, atol=1e-3)


def test_springs_as_stiff_as_the_elastic_joints_are_rejected() -> None:
    found = problems({**SOFT, "stiffness": 4500.0}, True)
    assert (
        "controllers.lwr.stiffness: joint A4: found 4500 Nm/rad; expected at most 4000, which is "
        "80 % of the stiffness of the elastic joint" in found
    )
    assert "joint A3" not in found


def test_flange_as_stiff_as_the_elastic_joints_is_rejected() -> None:
    stiff = {**CARTESIAN, "stiffness": [20000.0, 20000, 20000, 500, 500, 500]}
    found = problems(stiff, True)
    assert (
        "controllers.lwr.stiffness is above 80 % of the stiffness of the elastic joints at the "
        "flange; expected at most" in found
    )
    most = float(found.rpartition("at most ")[2].partition(" %")[0]) / 100
    simulation({**CARTESIAN, "stiffness": [20000.0 * most] * 3 + [500.0 * most] * 3}, True)


def test_damping_unstable_with_the_loop_is_reported() -> None:
    found = problems({**FREE, "damping": 500.0})
    assert "controllers.lwr.damping: joint" in found and "% of each damping" in found


@pytest.mark.parametrize(
    ("steps", "within"),
    [({"timestep": 4e-5, "physics_timestep": 2e-5}, 0.002), ({}, 0.03)],
    ids=["short steps", "default"],
)
def test_stiff_position_controller_before_the_loop_is_full_state_feedback(
    steps: dict[str, float], within: float
) -> None:
    """Against the closed form of u = -Kp theta - Kd dtheta - Kt tau - Ks dtau without a hold."""
    stiffness, joint, ratio, damping, target = 2000.0, 8000.0, 4.0, 0.7, 0.01
    robot = single(elastic=True, damping=damping, bandwidth=20000.0, friction_bandwidth=0.0)
    scenario = Scenario(
        Scene(robots=[robot], floor=False),
        controllers={"one": {"kind": "joint_position", "stiffness": stiffness}},
        targets={"one": {"kind": "constant", "angles": [target]}},
        torque_control=True, duration=0.3, **steps,
    )  # fmt: skip
    angles = ran(Simulation(scenario)).log.of("one", "joint_angles")[:, 0]
    shaped = MOTOR / ratio
    outer = 2.0 * np.sqrt(stiffness * (LINK + shaped))
    late = 2.0 * damping * np.sqrt(shaped / joint)
    gains = np.array([ratio * stiffness, ratio * outer, ratio - 1.0, ratio * late])
    # Of [theta, dtheta, tau, dtau]: tau'' = K (theta'' - q''), q'' = tau / M.
    motor = -gains / MOTOR - np.array([0, 0, 1 / MOTOR, 0])
    link = np.array([0, 0, 1 / LINK, 0])
    slope = np.array([[0, 1.0, 0, 0], motor, [0, 0, 0, 1.0], joint * (motor - link)])
    values, vectors = np.linalg.eig(slope)
    assert (values.real < -2.0).all()
    times = scenario.run.timestep * np.arange(len(angles))
    start = np.linalg.solve(vectors, [-target, 0, 0, 0])
    state = (vectors @ (start[:, None] * np.exp(values[:, None] * times))).real
    expected = target + state[0] - state[2] / joint
    assert np.abs(angles - expected).max() < within * target
    assert np.ptp(angles) > 0.95 * target


@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize("controller", [FREE, SOFT, CARTESIAN])
def test_energy_is_never_created(controller: dict[str, Any], elastic: bool) -> None:
    """The energy that a hand has put in at the flange, from rest, is never negative."""
    pushes = {
        f"p{k}": force(*way, begin=0.05 + 0.1 * k, end=0.15 + 0.1 * k)
        for k, way in enumerate(np.random.default_rng(3).normal(0.0, 15.0, (8, 3)).tolist())
    }
    made = ran(
        simulation(
            controller, elastic, dynamics=FRICTIONLESS, duration=1.0, disturbances=pushes
        )
    )  # fmt: skip
    given = np.zeros((made.steps, 3))
    for push in made.scenario.disturbances.values():
        given[round(push.begin * 1e3) : round(push.end * 1e3)] += push.force
    energy = np.cumsum((np.diff(flanges(made), axis=0) * given).sum(axis=1))
    assert energy.max() > 0.1  # J
    assert energy.min() > -1e-4


@pytest.mark.parametrize("elastic", [False, True])
def test_torque_error_in_free_motion_is_a_fraction_of_the_motor_torque(elastic: bool) -> None:
    errors = []
    swing = {"lwr": {"kind": "sine", "amplitude_deg": 8.0, "frequency": 0.5}}
    for on in (False, True):
        made = ran(simulation(SOFT, elastic, on=on, targets=swing, duration=2.0))
        log = made.log
        error = log.of("lwr", "commanded_torques") - log.of("lwr", "torques")
        errors.append(np.sqrt((error[200:] ** 2).mean(axis=0)))
    assert (errors[1] < 0.3 * errors[0]).all()


def test_real_sensors_do_not_destabilize_the_loop() -> None:
    real = {
        "torques": {"noise": 0.05, "resolution": 0.01},
        "velocities": {"noise": 1e-3},
        "angles": {"resolution": 1e-5},
        "velocity_filter": 500.0,
    }
    made = ran(simulation(SOFT, sensors={"lwr": real}, duration=1.0))
    error = made.log.of("lwr", "commanded_torques") - made.log.of("lwr", "torques")
    assert error.std(axis=0).max() < 0.2


def test_drives_saturate_at_the_torque_limits() -> None:
    limits = SerialRobot.from_model("lwr").torque_limits
    assert limits is not None
    fault = {"kind": "controller", "robot": "lwr", "joints": ["A2"], "gain": 50.0, "begin": 0.1}
    for on in (False, True):
        made = simulation(SOFT, on=on, faults={"f": fault}, duration=0.5)
        peak = np.zeros(7)
        try:
            while not made.is_done:
                made.advance(made.step + 1)
                peak = np.maximum(peak, np.abs(made.plant.motor_torques))
        except SimulationError:  # of a diverging motion
            pass
        assert peak[1] == limits[1]
        assert (peak <= limits).all()


def test_physics_can_run_faster_than_the_controllers() -> None:
    push = {"p": force(0.0, 20.0, 0.0, begin=0.1)}
    ways = [
        ran(simulation(SOFT, on=False, duration=0.6, disturbances=push, **fields))
        for fields in ({}, {"physics_timestep": 2.5e-4})
    ]
    assert ways[1].plant.timestep == 2.5e-4
    one, other = (each.log.of("lwr", "joint_angles") for each in ways)
    assert one.shape == other.shape
    assert 0 < np.abs(one - other).max() < 2e-4
    assert np.ptp(one[:, 0]) > 0.01


def test_sensor_delays_are_steps_of_the_controllers() -> None:
    push = {"p": force(0.0, 20.0, 0.0, begin=0.0)}
    sensors = {"lwr": {"angles": {"delay": 5}}}
    made = ran(
        simulation(FREE, sensors=sensors, duration=0.2, disturbances=push, physics_timestep=5e-4)
    )
    measured = made.log.of("lwr", "joint_angles")
    actual = made.log.of("lwr", "actual_angles")
    np.testing.assert_array_equal(measured[5:], actual[:-5])


def test_drives_can_have_a_delay() -> None:
    made = simulation(
        {"kind": "torque", "torques": [5.0, 0, 0, 0, 0, 0, 0]},
        on=False,
        physics_timestep=5e-4,
        drive_delay=2e-3,
        duration=0.01,
    )
    moved = []
    for step in range(1, 5):
        made.advance(step)
        moved.append(made.plant.motor_torques[0])
    assert moved == [0.0, 0.0, pytest.approx(5.0), pytest.approx(5.0)]


def test_restarted_run_is_identical() -> None:
    made = ran(simulation(SOFT, True, duration=0.1, drive_delay=1 / 3000))
    first = made.rows.copy()
    made.restart(np.array(HOME), 0)
    np.testing.assert_array_equal(ran(made).rows, first)


def test_high_observer_gain_is_fast() -> None:
    push = {"p": force(0.0, 20.0, 0.0, begin=0.1)}
    shares = []
    for gain in (50.0, 500.0):
        made = ran(simulation(SOFT, duration=0.12, observer_gain=gain, disturbances=push))
        outer = made.log.of("lwr", "external_torques")[109, 0]
        model = made.robot_model(made.robots["lwr"])
        model.update(np.array(HOME), np.zeros(7))
        shares.append(outer / (model.jacobian()[:3].T @ [0.0, 20.0, 0.0])[0])
    assert shares[0] < 0.5
    assert 0.9 < shares[1] < 1.1


def test_simulation_is_freed_with_its_last_reference() -> None:
    """Python's garbage collector does not count MuJoCo's memory, so it would run too late."""
    gc.disable()
    try:
        made = weakref.ref(simulation(SOFT, True, duration=0.01))
        assert made() is None
    finally:
        gc.enable()


def problems(*args: Any, **fields: Any) -> str:
    with pytest.raises(DeclarationError) as error:
        simulation(*args, **fields)
    return "\n".join(map(str, error.value.problems))


def test_loop_unstable_at_the_step_is_rejected_with_the_minimum_inertia() -> None:
    found = problems(SOFT, torque_control={"inertia_ratio": 0.02})
    key = "robots.lwr.torque_control.motor_inertias"
    assert (
        found.startswith(f"{key}: ")
        and "A2 unstable with a motor inertia of 0.061; expected at lea" in found
    )
    assert "or a shorter run.physics_timestep" in found
    least = float(found.partition("at least ")[2].partition(",")[0])
    motors = robot_dynamics(SerialRobot.from_model("lwr")).motor_inertias
    simulation(SOFT, torque_control={"inertia_ratio": least / motors[1]})
    with pytest.raises(DeclarationError):
        simulation(SOFT, torque_control={"inertia_ratio": 0.9 * least / motors[1]})


def test_rejected_loops_oscillate_and_accepted_ones_do_not() -> None:
    # One joint: the filter's pole is 1 - c (1 + g (B / Bt - 1)), unstable below -1.
    filtered, passed = -np.expm1(-1000.0 / 3000), LINK / (LINK + MOTOR)
    limit = 1 / (1 + (2 / filtered - 1) / passed)
    peaks = []
    for ratio in (0.95, 1.05):
        robot = single(inertia_ratio=ratio * limit, bandwidth=1000.0)
        plant = Plant(World(Scene(robots=[robot], floor=False), dynamic=True), timestep=1 / 3000)
        drives = Drives(plant.rows, {"one": robot}, Run(timestep=1 / 3000, torque_control=True))
        refused = False
        try:
            drives.check("one", np.array([[LINK]]), np.zeros((1, 1)), np.zeros((1, 1)))
        except DeclarationError:
            refused = True
        plant.step(np.array([1e-3]))
        for _ in range(3000):
            drives.step(np.zeros(1))
        peaks.append((refused, abs(plant.measured[2, 0]) > 1e-3))
    assert peaks == [(True, True), (False, False)]


def test_gains_unstable_with_the_loop_are_rejected_with_the_largest_stable_one() -> None:
    table = {"bandwidth": 20.0, "inertia_ratio": 0.1}
    found = problems({"kind": "joint_position"}, torque_control=table)
    assert "controllers.lwr.stiffness: joint" in found
    assert "with a torque loop of 3000 Hz and a time step of 1 ms" in found
    simulation({"kind": "joint_position", "stiffness": 10.0}, torque_control=table)


@pytest.mark.parametrize("elastic", [False, True])
def test_torque_control_of_a_robot_file_is_checked(elastic: bool) -> None:
    found = problems(SOFT, elastic, torque_control={"motor_inertias": [4.0] + [0.1] * 6})
    assert "robots.lwr.torque_control.motor_inertias: joint 1: found 4" in found
    with raises_with(
        key="torque_control.motor_inertias", found=2, expected="7, one per row of dh_params"
    ):
        SerialRobot.from_model("lwr", torque_control={"motor_inertias": [1.0, 1.0]})
    with raises_with(
        key="torque_control.inertia_ratio", found=2.0, expected="less than or equal to 1"
    ):
        SerialRobot.from_model("lwr", torque_control={"inertia_ratio": 2.0})
    dynamics = {"motor_inertias": [0.0] + [1.0] * 6}
    if not elastic:
        found = problems(SOFT, dynamics=dynamics)
        assert "joint 1: found 0; expected more than 0, because run.torque_control is true" in found


def test_incompatible_rates_are_all_reported_at_once() -> None:
    with pytest.raises(DeclarationError) as error:
        Run(physics_timestep=3e-4, observer_gain=2000.0)
    found = "\n".join(map(str, error.value.problems))
    assert "physics_timestep: found 0.0003 s" in found and "0.000333333 s" in found
    assert "observer_gain: found 2000 1/s; expected at most 1000" in found
    with raises_with(
        key="drive_delay",
        found=0.0004,
        expected="a multiple of the physics time step (0.00025 s), for example 0.0005 s",
    ):
        Run(drive_delay=4e-4, physics_timestep=2.5e-4)
    assert Run(torque_control=True).substeps == 3
    assert Run(torque_control=True, timestep=0.002).substeps == 6
    assert Run(torque_control=True, timestep=1e-4).substeps == 1
    assert Run(physics_timestep=1e-4).substeps == 10
