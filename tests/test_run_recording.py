from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with
from mcap.writer import Writer
from newton_euler import inverse_dynamics
from recordings import signals_in
from runs import HOME, in_old_words, record_packets, record_run, simulated

from sero_mj.base.errors import CsvError, RecordingError, UsageError
from sero_mj.cli import main
from sero_mj.cli.arguments import replay_instead
from sero_mj.data.drive.mirror import Mirror
from sero_mj.data.record.recording import Recording
from sero_mj.data.record.recording_writer import FLUSH_AFTER
from sero_mj.load import load_scene
from sero_mj.robots.assemble.robot_dynamics import robot_dynamics
from sero_mj.robots.declared.robot import SerialRobot
from sero_mj.robots.declared.scene import Scene
from sero_mj.robots.declared.scene_file import read_scene_file
from sero_mj.simulate.log_output import RunRecorder
from sero_mj.simulate.runs.recorded_signals import spread_bunches
from sero_mj.simulate.runs.run_csv import write_run_csv
from sero_mj.simulate.runs.run_log import event_of
from sero_mj.simulate.runs.run_recording import read_run
from sero_mj.simulate.runs.tables import find_tables
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulated_scene import SOURCE, simulated_scene
from sero_mj.simulate.simulation import Simulation

# Degrees and mNm; outputs of robots are used by others.
SCENE = """\
[robots.left]
model = "lwr"
joint_angles = [0, 0, 0, 0, 0, 0, 0]
torque_limits = [1, 2, 3, 4, 5, 6, 7]

[robots.right]
model = "lwr"
base_frame = { xyz = [0.0, 1.0, 0.0] }

[doubles.goal]
of = "left"

[sources.udp]
kind = "udp"
port = 31999
structure = "7F14F7F"

[routes]
"left.joint_angles" = "udp.values0 * deg"
"left.torques" = "udp.values1[0:7] * mNm"
"left.commanded_torques" = "left.torques + udp.values1[7:14]"
"goal.joint_angles" = "-udp.values2"
"right.joint_angles" = "0.5 * left.joint_angles"
"left.show_arrows" = "udp.receiving"
"right.base_frame" = "left/flange"
"""


@pytest.fixture
def mirrored(tmp_path: Path) -> tuple[Path, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.001, 0.004, 60))
    numbers = np.cumsum(rng.normal(size=(60, 28)), axis=0)
    numbers[20, 9] = np.nan  # a missing torque
    path = tmp_path / "real.mcap"
    rows = {"values0": numbers[:, :7], "values1": numbers[:, 7:21], "values2": numbers[:, 21:]}
    record_packets(path, "7F14F7F", rows, times, {"scenes/mine.toml": SCENE})
    return path, times, numbers


def test_recorded_simulation_equals_its_run(tmp_path: Path) -> None:
    simulation = simulated()
    found = read_run(record_run(simulation, tmp_path / "swing.mcap"))
    log = simulation.log
    assert found.name == "swing"
    assert list(found.robots) == ["lwr"]
    assert found.robots["lwr"].names == log.robots["lwr"].names
    np.testing.assert_array_equal(found.times, log.times)
    assert set(found.signals) == set(log.signals)
    for event, values in log.signals.items():
        if event != "time":
            np.testing.assert_array_equal(found.signals[event], values, err_msg=event)


def test_nan_in_a_simulation_is_recorded(tmp_path: Path) -> None:
    simulation = simulated()
    saved = simulation.rows[100].copy()
    column = simulation.layout.columns["lwr_torques"].start
    simulation.rows[100, column] = np.nan
    try:
        found = read_run(record_run(simulation, tmp_path / "swing.mcap"))
    finally:
        simulation.rows[100] = saved
    assert np.isnan(found.of("lwr", "torques")[100, 0])
    assert np.isfinite(found.of("lwr", "torques")[101:]).all()


