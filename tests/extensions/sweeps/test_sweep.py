"""Sweeps: samples, real processes, tables that survive interruption, and errors."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import raises_with, sampled

from sero_mj.base.errors import CsvError, UsageError
from sero_mj.base.paths import find_scenario
from sero_mj.cli import main
from sero_mj.extensions.sweeps.samples import Samples, Vary, full_grid, latin_hypercube
from sero_mj.extensions.sweeps.sweep import Sweep
from sero_mj.extensions.sweeps.sweep_results import SweepTable, plot_sweep, summarise_sweep
from sero_mj.extensions.sweeps.variants import Variants
from sero_mj.simulate.scenario_file import read_scenario
from sero_mj.simulate.simulation import Simulation
from sero_mj.study.engine import Processes, Work

SCENARIO = """
[robots.lwr]
model = "lwr"
joint_angles = [0.0, 0.6, 0.0, -1.2, 0.0, 1.2, 0.0]

[run]
duration = 0.3

[controllers.lwr]
kind = "joint_impedance"
stiffness = 800.0

[sensors.lwr]
angles = { noise = 1e-5 }

[disturbances.push]
kind = "force"
at = "lwr/flange"
force = [0.0, 0.0, -60.0]
begin = 0.1

[expect.it_holds]
measure = "position_error"
below = 0.02
"""
STIFFNESS = "controllers.lwr.stiffness"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "shove.toml"
    path.write_text(SCENARIO)
    return path


def sweep(file: Path, *varied: str, samples: int = 4, **options: Any) -> Sweep:
    fixed = options.pop("fixed", {})
    return Sweep(
        file, Samples(tuple(Vary.parse(each) for each in varied), samples, **options), fixed
    )


def read(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as table:
        return list(csv.DictReader(table))


# --- values


def test_lists_repeat_no_variant(file: Path) -> None:
    both = "run.elastic=true,false", "run.seed=int:1:3"
    pairs = [(values["run.elastic"], values["run.seed"]) for values in sweep(file, *both).variants]
    assert len(pairs) == len(set(pairs)) <= 4  # four samples of six
    every = [*sweep(file, *both, samples=6).variants, *sweep(file, *both, samples=60).variants]
    assert [(each["run.elastic"], each["run.seed"]) for each in every[:6]] == [
        (elastic, seed) for elastic in (True, False) for seed in (1, 2, 3)
    ]
    assert every[6:] == every[:6]


def test_latin_hypercube_has_one_sample_in_each_part_of_each_range() -> None:
    varied = [Vary.parse("a.x=10:20"), Vary.parse("a.y=log:1:1000"), Vary.parse("a.z=p,q")]
    rows = latin_hypercube(varied, 40, seed=1)
    x = np.array([row["a.x"] for row in rows])
    y = np.array([row["a.y"] for row in rows])
    assert sorted((np.floor((x - 10.0) / 10.0 * 40)).astype(int)) == list(range(40))
    assert sorted((np.floor(np.log(y) / np.log(1000.0) * 40)).astype(int)) == list(range(40))
    assert sorted(row["a.z"] for row in rows) == ["p"] * 20 + ["q"] * 20
    assert rows == latin_hypercube(varied, 40, seed=1) != latin_hypercube(varied, 40, seed=2)
    assert abs(np.corrcoef(x, np.log(y))[0, 1]) < 0.5


def test_grid_combines_all_values() -> None:
    varied = [Vary.parse("a.x=0:1"), Vary.parse("a.y=log:1:100"), Vary.parse("a.z=true,false")]
    rows = full_grid(varied, 3)
    assert len(rows) == 18
    assert [row["a.x"] for row in rows[::6]] == [0.0, 0.5, 1.0]
    assert [round(row["a.y"], 9) for row in rows[:6:2]] == [1.0, 10.0, 100.0]
    assert [row["a.z"] for row in rows[:2]] == [True, False]


@pytest.mark.parametrize(
    ("option", "values"),
    [
        ("run.seed=0:3", [0, 1, 2, 3]),
        ("a.delay=int:2:4", [2, 3, 4]),
        ("a.b=1,2.5", [1, 2.5]),
        ("a.b=[1, 2],[3, 4]", [[1, 2], [3, 4]]),
        ("a.kind=joint_impedance,torque", ["joint_impedance", "torque"]),
        ("a.at='x:y'", ["x:y"]),
        ("a.b=-1:1", [-1.0, 0.0, 1.0]),
        ("a.b=7", [7]),
    ],
)
def test_values_are_read(option: str, values: list[Any]) -> None:
    vary = Vary.parse(option)
    assert vary.grid(4 if "seed" in option else 3) == values
    many = vary.at(np.linspace(0.0, 0.999, 50))
    if not vary.is_range or vary.scale == "int":
        assert {str(value) for value in many} == {str(value) for value in values}


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ("stiffness", "--vary stiffness: expected KEY=LOW:HIGH, log:LOW:HIGH, int:LOW:HIGH or a "
         "list A,B,C, e.g. controllers.lwr.stiffness=100:2000"),
        ("stiffness=1:2", "--vary stiffness=1:2: expected KEY=LOW:HIGH"),
        ("a.b=", "--vary a.b=: expected KEY=LOW:HIGH"),
        ("a.b=1:x", "--vary a.b=1:x: found '1:x'; expected KEY=LOW:HIGH"),
        ("a.b=1:2:3", "found '1:2:3'"),
        ("a.b=2:1", "found 2 to 1; expected two numbers in ascending order"),
        ("a.b=nan:1", "found nan to 1; expected two numbers"),
        ("a.b=log:0:1", "found log from 0"),
        ("a.b=int:0.5:3", "found int:0.5:3; expected whole numbers"),
    ],
)  # fmt: skip
def test_invalid_values_are_rejected(option: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        Vary.parse(option)
    assert message in str(caught.value)


# --- variants


@pytest.mark.slow
def test_row_equals_the_result_of_a_single_simulation(file: Path) -> None:
    runs = sweep(file, f"{STIFFNESS}=200:3000", samples=3)
    for number, found in runs.run():
        scenario = read_scenario(file, runs.variants[number])
        simulation = Simulation(scenario)
        simulation.advance(simulation.steps)
        (outcome,) = simulation.outcomes()
        error = (simulation.log.of("lwr", "commanded_torques")
                 - simulation.log.of("lwr", "torques"))[1:]  # fmt: skip
        assert found["expect.it_holds"] is outcome.holds
        assert found["expect.it_holds.value"] == outcome.value
        assert found["lwr.peak_torque_error"] == np.abs(error).max()
        assert found["lwr.rms_torque_error"] == pytest.approx(
            max(np.sqrt((error**2).mean(axis=0))), rel=1e-12
        )
        assert found["lwr.findings"] == len(simulation.findings())
        assert found["held"] is outcome.holds and found["error"] == ""


def test_invalid_variant_is_a_row_with_its_error(file: Path) -> None:
    runs = sweep(file, f"{STIFFNESS}=500,9000", samples=2, is_grid=True)
    results = dict(runs.run())
    assert results[0]["error"] == ""
    assert results[1]["error"] == (  # and no further error about a missing target
        f"{STIFFNESS}: found 9000; expected 0 to 5000 Nm/rad; kind = 'joint_position' can be "
        "stiffer"
    )
    assert results[1]["held"] is False
    unstable = sweep(file, "run.timestep=0.001,0.05", fixed={STIFFNESS: 4000.0}, is_grid=True)
    error = dict(unstable.run())[1]["error"]
    assert "is unstable at 4000 Nm/rad with a time step of 50 ms" in error


def test_key_invalid_for_all_variants_is_rejected_at_once(file: Path) -> None:
    with raises_with(key="controllers.lwr.stifness", reason="unknown key", near="stiffness"):
        sweep(file, "controllers.lwr.stifness=1:2")
    with raises_with(key="controllers.lvr.stiffness", reason="no robot", found="lvr", near="lwr"):
        sweep(file, "controllers.lvr.stiffness=1:2")
    with raises_with(
        UsageError,
        key="--grid",
        reason="found 900 x 900 =",
        found=810000,
        of="variants",
        expected="at most 200000; reduce --samples, or omit --grid",
    ):
        sweep(file, f"{STIFFNESS}=1:2", "run.duration=1:2", samples=900, is_grid=True)
    with raises_with(
        UsageError,
        key="--vary run.seed",
        reason="is given twice",
        expected="one range for each key",
    ):
        sweep(file, "run.seed=0:3", "run.seed=4:5")
    with raises_with(
        UsageError, key="--vary run.seed", reason="is also set", expected="one of --vary and --set"
    ):
        sweep(file, "run.seed=0:3", fixed={"run.seed": 1})


@pytest.mark.thorough
@pytest.mark.slow
def test_results_do_not_depend_on_the_number_of_processes(file: Path, tmp_path: Path) -> None:
    runs = sweep(file, f"{STIFFNESS}=log:50:9000", "run.seed=0:99", samples=7)
    for jobs in (1, 3):
        with SweepTable(runs, tmp_path / f"{jobs}.csv") as table:
            for number, found in runs.run(Processes(jobs)):
                table.add(number, found)
    assert (tmp_path / "1.csv").read_bytes() == (tmp_path / "3.csv").read_bytes()
    rows = read(tmp_path / "3.csv")
    assert [row["variant"] for row in rows] == [str(k) for k in range(7)]
    assert any(row["error"] for row in rows) and any(row["held"] == "true" for row in rows)


KILLED = "the process was killed or ran out of memory"


@pytest.mark.slow
def test_killed_process_loses_its_variant_only(file: Path) -> None:
    runs = sweep(
        file, "run.seed=0:9", samples=6, fixed={"run.duration": 1.0, "expect.it_holds.below": 1.0}
    )
    before = children()
    results: dict[int, Any] = {}
    for number, found in runs.run(Processes(2)):
        results[number] = found
        if len(results) == 2:
            victim = (children() - before).pop()
            os.kill(victim, signal.SIGKILL)
    assert sorted(results) == list(range(6))
    errors = [found["error"] for found in results.values() if found["error"]]
    assert len(errors) <= 1  # none, if it was between two variants
    assert all(error == KILLED for error in errors)
    assert sum(found["held"] for found in results.values()) == 6 - len(errors)
    assert children() == before


def children(of: int | None = None) -> set[int]:
    """Returns the processes that run variants, started by this process or another."""
    listed = Path(f"/proc/{of or os.getpid()}/task/{of or os.getpid()}/children").read_text()
    pids = {int(pid) for pid in listed.split()}
    return {pid for pid in pids if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()}


# --- tables


def filled(runs: Sweep, path: Path, count: int) -> None:
    """Writes a table with the results of this number of variants."""
    with SweepTable(runs, path) as table:
        for number, found in runs.run():
            table.add(number, found)
            if len(table.rows) == count:
                break


@pytest.mark.slow
def test_interrupted_sweep_is_resumed(file: Path, tmp_path: Path) -> None:
    runs = sweep(file, f"{STIFFNESS}=log:50:9000", samples=6)
    whole, broken = tmp_path / "whole.csv", tmp_path / "broken.csv"
    filled(runs, whole, 6)
    filled(runs, broken, 3)
    with open(broken, "a") as table:  # killed in the middle of a row
        table.write("5,123.4,tr")
    with SweepTable(runs, broken, resume=True) as table:
        assert sorted(table.rows) == [0, 1, 2]
        for number, found in runs.run(numbers=range(3, 6)):
            assert number > 2
            table.add(number, found)
        summary = summarise_sweep(table.rows, runs.columns)
    assert broken.read_bytes() == whole.read_bytes()
    with SweepTable(runs, whole, resume=True) as table:
        assert len(table.rows) == 6
        assert summarise_sweep(table.rows, runs.columns) == summary
    assert whole.read_bytes() == broken.read_bytes()


@pytest.mark.slow
def test_joined_shards_equal_the_table_of_one_run(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["sweep", str(file), "--vary", f"{STIFFNESS}=50:900", "--samples", "5"]
    arguments += ["--jobs", "1", "--quiet"]

    def done(*more: str | Path) -> tuple[int, str]:
        with pytest.raises(SystemExit) as caught:
            main([*arguments, *map(str, more)])
        return int(caught.value.code or 0), capsys.readouterr().err

    whole, joined = tmp_path / "whole.csv", tmp_path / "joined.csv"
    parts = [tmp_path / f"part.{number}.csv" for number in (1, 2)]
    held, _ = done("-o", whole)
    assert held == 1  # not all of them
    done("--shard", "2/2", "-o", parts[1])
    assert [row["variant"] for row in read(parts[1])] == ["1", "3"]
    assert done("--merge", parts[1], "-o", joined) == (
        130, "sero-mj: stopped; 3 variants are left; repeat the command with --resume to "
        "continue\n",
    )  # fmt: skip
    done("--shard", "1/2", "-o", parts[0])
    assert done("--merge", tmp_path / "part.*.csv", "-o", joined, "--resume")[0] == held
    assert joined.read_bytes() == whole.read_bytes()
    head, first, second = parts[1].read_text().splitlines()
    parts[1].write_text(f"{head}\n{first.replace('1', '3', 1)}\n{second.replace('3', '1', 1)}\n")
    _, output = done("--merge", parts[1], "-o", joined, "--resume")
    assert "has a different result for variant" in output
    _, output = done("--merge", tmp_path / "no.*.csv", "-o", joined, "--resume")
    assert "--merge: no file" in output


@pytest.mark.thorough
def test_slurm_job_runs_the_shards(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["sweep", str(file), "--vary", f"{STIFFNESS}=50:900", "--samples", "3",
              "-o", str(tmp_path / "out.csv"), "--print-sbatch", "2"])  # fmt: skip
    job = capsys.readouterr().out
    assert "#SBATCH --array=1-2\n" in job
    # As on a cluster: bash, and an `srun` that runs its arguments.
    bin_ = tmp_path / "bin"
    bin_.mkdir()
    (bin_ / "srun").write_text('#!/bin/sh\nexec "$@"\n')
    (bin_ / "sero-mj").write_text(f'#!/bin/sh\nexec {sys.executable} -m sero_mj "$@"\n')
    for program in bin_.iterdir():
        program.chmod(0o755)
    path = f"{bin_}:{os.environ['PATH']}"
    for task in ("1", "2"):
        variables = {"PATH": path, "SLURM_ARRAY_TASK_ID": task, "SLURM_CPUS_PER_TASK": "1"}
        subprocess.run(["bash"], input=job, text=True, env=os.environ | variables, check=False)
    afterwards = job.partition("# Afterwards:\n")[2].replace("# ", "", 1).replace("\n#", "\n")
    subprocess.run(["bash"], input=afterwards, text=True, env=os.environ | {"PATH": path},
                   check=False, capture_output=True)  # fmt: skip
    assert [row["variant"] for row in read(tmp_path / "out.csv")] == ["0", "1", "2"]


def test_table_of_another_sweep_is_not_resumed(file: Path, tmp_path: Path) -> None:
    path = tmp_path / "out.csv"
    filled(sweep(file, f"{STIFFNESS}=50:900"), path, 2)
    with pytest.raises(UsageError) as caught:
        SweepTable(sweep(file, f"{STIFFNESS}=50:800", samples=5, seed=3), path, resume=True)
    assert str(caught.value) == (
        f"--resume {path}: it belongs to another sweep: vary.{STIFFNESS} was 50:900 and is 50:800; "
        "samples was 4 and is 5; seed was 0 and is 3"
    )
    file.write_text(SCENARIO.replace("-60.0", "-61.0"))
    with raises_with(
        UsageError,
        key=f"--resume {tmp_path}/out.csv",
        reason="it belongs to another sweep: shove.toml has changed",
    ):
        SweepTable(sweep(file, f"{STIFFNESS}=50:900"), path, resume=True)
    with raises_with(
        UsageError,
        reason="already exists",
        file=f"{tmp_path}/out.csv",
        expected="--resume to continue it, or --overwrite",
    ):
        SweepTable(sweep(file, f"{STIFFNESS}=50:900"), path)
    (tmp_path / "out.csv.json").unlink()
    with raises_with(
        UsageError,
        reason="cannot be continued: out.csv.json with its settings is missing",
        file=f"{tmp_path}/out.csv",
        expected="--overwrite",
    ):
        SweepTable(sweep(file, f"{STIFFNESS}=50:900"), path, resume=True)


def test_invalid_table_is_reported_with_its_line(file: Path, tmp_path: Path) -> None:
    runs, path = sweep(file, f"{STIFFNESS}=50:900"), tmp_path / "out.csv"
    filled(runs, path, 2)
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join([*lines[:2], "some words\n"]))
    with raises_with(
        CsvError,
        path=f"{tmp_path}/out.csv",
        line=3,
        reason="found 1 entries; expected the number of a variant and 10 other entries",
    ):
        SweepTable(runs, path, resume=True)
    path.write_text("".join([*lines[:2], lines[2].replace("1,", "77,", 1)]))
    with raises_with(
        CsvError,
        path=f"{tmp_path}/out.csv",
        line=3,
        reason="found variant 77; expected a number below 4",
    ):
        SweepTable(runs, path, resume=True)
    path.write_text("a,b\n1,2\n")
    with raises_with(
        CsvError,
        path=f"{tmp_path}/out.csv",
        reason="found columns a,b; expected the columns of this sweep",
    ):
        SweepTable(runs, path, resume=True)


def test_summary_names_the_variants_with_the_lowest_and_highest_values(file: Path) -> None:
    runs = sweep(file, f"{STIFFNESS}=200,1000,9000,3000", samples=1, is_grid=True)
    with SweepTable(runs) as table:
        for number, found in runs.run():
            table.add(number, found)
    summary = summarise_sweep(table.rows, runs.columns)
    assert summary.count == 4 and list(summary.errors) == [2]
    by_name = {each.name: each for each in summary.outcomes}
    held = by_name["it_holds"]
    assert held.known == 3
    assert held.highest[1] == 0 and held.lowest[1] == 3  # the softest and the stiffest
    assert held.lowest[0] < held.median < held.highest[0]
    assert held.held == summary.held


# --- the command


def test_figure_has_units_and_a_legend(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import matplotlib as mpl

    monkeypatch.setitem(mpl.rcParams, "svg.fonttype", "none")  # text as text
    drawn = sweep(file, f"{STIFFNESS}=200,4000", "disturbances.push.begin=0.1:0.2", samples=2)
    whole = dict.fromkeys(drawn.columns)
    rows = {
        0: {**whole, STIFFNESS: 200, "disturbances.push.begin": 0.1, "held": True,
            "expect.it_holds": True, "expect.it_holds.value": 0.01},
        1: {**whole, STIFFNESS: 4000, "disturbances.push.begin": 0.2, "held": False},
    }  # fmt: skip
    plot_sweep(drawn, rows, tmp_path / "out.svg")
    text = (tmp_path / "out.svg").read_text("utf-8")
    for part in ("it holds, rad", "disturbances.push.begin, s", "passed", "failed", "no value",
                 "expected bound"):  # fmt: skip
        assert f">{part}<" in text, part


@pytest.mark.thorough
@pytest.mark.slow
def test_sweep_writes_table_and_figure_and_reports_the_result(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, plot = tmp_path / "deep" / "out.csv", tmp_path / "out.png"
    command = ["sweep", str(file), "--vary", f"{STIFFNESS}=200,4000,9000", "--grid",
               "--vary", "run.elastic=true,false", "--jobs", "2", "-o", str(out),
               "--plot", str(plot)]  # fmt: skip
    with pytest.raises(SystemExit) as caught:
        main(command)
    output = capsys.readouterr().out
    assert caught.value.code == 1
    assert "shove: 6 variants (6 in " in output
    assert "stopped stiffness 9000, elastic True: controllers.lwr.stiffness: found 9000" in output
    assert "2 stopped with an error" in output
    assert len(read(out)) == 6
    assert plot.read_bytes()[:4] == b"\x89PNG" and plot.stat().st_size > 5000
    with pytest.raises(SystemExit) as caught:
        main([*command, "--resume", "--json"])
    result = json.loads(capsys.readouterr().out)
    assert caught.value.code == 1
    assert result["variants"] == 6 and list(result["errors"]) == ["4", "5"]
    lowest = result["outcomes"]["it_holds"]["lowest"]
    assert lowest["values"][STIFFNESS] == 4000
    with pytest.raises(SystemExit) as caught:
        main(["sweep", str(file), "--vary", f"{STIFFNESS}=4000:4500", "--samples", "2", "--quiet",
              "--jobs", "1", "--set", "expect.it_holds.below=0.5"])  # fmt: skip
    assert caught.value.code == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--resume"], "--resume needs the file to continue: add -o OUT.csv"),
        (["-o", "out.txt"], "--out: found 'out.txt'; expected a name that ends in .csv"),
        (["--plot", "out.csv"], "--plot: found 'out.csv'; expected a name that ends in .png"),
        (
            ["--resume", "--overwrite", "-o", "a.csv"],
            "--resume cannot be combined with --overwrite",
        ),
        (["--samples", "0"], "found '0'"),
        (["--jobs", "two"], "found 'two'"),
        (["--seed", "-1"], "found '-1'"),
    ],
)
def test_invalid_options_are_rejected(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["sweep", "impedance_push", "--vary", f"{STIFFNESS}=1:2", *arguments])
    assert caught.value.code == 2
    assert message in capsys.readouterr().err


# More variants than two processes run at once in batches of 24 each.
MANY = 100
SEEDS = ["--samples", str(MANY), "--vary", "run.seed=0:1000", "--set", "run.duration=0.4",
         "--set", "expect.it_holds.below=1.0"]  # fmt: skip


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Returns the table of a sweep that is not interrupted, run by one process."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "shove.toml").write_text(SCENARIO)
    out = folder / "out.csv"
    command = ["sweep", str(folder / "shove.toml"), *SEEDS, "--jobs", "1", "-o", str(out)]
    with pytest.raises(SystemExit) as caught:
        main([*command, "--quiet"])
    assert caught.value.code == 0
    return out.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("how", sampled([signal.SIGKILL, signal.SIGINT], 1))
def test_stopped_sweep_is_resumed_by_the_command(
    file: Path, tmp_path: Path, how: int, whole: bytes, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out.csv"
    command = ["sweep", str(file), *SEEDS, "-o", str(out)]
    process = subprocess.Popen(
        [sys.executable, "-m", "sero_mj", *command, "--jobs", "2"],
        stderr=subprocess.PIPE,
        text=True,
    )
    wait_for(lambda: out.exists() and out.read_bytes().count(b"\n") >= 5)
    workers = children(process.pid)
    assert len(workers) == 2
    process.send_signal(how)
    _, output = process.communicate(timeout=20)
    if how == signal.SIGINT:
        assert process.returncode == 130
        assert "variants are left; repeat the command with --resume to continue" in output
    else:
        assert process.returncode == -how
    wait_for(lambda: not any(is_alive(pid) for pid in workers))  # no process is left
    known = len(read(out))
    assert 4 <= known < MANY
    with pytest.raises(SystemExit) as caught:
        main([*command, "--jobs", "1", "--resume"])
    assert caught.value.code == 0
    output = capsys.readouterr().out
    assert f"; {known} from earlier runs" in output or f"; {known - 1} from earlier runs" in output
    assert out.read_bytes() == whole


def is_alive(pid: int) -> bool:
    try:
        return "Z" not in Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False


def wait_for(happens: Any, seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


@pytest.mark.slow
def test_processes_load_no_opengl(file: Path) -> None:
    code = (
        "import sys; from multiprocessing import Pipe; from pathlib import Path\n"
        "from sero_mj.study import engine\n"
        "end, other = Pipe(duplex=False)\n"
        "from sero_mj.extensions.sweeps.variants import Variants\n"
        f"engine.start_worker(end, Variants(Path({str(file)!r}), {{}}))\n"
        "print(engine._run([{}])[0]['held'], 'OpenGL.EGL' in sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[1] == "False", done.stdout


def test_shipped_scenario_can_be_swept() -> None:
    runs = sweep(find_scenario("impedance_push"), f"{STIFFNESS}=log:100:5000", samples=2)
    assert runs.columns[:3] == ["variant", STIFFNESS, "held"]
    assert set(runs.settings["files"]) == {"impedance_push.toml", "lwr/robot.toml"}


@pytest.mark.parametrize(
    ("left", "workers", "size"), [(64, 1, 32), (64, 2, 32), (70, 1, 35), (5, 8, 1), (300, 2, 50)]
)
def test_batches_of_all_workers_have_one_size(left: int, workers: int, size: int) -> None:
    work = Work(Variants(Path("shove.toml"), {}), [], max_batch=64)
    assert work.batch_size(left, workers) == size
