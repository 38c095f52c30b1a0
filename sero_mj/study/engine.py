"""Runs tasks in parallel: an `Engine` runs `Work` and yields the results.

A `Job` such as `EachRecording` defines what a task does. `Processes` is the engine for this
machine. A package adds an engine by an entry point in the group `sero_mj.engines`: a class whose
arguments are the values of `--scheduler` and `--ship`. This file imports little, because every new
process loads it.
"""

from __future__ import annotations

import os
import signal
import threading
from collections import deque
from collections.abc import Generator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Protocol

from ..base.child_process import end_all
from ..base.errors import Problem, SeroError, UsageError

Task = tuple[int, Mapping[str, Any]]  # number of the task, and its values
Result = tuple[int, dict[str, Any]]  # number of the task, and results by column

_EFFICIENT_BATCH = 24  # tasks per batch above which the fixed cost of a step is negligible
KILLED = "the process was killed or ran out of memory"


class Runner(Protocol):
    """A runner of tasks in one process, which caches data that several tasks need."""

    def run(self, tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Runs tasks; returns their results by column. The column `error` describes a failure."""


class Job(Protocol):
    """The definition of tasks. It is sent to other processes, so it contains only plain values."""

    def runner(self) -> Runner:
        """Returns a runner. Called in the process that runs the tasks."""

    def check(self) -> None:
        """Raises SeroError if the job cannot run, for example because files are missing."""

    def files(self) -> list[Path]:
        """Returns the files that all tasks read."""

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        """Returns the additional files that the task with these values reads."""

    def below(self, root: Path) -> Job:
        """Returns this job for a machine that has copies of its files below a root folder."""

    def killed(self) -> dict[str, Any]:
        """Returns the results to report for a task whose process was killed."""


@dataclass(frozen=True)
class EachRecording:
    """A `Job` that applies a function to each recording, which is the value `file` of a task.

    Attributes:
        study: `module:name` of the function, which takes `shared` and the path of a recording, and
            returns results by column.
        shared: plain values that are passed to all tasks.
        needed: files to which the values in `shared` refer.
    """

    study: str
    shared: Mapping[str, Any]
    needed: Sequence[Path] = ()

    def runner(self) -> Runner:
        return _RecordingRunner(self)

    def check(self) -> None:
        pass

    def files(self) -> list[Path]:
        return [file.absolute() for file in self.needed]

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        return files_in(Path(values["file"]))

    def below(self, root: Path) -> EachRecording:
        return replace(self, shared=below(root, self.shared))

    def killed(self) -> dict[str, Any]:
        return {"error": KILLED}


class _RecordingRunner:
    def __init__(self, job: EachRecording) -> None:
        self._shared = job.shared
        self._study = EntryPoint("study", job.study, "").load()

    def run(self, tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        return [self._examine(Path(values["file"])) for values in tasks]

    def _examine(self, file: Path) -> dict[str, Any]:
        try:
            return {"error": "", **self._study(self._shared, file)}
        except SeroError as error:
            text = str(error)
        except Exception as error:  # a bug must not end the other tasks
            text = f"{type(error).__name__}: {error}"
        return {"error": " ".join(text.split())}  # a row is one line


@dataclass(frozen=True)
class Work:
    """A job and the tasks that an engine runs.

    Attributes:
        max_batch: maximum number of tasks in one batch, limited by memory.
    """

    job: Job
    tasks: Sequence[Task]
    max_batch: int = 1

    def batch_size(self, left: int, workers: int) -> int:
        """Returns a batch size that fits into memory and gives intermediate results.

        All batches have the same size, so that the workers finish at the same time.
        """
        each = -(-left // max(workers, 1))
        batches = max(-(-each // self.max_batch), min(each // _EFFICIENT_BATCH, 2), 1)  # per worker
        return max(-(-each // batches), 1)


class Engine(Protocol):
    """An engine that runs tasks on this machine or on other machines.

    Attributes:
        workers: current number of workers.
    """

    workers: int

    def run(self, work: Work) -> Generator[Result]:
        """Yields the results of all tasks as they become ready, in any order.

        If a task fails or its process ends, the result contains `error`. Closing the generator
        ends the running tasks.
        """


def files_in(path: Path) -> list[Path]:
    """Returns a file, or all files in a folder; raises UsageError if there are no files."""
    found = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    if not found:
        raise UsageError(Problem("--ship", "no file or folder with files", found=str(path)))
    return [each.absolute() for each in found]


def below(root: Path, value: Any) -> Any:
    """Returns a copy of a value in which `/FILE` is replaced by `ROOT/FILE` if this copy exists.

    `value` may contain file names in nested lists and mappings.
    """
    if isinstance(value, str) and value.startswith("/") and (root / value[1:]).exists():
        return f"{root}{value}"
    if isinstance(value, list | tuple):
        return [below(root, each) for each in value]
    if isinstance(value, Mapping):
        return {key: below(root, each) for key, each in value.items()}
    return value


_runner: Runner  # the runner of a worker process


def available_cpus() -> int:
    """Returns the number of processors available to this process."""
    if hasattr(os, "process_cpu_count"):  # since Python 3.13
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def start_worker(parent: Connection, job: Job) -> None:
    """Initializes a worker process, which exits when the other end of `parent` is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process ends it
    threading.Thread(target=_exit_with, args=(parent,), daemon=True).start()
    os.environ["MUJOCO_GL"] = "disable"  # no rendering here
    global _runner  # noqa: PLW0603
    _runner = job.runner()


def _exit_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv_bytes()
    end_all()
    os._exit(1)


def _run(tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return _runner.run(tasks)


class Processes:
    """An `Engine` with `jobs` processes on this machine; a single job runs in this process.

    Threads would not help, because controllers, sensors and events are Python code between the
    steps of MuJoCo. `mujoco.rollout` needs all torques in advance, so it does not allow feedback.
    In a script, use this class below `if __name__ == "__main__":`, because new processes load the
    script.
    """

    def __init__(self, jobs: int = 1) -> None:
        self.workers = jobs

    def run(self, work: Work) -> Generator[Result]:
        """Yields the results of each finished batch.

        If a process is killed, for example because memory is exhausted, its tasks are repeated one
        by one in a new process. If this process is also killed, the result contains an error.
        """
        count = len(work.tasks)
        size = work.batch_size(count, self.workers)
        batches = [work.tasks[first : first + size] for first in range(0, count, size)]
        if (jobs := min(self.workers, count)) > 1:
            yield from _run_in_processes(batches, jobs, work.job)
            return
        runner = work.job.runner()
        for batch in batches:
            results = runner.run([values for _, values in batch])
            yield from zip((number for number, _ in batch), results, strict=True)


def _run_in_processes(batches: Sequence[Sequence[Task]], jobs: int, job: Job) -> Generator[Result]:
    context = get_context("spawn")  # a fork would inherit broken threads and OpenGL
    child_end, own_end = context.Pipe(duplex=False)

    def new_pool() -> ProcessPoolExecutor:
        arguments = (child_end, job)
        return ProcessPoolExecutor(1, context, initializer=start_worker, initargs=arguments)

    todo = deque(batches)
    # A killed process breaks its pool. With one process per pool, its tasks are known.
    free = [new_pool() for _ in range(jobs)]
    busy: dict[Future[list[dict[str, Any]]], tuple[ProcessPoolExecutor, Sequence[Task]]] = {}
    try:
        while True:
            while free and todo:
                batch, pool = todo.popleft(), free.pop()
                values = [dict(each) for _, each in batch]
                try:
                    future = pool.submit(_run, values)
                except BrokenProcessPool:  # killed while idle
                    pool = new_pool()
                    future = pool.submit(_run, values)
                busy[future] = pool, batch
            if not busy:
                return
            for future in wait(busy, return_when=FIRST_COMPLETED).done:
                pool, batch = busy.pop(future)
                try:
                    results = future.result()
                except BrokenProcessPool:
                    pool, results = new_pool(), [job.killed()]
                    if len(batch) > 1:
                        todo.extend([each] for each in batch)
                        batch, results = [], []
                free.append(pool)
                yield from zip((number for number, _ in batch), results, strict=True)
    finally:
        own_end.close()  # ends all processes immediately
        for pool in [*free, *(pool for pool, _ in busy.values())]:
            pool.shutdown()
        child_end.close()
