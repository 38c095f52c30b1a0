"""What runs many tasks: `Work` is handed to an `Engine`, which yields their results.

A `Job` says what is done: a recording is examined (`EachRecording`), say. `workers.Processes` does
it on this machine. A package adds an engine by an entry point in the group `sero_mj.engines`: a
class whose arguments are the values of `--scheduler` and of `--ship`. This file imports little:
every new process reads it.
"""

from __future__ import annotations

from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, Protocol

Task = tuple[int, Mapping[str, Any]]  # its number and values
Result = tuple[int, dict[str, Any]]  # its number and outcomes, by column

_ENOUGH = 24  # tasks that are done together; what a step costs however many is little of it then
KILLED = "its process was killed, or ran out of memory; expected an answer"


class Runner(Protocol):
    """Does tasks of a job in one process, and keeps what several need."""

    def run(self, tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        """Returns the outcomes of tasks with these values; what goes wrong is their `error`."""


class Job(Protocol):
    """What is done in all tasks; it is sent to other processes, so it has plain values only."""

    def runner(self) -> Runner:
        """What does it, made in the process that does."""

    def check(self) -> None:
        """Raises SeroError where it cannot be done: files that it needs are missing, say."""

    def files(self) -> list[Path]:
        """The files that it reads, whatever the task."""

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        """The files that the task with these values reads besides."""

    def below(self, root: Path) -> Job:
        """The same where all these files are below a root."""

    def killed(self) -> dict[str, Any]:
        """The outcomes of a task whose process ended."""


@dataclass(frozen=True)
class EachRecording:
    """A `Job`: the same is asked of every recording, which is the `file` of its task.

    Attributes:
        study: the function that is asked, `module:name`; takes `shared` and the recording's path,
            and returns outcomes by column.
        shared: plain values, the same in all tasks.
        needed: files that `shared` names.
    """

    study: str
    shared: Mapping[str, Any]
    needed: Sequence[Path] = ()

    def runner(self) -> Runner:
        """Asks for one recording after the other."""
        return _Asking(self)

    def check(self) -> None:
        """Nothing is known beforehand."""

    def files(self) -> list[Path]:
        """Those that all recordings are asked with."""
        return [file.absolute() for file in self.needed]

    def files_of(self, values: Mapping[str, Any]) -> list[Path]:
        """The recording, which may be a folder."""
        from .shipped_files import files_in

        return files_in(Path(values["file"]))

    def below(self, root: Path) -> EachRecording:
        """With the names of files among the plain values."""
        from .shipped_files import below

        return replace(self, shared=below(root, self.shared))

    def killed(self) -> dict[str, Any]:
        """Only why."""
        return {"error": KILLED}


class _Asking:
    def __init__(self, job: EachRecording) -> None:
        self._shared = job.shared
        self._study = EntryPoint("study", job.study, "").load()

    def run(self, tasks: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        return [self._asked(Path(values["file"])) for values in tasks]

    def _asked(self, file: Path) -> dict[str, Any]:
        from ..base.errors import SeroError

        try:
            return {"error": "", **self._study(self._shared, file)}
        except SeroError as error:
            text = str(error)
        except Exception as error:  # a fault in this program shall not end all others
            text = f"{type(error).__name__}: {error}"
        return {"error": " ".join(text.split())}  # a row is one line


@dataclass(frozen=True)
class Work:
    """Tasks to be done.

    Attributes:
        job: what is done in each.
        tasks: in their order.
        most: how many may be done together: they need memory.
    """

    job: Job
    tasks: Sequence[Task]
    most: int = 1

    def size(self, left: int, workers: int) -> int:
        """How many are done together: few enough for memory, and for results to come meanwhile.

        Batches are of one size, so that at the end no worker waits for another.
        """
        each = -(-left // max(workers, 1))
        batches = max(-(-each // self.most), min(each // _ENOUGH, 2), 1)  # of every worker
        return max(-(-each // batches), 1)


class Engine(Protocol):
    """Does tasks; nothing else knows where.

    Attributes:
        workers: how many do tasks at the moment.
    """

    workers: int

    def run(self, work: Work) -> Generator[Result]:
        """Yields the results of all tasks, in any order, as they are ready.

        A task that cannot be done, or ends the process that does it, has an `error`. Closing the
        generator ends what is still going on.
        """
