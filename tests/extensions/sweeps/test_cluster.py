"""Sweeps on a Dask cluster: workers with own folders, killed, late, missing, or different."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import free_udp_port, raises_with

from sero_mj.base.errors import ClusterError, UsageError
from sero_mj.base.paths import models_dir
from sero_mj.extensions.sweeps import cluster, cluster_worker
from sero_mj.extensions.sweeps.cluster import Cluster
from sero_mj.extensions.sweeps.samples import Samples, Vary
from sero_mj.extensions.sweeps.scenario_inputs import files_read, pack, unpack
from sero_mj.extensions.sweeps.sweep import Sweep
from sero_mj.extensions.sweeps.variants import Variants
from sero_mj.simulate.external_control.library import HEADER
from sero_mj.study.engine import KILLED, Work, files_in

pytest.importorskip("distributed")

# Its robot is beside its folder, and its motion has an absolute path.
SCENARIO = """
[robots.lwr]
model = "../robots/arm"
[run]
duration = 0.2
[controllers.lwr]
kind = "joint_impedance"
stiffness = 800.0
[sensors.lwr]
angles = { noise = 1e-5 }
[targets.lwr]
kind = "recorded"
file = "MOTION"
[expect.position_error]
measure = "position_error"
below = 0.005
"""
LAW = """
#include <signal.h>
#include <unistd.h>
#include "sero_mj_controller.h"
void control(struct sero_mj_robot *r) {
  if (FATAL && r->time > 0.05) kill(getpid(), SIGKILL);
  for (int i = 0; i < r->n; i++)
    r->torques_out[i] = 800.0 * (r->target_angles[i] - r->angles[i]) +
      40.0 * (r->target_velocities[i] - r->velocities[i]) + r->gravity[i];
}
"""
# A machine without access to the disk of the one that began the sweep.
NO_DISK = """
import os, sys
forbidden = os.environ["FORBIDDEN"]
def check(event, arguments):
    if event in ("open", "ctypes.dlopen") and isinstance(arguments[0], str):
        if os.path.abspath(arguments[0]).startswith(forbidden):
            raise PermissionError(arguments[0])
sys.addaudithook(check)
"""
SWEEP = ["--vary", "controllers.lwr.stiffness=log:50:90000", "--vary", "run.seed=0:99"]


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Writes a scenario with files in several folders."""
    folder = tmp_path_factory.mktemp("client")
    shutil.copytree(models_dir() / "lwr", folder / "robots" / "arm")
    motion = folder / "motions" / "still.csv"
    motion.parent.mkdir()
    rows = [f"{k / 100},0,0.6,0,{-1.2 + 0.001 * k},0,1.2,0\n" for k in range(30)]
    motion.write_text("time,a,b,c,d,e,f,g\n" + "".join(rows))
    path = folder / "study" / "follow.toml"
    path.parent.mkdir()
    path.write_text(SCENARIO.replace("MOTION", str(motion)))
    return path


