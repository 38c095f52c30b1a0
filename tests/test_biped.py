"""The biped: its kinematics, the load of both feet, standing, and falling."""

from __future__ import annotations

import runpy
import socket
import struct
from functools import cache

import numpy as np
import pytest

from sero_mj import Mirror, load_scene
from sero_mj.base.paths import find_scene, scenes_dir
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.mounts import base_frames
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

G = 9.81
LEGS = ("biped_left", "biped_right")
PELVIS = 15.0  # kg, of three shapes


def turn(axis: str, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    i, k = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[i, i], R[k, k], R[i, k], R[k, i] = c, c, -s, s
    return R


def toe_tip(angles: np.ndarray, side: float) -> np.ndarray:
    """Returns the frame of the sole below the toe in hip coordinates.

    `side` is 1 for the left leg and -1 for the mirrored right leg. `angles` has shape (7,), rad.
    """
    yaw, roll, pitch, knee, ankle, tilt, toe = angles
    at = np.zeros(3)
    R = turn("z", side * yaw) @ turn("x", side * roll) @ turn("y", pitch)
    for R_next, step in (
        (turn("y", knee), [0, 0, -0.4]),
        (turn("y", ankle) @ turn("x", side * tilt), [0, 0, -0.4]),
        (turn("y", toe), [0.10, 0, -0.07]),
    ):
        at = at + R @ np.array(step)
        R = R @ R_next
    return at + R @ [0, 0, -0.02]


def test_legs_are_two_mirrored_chains_of_rotations() -> None:
    robots = load_scene(find_scene("biped")).robots
    rng = np.random.default_rng(4)
    for _ in range(10):
        q = {name: rng.uniform(-0.6, 0.6, 7) for name in LEGS}
        bases = base_frames(robots, q)
        for name, side in zip(LEGS, (1.0, -1.0), strict=True):
            T = bases[name] @ robots[name].fwd_kin_base_to_flange(q[name])
            hip = [0.0, 0.1 * side, 0.8415]
            np.testing.assert_allclose(T[:3, 3], hip + toe_tip(q[name], side), atol=1e-9)


def test_sender_holds_both_soles_on_the_floor_and_carries_the_weight() -> None:
    scene = load_scene(find_scene("biped"))
    scene.sources["udp"]["port"] = 0
    sender = runpy.run_path(str(scenes_dir() / "biped_sender.py"))
    with Mirror(scene) as mirror, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        address = ("127.0.0.1", mirror.sources["udp"].port)
        soles, loads = [], []
        for k in range(20):
            values = sender["stand"](scene.robots, 0.37 * k)
            out.sendto(struct.pack("<44d", *values), address)
            assert mirror.wait(5.0) == []
            while mirror.sources["udp"].counters.received <= k:
                mirror.wait(5.0)
            mirror.advance()
            T = [mirror.world.frame(mirror.data, f"{name}/flange") for name in LEGS]
            soles.append([each[:3] for each in T])
            # The floor force passes the knee at a distance of the shank length times its lean.
            lever = 0.4 * np.sin(values[3] / 2) * np.cos(values[1])
            loads.append([-values[17] / lever, -values[24] / lever])
    np.testing.assert_allclose(soles, np.broadcast_to(soles[0], np.shape(soles)), atol=1e-6)
    assert np.ptp(loads) > 20.0  # N: the load shifts from foot to foot
    np.testing.assert_allclose(np.sum(loads, axis=1), sender["WEIGHT"], rtol=1e-6)


@cache
def standing() -> Simulation:
    simulation = Simulation(read_scenario("biped_stand"))
    simulation.advance(simulation.steps)
    return simulation


def bodies_of(simulation: Simulation, row: int) -> dict[str, list[tuple[float, np.ndarray]]]:
    """Returns masses and centers of mass (3,) of all bodies in the world, by leg, base first."""
    robots, log = simulation.robots, simulation.log
    q = {name: log.of(name, "actual_angles")[row] for name in LEGS}
    bases = base_frames(robots, q, {"biped_left": log.signals["biped_left_base_frame"][row]})
    found = {}
    for name in LEGS:
        known, frames = robot_dynamics(robots[name]), robots[name].dh.frames(q[name], bases[name])
        found[name] = [
            (m, (T @ np.append(c, 1.0))[:3])
            for m, c, T in zip(known.masses, known.centers, frames, strict=True)
        ]
    pelvis = simulation.plant.model.body("biped_left/on_base")
    assert pelvis.mass[0] == pytest.approx(PELVIS)
    found["pelvis"] = [(PELVIS, (bases["biped_left"] @ np.append(pelvis.ipos, 1.0))[:3])]
    return found


def middle_of(bodies: dict[str, list[tuple[float, np.ndarray]]]) -> tuple[float, np.ndarray]:
    """Returns the total mass and center of mass."""
    masses, centers = zip(*(body for each in bodies.values() for body in each), strict=True)
    return sum(masses), np.average(centers, axis=0, weights=masses)


@pytest.mark.thorough
def test_biped_stands_on_both_feet_after_pushes() -> None:
    simulation = standing()
    assert [each.text for each in simulation.outcomes() if not each.holds] == []
    log, row = simulation.log, 1900  # at rest, before the pushes
    bodies = bodies_of(simulation, row)
    mass, middle = middle_of(bodies)
    # The floor carries all of the weight, half on each foot.
    forces = np.array([log.signals[f"{name}_contact_force"][row] for name in LEGS])
    np.testing.assert_allclose(forces[:, 2], mass * G / 2, rtol=2e-3)
    np.testing.assert_allclose(forces[:, :2], 0.0, atol=1.0)
    # The force acts under the center of mass: statics of shank and foot about the knee.
    left = simulation.robots["biped_left"]
    q = log.of("biped_left", "actual_angles")[row]
    T = left.dh.frames(q, log.signals["biped_left_base_frame"][row])
    knee = T[4, 0, 3]
    below = sum(m * G * (c[0] - knee) for m, c in bodies["biped_left"][4:])
    expected = mass * G / 2 * (middle[0] - knee) - below
    assert log.of("biped_left", "torques")[row, 3] == pytest.approx(expected, abs=0.4)
    assert expected < -15.0
    left_torques, right_torques = (log.of(name, "torques")[row] for name in LEGS)
    np.testing.assert_allclose(left_torques, right_torques, atol=0.05)  # a mirror image


@pytest.mark.thorough
def test_declared_pose_is_balanced_over_the_soles() -> None:
    mass, middle = middle_of(bodies_of(standing(), 0))
    assert mass == pytest.approx(42.57, abs=0.01)
    # As declared in the scenario.
    np.testing.assert_allclose(middle, [0.0326, 0.0, 0.7246], atol=2e-4)


@pytest.mark.thorough
def test_pushes_change_the_momentum_by_their_impulse() -> None:
    """Over the whole run, the impulse of floor and pushes equals the change of momentum."""
    simulation = standing()
    log, step = simulation.log, simulation.plant.timestep
    forces = sum(log.signals[f"{name}_contact_force"] for name in LEGS)
    mass, _ = middle_of(bodies_of(simulation, 0))
    rows = slice(1500, 5900)  # at rest at both ends
    impulse = (forces[rows] - [0.0, 0.0, mass * G]).sum(axis=0) * step
    pushes = 2 / np.pi * 0.4 * np.array([40.0, -30.0, 0.0])
    np.testing.assert_allclose(impulse, -pushes, atol=0.4)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "over",
    [
        {"controllers.biped": {"kind": "torque", "compensate_gravity": False}},
        {"controllers.biped.stiffness": [800, 2000, 2000, 2000, 60, 2000, 10]},
    ],
    ids=["limp", "soft ankles"],
)
def test_biped_falls_without_control_and_with_soft_ankles(over: dict) -> None:
    simulation = Simulation(read_scenario("biped_stand", over))
    simulation.advance(simulation.steps)
    outcomes = {each.name: each.holds for each in simulation.outcomes()}
    assert not outcomes["min_base_height"] and not outcomes["peak_tilt"]
    assert simulation.log.signals["biped_left_base_frame"][-1, 2, 3] < 0.5  # m: it has fallen
