"""Torques and forces have one sign convention for all robot interfaces.

Simulated robots send the signs of their makers, and receivers convert them to ours.
"""

from __future__ import annotations

import socket
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import free_udp_port, raises_with
from franka_server import state
from fri_packets import measurement
from polling import until

from sero_mj import SerialRobot
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.receive.source import make_source
from sero_mj.extensions.franka.receiver import FrankaReceiver
from sero_mj.extensions.fri.receiver import FriReceiver
from sero_mj.extensions.rtde.receiver import VARIABLES, RtdeReceiver
from sero_mj.load import load_scene
from sero_mj.simulate.control.robot_model import RobotModel
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

FORCE = np.array([10.0, -5.0, -30.0])  # N, on the flange, in directions of the base
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # of the base in the world
SCENARIO = """
[robots.arm]
model = "{model}"
joint_angles = {home}
base_frame = {{ xyz = [0.3, 0, 0], rpy_deg = [0, 0, 90] }}
[controllers.arm]
port = {port}
clock = "real_time"
{controller}
[disturbances.push]
kind = "force"
at = "arm/flange"
force = {force}
begin = 0.0
end = 10.0
[run]
duration = {duration}
"""
SCENE = """
[robots.arm]
model = "{model}"
base_frame = {{ xyz = [0.3, 0, 0], rpy_deg = [0, 0, 90] }}
inputs = ["external_torques"]
[sources.it]
port = {port}
{source}
[arrows.force]
kind = "force"
at = "arm/flange"
expressed_in = "arm/base"
[routes]
"arm.joint_angles" = "it.joint_angles"
"arm.torques" = "it.torques"
{routes}
"""
ARMS: dict[str, dict[str, Any]] = {
    "franka": {
        "model": "panda",
        "home": [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785],
        "controller": 'kind = "franka"\nversion = 5\nfirst_patience = 1',
        "source": 'kind = "franka"\nhost = "127.0.0.1"',
        "told": {"force.vector": "tcp_force", "arm.external_torques": "external_torques"},
    },
    "rtde": {
        "model": "ur5e",
        "home": [0.0, -1.57, 1.57, -1.57, -1.57, 0.0],
        "controller": 'kind = "rtde"\ninterface = "position"',
        "source": 'kind = "rtde"\nhost = "127.0.0.1"',
        "told": {"force.vector": "tcp_force"},
    },
    "iiwa": {
        "model": "iiwa14",
        "home": [0.2, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0],
        "controller": 'kind = "fri"\nversion = "iiwa-2"\ncommands_from = 100',
        "source": 'kind = "fri"\nversion = "iiwa-2"\nanswer = true',
        "told": {"arm.external_torques": "external_torques"},
    },
}


def free_port(name: str) -> int:
    if name == "iiwa":
        return free_udp_port()
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.mark.parametrize("name", ARMS)
def test_push_has_the_same_direction_for_all_arms(name: str, tmp_path: Path) -> None:
    arm, port = ARMS[name], free_port(name)
    routes = "\n".join(f'"{target}" = "it.{event}"' for target, event in arm["told"].items())
    world_force = (TURN @ FORCE).tolist()
    scenario, scene = tmp_path / "scenario.toml", tmp_path / "scene.toml"
    scenario.write_text(SCENARIO.format(port=port, duration=0.6, force=world_force, **arm))
    scene.write_text(SCENE.format(port=port, routes=routes, **arm))
    simulation = Simulation(read_scenario(scenario))
    with Mirror(load_scene(scene)) as mirror:
        source = mirror.sources["it"]
        for _ in simulation.run():
            pass
        assert until(lambda: source.receive_trigger > 100)
        mirror.advance()
        world, data = mirror.world, mirror.data
        shown = {key: data.userdata[world.slots[key]].copy() for key in arm["told"]}
        torques, angles = data.userdata[world.slots["arm.torques"]].copy(), data.qpos.copy()
    log = simulation.log.signals
    # The simulated drive torques are shown bit for bit.
    logged = np.hstack([log["arm_joint_angles"], log["arm_torques"]])
    assert (logged == np.hstack([angles, torques])).all(axis=1).any()
    model = RobotModel.of(SerialRobot.from_model(arm["model"]))
    model.update(angles, np.zeros(model.n))
    external = model.jacobian()[:3].T @ FORCE
    # Drives that hold the arm against a push act in the opposite direction.
    np.testing.assert_allclose(torques - model.gravity(), -external, atol=3.0)
    assert np.abs(external).max() > 10.0
    if "force.vector" in shown:
        np.testing.assert_allclose(shown["force.vector"], FORCE, atol=3.0)
    if "arm.external_torques" in shown:
        np.testing.assert_allclose(shown["arm.external_torques"], external, atol=1.5)


@pytest.mark.parametrize("sign", [1, -1])
def test_torque_sign_multiplies_measured_and_commanded_torques(sign: int) -> None:
    numbers = [1.0, -2.0, 3.0, -4.0, 5.0, -6.0, 7.0]
    signed = [sign * x for x in numbers]
    lwr = FriReceiver(torque_sign=sign)
    got = lwr.decode(measurement(torques=numbers, external_torques=numbers))
    assert got is not None
    assert got["torques"].tolist() == signed
    assert got["external_torques"].tolist() == numbers
    assert lwr.decoding_fields() == {"torque_sign": sign}
    sent = lwr.layout.encode({"torques": numbers, "external_torques": numbers})  # as `send` does
    assert struct.unpack_from("<7f", sent, 444) == tuple(signed)
    assert struct.unpack_from("<7f", sent, 472) == tuple(numbers)

    franka = FrankaReceiver(host="a", torque_sign=sign)
    got = franka.decode(state(tau_J=numbers, tau_J_d=numbers, tau_ext_hat_filtered=numbers))
    assert got is not None
    assert got["torques"].tolist() == got["commanded_torques"].tolist() == signed
    assert got["external_torques"].tolist() == [-x for x in numbers]

    ur = RtdeReceiver(host="a", torque_sign=sign)
    wire = {"DOUBLE": (">d", 0.5), "INT32": (">i", 7), "VECTOR6D": (">6d", *numbers[:6])}
    packet = b"".join(struct.pack(*wire[kind]) for _, kind, _ in VARIABLES)
    got = ur.decode(packet + struct.pack(">BI", 0, 1))
    assert got is not None
    assert got["torques"].tolist() == got["commanded_torques"].tolist() == signed[:6]
    assert got["currents"].tolist() == numbers[:6]
    assert got["tcp_force"].tolist() == [numbers[:3]]


@pytest.mark.parametrize("kind", ["fri", "franka", "rtde", "ros2"])
def test_invalid_torque_signs_are_rejected(kind: str) -> None:
    host = {"host": "10.0.0.1"} if kind in ("franka", "rtde") else {}
    with raises_with(key="torque_sign", found=2, expected="-1 or 1"):
        make_source("it", {"kind": kind, "torque_sign": 2, **host})
