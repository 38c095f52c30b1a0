"""Robots mounted on robots: kinematics, dynamics, controllers, and errors."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np
import pytest
from conftest import problems_in

from sero_mj import DeclarationError, Double, Mirror, Plant, Scene, SerialRobot, World, load_scene
from sero_mj.base.frames import frame, rotation_from_rpy
from sero_mj.data.drive.wiring import wire
from sero_mj.data.send.play import MotionPackets
from sero_mj.robots.assemble.parts import robots_of_bodies
from sero_mj.robots.assemble.robot_dynamics import RobotDynamics, robot_dynamics
from sero_mj.robots.declared.mounts import base_frames, unmounted
from sero_mj.simulate.scenario import Scenario
from sero_mj.simulate.simulation import Simulation

GRAVITY = 9.81
ON_TORSO = frame(rotation_from_rpy(np.array([1.2, 0.2, 0.4])), np.array([0.0, 0.1, 0.15]))


@cache
def body() -> list[SerialRobot]:
    """Returns a torso of two joints, an arm on its link 1, and a finger on the arm's flange.

    The finger has two joints. The robots are not listed in mounting order.
    """
    still = {"viscous_friction": 0.0, "coulomb_friction": 0.0, "motor_inertias": 0.0}
    finger = SerialRobot(
        name="finger", mount="arm/flange", dh_convention="standard",
        dh_params=[[0.4, 0.03, 0.2, 0.02], [0.0, 0.05, 0.0, 0.0]], joint_angles=[0.3, -0.4],
        base_frame=frame(rotation_from_rpy(np.array([0.1, 0.7, 0.0])), np.array([0.02, 0.0, 0.03])),
        dynamics={
            "masses": [0.4, 0.3, 0.2], "centers_of_mass": [[0.01, 0, 0.02]] * 3,
            "inertias": [[0.002, 0.003, 0.004, 1e-4, 2e-4, -1e-4]] * 3,
            **{key: [value] * 2 for key, value in still.items()},
        },
    )  # fmt: skip
    arm = SerialRobot.from_model(
        "lwr", name="arm", mount="torso/link1", base_frame=ON_TORSO,
        joint_angles=[0.3, 0.7, -0.2, -1.1, 0.4, 0.6, 0.1],
        dynamics={key: [value] * 7 for key, value in still.items()},
    )  # fmt: skip
    torso = SerialRobot(
        name="torso", dh_convention="craig", base_frame=frame(position=np.array([0.5, 0.0, 0.2])),
        dh_params=[[0.0, 0.0, 0.0, 0.3], [1.2, 0.1, 0.0, 0.2]], joint_angles=[0.4, 0.5],
        dynamics={
            "masses": [9.0, 8.0, 3.0], "centers_of_mass": [[0.02, -0.03, 0.1]] * 3,
            "inertias": [[0.1, 0.12, 0.14, 0.01, -0.02, 0.015]] * 3,
            **{key: [value] * 2 for key, value in still.items()},
        },
    )  # fmt: skip
    return [finger, arm, torso]


@cache
def dynamics_of(name: str) -> RobotDynamics:
    return next(robot_dynamics(robot) for robot in body() if robot.name == name)


def links(angles: dict[str, np.ndarray]) -> list[tuple[float, np.ndarray, np.ndarray, np.ndarray]]:
    """Returns mass, inertia about the center, center and rotation of all moving links, by DH."""
    finger, arm, torso = body()
    below = torso.dh.frames(angles["torso"], torso.base_frame)
    middle = arm.dh.frames(angles["arm"], below[1] @ arm.base_frame)
    above = finger.dh.frames(angles["finger"], middle[-1] @ arm.flange_frame @ finger.base_frame)
    found = []
    for robot, frames in ((torso, below), (arm, middle), (finger, above)):
        known = dynamics_of(robot.name)
        for i in range(1 if robot is torso else 0, robot.n + 1):  # the torso's base is fixed
            centre = (frames[i] @ np.append(known.centers[i], 1.0))[:3]
            found.append((known.masses[i], known.tensors[i], centre, frames[i][:3, :3]))
    return found


def split(q: np.ndarray) -> dict[str, np.ndarray]:
    """Returns angles by robot, in the order of `body`."""
    return {"finger": q[:2], "arm": q[2:9], "torso": q[9:]}


def test_frames_of_mounted_robots_are_products_of_their_tables() -> None:
    world = World(Scene(robots=[*body()]))
    data = world.make_data()
    rng = np.random.default_rng(1)
    for _ in range(20):
        angles = {robot.name: rng.uniform(-2, 2, robot.n) for robot in body()}
        for name, values in angles.items():
            world.set_input(data, f"{name}.joint_angles", values)
        mujoco.mj_kinematics(world.model, data)
        finger, arm, torso = body()
        T_arm = torso.base_frame @ torso.dh.frames(angles["torso"])[1] @ arm.base_frame
        T_finger = T_arm @ arm.fwd_kin_base_to_flange(angles["arm"]) @ finger.base_frame
        tip = T_finger @ finger.fwd_kin_base_to_flange(angles["finger"])
        np.testing.assert_allclose(world.frame(data, "finger/flange"), tip, atol=1e-13)
        np.testing.assert_allclose(base_frames(world.scene.robots, angles)["finger"], T_finger)


def potential(q: np.ndarray) -> float:
    return sum(mass * GRAVITY * centre[2] for mass, _, centre, _ in links(split(q)))


def kinetic(q: np.ndarray, qd: np.ndarray, step: float = 1e-6) -> float:
    """Returns 1/2 (m v.v + w I w) of all links, with velocities by central differences."""
    before, after = links(split(q - step * qd)), links(split(q + step * qd))
    energy = 0.0
    for (mass, tensor, c0, R0), (_, _, c1, R1) in zip(before, after, strict=True):
        v = (c1 - c0) / (2 * step)
        spin = (R1 - R0) / (2 * step) @ ((R0 + R1) / 2).T
        w = ((R0 + R1) / 2).T @ np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
        energy += 0.5 * (mass * v @ v + w @ tensor @ w)
    return energy


def test_joint_torques_hold_the_weight_of_mounted_robots() -> None:
    plant = Plant(World(Scene(robots=[*body()], floor=False), dynamic=True))
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = rng.uniform(-1.5, 1.5, plant.n)
        plant.reset(q)
        step = 1e-5 * np.eye(plant.n)
        slope = [(potential(q + e) - potential(q - e)) / 2e-5 for e in step]
        np.testing.assert_allclose(plant.measured[2], slope, atol=2e-6)
    known = sum(mass for mass, *_ in links(split(np.zeros(plant.n))))
    carried = plant.model.body_subtreemass[plant.world.robots["torso"].bodies[1]]
    assert carried == pytest.approx(known)


def test_inertia_matrix_covers_all_mounted_links() -> None:
    plant = Plant(World(Scene(robots=[*body()], floor=False), dynamic=True))
    rng = np.random.default_rng(3)
    dofs = np.concatenate([part.dofs for part in plant.world.robots.values()])
    for _ in range(3):
        q, qd = rng.uniform(-1.5, 1.5, (2, plant.n))
        plant.reset(q)
        full = np.zeros((plant.model.nv, plant.model.nv))
        mujoco.mj_fullM(plant.model, plant.data, full)
        M = full[np.ix_(dofs, dofs)]
        assert 0.5 * qd @ M @ qd == pytest.approx(kinetic(q, qd), rel=1e-7)


def test_controller_model_includes_mounted_robots_and_the_base_pose() -> None:
    simulation = Simulation(Scenario(Scene(robots=[*body()], floor=False), duration=0.5))
    plant, whole = simulation.plant, simulation.whole_body
    rng = np.random.default_rng(4)
    models = {
        name: simulation.robot_model(unmounted(robot, base_frames(simulation.robots)[name]))
        for name, robot in simulation.robots.items()
    }
    assert whole is not None
    for _ in range(5):
        q = rng.uniform(-1.5, 1.5, plant.n)
        plant.reset(q)
        whole.update(q, plant.qpos)
        step = 1e-5 * np.eye(plant.n)
        slope = np.array([(potential(q + e) - potential(q - e)) / 2e-5 for e in step])
        for name, part in plant.world.robots.items():
            model = models[name]
            model.update(q[part.joints], np.zeros(part.robot.n))
            np.testing.assert_allclose(model.gravity(), slope[part.joints], atol=2e-6)
            np.testing.assert_allclose(model.flange(), plant.flange(name), atol=1e-13)
            qd = np.zeros(plant.n)
            qd[part.joints] = rng.uniform(-1, 1, part.robot.n)
            energy = 0.5 * qd[part.joints] @ model.mass() @ qd[part.joints]
            assert energy == pytest.approx(kinetic(q, qd), rel=1e-7)


def test_gravity_compensation_holds_the_whole_body_still() -> None:
    simulation = Simulation(Scenario(Scene(robots=[*body()], floor=False), duration=0.5))
    start = simulation.plant.actual[0].copy()
    simulation.advance(simulation.steps)
    np.testing.assert_allclose(simulation.plant.actual[0], start, atol=1e-6)


def test_push_at_the_finger_causes_external_torques_down_to_the_torso() -> None:
    plant = Plant(World(Scene(robots=[*body()], floor=False), dynamic=True))
    hold = plant.measured[2].copy()
    T = plant.flange("finger")
    plant.push("finger/flange", force=[7.0, -5.0, 3.0])
    plant.step(hold)
    external = plant.external_torques()
    q = np.concatenate([robot.home for robot in body()])
    for joint in range(plant.n):
        ways = []
        for side in (-1e-6, 1e-6):
            moved = q.copy()
            moved[joint] += side
            angles = split(moved)
            finger = body()[0]
            base = base_frames({robot.name: robot for robot in body()}, angles)["finger"]
            ways.append((base @ finger.fwd_kin_base_to_flange(angles["finger"]))[:3, 3])
        J = (ways[1] - ways[0]) / 2e-6
        assert external[joint] == pytest.approx(J @ [7.0, -5.0, 3.0], abs=1e-4)
    assert np.linalg.norm(T[:3, 3]) > 0


def test_adjacent_links_across_a_mount_do_not_collide() -> None:
    world = World(Scene(robots=[*body()], floor=False), dynamic=True)
    model, names = world.model, {i: world.model.body(i).name for i in range(world.model.nbody)}
    pairs = {
        frozenset((names[s >> 16], names[s & 0xFFFF])) for s in model.exclude_signature.tolist()
    }
    assert {"torso/link1", "arm/"} in pairs
    assert {"torso/link1", "arm/link2"} in pairs
    assert {"torso/link2", "arm/link1"} in pairs
    assert {"arm/flange", "finger/link1"} in pairs
    assert {"torso/link1", "arm/link3"} not in pairs
    assert {"torso/link2", "arm/link2"} not in pairs


def test_two_robots_mounted_on_one_link_are_neighbors() -> None:
    arms = [
        SerialRobot.from_model("lwr", name=name, mount="torso/link2", base_frame=ON_TORSO)
        for name in ("left", "right")
    ]
    world = World(Scene(robots=[*arms, body()[2]], floor=False), dynamic=True)
    names = {i: world.model.body(i).name for i in range(world.model.nbody)}
    pairs = {
        frozenset((names[s >> 16], names[s & 0xFFFF]))
        for s in world.model.exclude_signature.tolist()
    }
    assert {"left/", "right/link2"} in pairs
    assert {"left/link1", "right/link1"} in pairs
    assert {"left/link2", "right/link1"} not in pairs


def test_body_belongs_to_the_nearest_robot() -> None:
    world = World(Scene(robots=[*body()]))
    owner = robots_of_bodies(world.model, world.robots)
    for number, name in enumerate(world.robots):
        mine = {world.model.body(i).name for i in np.flatnonzero(owner == number)}
        assert mine == {
            n
            for n in map(lambda i: world.model.body(i).name, range(world.model.nbody))
            if n.startswith(f"{name}/")
        }
    assert owner[0] == -1


def test_double_of_a_mounted_robot_is_at_its_mount() -> None:
    target = np.array([0.5, 0.5])
    scene = Scene(
        robots=[*body()], doubles=[Double(name="target", of="finger", joint_angles=target)]
    )
    mirror = Mirror(scene)
    for lean in (0.2, -0.9):
        mirror.world.set_input(mirror.data, "torso.joint_angles", [lean, 0.0])
        mirror.advance(0.0)
        angles = {"torso": np.array([lean, 0.0])}
        base = base_frames(scene.robots, angles)["finger"]
        expected = base @ scene.robots["finger"].fwd_kin_base_to_flange(target)
        np.testing.assert_allclose(
            mirror.world.frame(mirror.data, "target/flange"), expected, atol=1e-12
        )


def test_sent_torques_include_the_load_of_mounted_robots() -> None:
    """The sent torques hold the mounted robots."""
    robots = body()
    routes = {}
    for i, robot in enumerate(robots):
        routes[f"{robot.name}.joint_angles"] = f"udp.values{2 * i}"
        routes[f"{robot.name}.torques"] = f"udp.values{2 * i + 1}"
    scene = Scene(
        robots=robots, routes=routes,
        sources={"udp": {"kind": "udp", "port": 0, "structure": "2F2F7F7F2F2F"}},
    )  # fmt: skip
    packets = MotionPackets(scene, amplitude=0.0)
    numbers = np.frombuffer(packets.at(0.3), "<f8")
    parts = np.split(numbers, np.cumsum([2, 2, 7, 7, 2]))
    q, torques = np.concatenate(parts[::2]), np.concatenate(parts[1::2])
    world = World(Scene(robots=robots))  # its masses are those of the shapes at some density
    data = world.make_data()

    def energy(angles: np.ndarray) -> float:
        for name, values in split(angles).items():
            world.set_input(data, f"{name}.joint_angles", values)
        mujoco.mj_kinematics(world.model, data)
        return float(GRAVITY * world.model.body_mass @ data.xipos[:, 2])

    slope = [(energy(q + e) - energy(q - e)) / 2e-5 for e in 1e-5 * np.eye(11)]
    np.testing.assert_allclose(torques, slope, rtol=1e-6, atol=1e-4)


WRONG = """\
[robots.torso]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.3]]

