"""`sero-mj plot`: recordings as figures, on the command line."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from conftest import raises_with
from PIL import Image
from runs import simulated, sine_run, two_joints

from sero_mj.base.errors import CsvError, UsageError
from sero_mj.cli import main
from sero_mj.data.receive.udp import UdpReceiver
from sero_mj.robots.declared.scene import Scene
from sero_mj.simulate.log_output import RunRecorder
from sero_mj.simulate.runs.run_csv import write_run_csv
from sero_mj.simulate.runs.run_log import RunLog
from sero_mj.simulate.runs.tables import find_tables


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Contains `swing.mcap` and `swing.csv`, half a second of a simulated LWR."""
    folder = tmp_path_factory.mktemp("runs")
    simulation = simulated()
    with RunRecorder(simulation, folder / "swing.mcap") as recorder:
        recorder.write(0, simulation.step + 1)
    write_run_csv(simulation.layout, simulation.rows, folder / "swing.csv")
    return folder


def plot(*arguments: object) -> int:
    with pytest.raises(SystemExit) as ended:
        main(["plot", *map(str, arguments)])
    return int(ended.value.code or 0)


def words_of(path: Path) -> list[str]:
    """Returns every text in an .svg file."""
    return [text for each in ElementTree.parse(path).iter() if (text := (each.text or "").strip())]


def test_plot_writes_a_figure_of_a_recording(folder: Path, tmp_path: Path) -> None:
    assert plot(folder / "swing.mcap", "-o", tmp_path / "new" / "all.svg") == 0
    words = words_of(tmp_path / "new" / "all.svg")
    for joint in ("A1", "A2", "E1", "A3", "A4", "A5", "A6"):
        assert words.count(joint) == 1
    assert {"swing", "torque, Nm", "torque error, Nm", "commanded", "measured"} <= set(words)
    assert "0.5 s, 501 rows; error is commanded minus measured" in words
    assert words.count("limit 176 Nm") == 2


def test_joints_and_times_are_selected(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "some.svg"
    arguments = ["--robot", "lwr", "--joints", "A2, A4", "--from", "0.1", "--to", "0.3"]
    assert plot(folder / "swing.mcap", "-o", out, *arguments, "--quiet") == 0
    words = words_of(out)
    assert "0.2 s, 201 rows; error is commanded minus measured" in words
    assert [word for word in words if re.fullmatch(r"[AE]\d", word)] == ["A2", "A4"]
    peak = next(word for word in words if word.startswith("peak") and "at" in word)
    assert 0.1 <= float(peak.split()[3]) <= 0.3


@pytest.mark.extensions
@pytest.mark.thorough
@pytest.mark.slow
def test_several_recordings_become_pages(folder: Path, tmp_path: Path) -> None:
    run = folder / "swing.mcap"
    for files, pages in (([run], 1), ([run, run, folder / "swing.csv"], 3)):
        out = tmp_path / f"{pages}.pdf"
        assert plot(*files, "-o", out, "--joints", "A2", "--scene", "lwr") == 0
        assert len(re.findall(rb"/Type /Page\b", out.read_bytes())) == pages
    assert plot(run, run, "-o", tmp_path / "x.png") == 2


@pytest.mark.extensions
@pytest.mark.thorough
@pytest.mark.slow
def test_table_gives_the_same_figure_as_its_recording(folder: Path, tmp_path: Path) -> None:
    for name, more in (("swing.mcap", []), ("swing.csv", ["--scene", "lwr"])):
        assert plot(folder / name, "-o", tmp_path / f"{name}.png", *more) == 0
    one, other = (
        np.asarray(Image.open(tmp_path / f"swing.{each}.png")) for each in ("mcap", "csv")
    )
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--joints", "A9"], "no joint 'A9' in swing; available: A1, A2, A3"),
        (["--robot", "lrw"], "no robot 'lrw' in swing; did you mean 'lwr'?"),
        (["--from", "3"], "run swing has no rows from 3 s; it lasts from 0 s to 0.5 s"),
        (["--from", "3", "--to", "2"], "--to: found 2"),
        (["--source", "upd"], "no source 'upd' in "),
        (["--joints", "A1,,A2"], "found 'A1,,A2'; expected names separated by commas"),
    ],
)
def test_unknown_robots_joints_and_times_are_reported(
    folder: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    expected: str,
) -> None:
    assert plot(folder / "swing.mcap", "-o", tmp_path / "x.png", *arguments) == 2
    assert expected in capsys.readouterr().err
    assert not (tmp_path / "x.png").exists()


