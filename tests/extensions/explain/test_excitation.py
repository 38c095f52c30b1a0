"""`identify --design`: motions within limits that excite all parameters of a robot."""

from __future__ import annotations

import csv
import importlib
import json
import re
import socket
import sys
from pathlib import Path
from typing import Any

import mujoco
import newton_euler
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from sero_mj.base.errors import UsageError
from sero_mj.cli import main
from sero_mj.extensions.explain import excitation
from sero_mj.extensions.explain.base_parameters import BaseParameters, standard_torques
from sero_mj.extensions.explain.clearance import Clearance
from sero_mj.extensions.explain.design_command import as_lines, summarize, write_motion
from sero_mj.extensions.explain.excitation import Excitation, FourierSeries, design_excitation
from sero_mj.extensions.explain.identify import identify
from sero_mj.extensions.explain.link_torques import body_torques, link_torques
from sero_mj.extensions.explain.motion_limits import MotionLimits
from sero_mj.robots.assemble.friction_torques import friction_of
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.assemble.world import World
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation

PERIOD, SHARE, CLEARANCE = 6.0, 0.8, 0.02
TIMES = np.arange(0.0, PERIOD + 5e-4, 1e-3)
# An arm with a revolute and a prismatic joint, and a joint that follows the first one.
ARM: dict[str, Any] = {
    "name": "arm",
    "dh_convention": "craig",
    "dh_params": [[0.0, 0.0, 0.0, 0.4], [-1.57, 0.0, 0.0, 0.6], [1.57, 0.3, 0.0, 0.0]],
    "joint_types": ["revolute", "prismatic", "revolute"],
    "joint_names": ["turn", "slide", "follow"],
    "couplings": {"follow": {"to": "turn", "ratio": -0.5, "offset": 0.1}},
    "position_limits": [[-2.0, 2.0], [-0.1, 0.3], [-2.0, 2.0]],
    "torque_limits": [20.0, 100.0, 20.0],
}


