"""Tables of other programs: cells, times, columns, and their use in commands."""

from __future__ import annotations

import math
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import raises_with

from sero_mj.base.errors import CsvError
from sero_mj.cli import main
from sero_mj.data.drive.wiring import wire
from sero_mj.data.record.csv_files import parse_columns
from sero_mj.extensions.tables.joints import move_by_table, robots_in
from sero_mj.extensions.tables.replay import TableReplay
from sero_mj.extensions.tables.run import read_run_table
from sero_mj.extensions.tables.signals import signals_of
from sero_mj.extensions.tables.table import read_csv, read_table
from sero_mj.load import load_scene
from sero_mj.robots.declared.robot import SerialRobot

OF_VENDORS = pytest.mark.extensions  # column names of libfranka and RTDE are in extensions

SCENE = """
[robots.two]
dh_convention = "craig"
dh_params = [[0, 0.3, 0, 0], [0, 0.3, 0, 0]]
joint_names = ["shoulder", "elbow"]
inputs = ["external_torques"]

[doubles.goal]
of = "two"

[sources.arm]
kind = "udp"
port = {port}
structure = "2f2F"

[routes]
"two.joint_angles" = "arm.values0 * deg"
"two.torques" = "arm.values1"
"two.show_arrows" = "arm.receiving"
"""
# record.py of Universal Robots: cells are separated by a space.
RTDE = """timestamp actual_q_0 actual_q_1 target_moment_0 target_moment_1
17000.000 0.5 -1.0 10.0 20.0
17000.008 0.6 -1.1 11.0 21.0
17000.016 0.7 -1.2 12.0 22.0
"""
# franka::logToCSV before and since 2024, in ms; commands have the names of measurements.
FRANKA = """duration, success rate, q[0], q[1],q_d[0], q_d[1],tau_J[0], tau_J[1],\
tau_ext_hat_filtered[0], tau_ext_hat_filtered[1],sent commands,q_d[0], q_d[1]
0,1,0.1,0.2,0.3,0.4,5,6,0.5,-0.5,,9,9
2,1,0.2,0.3,0.3,0.4,7,8,0.5,-0.5,,9,9
"""
FRANKA_2024 = """time,success_rate,state.q[0],state.q[1],state.tau_J[0],state.tau_J[1],cmd.q_d[0]
0,1,0.1,0.2,5,6,9
2,1,0.2,0.3,7,8,9
"""


def table(tmp_path: Path, text: str, name: str = "t.csv") -> Path:
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return path


def scene_of(tmp_path: Path, port: int = 0):
    (tmp_path / "two.toml").write_text(SCENE.format(port=port), encoding="utf-8")
    return load_scene(tmp_path / "two.toml")


@pytest.mark.parametrize(
    "text",
    [
        "time,a,b\n0,1,-2.5\n0.5,2,3\n",
        "time;a;b\n0;1;-2,5\n0,5;2;3\n",
        "time\ta\tb\n0\t1\t-2.5\n0.5\t2\t3\n",
        "time\ta\tb\n0,0\t1\t-2,5\n0,5\t2\t3\n",
        "time a b\n0 1 -2.5\n0.5 2 3\n",
        "  time   a  b\n  0.0  1  -2.5\n  0.5  2   3\n",
        "time a b\n0,0 1 -2,5\n0,5 2 3\n",
        "# time a b\n0 1 -2.5\n0.5 2 3\n",
        "time, a, b\n0, 1, -2.5\n0.5, 2, 3\n",
        "time;a;b;\n0;1;-2,5;\n0,5;2;3;\n",
    ],
)
def test_cell_and_decimal_separators_are_recognized(tmp_path: Path, text: str) -> None:
    times, columns = read_csv(table(tmp_path, text))
    assert times.tolist() == [0.0, 0.5]
    found = {name: values.tolist() for name, values in columns.items()}
    assert found == {"a": [1.0, 2.0], "b": [-2.5, 3.0]}


