"""Processes that run variants side by side.

Why processes: controllers, sensors, the observer and what happens in a run are Python between any
two steps of MuJoCo, which threads would take turns at. `mujoco.rollout` runs steps in threads but
takes all torques beforehand; no feedback could go into them.

This file imports little: a new process reads it before it chooses what else to load.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Generator, Iterable, Mapping
from contextlib import suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

Variant = tuple[int, Mapping[str, Any]]
Result = tuple[int, dict[str, Any]]


def work(connection: Connection, file: Path, fixed: Mapping[str, Any]) -> None:
    """Runs variants until the other end is closed, also by the end of its process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the one who asked for it closes the connection
    os.environ["MUJOCO_GL"] = "disable"  # nothing is drawn here
    from .variant import VariantRunner

    runner = VariantRunner(file, fixed)
    with suppress(EOFError, OSError):
        while True:
            number, values = connection.recv()
            connection.send((number, runner.run(values)))


class _Worker:
    """A process, and what it is at."""

    def __init__(self, file: Path, fixed: Mapping[str, Any]) -> None:
        context = get_context("spawn")  # a fork would take over threads and OpenGL half alive
        self.connection, other = context.Pipe()
        self.process: BaseProcess = context.Process(
            target=work, args=(other, file, dict(fixed)), daemon=True
        )
        self.process.start()
        other.close()  # so that its end is seen here
        self.number = -1
        self.has_ended = False

    def begin(self, variant: Variant) -> None:
        self.number = variant[0]
        with suppress(OSError):  # that it has ended is seen when the answer does not come
            self.connection.send((variant[0], dict(variant[1])))

    def end(self) -> Result:
        """What came of it; an error where the process has ended."""
        try:
            result: Result = self.connection.recv()
        except (EOFError, OSError):
            self.has_ended = True
            self.process.join()
            code = self.process.exitcode
            ended = f"by signal {-code}" if code is not None and code < 0 else f"with {code}"
            error = f"its process has ended {ended}; expected an answer"
            return self.number, {"held": False, "error": error, "ended": 0.0}
        return result

    def stop(self) -> None:
        self.connection.close()
        self.process.kill()
        self.process.join()
        self.process.close()


def run_in_processes(
    variants: Iterable[Variant], jobs: int, file: Path, fixed: Mapping[str, Any]
) -> Generator[Result]:
    """Runs variants in so many processes; results come as they are ready.

    A process that ends (no memory left, say) is an error of its variant, and another takes its
    place. In a script, call it below `if __name__ == "__main__":`, for new processes read the
    script.

    Args:
        variants: number and values of each.
        jobs: how many at once.
        file: the scenario's.
        fixed: dotted keys that are set in all of them.
    """
    todo = iter(variants)
    busy: dict[Connection, _Worker] = {}
    try:
        for variant in todo:
            worker = _Worker(file, fixed)
            busy[worker.connection] = worker
            worker.begin(variant)
            if len(busy) >= jobs:
                break
        while busy:
            for connection in wait(list(busy)):
                worker = busy.pop(connection)  # type: ignore[call-overload]
                result = worker.end()
                following = next(todo, None)
                if following is None or worker.has_ended:
                    worker.stop()
                if following is not None:
                    if worker.has_ended:
                        worker = _Worker(file, fixed)
                    busy[worker.connection] = worker
                    worker.begin(following)
                yield result
    finally:
        for worker in busy.values():
            worker.stop()