def test_recorded_robot_is_read_through_its_routes(
    mirrored: tuple[Path, np.ndarray, np.ndarray],
) -> None:
    path, times, numbers = mirrored
    run = read_run(path)
    np.testing.assert_allclose(run.times, times - times[0], atol=1e-8)
    left = np.deg2rad(numbers[:, :7])
    np.testing.assert_allclose(run.of("left", "joint_angles"), left, rtol=1e-12)
    np.testing.assert_allclose(run.of("left", "torques"), numbers[:, 7:14] * 1e-3, rtol=1e-12)
    commanded = numbers[:, 7:14] * 1e-3 + numbers[:, 14:21]
    np.testing.assert_allclose(run.of("left", "commanded_torques"), commanded, rtol=1e-12)
    np.testing.assert_allclose(run.of("left", "target_angles"), -numbers[:, 21:], rtol=1e-12)
    np.testing.assert_allclose(run.of("right", "joint_angles"), 0.5 * left, rtol=1e-12)
    assert not run.has("right", "torques")
    np.testing.assert_array_equal(run.torque_limits("left"), np.arange(1.0, 8.0))
    assert np.isnan(run.of("left", "torques")[20, 2])


def test_recorded_run_equals_the_mirror(
    mirrored: tuple[Path, np.ndarray, np.ndarray], tmp_path: Path
) -> None:
    """The second computation: the recording is played through the mirror, packet by packet."""
    path, times, _ = mirrored
    file = tmp_path / "mine.toml"
    file.write_text(SCENE)
    scene = load_scene(file)
    scene.sources["udp"] = {"kind": "replay", "file": str(path)}
    run = read_run(path)
    with Mirror(scene) as mirror:
        world, data = mirror.world, mirror.data
        for k in (0, 7, 31, 59):
            mirror.advance(times[k] - times[0] + 1e-5)
            for robot in ("left", "right"):
                qpos = data.qpos[world.robots[robot].qpos]
                np.testing.assert_allclose(run.of(robot, "joint_angles")[k], qpos, rtol=1e-12)
            for key in ("torques", "commanded_torques"):
                shown = data.userdata[world.slots[f"left.{key}"]]
                np.testing.assert_allclose(run.of("left", key)[k], shown, rtol=1e-12)


def test_missing_velocities_are_differences(
    mirrored: tuple[Path, np.ndarray, np.ndarray],
) -> None:
    path, _, numbers = mirrored
    run = read_run(path)
    before, after = run.times[10] - run.times[9], run.times[11] - run.times[10]
    left = np.deg2rad(numbers[:, :7])
    # The slope in the middle of the parabola through three points.
    slope = (
        (left[11] - left[10]) / after * before + (left[10] - left[9]) / before * after
    ) / (before + after)  # fmt: skip
    np.testing.assert_allclose(run.of("left", "joint_velocities")[10], slope, rtol=1e-6)


def test_model_torques_are_computed_over_time(
    mirrored: tuple[Path, np.ndarray, np.ndarray],
) -> None:
    path, times, numbers = mirrored
    scene = SCENE.replace(
        '"udp.values1[0:7] * mNm"',
        '"udp.values1[0:7] * mNm - left.gravity_torques - left.friction_torques"',
    )
    rows = {"values0": numbers[:, :7], "values1": numbers[:, 7:21], "values2": numbers[:, 21:]}
    path = path.with_name("modelled.mcap")
    run = read_run(record_packets(path, "7F14F7F", rows, times, {"scenes/mine.toml": scene}))
    robot = run.robots["left"]
    weight = np.array(
        [inverse_dynamics(robot, robot_dynamics(robot), np.deg2rad(row)) for row in numbers[:, :7]]
    )
    speeds = run.of("left", "joint_velocities")
    signs = np.clip(speeds / 0.01, -1.0, 1.0)
    friction = robot.dynamics.viscous_friction * speeds + robot.dynamics.coulomb_friction * signs
    expected = numbers[:, 7:14] * 1e-3 - weight - friction
    np.testing.assert_allclose(run.of("left", "torques"), expected, atol=1e-6)


def test_robots_and_routes_can_be_passed(tmp_path: Path) -> None:
    times, angles = np.arange(5) * 0.01, np.arange(35.0).reshape(5, 7)
    path = record_packets(tmp_path / "bare.mcap", "7F", {"values0": angles}, times, {})
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/bare.mcap",
        reason="has no robot: found no files; pass a scene",
    ):
        read_run(path)
    file = tmp_path / "mine.toml"
    file.write_text(
        '[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\nstructure = "7F"\n'
        '[routes]\n"lwr.joint_angles" = "udp.values0"\n'
    )
    scene, problems = read_scene_file(file)
    assert not problems
    run = read_run(path, scene=scene)
    np.testing.assert_array_equal(run.of("lwr", "joint_angles"), angles)


