"""`Processes`: batches of variants of a sweep side by side on this machine.

Why processes: controllers, sensors, the observer and events of a run are Python code between steps
of MuJoCo, which threads would serialize. `mujoco.rollout` runs steps in threads but takes all
torques beforehand; no feedback could go into them.

This file imports little: a new process reads it before it decides what else to load.
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
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .engine import Result, Variant, Work, killed

if TYPE_CHECKING:
    from .variant import VariantRunner

_runner: VariantRunner  # of a worker process


def available_cpus() -> int:
    """Number of processors available to this process."""
    if hasattr(os, "process_cpu_count"):  # since Python 3.13
        return os.process_cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):  # neither on macOS nor on Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def start_worker(parent: Connection, file: Path, fixed: Mapping[str, Any]) -> None:
    """Prepares a worker process, which ends with its parent process.

    Args:
        parent: carries no data; it is closed when that process ends, or before.
        file: the scenario's.
        fixed: dotted keys that are set in all variants.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # its parent process ends it
    threading.Thread(target=_exit_with, args=(parent,), daemon=True).start()
    os.environ["MUJOCO_GL"] = "disable"  # no rendering here
    from .variant import VariantRunner

    global _runner  # noqa: PLW0603
    _runner = VariantRunner(file, fixed)


def _exit_with(parent: Connection) -> None:
    with suppress(EOFError, OSError):
        parent.recv_bytes()
    os._exit(1)


def _run(variants: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    return _runner.run(variants)


class Processes:
    """An `Engine` of processes on this machine; one alone is this process itself.

    In a script, call it below `if __name__ == "__main__":`, for new processes read the script.

    Args:
        jobs: how many run at once.
    """

    def __init__(self, jobs: int = 1) -> None:
        self.workers = jobs

    def run(self, work: Work) -> Generator[Result]:
        """Runs variants; results come as their batches are ready.

        The variants of a process that ends (no memory left, say) are run anew one by one, in
        another one; that it ends with one alone is an error of this variant.
        """
        count = len(work.variants)
        size = work.size(count, self.workers)
        batches = [work.variants[first : first + size] for first in range(0, count, size)]
        if (jobs := min(self.workers, count)) > 1:
            yield from _run_in_processes(batches, jobs, work.file, work.fixed)
            return
        from .variant import VariantRunner

        runner = VariantRunner(work.file, work.fixed)
        for batch in batches:
            results = runner.run([values for _, values in batch])
            yield from zip((number for number, _ in batch), results, strict=True)


def _run_in_processes(
    batches: Sequence[Sequence[Variant]], jobs: int, file: Path, fixed: Mapping[str, Any]
) -> Generator[Result]:
    context = get_context("spawn")  # a fork would inherit broken threads and OpenGL
    child_end, own_end = context.Pipe(duplex=False)

    def new_pool() -> ProcessPoolExecutor:
        arguments = (child_end, file, dict(fixed))
        return ProcessPoolExecutor(1, context, initializer=start_worker, initargs=arguments)

    todo = deque(batches)
    # A process that is killed breaks its pool; with one process each it is known whose it was.
    free = [new_pool() for _ in range(jobs)]
    busy: dict[Future[list[dict[str, Any]]], tuple[ProcessPoolExecutor, Sequence[Variant]]] = {}
    try:
        while True:
            while free and todo:
                batch, pool = todo.popleft(), free.pop()
                values = [dict(each) for _, each in batch]
                try:
                    future = pool.submit(_run, values)
                except BrokenProcessPool:  # killed while it had nothing to do
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
                    pool, results = new_pool(), [killed()]
                    if len(batch) > 1:
                        todo.extend([each] for each in batch)
                        batch, results = [], []
                free.append(pool)
                yield from zip((number for number, _ in batch), results, strict=True)
    finally:
        own_end.close()  # ends all processes, whatever they do
        for pool in [*free, *(pool for pool, _ in busy.values())]:
            pool.shutdown()
        child_end.close()