[robots.a]
model = "lwr"
mount = "torso/lnk1"

[robots.b]
model = "lwr"
mount = "toroso/link1"

[robots.c]
model = "lwr"
mount = "torso"

[robots.d]
model = "lwr"
mount = "e/flange"

[robots.e]
model = "lwr"
mount = "d/flange"

[robots.f]
model = "lwr"
mount = "f/base"
"""


def test_invalid_mounts_are_reported_together_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(WRONG)
    assert problems_in(path) == [
        "7: robots.a.mount: no frame 'torso/lnk1'; did you mean 'torso/link1'?",
        "11: robots.b.mount: no frame 'toroso/link1'; did you mean 'torso/link1'?",
        "15: robots.c.mount: no frame 'torso'; expected one of its frames: torso/base, "
        "torso/link1, "
        "torso/flange",
        "19: robots.d.mount: robots are mounted on each other in a cycle: d on e on d",
        "27: robots.f.mount: robots are mounted on each other in a cycle: f on f",
    ]


def test_mount_on_an_invalid_robot_is_not_reported_twice(tmp_path: Path) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(
        '[robots.torso]\nmodel = "lwr"\nbase = 3\n[robots.a]\nmodel = "lwr"\n'
        'mount = "torso/flange"\n'
    )
    with pytest.raises(DeclarationError) as caught:
        load_scene(path)
    assert [problem.key for problem in caught.value.problems] == ["robots.torso.base"]


def test_route_to_the_base_of_a_mounted_robot_is_rejected() -> None:
    scene = Scene(
        robots=[*body()], routes={"arm.base_frame": "udp.matrices0"},
        sources={"udp": {"kind": "udp", "port": 0, "structure": "1M"}},
    )  # fmt: skip
    (problem,) = wire(scene).problems
    assert problem.key == "routes.arm.base_frame"
    assert "arm is mounted on torso/link1" in problem.message
