"""Robots with a free base: physics, controllers, logs, and display."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import raises_with

from sero_mj import DeclarationError, Mirror, Plant, Scene, SerialRobot, World
from sero_mj.base.frames import frame, quat_from_rotation, rotation_from_quat, rotation_from_rpy
from sero_mj.robots.assemble.gravity_torques import GravityTorques
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.mounts import base_frames, unmounted
from sero_mj.simulate.log_output import RunRecorder
from sero_mj.simulate.runs.measures import MEASURES
from sero_mj.simulate.runs.run_recording import read_run
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulated_scene import simulated_scene
from sero_mj.simulate.simulation import Simulation

START = frame(rotation_from_rpy(np.array([0.3, -0.2, 0.5])), np.array([0.2, 0.1, 1.0]))
G = 9.81


def walker(**fields: object) -> list[SerialRobot]:
    """Returns a free body with a leg on its last link."""
    still = {"viscous_friction": [0.0, 0.0], "coulomb_friction": [0.0, 0.0]}
    links = {
        "masses": [4.0, 2.0, 1.0], "centers_of_mass": [[0.03, 0.02, 0.05]] * 3,
        "inertias": [[0.03, 0.04, 0.05, 0.002, 0.001, -0.001]] * 3,
        "motor_inertias": [0.0, 0.0], **still,
    }  # fmt: skip
    rows = [[0.3, 0.0, 0.0, 0.1], [1.2, 0.15, 0.0, 0.0]]
    body = SerialRobot(
        name="body", dh_convention="craig", dh_params=rows, base_frame=START, dynamics=links,
        **{"free_base": True, **fields},
    )  # fmt: skip
    leg = SerialRobot(
        name="leg", dh_convention="standard", dh_params=rows, mount="body/flange", dynamics=links
    )
    return [leg, body]


def momentum(robots: list[SerialRobot], before: np.ndarray, after: np.ndarray, step: float):
    """Returns linear and angular momentum about the world's origin, by differences of DH frames.

    `before` and `after` are base pose (7,) and angles (4,) of leg and body, one step apart.
    """
    leg, body = robots
    found = np.zeros(6)
    poses = []
    for state in (before, after):
        T = frame(rotation_from_quat(state[3:7]), state[:3])
        angles = {"leg": state[7:9], "body": state[9:11]}
        bases = base_frames({r.name: r for r in robots}, angles, {"body": T})
        poses.append([r.dh.frames(angles[r.name], bases[r.name]) for r in (leg, body)])
    for r, first, last in zip((leg, body), *poses, strict=True):
        known = robot_dynamics(r)
        for i in range(r.n + 1):
            m, I = known.masses[i], known.tensors[i]  # noqa: E741
            c0, c1 = ((T[i] @ np.append(known.centers[i], 1))[:3] for T in (first, last))
            R0, R1 = first[i][:3, :3], last[i][:3, :3]
            v, middle = (c1 - c0) / step, (c0 + c1) / 2
            spin = (R1 - R0) / step @ ((R0 + R1) / 2).T
            w = 0.5 * np.array([spin[2, 1] - spin[1, 2], spin[0, 2] - spin[2, 0],
                                spin[1, 0] - spin[0, 1]])  # fmt: skip
            R = (R0 + R1) / 2
            found += [*(m * v), *(np.cross(middle, m * v) + R @ I @ R.T @ w)]
    return found


def test_internal_torques_conserve_momentum_and_gravity_changes_it() -> None:
    robots = walker()
    plant = Plant(World(Scene(robots=robots, floor=False), dynamic=True), timestep=1e-4)
    rng = np.random.default_rng(2)

    def state() -> np.ndarray:
        free = plant.world.robots["body"].free
        return np.concatenate([plant.data.qpos[free], plant.measured[0]])

    seen = [state()]
    for k in range(1000):
        plant.step(1.5 * np.sin(0.01 * k + np.arange(4)) * rng.uniform(0.9, 1.1))
        seen.append(state())
    start = momentum(robots, seen[0], seen[2], 2e-4)
    end = momentum(robots, seen[-3], seen[-1], 2e-4)
    mass = sum(robot_dynamics(robot).masses.sum() for robot in robots)
    time = 1e-4 * (len(seen) - 3)
    np.testing.assert_allclose((end - start)[:3], [0, 0, -mass * G * time], atol=0.01)
    # There is no moment about the center of mass. About the origin, gravity has one.
    middle = []
    for each in seen:
        T = frame(rotation_from_quat(each[3:7]), each[:3])
        angles = {"leg": each[7:9], "body": each[9:11]}
        bases = base_frames({r.name: r for r in robots}, angles, {"body": T})
        total = np.zeros(3)
        for r in robots:
            known, frames = robot_dynamics(r), r.dh.frames(angles[r.name], bases[r.name])
            for i in range(r.n + 1):
                total += known.masses[i] * (frames[i] @ np.append(known.centers[i], 1))[:3]
        middle.append(total / mass)
    turn = np.cross(np.mean(middle, axis=0), [0, 0, -mass * G]) * time
    np.testing.assert_allclose((end - start)[3:], turn, atol=0.02)
    assert np.abs(seen[-1][7:] - seen[0][7:]).max() > 0.02  # the joints moved


def test_controller_model_uses_the_orientation_of_the_free_base() -> None:
    simulation = Simulation(Scenario(Scene(robots=walker(), floor=False), duration=0.1))
    plant, whole = simulation.plant, simulation.whole_body
    assert whole is not None
    free = plant.world.robots["body"].free
    leaning = frame(rotation_from_rpy(np.array([1.1, 0.3, 0.2])), np.array([0.0, 0.0, 2.0]))
    mujoco.mju_mat2Quat(plant.data.qpos[free][3:], leaning[:3, :3].ravel())
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, leaning[:3, :3].ravel())
    plant.data.qpos[free] = [*leaning[:3, 3], *quat]
    q = np.array([0.3, -0.4, 0.5, 0.2])
    whole.update(q, plant.qpos)
    robots = {robot.name: robot for robot in walker()}

    def energy(angles: np.ndarray) -> float:
        each = {"leg": angles[:2], "body": angles[2:]}
        bases = base_frames(robots, each, {"body": leaning})
        return sum(
            float(m * G * (T @ np.append(c, 1))[2])
            for r in robots.values()
            for m, c, T in zip(
                robot_dynamics(r).masses, robot_dynamics(r).centers,
                r.dh.frames(each[r.name], bases[r.name]), strict=True,
            )
        )  # fmt: skip

    slope = [(energy(q + e) - energy(q - e)) / 2e-5 for e in 1e-5 * np.eye(4)]
    for name, rows in (("leg", slice(0, 2)), ("body", slice(2, 4))):
        model = simulation.robot_model(unmounted(robots[name], base_frames(robots)[name]))
        model.update(q[rows], np.zeros(2))
        np.testing.assert_allclose(model.gravity(), slope[rows], atol=1e-7)


def run_of(duration: float = 0.3) -> Simulation:
    hold = {"kind": "joint_impedance", "stiffness": 50.0, "damping": 0.7}
    scenario = Scenario(
        Scene(robots=walker()), controllers={"leg": hold, "body": hold}, duration=duration
    )
    return Simulation(scenario)


def test_log_contains_the_base_pose_and_shows_it() -> None:
    simulation = run_of()
    simulation.advance(simulation.steps)
    logged = simulation.log.signals["body_base_frame"]
    free = simulation.plant.world.robots["body"].free
    np.testing.assert_allclose(logged[0], START, atol=1e-12)
    np.testing.assert_allclose(logged[-1][:3, 3], simulation.plant.data.qpos[free][:3])
    times = simulation.log.times
    fall = START[2, 3] - logged[:, 2, 3]
    assert 0.2 < fall[-1] < 0.6  # 0.44 m, except for the motion of the links meanwhile
    mirror = Mirror(simulated_scene(simulation))
    with mirror:
        for row in (100, 299):
            mirror.advance(float(times[row]))
            shown = mirror.world.frame(mirror.data, "body/base")
            at = np.abs(logged[:, :3, 3] - shown[:3, 3]).sum(axis=1).argmin()
            assert abs(at - row) <= 1
            np.testing.assert_allclose(shown, logged[at], atol=1e-12)
            leg = mirror.world.frame(mirror.data, "leg/base")
            body = simulation.robots["body"]
            angles = simulation.log.of("body", "joint_angles")[at]
            np.testing.assert_allclose(
                leg, logged[at] @ body.fwd_kin_base_to_flange(angles), atol=1e-12
            )


def test_recorded_run_contains_the_base_pose(tmp_path: Path) -> None:
    simulation = run_of(0.1)
    path = tmp_path / "run.mcap"
    with RunRecorder(simulation, path) as recorder:
        for first, stop in simulation.run():
            recorder.write(first, stop)
    found = read_run(path, scene=simulation.scenario.scene)
    np.testing.assert_allclose(
        found.signals["body_base_frame"], simulation.log.signals["body_base_frame"]
    )
    error = MEASURES["flange_error"][1](found, "leg")
    np.testing.assert_allclose(error, MEASURES["flange_error"][1](simulation.log, "leg"))


def test_restarted_run_begins_at_the_declared_base_pose() -> None:
    simulation = run_of(0.1)
    simulation.advance(simulation.steps)
    first = simulation.rows.copy()
    simulation.restart(np.zeros(4), 0)
    simulation.advance(simulation.steps)
    np.testing.assert_array_equal(simulation.rows, first)


def test_planar_base_moves_freely_in_its_plane_only() -> None:
    normal = START[:3, :3].T @ [0, 0, 1]
    robots = walker(free_base="planar", base_normal=normal)
    plant = Plant(World(Scene(robots=robots, floor=False), dynamic=True), timestep=1e-4)
    part, model = plant.world.robots["body"], plant.model
    joints = [model.joint(f"body/free_base_{axis}") for axis in ("x", "y", "yaw")]
    assert [int(joint.qposadr[0]) for joint in joints] == part.free.tolist()
    assert plant.model.nv == 3 + 4

    def state() -> np.ndarray:
        T = part.base_pose(plant.qpos)
        base = plant.data.xpos[part.bodies[0]]
        np.testing.assert_allclose(T[:3, 3], base, atol=1e-12)
        assert base[2] == pytest.approx(START[2, 3])
        return np.concatenate([T[:3, 3], quat_from_rotation(T[:3, :3]), plant.measured[0]])

    seen = []
    for k in range(1000):
        plant.step(1.5 * np.sin(0.01 * k + np.arange(4)))
        mujoco.mj_kinematics(model, plant.data)
        seen.append(state())
    start = momentum(robots, seen[0], seen[2], 2e-4)
    end = momentum(robots, seen[-3], seen[-1], 2e-4)
    np.testing.assert_allclose((end - start)[[0, 1, 5]], 0.0, atol=0.01)
    assert np.abs(seen[-1][:3] - seen[0][:3]).max() > 1e-3  # the base moved


def test_joints_on_a_planar_base_feel_gravity_as_on_a_fixed_one() -> None:
    angles = {"body": np.array([0.4, -0.7]), "leg": np.array([0.2, 0.9])}
    held = []
    for free_base in ("planar", False):
        robots = {robot.name: robot for robot in walker(free_base=free_base)}
        held.append(GravityTorques(robots).of(angles))
    for name, torques in held[0].items():
        np.testing.assert_allclose(torques, held[1][name], atol=1e-12)
        assert np.abs(torques).max() > 0.1


def test_fallen_robot_rests_on_several_links() -> None:
    simulation = run_of(2.0)
    simulation.advance(simulation.steps)
    logged = simulation.log.signals["body_base_frame"]
    assert 0.0 < logged[-1][2, 3] < 0.4
    assert logged[:, 2, 3].min() > -0.1  # it does not sink into the floor
    assert np.abs(logged[-1] - logged[-100]).max() < 0.1
    model, data = simulation.plant.model, simulation.plant.data
    touching = {model.geom_bodyid[g] for pair in data.contact.geom for g in pair}
    assert len(touching) > 1


def test_mirror_sets_a_free_base_from_its_input() -> None:
    world = World(Scene(robots=walker()))
    data = world.make_data()
    T = frame(position=np.array([1.0, 2.0, 3.0]))
    world.set_input(data, "body.base_frame", T)
    mujoco.mj_kinematics(world.model, data)
    np.testing.assert_allclose(world.frame(data, "body/base"), T)


def test_base_cannot_be_free_and_mounted() -> None:
    with pytest.raises(DeclarationError) as caught:
        SerialRobot(
            name="r", dh_convention="craig", dh_params=[[0, 0, 0, 1]], mount="a/flange",
            free_base=True,
        )  # fmt: skip
    assert str(caught.value) == (
        "free_base: found true with mount = 'a/flange'; expected only one of them"
    )


def test_robot_floats_without_gravity_and_counter_rotates() -> None:
    scenario = Scenario(
        Scene(robots=walker(), floor=False),
        controllers={"leg": {"kind": "joint_impedance", "stiffness": 20.0}},
        targets={"leg": {"kind": "step", "amplitude": [0.8, -0.5]}},
        gravity=[0.0, 0.0, 0.0], duration=0.5,
    )  # fmt: skip
    made = Simulation(scenario)
    made.advance(made.steps)
    assert not made.log.of("body", "commanded_torques")[0].any()
    data, model = made.plant.data, made.plant.world.model
    mujoco.mj_subtreeVel(model, data)
    base = made.log.of("body", "base_frame")
    assert np.abs(base[-1, :3, :3] - base[0, :3, :3]).max() > 5e-3  # it rotates the other way
    assert np.abs(base[-1, :3, 3] - base[0, :3, 3]).max() < 0.2
    np.testing.assert_allclose(data.subtree_linvel[0], 0.0, atol=2e-4)  # falling: 4.9


def test_controllers_and_physics_use_the_same_gravity() -> None:
    held = []
    for gravity in (-G, -1.62):
        robot = SerialRobot.from_model("lwr", joint_angles=[0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0])
        made = Simulation(
            Scenario(Scene(robots=[robot], floor=False), gravity=[0.0, 0.0, gravity], duration=0.2)
        )
        made.advance(made.steps)
        held.append(made.log.of("lwr", "commanded_torques")[-1])
        np.testing.assert_allclose(made.log.of("lwr", "joint_angles")[-1], robot.home, atol=1e-6)
    np.testing.assert_allclose(held[1], held[0] * 1.62 / G, atol=1e-5)
    with raises_with(key="run.gravity", reason="found 2; expected 3 numbers"):
        Scenario(Scene(robots=[robot]), gravity=[0.0, 0.0])
    with raises_with(key="run.gravity", found=-981.0, expected="-100 to 100 m/s2"):
        Scenario(Scene(robots=[robot]), gravity=[0.0, 0.0, -981.0])
