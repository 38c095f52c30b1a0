"""Motor torques in, link-side torques out, checked by inverse dynamics of the links."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from conftest import raises_with
from newton_euler import inverse_dynamics

from sero_mj.base.errors import SimulationError, UnknownName
from sero_mj.robots.assemble.robot_dynamics import RobotDynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.surroundings import Object
from sero_mj.simulate.plant import Plant
from sero_mj.simulate.sensors import SensorErrors, Sensors

HOME = np.deg2rad([0, 30, 0, -90, 0, 60, 0])
FREE = {"viscous_friction": [0.0] * 7, "coulomb_friction": [0.0] * 7}


def make_lwr(*, elastic: bool = False, **changed) -> SerialRobot:
    return SerialRobot.from_model(
        "lwr", dynamics=changed, elastic_joints=elastic, joint_angles=HOME
    )


def plant_of(*robots: SerialRobot, timestep: float | None = None, **scene) -> Plant:
    scene = {"floor": False, **scene}
    return Plant(World(Scene(robots=list(robots), **scene), dynamic=True), timestep=timestep)


def one_joint(**dynamics) -> SerialRobot:
    """Returns a rod that rotates about a vertical axis."""
    fields = {
        "masses": [1.0, 2.0], "centers_of_mass": [[0, 0, 0], [0.3, 0, 0]],
        "inertias": [[0.1, 0.1, 0.1, 0, 0, 0]] * 2, "motor_inertias": [1.5],
        "viscous_friction": [0.0], "coulomb_friction": [0.0], "joint_stiffness": [1e4],
        "joint_damping": [0.0], **dynamics,
    }  # fmt: skip
    return SerialRobot(
        name="rod", dh_convention="craig", dh_params=[[0, 0, 0, 0.1]], dynamics=fields,
        elastic_joints=bool(dynamics.get("joint_stiffness")),
    )  # fmt: skip


def loaded(dynamics: RobotDynamics, mass: float, center) -> RobotDynamics:
    """Returns the dynamics with a steel payload as part of the last link; rotations are equal."""
    old, r = dynamics.masses[-1], (3 * mass / (4 * np.pi * 7800)) ** (1 / 3)
    middle = (old * dynamics.centers[-1] + mass * center) / (old + mass)
    tensor = dynamics.tensors[-1] + 0.4 * mass * r**2 * np.eye(3)
    for m, at in ((old, dynamics.centers[-1]), (mass, center)):
        arm = at - middle
        tensor = tensor + m * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    copies = [array.copy() for array in (dynamics.masses, dynamics.centers, dynamics.tensors)]
    copies[0][-1], copies[1][-1], copies[2][-1] = old + mass, middle, tensor
    return replace(dynamics, masses=copies[0], centers=copies[1], tensors=copies[2])


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize("elastic", [False, True])
@pytest.mark.parametrize("payload", [0.0, 3.0])
def test_sensors_measure_link_side_torques(elastic, payload):
    lwr = make_lwr(elastic=elastic)
    plant = plant_of(lwr, floor=True)
    dynamics = plant.world.dynamics["lwr"]
    if payload:
        at = np.array([0.05, -0.02, 0.1])
        plant.attach_payload("lwr", payload, at)
        dynamics = loaded(dynamics, payload, at + np.array([0, 0, 0.078]))
    push = plant.push("lwr/flange", force=[10.0, -5.0, 8.0])
    rng = np.random.default_rng(3)
    gravity = plant.actual[2].copy()
    largest = 0.0
    for k in range(400):
        if k == 200:
            plant.release(push)
        q, v = plant.actual[0].copy(), plant.actual[1].copy()
        # The links are roughly held and shaken; joint 3 is held by Coulomb friction alone.
        torque = gravity + rng.normal(0, 3, 7) - 20 * v + 100 * (HOME - q)
        torque[2] = gravity[2]
        plant.step(torque)
        acceleration = (plant.actual[1] - v) / plant.timestep
        force = push.force if k < 200 else np.zeros(3)
        expected = inverse_dynamics(lwr, dynamics, q, v, acceleration, force=force)
        np.testing.assert_allclose(plant.actual[2], expected, rtol=0, atol=2e-8)
        np.testing.assert_allclose(
            plant.external_torques(), lwr.dh.jacobian(q, None, lwr.flange_frame)[:3].T @ force,
            rtol=0, atol=1e-9,
        )  # fmt: skip
        np.testing.assert_array_equal(plant.measured, plant.actual)
        largest = max(largest, np.abs(torque - plant.actual[2]).max())
    assert largest > 1.0  # a sensor at the motor would fail this


@pytest.mark.slow
def test_contacts_and_stops_cause_external_torques():
    table = Object(name="table", shape="box", size=[0.4, 0.8, 0.3], frame={"xyz": [-0.55, 0, 0.05]})
    lwr = make_lwr()
    plant = plant_of(lwr, objects=[table])
    met = False
    for step in range(2000):
        q, v = plant.actual[0].copy(), plant.actual[1].copy()
        plant.step(np.array([0.0, -20.0, 0, 5.0, 0, 0, 20.0]) - 10 * v)
        if step % 10:  # inverse dynamics in Python are slow
            continue
        acceleration = (plant.actual[1] - v) / plant.timestep
        expected = inverse_dynamics(lwr, plant.world.dynamics["lwr"], q, v, acceleration)
        np.testing.assert_allclose(
            plant.actual[2], expected - plant.external_torques(), rtol=0, atol=1e-6
        )
        met |= plant.data.ncon > 0
    assert met
    limit = lwr.position_limits[6, 1]
    assert plant.actual[0, 6] == pytest.approx(limit, abs=0.01)  # joint 7 was rotated to its stop
    assert plant.external_torques()[6] == pytest.approx(-20, abs=0.5)


@pytest.mark.parametrize("elastic", [False, True])
def test_links_stop_at_their_limits_also_with_springs(elastic):
    plant = plant_of(make_lwr(elastic=elastic))
    gravity = plant.actual[2].copy()
    torque = gravity.copy()
    torque[0] = 40.0
    for _ in range(7000):
        plant.step(torque - [3.0, 40, 40, 40, 40, 40, 40] * plant.actual[1])
    assert plant.actual[0, 0] == pytest.approx(np.deg2rad(170), abs=4e-3)  # rubber
    assert plant.external_torques()[0] == pytest.approx(-40.0, abs=1.0)


def test_gravity_torques_hold_the_robot_at_rest(lwr):
    for elastic in (False, True):
        plant = plant_of(make_lwr(elastic=elastic, **FREE))
        np.testing.assert_allclose(plant.actual[0], HOME, atol=1e-15)
        gravity = inverse_dynamics(lwr, plant.world.dynamics["lwr"], HOME)
        np.testing.assert_allclose(plant.actual[2], gravity, atol=1e-9)
        for _ in range(2000):
            plant.step(gravity)
        np.testing.assert_allclose(plant.actual[0], HOME, atol=1e-9)
        np.testing.assert_allclose(plant.actual[2], gravity, atol=1e-6)
        # A spring is deflected by its load, and the motor leads by that angle.
        wound = gravity / plant.world.dynamics["lwr"].joint_stiffness if elastic else np.zeros(7)
        np.testing.assert_allclose(plant.motor_angles, HOME + wound, atol=1e-9)


def energy(plant: Plant) -> float:
    mujoco.mj_energyPos(plant.model, plant.data)
    mujoco.mj_energyVel(plant.model, plant.data)
    return float(plant.data.energy.sum())


@pytest.mark.slow
@pytest.mark.parametrize("elastic", [False, True])
def test_energy_is_constant_without_motors_and_friction(elastic):
    drifts = []
    for timestep in (2e-4, 1e-4):
        # Joint damping of the springs dissipates, too.
        robot = make_lwr(elastic=elastic, joint_damping=[0.0] * 7, **FREE)
        plant = plant_of(robot, timestep=timestep)
        start, kinetic = energy(plant), 0.0
        worst = 0.0
        for _ in range(round(0.4 / timestep)):
            plant.step(np.zeros(7))
            worst = max(worst, abs(energy(plant) - start))
            kinetic = max(kinetic, float(plant.data.energy[1]))
        assert kinetic > 5.0  # it has fallen
        drifts.append(worst / kinetic)
    assert drifts[1] < 3e-3
    assert drifts[1] < 0.6 * drifts[0]  # Euler's error is proportional to the step


def test_motor_oscillates_against_a_held_link_at_the_published_frequency():
    # ROBOTS.md 1.5: sqrt(1e4 / 3.19) / 2 pi = 8.9 Hz for a motor against a held link.
    held = [[0.1] * 3 + [0] * 3, [1e6] * 3 + [0] * 3]
    robot = one_joint(motor_inertias=[3.19], joint_stiffness=[1e4], inertias=held)
    plant = plant_of(robot)
    plant.step([50.0])
    torques = []
    for _ in range(3000):
        plant.step([0.0])
        torques.append(plant.actual[2, 0])
    signs = np.flatnonzero(np.diff(np.sign(torques)) != 0)
    frequency = (len(signs) - 1) / 2 / ((signs[-1] - signs[0]) * plant.timestep)
    assert frequency == pytest.approx(np.sqrt(1e4 / 3.19) / 2 / np.pi, rel=0.005)
    assert frequency == pytest.approx(8.9, abs=0.05)


def trajectory(plant: Plant, seconds: float = 0.4) -> np.ndarray:
    """Returns angles and torques every 10 ms under oscillating torques, (3, samples, 7)."""
    every = round(0.01 / plant.timestep)
    gravity = plant.actual[2].copy()
    samples = []
    for k in range(round(seconds / plant.timestep)):
        if k % every == 0:
            samples.append(plant.actual.copy())
        wave = np.sin(2 * np.pi * np.arange(1, 8) * k * plant.timestep)
        plant.step(gravity + [8, 8, 5, 5, 2, 1, 0.5] * wave)
    return np.array(samples).transpose(1, 0, 2)


def test_stiff_joints_approach_rigid_joints():
    rigid = trajectory(plant_of(make_lwr()))
    errors = []
    for stiffness in (1e5, 1e6, 1e7):
        robot = make_lwr(elastic=True, joint_stiffness=[stiffness] * 7)
        errors.append(np.abs(trajectory(plant_of(robot))[0] - rigid[0]).max())
    assert errors[2] < 3e-5 and errors[1] < 0.25 * errors[0]
    assert np.ptp(rigid[0], axis=0).max() > 0.02


@pytest.mark.slow
def test_elastic_joints_at_1_khz_are_close_to_those_at_100_khz():
    # This is the error stated in the docstring of the joint model.
    fine = trajectory(plant_of(make_lwr(elastic=True), timestep=1e-5))
    coarse = trajectory(plant_of(make_lwr(elastic=True)))
    angles, _, torques = np.abs(coarse - fine).max(axis=1)
    span = np.ptp(fine[2], axis=0)
    assert angles.max() < 2e-5 and torques.max() < 0.1
    assert (torques < 0.06 * span).all()
    assert span.max() > 5.0


def test_elastic_joints_are_stable_over_the_workspace():
    rng = np.random.default_rng(4)
    plant = plant_of(make_lwr(elastic=True, joint_damping=[0.0] * 7))
    limits = plant.world.robots["lwr"].robot.position_limits
    for _ in range(8):
        plant.reset(0.9 * rng.uniform(limits[:, 0], limits[:, 1]))
        gravity = plant.actual[2].copy()
        plant.data.qvel[:] = rng.normal(0, 0.2, 14)
        plant.refresh()
        for _ in range(500):
            plant.step(gravity - 5 * plant.actual[1])
        assert np.abs(plant.actual[1]).max() < 1.5


def test_coulomb_friction_holds_below_it_and_decelerates_above():
    plant = plant_of(one_joint(coulomb_friction=[0.5]))
    for _ in range(2000):
        plant.step([0.45])
    assert abs(plant.actual[0, 0]) < 2e-6  # in 2 s
    assert abs(plant.actual[2, 0]) < 1e-5  # friction takes all torque before the sensor
    for _ in range(1000):
        plant.step([2.0])
    inertia = 1.5 + 0.1 + 2 * 0.3**2
    assert plant.actual[1, 0] == pytest.approx(1.5 / inertia, rel=5e-3)
    assert plant.actual[2, 0] == pytest.approx(1.5 * (0.1 + 2 * 0.3**2) / inertia, rel=5e-3)


def test_viscous_friction_is_before_the_sensor():
    plant = plant_of(one_joint(viscous_friction=[4.0]))
    for _ in range(8000):
        plant.step([2.0])
    assert plant.actual[1, 0] == pytest.approx(0.5, rel=1e-3)
    assert plant.actual[2, 0] == pytest.approx(0.0, abs=2e-3)


@pytest.mark.thorough
@pytest.mark.slow
def test_nothing_drifts_in_a_minute_of_gravity_torques():
    plant = plant_of(make_lwr())
    gravity = plant.actual[2].copy()
    for _ in range(60_000):
        plant.step(gravity)
    np.testing.assert_allclose(plant.actual[0], HOME, atol=1e-9)
    offset = gravity + 0.5 * plant.world.dynamics["lwr"].coulomb_friction
    for _ in range(10_000):
        plant.step(offset)
    np.testing.assert_allclose(plant.actual[0], HOME, atol=2e-5)  # creep of the solver alone
    np.testing.assert_allclose(plant.actual[2], gravity, atol=1e-3)


def test_payloads_add_mass_and_are_removed_completely():
    plant = plant_of(make_lwr())
    lwr = plant.world.robots["lwr"].robot
    before = plant.actual[2].copy()
    bytes_before = {key: np.array(getattr(plant.model, key)) for key in (
        "body_mass", "body_subtreemass", "dof_invweight0", "body_invweight0")}  # fmt: skip
    extent = plant.model.stat.extent
    plant.attach_payload("lwr", 2.0, [0.0, 0.0, 0.1])
    assert plant.model.stat.extent == extent
    plant.reset()
    tip = lwr.flange_frame.copy()
    tip[2, 3] += 0.1
    weight = lwr.dh.jacobian(HOME, None, tip)[:3].T @ [0, 0, 2.0 * 9.81]
    np.testing.assert_allclose(plant.actual[2] - before, weight, atol=1e-9)
    assert np.abs(weight).max() > 5
    plant.detach_payload("lwr")
    plant.reset()
    np.testing.assert_array_equal(plant.actual[2], before)
    for key, value in bytes_before.items():
        np.testing.assert_array_equal(getattr(plant.model, key), value)


def test_payload_attached_in_motion_changes_torques_at_once():
    plant = plant_of(make_lwr())
    gravity = plant.actual[2].copy()
    plant.step(gravity)
    plant.attach_payload("lwr", 5.0)
    np.testing.assert_allclose(plant.actual[0], HOME, atol=1e-9)
    for _ in range(100):
        plant.step(gravity)
    assert plant.actual[1, 1] != 0 and np.abs(plant.actual[1]).max() > 0.05


def test_pushes_rotate_with_the_frame_they_are_expressed_in():
    lwr = make_lwr()
    plant = plant_of(lwr)
    gravity = plant.actual[2].copy()
    push = plant.push(
        "lwr/flange", [1, 2, 3], [0.1, 0.2, -0.3], expressed_in="lwr/flange", at=[0, 0.1, 0]
    )
    plant.step(gravity)
    pose = lwr.fwd_kin_base_to_flange(HOME)
    point = lwr.flange_frame.copy()
    point[:3, 3] += [0, 0.1, 0]
    wrench = np.concatenate([pose[:3, :3] @ [1, 2, 3], pose[:3, :3] @ [0.1, 0.2, -0.3]])
    expected = lwr.dh.jacobian(HOME, None, point).T @ wrench
    np.testing.assert_allclose(plant.external_torques(), expected, atol=1e-9)
    np.testing.assert_allclose(plant.motor_torques, gravity, atol=1e-12)
    push.force[:] = push.torque[:] = 0
    plant.step(gravity)
    np.testing.assert_allclose(plant.external_torques(), 0, atol=1e-12)
    plant.release(push)
    plant.release(push)
    plant.step(gravity)
    np.testing.assert_array_equal(plant.data.qfrc_applied, gravity)


def test_friction_can_change_during_a_run():
    plant = plant_of(one_joint(coulomb_friction=[0.5]))
    plant.set_friction("rod", coulomb=0.0, viscous=[0.25])
    plant.step([0.4])
    assert plant.actual[1, 0] == pytest.approx(0.001 * 0.4 / (1.5 + 0.1 + 0.18), rel=1e-3)
    plant.set_friction("rod", coulomb=10.0)
    for _ in range(20):
        plant.step([0.4])
    assert abs(plant.actual[1, 0]) < 1e-6
    with raises_with(key="coulomb", found=[-1.0], expected="0 or more"):
        plant.set_friction("rod", coulomb=-1)
    with raises_with(key="viscous", found=2, expected="1 or 1"):
        plant.set_friction("rod", viscous=[1, 2])
    with raises_with(UnknownName, kind="robot", name="rot", near="rod"):
        plant.set_friction("rot", coulomb=1)


GRIPPER = (
    '<mujoco><worldbody><body name="jaw" pos="0 0 0.1"><joint name="slide" type="slide"/>'
    '<geom size="0.02"/></body></worldbody></mujoco>'
)
BALL = (
    '<mujoco><worldbody><body name="free" pos="2 0 0.1"><joint type="slide" axis="0 0 1"/>'
    '<geom size="0.05"/></body></worldbody></mujoco>'
)


def test_robots_of_all_kinds_share_a_scene(lwr):
    # Joints of no robot are between theirs, and one of three robots is elastic.
    left = make_lwr()
    left.name = "left"
    left.children = [Object(name="gripper", mjcf=GRIPPER)]
    right = make_lwr(elastic=True)
    right.name, right.base_frame = "right", {"xyz": [0, 2.0, 0]}
    rail = SerialRobot(
        name="rail", dh_convention="standard",
        dh_params=[[1.5708, 0.1, 0.3, 0.2], [0.2, 0.3, 0, 1]],
        joint_types=["prismatic", "revolute"], base_frame={"xyz": [0, -3.0, 0]},
    )  # fmt: skip
    plant = plant_of(left, rail, right, objects=[Object(name="ball", mjcf=BALL)])
    assert plant.n == 16 and plant.model.nv == 16 + 7 + 2
    rows = {name: part.joints for name, part in plant.world.robots.items()}
    np.testing.assert_allclose(plant.actual[0, rows["right"]], HOME, atol=1e-12)
    rng = np.random.default_rng(9)
    hold = plant.actual[2].copy()
    for _ in range(50):
        before = plant.actual.copy()
        plant.step(hold + rng.normal(0, 1, 16))
        acceleration = (plant.actual[1] - before[1]) / plant.timestep
        data = plant.data
        np.testing.assert_array_equal(plant.motor_angles, data.qpos[plant.joints.motor_positions])
        np.testing.assert_array_equal(plant.motor_velocities, data.qvel[plant.joints.motor_dofs])
        for name in ("rail", "right"):
            part, row = plant.world.robots[name], rows[name]
            expected = inverse_dynamics(
                part.robot, plant.world.dynamics[name], before[0, row], before[1, row],
                acceleration[row],
            )  # fmt: skip
            np.testing.assert_allclose(plant.actual[2, row], expected, rtol=0, atol=1e-6)


def test_same_seed_gives_the_same_bits():
    def run() -> np.ndarray:
        sensors = Sensors(7, torques=SensorErrors(noise=0.1), seed=4)
        world = World(Scene(robots=[make_lwr()]), dynamic=True)
        plant = Plant(world, sensors)
        return np.array([plant.step(np.sin(k / 50) * np.ones(7)).copy() for k in range(600)])

    np.testing.assert_array_equal(run(), run())


def test_reset_repeats_the_run_bit_for_bit():
    plant = plant_of(make_lwr(elastic=True))
    first = [plant.step(np.ones(7)).copy() for _ in range(50)]
    plant.push("lwr/flange", [1, 0, 0])
    plant.step(np.ones(7))
    plant.reset()
    np.testing.assert_array_equal(first, [plant.step(np.ones(7)).copy() for _ in range(50)])
    assert plant.time == pytest.approx(0.05)


@pytest.mark.parametrize("elastic", [False, True])
def test_no_external_torques_after_a_reset(elastic):
    plant = plant_of(make_lwr(elastic=elastic))
    np.testing.assert_allclose(plant.external_torques(), 0.0, atol=1e-9)
    for _ in range(20):
        plant.step(plant.actual[2] + 3.0)
    plant.reset()
    np.testing.assert_allclose(plant.external_torques(), 0.0, atol=1e-9)


def test_torque_that_is_not_a_number_stops_with_joint_and_time():
    plant = plant_of(make_lwr())
    plant.step(plant.actual[2].copy())
    torques, kept = np.zeros(7), plant.actual.copy()
    torques[3] = np.nan
    with pytest.raises(SimulationError) as caught:
        plant.step(torques)
    assert str(caught.value) == (
        "lwr/A3 at 0.0010 s: found a motor torque of nan Nm; expected a finite torque below 1e9"
    )
    assert (caught.value.joint, caught.value.time) == ("lwr/A3", 0.001)
    np.testing.assert_array_equal(plant.actual, kept)
    plant.step(np.zeros(7))  # the state is still valid


def test_unstable_motion_stops_with_joint_and_time(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log there
    light = [[1e-3] * 3 + [0] * 3] * 2
    plant = plant_of(
        one_joint(motor_inertias=[0.0], inertias=light, centers_of_mass=[[0] * 3] * 2,
                  joint_stiffness=None)
    )  # fmt: skip
    plant.step([0.1])
    with pytest.raises(SimulationError) as caught:
        plant.step([1e8])
    assert str(caught.value) == (
        "rod/J1 at 0.0020 s: the motion is unstable: found an acceleration of 1e+11 rad/s2; "
        "expected lower gains, or a timestep below 0.001 s"
    )


def test_invalid_plants_and_payloads_are_rejected():
    world = World(Scene(robots=[make_lwr()]))
    with pytest.raises(ValueError, match=r"expected World\(scene, dynamic=True\)$"):
        Plant(world)
    world = World(Scene(robots=[make_lwr()]), dynamic=True)
    with raises_with(key="timestep", found=0.0, expected="more than 0 and less than 1 s"):
        Plant(world, timestep=0.0)
    with raises_with(reason="found sensors of", found=6, expected="7 joints"):
        Plant(world, Sensors(6))
    plant = Plant(world)
    with raises_with(key="joint_angles", found=6):
        plant.reset([0.0] * 6)
    with raises_with(UnknownName, kind="frame", name="lwr/flansch", near="lwr/flange"):
        plant.push("lwr/flansch")
    with raises_with(key="force", found=[1.0, 2.0]):
        plant.push("lwr/flange", [1, 2])
    with raises_with(key="payload of lwr", found=0.0, expected="a positive mass"):
        plant.attach_payload("lwr", 0.0)
    with raises_with(
        key="payload of lwr",
        reason=(
            "found principal moments 1, 1, 5 kg m2; expected the largest moment to be at "
            "most the sum of the other two, 2. Is the tensor about the center of mass?"
        ),
    ):
        plant.attach_payload("lwr", 1.0, inertia=[1, 1, 5, 0, 0, 0])
