"""Branched robots: controllers, free bases, mounts and doubles, against sums over links."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from decor_tools import toggles_of, view_at
from humanoid import humanoid
from test_joint_tree import tree_robot, values_of

from sero_mj import Plant, Scene, SerialRobot, World
from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.data.drive.place import Placer
from sero_mj.robots.assemble.robot_dynamics import RobotDynamics, robot_dynamics
from sero_mj.robots.declared.double import Double
from sero_mj.robots.declared.mounts import base_frames, unmounted
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.geom_buffer import Kind
from sero_mj.viewer.decor.quantities import jacobian, towards_singularity

G = np.array([0.0, 0.0, -9.81])
STILL = ("viscous_friction", "coulomb_friction")


def link_jacobians(
    robot: SerialRobot, known: RobotDynamics, q: np.ndarray, base: np.ndarray
) -> list[tuple[float, np.ndarray, np.ndarray]]:
    """Returns mass, Jacobian (6, n) of the center, and tensor in the world of every link."""
    table, found = robot.kinematics, []
    T = table.frames(q, base)
    for link in range(1, robot.n + 1):
        at = frame(position=known.centers[link])
        J, R = table.jacobian(q, base, at, link), T[link, :3, :3]
        found.append((float(known.masses[link]), J, R @ known.tensors[link] @ R.T))
    return found


def inertia(robot: SerialRobot, q: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Returns M(q) of the links by definition, the sum of m Jv^T Jv + Jw^T I Jw, (n, n)."""
    M = np.zeros((robot.n, robot.n))
    for m, J, tensor in link_jacobians(robot, robot_dynamics(robot), q, base):
        M += m * J[:3].T @ J[:3] + J[3:].T @ tensor @ J[3:]
    return M


