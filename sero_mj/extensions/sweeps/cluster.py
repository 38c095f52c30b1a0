"""Runs tasks on the workers of a Dask cluster.

This program, not the scheduler, assigns batches to workers. Each worker has two batches, and gets
the next batch when one is done. Therefore, workers that join late are used, few tasks wait at the
scheduler, and the tasks of a worker that dies are known.
"""

from __future__ import annotations

import logging
import queue
import tomllib
import uuid
from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...base.errors import ClusterError, Problem, UsageError, about_fault
from ...study.engine import Result, Task, Work, files_in
from .scenario_inputs import digest_of_models, is_installed, pack

if TYPE_CHECKING:
    from .cluster_worker import JobFiles

log = logging.getLogger(__name__)

PATIENCE = 10.0  # timeout of the connection to a scheduler, s
ELSEWHERE = 2  # maximum number of times that a task is repeated after its worker died
_EACH = 2  # batches per worker: one that runs, and the next one
_LOOK = 1.0  # time between checks for new and dead workers, s
_ANSWER = 30.0  # timeout for the transfer of results, s
_NEEDED = "pip install 'sero-mj[dask]'"
_QUEUES = {
    "slurm": "SLURMCluster",
    "pbs": "PBSCluster",
    "lsf": "LSFCluster",
    "sge": "SGECluster",
}


class Cluster:
    """An `Engine` of Dask workers, which need no shared disk.

    Args:
        scheduler: address `tcp://HOST:PORT`, scheduler file (.json), or .toml file with a table for
            `dask-jobqueue`: `[slurm]`, `[pbs]`, `[lsf]` or `[sge]`.
        shipped: additional files and folders to send to the workers.

    Attributes:
        workers: current number of workers.

    Raises:
        UsageError: Dask is not installed, or `scheduler` is invalid.
    """

    def __init__(
        self,
        scheduler: str,
        shipped: Iterable[Path] = (),
    ) -> None:
        try:
            import distributed  # noqa: F401
        except ImportError as error:
            raise UsageError(f"--engine dask requires Dask ({error}): {_NEEDED}") from None
        if not scheduler.endswith((".json", ".toml")) and "://" not in scheduler:
            expected = "tcp://HOST:PORT, a scheduler file .json, or a file .toml with [slurm]"
            raise UsageError(Problem("--scheduler", found=scheduler, expected=expected))
        if "://" not in scheduler and not Path(scheduler).is_file():
            raise UsageError(Problem("--scheduler", "no file", found=scheduler))
        self.workers = 0
        self._scheduler = scheduler
        self._shipped = [file for path in shipped for file in files_in(path)]

    def run(self, work: Work) -> Generator[Result]:
        """Yields results in the order of their completion.

        Raises:
            ClusterError: the scheduler is not available, or the versions of workers differ.
        """
        with _quiet(), self._client() as client:
            from .cluster_worker import JobFiles

            files = work.job.files()
            own = [file for file in files if not is_installed(file)]
            archive = pack(list(dict.fromkeys([*own, *self._shipped])))
            name = f"sero-mj-{uuid.uuid4().hex[:12]}"
            models = digest_of_models(files)
            files_there = JobFiles(name, archive, work.job, models)
            run = _Run(client, self._scheduler, work, files_there)
            try:
                for found in run.results():
                    self.workers = run.workers
                    yield from found
            finally:
                self.workers = 0
                run.end()

    @contextmanager
    def _client(self) -> Iterator[Any]:
        from distributed import Client

        if self._scheduler.endswith(".toml"):
            with _job_queue(Path(self._scheduler)) as cluster, _closed(Client(cluster)) as client:
                yield client
            return
        is_file = self._scheduler.endswith(".json")
        place = {"scheduler_file" if is_file else "address": self._scheduler}
        try:
            client = Client(**place, timeout=PATIENCE, set_as_default=False)
        except (OSError, ValueError) as error:
            reason = f"no scheduler answered within {PATIENCE:.0f} s"
            if isinstance(error, ValueError):
                reason = str(error)
            expected = "the address that `dask scheduler` prints"
            raise ClusterError(self._scheduler, Problem("", reason, expected=expected)) from None
        with _closed(client):
            yield client


