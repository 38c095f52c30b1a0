"""`Processes`: runs batches of tasks in parallel processes on this machine.

Threads would not help, because controllers, sensors and events are Python code between the steps of
MuJoCo. `mujoco.rollout` needs all torques in advance, so it does not allow feedback. This file
imports little, because every new process loads it.
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
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any

from ..base.child_process import end_all
from .engine import Job, Result, Runner, Task, Work

_runner: Runner  # of a worker process


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

    In a script, use it below `if __name__ == "__main__":`, because new processes load the script.
    """

    def __init__(self, jobs: int = 1) -> None:
        self.workers = jobs

    def run(self, work: Work) -> Generator[Result]:
        """Yields the results of each finished batch.

        If a process is killed, for example because memory is exhausted, its tasks are repeated one
        by one in a new process. If this is killed, too, the task has an error.
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