def weight(robot: SerialRobot, q: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Returns g(q), (n,), the torques that hold the links: minus the sum of m Jv^T g."""
    links = link_jacobians(robot, robot_dynamics(robot), q, base)
    return np.asarray(-sum(m * J[:3].T @ G for m, J, _ in links))


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize("mirrored", [False, True])
def test_controller_model_of_a_tree_is_the_sum_over_its_links(seed: int, mirrored: bool) -> None:
    robot = tree_robot(seed, n=6, mirrored=mirrored)
    base, q = robot.base_frame, values_of(robot, seed)
    dq = np.random.default_rng(seed).uniform(-1, 1, robot.n)
    model = RobotModel.of(robot)
    model.update(q, dq)
    M, motors = inertia(robot, q, base), np.diag(model.motor_inertia)
    scale = np.abs(M).max()
    np.testing.assert_allclose(model.mass(), M + motors, atol=1e-9 * scale)
    np.testing.assert_allclose(model.gravity(), weight(robot, q, base), atol=1e-9 * scale)
    momentum, momentum_slope = np.zeros((2, robot.n))
    model.write_momentum(momentum, momentum_slope)
    np.testing.assert_allclose(momentum, M @ dq, atol=1e-9 * scale)
    slopes = np.array([
        (inertia(robot, q + e, base) - inertia(robot, q - e, base)) / 2e-6
        for e in 1e-6 * np.eye(robot.n)
    ])  # dM/dq_k, (k, i, j)  # fmt: skip
    moving, slope = (
        np.einsum("kij,k,j->i", slopes, dq, dq),
        0.5 * np.einsum("kij,i,j->k", slopes, dq, dq),
    )
    np.testing.assert_allclose(model.coriolis(), moving - slope, atol=1e-6 * scale)
    np.testing.assert_allclose(momentum_slope, slope - model.gravity(), atol=1e-6 * scale)
    J = robot.kinematics.jacobian(q, base, robot.T_n_flange, robot.flange_link)
    np.testing.assert_allclose(model.jacobian(), J, atol=1e-9)
    assert not J[:, np.setdiff1d(np.arange(robot.n), robot.flange_joints)].any()


def arm(name: str, mount: str) -> SerialRobot:
    links = {"masses": [1.0, 2.0, 1.5], "centers_of_mass": [[0.02, 0.01, 0.05]] * 3,
             "inertias": [[0.01, 0.02, 0.02, 0, 0, 0]] * 3}  # fmt: skip
    rows = [[0.4, 0.0, 0.1, 0.1], [1.2, 0.2, 0.0, 0.0]]
    at = {"xyz": [0.05, 0.02, 0.1], "rpy": [0.3, 0.2, 0.1]}
    return SerialRobot(name=name, dh_convention="craig", dh_params=rows, dynamics=links,
                       mount=mount, base_frame=at)  # fmt: skip


def legs_and_arm(**fields: Any) -> list[SerialRobot]:
    """Returns a body with two legs, an arm on the second branch of its base, one on its flange."""
    body = humanoid("body", fingers=False, **fields)
    hip = body.names.index("r_hip_pitch") + 1
    return [body, arm("tool", f"body/link{hip}"), arm("hand", "body/flange")]


def test_robots_mounted_on_any_branch_load_the_controller_of_a_tree() -> None:
    robots = legs_and_arm()
    simulation = Simulation(Scenario(Scene(robots=robots, floor=False), duration=0.1))
    whole, rng = simulation.whole_body, np.random.default_rng(4)
    assert whole is not None
    q = rng.uniform(-0.8, 0.8, sum(robot.n for robot in robots))
    whole.update(q, simulation.plant.qpos)
    named = {robot.name: robot for robot in robots}

    def energy(angles: np.ndarray) -> float:
        shares = np.split(angles, np.cumsum([robot.n for robot in robots])[:-1])
        each = dict(zip(named, shares, strict=True))
        bases = base_frames(named, each)
        total = 0.0
        for name, robot in named.items():
            known = robot_dynamics(robot)
            T = robot.kinematics.frames(each[name], bases[name])
            centers = (T @ np.append(known.centers, np.ones((robot.n + 1, 1)), 1)[..., None])[
                :, 2, 0
            ]
            total += float(known.masses @ centers)
        return -G[2] * total

    n = robots[0].n
    slope = [(energy(q + e) - energy(q - e)) / 2e-5 for e in 1e-5 * np.eye(len(q))[:n]]
    model = simulation.robot_model(robots[0])
    model.update(q[:n], np.zeros(n))
    np.testing.assert_allclose(model.gravity(), slope, atol=1e-6)


def test_controller_model_of_a_tree_uses_the_orientation_of_its_free_base() -> None:
    robot = humanoid("body", fingers=False, free_base=True)
    simulation = Simulation(Scenario(Scene(robots=[robot], floor=False), duration=0.1))
    plant, whole = simulation.plant, simulation.whole_body
    assert whole is not None
    leaning = frame(rotation_from_rpy(np.array([0.6, 0.3, 0.2])), np.array([0.1, 0.0, 1.5]))
    free = plant.world.robots["body"].free
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, leaning[:3, :3].ravel())
    plant.data.qpos[free] = [*leaning[:3, 3], *quat]
    q = np.random.default_rng(6).uniform(-0.7, 0.7, robot.n)
    whole.update(q, plant.qpos)
    model = simulation.robot_model(unmounted(robot, robot.base_frame))
    model.update(q, np.zeros(robot.n))
    np.testing.assert_allclose(model.gravity(), weight(robot, q, leaning), atol=1e-8)
    M = inertia(robot, q, leaning) + np.diag(model.motor_inertia)
    np.testing.assert_allclose(model.mass(), M, atol=1e-8)


def held(robot: SerialRobot, controller: dict[str, Any], duration: float, **run: Any) -> Simulation:
    scenario = Scenario(
        Scene(robots=[robot], floor=False), controllers={robot.name: controller},
        duration=duration, **run,
    )  # fmt: skip
    simulation = Simulation(scenario)
    simulation.advance(simulation.steps)
    return simulation


BENT = dict(l_hip_pitch=-0.5, l_knee=0.9, r_elbow=-0.7, l_shoulder_roll=0.6, torso_pitch=0.2,
            l_elbow=-1.1, l_wrist_pitch=0.4, r_shoulder_roll=-0.5)  # fmt: skip


NAMES = humanoid(fingers=False).names


def bent(**fields: Any) -> SerialRobot:
    q = [BENT.get(name, 0.05) for name in NAMES]
    return humanoid("body", fingers=False, joint_angles=q, **fields)


@pytest.mark.parametrize(
    "controller",
    [
        {"kind": "joint_impedance", "stiffness": 80.0, "damping": 0.7},
        {"kind": "joint_position"},
        {"kind": "gravity_compensation"},
    ],
    ids=lambda table: table["kind"],
)
def test_controllers_hold_a_humanoid_with_a_fixed_pelvis(controller: dict[str, Any]) -> None:
    robot = bent()
    simulation = held(robot, controller, 0.4)
    angles = simulation.log.of("body", "joint_angles")
    assert np.abs(angles[-1] - robot.home).max() < 0.01
    torques = simulation.log.of("body", "torques")[-1]
    expected = weight(robot, angles[-1], robot.base_frame)
    assert np.abs(expected).max() > 10.0
    np.testing.assert_allclose(torques, expected, atol=1.0)


def test_moving_humanoid_without_gravity_conserves_momentum() -> None:
    robot = bent(free_base=True, dynamics={key: [0.0] * len(NAMES) for key in STILL})
    world = World(Scene(robots=[robot], floor=False), dynamic=True)
    world.model.opt.gravity[:] = 0.0
    plant = Plant(world, timestep=1e-4)
    part, known, rng = world.robots["body"], robot_dynamics(robot), np.random.default_rng(3)
    push = rng.uniform(-1, 1, robot.n) * np.minimum(robot.torque_bounds, 20.0)

    def centres() -> tuple[np.ndarray, np.ndarray]:
        pos, quat = np.split(plant.data.qpos[part.free], [3])
        R = np.empty(9)
        mujoco.mju_quat2Mat(R, quat)
        T = robot.kinematics.frames(plant.data.qpos[part.qpos], frame(R.reshape(3, 3), pos))
        return known.masses @ (
            T @ np.append(known.centers, np.ones((robot.n + 1, 1)), 1)[..., None]
        )[:, :3, 0] / known.masses.sum(), T

    start, before = centres()
    for k in range(1500):
        plant.step(3 * push * np.sin(0.004 * k))
    end, after = centres()
    np.testing.assert_allclose(end, start, atol=2e-5)
    assert np.abs(after[:, :3, 3] - before[:, :3, 3]).max() > 0.005


def test_hand_moves_under_cartesian_impedance_while_other_joints_hold() -> None:
    robot, way = bent(), np.array([0.05, 0.03, 0.06])
    start = robot.base_frame @ robot.fwd_kin_base_to_flange()
    pose = {"xyz": (start[:3, :3].T @ way).tolist()}
    law = {"kind": "cartesian_way_points", "poses": [pose], "relative_to": "start", "times": [1.0]}
    simulation = held(
        robot,
        {"kind": "cartesian_impedance", "stiffness": [800, 800, 800, 40, 40, 40]},
        1.5,
        targets={"body": law},
    )
    q = simulation.log.of("body", "joint_angles")
    others = np.setdiff1d(np.arange(robot.n), robot.flange_joints)
    assert np.abs(q[:, others] - robot.home[others]).max() < 0.03
    end = robot.base_frame @ robot.fwd_kin_base_to_flange(q[-1])
    np.testing.assert_allclose(end[:3, 3], start[:3, 3] + way, atol=0.01)


def test_singularity_arrows_are_on_the_joints_that_move_the_flange() -> None:
    q = [-0.3 if name == "l_elbow" else 0.0 for name in NAMES]
    robot = humanoid(fingers=False, show_arrows=True, joint_angles=q)
    world = World(Scene(robots=[robot], floor=False))
    data = world.make_data()
    Placer(world).place(data)
    part = world.robots["human"]
    found = towards_singularity(world, data, part)
    whole = robot.kinematics.jacobian(
        robot.home, robot.base_frame, robot.T_n_flange, robot.flange_link
    )
    whole[:3] /= part.reach
    np.testing.assert_allclose(jacobian(world, data, part), whole[:, part.chain], atol=1e-9)
    on_way = np.zeros(robot.n, bool)
    on_way[robot.flange_joints] = True
    names = [name for name, on in zip(robot.names, on_way, strict=True) if on]
    assert names == [
        *(f"torso_{axis}" for axis in ("pitch", "roll", "yaw")),
        *(name for name in robot.names if name.startswith("l_") and (
            "shoulder" in name or "elbow" in name or "wrist" in name)),
    ]  # fmt: skip
    assert np.abs(np.nan_to_num(found[on_way])).max() > 0.1
    assert not np.nan_to_num(found[~on_way]).any()


def test_doubles_of_a_tree_have_arrows_and_are_at_their_joint_angles() -> None:
    robot = humanoid(fingers=False, show_arrows=True)
    goal = Double(name="goal", of="human", show_arrows=True)
    scene = Scene(robots=[robot], doubles=[goal], floor=False)
    world = World(scene)
    data, q = world.make_data(), np.random.default_rng(5).uniform(-1, 1, robot.n)
    world.set_input(data, "goal.joint_angles", q)
    world.set_input(data, "goal.torques", robot.torque_limits)
    world.set_input(data, "human.torques", -robot.torque_limits)
    Placer(world).place(data)
    frames = robot.kinematics.frames(q, robot.base_frame)
    np.testing.assert_allclose(
        data.mocap_pos[world.doubles["goal"].frames], frames[1:, :3, 3], atol=1e-9
    )
    buffer = Decor(world).draw(data, toggles_of(world), view_at(distance=4.0))
    arrows = buffer.items[: buffer.count][buffer.kinds[: buffer.count] == Kind.ARROW]
    assert set(arrows.tolist()) == set(range(2 * robot.n))


def test_robots_can_be_mounted_on_trees_and_trees_on_robots() -> None:
    below = SerialRobot.from_model("lwr", joint_angles=[0.2, 0.5, 0.1, -0.6, 0.3, 0.4, 0.1])
    tree = tree_robot(6, mount="lwr/flange")
    top = arm("top", f"tree/{tree.names[3]}")  # the joint that moves the link
    robots = {robot.name: robot for robot in (top, tree, below)}
    world = World(Scene(robots=[*robots.values()], floor=False))
    data, q = world.make_data(), values_of(tree, 6)
    world.set_input(data, "tree.joint_angles", q)
    Placer(world).place(data)
    base = below.fwd_kin_base_to_flange() @ tree.base_frame
    links = tree.kinematics.frames(q, base)
    np.testing.assert_allclose(world.frame(data, "tree/link4"), links[4], atol=1e-9)
    np.testing.assert_allclose(world.frame(data, "top/base"), links[4] @ top.base_frame, atol=1e-9)
    robots = world.scene.robots
    assert robots["top"].mount == "tree/link4"
    bases = base_frames(robots, {"tree": q, "lwr": below.home, "top": top.home})
    np.testing.assert_allclose(bases["top"], links[4] @ top.base_frame, atol=1e-9)


def test_route_places_a_free_base() -> None:
    robot = humanoid(fingers=False, free_base=True)
    scene = Scene(
        robots=[robot], floor=False, sources={"udp": {"kind": "udp", "structure": "1M"}},
        routes={"human.base_frame": "udp.matrices0"},
    )  # fmt: skip
    world, T = World(scene), frame(rotation_from_rpy(np.array([0.3, 0.2, 0.1])), [0.1, 0.2, 1.3])
    data = world.make_data()
    world.set_input(data, "human.base_frame", T)
    Placer(world).place(data)
    expected = robot.kinematics.frames(robot.home, T)
    part = world.robots["human"]
    np.testing.assert_allclose(data.xpos[part.bodies], expected[:, :3, 3], atol=1e-9)


def test_arrows_of_128_joints_fit_the_capacity_of_a_page() -> None:
    robot = tree_robot(9, n=128, show_arrows=True, show_billboards=True, joint_types=None)
    world = World(Scene(robots=[robot], floor=False))
    data = world.make_data()
    world.set_input(data, "tree.torques", np.full(128, 50.0))
    Placer(world).place(data)
    buffer = Decor(world).draw(data, toggles_of(world), view_at(distance=6.0))
    assert not buffer.dropped
    assert buffer.count <= 2048
    arrows = buffer.items[: buffer.count][buffer.kinds[: buffer.count] == Kind.ARROW]
    assert set(arrows.tolist()) == set(range(128))