class _Run:
    """The execution of `Work` on the workers of a client.

    Args:
        address: address of the scheduler, for error messages.
    """

    def __init__(self, client: Any, address: str, work: Work, files: JobFiles) -> None:
        self._client, self._address, self._work, self._files = client, address, work, files
        self._todo: deque[Task] = deque(work.tasks)
        self._alone: deque[Task] = deque()  # tasks of killed workers, which are run one by one
        self._deaths: Counter[int] = Counter()
        # Worker, tasks and future of each batch, by key of the future.
        self._batches: dict[str, tuple[str, Sequence[Task], Any]] = {}
        self._of: dict[str, deque[str]] = {}  # keys by worker, with the running batch first
        self._refused: set[str] = set()
        self._done: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._count, self._has_warned = 0, False

    @property
    def workers(self) -> int:
        return len(self._of)

    def results(self) -> Generator[list[Result]]:
        with self._scheduler():
            installed = self._client.get_versions(check=False, packages=["sero_mj"])["workers"]
            self._refuse_without(installed)
            self._client.register_plugin(self._files)
        self._look()
        if not self._of:
            log.warning("%s has no workers yet; waiting", self._address)
        while self._todo or self._alone or self._batches:
            self._hand_out()
            try:
                yield self._take(self._done.get(timeout=_LOOK))
            except queue.Empty:
                yield self._look()

    def _refuse_without(self, installed: Mapping[str, Any]) -> None:
        for worker, found in installed.items():
            if not found["packages"].get("sero_mj"):
                expected = f"in the environment of its workers: {_NEEDED}"
                problem = Problem("", f"worker {worker} has no sero-mj", expected=expected)
                raise ClusterError(self._address, problem)

    @contextmanager
    def _scheduler(self) -> Iterator[None]:
        try:
            yield
        except (OSError, TimeoutError) as error:
            raise self._gone() from error
        if self._client.status != "running":
            raise self._gone()

    def _gone(self) -> ClusterError:
        return ClusterError(self._address, "the scheduler is gone; results so far are saved")

    def _look(self) -> list[Result]:
        """Adds new workers, and reassigns the tasks of workers that are gone."""
        with self._scheduler():
            threads: dict[str, int] = self._client.nthreads()
        new = [each for each in threads if each not in self._of and each not in self._refused]
        if new:
            self._check(new, threads)
        return [row for worker in set(self._of) - set(threads) for row in self._lost(worker)]

    def _check(self, new: list[str], threads: Mapping[str, int]) -> None:
        from .cluster_worker import differences_on_worker

        try:
            answers = self._client.run(
                differences_on_worker, self._files.name, workers=new, on_error="return"
            )
        except OSError:
            return  # a worker is gone; the others are checked again
        differing = {}
        for worker, found in answers.items():
            if isinstance(found, KeyError | OSError):
                continue  # the worker has just joined or left; it is checked again
            if found:
                is_error = isinstance(found, Exception)
                lines = [about_fault(found, Cluster)] if is_error else found
                differing[worker] = "; ".join(lines)
                continue
            self._of[worker] = deque()
        wide = [worker for worker in answers if threads[worker] > 1]
        if wide and not self._has_warned:
            self._has_warned = True
            log.warning(
                "worker %s has %d threads, but runs one batch at a time; for more, start: "
                "dask worker --nworkers %d --nthreads 1", wide[0], *2 * [threads[wide[0]]],
            )  # fmt: skip
        self._refused |= set(differing)
        for worker, text in differing.items():
            if not self._of or not self._count:
                raise ClusterError(
                    self._address, f"worker {worker} differs from this machine: {text}"
                )
            log.warning("worker %s differs from this machine and is not used: %s", worker, text)

    def _hand_out(self) -> None:
        from .cluster_worker import run_tasks

        job = self._work.job

        for has in range(_EACH):  # idle workers first
            for worker, keys in self._of.items():
                if len(keys) > has:
                    continue
                batch = self._next()
                if not batch:
                    return
                self._count += 1
                key = f"{self._files.name}-{self._count}"
                tasks = [dict(values) for _, values in batch]
                own = [file.absolute() for values in tasks for file in job.files_of(values)]
                future = self._client.submit(
                    run_tasks, self._files.name, tasks, pack(own) if own else b"", key=key,
                    workers=[worker], allow_other_workers=False, pure=False,
                )  # fmt: skip
                keys.append(key)
                self._batches[key] = worker, batch, future
                future.add_done_callback(lambda future: self._done.put(future.key))

    def _next(self) -> list[Task]:
        if not self._todo:
            return [self._alone.popleft()] if self._alone else []
        size = self._work.batch_size(len(self._todo), self.workers)
        return [self._todo.popleft() for _ in range(size)]

    def _take(self, key: str) -> list[Result]:
        if key not in self._batches:  # the batch was reassigned
            return []
        worker, batch, future = self._batches[key]
        if future.status in ("cancelled", "lost"):  # the scheduler or the worker is gone
            with self._scheduler():
                return self._lost(worker)
        try:
            results = future.result(timeout=_ANSWER)
        except Exception as error:
            if type(error).__name__ in ("KilledWorker", "TimeoutError", "CommClosedError"):
                return self._lost(worker)
            with self._scheduler():
                pass
            text = f"worker {worker} cannot run tasks: {type(error).__name__}: {error}"
            raise ClusterError(self._address, text) from error
        del self._batches[key]
        self._of[worker].remove(key)
        return list(zip((number for number, _ in batch), results, strict=True))

    def _lost(self, worker: str) -> list[Result]:
        """Reassigns the tasks of a dead worker.

        Returns the results of tasks that have failed too often to be repeated.
        """
        keys = self._of.pop(worker)
        failed: list[Result] = []
        waiting: list[Task] = []
        for place, key in enumerate(keys):
            _, batch, future = self._batches.pop(key)
            with suppress(Exception):
                self._client.cancel([future], force=True)
            if place:
                waiting += batch
                continue
            for number, values in batch:
                self._deaths[number] += 1
                if self._deaths[number] > ELSEWHERE:
                    failed.append((number, self._work.job.killed()))
                else:
                    self._alone.append((number, values))
        self._todo.extendleft(reversed(waiting))
        log.info("worker %s is gone", worker)
        return failed

    def end(self) -> None:
        if self._client.status != "running":
            return
        with suppress(Exception):
            self._client.cancel([future for _, _, future in self._batches.values()], force=True)
        with suppress(Exception):
            self._client.unregister_worker_plugin(self._files.name)


