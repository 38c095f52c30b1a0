"""Parallel tasks: an `Engine` runs `Work` and yields the results.

A `Job` such as `EachRecording` defines what a task does. `workers.Processes` is the engine for this
machine. A package adds an engine by an entry point in the group `sero_mj.engines`: a class whose
arguments are the values of `--scheduler` and `--ship`. This file imports little, because every new
process loads it.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Protocol

Task = tuple[int, Mapping[str, Any]]  # number and values
Result = tuple[int, dict[str, Any]]  # number of the task, and results by column

_EFFICIENT_BATCH = 24  # tasks per batch above which the fixed cost of a step is negligible
KILLED = "the process was killed or ran out of memory"


class Runner(Protocol):
    """Runs tasks of a job in one process, and caches what several tasks need."""

    def run(self, tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Returns the results of tasks with these values; `error` describes a failure."""


class Job(Protocol):
    """The definition of tasks. It is sent to other processes, so it contains only plain values."""

    def runner(self) -> Runner:
        """Returns a runner; called in the process that runs the tasks."""

    def check(self) -> None:
        """Raises SeroError if the job cannot run, for example because files are missing."""

    def files(self) -> list[Path]:
        """Returns the files that all tasks read."""

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        """Returns the additional files of the task with these values."""

    def below(self, root: Path) -> Job:
        """Returns the same job for copies of these files below a root folder."""

    def killed(self) -> dict[str, Any]:
        """Returns the results of a task whose process was killed."""


@dataclass(frozen=True)
class EachRecording:
    """A `Job` that applies a function to each recording, which is the `file` of its task.

    Attributes:
        study: `module:name` of the function, which takes `shared` and the path of a recording, and
            returns results by column.
        shared: plain values, the same for all tasks.
        needed: files in `shared`.
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
        from .shipped_files import files_in

        return files_in(Path(values["file"]))

    def below(self, root: Path) -> EachRecording:
        from .shipped_files import below

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
        from ..base.errors import SeroError

        try:
            return {"error": "", **self._study(self._shared, file)}
        except SeroError as error:
            text = str(error)
        except Exception as error:  # a bug must not end the other tasks
            text = f"{type(error).__name__}: {error}"
        return {"error": " ".join(text.split())}  # a row is one line


@dataclass(frozen=True)
class Work:
    """Tasks of a job.

    Attributes:
        max_batch: maximum number of tasks in one batch, limited by memory.
    """

    job: Job
    tasks: Sequence[Task]
    max_batch: int = 1

    def batch_size(self, left: int, workers: int) -> int:
        """Returns the size of batches that fit into memory and deliver intermediate results.

        All batches have the same size, so that the workers finish at the same time.
        """
        each = -(-left // max(workers, 1))
        batches = max(-(-each // self.max_batch), min(each // _EFFICIENT_BATCH, 2), 1)  # per worker
        return max(-(-each // batches), 1)


class Engine(Protocol):
    """Runs tasks, on this machine or elsewhere.

    Attributes:
        workers: current number of workers.
    """

    workers: int

    def run(self, work: Work) -> Generator[Result]:
        """Yields the results of all tasks as they become ready, in any order.

        The result of a task that fails or ends its process has an `error`. Closing the generator
        ends the running tasks.
        """
