"""The DLR/HIT Hand II: its kinematics from packets, its weight, and a simulated grasp."""

from __future__ import annotations

import socket
import struct
from functools import cache

import numpy as np
import pytest

from sero_mj import Mirror, load_scene
from sero_mj.base.paths import find_scene
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

FINGERS = ("thumb", "index", "middle", "ring", "little")
HAND = [f"hand_{finger}" for finger in FINGERS]
# Of the robot file's source HH: bases in the palm, m, roll, pitch, yaw.
BASES = {
    "thumb": [0.062569, 0.044545, 0.080045, 0.41136, -1.08366, 0.225804],
    "index": [-0.002530, 0.036800, 0.108744, 3.05433, -np.pi / 2, 0],
    "middle": [-0.003700, 0.010000, 0.119044, np.pi, -np.pi / 2, 0],
    "ring": [-0.002530, -0.016800, 0.114044, -3.05433, -np.pi / 2, 0],
    "little": [0.000972, -0.043396, 0.095044, -2.96706, -np.pi / 2, 0],
}


def turn(axis: int, angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    R = np.eye(3)
    i, k = (axis + 1) % 3, (axis + 2) % 3
    R[i, i], R[k, k], R[i, k], R[k, i] = c, c, -s, s
    return R


def fingertip(finger: str, angles: np.ndarray) -> np.ndarray:
    """Returns the fingertip in the palm frame, by planar kinematics of the finger."""
    x, y, z, roll, pitch, yaw = BASES[finger]
    R = turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    abduction, bend, outer = angles
    along, up = np.zeros(2)
    for length, total in ((0.055, bend), (0.025, bend + outer), (0.025, bend + 2 * outer)):
        along, up = along + length * np.cos(total), up + length * np.sin(total)
    return np.array([x, y, z]) + R @ turn(2, abduction) @ [along, 0.0, up]


def packet(sender: socket.socket, scene: str, numbers: np.ndarray) -> Mirror:
    """Returns a mirror that has received one packet."""
    declared = load_scene(find_scene(scene))
    declared.sources["udp"]["port"] = 0
    mirror = Mirror(declared)
    mirror.open()
    sender.sendto(struct.pack(f"<{len(numbers)}d", *numbers),
                  ("127.0.0.1", mirror.sources["udp"].port))  # fmt: skip
    assert mirror.wait(5.0) == []
    mirror.advance()
    return mirror


@pytest.mark.parametrize("scene", ["hit_hand", "lwr_hit_hand"])
def test_packet_of_the_independent_joints_moves_the_hand(scene: str) -> None:
    rng = np.random.default_rng(3)
    arm = 7 if scene == "lwr_hit_hand" else 0
    own, bent = rng.uniform(-1.0, 1.0, arm), rng.uniform(0.0, 1.0, (5, 3))
    torques = rng.uniform(-0.5, 0.5, arm + 15)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        mirror = packet(sender, scene, np.concatenate([own, bent.ravel(), torques]))
    world, data = mirror.world, mirror.data
    T = np.eye(4)
    T[2, 3] = 0.06
    if arm:
        T = world.frame(data, "arm/flange").copy()
        T[:3, 3] += 0.02 * T[:3, 2]
    for finger, angles, shown in zip(FINGERS, bent, torques[arm:].reshape(5, 3), strict=True):
        tip = world.frame(data, f"hand_{finger}/flange")[:3, 3]
        expected = T[:3, :3] @ fingertip(finger, angles) + T[:3, 3]
        np.testing.assert_allclose(tip, expected, atol=2e-6)  # angles in files are rounded
        got = data.userdata[world.slots[f"hand_{finger}.torques"]]
        # The torque of the coupled joint is unknown.
        np.testing.assert_allclose(got, [*shown, np.nan])
    mirror.close()


@cache
def grasp(friction: float | None = None) -> Simulation:
    over = {} if friction is None else {"objects.can.friction": friction}
    simulation = Simulation(read_scenario("hit_hand_grasp", {**over, "run.duration": 4.6}))
    simulation.advance(simulation.steps)
    return simulation


@pytest.mark.thorough
def test_arm_carries_the_weight_of_the_hand() -> None:
    simulation = grasp()
    robots, log = simulation.robots, simulation.log
    model, data = simulation.plant.model, simulation.plant.data
    # The center of the palm's shapes is the one that MuJoCo computes; the rest is from tables.
    body = model.body("hand_thumb/on_base")
    R = data.xmat[model.body("arm/flange").id].reshape(3, 3)
    flange, middle = data.xpos[model.body("arm/flange").id], data.xipos[body.id]
    palm = 0.8735, R.T @ (middle - flange)
    np.testing.assert_allclose(palm[1], [0.0, 0.0, 0.06], atol=0.02)  # in front of the adapter
    adapter = 1000.0 * np.pi * 0.032**2 * 0.02, np.array([0.0, 0.0, 0.01])
    start = np.concatenate([log.of(name, "actual_angles")[0] for name in ("arm", *HAND)])
    parameters = {name: robot_dynamics(robots[name]) for name in ("arm", *HAND)}
    # Its own links, then everything at the flange, and the fingers by their tables.

    def energy(q: np.ndarray) -> float:
        arm = robots["arm"]
        frames = arm.dh.frames(q[:7], arm.base_frame)
        flange = frames[-1] @ arm.T_n_flange
        own = parameters["arm"]
        bodies = list(zip(own.masses, own.centers, frames, strict=True))
        bodies += [(mass, center, flange) for mass, center in (palm, adapter)]
        for k, name in enumerate(HAND):
            robot = robots[name]
            at = robot.dh.frames(q[7 + 4 * k : 11 + 4 * k], flange @ robot.base_frame)
            known = parameters[name]
            bodies += zip(known.masses, known.centers, at, strict=True)
        return sum(9.81 * float(m * (T @ np.append(c, 1.0))[2]) for m, c, T in bodies)

    steps = 1e-6 * np.eye(len(start))
    gravity = np.array([(energy(start + e) - energy(start - e)) / 2e-6 for e in steps])
    held = np.concatenate([log.of(name, "actual_torques")[0] for name in ("arm", *HAND)])
    np.testing.assert_allclose(held, gravity, atol=2e-5)
    assert np.abs(gravity[:7]).max() > 30.0
    mass = model.body_mass[model.body_mocapid < 0].sum()  # of all but the base
    parts = sum(robot_dynamics(robots[name]).masses.sum() for name in HAND)
    own = robot_dynamics(robots["arm"]).masses[1:].sum()
    assert mass == pytest.approx(own + palm[0] + adapter[0] + parts + 0.2, abs=1e-9)


@pytest.mark.thorough
def test_distal_joints_follow_the_medial_ones_under_load() -> None:
    log = grasp().log
    for name in HAND:
        angles = log.of(name, "actual_angles")
        assert np.ptp(angles[:, 2]) > 0.3
        np.testing.assert_allclose(angles[:, 3], angles[:, 2], atol=2e-4)


@pytest.mark.thorough
def test_hand_holds_the_can_by_friction_only() -> None:
    simulation = grasp()
    outcomes = simulation.outcomes()
    assert [outcome.name for outcome in outcomes if not outcome.holds] == []
    # At the end, when everything is at rest, the hand carries the can's weight.
    force = sum(simulation.log.signals[f"{name}_contact_force"][-200:] for name in HAND)
    np.testing.assert_allclose(force.mean(axis=0), [0.0, 0.0, -0.2 * 9.81], atol=0.15)
    failed = [outcome.name for outcome in grasp(0.05).outcomes() if not outcome.holds]
    assert "lifted_can_height" in failed
    assert grasp(0.05).log.signals["can_frame"][-1, 2, 3] < 0.42  # on the table, lying or upright