@pytest.mark.parametrize(
    ("head", "cells", "times"),
    [
        ("timestamp", ("5", "5.25"), (5.0, 5.25)),
        ("Time [ms]", ("0", "250"), (0.0, 0.25)),
        ("t_us", ("0", "250000"), (0.0, 0.25)),
        ("Zeit [s]", ("0", "0.25"), (0.0, 0.25)),
        ("__time", ("1700000000.5", "1700000000.75"), (1_700_000_000.5, 1_700_000_000.75)),
        ("time", ("1700000000500", "1700000000750"), (1_700_000_000.5, 1_700_000_000.75)),
        ("%time", ("1700000000500000000", "1700000000750000000"),
         (1_700_000_000.5, 1_700_000_000.75)),
        ("stamp", ("2023-11-14T22:13:20.5+00:00", "2023-11-14T22:13:20.75+00:00"),
         (1_700_000_000.5, 1_700_000_000.75)),
    ],
)  # fmt: skip
def test_time_column_is_found_and_converted_to_seconds(
    tmp_path: Path, head: str, cells: tuple[str, str], times: tuple[float, float]
) -> None:
    path = table(tmp_path, f"a,{head}\n1,{cells[0]}\n2,{cells[1]}\n")
    found, columns = read_csv(path)
    assert found == pytest.approx(times, rel=0.0, abs=1e-6)
    assert columns["a"].tolist() == [1.0, 2.0]


def test_columns_with_text_raise_an_error_only_when_used(tmp_path: Path) -> None:
    path = table(tmp_path, "time,mode,a,a\n0,AUTO,1,2\n1,AUTO,3,4\n")
    found = read_table(path)
    assert found.column("a").tolist() == [1.0, 3.0]
    assert found.column("a.1").tolist() == [2.0, 4.0]  # as in pandas
    wrong = {"line": 2, "column": "mode", "reason": "found 'AUTO'; expected a number, or nan"}
    for read in (lambda: found.column("mode"), lambda: read_csv(path)):
        with raises_with(CsvError, **wrong):
            read()
    with raises_with(CsvError, reason="no column 'mod'; did you mean 'mode'?"):
        found.column("mod")
    with raises_with(CsvError, reason="no time column 'ti'; "
                                      "did you mean 'time'?"):  # fmt: skip
        read_table(path, time="ti")


@pytest.mark.parametrize(
    ("names", "signal"),
    [
        (["joint_angles[0]", "joint_angles[1]"], "joint_angles"),
        (["two_torques[0]", "two_torques[1]"], "torques"),  # simulate --csv
        (["torques[shoulder]", "torques[elbow]"], "torques"),  # export-csv
        (["two.shoulder.torque [Nm]", "two.elbow.torque [Nm]"], "torques"),
        (["joint1_position", "joint2_position"], "joint_angles"),
        (["shoulder", "elbow"], "joint_angles"),
        pytest.param(["actual_qd_0", "actual_qd_1"], "joint_velocities", marks=OF_VENDORS),
        (["A1 [rad]", "A2 [rad]"], "joint_angles"),
        pytest.param(["state.dq[0]", "state.dq[1]"], "joint_velocities", marks=OF_VENDORS),
        (["effort_1", "effort_2"], "torques"),
    ],
)
@pytest.mark.parametrize("order", [1, -1])
def test_columns_are_recognized_in_joint_order(
    tmp_path: Path, names: list[str], signal: str, order: int
) -> None:
    values = dict(zip(names, ("1", "2"), strict=True))
    head, row = ",".join(names[::order]), ",".join(values[name] for name in names[::order])
    found = read_table(table(tmp_path, f"time,{head}\n0,{row}\n"))
    signals = signals_of(found, ["shoulder", "elbow"], robot="two", counts=(2,))
    assert {key: each.tolist() for key, each in signals.items()} == {signal: [[1.0, 2.0]]}


@OF_VENDORS
def test_libfranka_logs_are_converted_to_our_units_and_signs(tmp_path: Path) -> None:
    found = read_table(table(tmp_path, FRANKA))
    assert found.times.tolist() == [0.0, 0.002]
    signals = {key: each[0].tolist() for key, each in signals_of(found).items()}
    assert signals == {
        "joint_angles": [0.1, 0.2], "torques": [5, 6], "commanded_angles": [0.3, 0.4],
        "external_torques": [-0.5, 0.5],  # libfranka's torques are exerted by the robot
    }  # fmt: skip
    found = read_table(table(tmp_path, FRANKA_2024))
    assert found.times.tolist() == [0.0, 0.002]
    signals = {key: each[0].tolist() for key, each in signals_of(found).items()}
    assert signals == {"joint_angles": [0.1, 0.2], "torques": [5, 6]}