def test_recorded_simulation_without_its_robot_requires_a_scene(tmp_path: Path) -> None:
    path = record_run(simulated(), tmp_path / "alone.mcap", attach=False)
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/alone.mcap",
        reason="does not describe robot 'lwr'; none is available; pass a scene",
    ):
        read_run(path)
    assert read_run(path, scene=simulated().scenario.scene).robots["lwr"].n == 7
    other = Scene(robots=[SerialRobot.from_model("scara", name="picker")], name="cell")
    reason = "has a robot that is not in the scene 'cell': no robot 'lwr'; available: picker"
    with raises_with(RecordingError, path=f"{tmp_path}/alone.mcap", reason=reason):
        read_run(path, scene=other)


def test_robots_with_other_joints_are_rejected(tmp_path: Path) -> None:
    times, rows = np.arange(3) * 0.01, {"time": np.arange(3)[:, None] * 0.01,
                                        "lwr_angles": np.zeros((3, 6))}  # fmt: skip
    files = {"x/mine.toml": '[robots.lwr]\nmodel = "lwr"\n'}
    path = record_packets(tmp_path / "six.mcap", "time:1F lwr_angles:6F", rows, times, files)
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/six.mcap",
        reason="lwr_joint_angles are 6; its robot 'lwr' has 7 joints",
    ):
        read_run(path)


def test_invalid_recordings_are_reported(
    tmp_path: Path, mirrored: tuple[Path, object, object]
) -> None:
    path = mirrored[0]
    with raises_with(
        UsageError, reason="no source", found="udq", of=f"in {tmp_path}/real.mcap", near="udp"
    ):
        read_run(path, "udq")
    text = tmp_path / "text.mcap"
    text.write_text("time,angle\n")
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/text.mcap",
        reason=(
            "is not an MCAP file: it begins with b'time,ang'; expected a file from sero-mj record"
        ),
    ):
        read_run(text)
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/missing.mcap",
        reason="cannot be read: No such file or directory",
    ):
        read_run(tmp_path / "missing.mcap")
    foreign = tmp_path / "foreign.mcap"
    with open(foreign, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("s", "jsonschema", b"{}")
        channel = writer.register_channel("/camera", "json", schema)
        writer.add_message(channel, 0, b"{}", 0)
        writer.finish()
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/foreign.mcap",
        reason=(
            "has the topics /camera (JSON: found the keys none; expected name, position, "
            "velocity and effort, or joints); expected one of sensor_msgs/msg/JointState or "
            "nav_msgs/msg/Odometry, or /tf"
        ),
    ):
        read_run(foreign)


def test_recording_that_moves_no_robot_is_reported(tmp_path: Path) -> None:
    scene = ('[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\nstructure = "7F"\n'
             '[routes]\n"lwr.torques" = "udp.values0"\n')  # fmt: skip
    rows = {"values0": np.zeros((3, 7))}
    path = record_packets(
        tmp_path / "still.mcap", "7F", rows, np.arange(3.0), {"scenes/x.toml": scene}
    )
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/still.mcap",
        reason=(
            "no recorded source moves a robot: found routes to lwr.torques; "
            "expected lwr.joint_angles"
        ),
    ):
        read_run(path)
    bad = scene.replace('"udp.values0"', '"udp.values9"').replace("torques", "joint_angles")
    path = record_packets(tmp_path / "bad.mcap", "7F", rows, np.arange(3.0), {"s/x.toml": bad})
    with raises_with(
        RecordingError,
        path=f"{tmp_path}/bad.mcap",
        reason=(
            "its routes cannot be followed: routes.lwr.joint_angles: no event "
            "'values9' of udp; did you mean 'values0'?"
        ),
    ):
        read_run(path)


