"""Parallel robots of serial legs: their legs meet in two computations, and gaps are reported."""

from __future__ import annotations

import subprocess
import sys
from types import ModuleType

import numpy as np
import pytest
from conftest import ROOT, import_script
from decor_tools import labels, toggles_of, view_at
from polling import until

from sero_mj.base.frames import rotation_angle
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.drive.place import Placer
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.load import load_scene
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.viewer.decor.draw import Decor
from sero_mj.viewer.decor.flange_check import flange_difference

SENDER = ROOT / "scenes" / "parallel_sender.py"
TIMES = np.linspace(0.0, 12.0, 13)
# The slices of each robot's joints in a packet, and the robot that the others must meet.
LEGS = {
    "five_bar": {"left": slice(0, 2), "right": slice(2, 5)},
    "stewart": {f"leg{k + 1}": slice(6 * k, 6 * k + 6) for k in range(6)},
}


@pytest.fixture(scope="module")
def sender() -> ModuleType:
    return import_script(SENDER)


def flanges(scene: Scene, packet) -> np.ndarray:
    """Returns the flange of every leg in the world from the DH tables, (legs, 4, 4)."""
    return np.array([
        scene.robots[name].base_frame @ scene.robots[name].fwd_kin_base_to_flange(packet[part])
        for name, part in LEGS[scene.name].items()
    ])  # fmt: skip


@pytest.mark.parametrize("name", LEGS)
def test_legs_meet_over_the_whole_motion_within_their_limits(sender, name):
    scene = load_scene(name)
    for t in TIMES:
        packet = np.array(getattr(sender, name)(scene.robots, t))
        poses = flanges(scene, packet)
        # Anchors are written to 1e-9 m.
        np.testing.assert_allclose(poses, np.broadcast_to(poses[0], poses.shape), atol=1e-8)
        for leg, part in LEGS[name].items():
            limits = scene.robots[leg].position_limits
            if limits is not None:
                assert (packet[part] > limits[:, 0]).all() and (packet[part] < limits[:, 1]).all()


@pytest.mark.parametrize("name", LEGS)
def test_legs_meet_in_the_compiled_scene_as_declared(name):
    scene = load_scene(name)
    world = World(scene)
    data = world.make_data()
    Placer(world).place(data)
    checked = list(LEGS[name])[1:]
    for leg in checked:
        distance, angle = flange_difference(world, data, leg)
        assert distance < 1e-6 and angle < 1e-6
    # With one leg opened, it alone is off, by the amount of the table.
    leg = checked[-1]
    bent = scene.robots[leg].home + 0.02
    world.set_input(data, f"{leg}.joint_angles", bent)
    Placer(world).place(data)
    off = {other: flange_difference(world, data, other)[0] for other in checked}
    moved = scene.robots[leg].fwd_kin_base_to_flange(bent)
    gap = moved[:3, 3] - scene.robots[leg].fwd_kin_base_to_flange()[:3, 3]
    assert off.pop(leg) == pytest.approx(np.linalg.norm(gap), abs=1e-6)
    assert np.linalg.norm(gap) > 0.005 and all(other < 1e-6 for other in off.values())
    buffer = Decor(world).draw(data, toggles_of(world), view_at(distance=4))
    assert f"{leg} flange is off" in labels(buffer.rows[: buffer.count])


def test_closed_form_inverse_kinematics_equals_newton(sender):
    # The second computation: Newton with the Jacobian of the DH table, from the declared pose.
    scene = load_scene("stewart")
    for t in (0.7, 2.9, 5.1):
        packet = np.array(sender.stewart(scene.robots, t))
        goal = flanges(scene, packet)[0]
        for name, part in LEGS["stewart"].items():
            robot = scene.robots[name]
            q = robot.home.copy()
            for _ in range(20):
                T = robot.base_frame @ robot.fwd_kin_base_to_flange(q)
                R = goal[:3, :3] @ T[:3, :3].T
                turn = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
                step = np.append(goal[:3, 3] - T[:3, 3], turn)
                q += np.linalg.solve(
                    robot.dh.jacobian(q, robot.base_frame, robot.flange_frame), step
                )
            assert rotation_angle(R) < 1e-7
            np.testing.assert_allclose(q, packet[part], atol=1e-7)


def test_work_of_the_driving_torques_equals_that_of_the_push(sender):
    scene = load_scene("five_bar")
    for t in TIMES:
        h = 1e-6
        before, after = (np.array(sender.five_bar(scene.robots, t + s)) for s in (-h, h))
        moved = [flanges(scene, packet)[0][:3, 3] for packet in (before, after)]
        now = np.array(sender.five_bar(scene.robots, t))
        work = now[5:7] @ (after - before)[[0, 2]] + now[7:] @ (moved[1] - moved[0])
        assert abs(work) < 1e-9 * 15 and np.linalg.norm(now[7:]) == pytest.approx(15)
        assert np.abs(now[5:7]).max() > 0.5


def test_work_of_the_struts_equals_that_of_lifting_the_platform(sender):
    scene = load_scene("stewart")
    struts = np.arange(6) * 6 + 2
    for t in TIMES:
        h = 1e-6
        before, after = (np.array(sender.stewart(scene.robots, t + s)) for s in (-h, h))
        lifted = [flanges(scene, packet)[0][2, 3] for packet in (before, after)]
        forces = np.array(sender.stewart(scene.robots, t))[36:]
        work = forces @ (after - before)[struts]
        assert work == pytest.approx(25 * 9.81 * (lifted[1] - lifted[0]), abs=1e-9 * 245)
        assert forces.max() < 120  # the limit of the struts


@pytest.mark.parametrize("name", LEGS)
def test_sender_moves_the_shipped_scene_and_its_legs_stay_closed(name):
    scene = load_scene(name)
    scene.sources["udp"]["port"] = 0
    with Mirror(scene) as mirror:
        source = mirror.sources["udp"]
        assert isinstance(source, UdpReceiver)
        command = [sys.executable, str(SENDER), name, "0.5", str(source.port)]
        with subprocess.Popen(command, cwd=ROOT) as process:
            for _ in range(5):
                assert until(mirror.advance, 20.0)
                for leg in list(LEGS[name])[1:]:
                    assert flange_difference(mirror.world, mirror.data, leg)[0] < 1e-6
            assert process.wait(20) == 0
        assert source.counters.malformed == 0
        torque = mirror.data.userdata[mirror.world.slots[f"{next(iter(LEGS[name]))}.torques"]]
        assert torque.any()


def test_flange_check_is_relative_to_the_robot_base():
    # The frame of another robot is a pose in the world, and a flange check is one from the base.
    base = {"xyz": [0.4, -0.3, 0.2], "rpy_deg": [20, -30, 70]}
    arms = [
        SerialRobot.from_model("lwr", name=name, base_frame=base, joint_angles=np.full(7, 0.3))
        for name in ("one", "two")
    ]
    scene = Scene(robots=arms, routes={"two.flange_check": "one/flange"})
    world = World(scene)
    data = world.make_data()
    Placer(world).place(data)
    np.testing.assert_allclose(flange_difference(world, data, "two"), 0, atol=1e-7)
    T = np.eye(4)
    T[:3, 3] = 0.1, 0.0, 0.05
    world.set_input(data, "one.base_frame", T @ arms[0].base_frame)
    Placer(world).place(data)
    assert flange_difference(world, data, "two")[0] == pytest.approx(np.hypot(0.1, 0.05))
