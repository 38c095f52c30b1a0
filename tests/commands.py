"""Runs `sero-mj` and programs in processes of their own, which need not import everything anew."""

from __future__ import annotations

import atexit
import multiprocessing
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

_IMPORTED = (
    "sero_mj.cli", "sero_mj.load", "sero_mj.study.explain", "sero_mj.study.figure",
    "sero_mj.study.sweep", "sero_mj.viewer.headless.render", "sero_mj.simulate.simulation",
    "matplotlib.figure", "matplotlib.backends.backend_agg", "matplotlib.backends.backend_pdf",
)  # fmt: skip
# A server has neither; what was imported in it has chosen nothing by them.
UNSET = ("DISPLAY", "MUJOCO_GL")


@cache
def _server() -> Any:
    """Processes that are copies of one in which neither a display nor a backend was set."""
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")
    context.set_forkserver_preload([__name__, *_IMPORTED])
    return context


def run_command(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    """Runs `sero-mj ARGUMENTS` in a folder; returns its exit status and all that it printed.

    Args:
        arguments: of the command.
        folder: where it runs; what it prints is kept there as well, in `printed.txt`.
        environment: its whole environment.
    """
    return _run(_command, [*arguments], folder, environment)


def run_program(program: str, folder: Path, environment: Mapping[str, str]) -> tuple[int, str]:
    """Runs a program in a folder, on its module search path; see `run_command`.

    Args:
        program: Python.
        folder: where it runs, with the modules and packages that only it has.
        environment: its whole environment.
    """
    return _run(_program, program, folder, environment)


def _run(
    act: Callable[[Any], None], what: Any, folder: Path, environment: Mapping[str, str]
) -> tuple[int, str]:
    said = folder / "printed.txt"
    before = dict(os.environ)
    os.environ.clear()
    # For modules that are imported beforehand.
    os.environ |= {**environment, "PYTHONPATH": str(Path(__file__).parent)}
    try:
        process = _server().Process(
            target=_begin, args=(act, what, str(folder), dict(environment), str(said))
        )
        process.start()
    finally:
        os.environ.clear()
        os.environ |= before
    process.join()
    status = process.exitcode
    process.close()
    return int(status), said.read_text("utf-8", "replace")


def _begin(
    act: Callable[[Any], None], what: Any, folder: str, environment: dict[str, str], said: str
) -> None:
    with open(said, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(folder)
    for key in os.environ.keys() - environment.keys() - {"MUJOCO_GL", "PYOPENGL_PLATFORM"}:
        del os.environ[key]
    os.environ |= environment
    sys.path[:0] = [folder]  # with packages, maybe
    try:
        act(what)
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        atexit._run_exitfuncs()


def _command(arguments: list[str]) -> None:
    from sero_mj.cli import main

    sys.argv = ["sero-mj", *arguments]
    main(arguments)


def _program(program: str) -> None:
    exec(compile(program, "<program>", "exec"), {"__name__": "__main__"})