@pytest.mark.parametrize(
    ("scene_file", "model"), [("x", "rod/robot.toml"), ("rod_robot", "rods/rod 7.toml")]
)
def test_robot_that_is_not_installed_is_read_from_the_recording(
    tmp_path: Path, scene_file: str, model: str
) -> None:
    own = ('dh_convention = "craig"\ndh_params = [[0, 0, 0, 0.2]]\ntorque_limits = [5.0]\n'
           'filenames = ["base.stl", "link.stl"]\n')  # fmt: skip
    named = model.removesuffix("/robot.toml")
    scene = (f'[robots.mine]\nmodel = "../elsewhere/{named}"\n[sources.udp]\nkind = "udp"\n'
             'structure = "1F"\n[routes]\n"mine.joint_angles" = "udp.values0"\n')  # fmt: skip
    files = {f"scenes/{scene_file}.toml": scene, model: own}
    rows = {"values0": np.ones((3, 1))}
    path = record_packets(tmp_path / "rod.mcap", "1F", rows, np.arange(3.0), files)
    run = read_run(path)
    assert run.torque_limits("mine") == [5.0]
    assert run.robots["mine"].filenames == []  # the meshes are not here: links are generated
    files.pop(model)
    path = record_packets(tmp_path / "gone.mcap", "1F", rows, np.arange(3.0), files)
    with pytest.raises(
        RecordingError, match=r"robot 'mine' is neither recorded nor installed.*scene"
    ):
        read_run(path)


def test_urdf_is_read_from_the_recording_if_its_folder_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    urdf, scenario = tmp_path / "arm.urdf", tmp_path / "arm.toml"
    urdf.write_text(
        '<robot name="arm"><link name="base"/><joint name="q" type="revolute"><parent link="base"/>'
        '<child link="a"/><axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="6" effort="60"/>'
        '</joint><link name="a"><inertial><origin xyz="0.2 0 0"/><mass value="2"/><inertia '
        'ixx="0.003" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial><visual><geometry>'
        '<mesh filename="package://elsewhere/a.stl"/></geometry></visual></link></robot>'
    )
    scenario.write_text('[robots.arm]\nmodel = "arm.urdf"\n[run]\nduration = 0.1\n')
    simulation, recording = Simulation(read_scenario(scenario)), tmp_path / "run.mcap"
    simulation.advance(simulation.steps)
    with RunRecorder(simulation, recording) as recorder:
        recorder.write(0, simulation.steps + 1)
    urdf.unlink()
    monkeypatch.chdir(tmp_path.root)
    assert "elsewhere" in caplog.text
    caplog.clear()
    (robot,) = read_run(recording).robots.values()
    assert not caplog.text  # it needs no meshes
    assert (robot.name, robot.names) == ("arm", ["q"])
    assert robot_dynamics(robot).masses == pytest.approx([0.0, 2.0], abs=1e-6)


def test_packets_with_the_same_arrival_time_count_as_one(tmp_path: Path) -> None:
    times = np.array([0.0, 0.1, 0.1, 0.1, 0.2])
    files = {"x/mine.toml": '[robots.lwr]\nmodel = "lwr"\n[sources.udp]\nkind = "udp"\n'
             'structure = "7F"\n[routes]\n"lwr.joint_angles" = "udp.values0"\n'}  # fmt: skip
    rows = {"values0": np.arange(5.0)[:, None] * np.ones(7) + HOME}
    run = read_run(record_packets(tmp_path / "x.mcap", "7F", rows, times, files))
    np.testing.assert_allclose(run.times, [0.0, 0.1, 0.2], atol=1e-8)
    np.testing.assert_allclose(run.of("lwr", "joint_angles")[:, 0], [0.0, 3.0, 4.0])


def test_recorded_rows_are_in_the_file_within_half_a_second(tmp_path: Path) -> None:
    simulation = simulated(duration=0.1)
    path = tmp_path / "run.mcap"
    with RunRecorder(simulation, path) as recorder:
        recorder.write(0, 51)
        time.sleep(FLUSH_AFTER + 0.05)
        recorder.write(51, 61)
        with Recording(path) as recording:  # as found if the process is killed now
            assert [at for at, _ in recording.packets(SOURCE)] == pytest.approx(
                simulation.rows[:61, 0], abs=1e-6
            )