def test_columns_are_declared_by_patterns_lists_and_units(tmp_path: Path) -> None:
    found = read_table(table(tmp_path, "time,J10,J9,x [deg],y [deg],tau\n0,10,9,180,90,3\n"))
    columns = parse_columns(["joint_angles=x [deg],y [deg]", "torques = J*"])
    signals = {key: each.tolist() for key, each in signals_of(found, (), columns).items()}
    assert signals == {"joint_angles": [[math.pi, math.pi / 2]], "torques": [[9.0, 10.0]]}
    given = signals_of(found, (), {"joint_angles [mrad]": ["J9", "J10"]})
    assert given["joint_angles"] == pytest.approx(np.array([[0.009, 0.01]]))
    with raises_with(CsvError, reason="no column matches 'j*'; "
                                      "available: J10, J9, tau, x [deg], y [deg]"):  # fmt: skip
        signals_of(found, (), {"joint_angles": "j*"})
    for key in ("joint_angles [ms]", "time [ms]"):
        with raises_with(key="columns", found="ms" if key.startswith("j") else key):
            signals_of(found, (), {key: "J*"})
    with raises_with(key="columns", found="joint angles"):
        signals_of(found, (), {"joint angles": "J*"})
    with pytest.raises(ValueError, match="found 'q'; expected SIGNAL=COLUMNS"):
        parse_columns(["q"])