@pytest.fixture(scope="module")
def quick() -> Any:
    """Shortens the search."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(excitation, "_DRAWS", 40)
        patch.setattr(excitation, "_STARTS", 1)
        patch.setattr(excitation, "_EVALUATIONS", 5)
        yield


@pytest.fixture(scope="module")
def lwr(quick: None) -> Excitation:
    scene = Scene(robots=[SerialRobot.from_model("lwr")])
    return design_excitation(scene, "lwr", period=PERIOD, share=SHARE, clearance=CLEARANCE)


@pytest.fixture(scope="module")
def arm(quick: None) -> Excitation:
    scene = Scene(robots=[SerialRobot(**ARM)], floor=False)
    return design_excitation(scene, "arm", period=PERIOD, share=SHARE)


@pytest.fixture
def found(request: pytest.FixtureRequest) -> Excitation:
    result: Excitation = request.getfixturevalue(request.param)
    return result


BOTH = pytest.mark.parametrize("found", ["lwr", "arm"], indirect=True)


def test_series_starts_and_ends_at_rest() -> None:
    series = FourierSeries(PERIOD, 4)
    for values in series.at(np.array([0.0, PERIOD, 3.0 * PERIOD])):
        assert values.shape == (3, series.count)
        assert np.abs(values).max() < 1e-11
    step = 1e-5
    t = np.linspace(0.1, PERIOD, 50)
    (less, *_), (_, v, a), (more, speed, _) = (series.at(t + k * step) for k in (-1, 0, 1))
    np.testing.assert_allclose((more - less) / (2.0 * step), v, atol=1e-8)
    np.testing.assert_allclose((speed - series.at(t - step)[1]) / (2.0 * step), a, atol=1e-7)
    assert np.linalg.matrix_rank(series.at(t)[0]) == series.count
    # No higher frequencies: the coefficients of a Fourier transform are zero.
    spectrum = np.abs(np.fft.rfft(series.at(np.arange(64) * PERIOD / 64)[0], axis=0))
    assert spectrum[5:].max() < 1e-10 < spectrum[4].min()


@BOTH
def test_limits_hold_between_the_rows_of_the_search(found: Excitation) -> None:
    robot, motion = found.regressor.robot, found.motion(TIMES)
    free = robot.coupled.independent
    low, high = robot.display_ranges.T
    middle, half = 0.5 * (low + high)[free], 0.5 * (high - low)[free]
    assert (np.abs(motion.angles[:, free] - middle) <= SHARE * half * 1.001).all()
    velocities = np.gradient(motion.angles, TIMES, axis=0)
    np.testing.assert_allclose(velocities[1:-1], motion.velocities[1:-1], atol=1e-3)
    speeds = np.full(robot.n, 1.5) if robot.velocity_limits is None else robot.velocity_limits
    speeds = np.where(robot.kinematics.revolute, speeds, 0.5)
    assert (np.abs(velocities[:, free]) <= SHARE * speeds[free] * 1.002).all()
    torques = found.torques(TIMES) @ found.limits.coupling
    assert (np.abs(torques) <= SHARE * robot.torque_bounds[free] * 1.001).all()
    for ends in (0, -1):
        np.testing.assert_allclose(motion.angles[ends, free], found.start, atol=1e-9)
        assert np.abs(motion.velocities[ends]).max() < 1e-9
        assert np.abs(motion.accelerations[ends]).max() < 1e-9
    used = found.used(TIMES)
    assert max(used["velocity"].max(), used["position"].max()) > 0.8  # the bounds are used


def test_coupled_joints_follow(arm: Excitation) -> None:
    motion = arm.motion(TIMES)
    np.testing.assert_allclose(motion.angles[:, 2], 0.1 - 0.5 * motion.angles[:, 0], atol=1e-12)
    assert arm.limits.names == ["turn", "slide"]
    # Virtual work: the torque of the driving joint is the slope of the work of all joints.
    torques = arm.torques(TIMES)
    np.testing.assert_allclose(
        (torques @ arm.limits.coupling)[:, 0], torques[:, 0] - 0.5 * torques[:, 2]
    )


def test_torques_are_those_of_inverse_dynamics(lwr: Excitation) -> None:
    robot, motion = lwr.regressor.robot, lwr.motion(TIMES)
    known = robot_dynamics(robot)
    rows = slice(0, None, 500)
    for q, v, a, torques in zip(
        motion.angles[rows], motion.velocities[rows], motion.accelerations[rows],
        lwr.torques(TIMES)[rows], strict=True,
    ):  # fmt: skip
        links = newton_euler.inverse_dynamics(robot, known, q, v, a)
        expected = links + known.motor_inertias * a + friction_of(robot, v)
        np.testing.assert_allclose(torques, expected, atol=2e-3)


def test_robot_touches_neither_itself_nor_the_floor(lwr: Excitation) -> None:
    world = World(Scene(robots=[lwr.regressor.robot]), dynamic=True)
    model, data = world.model, world.make_data()
    model.geom_margin[:] = 0.5 * CLEARANCE
    distances = []
    angles = lwr.motion(TIMES).angles
    for pose in angles[::2]:
        data.qpos[world.robots["lwr"].qpos] = pose
        mujoco.mj_forward(model, data)
        distances += data.contact.dist.tolist()
    assert min(distances, default=1.0) > 0.75 * CLEARANCE
    least, between, row = lwr.clearance.nearest(angles[::20])
    data.qpos[world.robots["lwr"].qpos] = angles[::20][row]
    mujoco.mj_forward(model, data)
    names = [name if "/" in name else "world" for name in between.split(" and ")]
    groups = [
        [g for g in range(model.ngeom) if model.body(model.geom_bodyid[g]).name == name
         and (model.geom_contype | model.geom_conaffinity)[g]]
        for name in names
    ]  # fmt: skip
    exact = min(
        mujoco.mj_geomDistance(model, data, one, other, 2.0, None)
        for one in groups[0] for other in groups[1]
    )  # fmt: skip
    assert least == pytest.approx(exact, abs=2e-3)


def test_torques_of_a_mounted_robot_are_those_of_its_pose(quick: None) -> None:
    # A robot that lies on its side: the first joint moves about a horizontal axis.
    bare = {**ARM, "collisions": [], "torque_limits": None}
    below = SerialRobot(**{**bare, "name": "below", "base_frame": {"rpy": [0.0, np.pi / 2, 0.0]}})
    above = SerialRobot(**{**bare, "mount": "below/base"})
    alone = SerialRobot(**{**bare, "base_frame": below.base_frame})
    mounted, other = (
        design_excitation(Scene(robots=robots, floor=False), "arm", period=PERIOD)
        for robots in ([below, above], [alone])
    )
    np.testing.assert_allclose(
        mounted.regressor.at(*other.independent(TIMES))[1], other.torques(TIMES), atol=1e-9
    )
    carrying = design_excitation(Scene(robots=[below, above], floor=False), "below", period=PERIOD)
    assert "torques do not include the loads arm" in carrying.limits.notes


def test_floor_limits_the_motion(quick: None) -> None:
    robot = SerialRobot.from_model("lwr", joint_angles=np.deg2rad([0, 95, 0, 20, 0, 0, 0]))
    found = design_excitation(Scene(robots=[robot]), "lwr", period=PERIOD, clearance=0.05)
    heights = robot.base_frame @ robot.fwd_kin_base_to_flange(found.motion(TIMES).angles)
    assert heights[:, 2, 3].min() > 0.0
    assert not found.exceeded()
    far = Excitation(found.regressor, found.limits, found.clearance, found.series, found.start,
                     -3.0 * found.coefficients)  # fmt: skip
    assert far.exceeded() in ("position", "velocity", "torque")


@BOTH
def test_condition_number_is_far_below_that_of_a_chirp(found: Excitation) -> None:
    number, count = found.condition()
    assert found.chirp_condition() > 5.0 * number
    columns, _ = found.regressor.at(*found.independent(TIMES))
    scale = 1.0 / np.where(np.isfinite(found.limits.torques), found.limits.torques, 1.0)
    X = (columns * scale[:, None]).reshape(-1, columns.shape[2])
    X = X[:, np.linalg.norm(X, axis=0) > 1e-9]
    X /= np.linalg.norm(X, axis=0)
    assert np.linalg.matrix_rank(X, 1e-5) == count
    if X.shape[1] == count:
        assert number == pytest.approx(np.linalg.cond(X), rel=0.01)


def test_search_reduces_the_condition_number_and_depends_on_the_seed_only(arm: Excitation) -> None:
    scene = Scene(robots=[SerialRobot(**ARM)], floor=False)
    again = design_excitation(scene, "arm", period=PERIOD, share=SHARE)
    other = design_excitation(scene, "arm", period=PERIOD, share=SHARE, seed=1)
    assert np.array_equal(again.coefficients, arm.coefficients)
    assert not np.allclose(other.coefficients, arm.coefficients)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(excitation, "_EVALUATIONS", 25)
        longer = design_excitation(scene, "arm", period=PERIOD, share=SHARE)
    assert longer.condition()[0] < arm.condition()[0]


def test_missing_limits_are_reported() -> None:
    bare = SerialRobot(**{**ARM, "torque_limits": None, "position_limits": None})
    assert MotionLimits.of(bare, 0.5).notes == [
        "turn, slide: no position limits are declared; ±180 deg or ±1 m is assumed",
        "turn, slide: no velocity limits are declared; 1.5 rad/s or 0.5 m/s is assumed",
        "turn, slide: no torque limits are declared, so torques are not bounded",
        "no masses are declared; torques are those of estimated masses",
    ]
    assert MotionLimits.of(SerialRobot.from_model("lwr"), 0.5).notes == []


@pytest.mark.parametrize(
    ("fields", "options", "expected"),
    [
        ({"free_base": True}, {}, "the base of 'arm' moves freely"),
        ({}, {"start": np.zeros(4)}, "--start: found 4 values; expected 2, one per independent"),
        ({}, {"start": np.array([1.9, 0.0])}, "--start, turn: found 1.9; expected -1.6 to 1.6"),
        ({"torque_limits": [1e-3, 1e-3, 1e-3]}, {}, "about its start exceeds the bounds: torque"),
    ],
)
def test_impossible_motions_are_reported(
    quick: None, fields: dict[str, Any], options: dict[str, Any], expected: str
) -> None:
    scene = Scene(robots=[SerialRobot(**{**ARM, **fields})], floor=False)
    with pytest.raises(UsageError, match=re.escape(expected)):
        design_excitation(scene, "arm", **options)


def test_collision_at_the_start_is_reported_and_permanent_overlap_is_not() -> None:
    robot = SerialRobot.from_model("lwr")
    down = np.deg2rad([0.0, 118.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    poses = np.random.default_rng(0).uniform(-1.0, 1.0, (40, 7))
    with pytest.raises(UsageError, match=r"touch at the start of the motion of 'lwr'. .*--start"):
        Clearance(Scene(robots=[robot]), "lwr", 0.02, down, poses)
    # If it touches in all poses, as overlapping shapes do, it is ignored.
    Clearance(Scene(robots=[robot]), "lwr", 0.02, down, np.tile(down, (40, 1)))


def test_links_without_collision_shapes_are_reported() -> None:
    robot, start = SerialRobot(**ARM, collisions=[]), np.zeros(3)
    space = Clearance(Scene(robots=[robot]), "arm", 0.02, start, start[None])
    text = "no collision shapes are declared, so distances are not checked"
    assert space.notes == [f"arm/link1, arm/link2, arm/link3: {text}"]
    assert np.isinf(space.nearest(start[None])[0])
    robot = SerialRobot.from_model("lwr")
    start = np.zeros(7)
    assert Clearance(Scene(robots=[robot]), "lwr", 0.02, start, start[None]).notes == []


LOAD, AT = 2.0, np.array([0.02, 0.03, 0.08])
SCENARIO = f"""
[robots.lwr]
model = "lwr"
[run]
duration = {PERIOD}
timestep = 0.002
[controllers.lwr]
kind = "joint_impedance"
stiffness = 1500
[sensors.lwr]
angles.resolution = 1e-5
torques.noise = 0.1
[disturbances.load]
kind = "payload"
robot = "lwr"
mass = {LOAD}
center_of_mass = {AT.tolist()}
[targets.lwr]
"""


def simulated(folder: Path, target: str) -> RunLog:
    """Returns a run of an LWR that carries a load and follows a target."""
    (folder / "run.toml").write_text(SCENARIO + target, encoding="utf-8")
    simulation = Simulation(read_scenario(folder / "run.toml"))
    for _ in simulation.run():
        pass
    return simulation.log


def error_of_base_parameters(log: RunLog) -> float:
    """Returns the rms error of the torques that base parameters fitted to a run predict, Nm.

    The base parameters are fitted by least squares, and predict the torques of random motions.
    """
    robot, step = SerialRobot.from_model("lwr"), float(np.diff(log.times).mean())
    angles, torques = log.of("lwr", "joint_angles"), log.of("lwr", "torques")
    q, smooth = (gaussian_filter1d(each, 8, axis=0) for each in (angles, torques))
    v = np.gradient(q, step, axis=0)
    a = np.gradient(v, step, axis=0)
    rows, base = slice(50, -50, 4), BaseParameters.of(robot)
    columns = base.columns(standard_torques(robot, q[rows], v[rows], a[rows]))
    values = np.linalg.lstsq(columns.reshape(-1, len(base)), smooth[rows].ravel(), rcond=None)[0]
    q, v, a = np.random.default_rng(0).uniform(-1.5, 1.5, (3, 200, robot.n))
    predicted = base.columns(standard_torques(robot, q, v, a)) @ values
    tensor = LOAD * (AT @ AT * np.eye(3) - np.outer(AT, AT))
    entries = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    load = body_torques(robot, q, v, a) @ np.concatenate([[LOAD], LOAD * AT, entries])
    return float(np.sqrt(np.mean((predicted - link_torques(robot, q, v, a) - load) ** 2)))


def test_table_can_be_simulated_and_gives_better_estimates_than_a_chirp(
    lwr: Excitation, tmp_path: Path
) -> None:
    write_motion(lwr, tmp_path / "excite.csv", rate=200.0)
    log = simulated(tmp_path, 'kind = "recorded"\nfile = "excite.csv"')
    tracked = log.of("lwr", "joint_angles") - lwr.motion(log.times).angles
    assert np.abs(tracked).max() < 0.1  # the controller follows the motion
    other = simulated(tmp_path, chirp_within_the_same_limits())
    mine, its = identify(log, "lwr"), identify(other, "lwr")
    assert mine.mass.value == pytest.approx(LOAD, abs=0.01)
    for one, another in zip((mine.mass, *mine.center), (its.mass, *its.center), strict=True):
        assert one.error is not None and another.error is not None
    assert sum(each.error or 0.0 for each in mine.center) < 0.5 * sum(
        each.error or 0.0 for each in its.center
    )
    assert error_of_base_parameters(log) < 0.1 * error_of_base_parameters(other)


def chirp_within_the_same_limits() -> str:
    robot = SerialRobot.from_model("lwr")
    assert robot.position_limits is not None and robot.velocity_limits is not None
    fastest = 5.0 / PERIOD
    amplitude = np.minimum(
        SHARE * robot.position_limits[:, 1], SHARE * robot.velocity_limits / (2 * np.pi * fastest)
    )
    return (
        f'kind = "chirp"\namplitude = {amplitude.tolist()}\nstart_frequency = {1.0 / PERIOD}\n'
        f"end_frequency = {fastest}\nduration = {PERIOD}"
    )


def test_table_can_be_sent(lwr: Excitation, tmp_path: Path) -> None:
    table = tmp_path / "excite.csv"
    write_motion(lwr, table, rate=50.0, periods=2)
    with table.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == round(2 * PERIOD * 50) + 1
    sent = lwr.motion(np.array([float(row["time"]) for row in rows]))
    names = lwr.limits.names
    for signal, expected in (
        ("joint_angles", sent.angles),
        ("joint_velocities", sent.velocities),
        ("torques", lwr.torques(sent.times)),
    ):
        written = [[float(row[f"{signal}[{name}]"]) for name in names] for row in rows]
        np.testing.assert_allclose(written, expected, atol=1e-8)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2**21)
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(5.0)
        port = receiver.getsockname()[1]
        assert command("send", "lwr", "--play", table, "--port", port, "--speed", 20) == 0
        packets = np.array([np.frombuffer(receiver.recv(2000), "<f8") for _ in rows])
    np.testing.assert_allclose(packets[:, :7], sent.angles, atol=1e-6)
    np.testing.assert_allclose(packets[:, 7:], lwr.torques(sent.times), atol=1e-4)


def test_command_writes_table_figure_and_summary(
    quick: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "cell.toml").write_text(
        '[robots.one]\nmodel = "scara"\n[robots.two]\nmodel = "scara"\n'
        "base_frame = { xyz = [1.5, 0.0, 0.0] }\n",
        encoding="utf-8",
    )
    table, figure = tmp_path / "excite.csv", tmp_path / "excite.svg"
    cell = ("--design", "--scene", tmp_path / "cell.toml", "--period", 4, "--rate", 100)
    out = ("-o", table, "--plot", figure, "--json")
    assert command("identify", *cell, "--robot", "two", *out) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["robot"] == "two" and summary["duration"] == 4.0
    assert summary["velocity"]["share"] <= 0.8001
    assert summary["torque"] is None  # a SCARA without torque limits
    assert len(table.read_text(encoding="utf-8").splitlines()) == 402
    assert "two: motion for identification" in figure.read_text(encoding="utf-8")
    assert command("identify", *cell) == 2
    assert "has several robots; expected one of one, two" in capsys.readouterr().err


def test_summary_names_joints_limits_and_notes(arm: Excitation) -> None:
    summary = summarize(arm, periods=3)
    first, second, *lines = as_lines(summary)
    assert first == "arm: 18 s, moves turn, slide, and with them follow"
    assert second.startswith(f"condition number: {arm.condition()[0]:.3g} for ")
    used = arm.used(TIMES)["velocity"]
    joint = ["turn", "slide"][int(used.max(axis=0).argmax())]
    assert f"velocity: at most {SHARE * used.max():.0%} of the limit ({joint} at " in "\n".join(
        lines
    )
    assert sum(line.startswith("note: ") for line in lines) == len(summary["notes"]) >= 2


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([], "expected a recording, or --design"),
        (["run.mcap", "--period", "5"], "--period needs --design"),
        (
            ["run.mcap", "-o", "x.csv"],
            "--output: found 'x.csv'; expected a name that ends in .toml",
        ),
        (["--design"], "--design: expected --robot or --scene"),
        (["--design", "run.mcap", "--robot", "lwr"], "RUN.mcap cannot be combined with --design"),
        (["--design", "--robot", "lwr", "-o", "x.toml"], "expected a name that ends in .csv"),
        (["--design", "--robot", "lwr", "--share", "1.5"], "expected a share between 0 and 1"),
        (["--design", "--robot", "lwr", "--start", "1,2"], "--start: found 2 values; expected 7"),
    ],
)
def test_invalid_arguments_are_rejected(
    capsys: pytest.CaptureFixture[str], arguments: list[str], expected: str
) -> None:
    assert command("identify", *arguments) == 2
    assert expected in capsys.readouterr().err


def test_missing_scipy_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, excitation.__name__)
    monkeypatch.setitem(sys.modules, "scipy.optimize", None)
    with pytest.raises(UsageError, match=r"pip install 'sero-mj\[identify\]'"):
        importlib.import_module(excitation.__name__)


def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(each) for each in arguments])
    return int(ended.value.code or 0)