def test_values_of_signals_belong_to_their_rows(tmp_path: Path) -> None:
    simulation = simulated(duration=0.1)
    path = tmp_path / "run.mcap"
    with RunRecorder(simulation, path, signals_rate=100.0) as recorder:
        recorder.write(0, 15)
        recorder.write(15, 16)  # none of these rows is due
        recorder.write(16, 101)
    _, _, found = signals_in(path, f"/{SOURCE}/signals")
    assert list(found) == list(range(0, 101, 10))
    angles = simulation.layout.columns[event_of("lwr", "joint_angles")]
    for k, values in found.items():
        joints = simulation.scenario.scene.robots["lwr"].names
        found_angles = [values[f"lwr_{joint.lower()}_angle"] for joint in joints]
        expected = simulation.rows[k, angles].tolist()
        assert found_angles == expected


DEGREES = """
[robots.lwr]
model = "lwr"

[sources.udp]
kind = "udp"
port = 32000
structure = "7F7F"

[routes]
"lwr.joint_angles" = "udp.values0 * deg"
"lwr.torques" = "udp.values1"
"""


# ---- older files, in which measured angles and velocities had other names


@pytest.mark.extensions
def test_old_recording_equals_the_same_run(tmp_path: Path) -> None:
    new = read_run(record_run(simulated(), tmp_path / "new.mcap"))
    old = read_run(record_run(simulated(), tmp_path / "old.mcap", is_old=True))
    assert new.signals.keys() == old.signals.keys() >= {"lwr_joint_angles", "lwr_joint_velocities"}
    for event, values in new.signals.items():
        np.testing.assert_array_equal(old.signals[event], values)


def exported(recording: Path) -> Path:
    table = recording.with_suffix(".csv")
    with pytest.raises(SystemExit) as ended:
        main(["export", str(recording), str(table)])
    assert not ended.value.code
    return table


@pytest.mark.extensions
def test_tables_of_simulations_and_packets_equal_their_runs(
    tmp_path: Path,
) -> None:
    simulation = simulated()
    run = read_run(record_run(simulation, tmp_path / "simulated.mcap"))
    write_run_csv(simulation.layout, simulation.rows, tmp_path / "rows.csv")
    for table in (tmp_path / "rows.csv", exported(tmp_path / "simulated.mcap")):
        log = find_tables(table).read_run(table, simulation.scenario.scene, None, {})
        np.testing.assert_array_equal(log.times, run.times)
        for signal in ("joint_angles", "joint_velocities", "torques", "commanded_torques"):
            np.testing.assert_array_equal(log.of("lwr", signal), run.of("lwr", signal))
    # From a robot, in the units of its packets.
    path = tmp_path / "scene.toml"
    path.write_text(DEGREES)
    times = 1e-3 * np.arange(len(run.times))
    rows = {
        "values0": np.rad2deg(run.of("lwr", "joint_angles")),
        "values1": run.of("lwr", "torques"),
    }
    files = {"scene.toml": DEGREES}
    recording = record_packets(tmp_path / "robot.mcap", "7F7F", rows, times, files)
    expected, table = read_run(recording), exported(recording)
    found = find_tables(table).read_run(table, load_scene(str(path)), None, {})
    np.testing.assert_allclose(found.times, expected.times, atol=1e-9)
    for signal in ("joint_angles", "joint_velocities", "torques"):
        np.testing.assert_allclose(found.of("lwr", signal), expected.of("lwr", signal), rtol=1e-6)
    path.write_text(DEGREES + DEGREES[DEGREES.index("[sources") : DEGREES.index("[routes")].replace(
        "udp", "other").replace("other\"", "udp\"").replace("32000", "32001"))  # fmt: skip
    with raises_with(
        UsageError,
        reason=f"{tmp_path}/robot.csv fits the sources udp, other. Choose one with --source udp",
    ):
        find_tables(table).read_run(table, load_scene(str(path)), None, {})
    assert find_tables(table).read_run(table, load_scene(str(path)), "udp", {}).robots.keys() == {
        "lwr"
    }
    with raises_with(
        CsvError,
        path=f"{tmp_path}/robot.csv",
        reason=(
            "no recorded source moves a robot: found routes to lwr.joint_angles, "
            "lwr.torques; expected lwr.joint_angles"
        ),
    ):
        find_tables(table).read_run(table, load_scene(str(path)), "other", {})
    with raises_with(UsageError, reason="no source", found="upd", of="in the scene", near="udp"):
        find_tables(table).read_run(table, load_scene(str(path)), "upd", {})