@contextmanager
def _closed(client: Any) -> Iterator[Any]:
    try:
        yield client
    finally:
        with suppress(Exception):
            client.close(timeout=2)


@contextmanager
def _quiet() -> Iterator[None]:
    import distributed  # noqa: F401  # sets the levels of its loggers

    known = [name for name in logging.root.manager.loggerDict if name.startswith("distributed.")]
    names = ("distributed", "tornado", "asyncio", *known)
    logs = [logging.getLogger(name) for name in names]
    levels = [each.level for each in logs]
    for each in logs:
        each.setLevel(logging.CRITICAL + 1)
    yield  # without `finally`, because cancelled tasks would log errors after an exception
    for each, level in zip(logs, levels, strict=True):
        each.setLevel(level)


@contextmanager
def _job_queue(file: Path) -> Iterator[Any]:
    try:
        import dask_jobqueue
    except ImportError as error:
        raise UsageError(f"{file} requires dask-jobqueue ({error}): {_NEEDED}") from None
    try:
        tables = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(Problem("--scheduler", f"cannot be read: {error}", str(file))) from None
    kinds = [kind for kind in tables if kind in _QUEUES]
    if len(tables) != 1 or not kinds or not isinstance(tables[kinds[0]], dict):
        found, expected = ", ".join(tables) or "nothing", f"one table of {', '.join(_QUEUES)}"
        raise UsageError(Problem("", file=str(file), found=found, expected=expected))
    settings = dict(tables[kinds[0]])
    jobs = settings.pop("jobs", 1)
    try:
        made = getattr(dask_jobqueue, _QUEUES[kinds[0]])(**settings)
    except (TypeError, ValueError) as error:
        first = str(error).partition(". ")[0]  # the rest describes internals
        expected = f"arguments of dask_jobqueue.{_QUEUES[kinds[0]]}, and jobs"
        problem = Problem(kinds[0], f"invalid settings: {first}", str(file), expected=expected)
        raise UsageError(problem) from None
    with made as cluster:
        cluster.scale(jobs=jobs)
        yield cluster
