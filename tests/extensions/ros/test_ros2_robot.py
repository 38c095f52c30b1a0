"""Kind `ros2` of controllers: nodes in other processes hold a simulated robot by topics."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from ros_tools import free_domain
from scipy.interpolate import BPoly

from sero_mj.base.errors import DeclarationError, SimulationError
from sero_mj.extensions.ros.joint_trajectory import JointTrajectory
from sero_mj.extensions.ros.messages import MalformedMessage
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
sys.path.insert(0, {str(ROOT / "tests")!r})
from ros2_peer import *
from cyclonedds.sub import DataReader

@dataclass
@final
class Clock(IdlStruct, typename="rosgraph_msgs::msg::dds_::Clock_"):
    clock: Time

@dataclass
@final
class Duration(IdlStruct, typename="builtin_interfaces::msg::dds_::Duration_"):
    sec: int32
    nanosec: uint32

@dataclass
@final
class Point(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectoryPoint_"):
    positions: sequence[float64]
    velocities: sequence[float64]
    accelerations: sequence[float64]
    effort: sequence[float64]
    time_from_start: Duration

@dataclass
@final
class JointTrajectory(IdlStruct, typename="trajectory_msgs::msg::dds_::JointTrajectory_"):
    header: Header
    joint_names: sequence[str]
    points: sequence[Point]

mode, number = sys.argv[1], int(os.environ["ROS_DOMAIN_ID"])
domain = Domain(number, LOOPBACK)
participant = DomainParticipant(number)
reliable = Policy.Reliability.Reliable(duration(seconds=1))
qos = Qos(reliable, Policy.History.KeepLast(1))
states = DataReader(participant, Topic(participant, "rt/joint_states", JointState), qos=qos)
clocks = DataReader(participant, Topic(participant, "rt/clock", Clock), qos=qos)
controller = "position" if mode == "position" else "effort"
topic = f"rt/forward_{{controller}}_controller/commands"
commands = DataWriter(participant, Topic(participant, topic, Float64MultiArray), qos=qos)
home = [0, 0.6, 0, -1.2, 0, 1.2, 0]
newest = None
if mode == "trajectory":
    commands = DataWriter(participant, Topic(
        participant, "rt/joint_trajectory_controller/joint_trajectory", JointTrajectory), qos=qos)
    state = next(states.take_iter(timeout=20 * 10**9))
    names = list(reversed(state.name))
    zero = Duration(0, 0)
    header = Header(Time(0, 0), "")
    def point(angle, velocity, ms):
        angles = [each + angle for each in reversed(home)]
        return Point(angles, [velocity] * 7, [], [], Duration(0, ms * 1_000_000))
    commands.write(JointTrajectory(header, names[1:], [point(0.0, 0.0, 40)]))  # without one joint
    commands.write(JointTrajectory(header, names, [point(0.01, 0.4, 40), point(0.02, 0.0, 80)]))
    time.sleep(20)
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


def test_node_holds_the_robot_in_lockstep(folder: Path) -> None:
    simulation = simulated(folder, "clock")
    signals = simulation.log.signals
    assert not signals["lwr_command_age"].any()
    for k in (10, 60, 100):
        q, v = signals["lwr_joint_angles"][k - 1], signals["lwr_joint_velocities"][k - 1]
        expected = 800.0 * (np.array([0, 0.6, 0, -1.2, 0, 1.2, 0]) - q) - 40.0 * v
        assert signals["lwr_commanded_torques"][k] == pytest.approx(expected, abs=1e-9)
    newest, stamp = map(float, (folder / "clock").read_text().split())
    assert stamp - 0.011 < newest <= stamp == pytest.approx(0.099, abs=0.0015)


@pytest.mark.thorough
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


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("mode", "said"),
    [
        ("short", "to step 1 within 2 s"),
        ("nan", "to step 32 within 0.2 s"),
        ("silent", "to step 32 within 0.2 s"),
    ],
)
def test_invalid_commands_are_not_applied(folder: Path, mode: str, said: str) -> None:
    settings = {"patience": 0.2, "first_patience": 2.0 if mode == "short" else 10.0}
    with pytest.raises(SimulationError, match=f"/forward_effort_controller/commands {said}"):
        simulated(folder, mode, **settings)


@pytest.mark.thorough
def test_run_can_continue_without_commands(folder: Path) -> None:
    settings = {"patience": 0.1, "on_silence": "hold"}
    ages = simulated(folder, "silent", **settings).log.signals["lwr_command_age"].ravel()
    assert ages[[31, 32, 40]] == pytest.approx([0.0, 0.001, 0.009])


def test_real_time_commands_arrive_within_their_step(folder: Path) -> None:
    ages = simulated(folder, "right", duration=0.3, clock="real_time").log.signals
    assert ages["lwr_command_age"][1:].min() == 0.0  # most, on a machine that is not busy


@pytest.mark.parametrize("mode", ["lockstep", "real_time"])
def test_trajectory_is_followed(folder: Path, mode: str, caplog: pytest.LogCaptureFixture) -> None:
    settings = {"interface": "trajectory", "stiffness": 4000.0, "damping": 60.0, "clock": mode}
    signals = simulated(folder, "trajectory", duration=0.15, **settings).log.signals
    assert "joint_names lacks A6" in caplog.text
    times, target = signals["time"].ravel(), signals["lwr_target_angles"]
    home = np.array([0, 0.6, 0, -1.2, 0, 1.2, 0])
    spline = BPoly.from_derivatives([0.0, 0.04, 0.08], [[0.0, 0.0], [0.01, 0.4], [0.02, 0.0]])
    expected = spline(np.minimum(times, 0.08))[:, None] + home
    assert target[1:] == pytest.approx(expected[:-1], abs=1e-9)  # a row has its step's command
    assert signals["lwr_joint_angles"][-1] == pytest.approx(expected[-1], abs=0.015)  # was pushed


def trajectory(*points: dict[str, Any], names: str = "ab", stamp: float = 0.0) -> Any:
    """A message for joints of one letter."""
    whole = SimpleNamespace(sec=int(stamp), nanosec=round(stamp % 1 * 1e9))
    empty: dict[str, list[float]] = {
        key: [] for key in ("positions", "velocities", "accelerations", "effort")
    }
    return SimpleNamespace(
        header=SimpleNamespace(stamp=whole),
        joint_names=list(names),
        points=[SimpleNamespace(**empty | point) for point in points],
    )


def point(seconds: float, **values: list[float]) -> dict[str, Any]:
    time = SimpleNamespace(sec=int(seconds), nanosec=round(seconds % 1 * 1e9))
    return {"time_from_start": time, **values}


REST = np.zeros((2, 2))


@pytest.mark.parametrize("keys", [1, 2, 3])
def test_trajectory_between_points_is_the_polynomial_of_their_derivatives(keys: int) -> None:
    values = np.random.default_rng(keys).normal(size=(3, keys, 2))
    names = ("positions", "velocities", "accelerations")
    points = [
        point(t, **dict(zip(names, rows.tolist(), strict=False)))
        for t, rows in zip((0.5, 0.7, 2.0), values, strict=True)
    ]
    motion = JointTrajectory(trajectory(*points, names="ba"), ["a", "b"], 3.0, REST)
    rows = np.concatenate((np.zeros((1, keys, 2)), values[:, :, ::-1]))
    spline = BPoly.from_derivatives([3.0, 3.5, 3.7, 5.0], rows)
    for t in (3.0, 3.2, 3.6, 4.4):
        angles, velocities, efforts = motion.at(t)
        assert angles == pytest.approx(spline(t), abs=1e-12)
        assert velocities == pytest.approx(spline.derivative()(t), abs=1e-11)
        assert not efforts.any()
    assert motion.at(9.0)[0] == pytest.approx(rows[-1, 0])
    assert not motion.at(9.0)[1].any()


def test_stamp_sets_the_start_and_past_points_are_skipped() -> None:
    points = [point(t, positions=[t, -t], effort=[1.0, 2.0]) for t in (1.0, 2.0, 3.0)]
    motion = JointTrajectory(trajectory(*points, stamp=10.0), ["a", "b"], 11.5, REST)
    assert motion.at(11.75)[0] == pytest.approx([1.0, -1.0])  # from the entry to the second point
    assert motion.at(12.5)[0] == pytest.approx([2.5, -2.5])
    assert motion.at(11.5)[2].tolist() == [1.0, 2.0]
    at_once = JointTrajectory(trajectory(point(0.0, positions=[4, 5])), ["a", "b"], 7.0, REST)
    assert at_once.at(7.0)[0].tolist() == [4.0, 5.0]


@pytest.mark.parametrize(
    ("message", "key"),
    [
        (trajectory(point(1, positions=[0, 0]), names="ac"), "joint_names"),
        (trajectory(point(1, positions=[0, 0]), names="aa"), "joint_names"),
        (trajectory(point(1, positions=[0]), names="a"), "joint_names"),
        (trajectory(), "points"),
        (trajectory(point(1, velocities=[0, 0])), "positions"),
        (trajectory(point(1, positions=[0])), "points[0].positions"),
        (trajectory(point(1, positions=[0, 0]), point(2)), "points[1].positions"),
        (trajectory(point(1, positions=[0, np.nan])), "points[0].positions"),
        (trajectory(point(1, positions=[0, 0]), point(1, positions=[0, 0])), "time_from_start"),
        (trajectory(point(1, positions=[0, 0]), stamp=2.0), "header.stamp"),
    ],
)
def test_invalid_trajectories_are_rejected(message: Any, key: str) -> None:
    with pytest.raises(MalformedMessage, match=f"^{re.escape(key)}: "):
        JointTrajectory(message, ["a", "b"], 9.0, REST)


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