@pytest.mark.extensions
@pytest.mark.thorough
@pytest.mark.parametrize(
    "arguments",
    [["compare", "{csv}", "{mcap}", "--tolerance-torque", "1e-6"], ["compare", "{csv}"],
     ["identify", "{csv}"], ["plot", "{csv}", "-o", "{out}"]],
)  # fmt: skip
def test_commands_for_recordings_accept_tables(arguments: list[str], tmp_path: Path) -> None:
    mcap = record_run(simulated(), tmp_path / "run.mcap")
    names = {"csv": exported(mcap), "mcap": mcap, "out": tmp_path / "out.svg"}
    with pytest.raises(SystemExit) as ended:
        main([each.format(**names) for each in arguments] + ["--scene", "lwr"])
    assert not ended.value.code


@pytest.mark.extensions
def test_old_table_equals_the_same_run(tmp_path: Path) -> None:
    scene = simulated().scenario.scene
    write_run_csv(simulated().layout, simulated().rows, tmp_path / "new.csv")
    text = (tmp_path / "new.csv").read_text()
    assert "lwr_joint_angles[0]" in text
    (tmp_path / "old.csv").write_text(in_old_words(text))
    new, old = (
        find_tables(tmp_path / f"{name}.csv").read_run(tmp_path / f"{name}.csv", scene, None, {})
        for name in ("new", "old")
    )
    assert new.signals.keys() == old.signals.keys() >= {"lwr_joint_angles", "lwr_joint_velocities"}


def test_old_recording_plays_in_the_scene_of_its_scenario(tmp_path: Path) -> None:
    simulation = simulated()
    scene = simulated_scene(simulation)
    replay_instead(scene, record_run(simulation, tmp_path / "old.mcap", is_old=True), None)
    with Mirror(scene) as mirror:
        mirror.advance(0.3)
        shown = mirror.data.qpos[mirror.world.robots["lwr"].qpos]
    expected = simulation.rows[300, simulation.layout.columns["lwr_joint_angles"]]
    np.testing.assert_array_equal(shown, expected)


FINGER = """\
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.02], [1.5, 0, 0, 0], [0, 0.05, 0, 0]]
couplings = { J3 = { to = "J2", ratio = 2.0 } }
torque_limits = [3.0, 4.0, 5.0]
"""
CLAW = """\
members = ["one", "two"]
[robots.two]
model = '../finger'
torque_limits = [6.0, 7.0, 8.0]
[robots.one]
model = "finger/robot.toml"
[objects.palm]
shape = "sphere"
size = [0.02]
"""
CLAWS = """\
[groups.claw]
model = "parts/claw"
[groups.both]
robots = ["claw", "arm"]
[robots.arm]
dh_convention = "craig"
dh_params = [[0, 0, 0, 0.3]]
[doubles.goal]
of = "claw"
[sources.udp]
kind = "udp"
port = 31998
structure = "5F6F4F"
[routes]
"both.joint_angles" = "udp.values0 * deg"
"claw.torques" = "udp.values1"
"goal.joint_angles" = "udp.values2"
"""


def folder_of_claws(folder: Path, scene: str) -> Path:
    for name, text in (
        ("parts/finger/robot", FINGER), ("parts/claw/group", CLAW), ("lab/scene", scene)
    ):  # fmt: skip
        file = folder / f"{name}.toml"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text.replace('"parts/', '"../parts/'))
    return folder / "lab" / "scene.toml"