def test_degree_sign_in_windows_encoding_is_a_unit(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes("t [s];A1 [°];A2 [°]\n0;90,0;180,0\n".encode("cp1252"))
    found = signals_of(read_table(path))
    assert found["joint_angles"] == pytest.approx(np.array([[math.pi / 2, math.pi]]))


def test_wrong_number_of_joints_is_reported(tmp_path: Path) -> None:
    three = "time,q_1,q_2,q_3\n0,1,2,3\n"
    scene = scene_of(tmp_path)
    expected = "expected 2 columns with joint angles"
    with raises_with(CsvError, reason=f"found joint angles in 3 columns, q_1 to q_3; {expected}"):
        robots_in(read_table(table(tmp_path, three)), scene.robots, {})
    unknown = read_table(table(tmp_path, "time,x1,x2\n0,1,2\n"))
    reported = (
        f'found the columns x1, x2; {expected}. Declare them with --columns "joint_angles=x*"'
    )
    with raises_with(CsvError, reason=reported):
        robots_in(unknown, scene.robots, {})


@OF_VENDORS
def test_table_is_a_source_of_joint_signals_or_packets(tmp_path: Path) -> None:
    source = TableReplay(file=table(tmp_path, RTDE), speed=1.0)
    assert source.events == {"joint_angles": (2,), "commanded_torques": (2,), "torques": (2,)}
    with source:
        source.advance_to(0.009)
        packet = source.latest()
        assert packet is not None and packet.values["joint_angles"].tolist() == [0.6, -1.1]
        assert packet.values["torques"].tolist() == [11.0, 21.0]  # the commanded torques
        source.advance_to(1.0)
        assert source.counters.received == 3 and source.end == pytest.approx(0.016)
    packets = TableReplay(file=tmp_path / "t.csv", structure="4f", rate=100.0)
    with packets:
        packets.advance_to(0.011)
        packet = packets.latest()
        assert packet is not None
        assert packet.values["values0"] == pytest.approx([0.6, -1.1, 11.0, 21.0])
    for fields, key in (
        ({"start": 1.0}, "start"), ({"stop": 0.0}, "stop"), ({"structure": "4X"}, "structure"),
        ({"columns": {"time": "no"}}, "file"), ({"topics": {"joints": ["a"]}}, "topics"),
    ):  # fmt: skip
        with raises_with(key=key):
            TableReplay(file=tmp_path / "t.csv", **fields)


@OF_VENDORS
def test_joint_signals_move_a_scene_independently_of_its_packets(tmp_path: Path) -> None:
    scene = scene_of(tmp_path)
    move_by_table(scene, table(tmp_path, FRANKA), {})
    wiring = wire(scene).check(scene)
    assert {route.to.target: route.text for route in wiring.routes} == {
        "two.joint_angles": "table.joint_angles",
        "two.torques": "table.torques",
        "two.external_torques": "table.external_torques",
        "goal.joint_angles": "table.commanded_angles",
    }
    assert scene.robots["two"].joint_angles.tolist() == [0.1, 0.2]
    assert scene.robots["two"].show_arrows


def test_columns_with_names_of_packet_numbers_replace_the_source(tmp_path: Path) -> None:
    scene = scene_of(tmp_path)
    move_by_table(scene, table(tmp_path, "time,values0[0],values0[1]\n0,90,45\n"), {})
    assert scene.sources["arm"]["structure"] == "2f2F"
    source = wire(scene).check(scene).sources["arm"]
    with source:
        packet = source.latest()
    assert packet is not None and packet.values["values0"].tolist() == [90.0, 45.0]


def test_columns_of_several_robots_are_distinguished(tmp_path: Path) -> None:
    robots = {name: SerialRobot.from_model("ur5e").model_copy(update={"name": name})
              for name in ("left", "right")}  # fmt: skip
    names = [f"{robot}_q_{i}" for robot in ("right", "left") for i in range(6)]
    row = ",".join(map(str, range(12)))
    found = read_table(table(tmp_path, f"time,{','.join(names)}\n0,{row}\n"))
    declared = {"left.joint_angles": "left_q_*", "right.joint_angles": "right_q_*"}
    for columns in ({}, declared):
        led = robots_in(found, robots, columns)
        assert led["left"]["joint_angles"].tolist() == [[6, 7, 8, 9, 10, 11]]
        assert led["right"]["joint_angles"].tolist() == [[0, 1, 2, 3, 4, 5]]


@OF_VENDORS
def test_table_of_joint_signals_is_a_run(tmp_path: Path) -> None:
    run = read_run_table(table(tmp_path, RTDE), scene_of(tmp_path))
    assert run.times == pytest.approx([0.0, 0.008, 0.016])
    assert run.of("two", "joint_angles")[1].tolist() == [0.6, -1.1]
    assert run.of("two", "commanded_torques")[2].tolist() == [12.0, 22.0]
    assert "two_torques" not in run.signals  # displayed, but not measured
    columns = {"joint_angles [deg]": "actual_q_*"}
    run = read_run_table(tmp_path / "t.csv", scene_of(tmp_path), columns=columns)
    assert run.of("two", "joint_angles")[0] == pytest.approx(np.deg2rad([0.5, -1.0]))
    columns = {"torques": "target_moment_*"}
    run = read_run_table(tmp_path / "t.csv", scene_of(tmp_path), columns=columns)
    assert run.of("two", "torques")[2].tolist() == [12.0, 22.0]


@pytest.mark.filterwarnings("error")
def test_rows_with_equal_times_have_finite_velocities(tmp_path: Path) -> None:
    """Some programs write times with only six digits."""
    rows = "time,q1,q2\n17000,0,0\n17000,0,0\n17000.5,1,2\n17001,2,4\n17001,2,4\n"
    run = read_run_table(table(tmp_path, rows), scene_of(tmp_path))
    assert run.of("two", "joint_velocities") == pytest.approx(np.tile([2.0, 4.0], (5, 1)))


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(5.0)
        yield sock


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main([str(each) for each in arguments])
    return int(ended.value.code or 0)


@OF_VENDORS
def test_send_converts_joint_signals_by_the_routes_of_the_scene(
    tmp_path: Path, listener: socket.socket
) -> None:
    scene_of(tmp_path, listener.getsockname()[1])
    assert run("send", tmp_path / "two.toml", "--play", table(tmp_path, RTDE)) == 0
    sent = [struct.unpack("<2f2d", listener.recv(100)) for _ in range(3)]
    assert sent[1] == pytest.approx([math.degrees(0.6), math.degrees(-1.1), 11.0, 21.0])


@OF_VENDORS
def test_commands_report_what_a_table_needs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = table(tmp_path, RTDE)
    assert run("render", path, "-o", tmp_path / "x.png") == 2
    assert "which does not describe its robot. Name the robot" in capsys.readouterr().err
    scene_of(tmp_path)
    assert run("check", tmp_path / "two.toml", "--columns", "torques=x*") == 2
    assert "--columns needs a table" in capsys.readouterr().err
    assert run("check", tmp_path / "two.toml", "--replay", path, "--columns", "torques=x*") == 2
    assert "no column matches 'x*'" in capsys.readouterr().err
    arguments = ("--replay", path, "--columns", "torques=target_moment_*")
    assert run("check", tmp_path / "two.toml", *arguments) == 0
    assert "table.torques -> two.torques" in capsys.readouterr().out