@pytest.mark.extensions
def test_invalid_figure_names_and_tables_are_reported(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for arguments, said in (
        (["swing.mcap", "-o", "x.jpg"], "x.jpg'; expected a name that ends in .png"),
        (["swing.csv", "-o", "x.png"], "a table does not describe its robots; add --scene with"),
        (["none.mcap", "-o", "x.png"], "none.mcap"),
    ):
        given = [folder / arguments[0], "-o", tmp_path / arguments[2]]
        assert plot(*given) == 2
        assert said in capsys.readouterr().err
    table = tmp_path / "t.csv"
    table.write_text("time,a,b[0]\n0,1,2\n")
    with raises_with(
        CsvError,
        path=f"{tmp_path}/t.csv",
        reason="found the columns a, b[0]; expected 2 columns with joint angles. Declare "
        'them with --columns "joint_angles=NAME,NAME,..."',
    ):
        find_tables(table).read_run(table, Scene(robots=[two_joints()]), None, {})
    with raises_with(
        CsvError,
        path=f"{tmp_path}/t.csv",
        reason="found the columns a, b[0]; expected columns with joint angles. Declare "
        'them with --columns "joint_angles=b[*]"',
    ):
        find_tables(table).read_run(table, Scene(), None, {})
    source = UdpReceiver(name="udp", structure="measured:2F commanded:2F", port=32000)
    scene = Scene(
        robots=[two_joints()], sources={"udp": source}, routes={"arm.torques": "udp.measured"}
    )
    table.write_text("time,measured[1],commanded[0],commanded[1]\n0,1,2,3\n")
    with raises_with(
        CsvError,
        path=f"{tmp_path}/t.csv",
        reason="has no columns measured[0] of source 'udp'; found the columns measured[1], "
        "commanded[0], commanded[1]; expected 2 columns with joint angles. Declare "
        'them with --columns "joint_angles=commanded[*]"',
    ):
        find_tables(table).read_run(table, scene, None, {})


def test_robots_without_torques_are_omitted_from_a_plot_of_all(tmp_path: Path) -> None:
    from sero_mj.study.plot import plot_run

    log = sine_run()
    hand = two_joints("hand")
    both = RunLog(
        {"hand": hand, **log.robots},
        {**log.signals, "hand_joint_angles": np.zeros((len(log.times), 2))},
        log.times,
    )
    plot_run(both, tmp_path / "x.svg")
    assert words_of(tmp_path / "x.svg").count("turn") == 1
    with raises_with(
        UsageError,
        key="run run",
        reason="has no torques of robot 'hand'",
        expected="torques or commanded_torques",
    ):
        plot_run(both, tmp_path / "x.svg", robots=["hand"])
    with raises_with(
        UsageError,
        file=f"{tmp_path}/x.svg",
        found=2,
        of="pages",
        expected="a name that ends in .pdf",
    ):
        plot_run([log, log], tmp_path / "x.svg")


def test_part_of_a_run_includes_its_ends() -> None:
    part = sine_run(duration=1.0).between(0.25, 0.5)
    assert (part.times[0], part.times[-1], len(part.times)) == (0.25, 0.5, 251)
    assert len(part.of("arm", "torques")) == 251
    assert len(sine_run(duration=1.0).between(None, 0.1).times) == 101
    with raises_with(
        UsageError, reason="run run has no rows from 2 s to 3 s; it lasts from 0 s to 1 s"
    ):
        sine_run(duration=1.0).between(2.0, 3.0)