def test_groups_are_read_from_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = folder_of_claws(tmp_path / "there", CLAWS)
    monkeypatch.chdir(file.parent)
    files = {f"{each.parent.name}/{each.name}": each.read_text()
             for each in load_scene(file.name).files()}  # fmt: skip
    assert sorted(files) == ["claw/group.toml", "finger/robot.toml", "lab/scene.toml"]
    (tmp_path / "there").rename(tmp_path / "away")
    monkeypatch.chdir(tmp_path)
    values = np.arange(60.0).reshape(4, 15)
    rows = {"values0": values[:, :5], "values1": values[:, 5:11], "values2": values[:, 11:]}
    record_packets(tmp_path / "claw.mcap", "5F6F4F", rows, np.arange(4) * 0.01, files)
    run = read_run(tmp_path / "claw.mcap")
    assert [*run.robots] == ["arm", "claw_two", "claw_one"]
    assert run.torque_limits("claw_one").tolist() == [3.0, 4.0, 5.0]
    assert run.torque_limits("claw_two").tolist() == [6.0, 7.0, 8.0]
    # The distal joint rotates twice as far.
    two = np.deg2rad(values[:, [2, 3, 3]]) * [1.0, 1.0, 2.0]
    np.testing.assert_allclose(run.of("claw_two", "joint_angles"), two)
    np.testing.assert_array_equal(run.of("claw_two", "torques"), values[:, 8:11])
    np.testing.assert_array_equal(run.of("arm", "joint_angles"), np.deg2rad(values[:, 4:5]))
    np.testing.assert_array_equal(
        run.of("claw_one", "target_angles"), values[:, [11, 12, 12]] * [1.0, 1.0, 2.0]
    )
    del files["claw/group.toml"]
    record_packets(tmp_path / "old.mcap", "5F6F4F", rows, np.arange(4) * 0.01, files)
    with pytest.raises(RecordingError) as caught:
        read_run(tmp_path / "old.mcap")
    assert caught.value.reason == (
        "its groups are invalid: groups.claw.model: no model 'claw' of a group; available: "
        "biped, dlr_hand2, hit_hand2, justin, space_justin; pass a scene"
    )


def test_simulated_group_equals_its_run(tmp_path: Path) -> None:
    file = folder_of_claws(
        tmp_path / "there",
        '[groups.claw]\nmodel = "parts/claw"\n[run]\nduration = 0.05\n'
        '[controllers.claw]\nkind = "joint_impedance"\nstiffness = 2\n',
    )
    simulation = Simulation(read_scenario(file))
    with RunRecorder(simulation, tmp_path / "run.mcap") as recorder:
        for first, stop in simulation.run():
            recorder.write(first, stop)
    (tmp_path / "there").rename(tmp_path / "away")
    run = read_run(tmp_path / "run.mcap")
    assert [*run.robots] == ["claw_two", "claw_one"]
    assert run.torque_limits("claw_two").tolist() == [6.0, 7.0, 8.0]
    angles = simulation.log.of("claw_two", "joint_angles")
    np.testing.assert_array_equal(run.of("claw_two", "joint_angles"), angles)


def test_recorded_group_alone_is_named_after_its_folder(tmp_path: Path) -> None:
    folder_of_claws(tmp_path, "")
    scene = load_scene(tmp_path / "parts" / "claw" / "group.toml")
    files = {f"{each.parent.name}/{each.name}": each.read_text() for each in scene.files()}
    structure = "time:1F claw_one_joint_angles:3F claw_two_joint_angles:3F"
    names = [field.split(":")[0] for field in structure.split()]
    rows = dict(
        zip(names, (np.arange(4.0)[:, None], np.ones((4, 3)), np.ones((4, 3))), strict=True)
    )
    record_packets(tmp_path / "run.mcap", structure, rows, np.arange(4) * 0.01, files)
    assert [*read_run(tmp_path / "run.mcap").robots] == ["claw_one", "claw_two"]


def test_bursts_are_spread_evenly_and_other_packets_unchanged() -> None:
    rng = np.random.default_rng(3)
    sent = 1e-3 * np.arange(4000)
    sent[2000:] += 5.0  # a pause
    uneven = sent + rng.uniform(0.0, 4e-4, len(sent))
    np.testing.assert_array_equal(spread_bunches(uneven), uneven)
    few = np.array([0.0, 0.1, 0.1, 0.5])
    np.testing.assert_array_equal(spread_bunches(few), few)
    # All four together with the last one.
    held = sent.reshape(-1, 4).repeat(4, axis=0)[::4, -1].repeat(4)
    np.testing.assert_allclose(spread_bunches(held), sent, atol=1e-9)
    lost = np.delete(held, np.arange(3, 4000, 100))
    assert np.abs(spread_bunches(lost) - np.delete(sent, np.arange(3, 4000, 100))).max() < 2e-3