class Machines:
    """A scheduler and workers, each with its own folder."""

    def __init__(self, folder: Path, forbidden: Path) -> None:
        self._folder, self._processes = folder, [subprocess.Popen(["true"])]
        (folder / "guard").mkdir()
        (folder / "guard" / "sitecustomize.py").write_text(NO_DISK)
        self._environment = os.environ | {
            "PYTHONPATH": str(folder / "guard"), "FORBIDDEN": str(forbidden), "TMPDIR": str(folder),
            "OMP_NUM_THREADS": "1", "DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "False",
        }  # fmt: skip
        self.file = folder / "scheduler.json"
        self.scheduler = self._started(
            "scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard",
            "--scheduler-file", str(self.file),
        )  # fmt: skip
        wait_for(self.file.is_file)

    def add_worker(self) -> subprocess.Popen[bytes]:
        """Starts a worker with the process that restarts it when it dies."""
        options = ["--nthreads", "1", "--nworkers", "1", "--no-dashboard"]
        return self._started("worker", "--scheduler-file", str(self.file), *options)

    def _started(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        home = self._folder / f"{what}{len(self._processes)}"
        home.mkdir()
        with open(home / "log", "wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", f"distributed.cli.dask_{what}", *options],
                cwd=home, env=self._environment, stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip
        self._processes.append(process)
        return process

    def pids(self) -> list[int]:
        """Returns the processes that run variants."""
        nannies = [str(process.pid) for process in self._processes[2:]]
        found = subprocess.run(
            ["pgrep", "-f", "spawn_main", "-P", ",".join(nannies)],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        return [int(pid) for pid in found.stdout.split()]

    def end(self) -> None:
        for process in self._processes:
            process.poll()
            if process.returncode is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


@contextmanager
def machines(folder: Path, forbidden: Path, workers: int) -> Iterator[Machines]:
    found = Machines(folder, forbidden)
    try:
        for _ in range(workers):
            found.add_worker()
        yield found
    finally:
        found.end()


def wait_for(happens: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.02)


def started(file: Path, *options: object) -> subprocess.Popen[str]:
    """Starts the command in the scenario's folder."""
    command = [sys.executable, "-m", "sero_mj", "sweep", file.name, *map(str, options)]
    return subprocess.Popen(command, cwd=file.parent, stderr=subprocess.PIPE, text=True,
                            stdout=subprocess.DEVNULL)  # fmt: skip


def commanded(*words: object) -> tuple[int, str]:
    """Returns exit status and stderr of a command."""
    command = [sys.executable, "-m", "sero_mj", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=110, check=False)
    return done.returncode, done.stderr


def swept(file: Path, *options: object) -> tuple[int, str]:
    """Returns exit status and stderr of the sweep."""
    process = started(file, *options)
    _, said = process.communicate(timeout=110)
    return process.returncode, said


@pytest.mark.thorough
@pytest.mark.slow
def test_table_equals_that_of_one_machine(file: Path, tmp_path: Path) -> None:
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    with machines(tmp_path, file.parents[1], 2) as found:
        sweep = [*SWEEP, "--samples", 12]
        done = swept(file, *sweep, "-o", here, "--jobs", 1)
        assert done == (1, "")  # some expectations fail
        engine = ["--engine", "dask", "--scheduler", found.file]
        _, output = swept(file, *sweep, "-o", there, *engine)
        assert "differs" not in output and "gone" not in output
        assert there.read_bytes() == here.read_bytes()
        rows = here.read_text()
        assert (
            ",true,,0.2" in rows and ",false,,0.2" in rows and "expected 0 to 5000 Nm/rad" in rows
        )
        assert not list(tmp_path.rglob("follow.toml"))  # removed afterwards
        # A file may be missing: a motion that the base scenario does not read.
        other = file.parents[1] / "motions" / "other.csv"
        other.write_text(Path(file.parents[1] / "motions" / "still.csv").read_text())
        faults = tmp_path / "faults.toml"
        faults.write_text(
            f"[soft]\ncontrollers.lwr.stiffness = 20.0\n[other]\ntargets.lwr.file = '{other}'\n"
        )
        for out, where in ((here, ["--jobs", 1]), (there, engine)):
            done = swept(file, "--mutations", faults, "-o", out, "--overwrite", *where)
            assert done == (1, "")
        assert there.read_bytes() == here.read_bytes()
        rows = here.read_text().splitlines()
        assert [row.split(",")[1:4] for row in rows[1:]] == [
            ["", "true", ""], ["soft", "false", ""], ["other", "true", ""],
        ]  # fmt: skip


@pytest.mark.thorough
def test_variant_that_kills_its_workers_is_a_row_and_affects_no_other(
    file: Path, tmp_path: Path
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    (tmp_path / "law.c").write_text(LAW)
    for fatal, name in enumerate(("good.so", "bad.so")):
        options = ["-O2", "-shared", "-fPIC", "-I", str(HEADER.parent), f"-DFATAL={fatal}"]
        command = ["cc", *options, "law.c", "-o", str(file.parent / name)]
        subprocess.run(command, cwd=tmp_path, check=True)
    scenario = file.parent / "library.toml"
    text = file.read_text().replace("joint_impedance", "library")
    scenario.write_text(text.replace("stiffness = 800.0", 'file = "good.so"'))
    files = "controllers.lwr.file=good.so,bad.so"
    sweep = ["--vary", files, "--vary", "run.seed=0,1,2,3", "--grid"]
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    loads = f"will load the library {file.parent / 'good.so'} (controllers.lwr)\n"
    with machines(tmp_path, file.parents[1], 2) as found:
        assert swept(scenario, *sweep, "-o", here, "--jobs", 2) == (1, loads)
        engine = ["--engine", "dask", "--scheduler", found.file]
        _, output = swept(scenario, *sweep, "-o", there, *engine)
    assert output == loads
    assert there.read_bytes() == here.read_bytes()
    assert there.read_text().count(KILLED) == 4


@pytest.mark.thorough
@pytest.mark.slow
def test_recordings_are_sent_to_workers_without_the_disk(file: Path, tmp_path: Path) -> None:
    client, table = file.parents[1] / "runs", tmp_path / "table.csv"
    client.mkdir()
    runs = [client / f"run{k}.mcap" for k in range(3)]
    for k, run in enumerate(runs):
        options = ["--set", f"controllers.lwr.stiffness={800 + 100 * k}", "--record", run]
        commanded("simulate", file, "--quiet", *options)
    (client / "broken.mcap").write_bytes(b"no recording")
    compare = ["compare", *runs, runs[0], client / "broken.mcap", "--table", table, "--quiet"]
    assert commanded(*compare, "--jobs", 2)[0] == 2
    here = table.read_bytes()
    with machines(tmp_path, file.parents[1], 1) as found:
        engine = ["--engine", "dask", "--scheduler", found.file]
        code, output = commanded(*compare, *engine)
        assert code == 2 and f"{client}/broken.mcap is not an MCAP file" in output
        assert not list(tmp_path.rglob("*.mcap"))  # removed afterwards
    assert table.read_bytes() == here
    rows = here.decode().splitlines()
    assert len(rows) == 5 and rows[1].startswith(str(runs[1])) and ",A2," in rows[1]


@pytest.mark.thorough
def test_killed_workers_do_not_change_the_table(file: Path, tmp_path: Path) -> None:
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    sweep = ["--vary", "run.seed=0:999", "--samples", "96", "--set", "run.duration=2"]
    swept(file, *sweep, "-o", here)
    with machines(tmp_path, file.parents[1], 2) as found:
        process = started(file, *sweep, "-o", there, "--engine", "dask", "--scheduler", found.file)
        for rows in (1, 30):
            wait_for(lambda rows=rows: there.exists() and there.read_bytes().count(b"\n") > rows)
            os.kill(found.pids()[0], signal.SIGKILL)
        found.add_worker()  # one that joins later
        _, output = process.communicate(timeout=110)
    assert output == ""
    assert KILLED not in there.read_text()
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.thorough
@pytest.mark.parametrize("how", ["Ctrl+C", "no scheduler"])
def test_stopped_sweep_is_resumed(file: Path, tmp_path: Path, how: str) -> None:
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    sweep = ["--vary", "run.seed=0:999", "--samples", "96", "--set", "run.duration=2"]
    swept(file, *sweep, "-o", here)
    with machines(tmp_path, file.parents[1], 2) as found:
        process = started(file, *sweep, "-o", there, "--engine", "dask", "--scheduler", found.file)
        wait_for(lambda: there.exists() and there.read_bytes().count(b"\n") > 1)
        if how == "Ctrl+C":
            process.send_signal(signal.SIGINT)
        else:
            found.scheduler.kill()
        begin = time.monotonic()
        _, output = process.communicate(timeout=60)
        assert time.monotonic() - begin < 20
        if how == "Ctrl+C":
            assert process.returncode == 130
            assert "variants are left; repeat the command with --resume to continue" in output
            wait_for(lambda: not list(tmp_path.rglob("follow.toml")))
            engine = ["--engine", "dask", "--scheduler", found.file]
        else:
            assert process.returncode == 2
            assert "the scheduler is gone; results so far are saved" in output
            engine = ["--jobs", 2]
        known = there.read_bytes().count(b"\n")
        assert 1 < known < 97
        swept(file, *sweep, "-o", there, "--resume", *engine)
    assert there.read_bytes() == here.read_bytes()


@pytest.mark.thorough
@pytest.mark.timeout(400)
def test_ten_thousand_short_variants_run(file: Path, tmp_path: Path) -> None:
    there = tmp_path / "there.csv"
    sweep = ["--vary", "run.seed=0:99999", "--samples", "10000", "--set", "run.duration=0.02"]
    with machines(tmp_path, file.parents[1], 4) as found:
        process = started(file, *sweep, "-o", there, "--engine", "dask", "--scheduler", found.file)
        _, output = process.communicate(timeout=390)
    assert output == ""
    assert there.read_bytes().count(b"\n") == 10_001


@pytest.mark.thorough
def test_workers_can_be_batch_jobs(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs = {
        "sbatch": f'cp "$1" {tmp_path}/job.sh; setsid bash {tmp_path}/job.sh >/dev/null 2>&1 &\n'
        'echo "Submitted batch job $!"',
        "scancel": f'kill -TERM -- "-$1"; echo $1 >> {tmp_path}/cancelled',
    }
    for name, text in programs.items():
        (tmp_path / name).write_text(f"#!/bin/bash\n{text}\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    queue = tmp_path / "cluster.toml"
    settings = 'cores = 1\nmemory = "1GB"\nwalltime = "00:10:00"\ninterface = "lo"'
    queue.write_text(f"[slurm]\njobs = 1\n{settings}\n")
    out = tmp_path / "out.csv"
    sweep = [*SWEEP, "--samples", 4, "-o", out, "--engine", "dask", "--scheduler", queue]
    status, output = swept(file, *sweep)
    assert status == 1, output
    assert out.read_bytes().count(b"\n") == 5
    assert "#SBATCH -t 00:10:00" in (tmp_path / "job.sh").read_text()
    wait_for((tmp_path / "cancelled").is_file)


# --- errors


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[slurm]\n[pbs]\n", "found 'slurm, pbs'; expected one table of slurm, pbs, lsf, sge"),
        ("jobs = ", "cannot be read"),
    ],
)
def test_invalid_batch_system_is_rejected(
    work: Work, tmp_path: Path, text: str, message: str
) -> None:
    queue = tmp_path / "cluster.toml"
    queue.write_text(text)
    with pytest.raises(UsageError) as caught:
        next(Cluster(str(queue)).run(work))
    assert message in str(caught.value)


@pytest.fixture
def work(file: Path) -> Work:
    sweep = Sweep(file, Samples((Vary.parse("run.seed=0:9"),), 2))
    return Work(Variants(file, {}), list(enumerate(sweep.variants)))


def test_missing_scheduler_is_reported(work: Work, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "PATIENCE", 0.3)
    address = f"tcp://127.0.0.1:{free_udp_port()}"
    with raises_with(
        ClusterError,
        address=address,
        reason="no scheduler answered within 0 s; expected the address that `dask scheduler` "
        "prints",
    ):
        next(Cluster(address).run(work))


@pytest.mark.thorough
def test_worker_with_other_packages_is_reported(
    work: Work, file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = cluster_worker.versions()
    monkeypatch.setattr(cluster_worker, "versions", lambda: {**own, "numpy": "1.0"})
    with machines(tmp_path, file.parents[1], 1) as found, pytest.raises(ClusterError) as caught:
        list(Cluster(str(found.file)).run(work))
    assert (
        f"differs from this machine: numpy is {own['numpy']} there and 1.0 here"
        in caught.value.reason
    )


@pytest.mark.parametrize(
    ("scheduler", "message"),
    [
        ("head:8786", "--scheduler: found 'head:8786'; expected tcp://HOST:PORT"),
        ("no.json", "--scheduler: no file 'no.json'"),
    ],
)
def test_invalid_scheduler_is_rejected(scheduler: str, message: str) -> None:
    with pytest.raises(UsageError) as caught:
        Cluster(scheduler)
    assert message in str(caught.value)


@pytest.mark.thorough
def test_shipped_files_have_the_same_relative_places(file: Path, tmp_path: Path) -> None:
    files = files_read(file, {})
    names = {each.relative_to(file.parents[1]).as_posix() for each in files}
    assert {"study/follow.toml", "robots/arm/robot.toml", "motions/still.csv"} <= names
    assert "robots/arm/meshes/base_grey.stl" in names
    extra = tmp_path / "extra" / "gains.txt"
    extra.parent.mkdir()
    extra.write_text("1 2 3")
    unpack(pack([*files, *files_in(extra.parent)]), tmp_path / "root")
    there = Path(f"{tmp_path}/root{file}")
    motion = Path(f"{tmp_path}/root{file.parents[1]}/motions/still.csv")
    assert f'"{motion}"' in there.read_text()
    assert motion.is_file() and Path(f"{tmp_path}/root{extra}").read_text() == "1 2 3"
    with pytest.raises(UsageError, match="--ship: no file or folder"):
        files_in(tmp_path / "none")
