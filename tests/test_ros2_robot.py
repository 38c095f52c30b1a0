"""Kind `ros2` of controllers: nodes in other processes hold a simulated robot by topics."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ros_tools import free_domain

from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

DOMAIN = free_domain() - 80
SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0, 0.6, 0, -1.2, 0, 1.2, 0]
[controllers.lwr]
kind = "ros2"
domain = {domain}
command = ["{python}", "node.py", "{mode}"]
[disturbances.push]
kind = "force"
at = "lwr/flange"
force = [0.0, 20.0, 0.0]
begin = 0.02
end = 0.05
[run]
duration = {duration}
gravity = [0, 0, 0]
"""
NODE = f"""
import os, sys, time
sys.path.insert(0, {str(Path(__file__).parent)!r})
from ros2_peer import *
from cyclonedds.sub import DataReader

@dataclass
@final
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time

mode, number = sys.argv[1], int(os.environ["ROS_DOMAIN_ID"])
domain = Domain(number, LOOPBACK)
participant = DomainParticipant(number)
reliable = Policy.Reliability.Reliable(duration(seconds=1))
qos = Qos(reliable, Policy.History.KeepLast(1))
states = DataReader(participant, Topic(participant, "rt/joint_states", JointState), qos=qos)
clocks = DataReader(participant, Topic(participant, "rt/clock", Clock), qos=qos)
commands = DataWriter(participant, Topic(participant, "rt/forward_effort_controller/commands",
                                         Float64MultiArray), qos=qos)
home = [0, 0.6, 0, -1.2, 0, 1.2, 0]
newest = None
for state in states.take_iter(timeout=20 * 10**9):
    stamp = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
    for each in clocks.take(1):
        newest = each.clock.sec + 1e-9 * each.clock.nanosec
    pairs = zip(home, state.position, state.velocity)
    numbers = [800.0 * (wanted - q) - 40.0 * v for wanted, q, v in pairs]
    if mode == "position":
        numbers = home
    if mode == "short":
        numbers = numbers[:6]
    if mode == "nan" and stamp > 0.0305:
        numbers[2] = float("nan")
    if mode == "silent" and stamp > 0.0305:
        continue
    if mode == "names":
        open("names", "w").write(" ".join(state.name))
    if mode == "clock" and newest is not None:
        open("clock", "w").write(f"{{newest}} {{stamp}}")
    commands.write(Float64MultiArray(Layout([], 0), numbers))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = tmp_path_factory.mktemp("ros2")
    (found / "node.py").write_text(NODE)
    return found


def simulated(folder: Path, mode: str, duration: float = 0.1, **settings: Any) -> Simulation:
    file = folder / "scenario.toml"
    values = {"python": sys.executable, "mode": mode, "duration": duration, "domain": DOMAIN}
    file.write_text(SCENARIO.format(**values))
    over = {f"controllers.lwr.{key}": value for key, value in settings.items()}
    simulation = Simulation(read_scenario(file, over))
    for _ in simulation.run():
        pass
    return simulation


def test_a_node_holds_the_robot_in_lockstep(folder: Path) -> None:
    simulation = simulated(folder, "clock")
    signals = simulation.log.signals
    assert not signals["lwr_command_age"].any()
    for k in (10, 60, 100):
        q, v = signals["lwr_joint_angles"][k - 1], signals["lwr_joint_velocities"][k - 1]
        expected = 800.0 * (np.array([0, 0.6, 0, -1.2, 0, 1.2, 0]) - q) - 40.0 * v
        assert signals["lwr_commanded_torques"][k] == pytest.approx(expected, abs=1e-9)
    newest, stamp = map(float, (folder / "clock").read_text().split())
    assert stamp - 0.011 < newest <= stamp == pytest.approx(0.099, abs=0.0015)


def test_names_are_those_of_the_robot_or_declared_ones(folder: Path) -> None:
    simulated(folder, "names", duration=0.06)
    assert (folder / "names").read_text().split() == ["A1", "A2", "E1", "A3", "A4", "A5", "A6"]
    names = [f"joint_a{i}" for i in range(1, 8)]
    simulated(folder, "names", duration=0.06, joint_names=names)
    assert (folder / "names").read_text().split() == names


def test_positions_go_to_springs_of_the_robot(folder: Path) -> None:
    gains = {"interface": "position", "stiffness": 800.0, "damping": 40.0}
    by_robot = simulated(folder, "position", **gains).log.signals["lwr_joint_angles"]
    by_node = simulated(folder, "right").log.signals["lwr_joint_angles"]
    assert by_robot == pytest.approx(by_node, abs=1e-9)


@pytest.mark.parametrize(
    ("mode", "said"),
    [
        ("short", "to step 1 within 2 s"),
        ("nan", "to step 32 within 0.2 s"),
        ("silent", "to step 32 within 0.2 s"),
    ],
)
def test_commands_that_are_none_are_not_applied(folder: Path, mode: str, said: str) -> None:
    settings = {"patience": 0.2, "first_patience": 2.0 if mode == "short" else 10.0}
    with pytest.raises(SimulationError, match=f"/forward_effort_controller/commands {said}"):
        simulated(folder, mode, **settings)


def test_the_run_may_go_on_without_commands(folder: Path) -> None:
    settings = {"patience": 0.1, "on_silence": "hold"}
    ages = simulated(folder, "silent", **settings).log.signals["lwr_command_age"].ravel()
    assert ages[[31, 32, 40]] == pytest.approx([0.0, 0.001, 0.009])


def test_in_real_time_commands_come_within_their_step(folder: Path) -> None:
    ages = simulated(folder, "right", duration=0.3, clock="real_time").log.signals
    assert ages["lwr_command_age"][1:].min() == 0.0  # most, on a machine that is not busy


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"port": 9}, "port"),
        ({"joint_names": ["a"]}, "joint_names"),
        ({"interface": "position"}, "stiffness"),
        ({"domain": 300}, "domain"),
    ],
)
def test_wrong_declarations_name_their_key(
    folder: Path, settings: dict[str, Any], key: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        simulated(folder, "right", **settings)
    assert caught.value.problems[0].key == f"controllers.lwr.{key}"
